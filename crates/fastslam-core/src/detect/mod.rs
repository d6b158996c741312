//! From a laser scan to sightings of landmarks: one pass per scan, one detector per file.
//!
//! A [`Detector`] owns its working memory, so scans after the first few need no allocation. Detections are in the
//! frame of the sensor at the stamp of the scan, which is the time of beam 0.

mod beams;
mod circle;
mod corners;
mod line;
mod reflectors;
mod segments;
#[cfg(test)]
mod tests;
mod trunks;
mod verdict;
mod wall;

pub use beams::{BeamGeometry, Scan};
pub use corners::Corners;
pub use reflectors::Reflectors;
pub use trunks::Trunks;
pub use verdict::{Piece, Verdict};

use crate::error::Result;
use crate::geometry::Symmetric2;
use crate::math;
use beams::Beams;
use schemars::JsonSchema;
use segments::Segment;
use serde::{Deserialize, Serialize};

/// What a detector found, in the sensor frame at the stamp of the scan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Detection {
    /// To the centre of the object, in metres.
    pub range_m: f64,
    /// Counter-clockwise from straight ahead, wrapped.
    pub bearing_rad: f64,
    /// Of (range, bearing): m², m·rad, rad².
    pub covariance: Symmetric2,
    /// Diameter in metres; NaN where it is unknown or the object has none.
    pub signature: f64,
    /// Strongest echo; NaN without intensities.
    pub intensity: f64,
    /// How likely the detector is to report an object of this size at this place.
    pub detection_probability: f64,
    /// First beam on the object.
    pub first_beam: u32,
    /// Last beam on the object (below `first_beam` where a full turn's seam lies within).
    pub last_beam: u32,
}

/// Which detector runs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum DetectorKind {
    /// Round things that stand free: trunks, poles, rocks.
    #[default]
    Trunks,
    /// Things that shine: reflective posts and tape.
    Reflectors,
    /// Where two straight walls meet.
    Corners,
}

/// How landmarks are found in scans.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct DetectorConfig {
    /// Which of the detectors below runs.
    pub kind: DetectorKind,
    /// Settings of `trunks`.
    pub trunks: Trunks,
    /// Settings of `reflectors`.
    pub reflectors: Reflectors,
    /// Settings of `corners`.
    pub corners: Corners,
}

impl DetectorConfig {
    /// Errors that name the first parameter out of range.
    pub fn validate(&self) -> Result<()> {
        self.trunks.validate().map_err(|e| e.within("trunks"))?;
        self.reflectors.validate().map_err(|e| e.within("reflectors"))?;
        self.corners.validate().map_err(|e| e.within("corners"))
    }
}

/// A detector with its working memory.
#[derive(Clone, Debug)]
pub struct Detector {
    config: DetectorConfig,
    beams: Beams,
    segments: Vec<Segment>,
    scratch: Vec<[f64; 2]>,
    values: Vec<f64>,
    lines: Vec<line::Line>,
    pieces: Vec<Piece>,
    walls: Vec<usize>,
}

impl Detector {
    /// Errors that name the first parameter out of range.
    pub fn new(config: DetectorConfig) -> Result<Self> {
        config.validate()?;
        Ok(Self {
            config,
            beams: Beams::default(),
            segments: Vec::new(),
            scratch: Vec::new(),
            values: Vec::new(),
            lines: Vec::new(),
            pieces: Vec::new(),
            walls: Vec::new(),
        })
    }

    /// Append the detections of one scan to `found`, in the order of the beams, and return how many there were.
    ///
    /// **Errors:** a geometry that makes no sense, a twist that is not finite, or intensities of another number than
    /// the ranges. Ranges and intensities may hold anything.
    pub fn detect(&mut self, scan: &Scan, found: &mut Vec<Detection>) -> Result<usize> {
        self.pieces.clear();
        scan.check()?;
        let before = found.len();
        self.beams.load(scan);
        match self.config.kind {
            DetectorKind::Trunks => self.trunks(scan, found),
            DetectorKind::Reflectors => self.reflectors(scan, found),
            DetectorKind::Corners => self.corners(found),
        }
        Ok(found.len() - before)
    }

    /// The pieces that the last scan was cut into, in the order of the beams, and what became of them.
    pub fn pieces(&self) -> &[Piece] {
        &self.pieces
    }
}

/// A point with its Cartesian covariance as range, bearing and their covariance; None at the origin or where a number
/// is not finite.
fn to_polar(point: [f64; 2], covariance: Symmetric2) -> Option<(f64, f64, Symmetric2)> {
    let range_squared = point[0] * point[0] + point[1] * point[1];
    let range = range_squared.sqrt();
    if !(range > 0.0 && range.is_finite()) {
        return None;
    }
    let jacobian = [[point[0] / range, point[1] / range], [-point[1] / range_squared, point[0] / range_squared]];
    let polar = covariance.transformed(jacobian);
    polar.is_positive_definite().then(|| (range, math::atan2(point[1], point[0]), polar))
}

/// The strongest echo among `beams`; NaN without intensities or where none is a number.
fn strongest(scan: &Scan, beams: impl Iterator<Item = usize>) -> f64 {
    scan.intensities.map_or(f64::NAN, |values| beams.fold(f64::NAN, |best, i| best.max(values[i])))
}
