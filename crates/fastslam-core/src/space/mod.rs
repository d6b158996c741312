//! Three dimensions: a robot that turns and moves in space, and landmarks in space that are known by name.
//!
//! As in FastSLAM 2.0 a particle is a path with a map of independent landmarks. Poses are rotations with positions, and
//! uncertain by ξ in `T_world_robot Exp(ξ)` ([`pose`]): then a motion's covariance is the same in all particles, and a
//! sensor need only say how it sees a point of its own frame ([`sensor`]). Particles are worked on side by side
//! ([`wide`]). What is lost by resampling is drawn anew from the posterior over the whole path and map, which the least
//! squares over it describes ([`graph`], [`draw`]).
//!
//! **Source:** `montemerlo2003fastslam2` for the filter, `barfoot2017state` for perturbations of poses.

pub mod draw;
pub mod estimate;
pub mod graph;
pub mod learn;
pub mod look;
pub mod map;
pub mod matrix;
pub mod motion;
mod past;
pub mod pose;
pub mod propose;
mod run;
pub mod sensor;
pub mod settings;
mod sighting;
mod state;
mod step;
pub mod track;
pub mod wander;
pub mod wide;

pub use estimate::{SpaceEstimate, SpaceLandmark};
pub use pose::{Rotation, SpacePose, Twist};
pub use run::{run, Columns, SpaceLog, SpaceRun};
pub use settings::{SpaceConfig, SpaceMotionKind, SpaceSensorModel};
pub use sighting::SpaceSighting;
pub use step::SpaceStep;

use crate::error::Result;
use crate::random::{Purpose, RandomSource};
use crate::workers::Workers;
use graph::{Guess, Problem, Solution};
use learn::Ratios;
use look::{Eye, Seat};
use motion::SpaceMotion;
use sensor::Spatial;
use state::State;

/// The fall of χ² below which a least squares over the past is good enough to draw from, and to report.
const TO_DRAW: f64 = 0.1;
const TO_REPORT: f64 = 1e-6;

/// FastSLAM 2.0 in space.
///
/// ```
/// use fastslam_core::space::{sensor::Point, SpaceConfig, SpaceSighting, SpaceSlam};
/// let mut filter = SpaceSlam::new(SpaceConfig::default(), Point { position_std_m: [0.1; 3] })?;
/// filter.advance([1.0, 0.0, 0.0, 0.0, 0.0, 0.1], 0.5)?;
/// filter.update(0.5, &[SpaceSighting::named([2.0, 0.3, -0.4], 7)])?;
/// assert!((filter.landmarks()[0].place.mean[0] - 2.5).abs() < 0.1);
/// # Ok::<(), fastslam_core::error::Error>(())
/// ```
pub struct SpaceSlam<M> {
    config: SpaceConfig,
    model: M,
    seat: Seat,
    random: RandomSource,
    workers: Workers,
    state: State,
}

/// The path and the map that the whole log makes most probable.
#[derive(Clone, Debug)]
pub struct Smoothed {
    /// Stamps in seconds and `T_world_robot`.
    pub path: Vec<(f64, SpacePose)>,
    /// The map.
    pub landmarks: Vec<SpaceLandmark>,
    /// What the residuals say of the noise, where the least squares had a solution.
    pub ratios: Option<Ratios>,
    /// How well path and map are held together, where velocities wander and the least squares had a solution.
    pub hold: Option<Hold>,
}

/// How well a path and a map are held together by what was seen alone.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hold {
    /// χ² over its degrees of freedom.
    pub misfit: f64,
    /// [`Solution::shape_std_m`].
    pub shape_std_m: f64,
}

impl<M: Spatial> SpaceSlam<M> {
    /// At the configured pose with an empty map.
    ///
    /// **Errors:** an invalid configuration.
    pub fn new(config: SpaceConfig, model: M) -> Result<Self> {
        config.validate()?;
        let seat = Seat::new(config.sensor.mounting.pose());
        let (random, workers) = (RandomSource::new(config.seed), Workers::new(config.filter.threads)?);
        let state = State::new(&config);
        Ok(Self { config, model, seat, random, workers, state })
    }

    /// Moves the robot by a velocity in its own axes (m/s, rad/s) that holds for `dt_s`; what `motion.kind` says is not
    /// measured of it is not looked at.
    ///
    /// **Errors:** [`crate::error::Error::Input`] for one that no robot could have; the filter is then as it was.
    pub fn advance(&mut self, velocity: Twist, dt_s: f64) -> Result<()> {
        let wandering = wander::wanders(self.config.motion.kind);
        let measured = std::array::from_fn(|i| if wandering[i] { 0.0 } else { velocity[i] });
        let motion = SpaceMotion::of(&self.config.motion, measured, dt_s)?;
        self.state.pending = self.state.pending.then(&motion);
        if let Some(track) = &mut self.state.track {
            track.dt_s += dt_s;
        }
        Ok(())
    }

    /// Puts a pose on the path where nothing is seen, and returns it.
    pub fn glance(&mut self, stamp_s: f64) -> SpaceEstimate {
        self.state.past.between.push((stamp_s, self.state.moved(&self.config.motion).mean));
        self.predicted_pose()
    }

    /// How far the robot has turned since the last scan, or pose that it passed, as far as that was measured; at most π.
    pub fn turned_rad(&self) -> f64 {
        self.state.pending.mean.rotation.to_vector().iter().map(|v| v * v).sum::<f64>().sqrt()
    }

    /// Mean and covariance of the pose at the last scan.
    pub fn pose(&self) -> SpaceEstimate {
        self.state.estimate
    }

    /// Mean and covariance of the pose now.
    pub fn predicted_pose(&self) -> SpaceEstimate {
        self.state.estimate.after(&self.state.moved(&self.config.motion))
    }

    /// The map: moments over the particles.
    pub fn landmarks(&self) -> Vec<SpaceLandmark> {
        self.state.slots.iter().map(|slot| estimate::landmark(slot, &self.state.weights.values)).collect()
    }

    /// Path and map given all that was seen, in order of the names' first sightings; those of the likeliest particle
    /// where the least squares has no solution.
    pub fn smoothed(&self) -> Smoothed {
        let Some(solution) = self.solve(TO_REPORT) else {
            let poses = self.best_path();
            let path = self.state.past.filled(self.config.initial_pose.pose(), &poses);
            return Smoothed { path, landmarks: self.landmarks(), ratios: None, hold: None };
        };
        let path = self.state.past.filled(self.config.initial_pose.pose(), &solution.at.poses);
        let place = |n: usize| crate::normal::Normal {
            mean: solution.at.landmarks[n],
            covariance: solution.landmark_covariance(n),
        };
        let slots = self.state.slots.iter().enumerate();
        let landmarks = slots.map(|(n, slot)| SpaceLandmark {
            identity: slot.identity,
            sightings: slot.sightings,
            place: place(n),
        });
        let stream = self.random.stream(Purpose::Rejuvenation, u64::from(u32::MAX));
        let ratios = learn::ratios(&self.problem(), &solution, stream);
        Smoothed { path, landmarks: landmarks.collect(), ratios, hold: self.hold(&solution) }
    }

    fn hold(&self, solution: &Solution) -> Option<Hold> {
        self.state.track.as_ref()?;
        let (seen, places) = (self.state.past.sightings.len(), solution.at.landmarks.len());
        // The motion has as many residuals as poses and velocities have variables.
        let degrees = 3.0 * (seen.checked_sub(places).filter(|left| *left > 0)? as f64);
        Some(Hold { misfit: solution.cost / degrees, shape_std_m: solution.shape_std_m()? })
    }

    /// The least squares over all that happened, from the likeliest particle on; where velocities wander, from what it found
    /// last too, and the better of the two.
    ///
    /// **Why:** after a blind stretch particles lie far apart, and the likeliest of those that were just drawn may lie where
    /// the least squares finds another minimum.
    fn solve(&self, close_enough: f64) -> Option<Solution> {
        let best = self.state.best();
        let landmarks = self.state.slots.iter().map(|slot| slot.of(best).mean).collect();
        let likeliest = self.guess(self.best_path(), landmarks);
        let found = self.problem().solve(likeliest, close_enough);
        let Some(track) = &self.state.track else { return found };
        let mut landmarks = track.mode.landmarks.clone();
        let new = self.state.slots[landmarks.len()..].iter();
        landmarks.extend(new.map(|slot| estimate::landmark(slot, &self.state.weights.values).place.mean));
        let again = self.problem().solve(self.guess(track.mode.poses.clone(), landmarks), close_enough);
        match (found, again) {
            (Some(found), Some(again)) => Some(if again.cost <= found.cost { again } else { found }),
            (found, again) => found.or(again),
        }
    }

    fn guess(&self, poses: Vec<SpacePose>, landmarks: Vec<[f64; 3]>) -> Guess {
        let velocities = match self.state.track {
            Some(_) => track::along(&self.state.past.scans, self.config.initial_pose.pose(), &poses),
            None => Vec::new(),
        };
        Guess { poses, velocities, landmarks }
    }

    fn problem(&self) -> Problem<'_, M> {
        let start = self.config.initial_pose.pose();
        Problem { eye: self.eye(), start, past: &self.state.past }
    }

    fn eye(&self) -> Eye<'_, M> {
        Eye { model: &self.model, seat: &self.seat }
    }

    /// Poses of the likeliest particle at the scans.
    fn best_path(&self) -> Vec<SpacePose> {
        self.state.path.path(self.state.best()).into_iter().map(|(_, pose)| pose).collect()
    }
}
