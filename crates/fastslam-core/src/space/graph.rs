//! Least squares over the whole path and all landmarks: Gauss–Newton over right perturbations.

use super::look::{Eye, Look, Stand};
use super::past::{Heard, Past};
use super::pose::{series, SpacePose, Twist};
use super::sensor::Spatial;
use super::wander::Leg;
use crate::normal::{product, Cholesky, Matrix};
use crate::smoothing::{Factor, UpperTriangle};
use serde::{Deserialize, Serialize};

/// Steps at most.
const STEPS: usize = 30;
/// How often a step that makes things worse is shortened.
const SHORTENED: usize = 8;

/// Poses of all scans, and all landmarks.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Guess {
    /// `T_world_robot`.
    pub poses: Vec<SpacePose>,
    /// In the robot's axes at the scans, where they wander; otherwise none.
    pub velocities: Vec<Twist>,
    /// In the world, metres.
    pub landmarks: Vec<[f64; 3]>,
}

impl Guess {
    /// Variables of a scan: its pose, and its velocity where there is one.
    pub fn node(&self) -> usize {
        if self.velocities.is_empty() {
            6
        } else {
            12
        }
    }

    /// The first variable of a landmark.
    pub fn first_of(&self, landmark: usize) -> usize {
        self.node() * self.poses.len() + 3 * landmark
    }
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
    /// The precision: [`Guess::node`] variables per scan, then three per landmark.
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
    node: usize,
}

impl Equations {
    fn of(past: &Past, at: &Guess) -> Self {
        let mut seen_from: Vec<Vec<usize>> = vec![Vec::new(); at.landmarks.len()];
        let mut rank = Vec::with_capacity(past.sightings.len());
        for heard in &past.sightings {
            let (poses, pose) = (&mut seen_from[heard.slot as usize], heard.scan as usize);
            if poses.last() != Some(&pose) {
                poses.push(pose);
            }
            rank.push(poses.len() - 1);
        }
        let (poses, node) = (past.scans.len(), at.node());
        let seen_from = seen_from.iter().map(|poses| poses.iter().copied());
        let precision = match node {
            6 => UpperTriangle::of_chain::<6, 6, 3>(poses, seen_from),
            _ => UpperTriangle::of_chain::<12, 6, 3>(poses, seen_from),
        };
        let vector = vec![0.0; precision.column_starts.len() - 1];
        Self { precision, vector, rank, poses, node }
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

    /// Adds what a residual between the scan before and scan `index` says, with its derivatives by both.
    fn add_step<const P: usize>(
        &mut self,
        index: usize,
        (residual, information): (&[f64; P], &Matrix<P, P>),
        (by_begin, by_end): (&Matrix<P, P>, &Matrix<P, P>),
    ) {
        let weighted = product(&transposed(by_end), information);
        let above = if index == 0 { 0 } else { P };
        self.add_own(P * index, above, &product(&weighted, by_end));
        self.push(P * index, negative(&weighted, residual));
        if index > 0 {
            let weighted = product(&transposed(by_begin), information);
            let own = if index == 1 { 0 } else { P };
            self.add_own(P * (index - 1), own, &product(&weighted, by_begin));
            self.add_above(P * index, 0, &product(&weighted, by_end));
            self.push(P * (index - 1), negative(&weighted, residual));
        }
    }

    fn add_look(&mut self, index: usize, (pose, landmark): (usize, usize), look: &Look<f64>, noise: &Matrix<3, 3>) {
        let above = if pose == 0 { 0 } else { self.node };
        let own = self.node * self.poses + 3 * landmark;
        let weighted = product(&transposed(&look.by_pose), noise);
        self.add_own(self.node * pose, above, &product(&weighted, &look.by_pose));
        self.push(self.node * pose, pull(&weighted, &look.innovation));
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
        let mut equations = Equations::of(self.past, &guess);
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

    /// (n₁, n₂) and T_a⁻¹ T_b of leg number `index`.
    fn wandered(&self, at: &Guess, index: usize, leg: &Leg) -> ([f64; 12], SpacePose) {
        let before = index.checked_sub(1).map_or((self.start, &[0.0; 6]), |k| (at.poses[k], &at.velocities[k]));
        leg.residual(before, (at.poses[index], &at.velocities[index]))
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
            if let Some(leg) = &self.past.scans[index].leg {
                let (squared, numbers) = (leg.squared(&self.wandered(at, index, leg).0), leg.numbers());
                (0..6).for_each(|i| sums.0[i] += squared[i] / numbers[i]);
                continue;
            }
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
            sum += match &scan.leg {
                Some(leg) => leg.squared(&self.wandered(at, index, leg).0).iter().sum(),
                None => square(&self.residual(at, index).0, &scan.information),
            };
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
            if let Some(leg) = &scan.leg {
                let (residual, step) = self.wandered(at, index, leg);
                let [by_begin, by_end, information] = leg.linearized(step);
                equations.add_step(index, (&residual, &information), (&by_begin, &by_end));
                continue;
            }
            let (residual, step) = self.residual(at, index);
            let (by_begin, by_end) = by_ends(&residual, step);
            equations.add_step(index, (&residual, &scan.information), (&by_begin, &by_end));
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

/// J_a = −J_b Ad(T_b⁻¹ T_a) and J_b = J_r⁻¹(e) of the residual e = log(M⁻¹ T_a⁻¹ T_b).
fn by_ends(residual: &Twist, step: SpacePose) -> (Matrix<6, 6>, Matrix<6, 6>) {
    let by_end = series(residual, 0.5, 1.0 / 12.0);
    let carried = product(&by_end, &step.inverse().adjoint());
    (carried.map(|row| row.map(|v| -v)), by_end)
}

fn square(v: &Twist, information: &Matrix<6, 6>) -> f64 {
    (0..6).map(|i| v[i] * (0..6).map(|j| information[i][j] * v[j]).sum::<f64>()).sum()
}

/// Rows of the six motions of a point: shifts, and turns about a middle.
fn motions_of(point: &[f64; 3], middle: &[f64; 3]) -> [[f64; 6]; 3] {
    let [x, y, z] = std::array::from_fn(|i| point[i] - middle[i]);
    [[1.0, 0.0, 0.0, 0.0, z, -y], [0.0, 1.0, 0.0, -z, 0.0, x], [0.0, 0.0, 1.0, y, -x, 0.0]]
}

/// Path and map after a part of a step in all variables.
pub fn moved(at: &Guess, step: &[f64], share: f64) -> Guess {
    let node = at.node();
    let (scans, shifts) = step.split_at(at.first_of(0));
    let poses = at.poses.iter().zip(scans.chunks(node));
    let velocities = at.velocities.iter().zip(scans.chunks(node));
    let landmarks = at.landmarks.iter().zip(shifts.chunks(3));
    Guess {
        poses: poses.map(|(pose, d)| pose.compose(SpacePose::exp(std::array::from_fn(|i| share * d[i])))).collect(),
        velocities: velocities.map(|(v, d)| std::array::from_fn(|i| v[i] + share * d[6 + i])).collect(),
        landmarks: landmarks.map(|(m, d)| std::array::from_fn(|i| m[i] + share * d[i])).collect(),
    }
}

impl Solution {
    /// The covariance of a landmark.
    pub fn landmark_covariance(&self, landmark: usize) -> Matrix<3, 3> {
        let first = self.at.first_of(landmark);
        let covariance = self.factor.covariance(&[first, first + 1, first + 2]);
        std::array::from_fn(|i| std::array::from_fn(|j| 0.5 * (covariance[i][j] + covariance[j][i])))
    }

    /// How surely landmarks lie where they do to each other: the root of the mean variance of their places, metres, but for
    /// what a motion of all of them together makes. `None` where they lie on a line, or there is none.
    ///
    /// With B the six motions, tr Σ − tr (Bᵀ B)⁻¹ Bᵀ Σ B.
    pub fn shape_std_m(&self) -> Option<f64> {
        let places = &self.at.landmarks;
        let (first, count) = (self.at.first_of(0), places.len());
        let covariance = self.factor.covariance(&(first..first + 3 * count).collect::<Vec<usize>>());
        let middle: [f64; 3] = std::array::from_fn(|i| places.iter().map(|p| p[i]).sum::<f64>() / count as f64);
        let motions: Vec<[f64; 6]> = places.iter().flat_map(|p| motions_of(p, &middle)).collect();
        let (mut own, mut moved, mut total) = ([[0.0; 6]; 6], [[0.0; 6]; 6], 0.0);
        for (r, by_row) in motions.iter().enumerate() {
            total += covariance[r][r];
            let mut carried = [0.0; 6];
            motions.iter().zip(&covariance[r]).for_each(|(by, v)| (0..6).for_each(|j| carried[j] += v * by[j]));
            for i in 0..6 {
                for j in 0..6 {
                    own[i][j] += by_row[i] * by_row[j];
                    moved[i][j] += by_row[i] * carried[j];
                }
            }
        }
        let factor = Cholesky::of(&own)?;
        let together: f64 = (0..6).map(|j| factor.solve(&std::array::from_fn(|i| moved[i][j]))[j]).sum();
        Some((0.0_f64.max(total - together) / count as f64).sqrt())
    }

    /// The covariance of the newest pose: of ξ in `T Exp(ξ)`.
    pub fn newest_covariance(&self) -> Matrix<6, 6> {
        let first = self.at.node() * self.at.poses.len().saturating_sub(1);
        let covariance = self.factor.covariance(&std::array::from_fn::<usize, 6, _>(|i| first + i));
        std::array::from_fn(|i| std::array::from_fn(|j| 0.5 * (covariance[i][j] + covariance[j][i])))
    }
}

#[cfg(test)]
mod tests {
    use super::super::look::Seat;
    use super::super::map::Measured;
    use super::super::motion::SpaceMotion;
    use super::super::sensor::Point;
    use super::super::settings::{SpaceMotionKind, SpaceMotionNoise};
    use super::super::wander::{variances, Ahead};
    use super::*;

    const LANDMARKS: [[f64; 3]; 4] = [[3.0, 1.0, 0.5], [2.5, -1.5, 0.2], [4.0, 0.3, -1.0], [3.5, 2.0, 1.0]];
    const NOISE: Matrix<3, 3> = [[0.01, 0.002, 0.0], [0.002, 0.02, 0.0], [0.0, 0.0, 0.015]];

    /// Five scans of a robot that turns a little, all sightings off by something.
    fn past(kind: SpaceMotionKind) -> Past {
        let noise = SpaceMotionNoise { kind, ..SpaceMotionNoise::default() };
        let (mut past, mut pose) = (Past::default(), SpacePose::default());
        for number in 0..5 {
            let dt_s = if number == 0 { 0.0 } else { 0.1 + 0.03 * f64::from(number) };
            let rates = [0.0, 0.0, 0.0, 0.1, -0.2, 0.3];
            let measured = SpaceMotion::of(&noise, rates, dt_s).unwrap();
            let ahead = Ahead::of(&noise, &variances(&noise), (dt_s, &measured), number == 0);
            past.push(f64::from(number), &measured, Some(ahead.leg)).unwrap();
            pose = pose.compose(SpacePose::exp([0.4, 0.05, -0.02, 0.1, -0.2, 0.3].map(|v| v * dt_s)));
            for (slot, landmark) in LANDMARKS.iter().enumerate() {
                let mut value = pose.inverse().transform(*landmark);
                (0..3).for_each(|i| value[i] += 0.05 * (1.3 * (number as f64) + 2.1 * (slot + 3 * i) as f64).sin());
                let measured = Measured { value, noise: NOISE };
                past.sightings.push(Heard { scan: number as u32, slot: slot as u32, measured });
            }
        }
        past
    }

    /// All residuals over their roots of variance.
    fn whitened(problem: &Problem<'_, Point>, at: &Guess) -> Vec<f64> {
        let mut out = Vec::new();
        for (index, scan) in problem.past.scans.iter().enumerate() {
            let leg = scan.leg.as_ref().unwrap();
            let residual = problem.wandered(at, index, leg).0;
            for i in 0..6 {
                // The root of [a, b; b, c].
                let [a, b, c] = leg.information[i];
                out.push(a.sqrt() * residual[i] + b / a.sqrt() * residual[6 + i]);
                out.push((c - b * b / a).sqrt() * residual[6 + i]);
            }
        }
        for heard in &problem.past.sightings {
            let factor = Cholesky::of(&heard.measured.noise).unwrap();
            out.extend(factor.whitened(&problem.innovation(at, heard).unwrap()));
        }
        out
    }

    /// A⁻¹ by Gauss and Jordan.
    fn inverted(mut a: Vec<Vec<f64>>) -> Vec<Vec<f64>> {
        let n = a.len();
        a.iter_mut().enumerate().for_each(|(i, row)| row.extend((0..n).map(|k| f64::from(u8::from(i == k)))));
        for i in 0..n {
            let pivot = a[i][i];
            a[i].iter_mut().for_each(|v| *v /= pivot);
            let own = a[i].clone();
            for (_, row) in a.iter_mut().enumerate().filter(|(k, _)| *k != i) {
                let share = row[i];
                row.iter_mut().zip(&own).for_each(|(v, o)| *v -= share * o);
            }
        }
        a.into_iter().map(|row| row[n..].to_vec()).collect()
    }

    #[test]
    fn a_path_with_velocities_is_that_of_dense_least_squares() {
        for kind in [SpaceMotionKind::Gyro, SpaceMotionKind::Wandering] {
            let (past, seat) = (past(kind), Seat::new(SpacePose::default()));
            let model = Point { position_std_m: [0.1; 3] };
            let start = SpacePose::default();
            let problem = Problem { eye: Eye { model: &model, seat: &seat }, start, past: &past };
            let guess = Guess { poses: vec![start; 5], velocities: vec![[0.0; 6]; 5], landmarks: LANDMARKS.to_vec() };
            let solution = problem.solve(guess, 1e-12).unwrap();
            let count = solution.at.first_of(LANDMARKS.len());
            let (h, at) = (1e-6, &solution.at);
            let nudged = |k: usize, by: f64| {
                let step: Vec<f64> = (0..count).map(|i| if i == k { by } else { 0.0 }).collect();
                whitened(&problem, &moved(at, &step, 1.0))
            };
            let column = |k: usize| -> Vec<f64> {
                nudged(k, h).iter().zip(nudged(k, -h)).map(|(up, down)| (up - down) / (2.0 * h)).collect()
            };
            let jacobian: Vec<Vec<f64>> = (0..count).map(column).collect();
            let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
            let normal: Vec<Vec<f64>> = jacobian.iter().map(|a| jacobian.iter().map(|b| dot(a, b)).collect()).collect();
            let covariance = inverted(normal);
            // What the dense equations would still move the solution by, in parts of its standard deviations.
            let residual = whitened(&problem, at);
            let pull: Vec<f64> = jacobian.iter().map(|column| -dot(column, &residual)).collect();
            for (row, own) in covariance.iter().zip(0..) {
                assert!(dot(row, &pull).abs() < 1e-3 * row[own].sqrt(), "{kind:?} {own}: {}", dot(row, &pull));
            }
            let newest = solution.newest_covariance();
            let (first, landmark) = (at.node() * 4, at.first_of(2));
            for i in 0..6 {
                let (got, expected) = (newest[i][i], covariance[first + i][first + i]);
                assert!((got / expected - 1.0).abs() < 1e-3, "{kind:?} {i}: {got} {expected}");
            }
            // The first pose is held, so that of a shape as wide as this one all else is small; with no motion taken out it
            // would be the mean of the landmarks' own variances.
            let shape = solution.shape_std_m().unwrap();
            let trace: f64 = (at.first_of(0)..count).map(|i| covariance[i][i]).sum();
            assert!(shape > 0.02 && shape * shape < 0.5 * trace / 4.0, "{kind:?}: {shape}, {trace}");
            let found = solution.landmark_covariance(2);
            assert!((0..3).all(|i| (found[i][i] / covariance[landmark + i][landmark + i] - 1.0).abs() < 1e-3));
        }
    }
}
