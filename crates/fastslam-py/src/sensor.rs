//! A sensor of one's own, in Python.

use crate::settings::to_python;
use fastslam_core::config::Config;
use fastslam_core::error::{Error, Result};
use fastslam_core::filter::Identities;
use fastslam_core::geometry::Pose;
use fastslam_core::measurement::{self, RangeOnly};
use fastslam_core::normal::{Matrix, Normal};
use fastslam_core::partial::{Look, PartialSlam, Request, Sensing};
use fastslam_core::slam::{self, Slam};
use numpy::{IntoPyArray, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3, PyReadonlyArray4};
use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use std::cell::Cell;
use std::sync::{Arc, Mutex};

type Table<'py> = Bound<'py, numpy::PyArray2<f64>>;

thread_local! {
    /// Whether this thread is in a sensor: its filter waits for the answer, and cannot be asked.
    static ASKED: Cell<bool> = const { Cell::new(false) };
}

/// What the package made of a user's class (`fastslam.sensors.Adapter`), and what went wrong there.
#[derive(Clone)]
pub struct Sensor {
    object: Arc<Py<PyAny>>,
    failure: Arc<Mutex<Option<PyErr>>>,
}

impl FromPyObject<'_, '_> for Sensor {
    type Error = PyErr;
    fn extract(object: Borrowed<'_, '_, PyAny>) -> PyResult<Self> {
        Ok(Self { object: Arc::new(object.to_owned().unbind()), failure: Arc::default() })
    }
}

/// A sensor with what does not change.
struct Foreign<const Z: usize> {
    sensor: Sensor,
    noise: Matrix<Z, Z>,
    /// Which of range and bearing it measures.
    columns: [usize; Z],
    births: Births,
}

/// Where the births of a sensor come from.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Births {
    /// Its own class.
    Own,
    /// Rings of ranges.
    Ring,
}

impl Sensor {
    /// What the object answers; an exception is kept for whoever called the filter.
    fn ask<T>(&self, question: impl FnOnce(&Bound<'_, PyAny>) -> PyResult<T>) -> Result<T> {
        let was = ASKED.replace(true);
        let answer = Python::attach(|py| question(self.object.bind(py)));
        ASKED.set(was);
        answer.map_err(|error| {
            let message = error.to_string();
            if let Ok(mut failure) = self.failure.lock() {
                failure.get_or_insert(error);
            }
            Error::Input(message)
        })
    }

    /// Makes the filter of a configuration for it.
    fn make(&self, config: Config, identities: Identities) -> Result<Box<dyn Slam>> {
        slam::check_names("own", identities)?;
        match self.ask(|object| object.getattr("size")?.extract::<usize>())? {
            1 => self.filter::<1>(config),
            _ => self.filter::<2>(config),
        }
    }

    fn filter<const Z: usize>(&self, config: Config) -> Result<Box<dyn Slam>> {
        check_alone(&config)?;
        let (noise, columns, births) = self.ask(|object| {
            let noise: PyReadonlyArray2<'_, f64> = object.getattr("noise")?.extract()?;
            let births = if object.getattr("has_births")?.extract()? { Births::Own } else { Births::Ring };
            Ok((table(&noise), object.getattr("columns")?.extract::<[usize; Z]>()?, births))
        })?;
        let foreign = Foreign { sensor: self.clone(), noise, columns, births };
        // Scale and bias are those of ranges: alone, or where somebody asks for them.
        let errors = config.sensor.range_errors();
        let asked = errors.range_scale_std.is_some() || errors.range_bias_std_m.is_some();
        Ok(match columns[0] == 0 && (Z == 1 || asked) {
            true => Box::new(PartialSlam::learning(config, foreign)?),
            false => Box::new(PartialSlam::new(config, foreign)?),
        })
    }

    fn take_failure(&self) -> Option<PyErr> {
        self.failure.lock().ok().and_then(|mut failure| failure.take())
    }
}

/// Errors where there are others beside a sensor of one's own.
fn check_alone(config: &Config) -> Result<()> {
    match config.sensors.is_empty() {
        true => Ok(()),
        false => Err(Error::parameter("sensors", "a sensor of one's own beside them", "`sensor`, which it stands for")),
    }
}

/// The filter of a configuration, for a sensor of one's own where there is one.
pub fn make(sensor: Option<&Sensor>, config: Config, identities: Identities) -> Result<Box<dyn Slam>> {
    match sensor {
        Some(sensor) => sensor.make(config, identities),
        None => slam::create(config, identities),
    }
}

/// What the core answered; where a sensor's class has failed, with its exception.
pub fn answer<T>(sensor: Option<&Sensor>, answer: Result<T>) -> PyResult<T> {
    match sensor.and_then(Sensor::take_failure) {
        Some(error) => Err(error),
        None => answer.map_err(to_python),
    }
}

/// Errors where this thread was asked by the filter that it asks.
pub fn check_not_asked() -> PyResult<()> {
    match ASKED.get() {
        true => Err(PyRuntimeError::new_err("a filter cannot be called from within its sensor")),
        false => Ok(()),
    }
}

impl<const Z: usize> Sensing<Z> for Foreign<Z> {
    fn look(&self, requests: &[Request<Z>]) -> Result<Vec<Look<Z>>> {
        if requests.is_empty() {
            return Ok(Vec::new());
        }
        self.sensor.ask(|object| {
            let py = object.py();
            let column = |of: fn(&Request<Z>) -> f64| requests.iter().map(of).collect::<Vec<_>>().into_pyarray(py);
            let answer = object.call_method1(
                "look",
                (
                    rows(py, requests.iter().map(|request| request.T_world_sensor.to_array()))?,
                    rows(py, requests.iter().map(|request| request.landmark))?,
                    rows(py, requests.iter().map(|request| request.measured))?,
                    column(|request| request.calibration.scale),
                    column(|request| request.calibration.bias),
                ),
            )?;
            let (innovation, by_scale, by_landmark, by_pose): (
                PyReadonlyArray2<'_, f64>,
                PyReadonlyArray1<'_, f64>,
                PyReadonlyArray3<'_, f64>,
                PyReadonlyArray3<'_, f64>,
            ) = answer.extract()?;
            let (innovation, by_scale) = (innovation.as_array(), by_scale.as_array());
            let (by_landmark, by_pose) = (by_landmark.as_array(), by_pose.as_array());
            let look = |i: usize| Look {
                innovation: std::array::from_fn(|z| innovation[[i, z]]),
                by_scale: by_scale[i],
                by_landmark: std::array::from_fn(|z| std::array::from_fn(|d| by_landmark[[i, z, d]])),
                by_pose: std::array::from_fn(|z| std::array::from_fn(|d| by_pose[[i, z, d]])),
            };
            Ok((0..requests.len()).map(look).collect())
        })
    }

    fn noise(&self) -> Matrix<Z, Z> {
        self.noise
    }

    fn columns(&self) -> [usize; Z] {
        self.columns
    }

    fn distance(&self, measured: &[f64; Z]) -> Option<f64> {
        (self.columns[0] == 0).then_some(measured[0])
    }

    fn births(&self, sightings: &[(Pose, [f64; Z])], noise: &Matrix<Z, Z>) -> Result<Vec<Vec<(f64, Normal<2>)>>> {
        if self.births == Births::Ring {
            let model = RangeOnly { range_std_m: self.noise[0][0].sqrt() };
            let across = [[noise[0][0]]];
            let ring = |(pose, measured): &(Pose, [f64; Z])| {
                measurement::Births::births(&model, *pose, [measured[0]], &across)
            };
            return Ok(sightings.iter().map(ring).collect());
        }
        self.sensor.ask(|object| {
            let py = object.py();
            let answer = object.call_method1(
                "births",
                (
                    rows(py, sightings.iter().map(|(pose, _)| pose.to_array()))?,
                    rows(py, sightings.iter().map(|(_, measured)| *measured))?,
                ),
            )?;
            let (share, mean, covariance): (
                PyReadonlyArray2<'_, f64>,
                PyReadonlyArray3<'_, f64>,
                PyReadonlyArray4<'_, f64>,
            ) = answer.extract()?;
            let (share, mean, covariance) = (share.as_array(), mean.as_array(), covariance.as_array());
            let birth = |i: usize, k: usize| {
                let covariance = std::array::from_fn(|a| std::array::from_fn(|b| covariance[[i, k, a, b]]));
                (share[[i, k]], Normal { mean: std::array::from_fn(|d| mean[[i, k, d]]), covariance })
            };
            let of = |i: usize| (0..share.ncols()).map(|k| birth(i, k)).collect();
            Ok((0..sightings.len()).map(of).collect())
        })
    }
}

/// Rows as an array of two dimensions.
fn rows<const N: usize>(py: Python<'_>, rows: impl ExactSizeIterator<Item = [f64; N]>) -> PyResult<Table<'_>> {
    let count = rows.len();
    rows.flatten().collect::<Vec<_>>().into_pyarray(py).reshape([count, N])
}

/// The first `Z` rows and columns.
fn table<const Z: usize>(array: &PyReadonlyArray2<'_, f64>) -> Matrix<Z, Z> {
    let view = array.as_array();
    std::array::from_fn(|a| std::array::from_fn(|b| view[[a, b]]))
}
