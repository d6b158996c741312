//! Bindings of the simulator: settings as JSON, a simulated log as columns.

use crate::settings::{from_json, schema_of, to_json, to_python};
use fastslam_sim::{SimulatedLog, SimulationConfig, PRESETS};
use numpy::{PyArray1, PyArray2, PyArrayMethods, ToPyArray};
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// The JSON Schema of the settings of a simulation.
#[pyfunction]
fn simulation_schema() -> PyResult<String> {
    schema_of::<SimulationConfig>()
}

/// Fills in defaults and checks every value.
#[pyfunction]
fn resolve_simulation(json: &str) -> PyResult<String> {
    let config: SimulationConfig = from_json(json)?;
    config.validate().map_err(to_python)?;
    to_json(&config)
}

/// Name and settings (JSON) of each ready-made simulation.
#[pyfunction]
fn simulation_presets() -> PyResult<Vec<(&'static str, String)>> {
    PRESETS.iter().map(|name| Ok((*name, to_json(&SimulationConfig::preset(name).map_err(to_python)?)?))).collect()
}

/// The same simulation with about this many landmarks, at the same density.
#[pyfunction]
fn simulation_with_landmarks(json: &str, landmarks: u32) -> PyResult<String> {
    let config: SimulationConfig = from_json(json)?;
    to_json(&config.with_landmarks(landmarks).map_err(to_python)?)
}

/// Simulates a log; returns its columns by name.
#[pyfunction]
fn simulate<'py>(py: Python<'py>, json: &str) -> PyResult<Bound<'py, PyDict>> {
    let config: SimulationConfig = from_json(json)?;
    let log = py.detach(|| fastslam_sim::simulate(&config)).map_err(to_python)?;
    columns(py, &log)
}

fn columns<'py>(py: Python<'py>, log: &SimulatedLog) -> PyResult<Bound<'py, PyDict>> {
    let out = PyDict::new(py);
    let width = log.control_columns.len();
    let controls: Vec<f64> = log.controls.iter().flat_map(|row| row[..width].iter().copied()).collect();
    out.set_item("control_stamp_s", log.control_stamp_s.to_pyarray(py))?;
    out.set_item("controls", matrix(py, controls, width)?)?;
    let sightings = &log.sightings;
    out.set_item("sighting_stamp_s", sightings.stamp_s.to_pyarray(py))?;
    out.set_item("range_m", sightings.range_m.to_pyarray(py))?;
    out.set_item("bearing_rad", sightings.bearing_rad.to_pyarray(py))?;
    out.set_item("identity", sightings.identity.to_pyarray(py))?;
    out.set_item("class_index", sightings.class_index.to_pyarray(py))?;
    out.set_item("signature", sightings.signature.to_pyarray(py))?;
    out.set_item("truth_stamp_s", log.truth_stamp_s.to_pyarray(py))?;
    out.set_item("T_world_robot", matrix(py, log.T_world_robot.concat(), 3)?)?;
    out.set_item("landmark_position_m", matrix(py, log.landmarks.position_m.concat(), 2)?)?;
    if let Some(scans) = &log.scans {
        out.set_item("scan_stamp_s", scans.stamp_s.to_pyarray(py))?;
        out.set_item("scan_ranges_m", matrix(py, scans.ranges_m.clone(), scans.beams)?)?;
        out.set_item("scan_geometry", to_json(&scans.geometry)?)?;
    }
    out.set_item("class_names", &log.class_names)?;
    out.set_item("motion", to_json(&log.motion)?)?;
    out.set_item("sensor", to_json(&log.sensor)?)?;
    out.set_item("sighting_sensor", log.sightings.sensor.to_pyarray(py))?;
    Ok(out)
}

fn matrix<'py>(py: Python<'py>, values: Vec<f64>, width: usize) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let rows = values.len() / width;
    PyArray1::from_vec(py, values).reshape([rows, width])
}

/// Adds these functions to the module.
pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(simulation_schema, module)?)?;
    module.add_function(wrap_pyfunction!(resolve_simulation, module)?)?;
    module.add_function(wrap_pyfunction!(simulation_presets, module)?)?;
    module.add_function(wrap_pyfunction!(simulation_with_landmarks, module)?)?;
    module.add_function(wrap_pyfunction!(simulate, module)?)
}
