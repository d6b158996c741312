//! Several sensors on one robot, by name.

use super::{Sensor, SensorModel};
use crate::error::{Error, Result};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// More sensors than this are no robot's.
const MOST: usize = 64;

/// The sensors of a robot that has several, by name; none where [`Sensor`] says it all.
///
/// Scans say the number of their sensor: its place in the order of the names.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(transparent)]
pub struct Sensors(pub BTreeMap<String, Sensor>);

impl Sensors {
    /// Whether none is named.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Errors that name the first sensor and parameter out of range, and sensors that cannot be used together.
    pub fn validate(&self) -> Result<()> {
        if self.0.len() > MOST {
            return Err(Error::parameter("sensors", self.0.len(), format!("{MOST} at most")));
        }
        for (name, sensor) in &self.0 {
            if name.is_empty() || name.trim() != name {
                return Err(Error::parameter("sensors", format!("the name {name:?}"), "one without blanks around it"));
            }
            let key = format!("sensors.{name}");
            if sensor.model() != SensorModel::RangeBearing {
                let expected = "range_bearing: sensors of another kind are used alone (`sensor`)";
                return Err(Error::parameter(format!("{key}.model"), sensor.model().name(), expected));
            }
            sensor.validate_as(&key)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(text: &str) -> String {
        serde_json::from_str::<Sensors>(text).unwrap().validate().unwrap_err().to_string()
    }

    #[test]
    fn what_is_wrong_is_named_with_its_sensor() {
        let message = refused(r#"{"front": {}, "rear": {"range_std_m": 0}}"#);
        assert!(message.starts_with("sensors.rear.range_std_m: got 0"), "{message}");
        let message = refused(r#"{"front": {}, "rear": {"mounting": {"x_m": 1e9}}}"#);
        assert!(message.starts_with("sensors.rear.mounting.x_m: got"), "{message}");
        for model in ["range", "bearing", "own"] {
            let message = refused(&format!(r#"{{"front": {{}}, "radio": {{"model": "{model}"}}}}"#));
            assert!(message.starts_with(&format!("sensors.radio.model: got {model}, expected range_bearing")));
        }
        assert!(refused(r#"{" front": {}}"#).contains("blanks"));
        let many: Vec<String> = (0..65).map(|i| format!(r#""{i}": {{}}"#)).collect();
        assert_eq!(refused(&format!("{{{}}}", many.join(", "))), "sensors: got 65, expected 64 at most");
    }
}
