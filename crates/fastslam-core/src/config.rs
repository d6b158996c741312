//! The one configuration schema. Python and the command line read it from here.

pub use crate::association::{
    AssociationConfig, AssociationMode, AssociationOrder, Classes, Exclusion, ExistenceConfig, ExistenceForm, Merging,
    MergingRule, Method, Removal, Signatures,
};
use crate::error::{coordinate, finite, fraction, positive, Error, Result};
pub use crate::filter::settings::{
    AdaptiveConfig, Algorithm, FilterConfig, ParticleNumber, RejuvenationConfig, ResamplingConfig,
};
use crate::geometry::Pose;
use crate::measurement::{Sensor, Sensors};
use crate::motion::Motion;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Everything that determines a run, given its log.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    /// Seed of all random numbers: the same seed gives the same bits.
    pub seed: u64,
    /// Which filter.
    pub algorithm: Algorithm,
    /// Particles, resampling and storage.
    pub filter: FilterConfig,
    /// How the robot moves.
    pub motion: Motion,
    /// What the robot sees with.
    pub sensor: Sensor,
    /// In place of `sensor`, where the robot has several: a section like `sensor` for each, under its name. Each sighting
    /// then says which of them made it. One of them at least measures range and bearing (`model: range_bearing`) and finds
    /// the landmarks; others may measure ranges or bearings of these alone.
    #[serde(skip_serializing_if = "Sensors::is_empty")]
    pub sensors: Sensors,
    /// Which landmark a sighting belongs to.
    pub association: AssociationConfig,
    /// Where the robot starts; it defines the world frame.
    pub initial_pose: InitialPose,
    /// From where on the filter says that it should not be believed; changes no estimate.
    pub health: HealthConfig,
}

/// From where on the filter says that it should not be believed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct HealthConfig {
    /// Scans (steps with sightings) over which most of what follows is averaged.
    pub window_scans: u32,
    /// Degraded when squared innovations, normalised, are on average this many times what the noise explains; lost
    /// from four times as many.
    pub largest_innovation_ratio: f64,
    /// Degraded when the effective sample size is on average below this fraction of ten or more particles.
    pub smallest_effective_fraction: f64,
    /// Degraded when nothing was sighted for longer than this.
    pub longest_blindness_s: f64,
    /// Degraded when this fraction of the sightings shows no known landmark where known ones should be in view; lost
    /// halfway from here to all.
    pub largest_unexplained_fraction: f64,
    /// Degraded when the landmarks of the map in view are sighted this many times as often as usual, or less.
    pub smallest_detection_ratio: f64,
    /// Degraded when the position's standard deviation along its longest axis is above this; lost from three times as
    /// much.
    pub largest_position_std_m: f64,
    /// Degraded when the heading's standard deviation is above this; lost from three times as much.
    pub largest_heading_std_rad: f64,
}

impl Default for HealthConfig {
    fn default() -> Self {
        Self {
            window_scans: 20,
            largest_innovation_ratio: 4.0,
            smallest_effective_fraction: 0.02,
            longest_blindness_s: 10.0,
            largest_unexplained_fraction: 0.6,
            smallest_detection_ratio: 0.4,
            largest_position_std_m: 5.0,
            largest_heading_std_rad: 0.3,
        }
    }
}

/// A pose of the robot in the world.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct InitialPose {
    /// East or along the map's first axis.
    pub x_m: f64,
    /// North or along the map's second axis.
    pub y_m: f64,
    /// Counter-clockwise from the first axis.
    pub heading_rad: f64,
}

impl InitialPose {
    /// As a transform.
    pub fn T_world_robot(&self) -> Pose {
        Pose::new(self.x_m, self.y_m, crate::math::wrap_angle(self.heading_rad))
    }
}

impl Config {
    /// Errors that name the first key out of range.
    pub fn validate(&self) -> Result<()> {
        self.filter.validate().map_err(|e| e.within("filter"))?;
        self.motion.validate()?;
        self.validate_sensors()?;
        self.association.validate().map_err(|e| e.within("association"))?;
        if self.algorithm == Algorithm::Ekf {
            self.association.validate_for_ekf().map_err(|e| e.within("association"))?;
        }
        coordinate("initial_pose.x_m", self.initial_pose.x_m)?;
        coordinate("initial_pose.y_m", self.initial_pose.y_m)?;
        finite("initial_pose.heading_rad", self.initial_pose.heading_rad)?;
        self.health.validate().map_err(|e| e.within("health"))
    }
}

impl Config {
    fn validate_sensors(&self) -> Result<()> {
        if !self.sensors.is_empty() && self.sensor != Sensor::default() {
            let expected = "one of the two: `sensor` is the only sensor, `sensors` has a section for each of several";
            return Err(Error::parameter("sensors", "`sensor` beside it", expected));
        }
        self.sensor.validate()?;
        self.sensors.validate()
    }

    /// The sensors, in the order of their numbers.
    pub fn each_sensor(&self) -> Vec<&Sensor> {
        match self.sensors.is_empty() {
            true => vec![&self.sensor],
            false => self.sensors.0.values().collect(),
        }
    }

    /// An error unless there is a sensor with this number.
    pub fn check_sensor(&self, sensor: usize) -> Result<()> {
        let count = self.sensors.0.len().max(1);
        if sensor < count {
            return Ok(());
        }
        Err(Error::Input(format!(
            "a scan of sensor {sensor}, expected less than {count}: `sensors` says how many there are"
        )))
    }

    /// The same with this one for its only sensor.
    pub(crate) fn seeing_with(&self, sensor: &Sensor) -> Self {
        Self { sensor: sensor.clone(), sensors: Sensors::default(), ..self.clone() }
    }
}

impl HealthConfig {
    fn validate(&self) -> Result<()> {
        if self.window_scans == 0 {
            return Err(Error::parameter("window_scans", 0, "at least 1"));
        }
        positive("largest_innovation_ratio", self.largest_innovation_ratio)?;
        fraction("smallest_effective_fraction", self.smallest_effective_fraction)?;
        positive("longest_blindness_s", self.longest_blindness_s)?;
        fraction("largest_unexplained_fraction", self.largest_unexplained_fraction)?;
        fraction("smallest_detection_ratio", self.smallest_detection_ratio)?;
        positive("largest_position_std_m", self.largest_position_std_m)?;
        positive("largest_heading_std_rad", self.largest_heading_std_rad)?;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_defaults_are_valid() {
        assert_eq!(Config::default().validate(), Ok(()));
    }

    #[test]
    fn unknown_keys_are_rejected_at_every_level() {
        for text in [
            r#"{"sead": 1}"#,
            r#"{"filter": {"partikles": 1}}"#,
            r#"{"motion": {"model": "velocity", "wheelbase_m": 1}}"#,
            r#"{"sensor": {"mounting": {"z_m": 1}}}"#,
        ] {
            assert!(serde_json::from_str::<Config>(text).is_err(), "{text}");
        }
    }

    #[test]
    fn the_key_of_a_bad_value_is_named() {
        let mut config = Config::default();
        config.sensor.change(|s| s.range_std_m = 0.0);
        assert_eq!(
            config.validate().map_err(|e| e.to_string()),
            Err("sensor.range_std_m: got 0, expected a finite number above 0 (1e-12 to 1e6)".into())
        );
        let mut config = Config::default();
        config.sensor.change(|s| s.max_range_m = 20.0);
        config.sensors.0.insert("rear".into(), Sensor::default());
        assert_eq!(
            config.validate().map_err(|e| e.to_string()),
            Err("sensors: got `sensor` beside it, expected one of the two: `sensor` is the only sensor, `sensors` has a \
                 section for each of several"
                .into())
        );
        let mut config = Config::default();
        config.filter.resampling.threshold = 1.5;
        assert_eq!(
            config.validate().map_err(|e| e.to_string()),
            Err("filter.resampling.threshold: got 1.5, expected 0 to 1".into())
        );
    }
}
