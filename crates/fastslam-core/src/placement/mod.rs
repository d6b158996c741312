//! Where a small map of one's own lies in a large one: all places that are likely, with their odds.
//!
//! A local map of a few landmarks is laid on a kept map wherever a pair of its landmarks has the distance of a pair
//! there ([`pairs`]) and a third one lies on a landmark too ([`propose`]). A place is judged by evidence: how much
//! likelier the local landmarks lie as they do if the robot is there than if they had nothing to do with the map; the
//! integral over the pose is Laplace's ([`judge`]).

mod hull;
mod judge;
mod nearest;
mod pairs;
mod propose;

use crate::geometry::{Matrix3, Pose};
use nearest::Nearest;
use pairs::Pairs;

/// Probability that a landmark that is seen is in the map.
const IN_MAP: f64 = 0.8;
/// Probability that a landmark of the map that is surely in view was seen.
const SEEN: f64 = 0.6;
/// Probability that a class is told right.
const SAME_CLASS: f64 = 0.9;
/// Landmarks further apart than so many standard deviations are not one.
const GATE_SIGMAS: f64 = 4.0;

/// A landmark with what says which it may be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mark {
    /// Metres.
    pub mean: [f64; 2],
    /// The mean of the two, m².
    pub variance: f64,
    /// A name or a class; None where nobody says.
    pub label: Option<u32>,
}

/// What labels are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Labels {
    /// Names, which never differ.
    Names,
    /// Classes, which may be told wrong.
    Classes,
}

/// From where a local map was seen.
#[derive(Clone, Debug)]
pub struct View {
    /// `T_local_sensor`.
    pub sensors: Vec<Pose>,
    /// How far it saw, metres.
    pub reach_m: f64,
    /// Half the field of view, radians.
    pub half_view_rad: f64,
}

/// How many places are looked at, and told.
#[derive(Clone, Copy, Debug)]
pub struct Effort {
    /// The places that look best at first, which are refined.
    pub refined: usize,
    /// The likeliest of these, which are told.
    pub told: usize,
}

/// A place at which the local map may lie.
#[derive(Clone, Copy, Debug)]
pub struct Placement {
    /// `T_map_local`.
    pub pose: Pose,
    /// In the order x, y, heading.
    pub covariance: Matrix3,
    /// Against a local map that has nothing to do with the map.
    pub log_odds: f64,
    /// How many local landmarks the map explains.
    pub matched: usize,
}

/// A kept map in which local ones are looked for.
#[derive(Clone, Debug)]
pub struct Chart {
    marks: Vec<Mark>,
    labels: Labels,
    classes: f64,
    nearest: Nearest,
    pairs: Pairs,
    hull_m2: f64,
    largest_variance: f64,
    typical_variance: f64,
}

impl Chart {
    /// Numbers are finite, variances positive.
    pub fn new(marks: Vec<Mark>, labels: Labels) -> Self {
        let means: Vec<[f64; 2]> = marks.iter().map(|mark| mark.mean).collect();
        let hull_m2 = hull::area(&means);
        let nearest = Nearest::new(&means);
        Self {
            labels,
            classes: classes(&marks),
            pairs: Pairs::new(&means, &nearest),
            nearest,
            hull_m2,
            largest_variance: marks.iter().map(|mark| mark.variance).fold(0.0, f64::max),
            typical_variance: median(marks.iter().map(|mark| mark.variance)),
            marks,
        }
    }

    /// The likeliest places of a local map, the best first; fewer than two landmarks in common place nothing.
    ///
    /// Places nearer to each other than half a metre and a tenth of a radian count once.
    pub fn placements(&self, local: &[Mark], view: &View, effort: Effort) -> Vec<Placement> {
        if self.marks.len() < 2 || local.len() < 2 {
            return Vec::new();
        }
        let inquiry = self.inquiry(local, view);
        let proposals = inquiry.proposals();
        let mut found: Vec<Placement> =
            apart(&proposals, effort.refined).into_iter().filter_map(|pose| inquiry.refined(pose)).collect();
        found.sort_by(|a, b| b.log_odds.total_cmp(&a.log_odds));
        let poses: Vec<Pose> = found.iter().map(|placement| placement.pose).collect();
        apart_rows(&poses, effort.told).into_iter().map(|row| found[row]).collect()
    }

    fn inquiry<'a>(&'a self, local: &'a [Mark], view: &'a View) -> Inquiry<'a> {
        let area_m2 = self.hull_m2.max(std::f64::consts::PI * view.reach_m * view.reach_m);
        let largest = local.iter().map(|mark| mark.variance).fold(self.largest_variance, f64::max);
        let typical = self.typical_variance + median(local.iter().map(|mark| mark.variance));
        Inquiry {
            chart: self,
            local,
            view,
            area_m2,
            density: self.marks.len() as f64 / area_m2,
            gate_m: GATE_SIGMAS * (2.0 * largest).sqrt(),
            tolerance_m: GATE_SIGMAS * typical.sqrt(),
        }
    }
}

/// One local map against one map.
struct Inquiry<'a> {
    chart: &'a Chart,
    local: &'a [Mark],
    view: &'a View,
    area_m2: f64,
    /// Landmarks of the map per square metre.
    density: f64,
    /// No two landmarks that are one are further apart.
    gate_m: f64,
    /// Typically.
    tolerance_m: f64,
}

impl Inquiry<'_> {
    /// How much likelier the labels are of one landmark than of two.
    fn looks(&self, ours: &Mark, theirs: &Mark) -> f64 {
        let (Some(a), Some(b)) = (ours.label, theirs.label) else {
            return 1.0;
        };
        match self.chart.labels {
            Labels::Names => f64::from(u8::from(a == b)) * self.chart.marks.len() as f64,
            Labels::Classes if a == b => SAME_CLASS * self.chart.classes,
            Labels::Classes => (1.0 - SAME_CLASS) / (self.chart.classes - 1.0) * self.chart.classes,
        }
    }

    /// How much likelier a local landmark lies where it does than one by chance.
    fn ratio(&self, ours: &Mark, theirs: &Mark, distance2: f64) -> f64 {
        let variance = ours.variance + theirs.variance;
        let peak = crate::math::exp(-0.5 * distance2 / variance) / (std::f64::consts::TAU * variance);
        1.0 - IN_MAP + IN_MAP * peak * self.looks(ours, theirs) / self.density
    }
}

/// How many classes there are, at least two.
fn classes(marks: &[Mark]) -> f64 {
    let mut labels: Vec<u32> = marks.iter().filter_map(|mark| mark.label).collect();
    labels.sort_unstable();
    labels.dedup();
    labels.len().max(2) as f64
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut sorted: Vec<f64> = values.collect();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied().unwrap_or(0.0)
}

/// The first of these poses that are not near an earlier one.
fn apart(poses: &[Pose], most: usize) -> Vec<Pose> {
    apart_rows(poses, most).into_iter().map(|row| poses[row]).collect()
}

fn apart_rows(poses: &[Pose], most: usize) -> Vec<usize> {
    const NEAR_M: f64 = 0.5;
    const NEAR_RAD: f64 = 0.1;
    let near = |a: &Pose, b: &Pose| {
        (a.x - b.x).hypot(a.y - b.y) < NEAR_M && crate::math::wrap_angle(a.heading - b.heading).abs() < NEAR_RAD
    };
    let mut chosen: Vec<usize> = Vec::new();
    for (row, pose) in poses.iter().enumerate() {
        if chosen.len() == most {
            break;
        }
        if !chosen.iter().any(|&other| near(pose, &poses[other])) {
            chosen.push(row);
        }
    }
    chosen
}

#[cfg(test)]
mod tests;
