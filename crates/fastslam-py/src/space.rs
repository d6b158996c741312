//! Runs in space: settings as JSON, columns in, columns out.

use crate::settings::{from_json, schema_of, to_json, to_python};
use fastslam_core::normal::Matrix;
use fastslam_core::sighting::Skipped;
use fastslam_core::space::{self, SpaceConfig, SpaceEstimate, SpaceLandmark, SpaceLog, SpacePose, SpaceRun};
use fastslam_core::space::{SpaceSighting, SpaceStep};
use numpy::{IntoPyArray, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::exceptions::{PyKeyboardInterrupt, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::time::{Duration, Instant};

/// Time between two calls of the progress callback, which are also the moments at which Ctrl-C is seen.
const PROGRESS_PERIOD: Duration = Duration::from_millis(100);

fn parse(json: &str) -> PyResult<SpaceConfig> {
    let config: SpaceConfig = from_json(json)?;
    config.validate().map_err(to_python)?;
    Ok(config)
}

#[pyfunction]
fn resolve_space_config(json: &str) -> PyResult<String> {
    to_json(&parse(json)?)
}

#[pyfunction]
fn space_config_schema() -> PyResult<String> {
    schema_of::<SpaceConfig>()
}

/// Runs the filter over a log in space. Ctrl-C, or `KeyboardInterrupt` from `progress(done, total)`, ends it early with what
/// has been computed; any other exception of `progress` is raised.
#[pyfunction]
#[pyo3(signature = (config_json, row_stamp_s, velocity, sighting_stamp_s, value, identity, covariance=None, progress=None))]
#[allow(clippy::too_many_arguments)] // One array per column of a log.
fn run_space<'py>(
    py: Python<'py>,
    config_json: &str,
    row_stamp_s: PyReadonlyArray1<'py, f64>,
    velocity: PyReadonlyArray2<'py, f64>,
    sighting_stamp_s: PyReadonlyArray1<'py, f64>,
    value: PyReadonlyArray2<'py, f64>,
    identity: PyReadonlyArray1<'py, i64>,
    covariance: Option<PyReadonlyArray2<'py, f64>>,
    progress: Option<Py<PyAny>>,
) -> PyResult<Bound<'py, PyDict>> {
    let config = parse(config_json)?;
    let log = SpaceLog {
        row_stamp_s: row_stamp_s.as_array().to_vec(),
        velocity: rows(&velocity, "velocities")?,
        sighting_stamp_s: sighting_stamp_s.as_array().to_vec(),
        sightings: sightings(&value, &identity, covariance.as_ref())?,
    };
    let mut failure = None;
    let begun = Instant::now();
    let run = py.detach(|| {
        let mut next = begun;
        let mut goes_on = |done: usize, total: usize| {
            if Instant::now() >= next || done == total {
                next = Instant::now() + PROGRESS_PERIOD;
                failure = report(progress.as_ref(), done, total).err();
            }
            failure.is_none()
        };
        space::run(&config, &log, &mut goes_on)
    });
    match failure.filter(|error| !error.is_instance_of::<PyKeyboardInterrupt>(py)) {
        Some(error) => Err(error),
        None => to_dict(py, &run.map_err(to_python)?, begun.elapsed()),
    }
}

fn report(progress: Option<&Py<PyAny>>, done: usize, total: usize) -> PyResult<()> {
    Python::attach(|py| {
        py.check_signals()?;
        progress.map_or(Ok(()), |callback| callback.call1(py, (done, total)).map(|_| ()))
    })
}

fn rows<const N: usize>(array: &PyReadonlyArray2<'_, f64>, what: &str) -> PyResult<Vec<[f64; N]>> {
    let view = array.as_array();
    if view.ncols() != N {
        return Err(PyValueError::new_err(format!("{what}: got {} columns, expected {N}", view.ncols())));
    }
    Ok(view.rows().into_iter().map(|row| std::array::from_fn(|i| row[i])).collect())
}

/// Identity −1 means unknown, a covariance of NaN the sensor's.
fn sightings(
    value: &PyReadonlyArray2<'_, f64>,
    identity: &PyReadonlyArray1<'_, i64>,
    covariance: Option<&PyReadonlyArray2<'_, f64>>,
) -> PyResult<Vec<SpaceSighting>> {
    let (values, identity) = (rows::<3>(value, "sightings")?, identity.as_array());
    let covariances = covariance.map(|array| rows::<6>(array, "covariances of sightings")).transpose()?;
    let covered = covariances.as_ref().map_or(values.len(), Vec::len);
    if identity.len() != values.len() || covered != values.len() {
        return Err(PyValueError::new_err(format!(
            "sightings: got {} values, {} identities and {covered} covariances",
            values.len(),
            identity.len()
        )));
    }
    let name = |i: usize| match identity[i] {
        -1 => Ok(None),
        value => u32::try_from(value).map(Some).map_err(|_| {
            PyValueError::new_err(format!("sightings: identity {value} of row {i}, expected -1 to 4294967295"))
        }),
    };
    let noise = |i: usize| covariances.as_ref().map(|all| all[i]).filter(|upper| !upper[0].is_nan()).map(full);
    let made = values.iter().enumerate();
    made.map(|(i, value)| Ok(SpaceSighting { value: *value, identity: name(i)?, noise: noise(i) })).collect()
}

fn full([xx, xy, xz, yy, yz, zz]: [f64; 6]) -> Matrix<3, 3> {
    [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]
}

fn matrix<'py>(py: Python<'py>, rows: usize, values: Vec<f64>, width: usize) -> PyResult<Bound<'py, PyArray2<f64>>> {
    values.into_pyarray(py).reshape([rows, width])
}

fn poses<'py>(py: Python<'py>, poses: &[SpacePose]) -> PyResult<Bound<'py, PyArray2<f64>>> {
    matrix(py, poses.len(), poses.iter().flat_map(|pose| pose.to_array()).collect(), 7)
}

fn to_dict<'py>(py: Python<'py>, run: &SpaceRun, took: Duration) -> PyResult<Bound<'py, PyDict>> {
    let dict = PyDict::new(py);
    dict.set_item("stamp_s", run.stamp_s.clone().into_pyarray(py))?;
    let live: Vec<SpacePose> = run.live.iter().map(|estimate| estimate.mean).collect();
    dict.set_item("T_world_robot", poses(py, &live)?)?;
    let covariance = |estimate: &SpaceEstimate| estimate.covariance.concat();
    let covariances: Vec<f64> = run.live.iter().flat_map(covariance).collect();
    dict.set_item("covariance", covariances.into_pyarray(py).reshape([live.len(), 6, 6])?)?;
    let path = &run.smoothed.path;
    dict.set_item("smoothed_stamp_s", path.iter().map(|(stamp_s, _)| *stamp_s).collect::<Vec<_>>().into_pyarray(py))?;
    dict.set_item("smoothed_T_world_robot", poses(py, &run.smoothed_poses().collect::<Vec<_>>())?)?;
    dict.set_item("map", landmarks(py, &run.smoothed.landmarks)?)?;
    dict.set_item("live_map", landmarks(py, &run.landmarks)?)?;
    if let Some(ratios) = run.smoothed.ratios {
        dict.set_item("motion_ratios", ratios.motion.to_vec().into_pyarray(py))?;
        dict.set_item("sensor_ratios", ratios.sensor.to_vec().into_pyarray(py))?;
    }
    if let Some(hold) = run.smoothed.hold {
        dict.set_item("misfit", hold.misfit)?;
        dict.set_item("shape_std_m", hold.shape_std_m)?;
    }
    dict.set_item("steps", steps(py, &run.steps)?)?;
    let mut skipped = Skipped::default();
    run.steps.iter().for_each(|step| skipped.add(&step.skipped));
    let counts = PyDict::new(py);
    for (reason, count) in skipped.by_reason() {
        counts.set_item(format!("sightings_{reason}"), count)?;
    }
    dict.set_item("counts", counts)?;
    dict.set_item("interrupted", run.interrupted)?;
    dict.set_item("filter_seconds", took.as_secs_f64())?;
    Ok(dict)
}

fn landmarks<'py>(py: Python<'py>, landmarks: &[SpaceLandmark]) -> PyResult<Bound<'py, PyDict>> {
    let dict = PyDict::new(py);
    let count = landmarks.len();
    dict.set_item("identity", landmarks.iter().map(|l| l.identity).collect::<Vec<_>>().into_pyarray(py))?;
    dict.set_item("sightings", landmarks.iter().map(|l| l.sightings).collect::<Vec<_>>().into_pyarray(py))?;
    let means = landmarks.iter().flat_map(|l| l.place.mean).collect();
    dict.set_item("mean_m", matrix(py, count, means, 3)?)?;
    let covariances: Vec<f64> = landmarks.iter().flat_map(|l| l.place.covariance.concat()).collect();
    dict.set_item("covariance_m2", covariances.into_pyarray(py).reshape([count, 3, 3])?)?;
    Ok(dict)
}

/// What happened, a row per step.
fn steps<'py>(py: Python<'py>, steps: &[SpaceStep]) -> PyResult<Bound<'py, PyDict>> {
    let dict = PyDict::new(py);
    let numbers = |of: fn(&SpaceStep) -> f64| steps.iter().map(of).collect::<Vec<_>>().into_pyarray(py);
    let counts = |of: fn(&SpaceStep) -> u32| steps.iter().map(of).collect::<Vec<_>>().into_pyarray(py);
    dict.set_item("sightings", counts(|s| s.sightings))?;
    dict.set_item("new_landmarks", counts(|s| s.new_landmarks))?;
    dict.set_item("skipped", counts(|s| s.skipped.total()))?;
    dict.set_item("effective_sample_size", numbers(|s| s.effective_sample_size))?;
    dict.set_item("log_likelihood", numbers(|s| s.log_likelihood))?;
    dict.set_item("nis", numbers(|s| s.mahalanobis_squared))?;
    dict.set_item("degrees_of_freedom", counts(|s| s.degrees_of_freedom))?;
    dict.set_item("resampled", counts(|s| u32::from(s.resampled)))?;
    dict.set_item("rejuvenated", counts(|s| u32::from(s.drawn)))?;
    Ok(dict)
}

/// Adds these functions to the module.
pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(resolve_space_config, module)?)?;
    module.add_function(wrap_pyfunction!(space_config_schema, module)?)?;
    module.add_function(wrap_pyfunction!(run_space, module)?)
}
