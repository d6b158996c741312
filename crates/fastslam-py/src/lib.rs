//! Python bindings: convert, validate, map errors; no arithmetic.

mod settings;
mod simulation;

use fastslam_core::config::Config;
use pyo3::prelude::*;
use settings::{parse, schema_of, to_value_error};

/// The JSON Schema of the configuration.
#[pyfunction]
fn config_schema() -> PyResult<String> {
    schema_of::<Config>()
}

/// Fills in defaults and checks every value.
#[pyfunction]
fn resolve_config(json: &str) -> PyResult<String> {
    let config: Config = parse(json)?;
    config.validate().map_err(to_value_error)?;
    serde_json::to_string(&config).map_err(to_value_error)
}

#[pymodule]
fn _core(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add_function(wrap_pyfunction!(config_schema, module)?)?;
    module.add_function(wrap_pyfunction!(resolve_config, module)?)?;
    simulation::register(module)
}
