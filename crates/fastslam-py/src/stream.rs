//! The filter on a stream of rows.

use crate::filter::{identities_named, Scan};
use crate::given::{GivenMap, GivenStart};
use crate::sensor::{self, check_not_asked, Sensor};
use crate::settings::{from_json, to_json, to_python};
use crate::view::{hypotheses_to_arrays, map_to_dict, path_to_arrays, View};
use crate::{config, given, noise, run, step};
use fastslam_core::config::Config;
use fastslam_core::error::Result;
use fastslam_core::filter::PoseEstimate;
use fastslam_core::geometry::Matrix3;
use fastslam_core::late::Late;
use fastslam_core::run::RunOutput;
use fastslam_core::stream::{ScanRow, Scanner, StepRecord, Stream as Core, Taken, Window};
use fastslam_core::timeline::{ControlRow, Row, SightingsRow};
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1};
use pyo3::exceptions::PySystemError;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};
use std::sync::{Mutex, MutexGuard};
use std::time::Instant;

type Vector<'py> = Bound<'py, PyArray1<f64>>;
type Matrix<'py> = Bound<'py, PyArray2<f64>>;
/// A stamp with the mean (3) and the covariance (3, 3) of a pose.
type StampedPose<'py> = (f64, Vector<'py>, Matrix<'py>);

/// A stream; frozen around a lock, as `Filter` is.
#[pyclass(frozen)]
pub struct Stream {
    stream: Mutex<Core>,
    /// The steps so far, where they are kept.
    steps: Mutex<Option<Vec<StepRecord>>>,
    config: Config,
    sensor: Option<Sensor>,
}

impl Stream {
    fn locked<T: Send>(&self, py: Python<'_>, work: impl FnOnce(&mut Core) -> T + Send) -> PyResult<T> {
        check_not_asked()?;
        py.detach(|| self.stream.lock().map(|mut stream| work(&mut stream)).ok())
            .ok_or_else(|| PySystemError::new_err("the stream failed in an earlier call and cannot go on"))
    }

    fn kept(&self) -> PyResult<MutexGuard<'_, Option<Vec<StepRecord>>>> {
        self.steps.lock().map_err(|_| PySystemError::new_err("the stream failed in an earlier call"))
    }

    fn put(&self, py: Python<'_>, push: impl FnOnce(&mut Core) -> Result<Taken> + Send) -> PyResult<&'static str> {
        let taken: Result<Taken> = self.locked(py, push)?;
        Ok(match taken.map_err(to_python)? {
            Taken::Yes => "taken",
            Taken::Late => "late",
            Taken::Repeated => "repeated",
            Taken::Ahead => "ahead",
        })
    }
}

fn pose_to_arrays<'py>(py: Python<'py>, stamp_s: f64, pose: &PoseEstimate) -> PyResult<StampedPose<'py>> {
    let covariance = pose.covariance.concat().into_pyarray(py).reshape([3, 3])?;
    Ok((stamp_s, pose.mean.to_array().to_vec().into_pyarray(py), covariance))
}

#[pymethods]
impl Stream {
    /// `window`: how late rows may be, how long sightings wait for odometry, how far ahead a row may be; seconds.
    #[new]
    #[pyo3(signature = (config_json, identities, window, sensor=None))]
    fn new(config_json: &str, identities: &str, window: [f64; 3], sensor: Option<Sensor>) -> PyResult<Self> {
        let config = config::parse(config_json)?;
        let [late_s, wait_s, gap_s] = window;
        let window = Window { late_s, wait_s, gap_s };
        window.validate().map_err(to_python)?;
        let make = |config, identities| sensor::make(sensor.as_ref(), config, identities);
        let made = Core::of(config.clone(), identities_named(identities)?, window, &make);
        let stream = Mutex::new(sensor::answer(sensor.as_ref(), made)?);
        Ok(Self { stream, steps: Mutex::default(), config, sensor })
    }

    /// The stream of a snapshot, its configuration as JSON, and the note that was kept with it.
    #[staticmethod]
    #[pyo3(signature = (snapshot, sensor=None))]
    fn load(py: Python<'_>, snapshot: &[u8], sensor: Option<Sensor>) -> PyResult<(Self, String, String)> {
        let make = |config, identities| sensor::make(sensor.as_ref(), config, identities);
        let loaded = py.detach(|| Core::load(snapshot, &make));
        let (stream, note) = sensor::answer(sensor.as_ref(), loaded)?;
        let config = stream.config().clone();
        let json = to_json(&config)?;
        Ok((Self { stream: Mutex::new(stream), steps: Mutex::default(), config, sensor }, json, note))
    }

    /// Starts in a map, at a start: before anything else.
    #[pyo3(signature = (map=None, start=None))]
    fn begin(&self, py: Python<'_>, map: Option<GivenMap<'_>>, start: Option<GivenStart<'_>>) -> PyResult<()> {
        let beginning = given::beginning(map, start)?;
        self.locked(py, |stream| stream.begin(&beginning))?.map_err(to_python)
    }

    /// From here on the steps are kept, for `output`.
    fn keep_steps(&self) -> PyResult<()> {
        self.kept()?.get_or_insert_default();
        Ok(())
    }

    /// What it has come to, as `run` returns it; the steps are those that were kept.
    fn output<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let steps = self.kept()?.clone().unwrap_or_default();
        let output = self.locked(py, |stream| RunOutput::of(stream, steps))?;
        run::to_dict(py, &output, &self.config)
    }

    /// What speaks for and against it so far, of which nothing grows with the drive: `noise` and `skipped` of `output`.
    fn so_far<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let (skipped, noise, returns) = self.locked(py, |stream| {
            let skipped = stream.skipped();
            (skipped, stream.filter().noise_report(), stream.filter().returns())
        })?;
        let dict = PyDict::new(py);
        dict.set_item("noise", noise::report(py, &noise, &self.config.motion)?)?;
        dict.set_item("skipped", run::skipped_to_dict(py, &skipped, returns)?)?;
        Ok(dict)
    }

    fn save<'py>(&self, py: Python<'py>, note: &str) -> PyResult<Bound<'py, PyBytes>> {
        let bytes = self.locked(py, |stream| stream.save(note))?.map_err(to_python)?;
        Ok(PyBytes::new(py, &bytes))
    }

    /// What became of the row: taken, late, repeated or ahead.
    #[pyo3(signature = (stamp_s, control, covariance=None))]
    fn odometry(
        &self,
        py: Python<'_>,
        stamp_s: f64,
        control: [f64; 3],
        covariance: Option<Matrix3>,
    ) -> PyResult<&'static str> {
        self.put(py, |stream| stream.push(Row::Control(ControlRow { stamp_s, control, covariance })))
    }

    /// As `odometry`, of the sightings of one moment by the sensor of this number.
    #[pyo3(signature = (stamp_s, scan, by=0))]
    fn sightings(&self, py: Python<'_>, stamp_s: f64, scan: Scan<'_>, by: usize) -> PyResult<&'static str> {
        let sightings = scan.sightings(&self.config, |_| by)?;
        self.put(py, |stream| stream.push(Row::Sightings(SightingsRow { stamp_s, sightings, sensor: by })))
    }

    /// From here on scans of a laser are taken; `geometry_json` holds the fields of `BeamGeometry`.
    fn scan_with(&self, py: Python<'_>, detector_json: &str, geometry_json: &str) -> PyResult<()> {
        let scanner = Scanner { geometry: from_json(geometry_json)?, detector: from_json(detector_json)? };
        self.locked(py, |stream| stream.scan_with(scanner))?.map_err(to_python)
    }

    /// As `odometry`, of one turn of the laser.
    #[pyo3(signature = (stamp_s, ranges_m, intensities=None))]
    fn scan(
        &self,
        py: Python<'_>,
        stamp_s: f64,
        ranges_m: PyReadonlyArray1<'_, f64>,
        intensities: Option<PyReadonlyArray1<'_, f64>>,
    ) -> PyResult<&'static str> {
        let intensities = intensities.map(|array| array.as_array().to_vec());
        let scan = ScanRow { stamp_s, ranges_m: ranges_m.as_array().to_vec(), intensities };
        self.put(py, |stream| stream.push_scan(scan))
    }

    /// Nothing more comes.
    fn end(&self, py: Python<'_>) -> PyResult<&'static str> {
        self.put(py, |stream| stream.push(Row::End))
    }

    /// The next step that the rows allow: its stamp, pose, covariance and fields; none where more must come.
    fn step<'py>(&self, py: Python<'py>) -> PyResult<Option<(StampedPose<'py>, Bound<'py, PyDict>)>> {
        let begun = Instant::now();
        let record = sensor::answer(self.sensor.as_ref(), self.locked(py, Core::step)?)?;
        let Some(record) = record else { return Ok(None) };
        if let Some(steps) = self.kept()?.as_mut() {
            steps.push(StepRecord { latency_s: begun.elapsed().as_secs_f64(), ..record });
        }
        let StepRecord { stamp_s, pose, info, .. } = record;
        let dict = PyDict::new(py);
        step::set_values(&dict, &info)?;
        dict.set_item("warnings", noise::warnings(py, &info.noise.warnings, &self.config.motion)?)?;
        Ok(Some((pose_to_arrays(py, stamp_s, &pose)?, dict)))
    }

    fn finish(&self, py: Python<'_>) -> PyResult<bool> {
        let changed = self.locked(py, Core::finish)?;
        sensor::answer(self.sensor.as_ref(), Ok(changed))
    }

    /// Stamp, mean and covariance of the pose at the newest row; none before the first.
    fn newest_pose<'py>(&self, py: Python<'py>) -> PyResult<Option<StampedPose<'py>>> {
        let newest = self.locked(py, |stream| stream.newest_pose())?.map_err(to_python)?;
        newest.map(|(stamp_s, pose)| pose_to_arrays(py, stamp_s, &pose)).transpose()
    }

    /// Mean and covariance of the pose as far as it is computed.
    fn computed_pose<'py>(&self, py: Python<'py>) -> PyResult<(Vector<'py>, Matrix<'py>)> {
        let pose = self.locked(py, |stream| stream.filter().pose())?;
        let (_, mean, covariance) = pose_to_arrays(py, 0.0, &pose)?;
        Ok((mean, covariance))
    }

    /// Poses (M, 3) and normalised weights (M) of the particles.
    fn particles<'py>(&self, py: Python<'py>) -> PyResult<(Matrix<'py>, Vector<'py>)> {
        let hypotheses = self.locked(py, |stream| stream.filter().weighted_poses())?;
        hypotheses_to_arrays(py, &hypotheses)
    }

    /// What it looks like after the last step.
    fn view<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        self.locked(py, View::of)?.to_dict(py)
    }

    fn map<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let map = self.locked(py, |stream| stream.filter().map())?;
        map_to_dict(py, &map)
    }

    /// Stamps (T) and poses (T, 3) of the path with a pose at every step.
    fn smoothed<'py>(&self, py: Python<'py>) -> PyResult<(Vector<'py>, Matrix<'py>)> {
        let path = self.locked(py, |stream| stream.smoothed())?;
        path_to_arrays(py, &path)
    }

    /// How many steps have waited for a draw of paths beside the filter, and how many have gone on without one.
    fn lateness(&self, py: Python<'_>) -> PyResult<(u64, u64)> {
        let lateness = self.locked(py, |stream| stream.filter().lateness())?;
        Ok((lateness.waits, lateness.put_off))
    }

    /// From here on no step waits for a draw of paths beside the filter.
    fn put_off_late_draws(&self, py: Python<'_>) -> PyResult<()> {
        self.locked(py, |stream| stream.filter().when_late(Late::PutOff))
    }

    /// Numbers of rows that were refused, by reason, and of those that wait.
    fn counts<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let (refused, waiting) = self.locked(py, |stream| (stream.refused(), stream.waiting()))?;
        let dict = PyDict::new(py);
        dict.set_item("late", refused.late)?;
        dict.set_item("repeated", refused.repeated)?;
        dict.set_item("ahead", refused.ahead)?;
        dict.set_item("waiting", waiting)?;
        Ok(dict)
    }
}
