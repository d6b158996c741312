//! Displacements with constant noise.

use super::{ConditionedControl, ControlTiming, MotionModel};
use crate::error::{non_negative, positive, Result};
use crate::geometry::Pose;
use crate::real::Real;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Measured displacements with the same noise on every row, as in pose graphs.
///
/// **Control:** (dx in m, dy in m, dheading in rad): the pose now in the frame of the pose at the previous row.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Increments {
    /// Standard deviation of dx per row.
    pub x_std_m: f64,
    /// Standard deviation of dy per row.
    pub y_std_m: f64,
    /// Standard deviation of dheading per row.
    pub heading_std_rad: f64,
}

impl Default for Increments {
    fn default() -> Self {
        Self { x_std_m: 0.02, y_std_m: 0.02, heading_std_rad: 0.01 }
    }
}

impl MotionModel for Increments {
    fn timing(&self) -> ControlTiming {
        ControlTiming::Increment
    }

    fn condition(&self, control: [f64; 3], dt_s: f64) -> ConditionedControl {
        ConditionedControl { mean: control, std: [self.x_std_m, self.y_std_m, self.heading_std_rad], dt_s }
    }

    #[inline(always)]
    fn relative_motion<R: Real>(&self, [x, y, heading]: [R; 3], _dt_s: f64) -> Pose<R> {
        Pose::new(x, y, heading)
    }

    fn validate(&self) -> Result<()> {
        positive("x_std_m", self.x_std_m)?;
        non_negative("y_std_m", self.y_std_m)?;
        non_negative("heading_std_rad", self.heading_std_rad)?;
        Ok(())
    }
}
