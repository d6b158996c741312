//! The configuration schema for Python.

use fastslam_core::config::Config;
use fastslam_core::error::Error;
use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::prelude::*;

/// Parses and validates a configuration; the message of an error starts with the dotted key.
pub fn parse(json: &str) -> PyResult<Config> {
    let mut deserializer = serde_json::Deserializer::from_str(json);
    let config: Config = serde_path_to_error::deserialize(&mut deserializer).map_err(|error| {
        let path = error.path().to_string();
        let message = error.into_inner().to_string();
        // The position in the JSON text means nothing to a user, who wrote YAML.
        let message = message.split(" at line ").next().unwrap_or_default().to_owned();
        PyValueError::new_err(if path == "." { message } else { format!("{path}: {message}") })
    })?;
    config.validate().map_err(|error| PyValueError::new_err(error.to_string()))?;
    Ok(config)
}

/// An error of the core as an exception: bad values are `ValueError`, a filter that cannot go on is `RuntimeError`.
pub fn to_python(error: Error) -> PyErr {
    match error {
        Error::Parameter { .. } | Error::Input(_) => PyValueError::new_err(error.to_string()),
        Error::AllWeightsZero { .. } | Error::NotFinite { .. } => PyRuntimeError::new_err(error.to_string()),
    }
}

fn to_json(value: &impl serde::Serialize) -> PyResult<String> {
    serde_json::to_string(value).map_err(|error| PyRuntimeError::new_err(error.to_string()))
}

#[pyfunction]
pub fn resolve_config(json: &str) -> PyResult<String> {
    to_json(&parse(json)?)
}

#[pyfunction]
pub fn config_schema() -> PyResult<String> {
    to_json(&schemars::schema_for!(Config))
}

#[pyfunction]
pub fn control_columns(json: &str) -> PyResult<Vec<&'static str>> {
    Ok(parse(json)?.motion.control_columns().to_vec())
}
