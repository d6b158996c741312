//! The integration tests as one program, which is compiled sooner than many.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)] // That is how a test fails.

mod detection;
mod detection_indoors;
mod simulation;
