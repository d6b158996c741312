//! The filter's state as bytes.

use super::{Covariance, EkfSlam, Landmark};
use crate::diagnosis::health::Watch;
use crate::diagnosis::NoiseReport;
use crate::error::Result;
use crate::geometry::Pose;
use crate::measurement::MeasurementModel;
use crate::motion::MotionGaussian;
use crate::snapshot::{content, open, seal, Head, Holds};
use rustc_hash::FxHashMap;
use serde::{Deserialize, Serialize};

/// What a later step needs of the earlier ones.
#[derive(Serialize, Deserialize)]
struct State {
    pose: Pose,
    pending: MotionGaussian,
    landmarks: Vec<Landmark>,
    of_identity: FxHashMap<u32, u32>,
    mean: Vec<f64>,
    covariance: Covariance,
    trail: Vec<(f64, Pose)>,
    steps: u64,
    watch: Watch,
    noise_report: NoiseReport,
}

impl<M: MeasurementModel> EkfSlam<M> {
    /// The state as bytes, from which [`EkfSlam::restore`] goes on to the same bits; `note` is kept in its head.
    pub fn save(&self, note: &str) -> Result<Vec<u8>> {
        seal(&Head::new(&self.config, self.identities, note)?, &self.state())
    }

    /// Takes over a state that was saved by a filter of this configuration and measurement model.
    ///
    /// **Errors:** [`Error::Input`](crate::error::Error::Input) when the bytes are no snapshot, of another format,
    /// damaged, or of another configuration; the filter is then as it was.
    pub fn restore(&mut self, snapshot: &[u8]) -> Result<()> {
        let (head, stored) = open(snapshot, Holds::Filter)?;
        head.check(&self.config, self.identities)?;
        self.take_over(content(stored)?);
        Ok(())
    }

    fn state(&self) -> State {
        State {
            pose: self.pose,
            pending: self.pending,
            landmarks: self.landmarks.clone(),
            of_identity: self.of_identity.clone(),
            mean: self.mean.clone(),
            covariance: self.covariance.clone(),
            trail: self.trail.clone(),
            steps: self.steps,
            watch: self.watch.clone(),
            noise_report: self.noise_report,
        }
    }

    fn take_over(&mut self, state: State) {
        let State { pose, pending, landmarks, of_identity, mean, covariance, trail, steps, watch, noise_report } =
            state;
        (self.pose, self.pending, self.steps) = (pose, pending, steps);
        (self.landmarks, self.of_identity, self.trail) = (landmarks, of_identity, trail);
        (self.mean, self.covariance) = (mean, covariance);
        (self.watch, self.noise_report) = (watch, noise_report);
    }
}
