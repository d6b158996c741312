//! The configuration schema for Python.

use crate::settings::{from_json, schema_of, to_json, to_python};
use fastslam_core::config::Config;
use pyo3::prelude::*;

/// Parses and validates a configuration; the message of an error starts with the dotted key.
pub fn parse(json: &str) -> PyResult<Config> {
    let config: Config = from_json(json)?;
    config.validate().map_err(to_python)?;
    Ok(config)
}

#[pyfunction]
pub fn resolve_config(json: &str) -> PyResult<String> {
    to_json(&parse(json)?)
}

#[pyfunction]
pub fn config_schema() -> PyResult<String> {
    schema_of::<Config>()
}

#[pyfunction]
pub fn control_columns(json: &str) -> PyResult<Vec<&'static str>> {
    Ok(parse(json)?.motion.control_columns().to_vec())
}
