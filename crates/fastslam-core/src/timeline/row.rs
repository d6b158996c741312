//! What a stream or a log brings, a row at a time.

use crate::geometry::Matrix3;
use crate::sighting::Sighting;
use serde::{Deserialize, Serialize};

/// A row of odometry.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ControlRow {
    /// Seconds.
    pub stamp_s: f64,
    /// In the columns of the motion model.
    pub control: [f64; 3],
    /// Covariance of (x, y, heading) that is stated for the row, as in [`super::LogData::control_covariances`].
    pub covariance: Option<Matrix3>,
}

/// One thing that a robot tells.
#[derive(Clone, Debug, PartialEq)]
pub enum Row {
    /// How it moves.
    Control(ControlRow),
    /// What it saw at a moment in seconds: that at which it was measured.
    Sightings(f64, Vec<Sighting>),
    /// Nothing more comes.
    End,
}
