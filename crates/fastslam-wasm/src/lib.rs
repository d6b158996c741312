//! FastSLAM in a browser: a world to drive in, or a log of one's own, and filters that watch.
//!
//! The page (`page/`) sends requests as JSON and gets numbers to draw. Nothing here knows of a browser: the same requests
//! give the same bits in a native program, which `make web` checks.

pub mod abi;
pub mod classroom;
pub mod drawing;
pub mod observer;
pub mod replay;
pub mod requests;
pub mod settings;
pub mod tables;
pub mod world;
