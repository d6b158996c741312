//! A part of a row of odometry.

use crate::geometry::Matrix3;

/// A part of a row of odometry: the row as the log has it, how long it lasts, and how much of it passes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RowPart {
    /// The columns of the motion model.
    pub control: [f64; 3],
    /// How long the whole row lasts, in seconds.
    pub row_s: f64,
    /// Which share of the row passes, in time and so in motion; 1 for all of it.
    pub share: f64,
    /// Covariance of (x, y, heading) that the log states for the whole row, in the frame of its start. It stands in place
    /// of all noise that the motion model is configured with.
    pub covariance: Option<Matrix3>,
}

impl RowPart {
    /// A row that is not cut.
    pub fn whole(control: [f64; 3], row_s: f64) -> Self {
        Self { control, row_s, share: 1.0, covariance: None }
    }

    /// How long the part lasts, in seconds.
    pub fn duration_s(&self) -> f64 {
        self.share * self.row_s
    }
}
