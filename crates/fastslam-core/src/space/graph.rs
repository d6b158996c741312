//! Least squares over the whole path and all landmarks: Gauss–Newton over right perturbations.

use super::look::{Eye, Look, Stand};
use super::past::{Heard, Past};
use super::pose::{series, SpacePose, Twist};
use super::sensor::Spatial;
use crate::normal::{product, Cholesky, Matrix};
use crate::smoothing::{Factor, UpperTriangle};

/// Steps at most.
const STEPS: usize = 30;
/// How often a step that makes things worse is shortened.
const SHORTENED: usize = 8;

/// Poses of all scans, and all landmarks.
#[derive(Clone, Debug, Default)]
pub struct Guess {
    /// `T_world_robot`.
    pub poses: Vec<SpacePose>,
    /// In the world, metres.
    pub landmarks: Vec<[f64; 3]>,
}

/// What is to be explained, and by whom.
pub struct Problem<'a, M> {
    /// Sensor.
    pub eye: Eye<'a, M>,
    /// Where the path starts.
    pub start: SpacePose,
    /// What happened.
    pub past: &'a Past,
}

/// The most probable path and map, with the precision about them.
pub struct Solution {
    /// The mode.
    pub at: Guess,
    /// Its factor.
    pub factor: Factor,
    /// The precision: six variables per pose, then three per landmark.
    pub precision: UpperTriangle,
    /// Sum of squared residuals over their variances.
    pub cost: f64,
}

/// The normal equations at a guess.
struct Equations {
    precision: UpperTriangle,
    vector: Vec<f64>,
    /// By sighting: which of its landmark's poses its own is.
    rank: Vec<usize>,
    poses: usize,
}

impl Equations {
    fn of(past: &Past, landmarks: usize) -> Self {
        let mut seen_from: Vec<Vec<usize>> = vec![Vec::new(); landmarks];
        let mut rank = Vec::with_capacity(past.sightings.len());
        for heard in &past.sightings {
            let (poses, pose) = (&mut seen_from[heard.slot as usize], heard.scan as usize);
            if poses.last() != Some(&pose) {
                poses.push(pose);
            }
            rank.push(poses.len() - 1);
        }
        let poses = past.scans.len();
        let precision = UpperTriangle::of_chain::<6, 3>(poses, seen_from.iter().map(|poses| poses.iter().copied()));
        let vector = vec![0.0; precision.column_starts.len() - 1];
        Self { precision, vector, rank, poses }
    }

    fn clear(&mut self) {
        self.precision.values.fill(0.0);
        self.vector.fill(0.0);
    }

    /// Adds Jᵀ Ω J to a triangle that starts so far down the columns from `first` on.
    fn add_own<const N: usize>(&mut self, first: usize, above: usize, block: &Matrix<N, N>) {
        for c in 0..N {
            let start = self.precision.column_starts[first + c] + above;
            for r in 0..=c {
                self.precision.values[start + r] += block[r][c];
            }
        }
    }

    /// Adds a block of other variables to columns, so far down.
    fn add_above<const A: usize, const N: usize>(&mut self, first: usize, above: usize, block: &Matrix<A, N>) {
        for c in 0..N {
            let start = self.precision.column_starts[first + c] + above;
            for r in 0..A {
                self.precision.values[start + r] += block[r][c];
            }
        }
    }

    /// Adds −Jᵀ Ω e.
    fn push<const N: usize>(&mut self, first: usize, pull: [f64; N]) {
        (0..N).for_each(|i| self.vector[first + i] += pull[i]);
    }

    /// Residual e = log(M⁻¹ T_a⁻¹ T_b) of motion number `index`, with J_b = J_r⁻¹(e) and J_a = −J_b Ad(T_b⁻¹ T_a).
    fn add_motion(&mut self, index: usize, step: SpacePose, residual: &Twist, information: &Matrix<6, 6>) {
        let by_end = series(residual, 0.5, 1.0 / 12.0);
        let weighted = product(&transposed(&by_end), information);
        let above = if index == 0 { 0 } else { 6 };
        self.add_own(6 * index, above, &product(&weighted, &by_end));
        self.push(6 * index, negative(&weighted, residual));
        if index > 0 {
            let carried = product(&by_end, &step.inverse().adjoint());
            let by_begin = carried.map(|row| row.map(|v| -v));
            let weighted = product(&transposed(&by_begin), information);
            let own = if index == 1 { 0 } else { 6 };
            self.add_own(6 * (index - 1), own, &product(&weighted, &by_begin));
            self.add_above(6 * index, 0, &product(&weighted, &by_end));
            self.push(6 * (index - 1), negative(&weighted, residual));
        }
    }

    fn add_look(&mut self, index: usize, (pose, landmark): (usize, usize), look: &Look<f64>, noise: &Matrix<3, 3>) {
        let above = if pose == 0 { 0 } else { 6 };
        let own = 6 * self.poses + 3 * landmark;
        let weighted = product(&transposed(&look.by_pose), noise);
        self.add_own(6 * pose, above, &product(&weighted, &look.by_pose));
        self.push(6 * pose, pull(&weighted, &look.innovation));
        self.add_above(own, 6 * self.rank[index], &product(&weighted, &look.by_landmark));
        let weighted = product(&transposed(&look.by_landmark), noise);
        let columns = self.precision.column_starts[own + 1] - self.precision.column_starts[own] - 1;
        self.add_own(own, columns, &product(&weighted, &look.by_landmark));
        self.push(own, pull(&weighted, &look.innovation));
    }
}

fn transposed<const A: usize, const B: usize>(a: &Matrix<A, B>) -> Matrix<B, A> {
    std::array::from_fn(|j| std::array::from_fn(|i| a[i][j]))
}

fn pull<const A: usize, const B: usize>(a: &Matrix<A, B>, v: &[f64; B]) -> [f64; A] {
    a.map(|row| (0..B).map(|k| row[k] * v[k]).sum())
}

fn negative<const A: usize, const B: usize>(a: &Matrix<A, B>, v: &[f64; B]) -> [f64; A] {
    pull(a, v).map(|x| -x)
}

impl<M: Spatial> Problem<'_, M> {
    /// The most probable path and map near a guess. `None` where the equations have no solution.
    ///
    /// `close_enough` is the fall of χ² below which it stops.
    pub fn solve(&self, guess: Guess, close_enough: f64) -> Option<Solution> {
        let mut equations = Equations::of(self.past, guess.landmarks.len());
        let mut factor = Factor::of_structure(&equations.precision)?;
        let mut at = guess;
        let mut cost = self.cost(&at)?;
        for _ in 0..STEPS {
            self.fill(&mut equations, &at)?;
            if !factor.factorize(&equations.precision) {
                return None;
            }
            let step = factor.solve(&equations.vector);
            let Some((next, less)) = self.improved(&at, &step, cost) else { break };
            let fallen = cost - less;
            (at, cost) = (next, less);
            if fallen < close_enough {
                break;
            }
        }
        Some(Solution { at, factor, precision: equations.precision, cost })
    }

    /// The guess after a step that is shortened until it helps; `None` where it does not.
    fn improved(&self, at: &Guess, step: &[f64], cost: f64) -> Option<(Guess, f64)> {
        let mut share = 1.0;
        for _ in 0..SHORTENED {
            let next = moved(at, step, share);
            if let Some(less) = self.cost(&next).filter(|less| *less <= cost) {
                return Some((next, less));
            }
            share *= 0.5;
        }
        None
    }

    /// log(M⁻¹ T_a⁻¹ T_b) and T_a⁻¹ T_b of motion number `index`.
    fn residual(&self, at: &Guess, index: usize) -> (Twist, SpacePose) {
        let before = index.checked_sub(1).map_or(self.start, |before| at.poses[before]);
        let step = before.inverse().compose(at.poses[index]);
        (self.past.scans[index].motion.inverse().compose(step).log(), step)
    }

    /// A sighting's residual; `None` where the sensor could not have seen the landmark, behind a camera for one.
    fn innovation(&self, at: &Guess, heard: &Heard) -> Option<[f64; 3]> {
        let (stand, landmark) = (Stand::from(at.poses[heard.scan as usize]), at.landmarks[heard.slot as usize]);
        let look = || self.eye.look(&stand, landmark, heard.measured.value).innovation;
        self.eye.sees(&stand, landmark).then(look)
    }

    /// Adds the squared residuals of a path and map, each over its variance, by axis of the motion and number of the sensor;
    /// false, and nothing added, where a sighting could not have been.
    pub fn add_ratios(&self, at: &Guess, sums: &mut ([f64; 6], [f64; 3])) -> bool {
        let looks: Option<Vec<_>> = self.past.sightings.iter().map(|heard| self.innovation(at, heard)).collect();
        let widths = self.past.scans.iter().map(|scan| Cholesky::of(&scan.information).map(|factor| factor.inverse()));
        let (Some(looks), Some(widths)) = (looks, widths.collect::<Option<Vec<_>>>()) else { return false };
        for (index, width) in widths.iter().enumerate() {
            let residual = self.residual(at, index).0;
            (0..6).for_each(|i| sums.0[i] += residual[i] * residual[i] / width[i][i]);
        }
        for (innovation, heard) in looks.iter().zip(&self.past.sightings) {
            (0..3).for_each(|i| sums.1[i] += innovation[i] * innovation[i] / heard.measured.noise[i][i]);
        }
        true
    }

    /// χ²; `None` where a sighting could not have been.
    fn cost(&self, at: &Guess) -> Option<f64> {
        let mut sum = 0.0;
        for (index, scan) in self.past.scans.iter().enumerate() {
            let residual = self.residual(at, index).0;
            sum += square(&residual, &scan.information);
        }
        for heard in &self.past.sightings {
            let whitened = Cholesky::of(&heard.measured.noise)?.whitened(&self.innovation(at, heard)?);
            sum += whitened.iter().map(|v| v * v).sum::<f64>();
        }
        sum.is_finite().then_some(sum)
    }

    fn fill(&self, equations: &mut Equations, at: &Guess) -> Option<()> {
        equations.clear();
        for (index, scan) in self.past.scans.iter().enumerate() {
            let (residual, step) = self.residual(at, index);
            equations.add_motion(index, step, &residual, &scan.information);
        }
        for (index, heard) in self.past.sightings.iter().enumerate() {
            let (pose, landmark) = (heard.scan as usize, heard.slot as usize);
            let stand = Stand::from(at.poses[pose]);
            let look = self.eye.look(&stand, at.landmarks[landmark], heard.measured.value);
            let information = Cholesky::of(&heard.measured.noise)?.inverse();
            equations.add_look(index, (pose, landmark), &look, &information);
        }
        Some(())
    }
}

fn square(v: &Twist, information: &Matrix<6, 6>) -> f64 {
    (0..6).map(|i| v[i] * (0..6).map(|j| information[i][j] * v[j]).sum::<f64>()).sum()
}

/// Path and map after a part of a step in all variables.
pub fn moved(at: &Guess, step: &[f64], share: f64) -> Guess {
    let (turns, shifts) = step.split_at(6 * at.poses.len());
    let poses = at.poses.iter().zip(turns.chunks(6));
    let landmarks = at.landmarks.iter().zip(shifts.chunks(3));
    Guess {
        poses: poses.map(|(pose, d)| pose.compose(SpacePose::exp(std::array::from_fn(|i| share * d[i])))).collect(),
        landmarks: landmarks.map(|(m, d)| std::array::from_fn(|i| m[i] + share * d[i])).collect(),
    }
}

impl Solution {
    /// The covariance of a landmark.
    pub fn landmark_covariance(&self, landmark: usize) -> Matrix<3, 3> {
        let first = 6 * self.at.poses.len() + 3 * landmark;
        let covariance = self.factor.covariance(&[first, first + 1, first + 2]);
        std::array::from_fn(|i| std::array::from_fn(|j| 0.5 * (covariance[i][j] + covariance[j][i])))
    }

    /// The covariance of the newest pose: of ξ in `T Exp(ξ)`.
    pub fn newest_covariance(&self) -> Matrix<6, 6> {
        let first = 6 * self.at.poses.len().saturating_sub(1);
        let covariance = self.factor.covariance(&std::array::from_fn::<usize, 6, _>(|i| first + i));
        std::array::from_fn(|i| std::array::from_fn(|j| 0.5 * (covariance[i][j] + covariance[j][i])))
    }
}
