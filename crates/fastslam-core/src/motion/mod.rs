//! Motion models: how far a control takes the robot, and how uncertain that is.
//!
//! Every planar vehicle moves relative to where it stands, so a model only says what a whole row of odometry means
//! ([`RowMotion`]): a constant twist, and the noise that diffuses meanwhile. Cutting a row, composing parts, sampling
//! and linearising are written once, here. A new model is one file with [`MotionModel`] implemented, one variant of
//! [`Motion`] and one line in its `dispatch!`; [`crate::testing::check_motion_model`] puts it through its conformance
//! suite.

mod ackermann;
mod by_noise;
mod gaussian;
mod increments;
mod odometry;
mod part;
mod row;
mod settings;
#[cfg(test)]
mod tests;
mod velocity;

pub use ackermann::Ackermann;
pub use by_noise::{MotionByNoise, NoiseKeys};
pub use gaussian::MotionGaussian;
pub use increments::Increments;
pub use odometry::Odometry;
pub use part::RowPart;
pub use row::{RowMotion, CONTROL_NOISES};
pub use settings::{Correction, Proportional};
pub use velocity::Velocity;

use crate::error::{Error, Result};
use crate::geometry::Pose;
use crate::math::wrap_angle;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// When a row of odometry acts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
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

    /// What a row says that lasts `row_s`. `control` has the columns of the model's odometry file.
    fn row(&self, control: [f64; 3], row_s: f64) -> RowMotion;

    /// Errors that name the first parameter out of range.
    fn validate(&self) -> Result<()>;
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

    /// What a whole row says that lasts `row_s`.
    pub fn row(&self, control: [f64; 3], row_s: f64) -> RowMotion {
        dispatch!(self, m => m.row(control, row_s))
    }

    /// What the whole row of a part says, with the covariance that the log states for it, if it does.
    fn row_of(&self, part: &RowPart) -> RowMotion {
        let row = self.row(part.control, part.row_s);
        part.covariance.map_or(row, |stated| RowMotion::stating(row.twist, &stated))
    }

    /// The noise-free motion `T_previous_current` of a whole row.
    pub fn mean_motion(&self, control: [f64; 3], row_s: f64) -> Pose {
        let [forward, left, turn] = self.row(control, row_s).twist;
        Pose::from_twist(forward, left, turn)
    }

    /// The motion of a part of a row.
    ///
    /// **Errors:** [`Error::Input`] for a control that no robot could follow.
    pub fn of(&self, part: &RowPart) -> Result<MotionGaussian> {
        Error::check_control(part.control, part.row_s)?;
        self.row_of(part).part(part.share).checked(part)
    }

    /// The motion of a part of a row, and what each noise adds to it.
    ///
    /// **Errors:** as [`Self::of`].
    pub fn with_noises(&self, part: &RowPart) -> Result<(MotionGaussian, MotionByNoise)> {
        Error::check_control(part.control, part.row_s)?;
        let (motion, covariances) = self.row_of(part).part_with_noises(part.share);
        Ok((motion.checked(part)?, MotionByNoise { mean: motion.mean, covariances }))
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

/// The twist of a displacement (dx, dy, dheading): the arc that leads there.
fn twist_of([x, y, heading]: [f64; 3]) -> [f64; 3] {
    Pose::new(x, y, wrap_angle(heading)).to_twist()
}
