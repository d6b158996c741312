//! What a stream or a log brings, a row at a time.

use crate::geometry::Matrix3;
use crate::sighting::{Scan, Sighting};
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

/// What one sensor saw at a moment.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SightingsRow {
    /// Seconds: when it was measured.
    pub stamp_s: f64,
    /// What was seen.
    pub sightings: Vec<Sighting>,
    /// Number of the sensor; behind the others in a snapshot, which older formats did not have.
    #[serde(skip)]
    pub sensor: usize,
}

impl SightingsRow {
    /// Of the only sensor.
    pub fn new(stamp_s: f64, sightings: Vec<Sighting>) -> Self {
        Self { stamp_s, sightings, sensor: 0 }
    }

    /// As a filter takes it.
    pub fn scan(&self) -> Scan<'_> {
        Scan { stamp_s: self.stamp_s, sensor: self.sensor, sightings: &self.sightings }
    }
}

impl From<Scan<'_>> for SightingsRow {
    fn from(Scan { stamp_s, sensor, sightings }: Scan<'_>) -> Self {
        Self { stamp_s, sightings: sightings.to_vec(), sensor }
    }
}

/// One thing that a robot tells.
#[derive(Clone, Debug, PartialEq)]
pub enum Row {
    /// How it moves.
    Control(ControlRow),
    /// What it saw.
    Sightings(SightingsRow),
    /// Nothing more comes.
    End,
}
