//! What a stream looks like after a step, for whoever watches.

use fastslam_core::filter::{GivenUse, MapEstimate, Seen, Taken};
use fastslam_core::geometry::Pose;
use fastslam_core::stream::Stream;
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;

type Vector<'py> = Bound<'py, PyArray1<f64>>;
type Matrix<'py> = Bound<'py, PyArray2<f64>>;

/// What there is to see.
pub struct View {
    map: MapEstimate,
    path: Vec<(f64, Pose)>,
    particles: Vec<(Pose, f64)>,
    seen: Vec<Seen>,
    sensor: usize,
}

impl View {
    /// Of a stream as it is.
    pub fn of(stream: &mut Stream) -> Self {
        let (path, sensor) = (stream.smoothed(), stream.last_sensor());
        let filter = stream.filter();
        Self { map: filter.map(), path, particles: filter.weighted_poses(), seen: filter.seen().to_vec(), sensor }
    }

    /// Particles (poses and weights), map, path (stamps and poses), and the sightings of the last scan: `seen` (S, 2)
    /// as measured, and `taken` (S): the birth of the landmark, -1 for none, -2 - birth for one that was founded;
    /// and the number of the sensor that made it.
    pub fn to_dict<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let dict = PyDict::new(py);
        dict.set_item("particles", hypotheses_to_arrays(py, &self.particles)?)?;
        let values: Vec<f64> = self.seen.iter().flat_map(|sighting| sighting.value).collect();
        dict.set_item("seen", values.into_pyarray(py).reshape([self.seen.len(), 2])?)?;
        let code = |taken: Taken| match taken {
            Taken::Landmark(birth) => birth as i64,
            Taken::New(birth) => -2 - birth as i64,
            Taken::Nothing => -1,
        };
        let taken: Vec<i64> = self.seen.iter().map(|sighting| code(sighting.taken)).collect();
        dict.set_item("taken", taken.into_pyarray(py))?;
        dict.set_item("sensor", self.sensor)?;
        dict.set_item("map", map_to_dict(py, &self.map)?)?;
        dict.set_item("path", path_to_arrays(py, &self.path)?)?;
        Ok(dict)
    }
}

/// Poses (M, 3) and weights (M).
pub fn hypotheses_to_arrays<'py>(py: Python<'py>, hypotheses: &[(Pose, f64)]) -> PyResult<(Matrix<'py>, Vector<'py>)> {
    let poses: Vec<f64> = hypotheses.iter().flat_map(|(pose, _)| pose.to_array()).collect();
    let weights: Vec<f64> = hypotheses.iter().map(|(_, weight)| *weight).collect();
    Ok((poses.into_pyarray(py).reshape([weights.len(), 3])?, weights.into_pyarray(py)))
}

/// Stamps (T) and poses (T, 3).
pub fn path_to_arrays<'py>(py: Python<'py>, path: &[(f64, Pose)]) -> PyResult<(Vector<'py>, Matrix<'py>)> {
    let poses: Vec<f64> = path.iter().flat_map(|node| node.1.to_array()).collect();
    let stamps: Vec<f64> = path.iter().map(|node| node.0).collect();
    let count = stamps.len();
    Ok((stamps.into_pyarray(py), poses.into_pyarray(py).reshape([count, 3])?))
}

/// A map as arrays: identity is −1 where nobody said one.
pub fn map_to_dict<'py>(py: Python<'py>, map: &MapEstimate) -> PyResult<Bound<'py, PyDict>> {
    let landmarks = &map.landmarks;
    let n = landmarks.len();
    let dict = PyDict::new(py);
    let integers = |values: Vec<i64>| values.into_pyarray(py);
    dict.set_item("birth", integers(landmarks.iter().map(|l| l.birth as i64).collect()))?;
    dict.set_item("identity", integers(landmarks.iter().map(|l| l.identity.map_or(-1, i64::from)).collect()))?;
    dict.set_item("sightings", integers(landmarks.iter().map(|l| i64::from(l.sightings)).collect()))?;
    let means: Vec<f64> = landmarks.iter().flat_map(|l| l.mean).collect();
    dict.set_item("mean_m", means.into_pyarray(py).reshape([n, 2])?)?;
    let covariances: Vec<f64> = landmarks.iter().map(|l| l.covariance).flat_map(|c| [c.xx, c.xy, c.xy, c.yy]).collect();
    dict.set_item("confirmed", landmarks.iter().map(|l| l.confirmed).collect::<Vec<_>>().into_pyarray(py))?;
    let classes = landmarks.iter().map(|l| l.appearance.class.map_or(-1, i64::from));
    dict.set_item("class_index", integers(classes.collect()))?;
    let signatures = landmarks.iter().map(|l| l.appearance.signature.unwrap_or(f64::NAN));
    dict.set_item("signature", signatures.collect::<Vec<_>>().into_pyarray(py))?;
    let given = |of: fn(GivenUse) -> u32| landmarks.iter().map(move |l| l.given.map_or(-1, |g| i64::from(of(g))));
    dict.set_item("given_sighted", integers(given(|g| g.sighted).collect()))?;
    dict.set_item("given_missed", integers(given(|g| g.missed).collect()))?;
    dict.set_item("covariance_m2", covariances.into_pyarray(py).reshape([n, 2, 2])?)?;
    Ok(dict)
}
