//! Which rows of a stream are taken, and how many were not.

use crate::error::{non_negative, positive, Error, Result};
use crate::timeline::{ControlRow, Row};
use serde::{Deserialize, Serialize};

/// What may come when. All in seconds of the rows' stamps; the core has no clock.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Window {
    /// A row may be this much older than the newest one: nothing is computed before. Later ones are refused.
    pub late_s: f64,
    /// Sightings wait this long for the row of odometry that says how the robot came to where it saw them; then it is
    /// taken to move on as it did (where odometry is a speed) or to have stood (where it is a displacement).
    pub wait_s: f64,
    /// A row that is further than this ahead of all others is refused, unless another one confirms it.
    pub gap_s: f64,
}

impl Window {
    /// Of a log that is known as a whole: in order, and any gap is one.
    pub const OF_A_LOG: Self = Self { late_s: 0.0, wait_s: f64::INFINITY, gap_s: f64::INFINITY };

    /// Errors that name what is out of range.
    pub fn validate(&self) -> Result<()> {
        non_negative("late_s", self.late_s)?;
        positive("wait_s", self.wait_s)?;
        positive("gap_s", self.gap_s)?;
        Ok(())
    }
}

/// What became of a row.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Taken {
    /// It counts.
    Yes,
    /// Refused: older than the window allows.
    Late,
    /// Refused: a row with this stamp is there, for sightings one that says the same.
    Repeated,
    /// Refused: too far ahead of all others.
    Ahead,
}

/// Rows that were refused, by reason.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Refused {
    /// Older than the window allows; stamps that go back are of these.
    pub late: u64,
    /// There already.
    pub repeated: u64,
    /// Too far ahead.
    pub ahead: u64,
}

/// The gate before a timeline.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(super) struct Intake {
    pub window: Window,
    pub refused: Refused,
    /// Stamp of the newest row that was taken.
    newest_s: f64,
    /// Stamp of the last row that was refused since it was too far ahead.
    ahead_s: f64,
}

impl Intake {
    pub fn new(window: Window) -> Self {
        Self { window, refused: Refused::default(), newest_s: f64::NEG_INFINITY, ahead_s: f64::NEG_INFINITY }
    }

    /// Whether a row of this stamp is taken, where all that is earlier than `settled_s` is settled.
    pub fn judge(&mut self, stamp_s: f64, settled_s: f64) -> Taken {
        if stamp_s < settled_s {
            return self.refuse(Taken::Late);
        }
        let gap_s = self.window.gap_s;
        let is_ahead = self.newest_s.is_finite() && stamp_s - self.newest_s > gap_s;
        let is_confirmed = (stamp_s - self.ahead_s).abs() <= gap_s;
        if is_ahead && !is_confirmed {
            self.ahead_s = stamp_s;
            return self.refuse(Taken::Ahead);
        }
        self.newest_s = self.newest_s.max(stamp_s);
        Taken::Yes
    }

    /// Everything before this moment has come, as far as it may.
    pub fn settled_s(&self) -> f64 {
        self.newest_s - self.window.late_s
    }

    /// Counts a row that is refused.
    pub fn refuse(&mut self, why: Taken) -> Taken {
        let count = match why {
            Taken::Yes => return why,
            Taken::Late => &mut self.refused.late,
            Taken::Repeated => &mut self.refused.repeated,
            Taken::Ahead => &mut self.refused.ahead,
        };
        *count += 1;
        why
    }
}

/// The stamp of a row that can be computed with; none for the end.
///
/// **Errors:** a row whose numbers are none.
pub(super) fn stamp_of(row: &Row) -> Result<Option<f64>> {
    let stamp_s = match row {
        Row::Control(ControlRow { stamp_s, control, covariance }) => {
            Error::check_control(*control, 0.0)?;
            if covariance.is_some_and(|c| !crate::geometry::is_covariance3(&c)) {
                return Err(Error::Input(format!("odometry: {covariance:?} is no covariance")));
            }
            *stamp_s
        }
        Row::Sightings(row) => row.stamp_s,
        Row::End => return Ok(None),
    };
    if stamp_s.is_finite() {
        Ok(Some(stamp_s))
    } else {
        Err(Error::Input(format!("the stamp is {stamp_s}, expected seconds")))
    }
}
