//! What a draw may take and what was done, in sightings of a particle (about 100 operations): by sizes, not by the clock.

use std::cell::Cell;

/// Work that was done, and how much a problem may take.
#[derive(Debug)]
pub struct Effort {
    most: f64,
    done: Cell<f64>,
    refused: Cell<Option<f64>>,
}

impl Effort {
    /// A problem that takes more is not solved.
    pub fn up_to(most: f64) -> Self {
        Self { most, done: Cell::new(0.0), refused: Cell::new(None) }
    }

    /// Whatever it takes.
    pub fn any() -> Self {
        Self::up_to(f64::INFINITY)
    }

    /// Whether a problem of so much work may be solved.
    pub fn allows(&self, work: f64) -> bool {
        let allows = work <= self.most;
        if !allows {
            self.refused.set(Some(work));
        }
        allows
    }

    /// So much was done.
    pub fn spend(&self, work: f64) {
        self.done.set(self.done.get() + work);
    }

    /// What was done.
    pub fn done(&self) -> f64 {
        self.done.get()
    }

    /// The work of a problem that was not solved for it.
    pub fn refused(&self) -> Option<f64> {
        self.refused.get()
    }
}
