//! Memory that steps share. What it holds counts for nothing once a step is done.

use super::beliefs::Beliefs;
use super::errors::{Linear, Noise, Shown};
use super::fading::Look;
use super::state::State;
use crate::association::{fast, CandidateTable, Decision, FitTable, ScanSighting, Scratch};
use crate::diagnosis::innovations::PredictedScan;
use crate::diagnosis::looks::MapInView;
use crate::landmark::{Gaussian, Measured, SensorPoses};
use crate::resampling::Resampler;
use crate::sighting::Seen;
use crate::workers::{PerThread, Workers};
use std::sync::mpsc::Sender;

/// What the stages of a step hand to each other, kept for its memory.
#[derive(Default)]
pub(super) struct Work {
    pub beliefs: Beliefs,
    /// Of the step's sightings, per particle.
    pub log_likelihood: Vec<f64>,
    pub resampler: Resampler,
    pub ancestor_indices: Vec<u32>,
    pub associating: Associating,
    pub correcting: Correcting,
    pub examination: Examination,
    /// What the best particle took the sightings of the last scan for.
    pub seen: Vec<Seen>,
    /// Landmarks of the map that the scan should have shown, where that was looked at.
    pub map_in_view: Option<MapInView>,
    pub judging: Judging,
    pub imagining: Imagining,
    pub draws: Draws,
}

/// What imagined runs see.
#[derive(Default)]
pub(super) struct Imagining {
    /// Sightings of all rounds with the slot of the landmark that the best particle took them for.
    pub shown: Vec<Shown>,
    pub scan: Vec<Linear>,
    pub noise: Vec<Noise>,
}

/// Draws between two steps, of which somebody on another thread may want to hear.
#[derive(Default)]
pub(super) struct Draws {
    /// That which the step has left to a filter beside this one.
    pub asked: Option<Box<Asked>>,
    /// How many were begun.
    pub count: u32,
    /// Landmarks that went over into others in them, and that nobody has told of yet.
    pub merged: u32,
    pub hear: Option<Sender<Heard>>,
}

impl Draws {
    /// One more begins.
    pub fn begin(&mut self) {
        self.count += 1;
        self.tell(Heard::Begun);
    }

    /// Tells it to whoever still hears.
    pub fn tell(&self, what: Heard) {
        self.hear.iter().for_each(|hear| hear.send(what).unwrap_or_default());
    }
}

/// What is heard of a filter on another thread.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Heard {
    /// A draw begins.
    Begun,
    /// A call is done.
    Done,
}

/// A draw that is done beside the filter.
pub(super) struct Asked {
    /// With the past, which the filter has no more.
    pub state: State,
    pub moment: Moment,
}

/// When a step finds that it needs a draw.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Moment {
    /// Before it decides about the scan.
    BeforeScan,
    /// After all.
    AfterScan,
}

/// What deciding about a scan needs.
#[derive(Default)]
pub(super) struct Associating {
    /// Landmarks that the scan may show.
    pub slots: Vec<u32>,
    /// The same with their rows.
    pub table: CandidateTable,
    /// Candidates of each sighting that may not exist.
    pub doubtful: Vec<Vec<u32>>,
    /// How well the candidates fit.
    pub fits: FitTable,
    pub deciding: PerThread<(fast::Workspace, Scratch)>,
    /// What each particle decided about the scan, an equal share each.
    pub decisions: Vec<Decision>,
    pub former_decisions: Vec<Decision>,
    /// Where all sightings name their landmark, its slot for each; none where it is new.
    pub named: Vec<Option<u32>>,
    /// For one sighting, the numbers of the decisions.
    pub decided: Vec<u32>,
}

impl Associating {
    /// What the particles decided about a scan.
    pub fn claims<'a>(&'a self, scan: &'a [ScanSighting]) -> Claims<'a> {
        Claims { scan, decisions: &self.decisions, table: &self.table }
    }
}

/// What every particle claims that a scan shows: decisions, an equal share each, about the candidates of a table.
#[derive(Clone, Copy, Debug)]
pub(super) struct Claims<'a> {
    pub scan: &'a [ScanSighting],
    pub decisions: &'a [Decision],
    pub table: &'a CandidateTable,
}

impl<'a> Claims<'a> {
    /// The decisions of one particle.
    pub fn of(&self, particle: usize) -> &'a [Decision] {
        &self.decisions[particle * self.scan.len()..][..self.scan.len()]
    }
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
    /// Landmarks that there were before the scan.
    pub first_birth: u64,
    /// Sightings of the scan that founded a landmark in some map, with its slot.
    pub founded: Vec<(usize, u32)>,
    /// Log-likelihood of the scan's sighting of every candidate in every map; only where existence follows Bayes' rule.
    pub sighting_densities: Vec<f64>,
}

/// What judging a scan needs to remember; kept for its memory.
#[derive(Debug, Default)]
pub(super) struct Judging {
    pub in_reach: Vec<u32>,
    /// Whether a particle took some sighting for a candidate: one entry per particle, for each candidate in turn.
    pub sighted: Vec<bool>,
    pub verdicts: Verdicts,
    /// Looks at the landmarks in view, and one of them in one map.
    pub looks: Vec<Look>,
    pub row: Vec<f64>,
    pub dead: Vec<bool>,
    /// Sine and cosine of the directions in which the sensors look.
    pub directions: [Vec<f64>; 2],
}

/// What a scan says about a landmark in every map.
#[derive(Debug, Default)]
pub(super) struct Verdicts {
    /// Whether it was surely in view, or sighted.
    pub judged: Vec<bool>,
    /// Whether it was sighted, and the log-likelihood of that.
    pub sighted: Vec<bool>,
    pub densities: Vec<f64>,
}

/// Particles that stand for all; evenly spaced, so that they come from different ancestors.
pub(super) const SUBSET: usize = 16;

/// A sighting with the landmark that it shows, as each particle of the subset has it.
pub(super) type Pair = (Measured, [Option<Gaussian>; SUBSET]);

/// What an examination needs to remember; kept for its memory.
#[derive(Debug, Default)]
pub(super) struct Examination {
    /// Sightings of known landmarks with the births of these.
    pub matches: Vec<([f64; 2], u64)>,
    /// The same sightings by number, with the slot or the candidate.
    pub known: Vec<(usize, u32)>,
    /// Whether a candidate was sighted.
    pub sighted: Vec<bool>,
    pub particles: Vec<usize>,
    pub pairs: Vec<Pair>,
    pub predictions: Vec<Prediction>,
    pub in_reach: Vec<u32>,
    pub row: Vec<f64>,
}

/// What one particle predicts of the sightings of a scan.
#[derive(Debug)]
pub(super) struct Prediction {
    pub weight: f64,
    pub scan: PredictedScan,
}

impl Work {
    /// For so many threads.
    pub fn new(workers: &Workers) -> Self {
        let associating = Associating { deciding: PerThread::new(workers), ..Associating::default() };
        Self { associating, ..Self::default() }
    }
}
