//! The one assembly of least squares over a path: motions, sightings and what is known become normal equations.
//!
//! Unknowns are ordered poses first: (x, y, heading) of each, then (x, y) of every landmark, then parameters at the border.
//! Who asks feeds blocks of derivatives with a weight; sums of JᵀWJ stand in the places that a chain with landmarks needs.

use super::triangle::UpperTriangle;
use crate::geometry::{Matrix3, Pose};
use crate::math;
use crate::motion::MotionGaussian;
use crate::normal::Matrix;

/// Added to the variances of every motion, in m² and rad².
///
/// **Why:** a control of two dimensions spans two of the three of a motion, and standing still none, so the precision
/// of a motion need not exist. A tenth of a millimetre a step is one centimetre after 10,000 steps.
const LEAST_VARIANCE: [f64; 3] = [1e-8, 1e-8, 1e-10];

/// The precision of a solution, and minus the gradient of its cost.
pub(crate) struct Equations {
    /// Of the precision.
    pub upper: UpperTriangle,
    /// Minus the gradient.
    pub descent: Vec<f64>,
    /// The first unknown at the border.
    border: usize,
}

/// Derivatives of `Z` numbers by `N` unknowns that stand together.
pub(crate) struct Block<const Z: usize, const N: usize> {
    at: usize,
    by: Matrix<Z, N>,
    /// Jᵀ W.
    weighted: Matrix<N, Z>,
}

impl<const Z: usize, const N: usize> Block<Z, N> {
    /// By the unknowns from `at` on, of numbers that count with a weight.
    #[inline(always)]
    pub fn new(at: usize, by: Matrix<Z, N>, weight: &Matrix<Z, Z>) -> Self {
        let weighted = std::array::from_fn(|r| std::array::from_fn(|c| (0..Z).map(|z| by[z][r] * weight[z][c]).sum()));
        Self { at, by, weighted }
    }

    /// (Jᵀ W)_r times a column of another block of the same numbers.
    #[inline(always)]
    fn times<const M: usize>(&self, r: usize, other: &Block<Z, M>, c: usize) -> f64 {
        (0..Z).map(|z| self.weighted[r][z] * other.by[z][c]).sum()
    }
}

impl Equations {
    /// With places for poses in a chain, for landmarks with the poses that saw each, in their order, and for unknowns at the
    /// border, which all landmarks and the poses `touched` may go with.
    pub fn new<S>(poses: usize, seen_from: impl Iterator<Item = S>, (border, touched): (usize, &[usize])) -> Self
    where
        S: Iterator<Item = usize> + Clone,
    {
        let mut upper = UpperTriangle::of_chain::<3, 3, 2>(poses, seen_from);
        let first = upper.size();
        for column in first..first + border {
            upper.rows.extend(touched.iter().flat_map(|pose| 3 * pose..3 * pose + 3));
            upper.rows.extend(3 * poses..=column);
            upper.column_starts.push(upper.rows.len());
        }
        upper.values = vec![0.0; upper.rows.len()];
        Self { descent: vec![0.0; upper.size()], upper, border: first }
    }

    /// Nothing is known any more.
    pub fn clear(&mut self) {
        self.upper.values.fill(0.0);
        self.descent.fill(0.0);
    }

    /// Adds what numbers that are so far off say of the unknowns of one block: ½ (ν − J δ)ᵀ W (ν − J δ).
    #[inline(always)]
    pub fn add<const Z: usize, const N: usize>(&mut self, block: &Block<Z, N>, innovation: &[f64; Z]) {
        for c in 0..N {
            let end = self.upper.column_starts[block.at + c + 1];
            for r in 0..=c {
                self.upper.values[end - 1 - c + r] += block.times(r, block, c);
            }
            self.descent[block.at + c] += (0..Z).map(|z| block.weighted[c][z] * innovation[z]).sum::<f64>();
        }
    }

    /// Adds what the same numbers say of two blocks together; the unknowns of the first come first.
    #[inline(always)]
    pub fn add_between<const Z: usize, const A: usize, const B: usize>(
        &mut self,
        first: &Block<Z, A>,
        second: &Block<Z, B>,
    ) {
        // What stands above a block is the same in all of its columns.
        let place = self.place(first.at, second.at);
        for c in 0..B {
            let start = self.upper.column_starts[second.at + c] + place;
            for r in 0..A {
                self.upper.values[start + r] += first.times(r, second, c);
            }
        }
    }

    /// Where a row stands in a column, from its start.
    #[inline(always)]
    fn place(&self, row: usize, column: usize) -> usize {
        let (start, end) = (self.upper.column_starts[column], self.upper.column_starts[column + 1]);
        if row >= self.border {
            return end - start - 1 - (column - row);
        }
        self.upper.rows[start..end].partition_point(|known| *known < row)
    }

    /// Adds what is known of one unknown: a precision, and how strongly it pulls.
    pub fn add_known(&mut self, column: usize, precision: f64, pull: f64) {
        self.upper.values[self.upper.column_starts[column + 1] - 1] += precision;
        self.descent[column] += pull;
    }

    /// Adds what is known of two unknowns that stand together: precision (xx, xy, yy) and pull (x, y).
    pub fn add_known_pair(&mut self, own: usize, [xx, xy, yy, pull_x, pull_y]: [f64; 5]) {
        self.add_known(own, xx, pull_x);
        self.add_known(own + 1, yy, pull_y);
        self.upper.values[self.upper.column_starts[own + 2] - 2] += xy;
    }

    /// Adds a motion that led to a pose of the chain, from the one before it, or for the first from where it stood.
    pub fn add_motion(&mut self, pose: usize, [before, after]: [Pose; 2], motion: &MotionGaussian) {
        let (residual, by_before, by_after) = motion_residual(before, after, motion.mean);
        let (weight, innovation) = (precision(motion.covariance), residual.map(|r| -r));
        let own = Block::new(3 * pose, by_after, &weight);
        self.add(&own, &innovation);
        if pose > 0 {
            let former = Block::new(3 * (pose - 1), by_before, &weight);
            self.add(&former, &innovation);
            self.add_between(&former, &own);
        }
    }
}

/// Minus the logarithm of the density of a motion, up to a constant.
pub(crate) fn motion_cost([before, after]: [Pose; 2], motion: &MotionGaussian) -> f64 {
    let (residual, ..) = motion_residual(before, after, motion.mean);
    let weighted = precision(motion.covariance).map(|row| (0..3).map(|k| row[k] * residual[k]).sum::<f64>());
    0.5 * (0..3).map(|i| weighted[i] * residual[i]).sum::<f64>()
}

/// How far a motion is from what the odometry says, in the frame of its start, with the derivatives by both poses.
pub(crate) fn motion_residual(before: Pose, after: Pose, expected: Pose) -> ([f64; 3], Matrix3, Matrix3) {
    let (s, c) = math::sin_cos(before.heading);
    let (dx, dy) = (after.x - before.x, after.y - before.y);
    let (forward, left) = (c * dx + s * dy, c * dy - s * dx);
    let turn = math::wrap_angle(after.heading - before.heading - expected.heading);
    let residual = [forward - expected.x, left - expected.y, turn];
    let by_after = [[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]];
    let by_before = [[-c, -s, left], [s, -c, -forward], [0.0, 0.0, -1.0]];
    (residual, by_before, by_after)
}

/// The precision of a motion in the frame of its start.
fn precision(mut p: Matrix3) -> Matrix3 {
    (0..3).for_each(|i| p[i][i] += LEAST_VARIANCE[i]);
    let minor = |a: usize, b: usize, c: usize, d: usize| p[a][b] * p[c][d] - p[a][d] * p[c][b];
    let adjugate = [
        [minor(1, 1, 2, 2), -minor(0, 1, 2, 2), minor(0, 1, 1, 2)],
        [-minor(1, 0, 2, 2), minor(0, 0, 2, 2), -minor(0, 0, 1, 2)],
        [minor(1, 0, 2, 1), -minor(0, 0, 2, 1), minor(0, 0, 1, 1)],
    ];
    let determinant = p[0][0] * adjugate[0][0] + p[0][1] * adjugate[1][0] + p[0][2] * adjugate[2][0];
    adjugate.map(|row| row.map(|v| v / determinant))
}
