//! What a draw may take and what was done, in sightings of a particle (about 100 operations): by sizes, not by the clock.

use std::cell::Cell;

/// Work that was done, and how much a problem may take, or all together.
#[derive(Debug)]
pub struct Effort {
    most: f64,
    most_in_all: f64,
    done: Cell<f64>,
    refused: Cell<Option<f64>>,
}

impl Effort {
    /// A problem that takes more is not solved.
    pub fn up_to(most: f64) -> Self {
        Self { most, most_in_all: f64::INFINITY, done: Cell::new(0.0), refused: Cell::new(None) }
    }

    /// All problems together take hardly more.
    pub fn in_all(most_in_all: f64) -> Self {
        Self { most_in_all, ..Self::any() }
    }

    /// Whatever it takes.
    pub fn any() -> Self {
        Self::up_to(f64::INFINITY)
    }

    /// Whether a problem of so much work may be solved.
    pub fn allows(&self, work: f64) -> bool {
        let allows = work <= self.most && self.done.get() + work <= self.most_in_all;
        if !allows {
            self.refused.set(Some(work));
        }
        allows
    }

    /// Spends so much; `None` where that is not allowed.
    pub fn take(&self, work: f64) -> Option<()> {
        self.allows(work).then(|| self.spend(work))
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
