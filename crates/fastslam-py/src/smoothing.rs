//! Least squares over path, landmarks and the errors of sensor and odometry: arrays in, arrays out.

use crate::settings::to_python;
use fastslam_core::geometry::{Matrix3, Pose};
use fastslam_core::smoothing::{Anchors, Bordered, Priors, Problem, Rows, Sight, OF_SENSOR};
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// Motions (K - 1, 3) with their derivatives (K - 1, 3, N).
type Odometry<'py> = (PyReadonlyArray2<'py, f64>, PyReadonlyArray3<'py, f64>);
/// Pose (S,), landmark (S,), and range and bearing (S, 2).
type Sightings<'py> = (PyReadonlyArray1<'py, i64>, PyReadonlyArray1<'py, i64>, PyReadonlyArray2<'py, f64>);
/// Of sightings (S, 2) and motions (K - 1, 3, 3).
type Whitening<'py> = (PyReadonlyArray2<'py, f64>, PyReadonlyArray3<'py, f64>);

/// The rows of a problem at its present solution.
#[pyclass(frozen, module = "fastslam._core")]
pub struct LeastSquaresRows(Rows);

#[pymethods]
impl LeastSquaresRows {
    #[new]
    fn new(
        poses: PyReadonlyArray2<'_, f64>,
        landmarks_m: PyReadonlyArray2<'_, f64>,
        sensor: [f64; OF_SENSOR],
        odometry: Odometry<'_>,
        sightings: Sightings<'_>,
    ) -> PyResult<Self> {
        let by_motion = odometry.1.as_array();
        if by_motion.dim().0 != odometry.0.as_array().nrows() || by_motion.dim().1 != 3 {
            let shape = by_motion.dim();
            return Err(PyValueError::new_err(format!("odometry: got derivatives of shape {shape:?}")));
        }
        let problem = Problem {
            poses: rows::<3>(&poses, "poses")?.into_iter().map(Pose::from).collect(),
            landmarks: rows::<2>(&landmarks_m, "landmarks")?,
            sensor,
            motion: rows::<3>(&odometry.0, "odometry")?.into_iter().map(Pose::from).collect(),
            by_motion: by_motion.iter().copied().collect(),
            sights: sights(&sightings)?,
        };
        Ok(Self(Rows::of(&problem).map_err(to_python)?))
    }

    /// What is left to explain.
    fn residuals<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        self.0.residuals().into_pyarray(py)
    }
}

/// The factorised normal equations of weighed rows.
#[pyclass(frozen, module = "fastslam._core")]
pub struct LeastSquares(Bordered);

#[pymethods]
impl LeastSquares {
    #[new]
    fn new(
        py: Python<'_>,
        rows: &LeastSquaresRows,
        whitening: Whitening<'_>,
        anchors: PyReadonlyArray2<'_, f64>,
        priors: PyReadonlyArray2<'_, f64>,
    ) -> PyResult<Self> {
        let seen: Vec<f64> = whitening.0.as_array().iter().copied().collect();
        let roots = whitening.1.as_array();
        if roots.dim().1 != 3 || roots.dim().2 != 3 {
            return Err(PyValueError::new_err(format!("roots of motions: got shape {:?}", roots.dim())));
        }
        let root = |k: usize| std::array::from_fn(|r| std::array::from_fn(|c| roots[[k, r, c]]));
        let moved: Vec<Matrix3> = (0..roots.dim().0).map(root).collect();
        let [information, missing] = columns(&anchors, "anchors")?;
        let anchors = Anchors { information, missing };
        let [std, missing] = columns(&priors, "priors")?;
        let free: Vec<bool> = std.iter().map(|std| *std > 0.0).collect();
        let priors = Priors { std, missing };
        let solved = py.detach(|| Bordered::new(rows.0.whitened(&seen, &moved, &free)?, anchors, priors));
        Ok(Self(solved.map_err(to_python)?))
    }

    /// Whitened residuals.
    fn residuals<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        self.0.rows().residuals().into_pyarray(py)
    }

    /// Of the parameters.
    fn covariance<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let size = self.0.covariance().len();
        self.0.covariance().concat().into_pyarray(py).reshape([size, size])
    }

    /// The step that explains the rows: of the unknowns and of the parameters.
    fn step<'py>(&self, py: Python<'py>) -> (Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<f64>>) {
        let (unknowns, parameters) = py.detach(|| self.0.step());
        (unknowns.into_pyarray(py), parameters.into_pyarray(py))
    }

    /// How the rows move with noise.
    fn response<'py>(&self, py: Python<'py>, noise: PyReadonlyArray1<'py, f64>) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let noise = noise.as_array().to_vec();
        let moved = py.detach(|| self.0.response(&noise)).map_err(to_python)?;
        Ok(moved.into_pyarray(py))
    }

    /// What each row's residual does to the parameters.
    fn influence<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let shape = [self.0.rows().len(), self.0.covariance().len()];
        py.detach(|| self.0.influence()).into_pyarray(py).reshape(shape)
    }
}

/// Rows of so many numbers.
fn rows<const N: usize>(array: &PyReadonlyArray2<'_, f64>, what: &str) -> PyResult<Vec<[f64; N]>> {
    let view = array.as_array();
    if view.ncols() != N {
        return Err(PyValueError::new_err(format!("{what}: got {} columns, expected {N}", view.ncols())));
    }
    Ok(view.rows().into_iter().map(|row| std::array::from_fn(|k| row[k])).collect())
}

/// Two columns.
fn columns(array: &PyReadonlyArray2<'_, f64>, what: &str) -> PyResult<[Vec<f64>; 2]> {
    let rows = rows::<2>(array, what)?;
    Ok([0, 1].map(|k| rows.iter().map(|row| row[k]).collect()))
}

fn sights((pose, landmark, measured): &Sightings<'_>) -> PyResult<Vec<Sight>> {
    let (pose, landmark, measured) = (pose.as_array(), landmark.as_array(), rows::<2>(measured, "sightings")?);
    if pose.len() != measured.len() || landmark.len() != measured.len() {
        return Err(PyValueError::new_err(format!(
            "sightings: got {} poses, {} landmarks and {} measurements",
            pose.len(),
            landmark.len(),
            measured.len()
        )));
    }
    let number = |value: i64| {
        usize::try_from(value).map_err(|_| PyValueError::new_err(format!("sightings: got number {value}")))
    };
    (0..measured.len())
        .map(|k| {
            let [range_m, bearing_rad] = measured[k];
            Ok(Sight { pose: number(pose[k])?, landmark: number(landmark[k])?, range_m, bearing_rad })
        })
        .collect()
}
