//! What a step needs of those before it: all that a snapshot holds.

use super::gauge::Gauge;
use super::past::Past;
use super::place::Place;
use super::sensing::Calibration;
use crate::config::Config;
use crate::diagnosis::health::{View, Watch};
use crate::diagnosis::NoiseReport;
use crate::filter::{Particles, PoseEstimate};
use crate::motion::MotionGaussian;
use crate::path::PathForest;
use crate::resampling::follow;
use crate::weights::Weights;
use rustc_hash::FxHashMap;
use serde::{Deserialize, Serialize};

/// A landmark that all maps hold.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(super) struct Name {
    pub identity: u32,
    pub sightings: u32,
}

/// The slot of what no landmark was seen in.
pub(super) const NOTHING: u32 = u32::MAX;

/// What takes the place of names where sightings have none: every particle decides what they show, until a draw makes what the
/// likeliest one decided that of all.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Unnamed {
    /// By particle, then by slot: running numbers of creation.
    pub births: Vec<Vec<u64>>,
    /// By particle: the slots that it took the sightings since the last draw for.
    pub claims: Vec<Vec<u32>>,
    /// Number of the next landmark.
    pub next_birth: u64,
}

impl Unnamed {
    /// So many particles with empty maps.
    pub fn new(particles: usize) -> Self {
        Self { births: vec![Vec::new(); particles], claims: vec![Vec::new(); particles], next_birth: 0 }
    }

    /// Particle i becomes a copy of the former particle `ancestors[i]`.
    pub fn resample(&mut self, ancestors: &[u32]) {
        self.births = ancestors.iter().map(|a| self.births[*a as usize].clone()).collect();
        self.claims = ancestors.iter().map(|a| self.claims[*a as usize].clone()).collect();
    }

    /// Sightings of a landmark of a particle; `names` counts those before the last draw.
    pub fn sightings_of(&self, particle: usize, slot: usize, names: &[Name]) -> u32 {
        let lately = self.claims[particle].iter().filter(|claim| **claim == slot as u32).count() as u32;
        names.get(slot).map_or(0, |name| name.sightings) + lately
    }
}

/// What belongs to particles and changes in every step.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Cloud {
    pub particles: Particles,
    pub calibrations: Vec<Calibration>,
    /// By particle, then by slot.
    pub maps: Vec<Vec<Place>>,
    pub weights: Weights,
    /// By slot.
    pub names: Vec<Name>,
    /// Motion since the last sampling of the poses.
    pub pending: MotionGaussian,
    pub estimate: PoseEstimate,
    /// How uncertain it is where all of it lies together.
    pub gauge: Gauge,
}

/// How often something was done: numbers the random streams.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub(super) struct Counters {
    pub samplings: u64,
    pub steps: u64,
    pub draws: u64,
    /// Steps of the path at the last draw.
    pub drawn_at: u64,
}

/// The filter between two steps.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct State {
    pub cloud: Cloud,
    pub slot_of: FxHashMap<u32, u32>,
    pub path: PathForest,
    pub past: Past,
    /// Where sightings have no names; a snapshot has it behind the rest.
    #[serde(skip)]
    pub unnamed: Option<Unnamed>,
    pub counters: Counters,
    /// Whether all this can be believed.
    pub watch: Watch,
    pub noise_report: NoiseReport,
}

/// All of a state that a step changes before it can fail.
pub(super) struct Before {
    cloud: Cloud,
    slot_of: FxHashMap<u32, u32>,
    /// Where the step ends with a draw, which can fail.
    path: Option<PathForest>,
    /// Motions and sightings of the past.
    lengths: (usize, usize),
    unnamed: Option<Unnamed>,
    counters: Counters,
    watch: Watch,
    noise_report: NoiseReport,
}

impl State {
    /// What [`State::go_back`] needs.
    pub fn before(&self, draws: bool) -> Before {
        Before {
            cloud: self.cloud.clone(),
            slot_of: self.slot_of.clone(),
            path: draws.then(|| self.path.clone()),
            lengths: (self.past.motions.len(), self.past.sightings.len()),
            unnamed: self.unnamed.clone(),
            counters: self.counters,
            watch: self.watch.clone(),
            noise_report: self.noise_report,
        }
    }

    /// Undoes a step that failed.
    pub fn go_back(&mut self, before: Before) {
        let Before { cloud, slot_of, path, lengths, unnamed, counters, watch, noise_report } = before;
        self.past.cut(lengths);
        self.unnamed = unnamed;
        self.path = path.unwrap_or_else(|| std::mem::take(&mut self.path));
        (self.cloud, self.slot_of, self.counters) = (cloud, slot_of, counters);
        (self.watch, self.noise_report) = (watch, noise_report);
    }

    /// At the configured initial pose with empty maps.
    pub fn new(config: &Config, calibrations: Vec<Calibration>) -> Self {
        let (start, count) = (config.initial_pose.T_world_robot(), calibrations.len());
        Self {
            cloud: Cloud {
                particles: Particles::at(start, count),
                calibrations,
                maps: vec![Vec::new(); count],
                weights: Weights { values: vec![1.0 / count as f64; count], ..Weights::default() },
                names: Vec::new(),
                pending: MotionGaussian::default(),
                estimate: PoseEstimate { mean: start, ..PoseEstimate::default() },
                gauge: Gauge::default(),
            },
            slot_of: FxHashMap::default(),
            path: PathForest::new(count),
            past: Past::default(),
            unnamed: None,
            counters: Counters::default(),
            watch: Watch::new(config.health, View::of(config)),
            noise_report: NoiseReport::default(),
        }
    }
}

impl Cloud {
    /// Particle i becomes a copy of the former particle `ancestors[i]`; all weights are equal then.
    pub fn resample(&mut self, ancestors: &[u32]) {
        self.particles.resample(ancestors);
        follow(&mut self.calibrations, ancestors, &mut Vec::new());
        self.maps = ancestors.iter().map(|a| self.maps[*a as usize].clone()).collect();
        self.restart_weights();
    }

    /// All weights are equal.
    pub fn restart_weights(&mut self) {
        self.particles.log_weight.fill(0.0);
        self.weights.restart(self.particles.len());
    }

    /// An estimate by the particles, as uncertain as they are all together.
    pub fn take_estimate(&mut self, mut estimate: PoseEstimate) {
        let more = self.gauge.of_pose([estimate.mean.x, estimate.mean.y]);
        estimate.covariance = crate::normal::sum(&estimate.covariance, &more);
        self.estimate = estimate;
    }

    /// A sighting of this likelihood was made by a particle.
    pub fn weigh(&mut self, particle: usize, log_likelihood: f64) {
        self.particles.log_weight[particle] += log_likelihood;
        self.particles.score[particle] += log_likelihood;
    }
}
