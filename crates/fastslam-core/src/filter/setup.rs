//! What no step changes.

use super::settings::Algorithm;
use crate::association::{Identities, Rules};
use crate::config::Config;
use crate::error::{Error, Result};
use crate::geometry::Pose;
use crate::measurement::{Placing, Sensor};
use crate::random::RandomSource;
use crate::workers::Workers;
use std::sync::Arc;

/// What no step changes, for the scans of each sensor.
pub(super) struct Setups<M> {
    /// As it was given.
    pub config: Config,
    each: Vec<Setup<M>>,
}

impl<M: Placing> Setups<M> {
    /// For a configuration and the measurement models of its sensors; `identities` says which sightings will come with one.
    pub fn new(config: Config, identities: Identities, models: Vec<M>) -> Result<Self> {
        config.validate()?;
        if config.algorithm == Algorithm::Ekf {
            return Err(Error::parameter("algorithm", "ekf", "fastslam1 or fastslam2; EKF-SLAM is a type of its own"));
        }
        let sensors = config.each_sensor();
        if sensors.len() != models.len() {
            let expected = format!("as many as measurement models ({})", models.len());
            return Err(Error::parameter("sensors", sensors.len(), expected));
        }
        let workers = Workers::new(config.filter.threads)?;
        let mountings: Arc<[Pose]> = sensors.iter().map(|sensor| sensor.T_robot_sensor()).collect();
        let all: Arc<[M]> = models.into();
        let setup = |(number, sensor): (usize, &&Sensor)| {
            let models = Models::new(number, &all, &mountings);
            let settings = Settings::new(config.seeing_with(sensor), identities, models.measurement());
            Setup { models, settings, workers: workers.clone() }
        };
        let each = sensors.iter().enumerate().map(setup).collect();
        Ok(Self { config, each })
    }

    /// The largest reach of the association in standard deviations.
    pub fn gate_radius(&self) -> f64 {
        self.each.iter().map(|setup| setup.settings.gate_radius).fold(0.0, f64::max)
    }

    /// Size of a cell of the index of landmarks: about as far as one of them is looked for.
    pub fn cell_m(&self) -> f64 {
        self.each.iter().filter(|setup| setup.models.measurement().places()).map(Setup::cell_m).fold(0.5, f64::max)
    }
}

impl<M> Setups<M> {
    /// One for each sensor.
    pub fn each(&self) -> &[Setup<M>] {
        &self.each
    }

    /// That of the first sensor, for what does not depend on it.
    pub fn first(&self) -> &Setup<M> {
        &self.each[0]
    }

    /// That of the sensor with this number, which there must be.
    pub fn of(&self, sensor: usize) -> &Setup<M> {
        &self.each[sensor]
    }
}

/// What no step changes: how a sensor of the robot sees, what was configured, and the threads.
#[derive(Clone)]
pub(super) struct Setup<M> {
    pub models: Models<M>,
    pub settings: Settings,
    pub workers: Workers,
}

/// How one sensor of the robot sees.
pub(super) struct Models<M> {
    /// Its number.
    pub sensor: usize,
    pub T_robot_sensor: Pose,
    /// How far the sensor stands from the robot's origin.
    pub lever_arm_m: f64,
    /// How all sensors measure, and where they sit.
    pub all: Arc<[M]>,
    pub mountings: Arc<[Pose]>,
}

// Derived, it would ask the measurement model for the same.
impl<M> Clone for Models<M> {
    fn clone(&self) -> Self {
        Self { all: Arc::clone(&self.all), mountings: Arc::clone(&self.mountings), ..*self }
    }
}

/// What was configured, with what follows from it; of several sensors, as if it were for this one alone.
#[derive(Clone, Debug)]
pub(super) struct Settings {
    pub config: Config,
    pub identities: Identities,
    pub rules: Rules,
    /// Reach of the association in standard deviations.
    pub gate_radius: f64,
    pub random: RandomSource,
}

impl<M> Models<M> {
    fn new(sensor: usize, all: &Arc<[M]>, mountings: &Arc<[Pose]>) -> Self {
        let T_robot_sensor = mountings[sensor];
        let lever_arm_m = T_robot_sensor.x.hypot(T_robot_sensor.y);
        Self { sensor, T_robot_sensor, lever_arm_m, all: Arc::clone(all), mountings: Arc::clone(mountings) }
    }

    /// How this sensor measures.
    #[inline(always)]
    pub fn measurement(&self) -> &M {
        &self.all[self.sensor]
    }
}

impl Settings {
    fn new<M: Placing>(config: Config, identities: Identities, measurement: &M) -> Self {
        let identities = identities.heeding(config.association.mode);
        let rules = Rules::new(&config, measurement);
        let gate_radius = rules.gate_radius(measurement, measurement.tail(config.sensor.tail()));
        let random = RandomSource::new(config.seed);
        Self { config, identities, rules, gate_radius, random }
    }
}

impl<M: Placing> Setup<M> {
    fn cell_m(&self) -> f64 {
        (4.0 * self.settings.gate_radius * self.models.measurement().noise_covariance().xx.sqrt()).clamp(0.5, 20.0)
    }
}
