//! Poses from what the particles believe.

use super::correct::place_sensors;
use super::particles::Particles;
use super::settings::Algorithm;
use super::setup::Setup;
use super::state::State;
use super::work::Work;
use crate::motion::MotionGaussian;
use crate::random::Purpose;
use crate::workers::PART;

/// Draws every particle's pose from its belief; in FastSLAM 1.0 it is there already.
pub(super) fn sample<M>(setup: &Setup<M>, state: &mut State, work: &mut Work) {
    if setup.settings.config.algorithm == Algorithm::Fastslam2 {
        let stream = setup.settings.random.stream(Purpose::Proposal, state.counters.samplings);
        let Particles { x, y, heading, .. } = &mut state.particles;
        let (beliefs, whole) = (&work.beliefs, [x, y, heading].map(Vec::as_mut_slice));
        setup.workers.share(whole, PART, &|first, poses| beliefs.sample(stream, first, poses));
        state.motions.pending = MotionGaussian::default();
    }
    state.counters.samplings += 1;
    place_sensors(setup, state, work);
}
