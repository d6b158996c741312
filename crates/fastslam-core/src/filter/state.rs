//! What a step needs of those before it: all that a snapshot holds.

use super::errors::Errors;
use super::eyes::Eyes;
use super::given::Given;
use super::landmarks::Landmarks;
use super::merger::Merger;
use super::need::{Need, Returns};
use super::particles::{Particles, PoseEstimate};
use super::settings::Algorithm;
use crate::association::Belief;
use crate::config::Config;
use crate::diagnosis::health::{View, Watch};
use crate::diagnosis::NoiseReport;
use crate::geometry::Pose;
use crate::motion::{MotionByNoise, MotionGaussian};
use crate::path::PathForest;
use crate::smoothing::History;
use crate::weights::Weights;
use serde::{Deserialize, Serialize};

/// The filter between two steps.
#[derive(Clone, Serialize, Deserialize)]
pub(super) struct State {
    pub particles: Particles,
    pub weights: Weights,
    /// The maps.
    pub landmarks: Landmarks,
    pub path: PathForest,
    /// What is remembered to draw paths anew; only when that is configured.
    pub rejuvenation: Option<Rejuvenation>,
    pub motions: Motions,
    pub counters: Counters,
    pub merger: Merger,
    /// Whether the numbers so far are of ordinary size.
    pub sizes: Sizes,
    pub diagnosis: Diagnosis,
    pub estimate: PoseEstimate,
    /// What the filter began with; behind the others in a snapshot, which older formats did not have.
    #[serde(skip)]
    pub given: Given,
}

/// Motion that the poses on the path do not know of yet.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(super) struct Motions {
    /// Since the last sampling of the poses, the same for all particles (FastSLAM 2.0).
    pub pending: MotionGaussian,
    /// Since the last scan, for the noise check.
    pub since_scan: MotionByNoise,
}

/// Whether all this can be believed.
#[derive(Clone, Serialize, Deserialize)]
pub(super) struct Diagnosis {
    pub watch: Watch,
    /// What the sliding window said of the noise when it was last looked at.
    pub noise_report: NoiseReport,
    /// What is known of each of several sensors; behind the others in a snapshot, which older formats did not have.
    #[serde(skip)]
    pub eyes: Eyes,
}

/// How large the numbers are that the steps so far have put into the state.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Sizes {
    /// The largest variance of a place that was taken in, square metres.
    pub coarsest_m2: f64,
    /// Whether some step was not ordinary; its numbers are still there.
    pub was_exceeded: bool,
}

/// How often something was done: numbers the random streams.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub(super) struct Counters {
    pub controls: u64,
    pub samplings: u64,
    pub steps: u64,
}

/// When to rejuvenate, and what is remembered for it.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(super) struct Rejuvenation {
    pub history: History,
    /// Steps at the last time.
    pub last: usize,
    /// How often it was done: numbers the random streams.
    pub count: u64,
    /// Landmarks that went over into others at the last time.
    pub merged: u32,
    /// Where draws follow need, what that needs.
    pub need: Option<Need>,
    /// What names say of drift; behind the others in a snapshot, which older formats did not have.
    #[serde(skip)]
    pub returns: Returns,
    /// How wrong the pose may be; behind the others in a snapshot, which older formats did not have.
    #[serde(skip)]
    pub errors: Errors,
    /// Follows from the configuration, and from whether a draw is under way.
    #[serde(skip)]
    pub drawing: Drawing,
}

/// Who draws between two steps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Drawing {
    /// The step that asks for it.
    #[default]
    InPlace,
    /// A filter beside this one, to which the step hands the past over.
    Beside,
    /// Nobody: that filter is at it.
    UnderWay,
}

impl Drawing {
    /// As it is configured.
    pub fn of(config: &Config) -> Self {
        match config.filter.rejuvenation.delay_scans {
            0 => Self::InPlace,
            _ => Self::Beside,
        }
    }
}

impl Rejuvenation {
    /// What the configuration asks for; `None` where paths are never drawn anew.
    fn of(config: &Config) -> Option<Self> {
        let by_need = match config.filter.rejuvenation.every_steps {
            Some(0) => return None,
            Some(_) => false,
            None => true,
        };
        let need = by_need.then(|| Need::new(config.initial_pose.T_world_robot()));
        let particles = config.filter.particles as usize;
        let (history, errors, drawing) = (History::new(particles), Errors::new(particles), Drawing::of(config));
        Some(Self { history, need, errors, drawing, ..Self::default() })
    }
}

/// The maps of all particles, and what decides what may happen to their landmarks.
pub(super) struct Maps<'a> {
    pub particles: &'a mut Particles,
    pub landmarks: &'a mut Landmarks,
    pub given: &'a Given,
}

impl Maps<'_> {
    /// Whether nothing may change the landmark of a slot.
    pub fn is_fixed(&self, slot: u32) -> bool {
        !self.given.landmarks.is_empty() && self.given.is_fixed(self.landmarks.birth(slot))
    }

    /// Takes a landmark out of the maps that `mask` marks, which hold it.
    pub fn lose(&mut self, slot: u32, mask: &[bool]) {
        self.landmarks.clear_rows(slot, mask);
        let counts = self.particles.landmarks.iter_mut().zip(mask);
        counts.for_each(|(count, lost)| *count -= u32::from(*lost));
        if self.landmarks.holders(slot) == 0 {
            self.landmarks.remove(slot);
        }
    }
}

impl State {
    /// Where the path begins.
    pub fn start(&self, config: &Config) -> Pose {
        self.given.start.unwrap_or_else(|| config.initial_pose.T_world_robot())
    }

    /// What a particle believes of the pose before a scan.
    pub fn belief_of(&self, algorithm: Algorithm, particle: usize) -> Belief {
        let pose = self.particles.pose(particle);
        match algorithm {
            Algorithm::Fastslam1 => Belief { mean: pose, covariance: [[0.0; 3]; 3] },
            _ => Belief {
                mean: pose.compose(self.motions.pending.mean),
                covariance: self.motions.pending.covariance_in_world(pose.heading),
            },
        }
    }

    /// Lets the sensor with this number look.
    pub fn look_with(&mut self, sensor: usize) {
        let Self { diagnosis: Diagnosis { watch, eyes, .. }, landmarks, .. } = self;
        eyes.turn_to(sensor, |eye| eye.swap(watch, landmarks.fading.as_mut()));
    }

    /// The maps with what decides about them.
    pub fn maps(&mut self) -> Maps<'_> {
        Maps { particles: &mut self.particles, landmarks: &mut self.landmarks, given: &self.given }
    }

    /// At the configured initial pose, with these maps.
    pub fn new(config: &Config, landmarks: Landmarks) -> Self {
        let (start, particles) = (config.initial_pose.T_world_robot(), config.filter.particles as usize);
        Self {
            particles: Particles::at(start, particles),
            weights: Weights { values: vec![1.0 / particles as f64; particles], ..Weights::default() },
            landmarks,
            path: PathForest::new(particles),
            rejuvenation: Rejuvenation::of(config),
            motions: Motions::default(),
            counters: Counters::default(),
            merger: Merger::default(),
            sizes: Sizes::default(),
            diagnosis: Diagnosis {
                watch: Watch::new(config.health, View::of(config)),
                noise_report: NoiseReport::default(),
                eyes: Eyes::default(),
            },
            estimate: PoseEstimate { mean: start, ..PoseEstimate::default() },
            given: Given::default(),
        }
    }
}
