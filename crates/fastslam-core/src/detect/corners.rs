//! Corners: where two straight pieces of wall meet, for indoor logs.

use super::beams::{Beams, Echo};
use super::circle::norm;
use super::line::{self, Line};
use super::segments::{self, Cut, Segment};
use super::verdict::{Piece, Verdict};
use super::{to_polar, Detection, Detector};
use crate::error::{non_negative, positive, Error, Result};
use crate::math;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Settings of the detector of corners.
///
/// A continuous piece of the scan is split at its point farthest from the chord until every part is straight; the lines
/// through two neighbouring parts meet in the corner.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Corners {
    /// Neighbouring ranges that differ by more are of two surfaces.
    pub jump_m: f64,
    /// Added to `jump_m` for each metre of range.
    pub jump_per_range: f64,
    /// So many beams without an echo within a wall are bridged.
    pub bridge_beams: u32,
    /// A part is split when a point is farther from its chord.
    pub split_m: f64,
    /// Fewest beams on each of the two walls.
    pub min_beams: u32,
    /// Shortest wall.
    pub min_length_m: f64,
    /// Smallest angle between the walls.
    pub min_angle_rad: f64,
    /// Largest root mean square distance of the points from their line.
    pub max_residual_m: f64,
    /// The lines must meet this close to an echo between the walls.
    pub max_gap_m: f64,
    /// Standard deviation of one range.
    pub range_std_m: f64,
    /// Probability that a corner in view is found.
    pub detection_probability: f64,
}

impl Default for Corners {
    fn default() -> Self {
        Self {
            jump_m: 0.3,
            jump_per_range: 0.02,
            bridge_beams: 2,
            split_m: 0.1,
            min_beams: 6,
            min_length_m: 0.4,
            min_angle_rad: 0.5,
            max_residual_m: 0.05,
            max_gap_m: 0.3,
            range_std_m: 0.02,
            detection_probability: 0.8,
        }
    }
}

impl Corners {
    /// Errors that name the first parameter out of range.
    pub fn validate(&self) -> Result<()> {
        positive("jump_m", self.jump_m)?;
        non_negative("jump_per_range", self.jump_per_range)?;
        positive("split_m", self.split_m)?;
        positive("min_length_m", self.min_length_m)?;
        positive("min_angle_rad", self.min_angle_rad)?;
        positive("max_residual_m", self.max_residual_m)?;
        positive("max_gap_m", self.max_gap_m)?;
        positive("range_std_m", self.range_std_m)?;
        if self.min_beams < 2 {
            return Err(Error::parameter("min_beams", self.min_beams, "at least 2"));
        }
        if !(self.detection_probability > 0.0 && self.detection_probability <= 1.0) {
            return Err(Error::parameter("detection_probability", self.detection_probability, "above 0, at most 1"));
        }
        Ok(())
    }
}

impl Detector {
    pub(super) fn corners(&mut self, found: &mut Vec<Detection>) {
        let Self { config, beams, segments, lines, pieces, walls, .. } = self;
        walls.clear();
        let settings = &config.corners;
        let cut = Cut {
            jump_m: settings.jump_m,
            jump_per_range: settings.jump_per_range,
            bridge_beams: settings.bridge_beams as usize,
        };
        segments::split(beams, cut, segments);
        let count = segments.len();
        for k in 0..count {
            straight_lines(settings, beams, k, segments, lines);
            let start = pieces.len();
            pieces.extend(lines.iter().map(|line| piece(settings, beams, line)));
            let mut before: Option<usize> = None;
            for j in (0..lines.len()).filter(|&j| pieces[start + j].verdict == Verdict::NoCorner) {
                let met = before.and_then(|i| corner(settings, beams, &lines[i], &lines[j]).map(|corner| (i, corner)));
                if let Some((i, corner)) = met {
                    walls.extend([start + i, start + j]);
                    found.push(corner);
                }
                before = Some(j);
            }
        }
        for &wall in walls.iter() {
            pieces[wall].verdict = Verdict::Detected;
        }
    }
}

/// The straight parts of piece `k`, in order. Parts still to be looked at are stacked on the pieces.
fn straight_lines(settings: &Corners, beams: &Beams, k: usize, segments: &mut Vec<Segment>, lines: &mut Vec<Line>) {
    lines.clear();
    let pieces = segments.len();
    segments.push(segments[k]);
    while segments.len() > pieces {
        let Some(part) = segments.pop() else { return };
        match farthest(beams, part) {
            Some((at, distance)) if distance > settings.split_m => {
                // The later half goes below the earlier one, so that lines come out in order.
                segments.push(counted(beams, at, part.last));
                segments.push(counted(beams, part.first, at));
            }
            _ => lines.extend(line::fit(beams, part, settings.range_std_m)),
        }
    }
}

fn counted(beams: &Beams, first: usize, last: usize) -> Segment {
    let hits = (first..=last).filter(|&i| beams.echo[beams.index(i)] == Echo::Hit).count();
    Segment { first, last, hits }
}

/// The hit strictly within a part that is farthest from the chord between its ends.
fn farthest(beams: &Beams, part: Segment) -> Option<(usize, f64)> {
    let (a, b) = (beams.point(beams.index(part.first)), beams.point(beams.index(part.last)));
    let chord = [b[0] - a[0], b[1] - a[1]];
    let length = norm(chord).max(1e-9);
    (part.first + 1..part.last)
        .filter(|&i| beams.echo[beams.index(i)] == Echo::Hit)
        .map(|i| {
            let p = beams.point(beams.index(i));
            (i, ((p[0] - a[0]) * chord[1] - (p[1] - a[1]) * chord[0]).abs() / length)
        })
        .max_by(|x, y| x.1.total_cmp(&y.1))
}

/// Whether a part is a wall.
fn judge(settings: &Corners, line: &Line) -> Verdict {
    if line.hits < settings.min_beams as usize {
        Verdict::TooFewBeams
    } else if line.length < settings.min_length_m {
        Verdict::TooSmall
    } else if line.residual > settings.max_residual_m {
        Verdict::PoorFit
    } else {
        Verdict::NoCorner
    }
}

fn piece(settings: &Corners, beams: &Beams, line: &Line) -> Piece {
    Segment { first: line.first, last: line.last, hits: line.hits }.piece(beams, judge(settings, line))
}

/// The corner of two walls that follow each other.
fn corner(settings: &Corners, beams: &Beams, a: &Line, b: &Line) -> Option<Detection> {
    let sine = (a.normal[0] * b.normal[1] - a.normal[1] * b.normal[0]).abs();
    if sine < math::sin_cos(settings.min_angle_rad.min(std::f64::consts::FRAC_PI_2)).0 {
        return None;
    }
    let (point, _) = line::intersection(a, b)?;
    // Where a corner was cut a beam or two off, scraps of wall lie between its two walls.
    let between = (a.last..=b.first).map(|i| beams.index(i)).filter(|&i| beams.echo[i] == Echo::Hit);
    let gaps = between.map(|i| beams.point(i)).map(|p| norm([point[0] - p[0], point[1] - p[1]]));
    if gaps.fold(f64::INFINITY, f64::min) > settings.max_gap_m || b.first - a.last > settings.min_beams as usize {
        return None;
    }
    // Echoes this close to the corner may be of either wall.
    let clear = |i: usize| {
        let p = beams.point(beams.index(i));
        beams.echo[beams.index(i)] == Echo::Hit && norm([point[0] - p[0], point[1] - p[1]]) > settings.split_m
    };
    let ends = ((a.first..=a.last).rev().find(|&i| clear(i))?, (b.first..=b.last).find(|&i| clear(i))?);
    let refit = |first, last| line::fit(beams, counted(beams, first, last), settings.range_std_m);
    let (point, covariance) = line::intersection(&refit(a.first, ends.0)?, &refit(ends.1, b.last)?)?;
    let (range_m, bearing_rad, covariance) = to_polar(point, covariance)?;
    Some(Detection {
        range_m,
        bearing_rad,
        covariance,
        signature: f64::NAN,
        intensity: f64::NAN,
        detection_probability: settings.detection_probability,
        first_beam: beams.index(a.first) as u32,
        last_beam: beams.index(b.last) as u32,
    })
}
