//! Steps whose numbers are of ordinary size cannot make one that is none. Before any other step the state is kept, and
//! it comes back when the step fails or leaves a number that is none.

use super::rounds::{process_rounds, start_anew_with_weights, Rounds};
use super::setup::Setup;
use super::state::{Sizes, State};
use super::work::Work;
use super::StepInfo;
use crate::association::{Box2, ScanSighting};
use crate::error::{Error, Result};
use crate::geometry::Matrix3;
use crate::limits::{FARTHEST_M, LARGEST_NUMBER, LARGEST_STATE, LONGEST_M};
use crate::measurement::Placing;
use crate::sighting::Measured;
use crate::vector::vectorized;

/// Nearer than this a landmark and the sensor may be the same point, in doubles far from the origin.
const NEAREST_M: f64 = 1e-6;
/// Variances further apart than this leave little of the smaller one in a sum of doubles: an ellipse a million times
/// longer than wide.
const LARGEST_RATIO: f64 = 1e12;
/// A correlation nearer to 1 than this does the same.
const LEAST_INDEPENDENCE: f64 = 1e-6;

/// Takes in the rounds of a scan. What fails leaves an ordinary filter with equal weights
/// ([`start_anew_with_weights`]), which only a measurement model of one's own can bring about, and any other as it was.
pub(super) fn take_in<M: Placing>(
    setup: &Setup<M>,
    state: &mut State,
    work: &mut Work,
    scan: Rounds<'_>,
    info: &mut StepInfo,
) -> Result<()> {
    let sizes = sizes_with(setup, state, scan.rounds);
    if !sizes.was_exceeded {
        state.sizes = sizes;
        let done = process_rounds(setup, state, work, scan, info);
        if done.is_err() {
            start_anew_with_weights(setup, state, work);
        }
        return done;
    }
    let before = state.clone();
    state.sizes = sizes;
    let done = process_rounds(setup, state, work, scan, info).and_then(|()| check_numbers(state, info));
    if done.is_err() {
        *state = before;
    }
    done
}

/// The sizes with what a scan brings.
fn sizes_with<M: Placing>(setup: &Setup<M>, state: &State, rounds: &[Vec<ScanSighting>]) -> Sizes {
    let Sizes { mut coarsest_m2, was_exceeded } = state.sizes;
    let motion = &state.motions.pending;
    let mut finest_m2 = f64::INFINITY;
    let mut is_ordinary = !was_exceeded && are_near(state) && motion.mean.x.hypot(motion.mean.y) <= FARTHEST_M;
    for sighting in rounds.iter().flatten() {
        let range_m = setup.models.measurement().range(sighting.measured.value);
        let Some([fine, coarse]) = variances(&sighting.measured, range_m) else {
            is_ordinary = false;
            continue;
        };
        finest_m2 = finest_m2.min(fine);
        let reach_m = range_m + setup.models.lever_arm_m;
        coarsest_m2 = coarsest_m2.max(coarse).max(spread(&motion.covariance, reach_m));
        is_ordinary &= sighting.appearance.signature.is_none_or(|signature| signature.abs() <= LARGEST_NUMBER);
    }
    is_ordinary &= coarsest_m2 <= LARGEST_RATIO * finest_m2;
    Sizes { coarsest_m2, was_exceeded: !is_ordinary }
}

/// Whether all particles are where positions can be computed with.
fn are_near(state: &State) -> bool {
    let (x, n) = (&state.particles.x[..], state.particles.len());
    let y = &state.particles.y[..n];
    let Box2 { low, high } = vectorized(
        #[inline(always)]
        || {
            Box2::around(
                n,
                #[inline(always)]
                |i| ([x[i], y[i]], [x[i], y[i]]),
            )
        },
    );
    low.into_iter().chain(high).all(|value| value.abs() <= FARTHEST_M)
}

/// Errors unless every number of the state is one.
fn check_numbers(state: &mut State, info: &StepInfo) -> Result<()> {
    let is_number = |value: &f64| value.abs() <= LARGEST_STATE;
    let State { particles, weights, estimate, landmarks, .. } = state;
    let fault = |what| Err(Error::NotFinite { step: info.step, what });
    let poses = [&particles.x, &particles.y, &particles.heading];
    if !poses.into_iter().flatten().all(is_number) {
        return fault("the pose of a particle");
    }
    let mean = estimate.mean.to_array();
    if !mean.iter().chain(estimate.covariance.as_flattened()).all(is_number) {
        return fault("the pose");
    }
    let said = [&info.weighing.log_likelihood, &info.weighing.effective_sample_size];
    if !weights.values.iter().chain(said).all(|w| w.is_finite()) {
        return fault("a weight");
    }
    for slot in landmarks.live_slots() {
        if !landmarks.read(slot).is_within(LARGEST_STATE) {
            return fault("a landmark");
        }
    }
    Ok(())
}

/// The smallest and the largest variance that a sighting gives a place, square metres; `None` where it is no ordinary one.
fn variances(measured: &Measured, range_m: f64) -> Option<[f64; 2]> {
    let noise = measured.noise;
    let (along, across) = (noise.xx, range_m * range_m * noise.yy);
    let is_ordinary =
        (NEAREST_M..=LONGEST_M).contains(&range_m) && noise.determinant() >= LEAST_INDEPENDENCE * noise.xx * noise.yy;
    is_ordinary.then(|| [along.min(across), along.max(across)])
}

/// How uncertain a motion makes a place at this distance, square metres.
fn spread(covariance: &Matrix3, reach_m: f64) -> f64 {
    covariance[0][0] + covariance[1][1] + reach_m * reach_m * covariance[2][2]
}
