//! The configuration schema for Python.

use crate::settings::{from_json, schema_of, to_json, to_python};
use fastslam_core::config::Config;
use fastslam_core::limits::{BY_UNIT, FARTHEST_M, LARGEST_STATE, LEAST};
use pyo3::prelude::*;
use std::collections::BTreeMap;

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

/// The largest size of a setting by the unit that ends its key, that of coordinates in the world (`position`), the least of
/// what is not zero (`least`), and the largest of any number of a state (`state`).
#[pyfunction]
pub fn limits() -> BTreeMap<&'static str, f64> {
    let others = [("position", FARTHEST_M), ("least", LEAST), ("state", LARGEST_STATE)];
    BY_UNIT.into_iter().chain(others).collect()
}

#[pyfunction]
pub fn control_columns(json: &str) -> PyResult<Vec<&'static str>> {
    Ok(parse(json)?.motion.control_columns().to_vec())
}
