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
    /// Landmarks that were created (by at least one particle).
    pub new_landmarks: u32,
    /// Landmarks that the best particle removed from its map.
    pub removed: u32,
    /// Landmarks that the best particle merged with another one.
    pub merged: u32,
    /// Particles for which the scan was too large for joint association.
    pub fell_back: u32,
    /// Sightings that the best particle took for neither a known nor a new landmark.
    pub ignored: u32,
    /// Sightings skipped: not finite, or outside the sensor's limits.
    pub skipped: Skipped,
    /// 1 / Σ weight², before resampling.
    pub effective_sample_size: f64,
    /// Whether the particles were resampled.
    pub resampled: bool,
    /// Increment of the log evidence.
    pub log_likelihood: f64,
    /// Landmarks in the map of the best particle.
    pub landmarks: u32,
    /// Whether all particles were drawn anew from the posterior over paths.
    pub rejuvenated: bool,
    /// Whether the poses are samples now; without sightings FastSLAM 2.0 waits.
    pub sampled: bool,
    /// Number of particles after the step.
    pub particles: u32,
    /// Sightings that the best particle took for landmarks of its map.
    pub matched: u32,
    /// Landmark covariances that lost definiteness and were repaired, over all particles.
    pub repaired: u32,
    /// Mean normalised innovation squared per sighting over the sliding window; 2 is expected, 0 before the first.
    pub nis: f64,
    /// What holds 95 % of such means when the noise is right.
    pub nis_band: [f64; 2],
    /// How the configured noise contradicts the sliding window.
    pub noise_warnings: NoiseWarnings,
    /// Whether the estimate can be believed.
    pub health: Health,
}
