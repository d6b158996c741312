//! The posterior over the whole path, the landmarks that are placed, and the sensor's calibration, as least squares.
//!
//! Unknowns are ordered poses first: (x, y, heading) of every step, then (x, y) of every landmark, then scale and bias
//! of the sensor where they are not known. Gauss–Newton with the sparse factor of [`crate::smoothing`].

use super::past::{Heard, Past};
use super::sensing::{Calibration, Look, Request, Sensing};
use crate::belief::by_robot_pose;
use crate::error::Result;
use crate::geometry::Pose;
use crate::math;
use crate::normal::{product, scaled, Cholesky, Matrix};
use crate::smoothing::{motion_cost, Block, Equations, Factor};

/// Iterations at most.
const ITERATIONS: usize = 15;
/// An undamped step that moves nothing by more than this (m, rad) is the last.
const SMALL_STEP: f64 = 1e-3;
/// With so many columns at the border the order of time is the best there is; with more, a search for one pays.
const WIDEST_BORDER: usize = 60;
/// Damping of the steps, relative to the diagonal, until one leads downhill.
const DAMPING: [f64; 4] = [0.0, 1e-3, 1e-1, 1e1];

/// What is known of the calibration beforehand: its likeliest value, and standard deviations of scale and bias; 0 where
/// it is known.
#[derive(Clone, Copy, Debug)]
pub(super) struct Prior {
    pub mean: Calibration,
    pub std: [f64; 2],
}

impl Prior {
    /// Which of scale and bias are unknown.
    pub fn free(&self) -> &'static [usize] {
        match self.std.map(|std| std > 0.0) {
            [true, true] => &[0, 1],
            [true, false] => &[0],
            [false, true] => &[1],
            [false, false] => &[],
        }
    }
}

/// What is to be explained, and by which models.
pub(super) struct Graph<'a, S: ?Sized> {
    pub past: &'a Past,
    pub sensor: &'a S,
    pub T_robot_sensor: Pose,
    pub start: Pose,
    pub likelihood_exponent: f64,
    pub prior: Prior,
    /// For every slot, the landmark's number among those of the graph.
    pub number_of: Vec<Option<usize>>,
}

/// A path with landmarks and calibration.
#[derive(Clone, Debug)]
pub(super) struct Solution {
    pub poses: Vec<Pose>,
    pub landmarks: Vec<[f64; 2]>,
    pub calibration: Calibration,
}

/// The likeliest solution, and the posterior about it.
pub(super) struct Mode {
    pub solution: Solution,
    pub factor: Factor,
    /// Minus the logarithm of the posterior there, up to a constant.
    pub cost: f64,
    /// What the sightings say of each landmark alone, given all else.
    pub information: Vec<Matrix<2, 2>>,
}

/// A sighting as the graph sees it.
struct Seen<const Z: usize> {
    step: usize,
    landmark: usize,
    heard: Heard<Z>,
}

/// A linearised problem.
struct System {
    equations: Equations,
    /// What the sightings say of each landmark alone.
    information: Vec<Matrix<2, 2>>,
}

impl<S: ?Sized> Graph<'_, S> {
    fn seen<const Z: usize>(&self) -> Vec<Seen<Z>> {
        let of = |kept: &super::past::Kept| {
            let heard = kept.heard();
            Some(Seen { step: kept.step as usize, landmark: (*self.number_of.get(heard.slot)?)?, heard })
        };
        self.past.sightings.iter().filter_map(of).collect()
    }

    /// The mode near a first guess; `None` when no finite solution was found.
    ///
    /// **Errors:** those of a sensor of one's own.
    pub fn solve<const Z: usize>(&self, guess: Solution) -> Result<Option<Mode>>
    where
        S: Sensing<Z>,
    {
        let seen = self.seen::<Z>();
        let mut system = self.structure(&seen, guess.landmarks.len());
        let border = system.equations.descent.len() - 3 * self.past.steps();
        let factor = if border <= WIDEST_BORDER { Factor::in_order } else { Factor::of_structure };
        let Some(mut factor) = factor(&system.equations.upper) else { return Ok(None) };
        let mut solution = guess;
        let mut looks = self.look(&solution, &seen)?;
        let mut cost = self.cost(&solution, &seen, &looks);
        for _ in 0..ITERATIONS {
            self.linearize(&solution, (&seen, &looks), &mut system);
            let mut step_size = f64::INFINITY;
            for damping in DAMPING {
                system.equations.upper.scale_diagonal(1.0 + damping);
                if factor.factorize(&system.equations.upper) {
                    let step = factor.solve(&system.equations.descent);
                    let moved = self.moved(&solution, &step);
                    let new_looks = self.look(&moved, &seen)?;
                    let new_cost = self.cost(&moved, &seen, &new_looks);
                    if new_cost <= cost {
                        step_size = step.iter().fold(0.0, |most: f64, s| most.max(s.abs())) + damping;
                        (solution, looks, cost) = (moved, new_looks, new_cost);
                        break;
                    }
                }
                system.equations.upper.scale_diagonal(1.0 / (1.0 + damping));
            }
            if !(step_size.is_finite() && step_size >= SMALL_STEP) {
                break;
            }
        }
        self.linearize(&solution, (&seen, &looks), &mut system);
        let usable = cost.is_finite() && factor.factorize(&system.equations.upper);
        Ok(usable.then_some(Mode { solution, factor, cost, information: system.information }))
    }

    fn look<const Z: usize>(&self, solution: &Solution, seen: &[Seen<Z>]) -> Result<Vec<Look<Z>>>
    where
        S: Sensing<Z>,
    {
        let request = |one: &Seen<Z>| Request {
            T_world_sensor: solution.poses[one.step].compose(self.T_robot_sensor),
            landmark: solution.landmarks[one.landmark],
            measured: one.heard.measured,
            calibration: solution.calibration,
        };
        self.sensor.look(&seen.iter().map(request).collect::<Vec<_>>())
    }

    /// With places for all poses, for the landmarks by the poses that heard them, and for the calibration.
    fn structure<const Z: usize>(&self, seen: &[Seen<Z>], landmarks: usize) -> System {
        let mut hearing: Vec<Vec<usize>> = vec![Vec::new(); landmarks];
        seen.iter().for_each(|one| hearing[one.landmark].push(one.step));
        hearing.iter_mut().for_each(Vec::dedup);
        let mut all: Vec<usize> = seen.iter().map(|one| one.step).collect();
        all.dedup();
        let seen_from = hearing.iter().map(|steps| steps.iter().copied());
        let equations = Equations::new(self.past.steps(), seen_from, (self.prior.free().len(), &all));
        System { equations, information: vec![[[0.0; 2]; 2]; landmarks] }
    }

    /// The normal equations about a solution: what motions, sightings and the calibration's prior say.
    fn linearize<const Z: usize>(
        &self,
        solution: &Solution,
        (seen, looks): (&[Seen<Z>], &[Look<Z>]),
        system: &mut System,
    ) {
        system.equations.clear();
        system.information.fill([[0.0; 2]; 2]);
        for (step, motion) in self.past.motions.iter().enumerate() {
            system.equations.add_motion(step, self.ends(solution, step), motion);
        }
        for (one, look) in seen.iter().zip(looks) {
            self.add_sighting(solution, one, look, system);
        }
        for (place, parameter) in self.prior.free().iter().enumerate() {
            let weight = self.prior.std[*parameter].powi(-2);
            let pull = -weight * self.off_prior(solution)[*parameter];
            system.equations.add_known(self.first_parameter(solution) + place, weight, pull);
        }
    }

    /// Where a motion begins and ends: the first at the start.
    fn ends(&self, solution: &Solution, step: usize) -> [Pose; 2] {
        [step.checked_sub(1).map_or(self.start, |before| solution.poses[before]), solution.poses[step]]
    }

    /// A sighting ties a pose to a landmark, and both to the calibration where that is free.
    fn add_sighting<const Z: usize>(&self, solution: &Solution, one: &Seen<Z>, look: &Look<Z>, system: &mut System) {
        let Some((weight, _)) = self.weighed(one, look) else { return };
        let equations = &mut system.equations;
        let pose = Block::new(3 * one.step, self.by_pose(solution, one, look), &weight);
        let own = 3 * self.past.steps() + 2 * one.landmark;
        let landmark = Block::new(own, look.by_landmark, &weight);
        equations.add(&pose, &look.innovation);
        equations.add(&landmark, &look.innovation);
        equations.add_between(&pose, &landmark);
        let first = self.first_parameter(solution);
        let parameters = self.prior.free().iter().enumerate().map(|(place, parameter)| {
            let mut by = [[0.0]; Z];
            by[0] = [if *parameter == 0 { look.by_scale } else { 1.0 }];
            Block::new(first + place, by, &weight)
        });
        let parameters: Vec<Block<Z, 1>> = parameters.collect();
        for (place, parameter) in parameters.iter().enumerate() {
            equations.add(parameter, &look.innovation);
            equations.add_between(&pose, parameter);
            equations.add_between(&landmark, parameter);
            parameters[..place].iter().for_each(|before| equations.add_between(before, parameter));
        }
        let weighted = product(&weight, &look.by_landmark);
        let own: Matrix<2, 2> = std::array::from_fn(|a| {
            std::array::from_fn(|b| (0..Z).map(|z| look.by_landmark[z][a] * weighted[z][b]).sum())
        });
        let information = &mut system.information[one.landmark];
        *information = crate::normal::sum(information, &own);
    }

    /// The first variable of the calibration, behind those of poses and landmarks.
    fn first_parameter(&self, solution: &Solution) -> usize {
        3 * self.past.steps() + 2 * solution.landmarks.len()
    }

    /// How far the calibration is from what is known of it.
    fn off_prior(&self, solution: &Solution) -> [f64; 2] {
        let (found, known) = (solution.calibration, self.prior.mean);
        [found.scale - known.scale, found.bias - known.bias]
    }

    fn by_pose<const Z: usize>(&self, solution: &Solution, one: &Seen<Z>, look: &Look<Z>) -> Matrix<Z, 3> {
        let robot = solution.poses[one.step];
        by_robot_pose(look.by_pose, robot, robot.compose(self.T_robot_sensor))
    }

    /// The precision that a sighting counts with, and what it costs; `None` where it cannot be computed.
    fn weighed<const Z: usize>(&self, one: &Seen<Z>, look: &Look<Z>) -> Option<(Matrix<Z, Z>, f64)> {
        let noise = &one.heard.noise;
        let factor = Cholesky::of(&noise.covariance)?;
        let distance: f64 = factor.whitened(&look.innovation).iter().map(|v| v * v).sum();
        let loss = noise.tail.loss_of(Z, distance);
        let weight = self.likelihood_exponent / noise.tail.noise_scale_of(Z, distance);
        Some((scaled(&factor.inverse(), weight), self.likelihood_exponent * loss))
    }

    /// Minus the logarithm of the posterior, up to a constant; infinite where it is not finite.
    fn cost<const Z: usize>(&self, solution: &Solution, seen: &[Seen<Z>], looks: &[Look<Z>]) -> f64 {
        let mut cost = 0.0;
        for (step, motion) in self.past.motions.iter().enumerate() {
            cost += motion_cost(self.ends(solution, step), motion);
        }
        for (one, look) in seen.iter().zip(looks) {
            cost += self.weighed(one, look).map_or(f64::INFINITY, |(_, cost)| cost);
        }
        let off = self.off_prior(solution);
        cost += self.prior.free().iter().map(|p| 0.5 * (off[*p] / self.prior.std[*p]).powi(2)).sum::<f64>();
        if cost.is_finite() && solution.calibration.scale > 0.0 {
            cost
        } else {
            f64::INFINITY
        }
    }

    fn moved(&self, solution: &Solution, step: &[f64]) -> Solution {
        let mut moved = solution.clone();
        let (poses, border) = step.split_at(3 * solution.poses.len());
        let (landmarks, calibration) = border.split_at(2 * solution.landmarks.len());
        for (pose, d) in moved.poses.iter_mut().zip(poses.chunks_exact(3)) {
            *pose = Pose::new(pose.x + d[0], pose.y + d[1], math::wrap_angle(pose.heading + d[2]));
        }
        for (landmark, d) in moved.landmarks.iter_mut().zip(landmarks.chunks_exact(2)) {
            *landmark = [landmark[0] + d[0], landmark[1] + d[1]];
        }
        for (parameter, d) in self.prior.free().iter().zip(calibration) {
            match parameter {
                0 => moved.calibration.scale += d,
                _ => moved.calibration.bias += d,
            }
        }
        moved
    }
}

#[cfg(test)]
mod tests {
    use super::super::past::Noise;
    use super::*;
    use crate::density::Tail;
    use crate::measurement::RangeOnly;
    use crate::motion::MotionGaussian;

    const MODEL: RangeOnly = RangeOnly { range_std_m: 0.2 };
    const T_ROBOT_SENSOR: Pose = Pose { x: 0.4, y: -0.1, heading: 0.2 };
    const TRUE: Calibration = Calibration { scale: 1.07, bias: 0.2 };

    /// A drive around two beacons whose ranges are too long, and a guess that is off.
    fn example(tail: Tail, noise_m: f64) -> (Past, Solution) {
        let mut past = Past::default();
        let covariance = [[0.01, 0.002, 0.001], [0.002, 0.02, 0.003], [0.001, 0.003, 0.005]];
        let (mean, landmarks) = (Pose::new(1.0, 0.1, 0.3), [[4.0, 3.0], [2.0, -3.0]]);
        let (mut pose, mut poses) = (Pose::default(), Vec::new());
        for step in 0..25_u32 {
            pose = pose.compose(mean);
            let off = f64::from(step % 3) - 1.0;
            poses.push(Pose::new(pose.x + 0.1 * off, pose.y - 0.05, pose.heading + 0.03 * off));
            for (slot, landmark) in landmarks.into_iter().enumerate() {
                let true_range = MODEL.differentiated(pose.compose(T_ROBOT_SENSOR), landmark);
                let measured = TRUE.reported([true_range + noise_m * off]);
                past.heard(&Heard { slot, measured, noise: Noise { covariance: [[0.04]], tail } });
            }
            past.step_done(MotionGaussian { mean, covariance });
        }
        (past, Solution { poses, landmarks: vec![[4.2, 2.7], [1.8, -3.3]], calibration: Calibration::NONE })
    }

    impl RangeOnly {
        fn differentiated(&self, sensor: Pose, landmark: [f64; 2]) -> f64 {
            crate::measurement::MeasurementModel::linearize(self, sensor, landmark).expected[0]
        }
    }

    fn graph(past: &Past) -> Graph<'_, RangeOnly> {
        Graph {
            past,
            sensor: &MODEL,
            T_robot_sensor: T_ROBOT_SENSOR,
            start: Pose::default(),
            likelihood_exponent: 0.7,
            prior: Prior { mean: Calibration::NONE, std: [0.1, 1.0] },
            number_of: vec![Some(0), Some(1)],
        }
    }

    #[test]
    fn the_descent_is_minus_the_gradient_of_the_cost() {
        for tail in [Tail::Gaussian, Tail::StudentT(4.0)] {
            let (past, solution) = example(tail, 0.3);
            let graph = graph(&past);
            let seen = graph.seen::<1>();
            let mut system = graph.structure(&seen, 2);
            let looks = graph.look(&solution, &seen).unwrap();
            graph.linearize(&solution, (&seen, &looks), &mut system);
            assert_eq!(system.equations.descent.len(), 75 + 4 + 2);
            for i in 0..system.equations.descent.len() {
                let h = 1e-6;
                let cost = |sign: f64| {
                    let mut step = vec![0.0; system.equations.descent.len()];
                    step[i] = sign * h;
                    let moved = graph.moved(&solution, &step);
                    graph.cost(&moved, &seen, &graph.look(&moved, &seen).unwrap())
                };
                let numeric = (cost(-1.0) - cost(1.0)) / (2.0 * h);
                let found = system.equations.descent[i];
                assert!((numeric - found).abs() < 1e-5 * (1.0 + numeric.abs()), "{tail:?} {i}: {numeric} {found}");
            }
        }
    }

    #[test]
    fn the_calibration_and_the_places_are_found() {
        let (past, guess) = example(Tail::Gaussian, 0.0);
        let mode = graph(&past).solve::<1>(guess).unwrap().unwrap();
        let Solution { landmarks, calibration, .. } = &mode.solution;
        assert!((calibration.scale - TRUE.scale).abs() < 0.01 && (calibration.bias - TRUE.bias).abs() < 0.05);
        // What is known beforehand of scale and bias pulls at them.
        assert!((landmarks[0][0] - 4.0).hypot(landmarks[0][1] - 3.0) < 0.1, "{landmarks:?}");
        assert!((landmarks[1][0] - 2.0).hypot(landmarks[1][1] + 3.0) < 0.1, "{landmarks:?}");
    }

    #[test]
    fn a_guess_that_is_no_number_gives_no_mode() {
        let (past, mut guess) = example(Tail::Gaussian, 0.0);
        guess.landmarks[0] = [f64::NAN, 0.0];
        assert!(graph(&past).solve::<1>(guess).unwrap().is_none());
    }
}
