//! The particles: poses and weights as columns.

use crate::geometry::{moved_by, transform3, Matrix3, Pose};
use crate::math;
use crate::motion::MotionGaussian;
use crate::resampling::follow;
use crate::vector::sums;
use serde::{Deserialize, Serialize};

/// All particles, one number each per column.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Particles {
    /// Metres.
    pub x: Vec<f64>,
    /// Metres.
    pub y: Vec<f64>,
    /// Radians, wrapped.
    pub heading: Vec<f64>,
    /// Unnormalised, since the last resampling.
    pub log_weight: Vec<f64>,
    /// Log-weight gathered along the whole path: says which particle explains the log best.
    pub score: Vec<f64>,
    /// Landmarks in the particle's map.
    pub landmarks: Vec<u32>,
    /// Kept for its memory.
    #[serde(skip)]
    spare: (Vec<f64>, Vec<u32>),
}

impl Particles {
    /// `count` particles at one pose.
    pub fn at(pose: Pose, count: usize) -> Self {
        Self {
            x: vec![pose.x; count],
            y: vec![pose.y; count],
            heading: vec![pose.heading; count],
            log_weight: vec![0.0; count],
            score: vec![0.0; count],
            landmarks: vec![0; count],
            spare: (Vec::with_capacity(count), Vec::with_capacity(count)),
        }
    }

    /// Number of particles.
    pub fn len(&self) -> usize {
        self.x.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.x.is_empty()
    }

    /// `T_world_robot` of one particle.
    #[inline(always)]
    pub fn pose(&self, i: usize) -> Pose {
        Pose::new(self.x[i], self.y[i], self.heading[i])
    }

    /// Moves one particle.
    #[inline(always)]
    pub fn set_pose(&mut self, i: usize, pose: Pose) {
        (self.x[i], self.y[i], self.heading[i]) = (pose.x, pose.y, pose.heading);
    }

    /// Particle i becomes a copy of the former particle `ancestor_indices[i]`, with weight 1.
    pub fn resample(&mut self, ancestor_indices: &[u32]) {
        for column in [&mut self.x, &mut self.y, &mut self.heading, &mut self.score] {
            follow(column, ancestor_indices, &mut self.spare.0);
        }
        follow(&mut self.landmarks, ancestor_indices, &mut self.spare.1);
        self.log_weight.clear();
        self.log_weight.resize(ancestor_indices.len(), 0.0);
    }

    /// The particle that explains the log best once so much is added to what each has gathered.
    pub fn best_with(&self, increments: &[f64]) -> usize {
        let mut best = 0;
        for i in 1..self.len() {
            if self.score[i] + increments[i] > self.score[best] + increments[best] {
                best = i;
            }
        }
        best
    }

    /// The particle that explains the log best; ties go to the first.
    pub fn best(&self) -> usize {
        let mut best = 0;
        for i in 1..self.len() {
            if self.score[i] > self.score[best] {
                best = i;
            }
        }
        best
    }
}

/// Mean and covariance of the robot's pose over all particles.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PoseEstimate {
    /// Mean of `T_world_robot`; the heading is the direction of the mean unit vector.
    pub mean: Pose,
    /// Covariance of (x, y, heading): between particles plus, in FastSLAM 2.0, within them.
    pub covariance: Matrix3,
}

impl PoseEstimate {
    /// The pose after a motion that is independent of it, to first order.
    pub fn moved(&self, motion: &MotionGaussian) -> Self {
        let (mean, by_pose) = moved_by(self.mean, motion.mean);
        let old = transform3(&by_pose, &self.covariance);
        let noise = motion.covariance_in_world(self.mean.heading);
        let covariance = std::array::from_fn(|i| std::array::from_fn(|j| old[i][j] + noise[i][j]));
        Self { mean, covariance }
    }
}

/// The moments of a weighted mixture of Gaussians over poses, given as (mean, covariance).
///
/// **Why:** two passes, and headings through sine and cosine, so that neither large coordinates nor ±π hurt.
#[inline(always)]
pub fn mixture(weights: &[f64], component: impl Fn(usize) -> (Pose, Matrix3)) -> PoseEstimate {
    let n = weights.len();
    let [x, y, sine, cosine] = sums(
        n,
        #[inline(always)]
        |i| {
            let (weight, (pose, _)) = (weights[i], component(i));
            let (sine, cosine) = math::sin_cos(pose.heading);
            [weight * pose.x, weight * pose.y, weight * sine, weight * cosine]
        },
    );
    let mean = Pose::new(x, y, math::atan2(sine, cosine));
    let [xx, xy, xh, yy, yh, hh] = sums(
        n,
        #[inline(always)]
        |i| spread(weights[i], &component(i), &mean),
    );
    PoseEstimate { mean, covariance: [[xx, xy, xh], [xy, yy, yh], [xh, yh, hh]] }
}

/// What one Gaussian adds to the covariance of a mixture: xx, xy, xh, yy, yh, hh.
#[inline(always)]
fn spread(weight: f64, (pose, within): &(Pose, Matrix3), mean: &Pose) -> [f64; 6] {
    let (x, y, h) = (pose.x - mean.x, pose.y - mean.y, math::wrap_angle(pose.heading - mean.heading));
    let [[xx, xy, xh], [_, yy, yh], [_, _, hh]] = *within;
    [
        weight * (xx + x * x),
        weight * (xy + x * y),
        weight * (xh + x * h),
        weight * (yy + y * y),
        weight * (yh + y * h),
        weight * (hh + h * h),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn headings_near_pi_have_their_mean_near_pi() {
        let poses = [Pose::new(1.0, 0.0, 3.1), Pose::new(3.0, 0.0, -3.1)];
        let estimate = mixture(&[0.5, 0.5], |i| (poses[i], [[0.0; 3]; 3]));
        assert!((estimate.mean.heading.abs() - std::f64::consts::PI).abs() < 1e-12);
        assert!((estimate.mean.x - 2.0).abs() < 1e-15);
        // Half the gap of 2π - 6.2 between the headings, squared.
        let half_gap = std::f64::consts::PI - 3.1;
        assert!((estimate.covariance[2][2] - half_gap * half_gap).abs() < 1e-12);
        assert!((estimate.covariance[0][0] - 1.0).abs() < 1e-12);
    }

    #[test]
    fn the_mixture_adds_within_to_between() {
        let within = [[0.5, 0.1, 0.0], [0.1, 0.4, 0.0], [0.0, 0.0, 0.01]];
        let estimate = mixture(&[0.25, 0.75], |i| (Pose::new(4.0 * i as f64, 0.0, 0.0), within));
        assert!((estimate.mean.x - 3.0).abs() < 1e-15);
        assert!((estimate.covariance[0][0] - (0.5 + 3.0)).abs() < 1e-12);
        assert!((estimate.covariance[0][1] - 0.1).abs() < 1e-12);
    }
}
