//! Bindings of the detectors: scans as arrays in, detections as columns out.

use crate::settings::{from_json, schema_of, to_json, to_python};
use fastslam_core::detect::{BeamGeometry, Detection, Detector, DetectorConfig, Piece, Scan, Verdict};
use fastslam_core::error::{Error, Result};
use fastslam_core::motion::Motion;
use fastslam_core::stream::{at_sensor, velocity_at, velocity_from};
use fastslam_core::timeline::ControlRow;
use numpy::ndarray::{ArrayView1, ArrayView2};
use numpy::{IntoPyArray, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// The JSON Schema of the settings of the detectors.
#[pyfunction]
fn detector_schema() -> PyResult<String> {
    schema_of::<DetectorConfig>()
}

/// Fills in defaults and checks every value.
#[pyfunction]
fn resolve_detector(json: &str) -> PyResult<String> {
    let config: DetectorConfig = from_json(json)?;
    config.validate().map_err(to_python)?;
    to_json(&config)
}

/// Ranges or intensities as they come: one row per scan, in either precision.
#[derive(FromPyObject)]
enum Table<'py> {
    Single(PyReadonlyArray2<'py, f32>),
    Double(PyReadonlyArray2<'py, f64>),
}

enum View<'a> {
    Single(ArrayView2<'a, f32>),
    Double(ArrayView2<'a, f64>),
}

impl Table<'_> {
    fn view(&self) -> View<'_> {
        match self {
            Self::Single(array) => View::Single(array.as_array()),
            Self::Double(array) => View::Double(array.as_array()),
        }
    }
}

impl View<'_> {
    fn shape(&self) -> (usize, usize) {
        match self {
            Self::Single(array) => array.dim(),
            Self::Double(array) => array.dim(),
        }
    }

    fn copy_row(&self, row: usize, to: &mut Vec<f64>) {
        to.clear();
        match self {
            Self::Single(array) => to.extend(array.row(row).iter().map(|&value| f64::from(value))),
            Self::Double(array) => to.extend(array.row(row).iter()),
        }
    }
}

/// Rows of all scans, and at which of them each scan ends.
struct Rows<T> {
    rows: Vec<T>,
    ends: Vec<usize>,
}

impl<T> Rows<T> {
    fn scan_index(&self) -> Vec<i64> {
        let mut index = Vec::with_capacity(self.rows.len());
        for (scan, &end) in self.ends.iter().enumerate() {
            index.resize(end, scan as i64);
        }
        index
    }
}

/// Everything that the detector reads, checked for shape.
struct Input<'a> {
    ranges_m: View<'a>,
    intensities: Option<View<'a>>,
    twists: Option<ArrayView2<'a, f64>>,
    geometry: BeamGeometry,
}

impl Input<'_> {
    fn check(&self, stamps: usize) -> PyResult<()> {
        let shape = self.ranges_m.shape();
        if shape.0 != stamps {
            return Err(PyValueError::new_err(format!("scans: got {} rows for {stamps} stamps", shape.0)));
        }
        if let Some(got) = self.intensities.as_ref().map(View::shape).filter(|&got| got != shape) {
            return Err(PyValueError::new_err(format!("scans: got intensities of shape {got:?} for ranges {shape:?}")));
        }
        if let Some(got) = self.twists.map(|twists| twists.dim()).filter(|&got| got != (stamps, 3)) {
            return Err(PyValueError::new_err(format!("scans: got twists of shape {got:?}, expected ({stamps}, 3)")));
        }
        Ok(())
    }

    /// Detections in all scans, and the pieces that the scans were cut into.
    fn detect(&self, config: DetectorConfig) -> Result<(Rows<Detection>, Rows<Piece>)> {
        let mut detector = Detector::new(config)?;
        let mut found = Rows { rows: Vec::new(), ends: Vec::new() };
        let mut pieces = Rows { rows: Vec::new(), ends: Vec::new() };
        let (mut ranges_m, mut intensities) = (Vec::new(), Vec::new());
        for row in 0..self.ranges_m.shape().0 {
            self.ranges_m.copy_row(row, &mut ranges_m);
            if let Some(view) = &self.intensities {
                view.copy_row(row, &mut intensities);
            }
            let scan = Scan {
                ranges_m: &ranges_m,
                intensities: self.intensities.as_ref().map(|_| intensities.as_slice()),
                geometry: self.geometry,
                twist: self.twists.map(|twists| [twists[[row, 0]], twists[[row, 1]], twists[[row, 2]]]),
            };
            detector.detect(&scan, &mut found.rows).map_err(|error| within_scan(error, row))?;
            found.ends.push(found.rows.len());
            pieces.rows.extend_from_slice(detector.pieces());
            pieces.ends.push(pieces.rows.len());
        }
        Ok((found, pieces))
    }
}

fn within_scan(error: Error, row: usize) -> Error {
    match error {
        Error::Input(message) => Error::Input(format!("scan {row}: {message}")),
        other => other,
    }
}

/// Finds landmarks in scans: columns of detections, and columns of the pieces that the scans were cut into with their
/// verdicts. `geometry_json` holds the fields of `BeamGeometry`; `twists` (N, 3) are the velocities of the sensor.
#[pyfunction]
#[pyo3(signature = (config_json, geometry_json, stamp_s, ranges_m, intensities=None, twists=None))]
fn detect<'py>(
    py: Python<'py>,
    config_json: &str,
    geometry_json: &str,
    stamp_s: PyReadonlyArray1<'py, f64>,
    ranges_m: Table<'py>,
    intensities: Option<Table<'py>>,
    twists: Option<PyReadonlyArray2<'py, f64>>,
) -> PyResult<(Bound<'py, PyDict>, Bound<'py, PyDict>)> {
    let config: DetectorConfig = from_json(config_json)?;
    let geometry: BeamGeometry = from_json(geometry_json)?;
    let stamps = stamp_s.as_array();
    let input = Input {
        ranges_m: ranges_m.view(),
        intensities: intensities.as_ref().map(Table::view),
        twists: twists.as_ref().map(|array| array.as_array()),
        geometry,
    };
    input.check(stamps.len())?;
    // Also for no scans at all, so that a wrong header is an error whatever follows it.
    geometry.validate(input.ranges_m.shape().1).map_err(|e| to_python(e.within("geometry")))?;
    let (found, pieces) = py.detach(|| input.detect(config)).map_err(to_python)?;
    Ok((detection_columns(py, &found, stamps)?, piece_columns(py, &pieces)?))
}

/// Velocities (N, 3) of the sensor at stamps (N), in its own frame, by the controls of a log.
#[pyfunction]
fn sensor_twists<'py>(
    py: Python<'py>,
    config_json: &str,
    control_stamps_s: PyReadonlyArray1<'py, f64>,
    controls: PyReadonlyArray2<'py, f64>,
    stamp_s: PyReadonlyArray1<'py, f64>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let config = crate::config::parse(config_json)?;
    let rows = control_rows(&control_stamps_s, &controls)?;
    let mounting = config.sensor.T_robot_sensor();
    let twist = |stamp_s: &f64| at_sensor(velocity_at(&config.motion, &rows, *stamp_s), mounting);
    let twists: Vec<f64> = stamp_s.as_array().iter().flat_map(twist).collect();
    twists.into_pyarray(py).reshape([stamp_s.as_array().len(), 3])
}

/// Velocities (C, 3) of the robot from each control until the next, by a motion model: the section `motion` as JSON.
#[pyfunction]
fn robot_twists<'py>(
    py: Python<'py>,
    motion_json: &str,
    control_stamps_s: PyReadonlyArray1<'py, f64>,
    controls: PyReadonlyArray2<'py, f64>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let motion: Motion = from_json(motion_json)?;
    let rows = control_rows(&control_stamps_s, &controls)?;
    let twists: Vec<f64> = (0..rows.len()).flat_map(|row| velocity_from(&motion, &rows, row)).collect();
    twists.into_pyarray(py).reshape([rows.len(), 3])
}

fn control_rows(
    stamps_s: &PyReadonlyArray1<'_, f64>,
    controls: &PyReadonlyArray2<'_, f64>,
) -> PyResult<Vec<ControlRow>> {
    let rows = stamps_s.as_array().into_iter().zip(crate::arrays::controls(controls)?);
    Ok(rows.map(|(stamp_s, control)| ControlRow { stamp_s: *stamp_s, control, covariance: None }).collect())
}

/// What may become of a piece of a scan, by number.
#[pyfunction]
fn verdicts() -> Vec<&'static str> {
    Verdict::ALL.iter().map(|verdict| verdict.label()).collect()
}

fn detection_columns<'py>(
    py: Python<'py>,
    found: &Rows<Detection>,
    stamps: ArrayView1<'_, f64>,
) -> PyResult<Bound<'py, PyDict>> {
    let (scan_index, found) = (found.scan_index(), &found.rows);
    let column = |f: &dyn Fn(&Detection) -> f64| found.iter().map(f).collect::<Vec<_>>().into_pyarray(py);
    let beams =
        |f: &dyn Fn(&Detection) -> u32| found.iter().map(|d| i64::from(f(d))).collect::<Vec<_>>().into_pyarray(py);
    let covariance: Vec<f64> = found.iter().map(|d| d.covariance).flat_map(|c| [c.xx, c.xy, c.yy]).collect();
    let out = PyDict::new(py);
    out.set_item("stamp_s", scan_index.iter().map(|&i| stamps[i as usize]).collect::<Vec<_>>().into_pyarray(py))?;
    out.set_item("scan_index", scan_index.into_pyarray(py))?;
    out.set_item("range_m", column(&|d| d.range_m))?;
    out.set_item("bearing_rad", column(&|d| d.bearing_rad))?;
    out.set_item("covariance", covariance.into_pyarray(py).reshape([found.len(), 3])?)?;
    out.set_item("signature", column(&|d| d.signature))?;
    out.set_item("intensity", column(&|d| d.intensity))?;
    out.set_item("detection_probability", column(&|d| d.detection_probability))?;
    out.set_item("first_beam", beams(&|d| d.first_beam))?;
    out.set_item("last_beam", beams(&|d| d.last_beam))?;
    Ok(out)
}

fn piece_columns<'py>(py: Python<'py>, pieces: &Rows<Piece>) -> PyResult<Bound<'py, PyDict>> {
    let column = |f: &dyn Fn(&Piece) -> i64| pieces.rows.iter().map(f).collect::<Vec<_>>().into_pyarray(py);
    let out = PyDict::new(py);
    out.set_item("scan_index", pieces.scan_index().into_pyarray(py))?;
    out.set_item("first_beam", column(&|p| i64::from(p.first_beam)))?;
    out.set_item("last_beam", column(&|p| i64::from(p.last_beam)))?;
    out.set_item("verdict", column(&|p| p.verdict as i64))?;
    Ok(out)
}

/// Adds everything here to the module.
pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(detector_schema, module)?)?;
    module.add_function(wrap_pyfunction!(resolve_detector, module)?)?;
    module.add_function(wrap_pyfunction!(verdicts, module)?)?;
    module.add_function(wrap_pyfunction!(sensor_twists, module)?)?;
    module.add_function(wrap_pyfunction!(robot_twists, module)?)?;
    module.add_function(wrap_pyfunction!(detect, module)?)
}
