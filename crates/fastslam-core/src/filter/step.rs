//! One scan as the papers have it, a stage a line.

use super::associate::{associate, list_named};
use super::correct::{correct, place_sensors};
use super::estimate::{estimate_beliefs, estimate_particles};
use super::examine::examine;
use super::judge::judge;
use super::propose::propose;
use super::remember::remember;
use super::resample::{follow_ancestors, resample};
use super::sample::sample;
use super::setup::Setup;
use super::state::State;
use super::weigh::{clear_log_likelihood, weigh};
use super::work::Work;
use super::StepInfo;
use crate::association::ScanSighting;
use crate::error::Result;
use crate::measurement::Placing;

/// FastSLAM 2.0; and 1.0 where particles decide what a sighting shows: its poses are samples already, of which the
/// beliefs have no spread.
///
/// A sighting is claimed by the same landmark in all maps where it is named, and by one per map where it is not; no
/// name occurs twice in `scan`.
///
/// **Source:** `montemerlo2003fastslam`, eqs. 9–19 and 22, section 4; `montemerlo2002fastslam`, eqs. 14 and 15.
/// **Why:** the weight (evidence form) does not depend on the sampled pose, so resampling comes first and copies of one
/// ancestor get different poses. The landmarks are corrected at the sampled pose, not at the predicted one as eq. 17
/// prints it: only that converges. What is judged away has no birth any more, so the scan is remembered before.
pub(super) fn step<M: Placing>(
    setup: &Setup<M>,
    state: &mut State,
    work: &mut Work,
    scan: &[ScanSighting],
    info: &mut StepInfo,
) -> Result<()> {
    propose(setup, state, &mut work.beliefs); //             ŝ = h(s, u), P                          eqs. 9–15
    associate(setup, state, work, scan, info); //            n = argmax p(z | n); μ_s, Σ_s given n   eqs. 14, 15; 9–15
    examine(setup, state, work, scan); //                    ν against what all particles expect
    weigh(setup, state, &work.log_likelihood, info)?; //     w ∝ N(z; ẑ, L)                          eq. 19
    estimate_beliefs(state, &work.beliefs); //               mean and covariance of Σ w N(μ_s, Σ_s)
    if resample(setup, state, work, info) {
        follow_ancestors(work); //                           particles in proportion to w            section 3.1
    }
    sample(setup, state, work); //                           s ~ N(μ_s, Σ_s)                         proposal
    correct(setup, state, work, scan, info); //              μ += K ν, Σ = (I − K G) Σ; g⁻¹(z, s)    eq. 17
    remember(setup, state, work, scan); //                   n, for draws of whole paths
    judge(setup, state, work, scan, info); //                τ += Δτ                                 eq. 22
    Ok(())
}

/// FastSLAM 1.0 after its poses were sampled, where sightings name their landmarks.
///
/// **Source:** `montemerlo2002fastslam`, sections 3.1 and 3.2. **Why:** the correction of a landmark says how likely its
/// sighting was, so that one pass over the maps does what [`step`] needs two for.
pub(super) fn step_fused<M: Placing>(
    setup: &Setup<M>,
    state: &mut State,
    work: &mut Work,
    scan: &[ScanSighting],
    info: &mut StepInfo,
) -> Result<()> {
    list_named(&state.landmarks, scan, &mut work.associating.named);
    examine(setup, state, work, scan); //                    ν against what all particles expect
    place_sensors(setup, state, work);
    clear_log_likelihood(state, work);
    correct(setup, state, work, scan, info); //              μ += K ν, Σ = (I − K G) Σ; g⁻¹(z, s)    section 3.2
    weigh(setup, state, &work.log_likelihood, info)?; //     w ∝ N(z; ẑ, Q)                          section 3.2
    estimate_particles(state); //                            mean and covariance of the samples
    resample(setup, state, work, info); //                   particles in proportion to w            section 3.1
    state.counters.samplings += 1;
    remember(setup, state, work, scan); //                   n, for draws of whole paths
    Ok(())
}
