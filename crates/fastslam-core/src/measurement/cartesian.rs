//! Position of a landmark in the sensor's frame.

use super::{Component, MeasurementModel, Placing};
use crate::geometry::{Pose, Symmetric2};
use crate::normal::Matrix;
use crate::real::Real;

/// A landmark's coordinates as the sensor sees them, with the same noise in both.
///
/// **Measurement:** (x ahead in m, y left in m). With a robot that never turns this is the linear world in which the
/// exact posterior is known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cartesian {
    /// Standard deviation of each coordinate.
    pub position_std_m: f64,
}

impl MeasurementModel<2, 2> for Cartesian {
    #[inline(always)]
    fn expected<R: Real>(&self, T_world_sensor: Pose<R>, landmark_in_world: [R; 2]) -> [R; 2] {
        let (s, c) = T_world_sensor.heading.sin_cos();
        let dx = landmark_in_world[0] - T_world_sensor.x;
        let dy = landmark_in_world[1] - T_world_sensor.y;
        [c * dx + s * dy, c * dy - s * dx]
    }

    #[inline(always)]
    fn innovation<R: Real>(&self, measured: [R; 2], expected: [R; 2]) -> [R; 2] {
        [measured[0] - expected[0], measured[1] - expected[1]]
    }

    #[inline(always)]
    fn noise(&self) -> Matrix<2, 2> {
        let variance = self.position_std_m * self.position_std_m;
        [[variance, 0.0], [0.0, variance]]
    }

    fn components(&self) -> [Component; 2] {
        ["x", "y"].map(|name| Component { name, unit: "m", noise_key: "position_std_m" })
    }
}

impl Placing for Cartesian {
    #[inline(always)]
    fn inverse<R: Real>(&self, T_world_sensor: Pose<R>, measured: [R; 2]) -> [R; 2] {
        T_world_sensor.transform(measured)
    }

    fn range(&self, measured: [f64; 2]) -> f64 {
        measured[0].hypot(measured[1])
    }

    fn position_variance(&self, _measured: [f64; 2], noise: Symmetric2) -> f64 {
        noise.xx + noise.yy
    }
}
