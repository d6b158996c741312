//! A car with wheel speed and steering angle.

use super::gaussian::symmetrized;
use super::settings::{integrated, validate_period, variance_of};
use super::{ControlTiming, Correction, MotionModel, Proportional, RowMotion};
use crate::error::{finite, non_negative, non_zero, positive, Error, Result};
use crate::geometry::transform3;
use crate::real::{Dual, Real};
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
    /// True steering angle per reported one.
    pub steering_gain: f64,
    /// Added to the steering angle after the gain: a wheel that is not straight at 0.
    pub steering_bias_rad: f64,
    /// Systematic errors of the speed, and of the turn that the corrected steering angle gives.
    pub correction: Correction,
    /// Noise in proportion to what the tracked point drives and turns, beside the constant noise.
    pub proportional: Proportional,
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
            noise_period_s: None,
            steering_gain: 1.0,
            steering_bias_rad: 0.0,
            correction: Correction::default(),
            proportional: Proportional::default(),
        }
    }
}

impl Ackermann {
    /// Velocity (forward, left, turn) of the tracked point, from the true speed of the encoder's wheel, the true
    /// steering angle and the slip.
    fn velocity<R: Real>(&self, [speed, steering, slip]: [R; 3]) -> [R; 3] {
        let constant = R::constant;
        let (sine, cosine) = steering.sin_cos();
        // v_c / cos α and ω, multiplied out so that a wheel turned by 90° needs no tangent.
        let denominator = constant(self.wheelbase_m) * cosine - constant(self.encoder_left_m) * sine;
        let center_speed = speed * constant(self.wheelbase_m) * cosine / denominator;
        let steered = speed * sine / denominator;
        let turned = steered * constant(self.correction.turn_gain);
        let yaw_rate = turned + constant(self.correction.yaw_rate_bias_rad_per_s);
        [
            center_speed - yaw_rate * constant(self.sensor_left_m),
            yaw_rate * constant(self.sensor_ahead_m) + slip,
            yaw_rate,
        ]
    }
}

impl MotionModel for Ackermann {
    fn timing(&self) -> ControlTiming {
        ControlTiming::Held
    }

    fn row(&self, control: [f64; 3], row_s: f64) -> RowMotion {
        let true_control =
            [self.correction.distance_gain * control[0], self.steering_gain * control[1] + self.steering_bias_rad, 0.0];
        let velocity = self.velocity(std::array::from_fn(|i| Dual::<3>::variable(true_control[i], i)));
        let twist = velocity.map(|rate| rate.value * row_s);
        let gathered = integrated(self.noise_period_s, row_s);
        let by_control = velocity.map(|rate| rate.gradient);
        let stds = [self.speed_std_m_per_s, self.steering_std_rad, self.lateral_std_m_per_s];
        let by_noise =
            [0, 1, 2].map(|i| symmetrized(&transform3(&by_control, &variance_of(i, stds[i] * stds[i] * gathered))));
        RowMotion::new(twist, by_noise).adding(self.proportional.variances(twist))
    }

    fn validate(&self) -> Result<()> {
        positive("wheelbase_m", self.wheelbase_m)?;
        finite("encoder_left_m", self.encoder_left_m)?;
        finite("sensor_ahead_m", self.sensor_ahead_m)?;
        finite("sensor_left_m", self.sensor_left_m)?;
        non_zero("steering_gain", self.steering_gain)?;
        finite("steering_bias_rad", self.steering_bias_rad)?;
        self.correction.validate()?;
        self.proportional.validate()?;
        self.proportional.or_positive("speed_std_m_per_s", self.speed_std_m_per_s)?;
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
    use crate::geometry::Pose;

    #[test]
    fn driving_straight_moves_the_laser_straight() {
        let motion = Ackermann::default().row([2.0, 0.0, 0.0], 0.5).part(1.0).mean;
        assert_eq!(motion, Pose::new(1.0, 0.0, 0.0));
    }

    #[test]
    fn the_published_rates_come_out() {
        let (v_e, alpha, dt) = (3.0_f64, 0.3_f64, 0.1);
        let v_c = v_e / (1.0 - alpha.tan() * 0.76 / 2.83);
        let omega = v_c / 2.83 * alpha.tan();
        let expected = [v_c - omega * 0.5, omega * 3.78, omega];
        let twist = Ackermann::default().row([v_e, alpha, 0.0], dt).twist;
        for (got, rate) in twist.iter().zip(expected) {
            assert!((got - rate * dt).abs() < 1e-14, "{twist:?} against {expected:?}");
        }
    }

    #[test]
    fn gains_and_biases_act_on_what_is_reported() {
        let plain = Ackermann::default();
        let correction = Correction { distance_gain: 1.1, turn_gain: 0.5, yaw_rate_bias_rad_per_s: 0.02 };
        let car = Ackermann { steering_gain: 0.8, steering_bias_rad: 0.05, correction, ..plain.clone() };
        let (got, base) = (car.row([2.0, 0.25, 0.0], 0.4).twist, plain.row([2.2, 0.25, 0.0], 0.4).twist);
        // 0.8 · 0.25 + 0.05 is the reported angle itself; the turn of the plain car is then halved and the bias added.
        assert!((got[2] - (0.5 * base[2] + 0.008)).abs() < 1e-15);
        assert!((got[0] - (base[0] + 0.5 * (base[2] - got[2]))).abs() < 1e-14);
    }
}
