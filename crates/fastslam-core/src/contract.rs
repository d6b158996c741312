//! What every filter can do, so that a run over a log need not know which one it has.

use crate::diagnosis::{NoiseReport, Returns, TwoPlaces};
use crate::error::Result;
use crate::filter::{MapEstimate, PoseEstimate, Seen, Sighting, StepInfo};
use crate::geometry::Pose;
use crate::given::Beginning;
use crate::late::{Late, Lateness};
use crate::motion::{MotionGaussian, RowPart};
use crate::sighting::Scan;
use crate::store::StoreUsage;

/// A SLAM filter: controls and sightings in, pose, path and map out.
pub trait Slam: Send + Sync {
    /// Starts in a given map, at a given pose: before anything else.
    fn begin(&mut self, beginning: &Beginning) -> Result<()>;
    /// Where the path begins.
    fn start(&self) -> Pose;
    /// Moves the robot by a row of odometry, or a part of it.
    fn advance(&mut self, part: &RowPart) -> Result<()>;
    /// Moves the robot by one control (columns of the motion model) that acts for `dt_s`: a whole row.
    fn predict(&mut self, control: [f64; 3], dt_s: f64) -> Result<()> {
        self.advance(&RowPart::whole(control, dt_s))
    }
    /// Processes a scan of the only sensor.
    fn update(&mut self, stamp_s: f64, sightings: &[Sighting]) -> Result<StepInfo> {
        self.take(Scan::new(stamp_s, sightings))
    }
    /// Processes all that one sensor saw at one stamp (there may be nothing).
    fn take(&mut self, scan: Scan<'_>) -> Result<StepInfo>;
    /// Ends a log: what the filter can still learn from the whole of it. Returns whether anything changed.
    fn finish(&mut self) -> bool;
    /// Mean and covariance of the pose after the last update.
    fn pose(&self) -> PoseEstimate;
    /// Mean and covariance of the pose now.
    fn predicted_pose(&mut self) -> PoseEstimate;
    /// Motion since the poses on the path were last set.
    fn pending_motion(&self) -> MotionGaussian;
    /// Every hypothesis about the pose now, with its weight.
    fn weighted_poses(&self) -> Vec<(Pose, f64)>;
    /// The path of the best hypothesis: stamps in seconds and `T_world_robot`.
    fn best_path(&self) -> Vec<(f64, Pose)>;
    /// The map.
    fn map(&mut self) -> MapEstimate;
    /// What the best hypothesis took the usable sightings of the last scan for.
    fn seen(&self) -> &[Seen];
    /// What the map occupies.
    fn usage(&self) -> StoreUsage;
    /// What the innovations so far say of the configured noise.
    fn noise_report(&self) -> NoiseReport;
    /// Names that were seen at two places so far.
    fn two_places(&self) -> Vec<TwoPlaces>;
    /// What came of the returns to the landmarks of the map.
    fn returns(&self) -> Returns;
    /// How often a draw of paths beside the filter was late.
    fn lateness(&self) -> Lateness {
        Lateness::default()
    }
    /// From here on this is done where a draw of paths beside the filter is late.
    fn when_late(&mut self, _late: Late) {}
    /// The state as bytes, from which [`Slam::restore`] goes on to the same bits; `note` is kept in their head.
    fn save(&self, note: &str) -> Result<Vec<u8>>;
    /// Takes over a state that was saved with this configuration; where that is refused, the filter is as it was.
    fn restore(&mut self, snapshot: &[u8]) -> Result<()>;
}
