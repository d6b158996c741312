//! Where Gauss–Newton begins: near the mode, whatever the particle that it comes from looks like.

use super::graph::{Graph, Known, Sights, Solution};
use super::history::{History, Trajectory};
use crate::gaussian::Inverse;
use crate::geometry::{Pose, Symmetric2};
use crate::measurement::Placing;

/// Gauss–Newton steps for a landmark given the path.
const STEPS: usize = 2;

impl Trajectory {
    /// A particle's path whose poses before a step are those of the mode when all paths were drawn, and from that step on
    /// its own draw: the later part moved as one so that the step in between is what odometry says.
    ///
    /// **Why:** a draw lies metres from the mode after a long way. As one jump between two poses this costs 10⁵ nats, and
    /// half of all steps of Gauss–Newton are needed to spread it over the way.
    pub fn joined(start: Pose, mut poses: Vec<Pose>, drawn: Option<usize>, history: &History) -> Self {
        if let Some(step) = drawn.filter(|step| *step < poses.len()) {
            let before = step.checked_sub(1).map_or(start, |previous| poses[previous]);
            let moved = before.compose(history.motion(step).mean).compose(poses[step].inverse());
            poses[step..].iter_mut().for_each(|pose| *pose = moved.compose(*pose));
        }
        Self { start, poses }
    }
}

impl<M: Placing> Graph<'_, M> {
    /// This path, and every landmark where the sightings from it say; those without a sighting stay where they are thought
    /// to be.
    pub fn guess(&self, trajectory: Trajectory, thought: impl Fn(&Sights) -> [f64; 2]) -> Solution {
        let place = |sights: &Sights| self.seen_at(sights, &trajectory).unwrap_or_else(|| thought(sights));
        let landmarks = self.landmarks.iter().map(place).collect();
        Solution { trajectory, landmarks }
    }

    /// Where a landmark lies by its sightings from a path; `None` where they do not say it, or where it is known for good.
    fn seen_at(&self, sights: &Sights, trajectory: &Trajectory) -> Option<[f64; 2]> {
        let first = sights.seen.iter().find(|seen| self.model(seen.step as usize).places());
        let first = first.filter(|_| !matches!(sights.known, Known::Place(_)))?;
        let sensor = trajectory.poses[first.step as usize].compose(self.T_robot_sensor(first.step as usize));
        let mut at = self.model(first.step as usize).inverse(sensor, self.history.sighting(first.sighting).value);
        for _ in 0..STEPS {
            let [mut xx, mut xy, mut yy, mut x, mut y] = sights.known.information(at);
            for seen in &sights.seen {
                let view = self.view(trajectory, (at, &sights.known), seen);
                let [[w00, w01], [_, w11]] = view.weight;
                let [[g00, g01], [g10, g11]] = view.by_landmark;
                let (p00, p01) = (w00 * g00 + w01 * g10, w01 * g00 + w11 * g10);
                let (p10, p11) = (w00 * g01 + w01 * g11, w01 * g01 + w11 * g11);
                (xx, xy, yy) = (xx + p00 * g00 + p01 * g10, xy + p00 * g01 + p01 * g11, yy + p10 * g01 + p11 * g11);
                x += p00 * view.innovation[0] + p01 * view.innovation[1];
                y += p10 * view.innovation[0] + p11 * view.innovation[1];
            }
            let step = Inverse::of(Symmetric2::new(xx, xy, yy)).times([x, y]);
            at = [at[0] + step[0], at[1] + step[1]];
        }
        at.iter().all(|v| v.is_finite()).then_some(at)
    }
}

#[cfg(test)]
mod tests {
    use super::super::graph::by_landmark;
    use super::*;
    use crate::landmark::{Measured, Tail};
    use crate::measurement::{MeasurementModel, RangeBearing};
    use crate::motion::MotionGaussian;
    use crate::smoothing::Effort;

    const MODEL: RangeBearing = RangeBearing { range_std_m: 0.1, bearing_std_rad: 0.01 };
    const STEPS: usize = 40;

    /// A straight way of a metre a step with no play across, told as it is, past one landmark that is seen at the
    /// beginning and at the end; `bend` is what the headings have turned by on the way, unknown to odometry.
    fn straight_way(bend: f64) -> (History, Vec<Sights>, Trajectory) {
        let mut history = History::new(1);
        let told = MotionGaussian {
            mean: Pose::new(1.0, 0.0, 0.0),
            covariance: [[1e-4, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 1e-4]],
        };
        let (mut truth, mut dead, mut poses) = (Pose::default(), Pose::default(), Vec::new());
        for step in 0..STEPS {
            history.moved(&told);
            truth = truth.compose(Pose::new(1.0, 0.0, bend / STEPS as f64));
            dead = dead.compose(told.mean);
            poses.push(dead);
            if !(2..STEPS - 2).contains(&step) {
                let value = MODEL.expected(truth, [20.0, 15.0]);
                let noise = MODEL.noise_covariance();
                history.explained_alike([Measured { value, noise, tail: Tail::Gaussian }].into_iter(), &[0]);
            }
            history.step_done(0);
        }
        let sights = by_landmark(&history.seen_by(0), |_| true);
        (history, sights, Trajectory { start: Pose::default(), poses })
    }

    #[test]
    fn a_draw_joins_the_path_before_it_as_odometry_says_and_keeps_its_shape() {
        let (history, _, path) = straight_way(0.0);
        let mut poses = path.poses.clone();
        let off = Pose::new(3.0, -2.0, 0.4);
        poses[10..].iter_mut().for_each(|pose| *pose = off.compose(*pose));
        let joined = Trajectory::joined(path.start, poses, Some(10), &history);
        for (pose, expected) in joined.poses.iter().zip(&path.poses) {
            let apart = [pose.x - expected.x, pose.y - expected.y, pose.heading - expected.heading];
            assert!(apart.iter().all(|d| d.abs() < 1e-9), "{pose:?} for {expected:?}");
        }
        let as_it_is = Trajectory::joined(path.start, path.poses.clone(), None, &history);
        assert_eq!(as_it_is.poses, path.poses);
    }

    #[test]
    fn a_landmark_is_guessed_where_the_path_saw_it() {
        let (history, mut sights, path) = straight_way(0.0);
        sights.push(Sights { birth: 7, known: Known::Nothing, seen: Vec::new() });
        let guess = Graph::over(&history, &MODEL, sights, &Effort::any()).guess(path, |_| [1.0, 2.0]);
        let [x, y] = guess.landmarks[0];
        assert!((x - 20.0).abs() < 1e-6 && (y - 15.0).abs() < 1e-6, "{x} {y}");
        assert_eq!(guess.landmarks[1], [1.0, 2.0]);
    }

    #[test]
    fn a_bend_that_stiff_wheels_hide_is_found() {
        // Steps along the valley of what the wheels allow would be a hundred: the first straight one leads uphill.
        let (history, sights, path) = straight_way(0.5);
        let effort = Effort::any();
        let graph = Graph::over(&history, &MODEL, sights, &effort);
        let mode = graph.solve(graph.guess(path, |_| [0.0, 0.0])).unwrap();
        let end = mode.solution.trajectory.poses[STEPS - 1];
        // The truth ends at a heading of 0.5; odometry errs by 0.5 over 40 steps of 0.01, which costs 31 nats.
        assert!((0.3..0.6).contains(&end.heading) && mode.cost < 31.25, "{end:?} {}", mode.cost);
    }
}
