//! Which landmark a sighting belongs to, when nobody says so.

mod decide;
pub mod fast;
mod grid;

pub(crate) use decide::by_robot_pose;
pub use decide::{
    decide, Belief, CandidateTable, Decision, FitTable, Hypothesis, ParticleHypothesis, Rules, ScanSighting, Scratch,
};
pub use grid::{Box2, Grid};
