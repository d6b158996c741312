//! Which landmark a sighting belongs to, when nobody says so.

mod decide;
mod grid;

pub use decide::{Belief, CandidateTable, Decision, FitTable, Rules, Scan, ScanSighting, Scratch};
pub use grid::{Box2, Grid};
