//! Settings cross the border as JSON; errors name the dotted key.

use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use schemars::JsonSchema;
use serde::de::DeserializeOwned;
use std::fmt::Display;

/// Reads settings; the message of an error starts with the dotted key.
pub fn parse<T: DeserializeOwned>(json: &str) -> PyResult<T> {
    let mut reader = serde_json::Deserializer::from_str(json);
    serde_path_to_error::deserialize(&mut reader)
        .map_err(|error| PyValueError::new_err(format!("{}: {}", error.path(), error.inner())))
}

/// The JSON Schema of a type of settings.
pub fn schema_of<T: JsonSchema>() -> PyResult<String> {
    serde_json::to_string(&schemars::schema_for!(T)).map_err(to_value_error)
}

/// Any error of the core as a `ValueError`.
pub fn to_value_error(error: impl Display) -> PyErr {
    PyValueError::new_err(error.to_string())
}
