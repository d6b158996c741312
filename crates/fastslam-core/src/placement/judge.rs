//! The best pose near a proposal, and its evidence.

use super::{Inquiry, Placement, GATE_SIGMAS, IN_MAP, SEEN};
use crate::geometry::{Matrix3, Pose};
use crate::math;
use crate::normal::Cholesky;
use std::f64::consts::TAU;

const MOST_STEPS: usize = 8;
const STEP_DONE: f64 = 1e-6;
/// Fraction of the sensor's poses from which a landmark must be in view to be surely seen.
const SURELY_SEEN: f64 = 0.3;

/// A local landmark and the one of the map that it lies on.
#[derive(Clone, Copy)]
struct Pair {
    ours: usize,
    theirs: usize,
    distance2: f64,
}

impl Inquiry<'_> {
    /// The placement near a pose; None where too little fits.
    pub(super) fn refined(&self, mut pose: Pose) -> Option<Placement> {
        let mut factor = None;
        for _ in 0..MOST_STEPS {
            let pairs = self.paired(pose);
            if pairs.len() < 2 {
                return None;
            }
            let (information, gradient) = self.normal_equations(pose, &pairs);
            let solved = Cholesky::of(&information)?;
            let step = solved.solve(&gradient);
            pose = Pose::new(pose.x + step[0], pose.y + step[1], pose.heading + step[2]);
            factor = Some(solved);
            if step.iter().all(|change| change.abs() < STEP_DONE) {
                break;
            }
        }
        let pose = Pose::new(pose.x, pose.y, math::wrap_angle(pose.heading));
        factor.map(|factor| self.judged(pose, &factor))
    }

    /// Local landmarks that lie on one of the map, each of which stands for the nearest alone.
    fn paired(&self, pose: Pose) -> Vec<Pair> {
        let mut pairs: Vec<Pair> = Vec::new();
        for (ours, mark) in self.local.iter().enumerate() {
            let Some((theirs, distance2)) = self.chart.nearest.within(pose.transform(mark.mean), self.gate_m) else {
                continue;
            };
            let other = &self.chart.marks[theirs];
            let gate2 = GATE_SIGMAS * GATE_SIGMAS * (mark.variance + other.variance);
            if distance2 > gate2 || self.looks(mark, other) <= 0.0 {
                continue;
            }
            match pairs.iter_mut().find(|pair| pair.theirs == theirs) {
                Some(rival) if rival.distance2 <= distance2 => {}
                Some(rival) => *rival = Pair { ours, theirs, distance2 },
                None => pairs.push(Pair { ours, theirs, distance2 }),
            }
        }
        pairs
    }

    /// Information and gradient of the pose: a step of Gauss and Newton.
    fn normal_equations(&self, pose: Pose, pairs: &[Pair]) -> (Matrix3, [f64; 3]) {
        let mut information = [[1e-9, 0.0, 0.0], [0.0, 1e-9, 0.0], [0.0, 0.0, 1e-9]];
        let mut gradient = [0.0; 3];
        for pair in pairs {
            let (ours, theirs) = (&self.local[pair.ours], &self.chart.marks[pair.theirs]);
            let moved = pose.transform(ours.mean);
            let lever = [moved[0] - pose.x, moved[1] - pose.y];
            let weight = 1.0 / (ours.variance + theirs.variance);
            let rows =
                [([1.0, 0.0, -lever[1]], theirs.mean[0] - moved[0]), ([0.0, 1.0, lever[0]], theirs.mean[1] - moved[1])];
            for (row, off) in rows {
                for i in 0..3 {
                    gradient[i] += weight * row[i] * off;
                    for j in 0..3 {
                        information[i][j] += weight * row[i] * row[j];
                    }
                }
            }
        }
        (information, gradient)
    }

    fn judged(&self, pose: Pose, factor: &Cholesky<3>) -> Placement {
        let pairs = self.paired(pose);
        let alone = (self.local.len() - pairs.len()) as f64 * math::ln(1.0 - IN_MAP);
        let fit: f64 = pairs
            .iter()
            .map(|pair| math::ln(self.ratio(&self.local[pair.ours], &self.chart.marks[pair.theirs], pair.distance2)))
            .sum();
        let missed = self.missed(pose, &pairs) as f64 * math::ln(1.0 - SEEN);
        // The volume of the pose's Gaussian against that of all poses.
        let occam = 1.5 * math::ln(TAU) - 0.5 * factor.log_determinant() - math::ln(self.area_m2 * TAU);
        Placement {
            pose,
            covariance: symmetric(&factor.inverse()),
            log_odds: fit + alone + missed + occam,
            matched: pairs.len(),
        }
    }

    /// How many landmarks of the map the sensor surely saw on its way that are not among the local ones.
    fn missed(&self, pose: Pose, pairs: &[Pair]) -> usize {
        let sensors: Vec<Pose> = self.view.sensors.iter().map(|sensor| pose.compose(*sensor)).collect();
        let mut counts: Vec<(usize, u32)> = Vec::new();
        for sensor in &sensors {
            self.chart.nearest.each([sensor.x, sensor.y], self.view.reach_m, |row, distance2| {
                let mark = self.chart.marks[row].mean;
                let bearing = math::wrap_angle(math::atan2(mark[1] - sensor.y, mark[0] - sensor.x) - sensor.heading);
                let near = distance2 < self.view.reach_m * self.view.reach_m;
                if near && bearing.abs() < self.view.half_view_rad {
                    match counts.iter_mut().find(|(other, _)| *other == row) {
                        Some((_, count)) => *count += 1,
                        None => counts.push((row, 1)),
                    }
                }
            });
        }
        let least = SURELY_SEEN * sensors.len() as f64;
        counts
            .iter()
            .filter(|(row, count)| f64::from(*count) > least && !pairs.iter().any(|pair| pair.theirs == *row))
            .count()
    }
}

/// The matrix without what rounding has made of its two halves.
fn symmetric(matrix: &Matrix3) -> Matrix3 {
    std::array::from_fn(|i| std::array::from_fn(|j| 0.5 * (matrix[i][j] + matrix[j][i])))
}
