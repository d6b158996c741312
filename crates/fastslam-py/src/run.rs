//! A whole log in one call.

use crate::filter::Scan;
use crate::sensor::{self, Sensor};
use crate::view::{map_to_dict, View};
use crate::{arrays, config, given, noise, step};
use fastslam_core::config::Config;
use fastslam_core::diagnosis::Returns;
use fastslam_core::filter::Skipped;
use fastslam_core::measurement::RangeErrors;
use fastslam_core::run::{run_with, Observer, RunOutput, StepRecord, Task};
use fastslam_core::stream::Stream;
use fastslam_core::timeline::LogData;
use numpy::{IntoPyArray, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::exceptions::PyKeyboardInterrupt;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};
use std::time::Instant;

/// Seconds between two calls of the progress callback, which are also the moments at which Ctrl-C is seen.
const PROGRESS_PERIOD_S: f64 = 0.1;

struct Progress {
    start: Instant,
    next_s: f64,
    total: usize,
    callback: Option<Py<PyAny>>,
    checkpoints: Option<Checkpoints>,
    watch: Option<Watch>,
    failure: Option<PyErr>,
}

/// Who is shown the run, and when next: at a time of the clock or at a stamp, whichever comes first.
struct Watch {
    callback: Py<PyAny>,
    next_s: f64,
    next_stamp_s: f64,
}

/// Who gets a run's snapshots, and how often.
struct Checkpoints {
    callback: Py<PyAny>,
    every_s: f64,
    next_s: f64,
}

impl Observer for Progress {
    fn now_s(&self) -> f64 {
        self.start.elapsed().as_secs_f64()
    }

    fn step_done(&mut self, done: usize) -> bool {
        let now_s = self.now_s();
        if now_s < self.next_s || self.failure.is_some() {
            return self.failure.is_none();
        }
        self.next_s = now_s + PROGRESS_PERIOD_S;
        let result = Python::attach(|py| {
            py.check_signals()?;
            match &self.callback {
                Some(callback) => callback.call1(py, (done, self.total)).map(|_| ()),
                None => Ok(()),
            }
        });
        self.failure = result.err();
        self.failure.is_none()
    }

    fn look(&mut self, stream: &mut Stream, record: &StepRecord) {
        let now_s = self.now_s();
        if self.watch.as_ref().is_some_and(|watch| now_s >= watch.next_s || record.stamp_s >= watch.next_stamp_s) {
            self.show(stream, record);
        }
    }

    fn look_back(&mut self, stream: &mut Stream, record: &StepRecord) {
        self.show(stream, record);
    }

    /// At its time, and when the run is stopped.
    fn wants_snapshot(&mut self) -> bool {
        let (now_s, stopped) = (self.now_s(), self.failure.is_some());
        self.checkpoints.as_mut().is_some_and(|checkpoints| {
            let due = stopped || now_s >= checkpoints.next_s;
            checkpoints.next_s = if due { now_s + checkpoints.every_s } else { checkpoints.next_s };
            due
        })
    }

    fn keep(&mut self, snapshot: Vec<u8>) {
        let Some(checkpoints) = &self.checkpoints else { return };
        let kept = Python::attach(|py| checkpoints.callback.call1(py, (PyBytes::new(py, &snapshot),)).map(|_| ()));
        self.failure = self.failure.take().or(kept.err());
    }
}

impl Watch {
    fn new(callback: Py<PyAny>) -> Self {
        Self { callback, next_s: 0.0, next_stamp_s: f64::NEG_INFINITY }
    }
}

impl Checkpoints {
    fn new(callback: Py<PyAny>, every_s: f64) -> Self {
        Self { callback, every_s, next_s: every_s }
    }
}

impl Progress {
    /// Of a run that begins now.
    fn new(total: usize, callback: Option<Py<PyAny>>, checkpoints: Option<Checkpoints>, watch: Option<Watch>) -> Self {
        Self { start: Instant::now(), next_s: 0.0, total, callback, checkpoints, watch, failure: None }
    }

    /// Raises what a callback raised; Ctrl-C only ends the run early.
    fn raise(self, py: Python<'_>) -> PyResult<()> {
        match self.failure.filter(|error| !error.is_instance_of::<PyKeyboardInterrupt>(py)) {
            Some(error) => Err(error),
            None => Ok(()),
        }
    }

    /// Shows whoever watches the run; an exception ends it.
    fn show(&mut self, stream: &mut Stream, record: &StepRecord) {
        let Some(watch) = self.watch.as_mut().filter(|_| self.failure.is_none()) else { return };
        let answer = Python::attach(|py| -> PyResult<(f64, f64)> {
            let (view, step) = (View::of(stream).to_dict(py)?, PyDict::new(py));
            step::set_values(&step, &record.info)?;
            let pose = &record.pose;
            watch.callback.call1(py, (view, step, record.stamp_s, pose.mean.to_array(), pose.covariance))?.extract(py)
        });
        let after_s = self.start.elapsed().as_secs_f64();
        match answer {
            Ok((wait_s, next_stamp_s)) => (watch.next_s, watch.next_stamp_s) = (after_s + wait_s, next_stamp_s),
            Err(error) => self.failure = Some(error),
        }
    }
}

/// Runs the filter over a log, all the sightings of which are one `scan` with stamps, with a sensor of one's own where there is one; `by` holds the numbers of the sensors where there are several; `resume` is a snapshot to go on from, and `checkpoint(snapshot)` is called every
/// `checkpoint_every_s` and when the run is stopped. `watch(view, step, stamp, pose,
/// covariance)` is shown the run, and answers in how many seconds, or
/// at which stamp, it wants to be shown it again. Ctrl-C, or `KeyboardInterrupt` from `progress(done, total)`, ends it early with what has
/// been computed; any other exception of `progress` is raised.
#[pyfunction]
#[pyo3(signature = (config_json, control_stamps_s, controls, sighting_stamps_s, scan, progress=None, control_covariance=None, checkpoint=None, checkpoint_every_s=60.0, resume=None, map=None, start=None, watch=None, sensor=None, by=None))]
#[allow(clippy::too_many_arguments)] // One array per column of a log.
pub fn run<'py>(
    py: Python<'py>,
    config_json: &str,
    control_stamps_s: PyReadonlyArray1<'py, f64>,
    controls: PyReadonlyArray2<'py, f64>,
    sighting_stamps_s: PyReadonlyArray1<'py, f64>,
    scan: Scan<'py>,
    progress: Option<Py<PyAny>>,
    control_covariance: Option<PyReadonlyArray2<'py, f64>>,
    checkpoint: Option<Py<PyAny>>,
    checkpoint_every_s: f64,
    resume: Option<&[u8]>,
    map: Option<given::GivenMap<'py>>,
    start: Option<given::GivenStart<'py>>,
    watch: Option<Py<PyAny>>,
    sensor: Option<Sensor>,
    by: Option<PyReadonlyArray1<'py, u8>>,
) -> PyResult<Bound<'py, PyDict>> {
    let (config, beginning) = (&config::parse(config_json)?, &given::beginning(map, start)?);
    let sighting_sensors = by.map_or_else(Vec::new, |by| by.as_array().to_vec());
    let log = &LogData {
        control_stamps_s: control_stamps_s.as_array().to_vec(),
        controls: arrays::controls(&controls)?,
        control_covariances: arrays::control_covariances(control_covariance.as_ref())?,
        sighting_stamps_s: sighting_stamps_s.as_array().to_vec(),
        sightings: scan.sightings(config, |i| sighting_sensors.get(i).copied().unwrap_or(0).into())?,
        sighting_sensors,
    };
    let checkpoints = checkpoint.map(|callback| Checkpoints::new(callback, checkpoint_every_s));
    let total = log.step_bound(config.filter.path_period_s);
    let mut observer = Progress::new(total, progress, checkpoints, watch.map(Watch::new));
    let make = |config, identities| sensor::make(sensor.as_ref(), config, identities);
    let output = py.detach(|| run_with(&make, Task { config, log, beginning }, resume, &mut observer));
    let output = sensor::answer(sensor.as_ref(), output)?;
    observer.raise(py).and_then(|()| to_dict(py, &output, config))
}

/// The columns of a run by name.
pub fn to_dict<'py>(py: Python<'py>, output: &RunOutput, config: &Config) -> PyResult<Bound<'py, PyDict>> {
    let dict = PyDict::new(py);
    let steps = &output.steps;
    dict.set_item("steps", steps_to_dict(py, steps)?)?;
    let poses: Vec<f64> = steps.iter().flat_map(|s| s.pose.mean.to_array()).collect();
    dict.set_item("T_world_robot", poses.into_pyarray(py).reshape([steps.len(), 3])?)?;
    let covariances: Vec<f64> = steps.iter().flat_map(|s| s.pose.covariance.concat()).collect();
    dict.set_item("covariance", covariances.into_pyarray(py).reshape([steps.len(), 3, 3])?)?;
    dict.set_item("warnings", noise::warnings(py, &output.noise.warnings, &config.motion)?)?;
    dict.set_item("noise", noise::report(py, &output.noise, &config.motion)?)?;
    dict.set_item("two_places", noise::two_places(&output.two_places))?;
    dict.set_item("calibration", calibration(py, output.map.range_errors.as_ref())?)?;
    dict.set_item("covariances_repaired", output.repaired)?;
    let smoothed = &output.smoothed;
    dict.set_item("smoothed_stamp_s", smoothed.iter().map(|n| n.0).collect::<Vec<_>>().into_pyarray(py))?;
    let poses: Vec<f64> = smoothed.iter().flat_map(|n| n.1.to_array()).collect();
    dict.set_item("smoothed_T_world_robot", poses.into_pyarray(py).reshape([smoothed.len(), 3])?)?;
    dict.set_item("map", map_to_dict(py, &output.map)?)?;
    dict.set_item("filter_seconds", output.filter_seconds)?;
    dict.set_item("interrupted", output.interrupted)?;
    dict.set_item("store_rows", output.usage.rows)?;
    dict.set_item("store_bytes", output.usage.bytes)?;
    let skipped = skipped_to_dict(py, &output.skipped, output.returns)?;
    let fell_back: u64 = steps.iter().map(|s| u64::from(s.info.fell_back)).sum();
    skipped.set_item("joint_association_fallbacks", fell_back)?;
    // Where it is none, runs that draw in place and others say the same.
    if output.waits > 0 {
        skipped.set_item("steps_waited_for_draws", output.waits)?;
    }
    dict.set_item("skipped", skipped)?;
    Ok(dict)
}

/// Sightings that could not be used, by reason, and what came of the returns to landmarks.
pub fn skipped_to_dict<'py>(py: Python<'py>, skipped: &Skipped, returns: Returns) -> PyResult<Bound<'py, PyDict>> {
    let dict = PyDict::new(py);
    for (reason, count) in skipped.by_reason() {
        dict.set_item(format!("sightings_{reason}"), count)?;
    }
    dict.set_item("landmarks_visited_again", returns.visited)?;
    dict.set_item("landmarks_not_found_again", returns.in_vain)?;
    Ok(dict)
}

/// Scale and bias that were learned, under the names of their settings; empty where none was.
fn calibration<'py>(py: Python<'py>, learned: Option<&RangeErrors>) -> PyResult<Bound<'py, PyDict>> {
    let dict = PyDict::new(py);
    let Some(learned) = learned else { return Ok(dict) };
    for (value, std) in [
        (("range_scale", learned.range_scale), ("range_scale_std", learned.range_scale_std)),
        (("range_bias_m", learned.range_bias_m), ("range_bias_std_m", learned.range_bias_std_m)),
    ] {
        if let (name, Some(of)) = std {
            dict.set_item(value.0, value.1)?;
            dict.set_item(name, of)?;
        }
    }
    Ok(dict)
}

/// Stamps, computing times and what happened, a row per step.
fn steps_to_dict<'py>(py: Python<'py>, steps: &[StepRecord]) -> PyResult<Bound<'py, PyDict>> {
    let dict = PyDict::new(py);
    dict.set_item("stamp_s", steps.iter().map(|s| s.stamp_s).collect::<Vec<_>>().into_pyarray(py))?;
    dict.set_item("latency_us", steps.iter().map(|s| 1e6 * s.latency_s).collect::<Vec<_>>().into_pyarray(py))?;
    step::set_columns(&dict, steps.iter().map(|s| &s.info))?;
    Ok(dict)
}
