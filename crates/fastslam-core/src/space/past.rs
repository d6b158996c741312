//! What happened so far, as the least squares over it need it.

use super::map::Measured;
use super::motion::SpaceMotion;
use super::pose::SpacePose;
use super::wander::Leg;
use crate::normal::{Cholesky, Matrix};
use serde::{Deserialize, Serialize};

/// The least width of a motion: a micrometre and a microradian, which no sensor tells from none.
const LEAST_VARIANCE: f64 = 1e-12;

/// A scan of the past.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Scan {
    /// Seconds.
    pub stamp_s: f64,
    /// From the scan before, or the start.
    pub motion: SpacePose,
    /// The inverse of that motion's covariance.
    pub information: Matrix<6, 6>,
    /// Poses between the scan before and this one: stamps, and motions since the scan before.
    pub between: Vec<(f64, SpacePose)>,
    /// How it was reached where velocities wander; motion and information are then not those of the least squares.
    pub leg: Option<Leg>,
}

/// A sighting of the past.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct Heard {
    /// Of which scan.
    pub scan: u32,
    /// Of which landmark.
    pub slot: u32,
    /// What.
    pub measured: Measured,
}

/// Everything that was done and seen.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Past {
    /// In time order.
    pub scans: Vec<Scan>,
    /// In time order.
    pub sightings: Vec<Heard>,
    /// What follows the last scan.
    pub between: Vec<(f64, SpacePose)>,
}

impl Past {
    /// A scan was made after a motion. `None` where the motion's covariance is none.
    pub fn push(&mut self, stamp_s: f64, motion: &SpaceMotion, leg: Option<Leg>) -> Option<()> {
        let mut covariance = motion.covariance;
        (0..6).for_each(|i| covariance[i][i] += LEAST_VARIANCE);
        let information = Cholesky::of(&covariance)?.inverse();
        let between = std::mem::take(&mut self.between);
        self.scans.push(Scan { stamp_s, motion: motion.mean, information, between, leg });
        Some(())
    }

    /// The path at every stamp, given the poses of the scans: between two scans the motion bends to meet both.
    pub fn filled(&self, start: SpacePose, poses: &[SpacePose]) -> Vec<(f64, SpacePose)> {
        let mut out = Vec::new();
        let (mut before, mut from_s) = (start, None);
        for (scan, pose) in self.scans.iter().zip(poses) {
            let first_s = *from_s.get_or_insert(scan.between.first().map_or(scan.stamp_s, |(stamp_s, _)| *stamp_s));
            let off = before.compose(scan.motion).inverse().compose(*pose).log();
            for (stamp_s, motion) in &scan.between {
                let share = (stamp_s - first_s) / (scan.stamp_s - first_s);
                let share = if share.is_finite() { share.clamp(0.0, 1.0) } else { 1.0 };
                out.push((*stamp_s, before.compose(*motion).compose(SpacePose::exp(off.map(|v| v * share)))));
            }
            out.push((scan.stamp_s, *pose));
            (before, from_s) = (*pose, Some(scan.stamp_s));
        }
        out.extend(self.between.iter().map(|(stamp_s, motion)| (*stamp_s, before.compose(*motion))));
        out
    }
}
