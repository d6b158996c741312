//! Motion models: how far a control takes the robot, and how uncertain that is.
//!
//! Every planar vehicle moves relative to where it stands, so a model only says which motion `T_previous_current` a
//! control makes; composing it with the pose, sampling it and linearising it are written once, here.
//! A new model is one file with [`MotionModel`] implemented, one variant of [`Motion`] and one line in
//! its `dispatch!`; [`crate::testing::check_motion_model`] puts it through its conformance suite.

mod ackermann;
mod by_noise;
mod increments;
mod odometry;
mod velocity;

pub use ackermann::Ackermann;
pub use by_noise::{MotionByNoise, NoiseKeys, CONTROL_NOISES};
pub use increments::Increments;
pub use odometry::Odometry;
pub use velocity::Velocity;

use crate::error::{Error, Result, LARGEST_MAGNITUDE};
use crate::geometry::{multiply3, transform3, Matrix3, Pose};
use crate::math;
use crate::random::Stream;
use crate::real::{Dual, Real};
use crate::vector::vectorized;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A control with its noise, ready to be sampled: conditioned once, used by every particle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ConditionedControl {
    /// Mean in the coordinates in which the noise is independent.
    pub mean: [f64; 3],
    /// Standard deviation of each coordinate.
    pub std: [f64; 3],
    /// How long the control acts, in seconds.
    pub dt_s: f64,
}

/// When a row of odometry acts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ControlTiming {
    /// From its stamp until the next row (a speed, a steering angle).
    Held,
    /// Between the previous row's stamp and its own (a measured displacement).
    Increment,
}

/// How a vehicle moves.
pub trait MotionModel {
    /// When a row of controls acts.
    fn timing(&self) -> ControlTiming;

    /// The control as a mean and independent noise. `control` has the columns of the model's odometry file.
    fn condition(&self, control: [f64; 3], dt_s: f64) -> ConditionedControl;

    /// `T_previous_current` for a control in the noise's coordinates that acts for `dt_s`.
    fn relative_motion<R: Real>(&self, control: [R; 3], dt_s: f64) -> Pose<R>;

    /// Errors that name the first parameter out of range.
    fn validate(&self) -> Result<()>;
}

/// The standard deviation of white noise on a control that is held for `dt_s`, when it is `std` over `period_s`.
///
/// Splitting a control in two then leaves the distribution of the motion as it was. Without a period the noise
/// belongs to the row, however long it lasts.
pub(crate) fn white_noise_std(std: f64, period_s: Option<f64>, dt_s: f64) -> f64 {
    match period_s {
        // Squares of what a shorter time would make of it are no numbers.
        Some(period_s) if dt_s > 0.0 => std * (period_s / dt_s.max(1e-30)).sqrt(),
        _ => std,
    }
}

/// A motion of the robot as a Gaussian in the frame of its start.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct MotionGaussian {
    /// `T_start_now`.
    pub mean: Pose,
    /// Covariance of (x, y, heading) of `mean`, in the frame of the start.
    pub covariance: Matrix3,
}

/// The motion model of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "model", rename_all = "snake_case")]
pub enum Motion {
    /// Forward speed and yaw rate.
    Velocity(Velocity),
    /// Rotation, translation, rotation, with noise in proportion to the motion.
    Odometry(Odometry),
    /// Displacements with constant noise per row.
    Increments(Increments),
    /// A car: wheel speed and steering angle.
    Ackermann(Ackermann),
}

impl Default for Motion {
    fn default() -> Self {
        Self::Velocity(Velocity::default())
    }
}

/// Calls the generic `$body` with `$model` bound to the model inside.
macro_rules! dispatch {
    ($motion:expr, $model:ident => $body:expr) => {
        match $motion {
            Motion::Velocity($model) => $body,
            Motion::Odometry($model) => $body,
            Motion::Increments($model) => $body,
            Motion::Ackermann($model) => $body,
        }
    };
}

impl Motion {
    /// When a row of controls acts.
    pub fn timing(&self) -> ControlTiming {
        dispatch!(self, m => m.timing())
    }

    /// Errors that name the first parameter out of range.
    pub fn validate(&self) -> Result<()> {
        dispatch!(self, m => m.validate()).map_err(|e| e.within("motion"))
    }

    /// Names of the odometry columns that this model reads.
    pub fn control_columns(&self) -> &'static [&'static str] {
        match self {
            Self::Velocity(_) => &["speed_m_per_s", "yaw_rate_rad_per_s"],
            Self::Ackermann(_) => &["speed_m_per_s", "steering_rad"],
            Self::Odometry(_) | Self::Increments(_) => &["dx_m", "dy_m", "dheading_rad"],
        }
    }

    /// The noise-free motion `T_previous_current` of one control.
    pub fn mean_motion(&self, control: [f64; 3], dt_s: f64) -> Pose {
        dispatch!(self, m => {
            let conditioned = m.condition(control, dt_s);
            m.relative_motion(conditioned.mean, dt_s)
        })
    }

    /// Moves every particle by a sample of the motion (the proposal of FastSLAM 1.0).
    ///
    /// **Shapes:** the three columns have one number per particle. **Source:** `montemerlo2002fastslam`, eq. 2.
    pub fn sample(&self, control: [f64; 3], dt_s: f64, stream: Stream, poses: PoseColumns<'_>) {
        dispatch!(self, m => sample(m, m.condition(control, dt_s), stream, poses));
    }

    /// Extends a motion by one control, to first order.
    ///
    /// **Why:** the recursion P ← F P Fᵀ + G Σ Gᵀ with F, G by automatic differentiation holds for any model.
    pub fn extend(&self, motion: &MotionGaussian, control: [f64; 3], dt_s: f64) -> MotionGaussian {
        dispatch!(self, m => extend(m, motion, m.condition(control, dt_s)))
    }

    /// The same with what each noise adds apart.
    pub fn extend_by_noise(&self, motion: &MotionByNoise, control: [f64; 3], dt_s: f64) -> MotionByNoise {
        let noises = self.noises();
        dispatch!(self, m => motion.extended(m, m.condition(control, dt_s), noises))
    }
}

/// Poses of all particles as columns.
#[derive(Debug)]
pub struct PoseColumns<'a> {
    /// Number of the first particle, which addresses its random numbers.
    pub first_particle: u32,
    /// Metres.
    pub x: &'a mut [f64],
    /// Metres.
    pub y: &'a mut [f64],
    /// Radians, wrapped.
    pub heading: &'a mut [f64],
}

fn sample<M: MotionModel>(model: &M, control: ConditionedControl, stream: Stream, poses: PoseColumns<'_>) {
    let PoseColumns { first_particle, x, y, heading } = poses;
    let n = x.len();
    let (y, heading) = (&mut y[..n], &mut heading[..n]);
    let third = control.std[2] > 0.0;
    vectorized(
        #[inline(always)]
        || {
            for i in 0..n {
                let particle = first_particle + i as u32;
                let [a, b] = stream.normal_pair(particle, 0);
                let c = if third { stream.normal_pair(particle, 1)[0] } else { 0.0 };
                let noisy = [
                    control.mean[0] + control.std[0] * a,
                    control.mean[1] + control.std[1] * b,
                    control.mean[2] + control.std[2] * c,
                ];
                let moved = Pose::new(x[i], y[i], heading[i]).compose(model.relative_motion(noisy, control.dt_s));
                (x[i], y[i], heading[i]) = (moved.x, moved.y, moved.heading);
            }
        },
    );
}

fn extend<M: MotionModel>(model: &M, motion: &MotionGaussian, control: ConditionedControl) -> MotionGaussian {
    let start = [motion.mean.x, motion.mean.y, motion.mean.heading];
    let variable = |value: [f64; 3], offset: usize| -> [Dual<6>; 3] {
        std::array::from_fn(|i| Dual::variable(value[i], offset + i))
    };
    let [x, y, heading] = variable(start, 0);
    let end = Pose::new(x, y, heading).compose(model.relative_motion(variable(control.mean, 3), control.dt_s));
    let rows = [end.x.gradient, end.y.gradient, end.heading.gradient];
    let by_start: Matrix3 = rows.map(|g| [g[0], g[1], g[2]]);
    let by_control: Matrix3 = rows.map(|g| [g[3], g[4], g[5]]);
    let noise: Matrix3 =
        std::array::from_fn(|i| std::array::from_fn(|j| if i == j { control.std[i] * control.std[i] } else { 0.0 }));
    let old = transform3(&by_start, &motion.covariance);
    let new = transform3(&by_control, &noise);
    MotionGaussian {
        mean: Pose::new(end.x.value, end.y.value, end.heading.value),
        covariance: symmetrized(&std::array::from_fn(|i| std::array::from_fn(|j| old[i][j] + new[i][j]))),
    }
}

fn symmetrized(m: &Matrix3) -> Matrix3 {
    std::array::from_fn(|i| std::array::from_fn(|j| 0.5 * (m[i][j] + m[j][i])))
}

impl MotionGaussian {
    /// This motion, or an error that names the control that made it too large to compute with.
    pub(crate) fn checked(self, control: [f64; 3], dt_s: f64) -> Result<Self> {
        let numbers = self.mean.to_array().into_iter().chain(self.covariance.into_iter().flatten());
        if numbers.into_iter().all(|v| v.abs() <= LARGEST_MAGNITUDE) {
            return Ok(self);
        }
        Err(Error::Input(format!("control {control:?} for {dt_s} s: no robot moves that far, or as uncertainly")))
    }

    /// Covariance of the pose reached from a start with this heading, in the world's axes.
    #[inline(always)]
    pub fn covariance_in_world(&self, heading: f64) -> Matrix3 {
        let (s, c) = math::sin_cos(heading);
        let [[xx, xy, xh], [_, yy, yh], [_, _, hh]] = self.covariance;
        let (cross, twice) = (s * c * (xx - yy) + (c * c - s * s) * xy, 2.0 * s * c * xy);
        let (along, across) = (c * xh - s * yh, s * xh + c * yh);
        [
            [c * c * xx - twice + s * s * yy, cross, along],
            [cross, s * s * xx + twice + c * c * yy, across],
            [along, across, hh],
        ]
    }

    /// This motion followed by another.
    pub fn then(&self, next: &MotionGaussian) -> MotionGaussian {
        let (s, c) = math::sin_cos(self.mean.heading);
        let step = next.mean;
        let by_start = [[1.0, 0.0, -s * step.x - c * step.y], [0.0, 1.0, c * step.x - s * step.y], [0.0, 0.0, 1.0]];
        let rotation = [[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]];
        let old = multiply3(&by_start, &self.covariance);
        let old = multiply3(&old, &transpose(&by_start));
        let new = transform3(&rotation, &next.covariance);
        MotionGaussian {
            mean: self.mean.compose(step),
            covariance: symmetrized(&std::array::from_fn(|i| std::array::from_fn(|j| old[i][j] + new[i][j]))),
        }
    }
}

fn transpose(m: &Matrix3) -> Matrix3 {
    std::array::from_fn(|i| std::array::from_fn(|j| m[j][i]))
}

/// The period must be positive where one is given.
pub(crate) fn validate_period(period_s: Option<f64>) -> Result<()> {
    match period_s {
        Some(value) if !(value.is_finite() && value > 0.0) => {
            Err(Error::parameter("noise_period_s", value, "a finite number above 0"))
        }
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Purpose, RandomSource};

    fn car() -> Motion {
        Motion::Ackermann(Ackermann { speed_std_m_per_s: 0.4, steering_std_rad: 0.05, ..Ackermann::default() })
    }

    #[test]
    fn the_linearised_motion_has_the_moments_of_the_samples() {
        // Small noise, so that linearisation errors stay below the standard error of 40,000 samples.
        let control = [3.0, 0.2, 0.0];
        let (n, steps) = (40_000_usize, 4_u64);
        for motion in [
            car(),
            Motion::Velocity(Velocity {
                speed_std_m_per_s: 0.3,
                yaw_rate_std_rad_per_s: 0.02,
                lateral_std_m_per_s: 0.0,
                noise_period_s: None,
            }),
        ] {
            let (mut x, mut y, mut heading) = (vec![0.0; n], vec![0.0; n], vec![0.0; n]);
            let mut gaussian = MotionGaussian::default();
            for step in 0..steps {
                let stream = RandomSource::new(11).stream(Purpose::Motion, step);
                motion.sample(
                    control,
                    0.1,
                    stream,
                    PoseColumns { first_particle: 0, x: &mut x, y: &mut y, heading: &mut heading },
                );
                gaussian = motion.extend(&gaussian, control, 0.1);
            }
            let columns = [&x, &y, &heading];
            let mean = columns.map(|c| c.iter().sum::<f64>() / n as f64);
            for (i, expected) in gaussian.mean.to_array().into_iter().enumerate() {
                let bound = 5.0 * (gaussian.covariance[i][i] / n as f64).sqrt() + 1e-4;
                assert!((mean[i] - expected).abs() < bound, "{motion:?} mean {i}: {} against {expected}", mean[i]);
                let variance = columns[i].iter().map(|v| (v - mean[i]).powi(2)).sum::<f64>() / n as f64;
                // The sample variance of a Gaussian has relative standard error sqrt(2/n) = 0.7 %; 5 of them.
                let ratio = variance / gaussian.covariance[i][i];
                assert!((ratio - 1.0).abs() < 0.04, "{motion:?} variance {i}: ratio {ratio}");
            }
        }
    }

    #[test]
    fn the_covariance_turns_with_the_heading() {
        let motion = MotionGaussian {
            mean: Pose::default(),
            covariance: [[0.3, 0.05, 0.02], [0.05, 0.2, -0.01], [0.02, -0.01, 0.1]],
        };
        let (s, c) = libm::sincos(0.7);
        let expected = transform3(&[[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]], &motion.covariance);
        for (row, want) in motion.covariance_in_world(0.7).iter().zip(expected) {
            for (got, want) in row.iter().zip(want) {
                assert!((got - want).abs() < 1e-15);
            }
        }
    }

    #[test]
    fn extending_by_a_control_equals_composing_with_its_motion() {
        let motion = car();
        let first = motion.extend(&MotionGaussian::default(), [2.0, -0.3, 0.0], 0.2);
        let second = motion.extend(&MotionGaussian::default(), [3.0, 0.1, 0.0], 0.3);
        let chained = motion.extend(&first, [3.0, 0.1, 0.0], 0.3);
        let composed = first.then(&second);
        assert!((chained.mean.x - composed.mean.x).abs() < 1e-12 && (chained.mean.y - composed.mean.y).abs() < 1e-12);
        for i in 0..3 {
            for j in 0..3 {
                assert!((chained.covariance[i][j] - composed.covariance[i][j]).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn splitting_a_control_in_two_leaves_white_noise_as_it_was() {
        let motion = Motion::Velocity(Velocity {
            speed_std_m_per_s: 0.3,
            yaw_rate_std_rad_per_s: 0.1,
            lateral_std_m_per_s: 0.0,
            noise_period_s: Some(0.1),
        });
        let whole = motion.extend(&MotionGaussian::default(), [1.0, 0.0, 0.0], 0.2);
        let half = motion.extend(&MotionGaussian::default(), [1.0, 0.0, 0.0], 0.1);
        let halves = motion.extend(&half, [1.0, 0.0, 0.0], 0.1);
        assert!((whole.covariance[0][0] - halves.covariance[0][0]).abs() < 1e-12);
        assert!((whole.covariance[2][2] - halves.covariance[2][2]).abs() < 1e-12);
    }
}
