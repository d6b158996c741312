//! Particles in proportion to their weights.

use super::setup::Setup;
use super::state::State;
use super::work::Work;
use super::StepInfo;
use crate::random::Purpose;

/// Resamples if the effective sample size says so; everything of the state that belongs to a particle follows its
/// ancestor.
///
/// The weights must have been normalised. Returns whether it resampled.
pub(super) fn resample<M>(setup: &Setup<M>, state: &mut State, work: &mut Work, info: &mut StepInfo) -> bool {
    let count = state.particles.len();
    let settings = &setup.settings.config.filter;
    // Without sightings the weights are what they were, but for rounding.
    if info.sightings == 0 || !state.weights.are_uneven(settings.resampling.threshold) {
        return false;
    }
    let stream = setup.settings.random.stream(Purpose::Resampling, state.counters.samplings);
    let Work { resampler, ancestor_indices, .. } = work;
    let scheme = settings.resampling.scheme;
    resampler.draw(scheme, &state.weights.values, count, stream, ancestor_indices);
    let enough = settings.adaptive.count(&state.particles, ancestor_indices, settings.particles as usize);
    if enough != count {
        resampler.draw(scheme, &state.weights.values, enough, stream, ancestor_indices);
    }
    let State { particles, landmarks, path, rejuvenation, weights, .. } = state;
    setup.workers.both(
        count,
        || path.resample(ancestor_indices),
        || {
            particles.resample(ancestor_indices);
            landmarks.resample(ancestor_indices);
        },
    );
    if let Some(rejuvenation) = rejuvenation {
        rejuvenation.history.resample(ancestor_indices);
        rejuvenation.errors.resample(ancestor_indices);
    }
    weights.restart(enough);
    work.log_likelihood.resize(enough, 0.0);
    info.weighing.resampled = true;
    true
}

/// What the particles believe and decided about the scan follows their ancestors as well.
pub(super) fn follow_ancestors(work: &mut Work) {
    let Work { beliefs, associating, ancestor_indices, .. } = work;
    let share = associating.decisions.len() / beliefs.len();
    beliefs.resample(ancestor_indices);
    std::mem::swap(&mut associating.former_decisions, &mut associating.decisions);
    associating.decisions.clear();
    for &a in &*ancestor_indices {
        associating.decisions.extend_from_slice(&associating.former_decisions[a as usize * share..][..share]);
    }
}
