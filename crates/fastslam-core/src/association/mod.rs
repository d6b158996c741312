//! Which landmark a sighting belongs to, when nobody says so.

mod decide;
mod grid;

pub(crate) use decide::by_robot_pose;
pub use decide::{associate, decide, Belief, CandidateTable, Decision, Hypothesis, Rules, ScanSighting};
pub use grid::{Box2, Grid};
