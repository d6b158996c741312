//! The filter that a configuration or a snapshot asks for, whichever it is: [`Slam`].

pub use crate::contract::Slam;

use crate::config::{Algorithm, Config};
use crate::diagnosis::{NoiseReport, Returns, TwoPlaces};
use crate::ekf_slam::EkfSlam;
use crate::error::{Error, Result};
use crate::filter::{FastSlam, Identities, MapEstimate, PoseEstimate, Seen, StepInfo};
use crate::geometry::Pose;
use crate::given::Beginning;
use crate::late::{Late, Lateness};
use crate::measurement::{Placing, RangeOrBearing, Sensor, EXPECTED_OF_OWN};
use crate::motion::{MotionGaussian, RowPart};
use crate::partial::PartialSlam;
use crate::sighting::Scan;
use crate::snapshot::{self, Holds};
use crate::store::StoreUsage;

/// Makes a filter: [`create`], or what makes one for a sensor of one's own.
pub type Maker<'a> = &'a dyn Fn(Config, Identities) -> Result<Box<dyn Slam>>;

/// The filter that a snapshot was taken of, with its configuration and note.
///
/// **Errors:** [`Error::Input`] when the bytes are no snapshot, of another format or damaged;
/// those of `make`.
pub fn load(snapshot: &[u8], make: Maker<'_>) -> Result<(Box<dyn Slam>, Config, String)> {
    let (head, _) = snapshot::open(snapshot, Holds::Filter)?;
    let config = head.config()?;
    let mut filter = make(config.clone(), head.identities)?;
    filter.restore(snapshot)?;
    Ok((filter, config, head.note))
}

/// The configured filter at its initial pose with an empty map.
pub fn create(config: Config, identities: Identities) -> Result<Box<dyn Slam>> {
    Ok(match (&config.sensor, config.algorithm) {
        _ if config.sensors.are_mixed() => return mixed(config, identities),
        (Sensor::RangeBearing(_), Algorithm::Ekf) => Box::new(EkfSlam::new(config, identities)?),
        (Sensor::RangeBearing(_), Algorithm::Fastslam1 | Algorithm::Fastslam2) => {
            Box::new(FastSlam::new(config, identities)?)
        }
        (Sensor::Range(_), _) => {
            check_names("range", identities)?;
            Box::new(PartialSlam::range_only(config)?)
        }
        (Sensor::Bearing(_), _) => {
            let make = match identities.heeding(config.association.mode) {
                Identities::None => PartialSlam::bearing_only_unnamed,
                Identities::All | Identities::Some => PartialSlam::bearing_only,
            };
            Box::new(make(config)?)
        }
        (Sensor::Own(_), _) => return Err(Error::parameter("sensor.model", "own", EXPECTED_OF_OWN)),
    })
}

/// The filter for several sensors, some of which measure ranges or bearings alone.
fn mixed(config: Config, identities: Identities) -> Result<Box<dyn Slam>> {
    Ok(match config.algorithm {
        Algorithm::Ekf => Box::new(EkfSlam::<RangeOrBearing>::mixed(config, identities)?),
        Algorithm::Fastslam1 | Algorithm::Fastslam2 => Box::new(FastSlam::mixed(config, identities)?),
    })
}

/// Errors unless some sightings name their landmark, as sensors need of which one does not place it.
pub fn check_names(model: &str, identities: Identities) -> Result<()> {
    if identities != Identities::None {
        return Ok(());
    }
    let expected = "range_bearing where sightings name no landmark: what does not place one needs known identities";
    Err(Error::parameter("sensor.model", model, expected))
}

impl Slam for FastSlam {
    fn begin(&mut self, beginning: &Beginning) -> Result<()> {
        FastSlam::begin(self, beginning)
    }
    fn start(&self) -> Pose {
        FastSlam::start(self)
    }
    fn advance(&mut self, part: &RowPart) -> Result<()> {
        FastSlam::advance(self, part)
    }
    fn take(&mut self, scan: Scan<'_>) -> Result<StepInfo> {
        FastSlam::take(self, scan)
    }
    fn finish(&mut self) -> bool {
        self.rejuvenate()
    }
    fn pose(&self) -> PoseEstimate {
        FastSlam::pose(self)
    }
    fn predicted_pose(&mut self) -> PoseEstimate {
        FastSlam::predicted_pose(self)
    }
    fn pending_motion(&self) -> MotionGaussian {
        FastSlam::pending_motion(self)
    }
    fn weighted_poses(&self) -> Vec<(Pose, f64)> {
        let motion = self.pending_motion().mean;
        let poses = (0..self.particles().len()).map(|i| self.particles().pose(i).compose(motion));
        poses.zip(self.weights().iter().copied()).collect()
    }
    fn best_path(&self) -> Vec<(f64, Pose)> {
        FastSlam::best_path(self)
    }
    fn map(&mut self) -> MapEstimate {
        FastSlam::map(self)
    }
    fn seen(&self) -> &[Seen] {
        FastSlam::seen(self)
    }
    fn usage(&self) -> StoreUsage {
        self.store_usage()
    }
    fn noise_report(&self) -> NoiseReport {
        FastSlam::noise_report(self)
    }
    fn two_places(&self) -> Vec<TwoPlaces> {
        FastSlam::two_places(self)
    }
    fn returns(&self) -> Returns {
        FastSlam::returns(self)
    }
    fn lateness(&self) -> Lateness {
        FastSlam::lateness(self)
    }
    fn when_late(&mut self, late: Late) {
        FastSlam::when_late(self, late);
    }
    fn save(&self, note: &str) -> Result<Vec<u8>> {
        FastSlam::save(self, note)
    }
    fn restore(&mut self, snapshot: &[u8]) -> Result<()> {
        FastSlam::restore(self, snapshot)
    }
}

impl<M: Placing> Slam for EkfSlam<M> {
    fn begin(&mut self, beginning: &Beginning) -> Result<()> {
        if beginning.is_empty() {
            return Ok(());
        }
        Err(Error::parameter("algorithm", "ekf", "fastslam1 or fastslam2: EKF-SLAM cannot start in a given map"))
    }
    fn start(&self) -> Pose {
        self.config().initial_pose.T_world_robot()
    }
    fn advance(&mut self, part: &RowPart) -> Result<()> {
        EkfSlam::advance(self, part)
    }
    fn take(&mut self, scan: Scan<'_>) -> Result<StepInfo> {
        EkfSlam::take(self, scan)
    }
    fn finish(&mut self) -> bool {
        false
    }
    fn pose(&self) -> PoseEstimate {
        EkfSlam::pose(self)
    }
    fn predicted_pose(&mut self) -> PoseEstimate {
        EkfSlam::predicted_pose(self)
    }
    fn pending_motion(&self) -> MotionGaussian {
        EkfSlam::pending_motion(self)
    }
    fn weighted_poses(&self) -> Vec<(Pose, f64)> {
        vec![(EkfSlam::predicted_pose(self).mean, 1.0)]
    }
    fn best_path(&self) -> Vec<(f64, Pose)> {
        self.trail().to_vec()
    }
    fn map(&mut self) -> MapEstimate {
        EkfSlam::map(self)
    }
    fn seen(&self) -> &[Seen] {
        EkfSlam::seen(self)
    }
    fn usage(&self) -> StoreUsage {
        EkfSlam::usage(self)
    }
    fn noise_report(&self) -> NoiseReport {
        EkfSlam::noise_report(self)
    }
    fn two_places(&self) -> Vec<TwoPlaces> {
        EkfSlam::two_places(self)
    }
    fn returns(&self) -> Returns {
        EkfSlam::returns(self)
    }
    fn save(&self, note: &str) -> Result<Vec<u8>> {
        EkfSlam::save(self, note)
    }
    fn restore(&mut self, snapshot: &[u8]) -> Result<()> {
        EkfSlam::restore(self, snapshot)
    }
}
