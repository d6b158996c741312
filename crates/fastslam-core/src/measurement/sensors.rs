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
            if sensor.model() == SensorModel::Own {
                let expected = "range_bearing, range or bearing: a sensor of one's own is used alone";
                return Err(Error::parameter(format!("{key}.model"), sensor.model().name(), expected));
            }
            sensor.validate_as(&key)?;
        }
        self.validate_together()
    }

    /// An error where no sensor says where a landmark is.
    fn validate_together(&self) -> Result<()> {
        if self.is_empty() || self.0.values().any(|sensor| sensor.model() == SensorModel::RangeBearing) {
            return Ok(());
        }
        let kinds: Vec<&str> = self.0.values().map(|sensor| sensor.model().name()).collect();
        let expected =
            "one of range_bearing among them, which finds the landmarks that the others sight; one sensor of \
                        ranges or bearings alone stands in `sensor`";
        Err(Error::parameter("sensors", kinds.join(", "), expected))
    }

    /// Whether some of them measure ranges or bearings alone.
    pub fn are_mixed(&self) -> bool {
        self.0.values().any(|sensor| sensor.model() != SensorModel::RangeBearing)
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
        let message = refused(r#"{"front": {}, "radio": {"model": "own"}}"#);
        assert!(message.starts_with("sensors.radio.model: got own, expected range_bearing, range or bearing"));
        let message = refused(r#"{"eye": {"model": "bearing"}, "radio": {"model": "range"}}"#);
        assert!(
            message.starts_with("sensors: got bearing, range, expected one of range_bearing among them"),
            "{message}"
        );
        for model in ["range", "bearing", "range_bearing"] {
            let text = format!(r#"{{"front": {{}}, "other": {{"model": "{model}"}}}}"#);
            let sensors: Sensors = serde_json::from_str(&text).unwrap();
            assert_eq!((sensors.validate(), sensors.are_mixed()), (Ok(()), model != "range_bearing"));
        }
        assert!(refused(r#"{" front": {}}"#).contains("blanks"));
        let many: Vec<String> = (0..65).map(|i| format!(r#""{i}": {{}}"#)).collect();
        assert_eq!(refused(&format!("{{{}}}", many.join(", "))), "sensors: got 65, expected 64 at most");
    }
}
