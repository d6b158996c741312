//! Bindings of placements: landmarks as arrays in, places as columns out.

use fastslam_core::geometry::Pose;
use fastslam_core::placement::{self, Effort, Labels, Mark, Placement, View};
use numpy::ndarray::{Array1, Array2, Array3};
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArray3, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// Landmarks: mean (n x 2), variance (n) and label (n, −1: nobody says).
#[derive(FromPyObject)]
pub struct Marks<'py>(PyReadonlyArray2<'py, f64>, PyReadonlyArray1<'py, f64>, PyReadonlyArray1<'py, i64>);

/// From where a local map was seen: poses of the sensor (t x 3) in its frame, reach in metres, half field of view.
#[derive(FromPyObject)]
pub struct Seen<'py>(PyReadonlyArray2<'py, f64>, f64, f64);

/// Poses (k x 3), covariances (k x 3 x 3), log-odds (k) and how many were matched (k).
type Places<'py> =
    (Bound<'py, PyArray2<f64>>, Bound<'py, PyArray3<f64>>, Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<i64>>);

/// A map in which small ones are looked for.
#[pyclass(frozen, module = "fastslam._core")]
pub struct Chart(placement::Chart);

#[pymethods]
impl Chart {
    #[new]
    fn new(marks: Marks<'_>, names: bool) -> PyResult<Self> {
        let labels = if names { Labels::Names } else { Labels::Classes };
        Ok(Self(placement::Chart::new(marks_of(&marks)?, labels)))
    }

    /// The likeliest places of a local map, the best first; `effort` is how many are refined, and told at most.
    fn placements<'py>(
        &self,
        py: Python<'py>,
        local: Marks<'py>,
        seen: Seen<'py>,
        effort: (usize, usize),
    ) -> PyResult<Places<'py>> {
        let (local, view) = (marks_of(&local)?, view_of(&seen)?);
        let (refined, told) = effort;
        let found = py.detach(|| self.0.placements(&local, &view, Effort { refined, told }));
        Ok(columns(py, &found))
    }
}

fn view_of(Seen(sensors, reach_m, half_view_rad): &Seen<'_>) -> PyResult<View> {
    let sensors = sensors.as_array();
    if sensors.ncols() != 3 || sensors.iter().any(|value| !value.is_finite()) {
        return Err(PyValueError::new_err("sensors: expected finite poses (t x 3)"));
    }
    let sensors = sensors.rows().into_iter().map(|row| Pose::new(row[0], row[1], row[2])).collect();
    Ok(View { sensors, reach_m: *reach_m, half_view_rad: *half_view_rad })
}

fn columns<'py>(py: Python<'py>, found: &[Placement]) -> Places<'py> {
    let count = found.len();
    let poses = Array2::from_shape_fn((count, 3), |(row, axis)| found[row].pose.to_array()[axis]);
    let covariances = Array3::from_shape_fn((count, 3, 3), |(row, i, j)| found[row].covariance[i][j]);
    let log_odds: Array1<f64> = found.iter().map(|placement| placement.log_odds).collect();
    let matched: Array1<i64> = found.iter().map(|placement| placement.matched as i64).collect();
    (poses.into_pyarray(py), covariances.into_pyarray(py), log_odds.into_pyarray(py), matched.into_pyarray(py))
}

fn marks_of(Marks(mean, variance, label): &Marks<'_>) -> PyResult<Vec<Mark>> {
    let (mean, variance, label) = (mean.as_array(), variance.as_array(), label.as_array());
    if mean.ncols() != 2 || variance.len() != mean.nrows() || label.len() != mean.nrows() {
        return Err(PyValueError::new_err("landmarks: columns of unequal length"));
    }
    if mean.iter().any(|value| !value.is_finite()) || variance.iter().any(|value| !(*value > 0.0 && value.is_finite()))
    {
        return Err(PyValueError::new_err("landmarks: expected finite places and positive variances"));
    }
    Ok((0..mean.nrows())
        .map(|row| Mark {
            mean: [mean[[row, 0]], mean[[row, 1]]],
            variance: variance[row],
            label: u32::try_from(label[row]).ok(),
        })
        .collect())
}
