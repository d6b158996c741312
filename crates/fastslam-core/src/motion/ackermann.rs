//! A car with wheel speed and steering angle.

use super::{validate_period, white_noise_std, ConditionedControl, ControlTiming, MotionModel};
use crate::error::{finite, non_negative, positive, Error, Result};
use crate::geometry::Pose;
use crate::real::Real;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Motion of a point fixed on a car that steers with its front wheels.
///
/// The defaults are the geometry of the Victoria Park truck: the speed is measured at the rear left wheel, and the
/// pose is that of the laser.
///
/// **Control:** (encoder speed in m/s, steering angle in rad, left positive), held until the next row.
/// **Source:** `guivant2001optimization`; with v_c = v_e / (1 − (H/L) tan α) and ω = v_c tan α / L the laser's twist is
/// (v_c − ω b, ω a, ω).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Ackermann {
    /// Distance between the axles (L).
    pub wheelbase_m: f64,
    /// How far left of the rear axle's centre the speed is measured (H).
    pub encoder_left_m: f64,
    /// How far ahead of the rear axle the tracked point is (a).
    pub sensor_ahead_m: f64,
    /// How far left of the centre line the tracked point is (b).
    pub sensor_left_m: f64,
    /// Standard deviation of the speed.
    pub speed_std_m_per_s: f64,
    /// Standard deviation of the steering angle.
    pub steering_std_rad: f64,
    /// Standard deviation of sideways slip of the tracked point.
    pub lateral_std_m_per_s: f64,
    /// The standard deviations belong to a control held this long, and shrink with the root of a longer time (white
    /// noise). Without it they belong to each row, however long it lasts.
    pub noise_period_s: Option<f64>,
}

impl Default for Ackermann {
    fn default() -> Self {
        Self {
            wheelbase_m: 2.83,
            encoder_left_m: 0.76,
            sensor_ahead_m: 3.78,
            sensor_left_m: 0.5,
            speed_std_m_per_s: 1.0,
            steering_std_rad: 0.05,
            lateral_std_m_per_s: 0.0,
            noise_period_s: Some(0.025),
        }
    }
}

impl MotionModel for Ackermann {
    fn timing(&self) -> ControlTiming {
        ControlTiming::Held
    }

    fn condition(&self, control: [f64; 3], dt_s: f64) -> ConditionedControl {
        let std = |value| white_noise_std(value, self.noise_period_s, dt_s);
        ConditionedControl {
            mean: [control[0], control[1], 0.0],
            std: [std(self.speed_std_m_per_s), std(self.steering_std_rad), std(self.lateral_std_m_per_s)],
            dt_s,
        }
    }

    #[inline(always)]
    fn relative_motion<R: Real>(&self, [speed, steering, lateral]: [R; 3], dt_s: f64) -> Pose<R> {
        let constant = R::constant;
        let (sine, cosine) = steering.sin_cos();
        // v_c / cos α and ω, multiplied out so that a wheel turned by 90° needs no tangent.
        let denominator = constant(self.wheelbase_m) * cosine - constant(self.encoder_left_m) * sine;
        let center_speed = speed * constant(self.wheelbase_m) * cosine / denominator;
        let yaw_rate = speed * sine / denominator;
        let dt = constant(dt_s);
        Pose::from_twist(
            (center_speed - yaw_rate * constant(self.sensor_left_m)) * dt,
            (yaw_rate * constant(self.sensor_ahead_m) + lateral) * dt,
            yaw_rate * dt,
        )
    }

    fn validate(&self) -> Result<()> {
        positive("wheelbase_m", self.wheelbase_m)?;
        finite("encoder_left_m", self.encoder_left_m)?;
        finite("sensor_ahead_m", self.sensor_ahead_m)?;
        finite("sensor_left_m", self.sensor_left_m)?;
        positive("speed_std_m_per_s", self.speed_std_m_per_s)?;
        non_negative("steering_std_rad", self.steering_std_rad)?;
        non_negative("lateral_std_m_per_s", self.lateral_std_m_per_s)?;
        if self.encoder_left_m.abs() >= self.wheelbase_m {
            return Err(Error::parameter("encoder_left_m", self.encoder_left_m, "less than the wheelbase"));
        }
        validate_period(self.noise_period_s)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn driving_straight_moves_the_laser_straight() {
        let motion = Ackermann::default().relative_motion([2.0, 0.0, 0.0], 0.5);
        assert_eq!(motion, Pose::new(1.0, 0.0, 0.0));
    }

    #[test]
    fn the_published_rates_come_out_for_a_short_step() {
        let car = Ackermann::default();
        let (v_e, alpha, dt) = (3.0_f64, 0.3_f64, 1e-6);
        let v_c = v_e / (1.0 - alpha.tan() * 0.76 / 2.83);
        let omega = v_c / 2.83 * alpha.tan();
        let motion = car.relative_motion([v_e, alpha, 0.0], dt);
        assert!((motion.x / dt - (v_c - omega * 0.5)).abs() < 1e-4);
        assert!((motion.y / dt - omega * 3.78).abs() < 1e-4);
        assert!((motion.heading / dt - omega).abs() < 1e-9);
    }
}
