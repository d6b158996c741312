//! Python bindings: convert, validate, map errors; no arithmetic.

mod arena;
mod arrays;
mod config;
mod detect;
mod filter;
mod given;
mod noise;
mod placement;
mod run;
mod sensor;
mod settings;
mod simulation;
mod smoothing;
mod space;
mod step;
mod stream;
mod view;

use pyo3::prelude::*;

/// The compiled part of `fastslam`.
#[pymodule]
fn _core(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add("build_profile", if cfg!(debug_assertions) { "debug" } else { "release" })?;
    module.add_function(wrap_pyfunction!(config::resolve_config, module)?)?;
    module.add_function(wrap_pyfunction!(config::config_schema, module)?)?;
    module.add_function(wrap_pyfunction!(config::control_columns, module)?)?;
    module.add_function(wrap_pyfunction!(config::limits, module)?)?;
    module.add_function(wrap_pyfunction!(run::run, module)?)?;
    module.add_function(wrap_pyfunction!(step::step_fields, module)?)?;
    module.add_class::<filter::Filter>()?;
    module.add_class::<stream::Stream>()?;
    module.add_class::<smoothing::LeastSquaresRows>()?;
    module.add_class::<smoothing::LeastSquares>()?;
    module.add_class::<placement::Chart>()?;
    arena::register(module)?;
    detect::register(module)?;
    space::register(module)?;
    simulation::register(module)
}
