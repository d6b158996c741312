//! Which landmark a sighting belongs to, when nobody says so.

mod decide;
mod grid;

pub use decide::{associate, Belief, CandidateTable, Decision, Rules, ScanSighting};
pub use grid::{Box2, Grid};
