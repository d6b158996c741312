//! Settings cross the border as JSON; errors name the dotted key.

use fastslam_core::error::Error;
use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use schemars::JsonSchema;
use serde::de::DeserializeOwned;
use serde::Serialize;

/// Reads settings; the message of an error starts with the dotted key.
pub fn from_json<T: DeserializeOwned>(json: &str) -> PyResult<T> {
    let mut deserializer = serde_json::Deserializer::from_str(json);
    serde_path_to_error::deserialize(&mut deserializer).map_err(|error| {
        let path = error.path().to_string();
        let message = error.into_inner().to_string();
        // The position in the JSON text means nothing to a user, who wrote YAML.
        let message = message.split(" at line ").next().unwrap_or_default().to_owned();
        PyValueError::new_err(if path == "." { message } else { format!("{path}: {message}") })
    })
}

/// Writes settings.
pub fn to_json(value: &impl Serialize) -> PyResult<String> {
    serde_json::to_string(value).map_err(|error| PyRuntimeError::new_err(error.to_string()))
}

/// The JSON Schema of a type of settings.
pub fn schema_of<T: JsonSchema>() -> PyResult<String> {
    to_json(&schemars::schema_for!(T))
}

/// An error of the core as an exception: bad values are `ValueError`, a filter that cannot go on is `RuntimeError`.
pub fn to_python(error: Error) -> PyErr {
    match error {
        Error::Parameter { .. } | Error::Input(_) => PyValueError::new_err(error.to_string()),
        Error::AllWeightsZero { .. } | Error::NotFinite { .. } | Error::NotPositiveDefinite { .. } => {
            PyRuntimeError::new_err(error.to_string())
        }
    }
}
