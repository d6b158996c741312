//! One filter that watches a robot, with what the page wants to know of it.

use fastslam_core::config::{Algorithm, Config};
use fastslam_core::ekf_slam::EkfSlam;
use fastslam_core::error::Result;
use fastslam_core::filter::{FastSlam, Identities, MapEstimate, PoseEstimate, Sighting, StepInfo};
use fastslam_core::geometry::Pose;
use fastslam_core::motion::RowPart;
use fastslam_core::slam::Slam;

/// The filters there are.
pub enum Filter {
    /// FastSLAM 1.0 and 2.0.
    Particles(Box<FastSlam>),
    /// EKF-SLAM.
    Joint(Box<EkfSlam>),
}

/// A filter, and what it did so far.
pub struct Observer {
    /// The filter.
    pub filter: Filter,
    /// What happened at the last scan.
    pub last: StepInfo,
    /// Times that the particles were resampled.
    pub resamplings: u32,
    /// Times that paths were drawn anew.
    pub redraws: u32,
    /// The map after the last scan.
    pub map: MapEstimate,
    /// What ended it, where something did.
    pub failure: Option<String>,
}

impl Observer {
    /// A filter at the start with an empty map.
    pub fn new(config: Config, identities: Identities) -> Result<Self> {
        let filter = match config.algorithm {
            Algorithm::Ekf => Filter::Joint(Box::new(EkfSlam::new(config, identities)?)),
            _ => Filter::Particles(Box::new(FastSlam::new(config, identities)?)),
        };
        let (last, map) = Default::default();
        Ok(Self { filter, last, resamplings: 0, redraws: 0, map, failure: None })
    }

    /// The filter as the core's runs use it.
    pub fn slam(&mut self) -> &mut dyn Slam {
        match &mut self.filter {
            Filter::Particles(filter) => filter.as_mut(),
            Filter::Joint(filter) => filter.as_mut(),
        }
    }

    /// Moves the robot by a part of a row of odometry.
    pub fn advance(&mut self, part: &RowPart) {
        if self.failure.is_none() {
            self.failure = self.slam().advance(part).err().map(|error| error.to_string());
        }
    }

    /// Takes in a scan. Where the filter cannot, it stays as it was, and says so.
    pub fn update(&mut self, stamp_s: f64, sightings: &[Sighting]) {
        if self.failure.is_some() {
            return;
        }
        match self.slam().update(stamp_s, sightings) {
            Ok(info) => {
                self.resamplings += u32::from(info.weighing.resampled);
                self.redraws += u32::from(info.sampling.rejuvenated);
                self.last = info;
                self.map = self.slam().map();
            }
            Err(error) => self.failure = Some(error.to_string()),
        }
    }

    /// Draws all paths anew now. Returns whether that was done.
    pub fn draw_anew(&mut self) -> bool {
        let Filter::Particles(filter) = &mut self.filter else { return false };
        let done = filter.rejuvenate();
        self.redraws += u32::from(done);
        self.map = self.slam().map();
        done
    }

    /// Where the robot is now.
    pub fn pose(&mut self) -> PoseEstimate {
        self.slam().predicted_pose()
    }

    /// The pose of the best particle at the last scan, or of the one estimate.
    pub fn best_pose(&self) -> Pose {
        match &self.filter {
            Filter::Particles(filter) => filter.particles().pose(filter.particles().best()),
            Filter::Joint(filter) => filter.pose().mean,
        }
    }
}
