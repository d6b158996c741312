//! The sensor of a run: one of the models, with what that needs.

use super::{Mounting, RangeBearing, RangeOnly, SensorModel, SensorSettings, SystematicError};
use crate::density::Tail;
use crate::error::{Error, Result};
use crate::geometry::Pose;
use schemars::{JsonSchema, Schema, SchemaGenerator};
use serde::{Deserialize, Serialize};
use std::borrow::Cow;

/// What is expected where there is no sensor of one's own.
pub(crate) const EXPECTED_OF_OWN: &str =
    "range_bearing, range or bearing where no sensor of one's own is given (`sensor=`)";

/// The sensor of a run.
///
/// In files it is the flat section [`SensorSettings`], of which it keeps what its model has.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(from = "SensorSettings", tag = "model", rename_all = "snake_case")]
pub enum Sensor {
    /// Distance and direction of a landmark.
    RangeBearing(RangeBearingSensor),
    /// Distance of a landmark alone.
    Range(RangeSensor),
    /// Direction of a landmark alone.
    Bearing(BearingSensor),
    /// A sensor of one's own, from Python: only together with one.
    Own(OwnSensor),
}

/// What all sensors have.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Common {
    /// Sightings nearer than this are skipped and counted.
    pub min_range_m: f64,
    /// Sightings farther than this are skipped and counted.
    pub max_range_m: f64,
    /// Full opening angle, centred straight ahead of the sensor.
    pub field_of_view_rad: f64,
    /// Degrees of freedom of the noise (Student's t); Gaussian without.
    pub tail_degrees_of_freedom: Option<f64>,
    /// How late the stamps of sightings are against those of the odometry.
    pub delay_s: f64,
    /// Pose of the sensor on the robot.
    pub mounting: Mounting,
}

/// A sensor of distances and directions.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RangeBearingSensor {
    /// The model with its noise.
    #[serde(flatten)]
    pub model: RangeBearing,
    /// What it is off by.
    #[serde(flatten)]
    pub error: SystematicError,
    /// Limits, tail, delay and mounting.
    #[serde(flatten)]
    pub common: Common,
}

/// Scale and bias of ranges, and how uncertain these are.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct RangeErrors {
    /// Reported metres per metre.
    pub range_scale: f64,
    /// Added to every range.
    pub range_bias_m: f64,
    /// Standard deviation of the scale, where somebody says it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub range_scale_std: Option<f64>,
    /// Standard deviation of the bias, where somebody says it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub range_bias_std_m: Option<f64>,
}

/// A sensor of distances alone.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RangeSensor {
    /// The model with its noise.
    #[serde(flatten)]
    pub model: RangeOnly,
    /// What it may be off by.
    #[serde(flatten)]
    pub errors: RangeErrors,
    /// Limits, tail, delay and mounting.
    #[serde(flatten)]
    pub common: Common,
}

/// A sensor of directions alone; its landmarks lie within its limits of the range.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct BearingSensor {
    /// Standard deviation of the bearing.
    pub bearing_std_rad: f64,
    /// Added to every bearing.
    pub bearing_bias_rad: f64,
    /// Limits, tail, delay and mounting.
    #[serde(flatten)]
    pub common: Common,
}

/// A sensor of one's own, which brings its model and noise.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct OwnSensor {
    /// What its ranges may be off by.
    #[serde(flatten)]
    pub errors: RangeErrors,
    /// Limits, tail, delay and mounting.
    #[serde(flatten)]
    pub common: Common,
}

impl Sensor {
    /// What it has as any sensor.
    pub fn common(&self) -> &Common {
        match self {
            Self::RangeBearing(RangeBearingSensor { common, .. })
            | Self::Range(RangeSensor { common, .. })
            | Self::Bearing(BearingSensor { common, .. })
            | Self::Own(OwnSensor { common, .. }) => common,
        }
    }

    /// The name of its model.
    pub fn model(&self) -> SensorModel {
        match self {
            Self::RangeBearing(_) => SensorModel::RangeBearing,
            Self::Range(_) => SensorModel::Range,
            Self::Bearing(_) => SensorModel::Bearing,
            Self::Own(_) => SensorModel::Own,
        }
    }

    /// Changes it as its settings are written; what its model does not have counts for nothing.
    pub fn change(&mut self, change: impl FnOnce(&mut SensorSettings)) {
        let mut settings = SensorSettings::from(&*self);
        change(&mut settings);
        *self = Self::from(settings);
    }

    /// Errors that name the first parameter out of range.
    pub fn validate(&self) -> Result<()> {
        self.validate_as("sensor")
    }

    /// The same for the sensor with this key.
    pub(super) fn validate_as(&self, key: &str) -> Result<()> {
        SensorSettings::from(self).validate().map_err(|e| e.within(key))
    }

    /// How the noise falls off.
    pub fn tail(&self) -> Tail {
        Tail::from_degrees_of_freedom(self.common().tail_degrees_of_freedom)
    }

    /// Where it sits.
    pub fn T_robot_sensor(&self) -> Pose {
        self.common().mounting.T_robot_sensor()
    }

    /// The model of which one sighting says where a landmark is.
    ///
    /// **Errors:** [`Error::Parameter`] for the other models.
    pub fn range_bearing(&self) -> Result<RangeBearing> {
        let expected = match self {
            Self::RangeBearing(sensor) => return Ok(sensor.model),
            Self::Range(_) | Self::Bearing(_) => {
                "range_bearing: `slam::create` makes the filter for ranges or bearings alone"
            }
            Self::Own(_) => EXPECTED_OF_OWN,
        };
        Err(Error::parameter("sensor.model", self.model().name(), expected))
    }

    /// A reported range and bearing as the value of a sighting: what the sensor does not measure counts for nothing; a
    /// sensor of one's own takes what is its.
    pub fn value_of(&self, range_m: f64, bearing_rad: f64) -> [f64; 2] {
        match self {
            Self::RangeBearing(_) | Self::Own(_) => [range_m, bearing_rad],
            Self::Range(_) => [range_m, 0.0],
            Self::Bearing(_) => [0.0, bearing_rad],
        }
    }

    /// Its systematic errors.
    pub fn systematic_error(&self) -> SystematicError {
        match self {
            Self::RangeBearing(sensor) => sensor.error,
            Self::Bearing(BearingSensor { bearing_bias_rad, .. }) => {
                SystematicError { bearing_bias_rad: *bearing_bias_rad, ..SystematicError::NONE }
            }
            Self::Range(RangeSensor { errors, .. }) | Self::Own(OwnSensor { errors, .. }) => {
                let RangeErrors { range_scale, range_bias_m, .. } = *errors;
                SystematicError { range_scale, range_bias_m, ..SystematicError::NONE }
            }
        }
    }

    /// Scale and bias of its ranges, with how uncertain they are.
    pub fn range_errors(&self) -> RangeErrors {
        match self {
            Self::Range(RangeSensor { errors, .. }) | Self::Own(OwnSensor { errors, .. }) => *errors,
            Self::RangeBearing(_) | Self::Bearing(_) => {
                let SystematicError { range_scale, range_bias_m, .. } = self.systematic_error();
                RangeErrors { range_scale, range_bias_m, range_scale_std: None, range_bias_std_m: None }
            }
        }
    }
}

impl Default for Sensor {
    fn default() -> Self {
        SensorSettings::default().into()
    }
}

impl From<SensorSettings> for Sensor {
    fn from(settings: SensorSettings) -> Self {
        let SensorSettings { range_std_m, bearing_std_rad, range_scale, range_bias_m, bearing_bias_rad, .. } = settings;
        let SensorSettings { min_range_m, max_range_m, field_of_view_rad, delay_s, mounting, .. } = settings;
        let SensorSettings { tail_degrees_of_freedom, range_scale_std, range_bias_std_m, .. } = settings;
        let common = Common { min_range_m, max_range_m, field_of_view_rad, tail_degrees_of_freedom, delay_s, mounting };
        let errors = RangeErrors { range_scale, range_bias_m, range_scale_std, range_bias_std_m };
        match settings.model {
            SensorModel::RangeBearing => {
                let model = RangeBearing { range_std_m, bearing_std_rad };
                let error = SystematicError { range_scale, range_bias_m, bearing_bias_rad };
                Self::RangeBearing(RangeBearingSensor { model, error, common })
            }
            SensorModel::Range => Self::Range(RangeSensor { model: RangeOnly { range_std_m }, errors, common }),
            SensorModel::Bearing => Self::Bearing(BearingSensor { bearing_std_rad, bearing_bias_rad, common }),
            SensorModel::Own => Self::Own(OwnSensor { errors, common }),
        }
    }
}

impl From<&Sensor> for SensorSettings {
    fn from(sensor: &Sensor) -> Self {
        let Common { min_range_m, max_range_m, field_of_view_rad, tail_degrees_of_freedom, delay_s, mounting } =
            *sensor.common();
        let RangeErrors { range_scale, range_bias_m, range_scale_std, range_bias_std_m } = sensor.range_errors();
        let others = Self::default();
        let (range_std_m, bearing_std_rad) = match sensor {
            Sensor::RangeBearing(RangeBearingSensor { model, .. }) => (model.range_std_m, model.bearing_std_rad),
            Sensor::Range(RangeSensor { model, .. }) => (model.range_std_m, others.bearing_std_rad),
            Sensor::Bearing(sensor) => (others.range_std_m, sensor.bearing_std_rad),
            Sensor::Own(_) => (others.range_std_m, others.bearing_std_rad),
        };
        Self {
            model: sensor.model(),
            range_std_m,
            bearing_std_rad,
            min_range_m,
            max_range_m,
            field_of_view_rad,
            tail_degrees_of_freedom,
            range_scale,
            range_bias_m,
            range_scale_std,
            range_bias_std_m,
            bearing_bias_rad: sensor.systematic_error().bearing_bias_rad,
            delay_s,
            mounting,
        }
    }
}

impl JsonSchema for Sensor {
    fn schema_name() -> Cow<'static, str> {
        "Sensor".into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        SensorSettings::json_schema(generator)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn written(sensor: &Sensor) -> serde_json::Value {
        serde_json::to_value(sensor).unwrap()
    }

    #[test]
    fn every_model_reads_the_flat_section_and_writes_what_it_has() {
        let keys = |model: &str| {
            let text = format!(
                r#"{{"model": "{model}", "range_std_m": 0.3, "bearing_std_rad": 0.04, "range_scale": 1.1, "range_bias_m": 0.2,
                    "bearing_bias_rad": 0.01, "range_scale_std": 0.0, "max_range_m": 7.0, "mounting": {{"x_m": 0.5}}}}"#
            );
            let sensor: Sensor = serde_json::from_str(&text).unwrap();
            let value = written(&sensor);
            assert_eq!(serde_json::from_value::<Sensor>(value.clone()).unwrap(), sensor, "what it writes it reads");
            assert_eq!(Sensor::from(SensorSettings::from(&sensor)), sensor);
            assert_eq!((sensor.common().max_range_m, sensor.common().mounting.x_m), (7.0, 0.5));
            assert_eq!(value["model"], model);
            let shared = ["min_range_m", "max_range_m", "field_of_view_rad", "tail_degrees_of_freedom", "delay_s"];
            let own = |key: &&String| !shared.contains(&key.as_str()) && *key != "model" && *key != "mounting";
            assert!(shared.iter().all(|key| value.get(key).is_some()));
            value.as_object().unwrap().keys().filter(own).cloned().collect::<Vec<_>>()
        };
        assert_eq!(
            keys("range_bearing"),
            ["bearing_bias_rad", "bearing_std_rad", "range_bias_m", "range_scale", "range_std_m"]
        );
        assert_eq!(keys("range"), ["range_bias_m", "range_scale", "range_scale_std", "range_std_m"]);
        assert_eq!(keys("bearing"), ["bearing_bias_rad", "bearing_std_rad"]);
        assert_eq!(keys("own"), ["range_bias_m", "range_scale", "range_scale_std"]);
    }

    #[test]
    fn what_no_model_has_is_refused() {
        let error = serde_json::from_str::<Sensor>(r#"{"range_std": 0.3}"#).unwrap_err().to_string();
        assert!(error.contains("unknown field `range_std`"), "{error}");
    }
}
