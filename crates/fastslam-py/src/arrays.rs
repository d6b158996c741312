//! Arrays in and out.

use fastslam_core::association::Appearance;
use fastslam_core::filter::Sighting;
use fastslam_core::geometry::{Matrix3, Symmetric2};
use fastslam_core::measurement::Sensor;
use numpy::{PyReadonlyArray1, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// Rows of two or three controls as arrays of three; a missing third is zero.
pub fn controls(array: &PyReadonlyArray2<'_, f64>) -> PyResult<Vec<[f64; 3]>> {
    let view = array.as_array();
    let columns = view.ncols();
    if !(2..=3).contains(&columns) {
        return Err(PyValueError::new_err(format!("controls: got {columns} columns, expected 2 or 3")));
    }
    Ok(view.rows().into_iter().map(|r| [r[0], r[1], if columns == 3 { r[2] } else { 0.0 }]).collect())
}

/// Covariances of rows as upper triangles (xx, xy, xh, yy, yh, hh); NaN means that a row has none.
pub fn control_covariances(array: Option<&PyReadonlyArray2<'_, f64>>) -> PyResult<Vec<Option<Matrix3>>> {
    let Some(view) = array.map(|a| a.as_array()) else { return Ok(Vec::new()) };
    if view.ncols() != 6 {
        return Err(PyValueError::new_err(format!(
            "covariances of controls: got {} columns, expected 6",
            view.ncols()
        )));
    }
    let matrix = |r: [f64; 6]| [[r[0], r[1], r[2]], [r[1], r[3], r[4]], [r[2], r[4], r[5]]];
    let triangles = view.rows().into_iter().map(|row| std::array::from_fn(|k| row[k]));
    Ok(triangles.map(|r: [f64; 6]| (!r.iter().any(|v| v.is_nan())).then(|| matrix(r))).collect())
}

/// What sightings look like, as columns: class −1 means none, a signature of NaN none.
#[derive(Default)]
pub struct Looks<'py> {
    pub class_index: Option<PyReadonlyArray1<'py, i64>>,
    pub signature: Option<PyReadonlyArray1<'py, f64>>,
}

impl Looks<'_> {
    fn check_length(&self, n: usize) -> PyResult<()> {
        let classes = self.class_index.as_ref().map_or(n, |a| a.as_array().len());
        let signatures = self.signature.as_ref().map_or(n, |a| a.as_array().len());
        if classes == n && signatures == n {
            return Ok(());
        }
        Err(PyValueError::new_err(format!("sightings: got {n} ranges, {classes} classes and {signatures} signatures")))
    }

    fn get(&self, i: usize) -> PyResult<Appearance> {
        let class = match self.class_index.as_ref().map_or(-1, |a| a.as_array()[i]) {
            -1 => None,
            value => Some(u32::try_from(value).map_err(|_| {
                PyValueError::new_err(format!("sightings: class {value} of row {i}, expected -1 to 4294967295"))
            })?),
        };
        let signature = self.signature.as_ref().map(|a| a.as_array()[i]).filter(|value| !value.is_nan());
        Ok(Appearance { class, signature })
    }
}

/// Sightings from columns of equal length; identity −1 means unknown, a noise covariance of NaN means the sensor's.
pub fn sightings(
    range_m: &PyReadonlyArray1<'_, f64>,
    bearing_rad: &PyReadonlyArray1<'_, f64>,
    identity: &PyReadonlyArray1<'_, i64>,
    noise: Option<&PyReadonlyArray2<'_, f64>>,
    looks: &Looks<'_>,
) -> PyResult<Vec<Sighting>> {
    let (range_m, bearing_rad, identity) = (range_m.as_array(), bearing_rad.as_array(), identity.as_array());
    let n = range_m.len();
    if bearing_rad.len() != n || identity.len() != n || noise.is_some_and(|a| a.as_array().dim() != (n, 3)) {
        return Err(PyValueError::new_err(format!(
            "sightings: got {n} ranges, {} bearings and {} identities, expected equal numbers (and noise as n x 3)",
            bearing_rad.len(),
            identity.len()
        )));
    }
    looks.check_length(n)?;
    (0..n)
        .map(|i| {
            let identity = match identity[i] {
                -1 => None,
                value => Some(u32::try_from(value).map_err(|_| {
                    PyValueError::new_err(format!("sightings: identity {value} of row {i}, expected -1 to 4294967295"))
                })?),
            };
            let noise = noise
                .map(|a| a.as_array())
                .and_then(|a| a[[i, 0]].is_finite().then(|| Symmetric2::new(a[[i, 0]], a[[i, 1]], a[[i, 2]])));
            Ok(Sighting { value: [range_m[i], bearing_rad[i]], identity, noise, appearance: looks.get(i)? })
        })
        .collect()
}

/// Sightings as the sensors of a run make them, each by that of the number that `by` gives: what it does not measure counts
/// for nothing. The filter refuses the numbers of sensors that there are not.
pub fn of_sensors(sensors: &[&Sensor], by: impl Fn(usize) -> usize, mut sightings: Vec<Sighting>) -> Vec<Sighting> {
    for (i, sighting) in sightings.iter_mut().enumerate() {
        let [range_m, bearing_rad] = sighting.value;
        sighting.value = sensors.get(by(i)).map_or(sighting.value, |sensor| sensor.value_of(range_m, bearing_rad));
    }
    sightings
}
