//! Settings that every motion model shares: systematic errors, and noise in proportion to the motion.

use crate::error::{finite, non_negative, non_zero, positive, Result};
use crate::geometry::Matrix3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Systematic errors of the odometry: what was truly driven, from what it reports.
///
/// The truth is the gain times what is reported, plus the bias; noise is that of the truth.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Correction {
    /// True speed or distance per reported one: 1.05 where the wheels are 5 % larger than the odometry thinks.
    pub distance_gain: f64,
    /// True turn or yaw rate per reported one; -1 where the odometry turns the other way.
    pub turn_gain: f64,
    /// Added to the yaw rate after the gain, as long as a row lasts: the bias of a gyroscope with its sign turned.
    pub yaw_rate_bias_rad_per_s: f64,
}

impl Default for Correction {
    fn default() -> Self {
        Self { distance_gain: 1.0, turn_gain: 1.0, yaw_rate_bias_rad_per_s: 0.0 }
    }
}

impl Correction {
    /// What was driven (forward, left, turn) in `row_s`, from what was reported.
    pub fn truth_of(&self, [forward, left, turn]: [f64; 3], row_s: f64) -> [f64; 3] {
        let turned = self.turn_gain * turn + self.yaw_rate_bias_rad_per_s * row_s;
        [self.distance_gain * forward, self.distance_gain * left, turned]
    }

    /// The inverse of [`Self::truth_of`].
    pub fn report_of(&self, [forward, left, turn]: [f64; 3], row_s: f64) -> [f64; 3] {
        let turned = (turn - self.yaw_rate_bias_rad_per_s * row_s) / self.turn_gain;
        [forward / self.distance_gain, left / self.distance_gain, turned]
    }

    pub(super) fn validate(&self) -> Result<()> {
        non_zero("correction.distance_gain", self.distance_gain)?;
        non_zero("correction.turn_gain", self.turn_gain)?;
        finite("correction.yaw_rate_bias_rad_per_s", self.yaw_rate_bias_rad_per_s).map(drop)
    }
}

/// Noise that grows with what was driven and turned, beside the noise that grows with time or rows.
///
/// A standard deviation of s per root metre is s after one metre and 2 s after four: the variances of parts add up.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Proportional {
    /// Standard deviation of the way ahead after one metre.
    pub distance_std_m_per_sqrt_m: f64,
    /// Standard deviation of the way aside after one metre.
    pub lateral_std_m_per_sqrt_m: f64,
    /// Standard deviation of the heading after one metre.
    pub turn_std_rad_per_sqrt_m: f64,
    /// Standard deviation of the heading after a turn of one radian.
    pub turn_std_rad_per_sqrt_rad: f64,
}

impl Proportional {
    /// Variances (forward, left, turn) that a row with this twist gathers.
    pub fn variances(&self, [forward, left, turn]: [f64; 3]) -> [f64; 3] {
        let distance = (forward * forward + left * left).sqrt();
        let [ahead, aside, by_way, by_turn] = self.stds().map(|std| std * std);
        [ahead * distance, aside * distance, by_way * distance + by_turn * turn.abs()]
    }

    fn stds(&self) -> [f64; 4] {
        let Self {
            distance_std_m_per_sqrt_m,
            lateral_std_m_per_sqrt_m,
            turn_std_rad_per_sqrt_m,
            turn_std_rad_per_sqrt_rad,
        } = *self;
        [distance_std_m_per_sqrt_m, lateral_std_m_per_sqrt_m, turn_std_rad_per_sqrt_m, turn_std_rad_per_sqrt_rad]
    }

    pub(super) fn validate(&self) -> Result<()> {
        let keys = [
            "distance_std_m_per_sqrt_m",
            "lateral_std_m_per_sqrt_m",
            "turn_std_rad_per_sqrt_m",
            "turn_std_rad_per_sqrt_rad",
        ];
        keys.into_iter()
            .zip(self.stds())
            .try_for_each(|(key, std)| non_negative(&format!("proportional.{key}"), std).map(drop))
    }

    /// `value` of the constant noise: above 0, unless the way ahead has noise of its own in proportion.
    pub(super) fn or_positive(&self, key: &str, value: f64) -> Result<f64> {
        if self.distance_std_m_per_sqrt_m > 0.0 {
            non_negative(key, value)
        } else {
            positive(key, value)
        }
    }
}

/// The period must be positive where one is given.
pub(super) fn validate_period(period_s: Option<f64>) -> Result<()> {
    period_s.map_or(Ok(()), |value| positive("noise_period_s", value).map(drop))
}

/// What a variance of a rate becomes as the variance of its integral over a row, when it is that of a mean over
/// `period_s`: white noise. Without a period it is that of the mean over the row, however long it lasts.
pub(super) fn integrated(period_s: Option<f64>, row_s: f64) -> f64 {
    period_s.unwrap_or(row_s) * row_s
}

/// A covariance of one coordinate alone.
pub(super) fn variance_of(coordinate: usize, variance: f64) -> Matrix3 {
    let mut covariance = Matrix3::default();
    covariance[coordinate][coordinate] = variance;
    covariance
}
