//! The sensor as configuration files write it: one flat section, whichever its model.

use crate::error::{finite, non_negative, positive, Result};
use crate::geometry::Pose;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Where the sensor sits on the robot: `T_robot_sensor`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Mounting {
    /// Ahead of the robot's origin.
    pub x_m: f64,
    /// Left of the robot's origin.
    pub y_m: f64,
    /// Counter-clockwise from straight ahead.
    pub yaw_rad: f64,
}

impl Mounting {
    /// As a transform.
    pub fn T_robot_sensor(&self) -> Pose {
        Pose::new(self.x_m, self.y_m, self.yaw_rad)
    }

    /// Errors that name the first parameter that is not finite.
    pub fn validate(&self) -> Result<()> {
        finite("mounting.x_m", self.x_m)?;
        finite("mounting.y_m", self.y_m)?;
        finite("mounting.yaw_rad", self.yaw_rad)?;
        Ok(())
    }
}

/// Systematic errors of a range-bearing sensor.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SystematicError {
    /// Reported metres per metre.
    pub range_scale: f64,
    /// Added to every range.
    pub range_bias_m: f64,
    /// Added to every bearing.
    pub bearing_bias_rad: f64,
}

impl SystematicError {
    /// None at all: [`Self::corrected`] returns what it is given, to the last bit.
    pub const NONE: Self = Self { range_scale: 1.0, range_bias_m: 0.0, bearing_bias_rad: 0.0 };

    /// What a sensor without these errors would have reported.
    pub fn corrected(&self, [range_m, bearing_rad]: [f64; 2]) -> [f64; 2] {
        [(range_m - self.range_bias_m) / self.range_scale, bearing_rad - self.bearing_bias_rad]
    }
}

/// Names of the measurement models.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum SensorModel {
    /// Distance and direction of a landmark.
    #[default]
    RangeBearing,
    /// Distance of a landmark alone.
    Range,
    /// Direction of a landmark alone.
    Bearing,
    /// A sensor of one's own, from Python: only together with one.
    Own,
}

impl SensorModel {
    /// As settings write it.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::RangeBearing => "range_bearing",
            Self::Range => "range",
            Self::Bearing => "bearing",
            Self::Own => "own",
        }
    }
}

/// The sensor of a run: its model, where it sits and what it can see.
///
/// [`Sensor`](super::Sensor) is made of it, and keeps what its model has; what is said of another counts for nothing.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct SensorSettings {
    /// What a sighting says: `range_bearing`, `range` alone (beacons that are heard, by name) or `bearing` alone (landmarks
    /// in pictures); `own` stands in the settings of a run with a sensor of one's own.
    pub model: SensorModel,
    /// Standard deviation of the range.
    #[schemars(extend("x-only-for" = "model = range_bearing | range"))]
    pub range_std_m: f64,
    /// Standard deviation of the bearing.
    #[schemars(extend("x-only-for" = "model = range_bearing | bearing"))]
    pub bearing_std_rad: f64,
    /// Sightings nearer than this are skipped and counted: the bearing of a landmark at the sensor says nothing.
    pub min_range_m: f64,
    /// Sightings farther than this are skipped and counted. Where nothing states it, a run over a log takes 1.1 times its
    /// farthest sighting, 100 m at most.
    pub max_range_m: f64,
    /// Full opening angle, centred straight ahead of the sensor.
    pub field_of_view_rad: f64,
    /// Degrees of freedom of the noise (Student's t): 3 to 10 for a sensor with outliers. Without it the noise is
    /// Gaussian, and one wild sighting can spoil a landmark.
    pub tail_degrees_of_freedom: Option<f64>,
    /// What the sensor reports for every metre of range, beyond `range_bias_m`; `fastslam calibrate` finds it.
    #[schemars(extend("x-only-for" = "model = range_bearing | range | own"))]
    pub range_scale: f64,
    /// What the sensor adds to every range. Reported ranges become (range − bias) / scale before anything else is done
    /// with them, the limits included.
    #[schemars(extend("x-only-for" = "model = range_bearing | range | own"))]
    pub range_bias_m: f64,
    /// How uncertain `range_scale` is (standard deviation): a run with `model: range` learns the scale; 0 takes it as it
    /// is. Without it 0.05.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(extend("x-only-for" = "model = range | own"))]
    pub range_scale_std: Option<f64>,
    /// How uncertain `range_bias_m` is (standard deviation): a run with `model: range` learns the bias; 0 takes it as it
    /// is. Without it 0.5.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(extend("x-only-for" = "model = range | own"))]
    pub range_bias_std_m: Option<f64>,
    /// What the sensor adds to every bearing. A sensor with this alone is one that is mounted turned the other way.
    #[schemars(extend("x-only-for" = "model = range_bearing | bearing"))]
    pub bearing_bias_rad: f64,
    /// How late the stamps of sightings are against those of the odometry: a sighting is of the pose this long before
    /// its stamp. Runs over a log and `Robot` apply it; `FastSlam` is told stamps that are right.
    pub delay_s: f64,
    /// Pose of the sensor on the robot.
    pub mounting: Mounting,
}

impl Default for SensorSettings {
    fn default() -> Self {
        Self {
            model: SensorModel::RangeBearing,
            range_std_m: 0.1,
            bearing_std_rad: 0.02,
            min_range_m: 0.05,
            max_range_m: 100.0,
            field_of_view_rad: std::f64::consts::TAU,
            tail_degrees_of_freedom: None,
            range_scale: SystematicError::NONE.range_scale,
            range_bias_m: SystematicError::NONE.range_bias_m,
            range_scale_std: None,
            range_bias_std_m: None,
            bearing_bias_rad: SystematicError::NONE.bearing_bias_rad,
            delay_s: 0.0,
            mounting: Mounting::default(),
        }
    }
}

impl SensorSettings {
    /// Errors that name the first parameter out of range.
    pub fn validate(&self) -> Result<()> {
        positive("range_std_m", self.range_std_m)?;
        positive("bearing_std_rad", self.bearing_std_rad)?;
        positive("min_range_m", self.min_range_m)?;
        positive("max_range_m", self.max_range_m)?;
        positive("field_of_view_rad", self.field_of_view_rad)?;
        if let Some(value) = self.tail_degrees_of_freedom {
            positive("tail_degrees_of_freedom", value)?;
        }
        positive("range_scale", self.range_scale)?;
        finite("range_bias_m", self.range_bias_m)?;
        for (key, value) in [("range_scale_std", self.range_scale_std), ("range_bias_std_m", self.range_bias_std_m)] {
            value.map_or(Ok(0.0), |value| non_negative(key, value))?;
        }
        finite("bearing_bias_rad", self.bearing_bias_rad)?;
        finite("delay_s", self.delay_s)?;
        self.mounting.validate()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn systematic_errors_are_taken_out() {
        let error = SystematicError { range_scale: 1.25, range_bias_m: -0.5, bearing_bias_rad: 0.1 };
        // Truly 8 m at 0.3 rad: reported 1.25 * 8 - 0.5 and 0.3 + 0.1.
        let [range_m, bearing_rad] = error.corrected([9.5, 0.4]);
        assert!((range_m - 8.0).abs() < 1e-12 && (bearing_rad - 0.3).abs() < 1e-12);
        for value in [[0.1, -3.0], [1e-300, 0.0], [77.7, 1.0 / 3.0]] {
            assert_eq!(SystematicError::NONE.corrected(value), value);
        }
        assert!(SystematicError::NONE.corrected([f64::NAN, 0.0])[0].is_nan());
    }

    #[test]
    fn a_scale_that_is_not_positive_is_an_error() {
        for range_scale in [0.0, -1.0, f64::NAN] {
            let error = SensorSettings { range_scale, ..Default::default() }.validate().unwrap_err();
            assert!(error.to_string().contains("range_scale"), "{error}");
        }
        let error = SensorSettings { range_bias_m: f64::INFINITY, ..Default::default() }.validate().unwrap_err();
        assert!(error.to_string().contains("range_bias_m"), "{error}");
    }
}
