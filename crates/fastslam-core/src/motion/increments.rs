//! Displacements with constant noise.

use super::settings::variance_of;
use super::{twist_of, ControlTiming, Correction, MotionModel, Proportional, RowMotion};
use crate::error::{non_negative, Result};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Measured displacements with the same noise on every row, as in pose graphs.
///
/// **Control:** (dx in m, dy in m, dheading in rad): the pose now in the frame of the pose at the previous row.
/// The noise is that of the whole row in that frame, independent in the three; what a part of a row has of it is said
/// by [`RowMotion::reaching`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Increments {
    /// Standard deviation of dx per row.
    pub x_std_m: f64,
    /// Standard deviation of dy per row.
    pub y_std_m: f64,
    /// Standard deviation of dheading per row.
    pub heading_std_rad: f64,
    /// Systematic errors of the odometry.
    pub correction: Correction,
    /// Noise in proportion to what was driven and turned, beside the constant noise.
    pub proportional: Proportional,
}

impl Default for Increments {
    fn default() -> Self {
        Self {
            x_std_m: 0.02,
            y_std_m: 0.02,
            heading_std_rad: 0.01,
            correction: Correction::default(),
            proportional: Proportional::default(),
        }
    }
}

impl MotionModel for Increments {
    fn timing(&self) -> ControlTiming {
        ControlTiming::Increment
    }

    fn row(&self, control: [f64; 3], row_s: f64) -> RowMotion {
        let twist = self.correction.truth_of(twist_of(control), row_s);
        let stds = [self.x_std_m, self.y_std_m, self.heading_std_rad];
        let stated = [0, 1, 2].map(|i| variance_of(i, stds[i] * stds[i]));
        RowMotion::reaching(twist, stated, 2).adding(self.proportional.variances(twist))
    }

    fn validate(&self) -> Result<()> {
        self.correction.validate()?;
        self.proportional.validate()?;
        self.proportional.or_positive("x_std_m", self.x_std_m)?;
        non_negative("y_std_m", self.y_std_m)?;
        non_negative("heading_std_rad", self.heading_std_rad)?;
        Ok(())
    }
}
