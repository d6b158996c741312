//! Which landmark a sighting belongs to, when nobody says so.

mod ambiguity;
mod assignment;
mod choice;
mod decide;
pub mod fast;
mod grid;
mod hypothesis;
mod joint;
mod rules;
mod sampled;
mod settings;
mod table;

pub(crate) use crate::belief::by_robot_pose;
pub use crate::belief::Belief;
pub use crate::sighting::{Appearance, ScanSighting};
pub use ambiguity::{area_m2, disagreement_m2, GATE};
pub use assignment::{assign, decide_assignment};
pub use choice::{Candidates, Scratch};
pub use decide::{decide, Outcome};
pub use grid::{Box2, Grid};
pub use hypothesis::{Hypothesis, ParticleHypothesis};
pub use joint::decide_joint;
pub use rules::{joint_gates, Rules, MOST_JOINT};
pub use sampled::{decide_sampled, Sampler};
pub use settings::{
    AssociationConfig, AssociationMode, AssociationOrder, Classes, Exclusion, ExistenceConfig, ExistenceForm,
    Identities, Merging, MergingRule, Method, Removal, Signatures,
};
pub use table::{CandidateTable, Decision, Evidence, FitTable};
