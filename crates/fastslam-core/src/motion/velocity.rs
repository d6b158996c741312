//! Forward speed and yaw rate.

use super::settings::{integrated, validate_period, variance_of};
use super::{ControlTiming, Correction, MotionModel, Proportional, RowMotion};
use crate::error::{non_negative, Result};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Motion on the arc that constant forward speed and yaw rate make.
///
/// **Control:** (speed in m/s, yaw rate in rad/s), held until the next row.
/// **Source:** `thrun2005probabilistic`, section 5.3, with independent noise on both.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Velocity {
    /// Standard deviation of the speed.
    pub speed_std_m_per_s: f64,
    /// Standard deviation of the yaw rate.
    pub yaw_rate_std_rad_per_s: f64,
    /// Standard deviation of sideways slip. Without it the robot can only move where it heads, and a wheel that is not
    /// quite straight turns the estimated heading instead.
    pub lateral_std_m_per_s: f64,
    /// The standard deviations belong to a control held this long, and shrink with the root of a longer time (white
    /// noise). Without it they belong to each row, however long it lasts.
    pub noise_period_s: Option<f64>,
    /// Systematic errors of the odometry.
    pub correction: Correction,
    /// Noise in proportion to what was driven and turned, beside the constant noise.
    pub proportional: Proportional,
}

impl Default for Velocity {
    fn default() -> Self {
        Self {
            speed_std_m_per_s: 0.1,
            yaw_rate_std_rad_per_s: 0.05,
            lateral_std_m_per_s: 0.0,
            noise_period_s: None,
            correction: Correction::default(),
            proportional: Proportional::default(),
        }
    }
}

impl MotionModel for Velocity {
    fn timing(&self) -> ControlTiming {
        ControlTiming::Held
    }

    fn row(&self, control: [f64; 3], row_s: f64) -> RowMotion {
        let twist = self.correction.truth_of([control[0] * row_s, 0.0, control[1] * row_s], row_s);
        let gathered = integrated(self.noise_period_s, row_s);
        let noise = |coordinate, std: f64| variance_of(coordinate, std * std * gathered);
        let by_noise = [
            noise(0, self.speed_std_m_per_s),
            noise(2, self.yaw_rate_std_rad_per_s),
            noise(1, self.lateral_std_m_per_s),
        ];
        RowMotion::new(twist, by_noise).adding(self.proportional.variances(twist))
    }

    fn validate(&self) -> Result<()> {
        self.correction.validate()?;
        self.proportional.validate()?;
        self.proportional.or_positive("speed_std_m_per_s", self.speed_std_m_per_s)?;
        non_negative("yaw_rate_std_rad_per_s", self.yaw_rate_std_rad_per_s)?;
        non_negative("lateral_std_m_per_s", self.lateral_std_m_per_s)?;
        validate_period(self.noise_period_s)
    }
}
