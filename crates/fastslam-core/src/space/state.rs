//! What a step needs of those before it.

use super::estimate::SpaceEstimate;
use super::map::Slot;
use super::motion::SpaceMotion;
use super::past::Past;
use super::pose::SpacePose;
use super::settings::{SpaceConfig, SpaceMotionKind, SpaceMotionNoise};
use super::track::{self, Track};
use super::wander::Ahead;
use super::wide::{Wide, LANES};
use crate::path::PathForest;
use crate::weights::Weights;
use rustc_hash::FxHashMap;
use serde::{Deserialize, Serialize};

/// The filter between two steps.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct State {
    /// Of the particles, [`LANES`] side by side.
    pub poses: Vec<SpacePose<Wide>>,
    /// Since the last resampling; of the particles alone.
    pub log_weight: Vec<f64>,
    /// As the last step left them.
    pub weights: Weights,
    /// The landmarks.
    pub slots: Vec<Slot>,
    /// Where a name stands in them.
    pub slot_of: FxHashMap<u32, u32>,
    /// Motion since the poses were last sampled.
    pub pending: SpaceMotion,
    /// Velocities of the particles, where they wander; [`State::pending`] is then what was measured.
    pub track: Option<Track>,
    /// Paths of the particles, a pose per scan.
    pub path: PathForest<SpacePose>,
    /// What the least squares is over.
    pub past: Past,
    /// Where the robot was at the last scan.
    pub estimate: SpaceEstimate,
    /// How often something was done: numbers the random streams.
    pub counters: Counters,
}

/// How often something was done.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub struct Counters {
    /// Rounds of sightings.
    pub steps: u64,
    /// Draws anew.
    pub draws: u64,
    /// Scans at the last draw.
    pub drawn_at: u64,
}

impl State {
    /// At the start with empty maps.
    pub fn new(config: &SpaceConfig) -> Self {
        let count = config.filter.particles as usize;
        let start = config.initial_pose.pose();
        let mut weights = Weights::default();
        weights.restart(count);
        Self {
            poses: vec![start.constant(); count.div_ceil(LANES)],
            log_weight: vec![0.0; count],
            weights,
            slots: Vec::new(),
            slot_of: FxHashMap::default(),
            pending: SpaceMotion::default(),
            track: (config.motion.kind != SpaceMotionKind::Odometry).then(|| Track::new(&config.motion, count)),
            path: PathForest::new(count),
            past: Past::default(),
            estimate: SpaceEstimate { mean: start, covariance: [[0.0; 6]; 6] },
            counters: Counters::default(),
        }
    }

    /// Number of particles.
    pub fn particles(&self) -> usize {
        self.log_weight.len()
    }

    /// Where the next scan is looked for, if velocities wander.
    pub fn ahead(&self, noise: &SpaceMotionNoise) -> Option<Ahead> {
        Some(self.track.as_ref()?.ahead(noise, &self.pending, self.past.scans.is_empty()))
    }

    /// The motion since the last scan: of all particles together where their velocities differ.
    pub fn moved(&self, noise: &SpaceMotionNoise) -> SpaceMotion {
        let (Some(track), Some(ahead)) = (&self.track, self.ahead(noise)) else { return self.pending };
        let [velocity, spread] = track.moments(&self.weights.values);
        let way = std::array::from_fn(|i| ahead.way[i] + ahead.leg.reach_s[i].powi(2) * spread[i]);
        track::motion(&ahead.leg, &velocity, &way)
    }

    /// The likeliest particle.
    pub fn best(&self) -> usize {
        let better = |best: usize, i: usize| if self.weights.values[i] > self.weights.values[best] { i } else { best };
        (1..self.particles()).fold(0, better)
    }
}

/// The pose of one particle.
pub fn of_lane(pose: &SpacePose<Wide>, lane: usize) -> SpacePose {
    SpacePose {
        rotation: super::pose::Rotation { w: pose.rotation.w.0[lane], v: pose.rotation.v.map(|v| v.0[lane]) },
        position: pose.position.map(|v| v.0[lane]),
    }
}

/// A number of every particle, from blocks.
pub fn column(blocks: impl Iterator<Item = Wide>, count: usize) -> Vec<f64> {
    blocks.flat_map(|wide| wide.0).take(count).collect()
}
