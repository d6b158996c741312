//! Distance and direction of a landmark.

use super::{Component, Linearization, MeasurementModel, Placing, SystematicError};
use crate::geometry::{Pose, Symmetric2};
use crate::normal::Matrix;
use crate::real::Real;
use serde::Serialize;

/// Range and bearing.
///
/// **Measurement:** (range in m, bearing in rad, counter-clockwise from the sensor's heading).
/// **Source:** `montemerlo2002fastslam`, section 4; g = [r, wrap(atan2(dy, dx) − heading)].
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct RangeBearing {
    /// Standard deviation of the range.
    pub range_std_m: f64,
    /// Standard deviation of the bearing.
    pub bearing_std_rad: f64,
}

impl MeasurementModel<2, 2> for RangeBearing {
    #[inline(always)]
    fn expected<R: Real>(&self, T_world_sensor: Pose<R>, landmark_in_world: [R; 2]) -> [R; 2] {
        let dx = landmark_in_world[0] - T_world_sensor.x;
        let dy = landmark_in_world[1] - T_world_sensor.y;
        [(dx * dx + dy * dy).sqrt(), (R::atan2(dy, dx) - T_world_sensor.heading).wrap_angle()]
    }

    #[inline(always)]
    fn innovation<R: Real>(&self, measured: [R; 2], expected: [R; 2]) -> [R; 2] {
        [measured[0] - expected[0], (measured[1] - expected[1]).wrap_angle()]
    }

    #[inline(always)]
    fn noise(&self) -> Matrix<2, 2> {
        [[self.range_std_m * self.range_std_m, 0.0], [0.0, self.bearing_std_rad * self.bearing_std_rad]]
    }

    fn components(&self) -> [Component; 2] {
        [
            Component { name: "range", unit: "m", noise_key: "range_std_m" },
            Component { name: "bearing", unit: "rad", noise_key: "bearing_std_rad" },
        ]
    }

    #[inline(always)]
    fn linearize(&self, T_world_sensor: Pose, landmark_in_world: [f64; 2]) -> Linearization<2, 2> {
        let dx = landmark_in_world[0] - T_world_sensor.x;
        let dy = landmark_in_world[1] - T_world_sensor.y;
        // A landmark at the sensor itself: nothing follows from the sighting, and nothing is divided by zero.
        let q = dx * dx + dy * dy + f64::MIN_POSITIVE;
        let r = q.sqrt();
        let (ux, uy) = (dx / r, dy / r);
        let (vx, vy) = (-dy / q, dx / q);
        Linearization {
            expected: [r, (<f64 as Real>::atan2(dy, dx) - T_world_sensor.heading).wrap_angle()],
            by_landmark: [[ux, uy], [vx, vy]],
            by_pose: [[-ux, -uy, 0.0], [-vx, -vy, -1.0]],
        }
    }
}

impl Placing for RangeBearing {
    #[inline(always)]
    fn inverse<R: Real>(&self, T_world_sensor: Pose<R>, measured: [R; 2]) -> [R; 2] {
        let (s, c) = (T_world_sensor.heading + measured[1]).sin_cos();
        [T_world_sensor.x + measured[0] * c, T_world_sensor.y + measured[0] * s]
    }

    fn corrected(&self, reported: [f64; 2], error: &SystematicError) -> [f64; 2] {
        error.corrected(reported)
    }

    fn is_usable(&self, measured: [f64; 2]) -> bool {
        // Beyond some thousand turns rounding leaves nothing of an angle, and sine and cosine need not be in [-1, 1].
        measured[0].is_finite() && measured[1].abs() < 1e5
    }

    fn range(&self, measured: [f64; 2]) -> f64 {
        measured[0]
    }

    fn position_variance(&self, measured: [f64; 2], noise: Symmetric2) -> f64 {
        noise.xx + measured[0] * measured[0] * noise.yy
    }
}
