//! Memory that steps share. What it holds counts for nothing once a step is done.

use super::beliefs::Beliefs;
use super::examine::Examination;
use super::existence::Judging;
use crate::association::{fast, CandidateTable, Decision, FitTable, Scratch};
use crate::diagnosis::health::MapInView;
use crate::landmark::SensorPoses;
use crate::resampling::Resampler;
use crate::sighting::ScanSighting;
use crate::workers::{PerThread, Workers};

/// What the stages of a step hand to each other, kept for its memory.
#[derive(Default)]
pub(super) struct Work {
    /// The sightings of the step, each identity once in each.
    pub rounds: Vec<Vec<ScanSighting>>,
    pub beliefs: Beliefs,
    /// Of the step's sightings, per particle.
    pub log_likelihood: Vec<f64>,
    pub resampler: Resampler,
    pub ancestor_indices: Vec<u32>,
    pub associating: Associating,
    pub correcting: Correcting,
    pub examination: Examination,
    /// Sightings of known landmarks with the births of these.
    pub matches: Vec<([f64; 2], u64)>,
    /// Landmarks of the map that the scan should have shown, where that was looked at.
    pub map_in_view: Option<MapInView>,
    pub judging: Judging,
}

/// What deciding about a scan needs.
#[derive(Default)]
pub(super) struct Associating {
    /// Landmarks that the scan may show.
    pub slots: Vec<u32>,
    /// The same with their rows.
    pub table: CandidateTable,
    /// How well the candidates fit.
    pub fits: FitTable,
    pub deciding: PerThread<(fast::Workspace, Scratch)>,
    /// What each particle decided about the scan, an equal share each.
    pub decisions: Vec<Decision>,
    pub former_decisions: Vec<Decision>,
    /// For one sighting, the numbers of the decisions.
    pub decided: Vec<u32>,
}

/// What correcting and creating landmarks needs.
#[derive(Default)]
pub(super) struct Correcting {
    pub sensor_poses: SensorPoses,
    /// The particles that a correction concerns.
    pub mask: Vec<bool>,
    /// Rows of a new landmark.
    pub rows: Vec<f64>,
    /// Landmarks that there were before each sighting of the scan.
    pub births: Vec<u64>,
    /// Sightings of the scan that founded a landmark in some map, with its slot.
    pub founded: Vec<(usize, u32)>,
    /// Log-likelihood of the scan's sighting of every candidate in every map; only where existence follows Bayes' rule.
    pub sighting_densities: Vec<f64>,
}

impl Work {
    /// For so many threads.
    pub fn new(workers: &Workers) -> Self {
        let associating = Associating { deciding: PerThread::new(workers), ..Associating::default() };
        Self { associating, ..Self::default() }
    }
}
