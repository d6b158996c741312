//! The filter, step by step.

use crate::given::{GivenMap, GivenStart};
use crate::sensor::{self, check_not_asked, Sensor};
use crate::settings::{to_json, to_python};
use crate::view::{hypotheses_to_arrays, map_to_dict, path_to_arrays};
use crate::{arrays, config, given, step};
use fastslam_core::config::Config;
use fastslam_core::error::Result;
use fastslam_core::filter::{Identities, Scan as CoreScan, Sighting, StepInfo};
use fastslam_core::slam::{self, Slam};
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};
use std::sync::Mutex;

type Vector<'py> = Bound<'py, PyArray1<f64>>;
type Matrix<'py> = Bound<'py, PyArray2<f64>>;

/// The configured filter, one control and one scan at a time.
///
/// Frozen around a lock, so that several threads may use it: each call finds the filter between two calls. The lock is
/// only waited for, and only held, without the interpreter's lock.
#[pyclass(frozen)]
pub struct Filter {
    filter: Mutex<Box<dyn Slam>>,
    config: Config,
    sensor: Option<Sensor>,
}

impl Filter {
    /// What `work` makes of the filter, with the interpreter free for other threads.
    fn locked<T: Send>(&self, py: Python<'_>, work: impl FnOnce(&mut dyn Slam) -> T + Send) -> PyResult<T> {
        check_not_asked()?;
        py.detach(|| self.filter.lock().map(|mut filter| work(filter.as_mut())).ok())
            .ok_or_else(|| PyRuntimeError::new_err("the filter failed in an earlier call and cannot go on"))
    }

    /// What `work` makes of the filter, or what went wrong there, in the sensor's class too.
    fn worked<T: Send>(&self, py: Python<'_>, work: impl FnOnce(&mut dyn Slam) -> Result<T> + Send) -> PyResult<T> {
        sensor::answer(self.sensor.as_ref(), self.locked(py, work)?)
    }

    fn answer<'py>(&self, py: Python<'py>, info: &StepInfo) -> PyResult<Bound<'py, PyDict>> {
        let dict = PyDict::new(py);
        step::set_values(&dict, info)?;
        dict.set_item("warnings", crate::noise::warnings(py, &info.noise.warnings, &self.config.motion)?)?;
        Ok(dict)
    }
}

/// Which sightings will come with an identity.
pub fn identities_named(name: &str) -> PyResult<Identities> {
    match name {
        "all" => Ok(Identities::All),
        "some" => Ok(Identities::Some),
        "none" => Ok(Identities::None),
        other => Err(PyValueError::new_err(format!("identities: got {other}, expected all, some or none"))),
    }
}

/// The columns of one scan.
#[derive(FromPyObject)]
pub struct Scan<'py>(
    PyReadonlyArray1<'py, f64>,
    PyReadonlyArray1<'py, f64>,
    PyReadonlyArray1<'py, i64>,
    Option<PyReadonlyArray2<'py, f64>>,
    Option<PyReadonlyArray1<'py, i64>>,
    Option<PyReadonlyArray1<'py, f64>>,
);

impl Scan<'_> {
    /// The sightings, checked: nothing of the filter has changed when this fails.
    ///
    /// `by` gives the number of the sensor that made each.
    pub fn sightings(self, config: &Config, by: impl Fn(usize) -> usize) -> PyResult<Vec<Sighting>> {
        let Self(range_m, bearing_rad, identity, noise, class_index, signature) = self;
        let looks = arrays::Looks { class_index, signature };
        let sightings = arrays::sightings(&range_m, &bearing_rad, &identity, noise.as_ref(), &looks)?;
        let sightings = arrays::of_sensors(&config.each_sensor(), by, sightings);
        config.association.check_classes(&sightings).map_err(to_python)?;
        Ok(sightings)
    }
}

#[pymethods]
impl Filter {
    /// `sensor`: a sensor of one's own, as `fastslam.sensors.Adapter`.
    #[new]
    #[pyo3(signature = (config_json, identities, sensor=None))]
    fn new(config_json: &str, identities: &str, sensor: Option<Sensor>) -> PyResult<Self> {
        let identities = identities_named(identities)?;
        let config = config::parse(config_json)?;
        let filter = sensor::answer(sensor.as_ref(), sensor::make(sensor.as_ref(), config.clone(), identities))?;
        Ok(Self { filter: Mutex::new(filter), config, sensor })
    }

    /// Starts in a map, at a start: before anything else.
    #[pyo3(signature = (map=None, start=None))]
    fn begin(&self, py: Python<'_>, map: Option<GivenMap<'_>>, start: Option<GivenStart<'_>>) -> PyResult<()> {
        let beginning = given::beginning(map, start)?;
        self.worked(py, |filter| filter.begin(&beginning))
    }

    /// The filter of a snapshot, its configuration as JSON, and the note that was kept with it.
    #[staticmethod]
    #[pyo3(signature = (snapshot, sensor=None))]
    fn load(py: Python<'_>, snapshot: &[u8], sensor: Option<Sensor>) -> PyResult<(Self, String, String)> {
        let make = |config, identities| sensor::make(sensor.as_ref(), config, identities);
        let loaded = py.detach(|| slam::load(snapshot, &make));
        let (filter, config, note) = sensor::answer(sensor.as_ref(), loaded)?;
        let json = to_json(&config)?;
        Ok((Self { filter: Mutex::new(filter), config, sensor }, json, note))
    }

    /// The state as bytes, with a note.
    fn save<'py>(&self, py: Python<'py>, note: &str) -> PyResult<Bound<'py, PyBytes>> {
        let bytes = self.worked(py, |filter| filter.save(note))?;
        Ok(PyBytes::new(py, &bytes))
    }

    fn predict(&self, py: Python<'_>, control: [f64; 3], dt_s: f64) -> PyResult<()> {
        self.worked(py, |filter| filter.predict(control, dt_s))
    }

    /// `scan`: range_m, bearing_rad, identity, then noise (n x 3), class_index and signature or None; `by`: the number of
    /// its sensor.
    #[pyo3(signature = (stamp_s, scan, by=0))]
    fn update<'py>(&self, py: Python<'py>, stamp_s: f64, scan: Scan<'py>, by: usize) -> PyResult<Bound<'py, PyDict>> {
        let sightings = scan.sightings(&self.config, |_| by)?;
        let info = self.worked(py, |filter| filter.take(CoreScan { stamp_s, sensor: by, sightings: &sightings }))?;
        self.answer(py, &info)
    }

    /// `predict`, then `update`, between which no other thread comes.
    fn step<'py>(
        &self,
        py: Python<'py>,
        control: [f64; 3],
        dt_s: f64,
        stamp_s: f64,
        scan: Scan<'py>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let sightings = scan.sightings(&self.config, |_| 0)?;
        let both = |filter: &mut dyn Slam| {
            filter.predict(control, dt_s)?;
            filter.update(stamp_s, &sightings)
        };
        let info = self.worked(py, both)?;
        self.answer(py, &info)
    }

    /// Mean (3) and covariance (3, 3) of the pose now.
    fn pose<'py>(&self, py: Python<'py>) -> PyResult<(Vector<'py>, Matrix<'py>)> {
        let estimate = self.locked(py, |filter| filter.predicted_pose())?;
        let covariance = estimate.covariance.concat().into_pyarray(py).reshape([3, 3])?;
        Ok((estimate.mean.to_array().to_vec().into_pyarray(py), covariance))
    }

    /// Poses (M, 3) and normalised weights (M) of the particles.
    fn particles<'py>(&self, py: Python<'py>) -> PyResult<(Matrix<'py>, Vector<'py>)> {
        let hypotheses = self.locked(py, |filter| filter.weighted_poses())?;
        hypotheses_to_arrays(py, &hypotheses)
    }

    /// Draws all particles anew from the posterior over paths; false when it was not configured or nothing changed.
    fn rejuvenate(&self, py: Python<'_>) -> PyResult<bool> {
        self.worked(py, |filter| Ok(filter.finish()))
    }

    fn map<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let map = self.locked(py, |filter| filter.map())?;
        map_to_dict(py, &map)
    }

    /// Stamps (T) and poses (T, 3) of the path of the best particle.
    fn best_path<'py>(&self, py: Python<'py>) -> PyResult<(Vector<'py>, Matrix<'py>)> {
        let path = self.locked(py, |filter| filter.best_path())?;
        path_to_arrays(py, &path)
    }
}
