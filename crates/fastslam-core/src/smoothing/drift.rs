//! How far dead reckoning may have drifted between any two steps, in constant time.
//!
//! An error in heading made at one step turns all that comes later about the place where it was made; errors of position
//! add up. Sums over the steps, of the variances and of the places that they turn about, give the covariance between any
//! two steps as a difference. To first order, and without what sightings know: an upper bound of what the robot's belief
//! about an old landmark has lost since it saw it last.

use crate::geometry::{Pose, Symmetric2};
use crate::math;
use crate::motion::MotionGaussian;
use serde::{Deserialize, Serialize};

/// Sums over all steps before one, about the first pose.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
struct Sums {
    /// Variance of the heading, rad².
    heading: f64,
    /// The same times the place (x, y), and times its products (xx, xy, yy).
    first: [f64; 2],
    second: [f64; 3],
    /// Covariance of the position in the world (xx, xy, yy), m².
    position: [f64; 3],
}

/// Dead reckoning along one path.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Drift {
    origin: Pose,
    last: Pose,
    /// One more than steps.
    sums: Vec<Sums>,
}

impl Drift {
    /// Of a path that starts here.
    pub fn new(start: Pose) -> Self {
        Self { origin: start, last: start, sums: vec![Sums::default()] }
    }

    /// Steps so far.
    pub fn steps(&self) -> usize {
        self.sums.len() - 1
    }

    /// Adds a step with a motion that led here.
    pub fn extend(&mut self, MotionGaussian { covariance, .. }: &MotionGaussian, after: Pose) {
        let Some(mut sums) = self.sums.last().copied() else { return };
        let (s, c) = math::sin_cos(self.last.heading);
        let body = Symmetric2::new(covariance[0][0], covariance[0][1], covariance[1][1]);
        let world = body.transformed([[c, -s], [s, c]]);
        let [x, y] = [after.x - self.origin.x, after.y - self.origin.y];
        let variance = covariance[2][2];
        sums.heading += variance;
        sums.first.iter_mut().zip([x, y]).for_each(|(sum, v)| *sum += variance * v);
        sums.second.iter_mut().zip([x * x, x * y, y * y]).for_each(|(sum, v)| *sum += variance * v);
        sums.position.iter_mut().zip([world.xx, world.xy, world.yy]).for_each(|(sum, v)| *sum += v);
        self.sums.push(sums);
        self.last = after;
    }

    /// Variance of the turn since a step, rad².
    pub fn of_heading(&self, since: usize) -> f64 {
        self.sums[self.steps()].heading - self.sums[(since + 1).min(self.steps())].heading
    }

    /// The covariance of where a place lies that the robot related to at step `since`, relative to the robot now (in
    /// the directions of the world), m².
    pub fn of_place(&self, place: [f64; 2], since: usize) -> Symmetric2 {
        let Some(&now) = self.sums.last() else { return Symmetric2::default() };
        let then = self.sums[(since + 1).min(self.steps())];
        let heading = now.heading - then.heading;
        let [fx, fy] = [0, 1].map(|i| now.first[i] - then.first[i]);
        let [sxx, sxy, syy] = [0, 1, 2].map(|i| now.second[i] - then.second[i]);
        let [pxx, pxy, pyy] = [0, 1, 2].map(|i| now.position[i] - then.position[i]);
        let [x, y] = [place[0] - self.origin.x, place[1] - self.origin.y];
        // Σ σ² (ℓ − p)(ℓ − p)ᵀ, turned by a right angle.
        let xx = (heading * x * x - 2.0 * x * fx + sxx).max(0.0);
        let xy = heading * x * y - x * fy - y * fx + sxy;
        let yy = (heading * y * y - 2.0 * y * fy + syy).max(0.0);
        Symmetric2::new(pxx + yy, pxy - xy, pyy + xx)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Purpose, RandomSource};

    #[test]
    fn it_is_the_covariance_of_simulated_dead_reckoning() {
        let steps = 60_usize;
        let mean = Pose::new(1.0, 0.05, 0.03);
        let covariance = [[4e-4, 1e-4, 0.0], [1e-4, 1e-4, 0.0], [0.0, 0.0, 9e-6]];
        let start = Pose::new(3.0, -2.0, 0.4);
        let (mut drift, mut pose) = (Drift::new(start), start);
        for _ in 0..steps {
            pose = pose.compose(mean);
            drift.extend(&MotionGaussian { mean, covariance }, pose);
        }
        let (since, place) = (20, [10.0, 20.0]);
        // The place as seen from the end of the path, when every motion since errs as told.
        let stream = RandomSource::new(3).stream(Purpose::Simulation, 0);
        let (trials, mut seen) = (4000_u32, Vec::new());
        let then = (0..=since).fold(start, |pose, _| pose.compose(mean));
        for trial in 0..trials {
            let mut erring = then;
            for step in since + 1..steps {
                let [a, b] = stream.normal_pair(trial, 2 * step as u32);
                let [turn, _] = stream.normal_pair(trial, 2 * step as u32 + 1);
                let (x, y) = (0.02 * a, 0.005 * a + (1e-4_f64 - 2.5e-5).sqrt() * b);
                erring = erring.compose(Pose::new(mean.x + x, mean.y + y, mean.heading + 0.003 * turn));
            }
            seen.push(pose.transform(erring.inverse().transform(place)));
        }
        let average = |of: &dyn Fn(&[f64; 2]) -> f64| seen.iter().map(of).sum::<f64>() / f64::from(trials);
        let (x, y) = (average(&|at| at[0]), average(&|at| at[1]));
        let sampled = [
            average(&|at| (at[0] - x).powi(2)),
            average(&|at| (at[0] - x) * (at[1] - y)),
            average(&|at| (at[1] - y).powi(2)),
        ];
        let told = drift.of_place(place, since);
        let scale = told.largest_eigenvalue();
        for (told, sampled) in [told.xx, told.xy, told.yy].into_iter().zip(sampled) {
            // Four standard errors of a sample covariance, 4 · sqrt(2 / 4000), and the second order.
            assert!((told - sampled).abs() < 0.12 * scale, "{told} against {sampled} of {scale}");
        }
        assert!(scale > 0.02, "{scale}: nothing drifts");
        assert_eq!(drift.of_place(place, steps - 1), Symmetric2::default());
    }
}
