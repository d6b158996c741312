//! Sightings and odometry over path, landmarks and the errors of both, linearised: the rows of a least-squares problem.

use super::equations::motion_residual;
use crate::error::{Error, Result};
use crate::geometry::{Matrix3, Pose};
use crate::math;

/// Errors of a range-bearing sensor that stand at the border, in this order: scale of the range, its bias (m), and the
/// mounting on the robot, ahead (m), left (m) and yaw (rad).
pub const OF_SENSOR: usize = 5;

/// A sighting of a landmark from a pose of the path, as reported.
#[derive(Clone, Copy, Debug)]
pub struct Sight {
    /// Number of the pose.
    pub pose: usize,
    /// Number of the landmark.
    pub landmark: usize,
    /// Metres.
    pub range_m: f64,
    /// Radians.
    pub bearing_rad: f64,
}

/// What is to be explained, with its present explanation.
#[derive(Clone, Debug)]
pub struct Problem {
    /// The path: where the robot was, one after the other.
    pub poses: Vec<Pose>,
    /// Metres.
    pub landmarks: Vec<[f64; 2]>,
    /// Errors of the sensor.
    pub sensor: [f64; OF_SENSOR],
    /// Motion from each pose to the next by the odometry: ahead, left, turn.
    pub motion: Vec<Pose>,
    /// Its derivatives by the errors of the odometry: per link, those of ahead, of left, and of the turn.
    pub by_motion: Vec<f64>,
    /// Sightings, in any order.
    pub sights: Vec<Sight>,
}

impl Problem {
    /// How many errors of the odometry stand at the border.
    ///
    /// **Errors:** [`Error::Input`] where the numbers of poses, links and derivatives do not fit, or a sighting is of a
    /// pose or landmark that is none.
    pub fn motion_parameters(&self) -> Result<usize> {
        let (poses, links) = (self.poses.len(), self.motion.len());
        let fits = poses == links + 1 && self.by_motion.len().is_multiple_of(3 * links.max(1));
        let known = |sight: &Sight| sight.pose < poses && sight.landmark < self.landmarks.len();
        if fits && self.sights.iter().all(known) {
            return Ok(self.by_motion.len() / (3 * links.max(1)));
        }
        Err(Error::Input(format!(
            "least squares: got {poses} poses, {} landmarks, {links} motions, {} derivatives of them and {} sightings, \
             which do not fit",
            self.landmarks.len(),
            self.by_motion.len(),
            self.sights.len(),
        )))
    }
}

/// One number that is to be zero: its value, and its derivatives by two blocks of unknowns.
#[derive(Clone, Copy, Debug)]
pub(super) struct Row {
    pub residual: f64,
    /// First unknown of either block; the first has three, the second `width`.
    pub at: [usize; 2],
    pub width: usize,
    pub first: [f64; 3],
    pub second: [f64; 3],
}

/// Rows of a problem: those of the sightings, range and bearing in turn, then three for each motion.
///
/// Unknowns are ordered poses first: (x, y, heading) of each, then (x, y) of every landmark; at the border the errors of
/// the odometry, then those of the sensor.
#[derive(Clone, Debug)]
pub struct Rows {
    pub(super) poses: usize,
    pub(super) landmarks: usize,
    /// Columns of the border.
    pub(super) parameters: usize,
    pub(super) sightings: usize,
    pub(super) rows: Vec<Row>,
    /// Derivatives by the border, row by row.
    pub(super) border: Vec<f64>,
}

impl Rows {
    /// The rows of a problem at its present solution, not yet weighed.
    ///
    /// **Errors:** those of [`Problem::motion_parameters`].
    pub fn of(problem: &Problem) -> Result<Self> {
        let of_motion = problem.motion_parameters()?;
        let parameters = of_motion + OF_SENSOR;
        let count = 2 * problem.sights.len() + 3 * problem.motion.len();
        let mut rows = Self {
            poses: problem.poses.len(),
            landmarks: problem.landmarks.len(),
            parameters,
            sightings: problem.sights.len(),
            rows: Vec::with_capacity(count),
            border: vec![0.0; count * parameters],
        };
        for sight in &problem.sights {
            rows.add_sight(problem, sight, of_motion);
        }
        for link in 0..problem.motion.len() {
            rows.add_motion(problem, link, of_motion);
        }
        Ok(rows)
    }

    /// How many rows there are.
    pub fn len(&self) -> usize {
        self.rows.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    /// The number of unknowns, and of parameters at the border.
    pub fn size(&self) -> (usize, usize) {
        (3 * self.poses + 2 * self.landmarks, self.parameters)
    }

    /// How many of the rows, the first, are those of sightings.
    pub fn of_sightings(&self) -> usize {
        2 * self.sightings
    }

    /// What is left to explain, row by row.
    pub fn residuals(&self) -> Vec<f64> {
        self.rows.iter().map(|row| row.residual).collect()
    }

    /// Expected minus reported.
    fn add_sight(&mut self, problem: &Problem, sight: &Sight, of_motion: usize) {
        let [scale, bias_m, ahead_m, left_m, yaw_rad] = problem.sensor;
        let (pose, landmark) = (problem.poses[sight.pose], problem.landmarks[sight.landmark]);
        let (s, c) = math::sin_cos(pose.heading);
        let arm = [c * ahead_m - s * left_m, s * ahead_m + c * left_m];
        let offset = [landmark[0] - pose.x - arm[0], landmark[1] - pose.y - arm[1]];
        let distance = (offset[0] * offset[0] + offset[1] * offset[1]).sqrt().max(1e-6);
        let along = [offset[0] / distance, offset[1] / distance];
        let bearing = math::atan2(offset[1], offset[0]) - pose.heading - yaw_rad;
        let by_range = [scale * along[0], scale * along[1]];
        let by_bearing = [-along[1] / distance, along[0] / distance];
        let residuals = [scale * distance + bias_m - sight.range_m, math::wrap_angle(bearing - sight.bearing_rad)];
        for (k, by) in [by_range, by_bearing].into_iter().enumerate() {
            let turned = by[0] * arm[1] - by[1] * arm[0] - if k == 1 { 1.0 } else { 0.0 };
            let own = &mut self.border[self.rows.len() * self.parameters + of_motion..][..OF_SENSOR];
            own.copy_from_slice(&if k == 0 { [distance, 1.0, 0.0, 0.0, 0.0] } else { [0.0, 0.0, 0.0, 0.0, -1.0] });
            own[2] = -by[0] * c - by[1] * s;
            own[3] = by[0] * s - by[1] * c;
            self.rows.push(Row {
                residual: residuals[k],
                at: [3 * sight.pose, 3 * self.poses + 2 * sight.landmark],
                width: 2,
                first: [-by[0], -by[1], turned],
                second: [by[0], by[1], 0.0],
            });
        }
    }

    /// Motion of the path minus that of the odometry.
    fn add_motion(&mut self, problem: &Problem, link: usize, of_motion: usize) {
        let (before, after) = (problem.poses[link], problem.poses[link + 1]);
        let (residual, by_before, by_after) = motion_residual(before, after, problem.motion[link]);
        for axis in 0..3 {
            let own = &mut self.border[self.rows.len() * self.parameters..][..of_motion];
            let by = &problem.by_motion[(3 * link + axis) * of_motion..][..of_motion];
            own.iter_mut().zip(by).for_each(|(to, from)| *to = -from);
            self.rows.push(Row {
                residual: residual[axis],
                at: [3 * link, 3 * link + 3],
                width: 3,
                first: by_before[axis],
                second: by_after[axis],
            });
        }
    }

    /// The rows divided by their noise: `seen` is one over the standard deviation of each row of a sighting, `moved` a
    /// root of the precision of each motion. Columns of the border that are not `free` become zero.
    ///
    /// **Errors:** [`Error::Input`] for other numbers of them.
    pub fn whitened(&self, seen: &[f64], moved: &[Matrix3], free: &[bool]) -> Result<Self> {
        let links = (self.len() - self.of_sightings()) / 3;
        if seen.len() != self.of_sightings() || moved.len() != links || free.len() != self.parameters {
            return Err(Error::Input(format!(
                "least squares: got noise of {} rows of sightings, {} motions and {} parameters, expected {}, {links} \
                 and {}",
                seen.len(),
                moved.len(),
                free.len(),
                self.of_sightings(),
                self.parameters,
            )));
        }
        let mut white = self.clone();
        for (k, weight) in seen.iter().enumerate() {
            white.combine(self, k, &[(k, *weight)]);
        }
        for (link, root) in moved.iter().enumerate() {
            let first = self.of_sightings() + 3 * link;
            for (axis, weights) in root.iter().enumerate() {
                white.combine(self, first + axis, &std::array::from_fn::<_, 3, _>(|k| (first + k, weights[k])));
            }
        }
        for row in white.border.chunks_exact_mut(self.parameters) {
            row.iter_mut().zip(free).filter(|(_, free)| !**free).for_each(|(value, _)| *value = 0.0);
        }
        Ok(white)
    }

    /// Makes a row the weighted sum of some of `from`, which have the same unknowns.
    fn combine(&mut self, from: &Self, to: usize, parts: &[(usize, f64)]) {
        let sum = |f: &dyn Fn(&Row) -> f64| parts.iter().map(|(k, weight)| weight * f(&from.rows[*k])).sum();
        let row = &mut self.rows[to];
        row.residual = sum(&|row| row.residual);
        row.first = std::array::from_fn(|c| sum(&|row| row.first[c]));
        row.second = std::array::from_fn(|c| sum(&|row| row.second[c]));
        for c in 0..self.parameters {
            let by = |k: usize| from.border[k * self.parameters + c];
            self.border[to * self.parameters + c] = parts.iter().map(|(k, weight)| weight * by(*k)).sum();
        }
    }

    /// How the rows change with the unknowns, the parameters behind them: J x.
    pub(super) fn times(&self, unknowns: &[f64]) -> Vec<f64> {
        let (unknowns, parameters) = unknowns.split_at(self.size().0);
        let border = self.border.chunks_exact(self.parameters);
        let change = |(row, border): (&Row, &[f64])| {
            let first = dot(&row.first, &unknowns[row.at[0]..][..3]);
            let second = dot(&row.second[..row.width], &unknowns[row.at[1]..][..row.width]);
            first + second + dot(border, parameters)
        };
        self.rows.iter().zip(border).map(change).collect()
    }

    /// Jᵀ r, the parameters behind the unknowns.
    pub(super) fn transposed(&self, values: &[f64]) -> Vec<f64> {
        let (unknowns, parameters) = self.size();
        let mut sums = vec![0.0; unknowns + parameters];
        for ((row, border), value) in self.rows.iter().zip(self.border.chunks_exact(self.parameters)).zip(values) {
            add_to(&mut sums[row.at[0]..][..3], &row.first, *value);
            add_to(&mut sums[row.at[1]..][..row.width], &row.second[..row.width], *value);
            add_to(&mut sums[unknowns..], border, *value);
        }
        sums
    }
}

pub(super) fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Adds a multiple of a vector.
fn add_to(to: &mut [f64], vector: &[f64], times: f64) {
    to.iter_mut().zip(vector).for_each(|(to, value)| *to += times * value);
}
