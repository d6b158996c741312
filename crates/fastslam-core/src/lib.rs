//! FastSLAM: landmark SLAM by Rao-Blackwellized particle filtering.
//!
//! Each particle carries a robot path and, given the path, one small Gaussian per landmark. This crate holds all the
//! mathematics and nothing else: no files, no clock, no global state, no randomness that is not a function of the seed.

pub mod association;
pub mod belief;
pub mod config;
mod contract;
pub mod density;
pub mod detect;
pub mod diagnosis;
pub mod ekf_slam;
pub mod error;
pub mod filter;
pub mod gaussian;
pub mod geometry;
pub mod given;
pub mod landmark;
pub mod late;
pub mod limits;
pub mod math;
pub mod measurement;
pub mod motion;
pub mod normal;
pub mod partial;
pub mod path;
pub mod placement;
pub mod random;
pub mod real;
pub mod resampling;
pub mod run;
mod shared;
pub mod sighting;
pub mod slam;
pub mod smoothing;
pub mod snapshot;
pub mod space;
pub mod step_info;
pub mod store;
mod stored_arrays;
pub mod stream;
pub mod testing;
pub mod timeline;
pub mod vector;
pub mod weights;
pub mod workers;

/// The documentation's Rust blocks, which compile and run as tests.
#[cfg(doctest)]
#[doc = include_str!("../../../docs/add-a-measurement-model.md")]
struct AddAMeasurementModel;
