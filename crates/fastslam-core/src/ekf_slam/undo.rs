//! A scan that fails half way leaves no trace.

use super::{EkfSlam, Landmark, FIRST_LANDMARK};
use crate::diagnosis::names::Names;
use crate::geometry::Pose;
use crate::measurement::Placing;
use crate::motion::MotionGaussian;
use rustc_hash::FxHashMap;

/// What a scan may change, beside the covariance, as it was before.
#[derive(Default)]
pub(super) struct Before {
    pose: Pose,
    pending: MotionGaussian,
    landmarks: Vec<Landmark>,
    of_identity: FxHashMap<u32, u32>,
    mean: Vec<f64>,
    names: Names,
}

impl<M: Placing> EkfSlam<M> {
    /// Takes note of the state, which costs as much as a few rows of the covariance.
    pub(super) fn remember(&mut self) {
        let before = &mut self.before;
        (before.pose, before.pending) = (self.state.pose, self.state.pending);
        before.landmarks.clone_from(&self.state.landmarks);
        before.of_identity.clone_from(&self.state.of_identity);
        before.mean.clone_from(&self.state.mean);
        before.names.clone_from(&self.state.watch.names);
        self.state.covariance.remember();
    }

    /// Makes the state what it was when it was last remembered.
    pub(super) fn go_back(&mut self) {
        let before = &mut self.before;
        (self.state.pose, self.state.pending) = (before.pose, before.pending);
        std::mem::swap(&mut self.state.landmarks, &mut before.landmarks);
        std::mem::swap(&mut self.state.of_identity, &mut before.of_identity);
        std::mem::swap(&mut self.state.mean, &mut before.mean);
        std::mem::swap(&mut self.state.watch.names, &mut before.names);
        self.seen_again.clear();
        self.state.covariance.go_back(FIRST_LANDMARK + 2 * self.state.landmarks.len());
    }
}
