//! Forward speed and yaw rate.

use super::{validate_period, white_noise_std, ConditionedControl, ControlTiming, MotionModel};
use crate::error::{non_negative, positive, Result};
use crate::geometry::Pose;
use crate::real::Real;
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
}

impl Default for Velocity {
    fn default() -> Self {
        Self {
            speed_std_m_per_s: 0.1,
            yaw_rate_std_rad_per_s: 0.05,
            lateral_std_m_per_s: 0.0,
            noise_period_s: Some(0.1),
        }
    }
}

impl MotionModel for Velocity {
    fn timing(&self) -> ControlTiming {
        ControlTiming::Held
    }

    fn condition(&self, control: [f64; 3], dt_s: f64) -> ConditionedControl {
        let std = |value| white_noise_std(value, self.noise_period_s, dt_s);
        ConditionedControl {
            mean: [control[0], control[1], 0.0],
            std: [std(self.speed_std_m_per_s), std(self.yaw_rate_std_rad_per_s), std(self.lateral_std_m_per_s)],
            dt_s,
        }
    }

    #[inline(always)]
    fn relative_motion<R: Real>(&self, [speed, yaw_rate, lateral]: [R; 3], dt_s: f64) -> Pose<R> {
        let dt = R::constant(dt_s);
        Pose::from_twist(speed * dt, lateral * dt, yaw_rate * dt)
    }

    fn validate(&self) -> Result<()> {
        positive("speed_std_m_per_s", self.speed_std_m_per_s)?;
        non_negative("yaw_rate_std_rad_per_s", self.yaw_rate_std_rad_per_s)?;
        non_negative("lateral_std_m_per_s", self.lateral_std_m_per_s)?;
        validate_period(self.noise_period_s)
    }
}
