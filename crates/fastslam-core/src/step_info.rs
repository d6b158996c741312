//! What a step tells about itself.

use crate::diagnosis::{Health, NoiseWarnings};
use crate::sighting::Skipped;
use serde::{Deserialize, Serialize};

/// What happened in one step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct StepInfo {
    /// Number of the step, from 0.
    pub step: u64,
    /// Sightings used.
    pub sightings: u32,
    /// What became of the landmarks.
    pub changes: MapChanges,
    /// Particles for which the scan was too large for joint association.
    pub fell_back: u32,
    /// Sightings that changed nothing.
    pub left_out: LeftOut,
    /// What the sightings made of the weights.
    pub weighing: Weighing,
    /// Landmarks in the map of the best particle.
    pub landmarks: u32,
    /// How the poses came about.
    pub sampling: Sampling,
    /// Sightings that the best particle took for landmarks of its map.
    pub matched: u32,
    /// Landmark covariances that lost definiteness and were repaired, over all particles.
    pub repaired: u32,
    /// What the sliding window says of the configured noise.
    pub noise: NoiseInWindow,
    /// Whether the estimate can be believed.
    pub health: Health,
}

/// What became of the landmarks of the maps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct MapChanges {
    /// Landmarks that were created (by at least one particle).
    pub new_landmarks: u32,
    /// Landmarks that the best particle removed from its map.
    pub removed: u32,
    /// Landmarks that the best particle merged with another one.
    pub merged: u32,
}

/// Sightings that changed nothing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct LeftOut {
    /// Those that the best particle took for neither a known nor a new landmark.
    pub ignored: u32,
    /// Those skipped: not finite, or outside the sensor's limits.
    pub skipped: Skipped,
}

/// What the sightings made of the weights.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Weighing {
    /// 1 / Σ weight², before resampling.
    pub effective_sample_size: f64,
    /// Whether the particles were resampled.
    pub resampled: bool,
    /// Increment of the log evidence.
    pub log_likelihood: f64,
}

/// How the poses of the particles came about.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Sampling {
    /// Whether all particles were drawn anew from the posterior over paths.
    pub rejuvenated: bool,
    /// Whether the poses are samples now; without sightings FastSLAM 2.0 waits.
    pub sampled: bool,
    /// Number of particles after the step.
    pub particles: u32,
}

/// What the sliding window of sightings says of the configured noise.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct NoiseInWindow {
    /// Mean normalised innovation squared per sighting; 2 is expected, 0 before the first.
    pub nis: f64,
    /// What holds 95 % of such means when the noise is right.
    pub nis_band: [f64; 2],
    /// How the noise contradicts the window.
    pub warnings: NoiseWarnings,
}

impl From<&crate::diagnosis::NoiseReport> for NoiseInWindow {
    fn from(report: &crate::diagnosis::NoiseReport) -> Self {
        Self { nis: report.nis, nis_band: report.band, warnings: report.warnings }
    }
}
