//! What a particle believes about the robot's pose, and how a sighting of a landmark refines that.

use crate::density::{Fit, Tail};
use crate::gaussian::{fit_with_tail, innovation_covariance, Gaussian, Inverse};
use crate::geometry::{Matrix3, Pose, Symmetric2};
use crate::math;
use crate::measurement::Placing;
use crate::normal::Matrix;
use crate::sighting::Measured;

/// What a particle believes about the robot's pose while it looks at a scan.
///
/// In FastSLAM 1.0 the pose is a sample and the covariance zero; in 2.0 it is the proposal, refined sighting by
/// sighting.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Belief {
    /// Mean of `T_world_robot`.
    pub mean: Pose,
    /// Covariance of (x, y, heading) in the world's axes.
    pub covariance: Matrix3,
}

/// A landmark as a particle sees it: innovation, how it depends on the pose, and how uncertain it is.
pub(crate) struct View {
    innovation: [f64; 2],
    by_pose: [[f64; 3]; 2],
    q: Symmetric2,
    noise: Symmetric2,
    tail: Tail,
}

impl View {
    /// How likely the sighting is when the pose is known.
    #[inline(always)]
    pub(crate) fn judge(&self) -> Fit {
        fit_with_tail(self.innovation, self.q, self.tail)
    }
}

/// G_s for the robot's pose: the sensor turns about the robot, so its lever arm enters.
#[inline(always)]
pub(crate) fn by_robot_pose<const Z: usize>(
    by_sensor: Matrix<Z, 3>,
    T_world_robot: Pose,
    T_world_sensor: Pose,
) -> Matrix<Z, 3> {
    let (ax, ay) = (T_world_sensor.x - T_world_robot.x, T_world_sensor.y - T_world_robot.y);
    // Not `map`: that is left a call within passes over particles, which then are no vector code.
    let mut by_robot = by_sensor;
    for row in &mut by_robot {
        let [x, y, h] = *row;
        row[2] = h - ay * x + ax * y;
    }
    by_robot
}

impl Belief {
    /// A landmark as this belief, which has the sensor there, sees it.
    #[inline(always)]
    pub(crate) fn view<M: Placing>(&self, model: &M, sensor: Pose, landmark: &Gaussian, measured: &Measured) -> View {
        let linear = model.linearize(sensor, landmark.mean);
        View {
            innovation: model.innovation(measured.value, linear.expected),
            by_pose: by_robot_pose(linear.by_pose, self.mean, sensor),
            q: innovation_covariance(linear.by_landmark, landmark.covariance, measured.noise),
            noise: measured.noise,
            tail: measured.tail,
        }
    }

    /// P G_sᵀ, one row per component of the pose.
    #[inline(always)]
    fn cross(&self, by_pose: &[[f64; 3]; 2]) -> [[f64; 2]; 3] {
        let [row0, row1, row2] = &self.covariance;
        let [g0, g1] = by_pose;
        [[dot3(row0, g0), dot3(row0, g1)], [dot3(row1, g0), dot3(row1, g1)], [dot3(row2, g0), dot3(row2, g1)]]
    }

    /// L = G_s P G_sᵀ + Q.
    #[inline(always)]
    fn total_covariance(cross: &[[f64; 2]; 3], view: &View) -> Symmetric2 {
        let [g0, g1] = &view.by_pose;
        let [[a0, b0], [a1, b1], [a2, b2]] = *cross;
        let (first, second) = ([a0, a1, a2], [b0, b1, b2]);
        Symmetric2::new(dot3(g0, &first) + view.q.xx, dot3(g0, &second) + view.q.xy, dot3(g1, &second) + view.q.yy)
    }

    /// How likely the sighting is under this belief, with the pose's uncertainty.
    #[inline(always)]
    pub(crate) fn judge(&self, view: &View) -> Fit {
        let cross = self.cross(&view.by_pose);
        fit_with_tail(view.innovation, Self::total_covariance(&cross, view), view.tail)
    }

    /// How well a sighting of a landmark fits.
    #[inline(always)]
    pub fn fit<M: Placing>(&self, model: &M, T_robot_sensor: Pose, landmark: &Gaussian, measured: &Measured) -> Fit {
        self.judge(&self.view(model, self.mean.compose(T_robot_sensor), landmark, measured))
    }

    /// The belief after a sighting of a landmark, and how well it fitted.
    ///
    /// **Source:** `montemerlo2003fastslam`, eqs. 9–15, in gain form, which holds for a singular P: K = P G_sᵀ L⁻¹,
    /// μ ← μ + K ν, P ← P − K L Kᵀ.
    #[inline(always)]
    pub(crate) fn refined(&self, view: &View) -> (Self, Fit) {
        let cross = self.cross(&view.by_pose);
        let plain = Self::total_covariance(&cross, view);
        let fitted = fit_with_tail(view.innovation, plain, view.tail);
        let more = view.noise.scaled(view.tail.noise_scale(fitted.mahalanobis_squared) - 1.0);
        let l = Symmetric2::new(plain.xx + more.xx, plain.xy + more.xy, plain.yy + more.yy);
        let inverse = Inverse::of(l);
        let [c0, c1, c2] = cross;
        let (k0, k1, k2) = (inverse.times(c0), inverse.times(c1), inverse.times(c2));
        // K Lᵀ Kᵀ is K crossᵀ; the mean of both halves keeps it symmetric to the bit.
        let less = |a: [f64; 2], b: [f64; 2], ca: [f64; 2], cb: [f64; 2]| 0.5 * (dot2(a, cb) + dot2(b, ca));
        let [[xx, xy, xh], [_, yy, yh], [_, _, hh]] = self.covariance;
        let (xx, xy, xh) = (xx - dot2(k0, c0), xy - less(k0, k1, c0, c1), xh - less(k0, k2, c0, c2));
        let (yy, yh, hh) = (yy - dot2(k1, c1), yh - less(k1, k2, c1, c2), hh - dot2(k2, c2));
        let covariance = [[xx, xy, xh], [xy, yy, yh], [xh, yh, hh]];
        let mean = Pose::new(
            self.mean.x + dot2(k0, view.innovation),
            self.mean.y + dot2(k1, view.innovation),
            math::wrap_angle(self.mean.heading + dot2(k2, view.innovation)),
        );
        (Self { mean, covariance }, fitted)
    }

    /// Refines by a sighting of a known landmark and gives the log-likelihood of the sighting.
    #[inline(always)]
    pub fn refine<M: Placing>(
        &mut self,
        model: &M,
        T_robot_sensor: Pose,
        landmark: &Gaussian,
        measured: &Measured,
    ) -> Fit {
        let view = self.view(model, self.mean.compose(T_robot_sensor), landmark, measured);
        let (refined, fit) = self.refined(&view);
        *self = refined;
        fit
    }
}

#[inline(always)]
fn dot3(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[inline(always)]
fn dot2(a: [f64; 2], b: [f64; 2]) -> f64 {
    a[0] * b[0] + a[1] * b[1]
}
