//! What the particles say together, and the filter as a run over a log knows it.

use super::sensing::{Calibration, Sensing};
use super::PartialSlam;
use crate::association::Appearance;
use crate::contract::Slam;
use crate::diagnosis::{NoiseReport, Returns, TwoPlaces};
use crate::error::{Error, Result};
use crate::filter::{MapEstimate, MapLandmark, PoseEstimate, StepInfo};
use crate::gaussian::Gaussian;
use crate::geometry::{Pose, Symmetric2};
use crate::given::Beginning;
use crate::measurement::RangeErrors;
use crate::motion::{MotionGaussian, RowPart};
use crate::normal::Normal;
use crate::sighting::{Scan, Seen};
use crate::store::StoreUsage;

impl<S: Sensing<Z>, const Z: usize> PartialSlam<S, Z> {
    /// The map: each landmark as the mixture over all particles and components; confirmed are those that most of the
    /// weight has placed. Without names it is that of the best particle, and confirmed is what was seen often enough too.
    pub fn map(&self) -> MapEstimate {
        let slots = self.state.cloud.maps[self.state.cloud.particles.best()].len();
        let landmarks = (0..slots).map(|slot| self.landmark(slot)).collect();
        MapEstimate { landmarks, range_errors: self.range_errors() }
    }

    /// What was learned of scale and bias; what is not free keeps its value, and has no standard deviation.
    fn range_errors(&self) -> Option<RangeErrors> {
        let free = self.prior.free();
        let (Calibration { scale, bias }, std) = self.calibration();
        (!free.is_empty()).then(|| RangeErrors {
            range_scale: scale,
            range_bias_m: bias,
            range_scale_std: free.contains(&0).then_some(std[0]),
            range_bias_std_m: free.contains(&1).then_some(std[1]),
        })
    }

    fn landmark(&self, slot: usize) -> MapLandmark {
        let cloud = &self.state.cloud;
        let best = cloud.particles.best();
        let unnamed = self.state.unnamed.as_ref();
        let birth = unnamed.map_or(slot as u64, |unnamed| unnamed.births[best][slot]);
        let holds = |i: usize| unnamed.is_none_or(|unnamed| unnamed.births[i].get(slot) == Some(&birth));
        let held = || (0..cloud.maps.len()).filter(|i| holds(*i)).map(|i| cloud.weights.values[i]).sum();
        let total: f64 = unnamed.map_or(1.0, |_| held());
        let weighed = || (0..cloud.maps.len()).filter(|i| holds(*i)).map(|i| (i, cloud.weights.values[i] / total));
        let parts: Vec<(f64, Normal<2>)> =
            weighed().map(|(i, weight)| (weight, cloud.maps[i][slot].moments())).collect();
        let whole = Gaussian::from(Normal::of_mixture(parts.iter().map(|(weight, part)| (*weight, part))));
        let (own, more) = (whole.covariance, cloud.gauge.of_landmark(whole.mean));
        let placed = |i: usize| {
            let here = cloud.particles.pose(i);
            cloud.maps[i][slot].placed([here.x, here.y]).is_some()
        };
        let mass: f64 = weighed().filter(|(i, _)| placed(*i)).map(|(_, weight)| weight).sum();
        let enough = self.config().association.existence.confirmed_sightings;
        let (identity, sightings, known) = match unnamed {
            Some(unnamed) => {
                let sightings = unnamed.sightings_of(best, slot, &cloud.names);
                (None, sightings, sightings >= enough)
            }
            None => (Some(cloud.names[slot].identity), cloud.names[slot].sightings, true),
        };
        MapLandmark {
            birth,
            identity,
            mean: whole.mean,
            covariance: Symmetric2::new(own.xx + more.xx, own.xy + more.xy, own.yy + more.yy),
            sightings,
            confirmed: known && mass > 0.5,
            appearance: Appearance::default(),
            given: None,
        }
    }

    /// Where a landmark may be, in the best particle: shares with their Gaussians, by identity.
    pub fn hypotheses(&self, identity: u32) -> Vec<(f64, Gaussian)> {
        let best = self.state.cloud.particles.best();
        let slot = self.state.slot_of.get(&identity);
        let parts = slot.map(|slot| self.state.cloud.maps[best][*slot as usize].parts());
        parts.into_iter().flatten().map(|part| (crate::math::exp(part.log_share), part.gaussian)).collect()
    }

    /// Mean of the sensor's calibration over the particles, and its standard deviations.
    pub fn calibration(&self) -> (Calibration, [f64; 2]) {
        let cloud = &self.state.cloud;
        let each = |of: fn(&Calibration) -> f64| {
            let pairs = cloud.weights.values.iter().zip(&cloud.calibrations);
            let mean: f64 = pairs.clone().map(|(w, c)| w * of(c)).sum();
            let variance: f64 = pairs.map(|(w, c)| w * (of(c) - mean).powi(2)).sum();
            (mean, variance.sqrt())
        };
        let ((scale, scale_std), (bias, bias_std)) = (each(|c| c.scale), each(|c| c.bias));
        (Calibration { scale, bias }, [scale_std, bias_std])
    }
}

impl<S: Sensing<Z>, const Z: usize> Slam for PartialSlam<S, Z> {
    fn begin(&mut self, beginning: &Beginning) -> Result<()> {
        if beginning.is_empty() {
            return Ok(());
        }
        let expected = "range_bearing: a filter on sightings that do not place a landmark cannot start in a given map";
        Err(Error::parameter("sensor.model", self.config.sensor.model().name(), expected))
    }
    fn start(&self) -> Pose {
        self.config().initial_pose.T_world_robot()
    }
    fn advance(&mut self, part: &RowPart) -> Result<()> {
        PartialSlam::advance(self, part)
    }
    fn take(&mut self, Scan { stamp_s, sensor, sightings }: Scan<'_>) -> Result<StepInfo> {
        self.config.check_sensor(sensor)?;
        PartialSlam::update(self, stamp_s, sightings)
    }
    fn finish(&mut self) -> bool {
        self.finish_log()
    }
    fn pose(&self) -> PoseEstimate {
        self.state.cloud.estimate
    }
    fn predicted_pose(&mut self) -> PoseEstimate {
        let beliefs = self.beliefs();
        self.estimate_beliefs(&beliefs);
        self.state.cloud.estimate
    }
    fn pending_motion(&self) -> MotionGaussian {
        self.state.cloud.pending
    }
    fn weighted_poses(&self) -> Vec<(Pose, f64)> {
        let weights = self.state.cloud.weights.values.iter().copied();
        self.beliefs().iter().map(|belief| belief.mean).zip(weights).collect()
    }
    fn best_path(&self) -> Vec<(f64, Pose)> {
        self.state.path.path(self.state.cloud.particles.best())
    }
    fn map(&mut self) -> MapEstimate {
        PartialSlam::map(self)
    }
    /// None: a range alone lies nowhere in the frame of the sensor.
    fn seen(&self) -> &[Seen] {
        &[]
    }
    fn usage(&self) -> StoreUsage {
        let places = self.state.cloud.maps.iter().flatten();
        let rows: usize = places.map(|place| place.parts().len()).sum();
        StoreUsage { rows, bytes: rows * std::mem::size_of::<super::place::Part>() }
    }
    fn noise_report(&self) -> NoiseReport {
        self.state.watch.noise.of_run()
    }
    fn two_places(&self) -> Vec<TwoPlaces> {
        self.state.watch.names.two_places()
    }
    fn returns(&self) -> Returns {
        match self.state.unnamed {
            Some(_) => self.state.watch.returns(self.births_that_count().into_iter()),
            None => self.state.watch.returns(0..self.state.cloud.names.len() as u64),
        }
    }
    fn save(&self, note: &str) -> Result<Vec<u8>> {
        PartialSlam::save(self, note)
    }
    fn restore(&mut self, snapshot: &[u8]) -> Result<()> {
        PartialSlam::restore(self, snapshot)
    }
}
