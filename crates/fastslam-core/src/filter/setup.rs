//! What no step changes.

use super::settings::Algorithm;
use crate::association::{Identities, Rules};
use crate::config::Config;
use crate::error::{Error, Result};
use crate::geometry::Pose;
use crate::measurement::Placing;
use crate::random::RandomSource;
use crate::workers::Workers;

/// What no step changes: how the robot sees, what was configured, and the threads.
#[derive(Clone)]
pub(super) struct Setup<M> {
    pub models: Models<M>,
    pub settings: Settings,
    pub workers: Workers,
}

/// How the robot sees.
#[derive(Clone, Debug)]
pub(super) struct Models<M> {
    pub measurement: M,
    pub T_robot_sensor: Pose,
    /// How far the sensor stands from the robot's origin.
    pub lever_arm_m: f64,
}

/// What was configured, with what follows from it.
#[derive(Clone, Debug)]
pub(super) struct Settings {
    pub config: Config,
    pub identities: Identities,
    pub rules: Rules,
    /// Reach of the association in standard deviations.
    pub gate_radius: f64,
    pub random: RandomSource,
}

impl<M: Placing> Setup<M> {
    /// For a configuration and a measurement model; `identities` says which sightings will come with one.
    pub fn new(config: Config, identities: Identities, measurement: M) -> Result<Self> {
        config.validate()?;
        if config.algorithm == Algorithm::Ekf {
            return Err(Error::parameter("algorithm", "ekf", "fastslam1 or fastslam2; EKF-SLAM is a type of its own"));
        }
        let identities = identities.heeding(config.association.mode);
        let rules = Rules::new(&config, &measurement);
        let gate_radius = rules.gate_radius(&measurement, config.sensor.tail());
        let workers = Workers::new(config.filter.threads)?;
        let T_robot_sensor = config.sensor.T_robot_sensor();
        let models = Models { measurement, T_robot_sensor, lever_arm_m: T_robot_sensor.x.hypot(T_robot_sensor.y) };
        let random = RandomSource::new(config.seed);
        Ok(Self { models, settings: Settings { config, identities, rules, gate_radius, random }, workers })
    }

    /// Size of a cell of the index of landmarks: about as far as one of them is looked for.
    pub fn cell_m(&self) -> f64 {
        (4.0 * self.settings.gate_radius * self.models.measurement.noise_covariance().xx.sqrt()).clamp(0.5, 20.0)
    }
}
