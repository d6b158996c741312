//! Things that shine: posts with reflective tape, warehouse reflectors.

use super::beams::{Beams, Echo};
use super::segments::Segment;
use super::verdict::Verdict;
use super::{strongest, to_polar, Detection, Detector, Scan};
use crate::error::{finite, non_negative, positive, Error, Result};
use crate::geometry::Symmetric2;
use crate::math;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Settings of the detector of reflectors. It needs intensities and finds nothing without them.
///
/// Neighbouring bright beams at one range are one reflector: the median of the ranges to its axis, at the mean
/// direction of the beams.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Reflectors {
    /// A beam is bright from this intensity on, in the unit of the scan.
    pub min_intensity: f64,
    /// Bright beams whose ranges differ by more are of two reflectors.
    pub jump_m: f64,
    /// So many dim or missing beams within a reflector are bridged; of a post near the sensor also more, if no beam between
    /// passes it by.
    pub bridge_beams: u32,
    /// Fewest bright beams on a reflector.
    pub min_beams: u32,
    /// Largest distance between the outermost bright beams.
    pub max_width_m: f64,
    /// Reflectors farther than this are skipped.
    pub max_range_m: f64,
    /// Radius of the post: added to the range of its surface, and its diameter is the signature; no two posts stand nearer
    /// than twice that. 0 for flat ones.
    pub radius_m: f64,
    /// How much too long the ranges of bright echoes are; subtracted.
    pub range_bias_m: f64,
    /// Standard deviation of one range.
    pub range_std_m: f64,
    /// Standard deviation of the direction of a reflector beyond that of its place between the beams.
    pub bearing_std_rad: f64,
    /// Probability that a reflector in view is found.
    pub detection_probability: f64,
}

impl Default for Reflectors {
    fn default() -> Self {
        Self {
            min_intensity: 1.0,
            jump_m: 0.5,
            bridge_beams: 1,
            min_beams: 1,
            max_width_m: 0.5,
            max_range_m: 75.0,
            radius_m: 0.03,
            range_bias_m: 0.0,
            range_std_m: 0.05,
            bearing_std_rad: 0.002,
            detection_probability: 0.9,
        }
    }
}

impl Reflectors {
    /// Errors that name the first parameter out of range.
    pub fn validate(&self) -> Result<()> {
        finite("min_intensity", self.min_intensity)?;
        positive("jump_m", self.jump_m)?;
        positive("max_width_m", self.max_width_m)?;
        positive("max_range_m", self.max_range_m)?;
        non_negative("radius_m", self.radius_m)?;
        finite("range_bias_m", self.range_bias_m)?;
        positive("range_std_m", self.range_std_m)?;
        non_negative("bearing_std_rad", self.bearing_std_rad)?;
        if self.min_beams == 0 {
            return Err(Error::parameter("min_beams", self.min_beams, "at least 1"));
        }
        if !(self.detection_probability > 0.0 && self.detection_probability <= 1.0) {
            return Err(Error::parameter("detection_probability", self.detection_probability, "above 0, at most 1"));
        }
        Ok(())
    }

    /// Covariance of (range, bearing): the range is a median of so many, the direction uniform within half a step at
    /// both ends.
    fn covariance(&self, hits: usize, step_rad: f64) -> Symmetric2 {
        let median_factor = if hits > 2 { std::f64::consts::FRAC_PI_2 } else { 1.0 };
        let range_variance = self.range_std_m * self.range_std_m * median_factor / hits as f64;
        let bearing_variance = self.bearing_std_rad * self.bearing_std_rad + step_rad * step_rad / 24.0;
        Symmetric2::new(range_variance, 0.0, bearing_variance)
    }
}

impl Detector {
    pub(super) fn reflectors(&mut self, scan: &Scan, found: &mut Vec<Detection>) {
        let Some(intensities) = scan.intensities else { return };
        let settings = &self.config.reflectors;
        let beams = &self.beams;
        let bright = |i: usize| {
            beams.echo[i] == Echo::Hit
                && intensities[i] >= settings.min_intensity
                && beams.range[i] <= settings.max_range_m
        };
        cluster(settings, beams, bright, &mut self.segments);
        for &segment in &self.segments {
            let verdict = judge(settings, beams, segment);
            self.pieces.push(segment.piece(beams, verdict));
            if verdict != Verdict::Detected {
                continue;
            }
            let members = || (segment.first..=segment.last).map(|i| beams.index(i)).filter(|&i| bright(i));
            let Some([range_m, bearing_rad]) = measure(settings, beams, segment, members(), &mut self.values) else {
                continue;
            };
            found.push(Detection {
                range_m,
                bearing_rad,
                covariance: settings.covariance(segment.hits, beams.step.abs()),
                signature: if settings.radius_m > 0.0 { 2.0 * settings.radius_m } else { f64::NAN },
                intensity: strongest(scan, members()),
                detection_probability: settings.detection_probability,
                first_beam: segment.first as u32,
                last_beam: beams.index(segment.last) as u32,
            });
        }
    }
}

/// Whether a run of bright beams may be a reflector.
fn judge(settings: &Reflectors, beams: &Beams, segment: Segment) -> Verdict {
    if segment.hits < settings.min_beams as usize {
        Verdict::TooFewBeams
    } else if width(beams, segment) > settings.max_width_m {
        Verdict::TooWide
    } else {
        Verdict::Detected
    }
}

/// Range and bearing of the axis: the median of what the bright beams say of its range, in their mean direction.
fn measure(
    settings: &Reflectors,
    beams: &Beams,
    segment: Segment,
    members: impl Iterator<Item = usize>,
    ranges: &mut Vec<f64>,
) -> Option<[f64; 2]> {
    let ends = [segment.first, segment.last].map(|end| beams.direction[beams.index(end)]);
    let sum = [0, 1].map(|axis| ends[0][axis] + ends[1][axis]);
    let length = (sum[0].powi(2) + sum[1].powi(2)).sqrt();
    let toward = [sum[0] / length, sum[1] / length];
    let axis = (toward, play(settings, beams, segment));
    ranges.clear();
    ranges.extend(members.map(|i| axis_range(settings, beams, i, axis)));
    let range = median(ranges);
    let origin = beams.origin[beams.index((segment.first + segment.last) / 2)];
    let center = [origin[0] + range * toward[0], origin[1] + range * toward[1]];
    let (range_m, bearing_rad, _) = to_polar(center, Symmetric2::new(1.0, 0.0, 1.0))?;
    Some([range_m, bearing_rad])
}

/// Runs of bright beams at one range, joined over the seam of a full turn.
fn cluster(settings: &Reflectors, beams: &Beams, bright: impl Fn(usize) -> bool, segments: &mut Vec<Segment>) {
    segments.clear();
    let at_one_range = |a: usize, b: usize| (beams.range[a] - beams.range[b]).abs() <= settings.jump_m;
    // Of a post near by the beams that meet its middle may come back dim.
    let one_post = |a: usize, beams_on: usize| {
        let passes = |i: usize| beams.echo[i] == Echo::Hit && !at_one_range(a, i);
        beams_on as f64 * beams.range[a] * beams.step.abs() <= 4.0 * settings.radius_m
            && !(1..beams_on).any(|on| passes(beams.index(a + on)))
    };
    let joins = |a: usize, b: usize, beams_on: usize| {
        at_one_range(a, b) && (beams_on <= settings.bridge_beams as usize + 1 || one_post(a, beams_on))
    };
    for i in (0..beams.len()).filter(|&i| bright(i)) {
        match segments.last_mut() {
            Some(open) if joins(open.last, i, i - open.last) => {
                open.last = i;
                open.hits += 1;
            }
            _ => segments.push(Segment { first: i, last: i, hits: 1 }),
        }
    }
    if let (true, Some(&first), Some(&last)) = (beams.closed && segments.len() > 1, segments.first(), segments.last()) {
        if joins(last.last, first.first, first.first + beams.len() - last.last) {
            segments.pop();
            segments[0] = Segment { first: last.first, last: first.last + beams.len(), hits: first.hits + last.hits };
            segments.rotate_left(1);
        }
    }
}

fn width(beams: &Beams, segment: Segment) -> f64 {
    let (a, b) = (beams.point(beams.index(segment.first)), beams.point(beams.index(segment.last)));
    ((a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2)).sqrt()
}

/// Distance of the axis of the post along `toward`, from what beam `i` says of its surface. The axis lies up to `play_m`
/// beside that line: the depth of the post behind its surface is the mean over this interval.
fn axis_range(settings: &Reflectors, beams: &Beams, i: usize, (toward, play_m): ([f64; 2], f64)) -> f64 {
    let (d, range) = (beams.direction[i], beams.range[i] - settings.range_bias_m);
    let along = range * (d[0] * toward[0] + d[1] * toward[1]);
    let across = range * (d[0] * toward[1] - d[1] * toward[0]);
    along + mean_depth(settings.radius_m, across - play_m, across + play_m)
}

/// Mean of √(R² − x²) for x from `low` to `high`, 0 beyond the circle.
fn mean_depth(radius: f64, low: f64, high: f64) -> f64 {
    let depth = |x: f64| (radius * radius - x * x).max(0.0).sqrt();
    if high - low < 1e-6 * radius.max(1e-6) {
        return depth(0.5 * (low + high));
    }
    let area = |x: f64| {
        let x = x.clamp(-radius, radius);
        0.5 * (x * depth(x) + radius * radius * math::atan2(x, depth(x)))
    };
    (area(high) - area(low)) / (high - low)
}

/// How far the axis of the post may lie beside the middle of the beams on it: not so far that another number of beams
/// would have met it.
fn play(settings: &Reflectors, beams: &Beams, segment: Segment) -> f64 {
    let spacing = beams.range[beams.index(segment.first)] * beams.step.abs();
    let width = (segment.last - segment.first) as f64 * spacing;
    let inside = settings.radius_m - 0.5 * width;
    inside.min(0.5 * width + spacing - settings.radius_m).max(0.0)
}

/// The median of a list that is not empty.
fn median(values: &mut [f64]) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    let half = values.len() / 2;
    if values.len() % 2 == 1 {
        values[half]
    } else {
        0.5 * (values[half - 1] + values[half])
    }
}
