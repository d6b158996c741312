//! Lets the imagined runs of `errors.rs` do what the filter does, and reports what they say of the pose.

use super::errors::{Linear, Shown};
use super::landmarks::Place;
use super::particles::{Particles, PoseEstimate};
use super::setup::Setup;
use super::state::State;
use super::work::Imagining;
use crate::belief::by_robot_pose;
use crate::geometry::{transform3, Matrix3, Pose};
use crate::math;
use crate::measurement::Placing;
use crate::motion::MotionGaussian;
use crate::random::{Purpose, Stream};
use crate::smoothing::{Drawn, Known, Sights};
use rustc_hash::FxHashMap;

/// The imagined runs move as the robot did, and see what it saw.
pub(super) fn imagine<M: Placing>(
    setup: &Setup<M>,
    state: &mut State,
    imagining: &mut Imagining,
    motion: &MotionGaussian,
) {
    let stream = stream_of(setup, state);
    let Imagining { shown, scan, noise } = imagining;
    let best = best_to_rounding(&state.particles);
    scan.clear();
    scan.extend(shown.iter().filter_map(|shown| linear(setup, state, best, shown)));
    let heading = state.estimate.mean.heading - motion.mean.heading;
    if let Some(rejuvenation) = &mut state.rejuvenation {
        rejuvenation.errors.moved(heading, motion, stream);
        rejuvenation.errors.sighted(scan, stream, noise);
    }
}

/// The particle that explains the log best; the first of those that differ by rounding.
fn best_to_rounding(particles: &Particles) -> usize {
    let highest = particles.score[particles.best()];
    let enough = highest - 1e-9 * (1.0 + highest.abs());
    particles.score.iter().position(|score| *score >= enough).unwrap_or(0)
}

/// A sighting, linearised where the best particle has robot and landmark; `None` where it has no such landmark.
fn linear<M: Placing>(setup: &Setup<M>, state: &State, best: usize, (slot, measured): &Shown) -> Option<Linear> {
    let (landmark, _) = state.landmarks.held_by(best, *slot)?;
    let robot = state.particles.pose(best);
    let sensor = robot.compose(setup.models.T_robot_sensor);
    let linear = setup.models.measurement().linearize(sensor, landmark.mean);
    let birth = state.landmarks.birth(*slot);
    Some(Linear {
        slot: *slot,
        birth,
        known: state.given.known(birth),
        by_pose: by_robot_pose(linear.by_pose, robot, sensor),
        by_landmark: linear.by_landmark,
        // An exponent says that so much of what sightings tell is told by others as well.
        noise: measured.noise.scaled(1.0 / setup.settings.config.filter.likelihood_exponent),
    })
}

/// The imagined runs start anew from draws of whole paths, which are spread by their posterior times the spread.
pub(super) fn imagine_drawn<M>(
    setup: &Setup<M>,
    state: &mut State,
    (landmarks, drawn): (&[Sights], &Drawn),
    places: &FxHashMap<u32, Place>,
) {
    let stream = stream_of(setup, state);
    let spread = setup.settings.config.filter.rejuvenation.spread;
    let Some(rejuvenation) = state.rejuvenation.as_mut().filter(|_| spread > 0.0) else { return };
    let (errors, count) = (&mut rejuvenation.errors, drawn.last_poses.len());
    let mean = mean_of(&drawn.last_poses);
    errors.pose_drawn(state.particles.len(), |m| difference(drawn.last_poses[m], mean).map(|error| error / spread));
    for (sights, gaussians) in landmarks.iter().zip(drawn.landmarks.chunks_exact(count)) {
        if sights.seen.is_empty() || matches!(sights.known, Known::Place(_)) {
            continue;
        }
        let mean = [0, 1].map(|k| gaussians.iter().map(|g| g.mean[k]).sum::<f64>() / count as f64);
        let named = (places[&sights.birth].0, u64::from(sights.birth));
        errors.place_drawn(named, gaussians[0].covariance, stream, |m| {
            [0, 1].map(|k| (gaussians[m].mean[k] - mean[k]) / spread)
        });
    }
}

/// Mean of poses that lie close together.
fn mean_of(poses: &[Pose]) -> Pose {
    let first = poses[0];
    let mean = |k: usize| poses.iter().map(|pose| difference(*pose, first)[k]).sum::<f64>() / poses.len() as f64;
    Pose::new(first.x + mean(0), first.y + mean(1), first.heading + mean(2))
}

fn difference(a: Pose, b: Pose) -> [f64; 3] {
    [a.x - b.x, a.y - b.y, math::wrap_angle(a.heading - b.heading)]
}

/// Reports the pose as uncertain as the imagined runs are wrong, and in no direction surer than the particles make it.
pub(super) fn report_errors(state: &mut State) {
    let Some(rejuvenation) = &mut state.rejuvenation else { return };
    let pending = rejuvenation.history.pending();
    let Some(covariance) = rejuvenation.errors.covariance(&state.weights.values) else { return };
    let heading = state.estimate.mean.heading - pending.mean.heading;
    let before = PoseEstimate { mean: Pose::new(0.0, 0.0, heading), covariance };
    let PoseEstimate { mean, covariance } = state.estimate;
    state.estimate.covariance = no_surer(mean.heading, &before.moved(pending).covariance, &covariance);
}

/// The first covariance, stretched along and across a heading and in the turn until no variance is below that of the second.
fn no_surer(heading: f64, first: &Matrix3, second: &Matrix3) -> Matrix3 {
    let (s, c) = math::sin_cos(heading);
    let (back, turn) = ([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]], [[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]);
    let [wide, least] = [first, second].map(|covariance| transform3(&back, covariance));
    if (0..3).any(|i| wide[i][i] <= 0.0) {
        return *second;
    }
    let stretch: [f64; 3] = std::array::from_fn(|i| (least[i][i] / wide[i][i]).max(1.0).sqrt());
    transform3(&turn, &std::array::from_fn(|i| std::array::from_fn(|k| stretch[i] * wide[i][k] * stretch[k])))
}

fn stream_of<M>(setup: &Setup<M>, state: &State) -> Stream {
    setup.settings.random.stream(Purpose::Errors, state.counters.samplings)
}
