//! An observer for runs that nobody watches.

use fastslam_core::run::Observer;

/// Watches nothing; time stands still.
pub struct Blind;

impl Observer for Blind {
    fn now_s(&self) -> f64 {
        0.0
    }

    fn step_done(&mut self, _done: usize) -> bool {
        true
    }
}
