//! Round things that stand free: tree trunks, poles, rocks.

use super::beams::{Beams, Echo};
use super::circle::{self, norm, Arc, Circle, Edge, Noise};
use super::segments::{self, Cut, Segment};
use super::verdict::Verdict;
use super::wall;
use super::{strongest, to_polar, Detection, Detector, Scan};
use crate::error::{non_negative, positive, Error};
use crate::geometry::Symmetric2;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Settings of the detector of round objects.
///
/// The scan is cut where the range jumps. A piece whose neighbour is nearer may go on behind it, so that end says
/// nothing of the width; a piece with both ends hidden is no object. A circle is fitted to the rest: its centre is the
/// landmark, its diameter the signature (NaN unless both ends are free).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Trunks {
    /// Neighbouring ranges that differ by more are of two surfaces.
    pub jump_m: f64,
    /// Added to `jump_m` for each metre of range.
    pub jump_per_range: f64,
    /// So many beams without an echo within an object are bridged.
    pub bridge_beams: u32,
    /// Fewest beams on an object.
    pub min_beams: u32,
    /// Objects whose surface is farther are skipped.
    pub max_range_m: f64,
    /// Smallest diameter.
    pub min_diameter_m: f64,
    /// Largest diameter.
    pub max_diameter_m: f64,
    /// Largest root mean square distance of the points from the circle, in standard deviations.
    pub max_normalized_residual: f64,
    /// Largest standard deviation of the centre in any direction.
    pub max_center_std_m: f64,
    /// How much farther, at least, the background must be at both free ends.
    pub min_clearance_m: f64,
    /// Standard deviation of one range.
    pub range_std_m: f64,
    /// Standard deviation of the direction of one beam.
    pub beam_std_rad: f64,
    /// Full width of a beam: objects look wider by this.
    pub beam_width_rad: f64,
    /// Deviation of surfaces from a circle.
    pub roughness_std_m: f64,
    /// Expected diameter, used only where one end of an object is hidden.
    pub typical_diameter_m: f64,
    /// Standard deviation of the diameters about the expected one.
    pub typical_diameter_std_m: f64,
    /// Standard deviation of the range of a centre beyond that of the fit: what repeats from scan to scan, such as lean
    /// and shape of trunks, must not be averaged away.
    pub extra_range_std_m: f64,
    /// The same for the bearing.
    pub extra_bearing_std_rad: f64,
    /// Probability that a beam on an object comes back.
    pub return_probability: f64,
}

impl Default for Trunks {
    fn default() -> Self {
        Self {
            jump_m: 0.3,
            jump_per_range: 0.005,
            bridge_beams: 1,
            min_beams: 3,
            max_range_m: 75.0,
            min_diameter_m: 0.02,
            max_diameter_m: 2.0,
            max_normalized_residual: 2.5,
            max_center_std_m: 0.3,
            min_clearance_m: 0.3,
            range_std_m: 0.02,
            beam_std_rad: 0.0005,
            beam_width_rad: 0.0,
            roughness_std_m: 0.01,
            typical_diameter_m: 0.5,
            typical_diameter_std_m: 0.4,
            extra_range_std_m: 0.0,
            extra_bearing_std_rad: 0.0,
            return_probability: 0.98,
        }
    }
}

impl Trunks {
    /// Errors that name the first parameter out of range.
    pub fn validate(&self) -> crate::error::Result<()> {
        positive("jump_m", self.jump_m)?;
        non_negative("jump_per_range", self.jump_per_range)?;
        positive("max_range_m", self.max_range_m)?;
        non_negative("min_diameter_m", self.min_diameter_m)?;
        positive("max_diameter_m", self.max_diameter_m)?;
        positive("max_normalized_residual", self.max_normalized_residual)?;
        positive("max_center_std_m", self.max_center_std_m)?;
        non_negative("min_clearance_m", self.min_clearance_m)?;
        positive("range_std_m", self.range_std_m)?;
        non_negative("beam_std_rad", self.beam_std_rad)?;
        non_negative("beam_width_rad", self.beam_width_rad)?;
        positive("roughness_std_m", self.roughness_std_m)?;
        non_negative("extra_range_std_m", self.extra_range_std_m)?;
        non_negative("extra_bearing_std_rad", self.extra_bearing_std_rad)?;
        positive("typical_diameter_m", self.typical_diameter_m)?;
        positive("typical_diameter_std_m", self.typical_diameter_std_m)?;
        if self.min_beams == 0 {
            return Err(Error::parameter("min_beams", self.min_beams, "at least 1"));
        }
        if self.max_diameter_m <= self.min_diameter_m {
            return Err(Error::parameter("max_diameter_m", self.max_diameter_m, "more than min_diameter_m"));
        }
        if !(self.return_probability > 0.0 && self.return_probability <= 1.0) {
            return Err(Error::parameter("return_probability", self.return_probability, "above 0, at most 1"));
        }
        Ok(())
    }

    fn noise(&self) -> Noise {
        Noise {
            range_std_m: self.range_std_m,
            beam_std_rad: self.beam_std_rad,
            roughness_std_m: self.roughness_std_m,
            radius_m: 0.5 * self.typical_diameter_m,
            radius_std_m: 0.5 * self.typical_diameter_std_m,
        }
    }

    /// Probability that an object as wide as this is hit by `min_beams` beams that come back: the number of beams on it
    /// is the width in beams, rounded down or up with the chance of its position between the beams.
    fn detection_probability(&self, range_m: f64, radius_m: f64, step_rad: f64) -> f64 {
        let width_in_beams = (2.0 * radius_m / range_m + self.beam_width_rad) / step_rad;
        let enough = (width_in_beams - f64::from(self.min_beams) + 1.0).clamp(0.0, 1.0);
        (enough * self.return_probability).max(1e-3)
    }
}

impl Detector {
    pub(super) fn trunks(&mut self, scan: &Scan, found: &mut Vec<Detection>) {
        let Self { config, beams, segments, scratch, pieces, .. } = self;
        let settings = &config.trunks;
        let cut = Cut {
            jump_m: settings.jump_m,
            jump_per_range: settings.jump_per_range,
            bridge_beams: settings.bridge_beams as usize,
        };
        segments::split(beams, cut, segments);
        let beams = &*beams;
        for &segment in segments.iter() {
            let fitted = fit(settings, beams, segment, scratch);
            pieces.push(segment.piece(beams, fitted.as_ref().err().copied().unwrap_or(Verdict::Detected)));
            let Ok((circle, origin, whole)) = fitted else { continue };
            let center = [circle.center[0] + origin[0], circle.center[1] + origin[1]];
            let c = circle.covariance;
            let spread = settings.roughness_std_m * settings.roughness_std_m;
            let covariance = Symmetric2::new(c[0][0] + spread, c[0][1], c[1][1] + spread);
            let Some((range_m, bearing_rad, mut covariance)) = to_polar(center, covariance) else { continue };
            covariance.xx += settings.extra_range_std_m * settings.extra_range_std_m;
            covariance.yy += settings.extra_bearing_std_rad * settings.extra_bearing_std_rad;
            let members = (segment.first..=segment.last).map(|i| beams.index(i));
            found.push(Detection {
                range_m,
                bearing_rad,
                covariance,
                signature: if whole { 2.0 * circle.radius } else { f64::NAN },
                intensity: strongest(scan, members.filter(|&i| beams.echo[i] == Echo::Hit)),
                detection_probability: settings.detection_probability(range_m, circle.radius, beams.step.abs()),
                first_beam: segment.first as u32,
                last_beam: beams.index(segment.last) as u32,
            });
        }
    }
}

/// The circle of one piece, relative to the place its middle beam was sent from, that place, and whether both ends are
/// free; or why it is no round object.
fn fit(
    settings: &Trunks,
    beams: &Beams,
    segment: Segment,
    points: &mut Vec<[f64; 2]>,
) -> Result<(Circle, [f64; 2], bool), Verdict> {
    if segment.hits < settings.min_beams as usize {
        return Err(Verdict::TooFewBeams);
    }
    let (first, last) = (beams.index(segment.first), beams.index(segment.last));
    if beams.range[first].min(beams.range[last]) > settings.max_range_m {
        return Err(Verdict::TooFar);
    }
    // An object wider than the largest cannot pass: spare the fit.
    if chord(beams, first, last) > 1.2 * settings.max_diameter_m {
        return Err(Verdict::TooWide);
    }
    let edges = edges(settings, beams, segment);
    if edges.iter().all(Option::is_none) {
        return Err(Verdict::EndsHidden);
    }
    let origin = beams.origin[beams.index((segment.first + segment.last) / 2)];
    collect_hits(beams, segment, origin, points);
    let arc = Arc { points, origin, edges };
    let noise = settings.noise();
    let circle = circle::refine(&arc, start(settings, beams, segment, points), &noise).ok_or(Verdict::PoorFit)?;
    judge(settings, &circle)?;
    let whole = edges.iter().all(Option::is_some);
    // Last, as few get here. What stands free on both sides is no part of a wall however flat it looks.
    if wall::goes_on(beams, segment, &noise, settings.max_normalized_residual)
        || !whole && wall::is_straight(beams, segment, &noise, circle.normalized_residual)
    {
        return Err(Verdict::Wall);
    }
    Ok((circle, origin, whole))
}

/// What the beams of a piece hit, relative to `origin`.
fn collect_hits(beams: &Beams, segment: Segment, origin: [f64; 2], points: &mut Vec<[f64; 2]>) {
    points.clear();
    let hits = (segment.first..=segment.last).map(|i| beams.index(i)).filter(|&i| beams.echo[i] == Echo::Hit);
    points.extend(hits.map(|i| {
        let p = beams.point(i);
        [p[0] - origin[0], p[1] - origin[1]]
    }));
}

/// Whether a circle may be an object.
fn judge(settings: &Trunks, circle: &Circle) -> Result<(), Verdict> {
    let c = circle.covariance;
    let variance = Symmetric2::new(c[0][0], c[0][1], c[1][1]).largest_eigenvalue();
    let diameter = 2.0 * circle.radius;
    if diameter < settings.min_diameter_m {
        Err(Verdict::TooSmall)
    } else if diameter > settings.max_diameter_m {
        Err(Verdict::TooWide)
    } else if variance > settings.max_center_std_m * settings.max_center_std_m {
        Err(Verdict::Uncertain)
    } else if circle.normalized_residual <= settings.max_normalized_residual && norm(circle.center) > circle.radius {
        // The sensor is outside of what it sees.
        Ok(())
    } else {
        Err(Verdict::PoorFit)
    }
}

fn chord(beams: &Beams, first: usize, last: usize) -> f64 {
    let (a, b) = (beams.point(first), beams.point(last));
    norm([a[0] - b[0], a[1] - b[1]])
}

/// The free ends of a piece (low index, high index).
fn edges(settings: &Trunks, beams: &Beams, segment: Segment) -> [Option<Edge>; 2] {
    let free = segments::free_ends(beams, segment);
    let n = beams.len();
    let end = [beams.index(segment.first), beams.index(segment.last)];
    std::array::from_fn(|side| {
        let steps = free[side]?;
        let inside = end[side];
        let outside = if side == 0 { (inside + n - steps) % n } else { (inside + steps) % n };
        let clear = beams.echo[outside] == Echo::Beyond
            || beams.range[outside] - beams.range[inside] >= settings.min_clearance_m;
        if !clear {
            return None;
        }
        let (a, b) = (beams.direction[inside], beams.direction[outside]);
        let middle = [a[0] + b[0], a[1] + b[1]];
        let length = norm(middle);
        Some(Edge {
            origin: beams.origin[inside],
            direction: [middle[0] / length, middle[1] / length],
            side: if (side == 1) == (beams.step > 0.0) { 1.0 } else { -1.0 },
            half_width_rad: 0.5 * beams.step.abs() * steps as f64,
            overhang_rad: 0.5 * settings.beam_width_rad,
        })
    })
}

/// Where the refinement starts: the algebraic circle if it agrees with the width of the piece, else one of that width.
fn start(settings: &Trunks, beams: &Beams, segment: Segment, points: &[[f64; 2]]) -> ([f64; 2], f64) {
    let middle = points[points.len() / 2];
    let range = norm(middle);
    let width = range * beams.step.abs() * (segment.last - segment.first + 1) as f64;
    let radius = (0.5 * width).clamp(0.5 * settings.min_diameter_m.max(0.01), 0.5 * settings.max_diameter_m);
    match circle::algebraic(points) {
        Some((center, r)) if r > 0.5 * radius && r < 2.0 * radius && norm(center) > range => (center, r),
        _ => {
            let stretch = (range + radius) / range.max(1e-9);
            ([middle[0] * stretch, middle[1] * stretch], radius)
        }
    }
}
