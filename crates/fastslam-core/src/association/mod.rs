//! Which landmark a sighting belongs to, when nobody says so.

mod assignment;
mod decide;
pub mod fast;
mod grid;
mod joint;
mod sampled;
mod settings;

pub use assignment::{assign, decide_assignment};
pub(crate) use decide::by_robot_pose;
pub use decide::{
    decide, Belief, CandidateTable, Decision, FitTable, Hypothesis, ParticleHypothesis, Rules, ScanSighting, Scratch,
};
pub use grid::{Box2, Grid};
pub use joint::{decide_joint, joint_gates, Outcome, MOST_JOINT};
pub use sampled::decide_sampled;
pub(crate) use settings::{logistic, validate_below};
pub use settings::{Appearance, Classes, ExistenceForm, Merging, MergingRule, Method, Signatures};
