//! Where the robot may be before a scan is looked at: the motion model.

use super::beliefs::Beliefs;
use super::particles::Particles;
use super::settings::Algorithm;
use super::setup::Setup;
use super::state::State;
use crate::association::ScanSighting;
use crate::error::Result;
use crate::motion::{PoseColumns, RowPart};
use crate::random::Purpose;
use crate::workers::PART;

/// Moves the robot by a row of odometry, or a part of it: FastSLAM 1.0 samples every particle's pose, 2.0 keeps the
/// motion as a Gaussian.
///
/// **Source:** `montemerlo2002fastslam`, eq. 2.
pub(super) fn advance<M>(setup: &Setup<M>, state: &mut State, part: &RowPart) -> Result<()> {
    let (motion, by_noise) = setup.settings.config.motion.with_noises(part)?;
    match setup.settings.config.algorithm {
        Algorithm::Fastslam1 => {
            let stream = setup.settings.random.stream(Purpose::Motion, state.counters.controls);
            let Particles { x, y, heading, .. } = &mut state.particles;
            let whole = [x, y, heading].map(Vec::as_mut_slice);
            setup.workers.share(whole, PART, &|first, [x, y, heading]| {
                let first_particle = first as u32;
                motion.sample(stream, PoseColumns { first_particle, x, y, heading });
            });
        }
        _ => state.motions.pending = state.motions.pending.then(&motion).checked(part)?,
    }
    state.motions.since_scan = state.motions.since_scan.then(&by_noise);
    if let Some(rejuvenation) = &mut state.rejuvenation {
        rejuvenation.history.moved(&motion);
    }
    state.counters.controls += 1;
    Ok(())
}

/// What each particle believes about the robot's pose before the scan.
pub(super) fn propose<M>(setup: &Setup<M>, state: &State, beliefs: &mut Beliefs) {
    let Particles { x, y, heading, .. } = &state.particles;
    match setup.settings.config.algorithm {
        Algorithm::Fastslam1 => beliefs.certain(x, y, heading),
        _ => beliefs.predict(x, y, heading, &state.motions.pending),
    }
}

/// Whether a step without sightings leaves the poses unsampled: later sightings may still say where they were.
pub(super) fn keeps_motion_pending<M>(setup: &Setup<M>, state: &State, scan: &[ScanSighting]) -> bool {
    setup.settings.config.algorithm == Algorithm::Fastslam2
        && scan.is_empty()
        && state.motions.pending.can_be_linearised_on()
}
