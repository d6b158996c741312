//! What a filter is given to begin with, as arrays.

use fastslam_core::association::Appearance;
use fastslam_core::gaussian::Gaussian;
use fastslam_core::geometry::{Matrix3, Pose, Symmetric2};
use fastslam_core::given::{Beginning, GivenLandmark, Role, Start};
use numpy::{PyReadonlyArray1, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// The columns of a map: mean (n x 2), covariance (n x 3: xx, xy, yy), identity and class (−1: none), signature and
/// log-odds (NaN: none), sightings, and whether the landmark is fixed.
#[derive(FromPyObject)]
pub struct GivenMap<'py>(
    PyReadonlyArray2<'py, f64>,
    PyReadonlyArray2<'py, f64>,
    PyReadonlyArray1<'py, i64>,
    PyReadonlyArray1<'py, i64>,
    PyReadonlyArray1<'py, f64>,
    PyReadonlyArray1<'py, f64>,
    PyReadonlyArray1<'py, i64>,
    PyReadonlyArray1<'py, bool>,
);

/// Poses (n x 3); with a covariance (3 x 3) the first of them is the mean of a Gaussian.
#[derive(FromPyObject)]
pub struct GivenStart<'py>(PyReadonlyArray2<'py, f64>, Option<PyReadonlyArray2<'py, f64>>);

/// Both together.
pub fn beginning(map: Option<GivenMap<'_>>, start: Option<GivenStart<'_>>) -> PyResult<Beginning> {
    Ok(Beginning {
        landmarks: map.map_or(Ok(Vec::new()), landmarks)?,
        start: start.map_or(Ok(Start::Configured), start_of)?,
    })
}

fn landmarks(map: GivenMap<'_>) -> PyResult<Vec<GivenLandmark>> {
    let GivenMap(mean, covariance, identity, class, signature, log_odds, sightings, fixed) = map;
    let (mean, covariance) = (mean.as_array(), covariance.as_array());
    let (identity, class, sightings) = (identity.as_array(), class.as_array(), sightings.as_array());
    let (signature, log_odds, fixed) = (signature.as_array(), log_odds.as_array(), fixed.as_array());
    let n = mean.nrows();
    let lengths = [identity.len(), class.len(), signature.len(), log_odds.len(), sightings.len(), fixed.len()];
    if mean.ncols() != 2 || covariance.dim() != (n, 3) || lengths.iter().any(|length| *length != n) {
        return Err(PyValueError::new_err("map: columns of unequal length"));
    }
    let whole = |value: i64| u32::try_from(value).ok();
    let number = |value: f64| (!value.is_nan()).then_some(value);
    Ok((0..n)
        .map(|i| GivenLandmark {
            place: Gaussian {
                mean: [mean[[i, 0]], mean[[i, 1]]],
                covariance: Symmetric2::new(covariance[[i, 0]], covariance[[i, 1]], covariance[[i, 2]]),
            },
            identity: whole(identity[i]),
            appearance: Appearance { class: whole(class[i]), signature: number(signature[i]) },
            log_odds: number(log_odds[i]),
            sightings: whole(sightings[i]).unwrap_or(0),
            role: if fixed[i] { Role::Fixed } else { Role::Prior },
        })
        .collect())
}

fn start_of(start: GivenStart<'_>) -> PyResult<Start> {
    let GivenStart(poses, covariance) = start;
    let view = poses.as_array();
    if view.ncols() != 3 {
        return Err(PyValueError::new_err(format!("start: got {} columns, expected x, y, heading", view.ncols())));
    }
    let poses: Vec<Pose> = view.rows().into_iter().map(|row| Pose { x: row[0], y: row[1], heading: row[2] }).collect();
    let Some(covariance) = covariance else { return Ok(Start::Samples(poses)) };
    let covariance = covariance.as_array();
    match poses.first() {
        Some(mean) if covariance.dim() == (3, 3) => {
            let matrix: Matrix3 = std::array::from_fn(|r| std::array::from_fn(|c| covariance[[r, c]]));
            Ok(Start::Gaussian(*mean, matrix))
        }
        _ => Err(PyValueError::new_err("start: expected one pose with a covariance of 3 x 3")),
    }
}
