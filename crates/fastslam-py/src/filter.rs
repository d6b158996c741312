//! The filter, step by step.

use crate::settings::to_python;
use crate::{arrays, config, run};
use fastslam_core::config::Config;
use fastslam_core::filter::Identities;
use fastslam_core::slam::{self, Slam};
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

type Vector<'py> = Bound<'py, PyArray1<f64>>;
type Matrix<'py> = Bound<'py, PyArray2<f64>>;

/// The configured filter, one control and one scan at a time.
#[pyclass]
pub struct Filter {
    filter: Box<dyn Slam>,
    config: Config,
}

#[pymethods]
impl Filter {
    #[new]
    fn new(config_json: &str, identities: &str) -> PyResult<Self> {
        let identities = match identities {
            "all" => Identities::All,
            "some" => Identities::Some,
            "none" => Identities::None,
            other => return Err(PyValueError::new_err(format!("identities: got {other}, expected all, some or none"))),
        };
        let config = config::parse(config_json)?;
        let filter = slam::create(config.clone(), identities).map_err(to_python)?;
        Ok(Self { filter, config })
    }

    fn predict(&mut self, py: Python<'_>, control: [f64; 3], dt_s: f64) -> PyResult<()> {
        py.detach(|| self.filter.predict(control, dt_s)).map_err(to_python)
    }

    #[pyo3(signature = (stamp_s, range_m, bearing_rad, identity, noise=None, class_index=None, signature=None))]
    #[allow(clippy::too_many_arguments)] // One array per column of a scan.
    fn update<'py>(
        &mut self,
        py: Python<'py>,
        stamp_s: f64,
        range_m: PyReadonlyArray1<'py, f64>,
        bearing_rad: PyReadonlyArray1<'py, f64>,
        identity: PyReadonlyArray1<'py, i64>,
        noise: Option<PyReadonlyArray2<'py, f64>>,
        class_index: Option<PyReadonlyArray1<'py, i64>>,
        signature: Option<PyReadonlyArray1<'py, f64>>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let looks = arrays::Looks { class_index, signature };
        let sightings = arrays::sightings(&range_m, &bearing_rad, &identity, noise.as_ref(), &looks)?;
        let info = py.detach(|| self.filter.update(stamp_s, &sightings)).map_err(to_python)?;
        let dict = PyDict::new(py);
        dict.set_item("step", info.step)?;
        dict.set_item("sightings", info.sightings)?;
        dict.set_item("new_landmarks", info.new_landmarks)?;
        dict.set_item("ignored", info.ignored)?;
        dict.set_item("effective_sample_size", info.effective_sample_size)?;
        dict.set_item("resampled", info.resampled)?;
        dict.set_item("rejuvenated", info.rejuvenated)?;
        dict.set_item("log_likelihood", info.log_likelihood)?;
        dict.set_item("landmarks", info.landmarks)?;
        dict.set_item("removed", info.removed)?;
        dict.set_item("matched", info.matched)?;
        dict.set_item("repaired", info.repaired)?;
        dict.set_item("particles", info.particles)?;
        dict.set_item("nis", info.nis)?;
        dict.set_item("nis_band", (info.nis_band[0], info.nis_band[1]))?;
        dict.set_item("health", info.health.status as u8)?;
        dict.set_item("health_reasons", info.health.reasons)?;
        dict.set_item("warnings", crate::noise::warnings(py, &info.noise_warnings, &self.config.motion)?)?;
        let skipped = info.skipped;
        let unusable = skipped.not_finite + skipped.too_near + skipped.too_far;
        dict.set_item("skipped", unusable + skipped.without_identity + skipped.bad_covariance)?;
        Ok(dict)
    }

    /// Mean (3) and covariance (3, 3) of the pose now.
    fn pose<'py>(&mut self, py: Python<'py>) -> PyResult<(Vector<'py>, Matrix<'py>)> {
        let estimate = py.detach(|| self.filter.predicted_pose());
        let covariance = estimate.covariance.concat().into_pyarray(py).reshape([3, 3])?;
        Ok((estimate.mean.to_array().to_vec().into_pyarray(py), covariance))
    }

    /// Poses (M, 3) and normalised weights (M) of the particles.
    fn particles<'py>(&self, py: Python<'py>) -> PyResult<(Matrix<'py>, Vector<'py>)> {
        let hypotheses = self.filter.weighted_poses();
        let poses: Vec<f64> = hypotheses.iter().flat_map(|(pose, _)| pose.to_array()).collect();
        let weights: Vec<f64> = hypotheses.iter().map(|(_, weight)| *weight).collect();
        Ok((poses.into_pyarray(py).reshape([weights.len(), 3])?, weights.into_pyarray(py)))
    }

    /// Draws all particles anew from the posterior over paths; false when it was not configured or nothing changed.
    fn rejuvenate(&mut self, py: Python<'_>) -> bool {
        py.detach(|| self.filter.finish())
    }

    fn map<'py>(&mut self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let map = py.detach(|| self.filter.map());
        run::map_to_dict(py, &map)
    }

    /// Stamps (T) and poses (T, 3) of the path of the best particle.
    fn best_path<'py>(&self, py: Python<'py>) -> PyResult<(Vector<'py>, Matrix<'py>)> {
        let path = self.filter.best_path();
        let poses: Vec<f64> = path.iter().flat_map(|node| node.1.to_array()).collect();
        let stamps: Vec<f64> = path.iter().map(|node| node.0).collect();
        let count = stamps.len();
        Ok((stamps.into_pyarray(py), poses.into_pyarray(py).reshape([count, 3])?))
    }
}
