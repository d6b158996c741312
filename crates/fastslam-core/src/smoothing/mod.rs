//! The posterior over a whole path and its map, given which sighting shows which landmark, as sparse least squares.
//!
//! Motions and sightings of the past ([`History`]) make a [`Graph`]; its most probable solution and the precision there
//! (the Laplace approximation, [`Mode`]) describe the posterior. Loops that the associations have missed are closed by
//! joint evidence ([`Closing`]); paths are drawn, and landmarks follow from each ([`draw`]). It knows no particle filter.
//!
//! **Source:** `beevers2007fixedlag` for the idea of drawing past poses again; the exact factorisation
//! (`montemerlo2002fastslam`, eq. 3) is what makes landmarks follow from a path. Exact in a linear-Gaussian world.

mod border;
mod closing;
mod conditional;
mod differences;
mod draws;
mod drift;
mod effort;
mod elimination;
mod equations;
mod factor;
mod graph;
mod guess;
mod history;
mod keyframes;
mod misread;
mod rows;
mod second_thoughts;
mod surplus;
mod symbolic;
mod thinning;
mod triangle;
mod twins;

pub use border::{Anchors, Bordered, Priors};
pub use rows::{Problem, Rows, Sight, OF_SENSOR};

pub(crate) use closing::{Closing, PASSES, RARE};
pub(crate) use draws::{draw, fill_normal, Drawn, Sampling};
pub(crate) use drift::Drift;
pub(crate) use effort::Effort;
pub(crate) use equations::{motion_cost, Block, Equations};
pub(crate) use factor::{Factor, LANES};
pub(crate) use graph::{by_landmark, Graph, Known, Mode, Sights};
pub(crate) use history::{History, Trajectory, NO_LANDMARK};
pub(crate) use keyframes::Keyframes;
pub(crate) use second_thoughts::{Moved, SecondThoughts};
pub(crate) use triangle::UpperTriangle;
