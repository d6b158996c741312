//! The posterior over a path and its landmarks as a sparse least-squares problem, solved by Gauss–Newton.
//!
//! Unknowns are ordered poses first: (x, y, heading) of every free step, then (x, y) of every landmark seen from one.

use super::effort::Effort;
use super::equations::{motion_cost, Block, Equations};
use super::factor::Factor;
use super::history::{History, Seen, Trajectory};
use crate::belief::by_robot_pose;
use crate::gaussian::{innovation_covariance, Gaussian, Inverse};
use crate::geometry::{Pose, Symmetric2};
use crate::math;
use crate::measurement::Placing;
use rustc_hash::FxHashMap;

/// Iterations at most.
const ITERATIONS: usize = 12;
/// What a solution takes as a rule.
const EXPECTED_ITERATIONS: f64 = 3.0;
/// An undamped step that promises to lower the cost by less than this is the last.
///
/// **Why:** the promise is half the squared distance to the mode in standard deviations of the posterior; what is left
/// of it after such a step is a thousandth, nothing beside draws that lie √n of them away.
const SMALL_GAIN: f64 = 0.5;
/// Precision of a place that is known once and for all, per square metre; no sighting touches it.
const UNMOVED: f64 = 1e12;
/// Steps in a row that may lead uphill before the lowest solution so far is gone back to.
///
/// **Why:** where odometry is stiff across the way, a step that turns the path leaves the valley of what the wheels allow,
/// and the next one comes back to it far lower down. Damped steps that follow the valley would be a hundred.
const MOST_RISEN: usize = 2;
/// Damping of the steps, relative to the diagonal, where undamped ones do not lead downhill.
const DAMPING: [f64; 3] = [1e-3, 1e-1, 1e1];

/// What is known of a landmark but for the sightings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Known {
    /// Nothing.
    Nothing,
    /// Where it lies, as a Gaussian that sightings improve.
    Prior(Gaussian),
    /// Where it lies, once and for all; the covariance adds to the noise of each sighting.
    Place(Gaussian),
}

/// Sightings of one landmark.
#[derive(Clone, Debug)]
pub struct Sights {
    /// Birth of the landmark.
    pub birth: u32,
    /// What is known of it beside them.
    pub known: Known,
    /// When and as what it was seen, in the order of time.
    pub seen: Vec<Seen>,
}

impl Sights {
    /// Whether there is something that says where the landmark is: a sighting, or what is known beside them.
    pub fn is_left(&self) -> bool {
        !self.seen.is_empty() || self.known != Known::Nothing
    }
}

/// Sightings by landmark; the landmarks in the order of their first sighting.
pub fn by_landmark(seen: &[Seen], known: impl Fn(u32) -> bool) -> Vec<Sights> {
    let mut places: FxHashMap<u32, usize> = FxHashMap::default();
    let mut sights: Vec<Sights> = Vec::new();
    for &one in seen.iter().filter(|one| known(one.birth)) {
        let place = *places.entry(one.birth).or_insert_with(|| {
            sights.push(Sights { birth: one.birth, known: Known::Nothing, seen: Vec::new() });
            sights.len() - 1
        });
        sights[place].seen.push(one);
    }
    sights
}

/// What is to be explained, and by which models.
pub struct Graph<'a, M> {
    /// Motions and sightings.
    pub history: &'a History,
    /// How each sensor sees.
    pub models: &'a [M],
    /// Where each sits.
    pub mountings: &'a [Pose],
    /// Power of each sighting's likelihood.
    pub likelihood_exponent: f64,
    /// Poses before this step stand still.
    pub first_free: usize,
    /// Landmarks seen from a free pose.
    pub landmarks: Vec<Sights>,
    /// What it may take, and what is done.
    pub effort: &'a Effort,
}

/// A path with landmarks.
#[derive(Clone, Debug)]
pub struct Solution {
    /// Path.
    pub trajectory: Trajectory,
    /// Positions of the graph's landmarks, metres.
    pub landmarks: Vec<[f64; 2]>,
}

/// The likeliest solution with the factor of its precision.
pub struct Mode {
    /// Where the posterior is highest.
    pub solution: Solution,
    /// Minus the logarithm of the posterior there, up to a constant.
    pub cost: f64,
    /// Of the precision there.
    pub factor: Factor,
}

/// A step of Gauss–Newton.
struct Stepped {
    to: Solution,
    cost: f64,
    /// How much lower the cost should be by the quadratic approximation.
    promised: f64,
}

impl<M: Placing> Graph<'_, M> {
    /// The mode near a first guess; `None` when no finite solution was found, or it may take too much.
    pub fn solve(&self, guess: Solution) -> Option<Mode> {
        let mut equations = self.equations(guess.trajectory.poses.len());
        let mut factor = Factor::of_structure(&equations.upper)?;
        let each = self.work_of_iteration(guess.trajectory.poses.len(), &factor);
        if !self.effort.allows(EXPECTED_ITERATIONS * each) {
            return None;
        }
        let mut best = (guess.clone(), self.cost(&guess));
        let (mut at, mut risen) = (guess, 0);
        for _ in 0..ITERATIONS {
            self.effort.take(each)?;
            self.linearize(&at, &mut equations);
            if let Some(Stepped { to, cost, promised }) = self.step(&at, &equations, &mut factor) {
                if cost <= best.1 {
                    best = (to, cost);
                    if promised < SMALL_GAIN {
                        let (solution, cost) = best;
                        return Some(Mode { solution, cost, factor });
                    }
                    (at, risen) = (best.0.clone(), 0);
                    continue;
                }
                if cost.is_finite() && risen < MOST_RISEN {
                    (at, risen) = (to, risen + 1);
                    continue;
                }
            }
            if risen > 0 {
                self.linearize(&best.0, &mut equations);
            }
            let Some(better) = self.descend(&best, &mut equations, &mut factor) else { break };
            (at, risen) = (better.0.clone(), 0);
            best = better;
        }
        let (solution, cost) = best;
        self.linearize(&solution, &mut equations);
        let usable = cost.is_finite() && factor.factorize(&equations.upper);
        usable.then_some(Mode { solution, cost, factor })
    }

    fn work_of_iteration(&self, steps: usize, factor: &Factor) -> f64 {
        let sightings: usize = self.landmarks.iter().map(|sights| sights.seen.len()).sum();
        0.01 * factor.operations() + (sightings + steps - self.first_free) as f64
    }

    /// A step of Gauss–Newton; `None` where the precision is none.
    fn step(&self, from: &Solution, equations: &Equations, factor: &mut Factor) -> Option<Stepped> {
        if !factor.factorize(&equations.upper) {
            return None;
        }
        let step = factor.solve(&equations.descent);
        let to = self.moved(from, &step);
        let cost = self.cost(&to);
        let promised = 0.5 * step.iter().zip(&equations.descent).map(|(s, d)| s * d).sum::<f64>();
        Some(Stepped { to, cost, promised })
    }

    /// A better solution with its cost by the least damped step that leads to one; `None` when none does.
    fn descend(
        &self,
        (solution, cost): &(Solution, f64),
        equations: &mut Equations,
        factor: &mut Factor,
    ) -> Option<(Solution, f64)> {
        for damping in DAMPING {
            equations.upper.scale_diagonal(1.0 + damping);
            self.effort.spend(0.01 * factor.operations());
            let stepped = self.step(solution, equations, factor);
            if let Some(Stepped { to, cost, .. }) = stepped.filter(|stepped| stepped.cost <= *cost) {
                return Some((to, cost));
            }
            equations.upper.scale_diagonal(1.0 / (1.0 + damping));
        }
        None
    }

    /// With places for free poses and the landmarks seen from them.
    fn equations(&self, steps: usize) -> Equations {
        let free_steps = |sights: &Sights| {
            let mut steps: Vec<usize> =
                sights.seen.iter().filter_map(|s| (s.step as usize).checked_sub(self.first_free)).collect();
            steps.dedup();
            steps.into_iter()
        };
        Equations::new(steps - self.first_free, self.landmarks.iter().map(free_steps), (0, &[]))
    }

    /// Fills the equations about a solution.
    fn linearize(&self, solution: &Solution, equations: &mut Equations) {
        equations.clear();
        let poses = solution.trajectory.poses.len() - self.first_free;
        for pose in 0..poses {
            let step = self.first_free + pose;
            let ends = [solution.trajectory.before(step), solution.trajectory.poses[step]];
            equations.add_motion(pose, ends, self.history.motion(step));
        }
        for (k, sights) in self.landmarks.iter().enumerate() {
            let own = 3 * poses + 2 * k;
            for seen in &sights.seen {
                self.add_sighting(solution, k, seen, (own, equations));
            }
            match sights.known {
                Known::Nothing => {}
                Known::Prior(_) => equations.add_known_pair(own, sights.known.information(solution.landmarks[k])),
                Known::Place(_) => equations.add_known_pair(own, [UNMOVED, 0.0, UNMOVED, 0.0, 0.0]),
            }
        }
    }

    /// A sighting ties a landmark, whose first unknown is `own`, to the pose that it was made from, where these are free.
    fn add_sighting(&self, solution: &Solution, k: usize, seen: &Seen, (own, equations): (usize, &mut Equations)) {
        let known = &self.landmarks[k].known;
        let view = self.view(&solution.trajectory, (solution.landmarks[k], known), seen);
        let landmark = Block::new(own, view.by_landmark, &view.weight);
        let moves = !matches!(known, Known::Place(_));
        if moves {
            equations.add(&landmark, &view.innovation);
        }
        let Some(pose) = (seen.step as usize).checked_sub(self.first_free) else { return };
        let pose = Block::new(3 * pose, view.by_pose, &view.weight);
        equations.add(&pose, &view.innovation);
        if moves {
            equations.add_between(&pose, &landmark);
        }
    }

    /// How the sensor sees that made a step.
    pub(super) fn model(&self, step: usize) -> &M {
        &self.models[self.history.sensor(step)]
    }

    /// Where the sensor that made a step sits on the robot.
    pub(super) fn T_robot_sensor(&self, step: usize) -> Pose {
        self.mountings[self.history.sensor(step)]
    }

    /// A sighting from where a path has the robot, of a landmark that is thought to be here.
    pub(super) fn view(&self, path: &Trajectory, (landmark, known): ([f64; 2], &Known), seen: &Seen) -> View {
        let (T_world_robot, measured) = (path.poses[seen.step as usize], self.history.sighting(seen.sighting));
        let sensor = T_world_robot.compose(self.T_robot_sensor(seen.step as usize));
        let model = self.model(seen.step as usize);
        let linear = model.linearize(sensor, landmark);
        let innovation = model.innovation(measured.value, linear.expected);
        let r = known.widened(measured.noise, linear.by_landmark);
        let inverse = Inverse::of(r);
        let distance = inverse.form(innovation);
        let scale = inverse.reciprocal * self.likelihood_exponent / measured.tail.noise_scale(distance);
        let Symmetric2 { xx, xy, yy } = inverse.adjugate().scaled(scale);
        View {
            innovation,
            by_landmark: linear.by_landmark,
            by_pose: by_robot_pose(linear.by_pose, T_world_robot, sensor),
            weight: [[xx, xy], [xy, yy]],
            distance,
        }
    }

    /// Minus the logarithm of the posterior, up to a constant; infinite where it is not finite.
    fn cost(&self, solution: &Solution) -> f64 {
        let mut cost = 0.0;
        for step in self.first_free..solution.trajectory.poses.len() {
            let ends = [solution.trajectory.before(step), solution.trajectory.poses[step]];
            cost += motion_cost(ends, self.history.motion(step));
        }
        for (k, sights) in self.landmarks.iter().enumerate() {
            cost += sights.known.cost(solution.landmarks[k]);
            for seen in &sights.seen {
                let measured = self.history.sighting(seen.sighting);
                let distance = self.view(&solution.trajectory, (solution.landmarks[k], &sights.known), seen).distance;
                cost += self.likelihood_exponent * measured.tail.loss_of(2, distance);
            }
        }
        if cost.is_finite() {
            cost
        } else {
            f64::INFINITY
        }
    }

    fn moved(&self, solution: &Solution, step: &[f64]) -> Solution {
        let mut moved = solution.clone();
        let free = moved.trajectory.free(self.first_free);
        let (poses, landmarks) = step.split_at(3 * free.len());
        for (pose, d) in moved.trajectory.poses[free].iter_mut().zip(poses.chunks_exact(3)) {
            *pose = Pose::new(pose.x + d[0], pose.y + d[1], math::wrap_angle(pose.heading + d[2]));
        }
        for (landmark, d) in moved.landmarks.iter_mut().zip(landmarks.chunks_exact(2)) {
            *landmark = [landmark[0] + d[0], landmark[1] + d[1]];
        }
        moved
    }
}

impl Known {
    /// Precision (xx, xy, yy) and pull (x, y) on a landmark that is thought to be here.
    pub(super) fn information(&self, at: [f64; 2]) -> [f64; 5] {
        let Self::Prior(Gaussian { mean, covariance }) = self else { return [0.0; 5] };
        let Symmetric2 { xx, xy, yy } = Inverse::of(*covariance).matrix();
        let [x, y] = [mean[0] - at[0], mean[1] - at[1]];
        [xx, xy, yy, xx * x + xy * y, xy * x + yy * y]
    }

    /// Minus the logarithm of the prior density, up to a constant.
    fn cost(&self, at: [f64; 2]) -> f64 {
        let (Self::Prior(known), [.., pull_x, pull_y]) = (self, self.information(at)) else { return 0.0 };
        0.5 * (pull_x * (known.mean[0] - at[0]) + pull_y * (known.mean[1] - at[1]))
    }

    /// The noise of a sighting with that of a place that does not move.
    fn widened(&self, noise: Symmetric2, by_landmark: [[f64; 2]; 2]) -> Symmetric2 {
        let Self::Place(Gaussian { covariance, .. }) = self else { return noise };
        innovation_covariance(by_landmark, *covariance, noise)
    }
}

/// A sighting, linearised.
pub(super) struct View {
    pub innovation: [f64; 2],
    pub by_landmark: [[f64; 2]; 2],
    /// By the robot's pose.
    by_pose: [[f64; 3]; 2],
    /// Precision that it counts with.
    pub weight: [[f64; 2]; 2],
    /// νᵀ R⁻¹ ν.
    pub distance: f64,
}

#[cfg(test)]
impl<'a, M> Graph<'a, M> {
    /// Over these landmarks and all of a past, for a sensor at the robot's origin.
    pub fn over(history: &'a History, model: &'a M, landmarks: Vec<Sights>, effort: &'a Effort) -> Self {
        let mountings = &[Pose { x: 0.0, y: 0.0, heading: 0.0 }];
        Self {
            history,
            models: std::slice::from_ref(model),
            mountings,
            likelihood_exponent: 1.0,
            first_free: 0,
            landmarks,
            effort,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::density::Tail;
    use crate::landmark::Measured;
    use crate::measurement::{MeasurementModel, RangeBearing};
    use crate::motion::MotionGaussian;

    const MODEL: RangeBearing = RangeBearing { range_std_m: 0.2, bearing_std_rad: 0.05 };

    const T_ROBOT_SENSOR: Pose = Pose { x: 0.4, y: -0.1, heading: 0.2 };

    /// Six steps along a bend with two landmarks in sight, one wild sighting, and a guess that is off.
    fn example(tail: Tail) -> (History, Vec<Sights>, Solution) {
        let mut history = History::new(1);
        let covariance = [[0.01, 0.002, 0.001], [0.002, 0.02, 0.003], [0.001, 0.003, 0.005]];
        let mean = Pose::new(1.0, 0.1, 0.3);
        let (start, landmarks) = (Pose::new(0.1, -0.2, 0.05), [[4.0, 3.0], [2.0, -3.0]]);
        let (mut pose, mut poses) = (start, Vec::new());
        for step in 0..6_u32 {
            history.moved(&MotionGaussian { mean, covariance });
            pose = pose.compose(mean);
            let off = f64::from(step % 3) - 1.0;
            poses.push(Pose::new(pose.x + 0.1 * off, pose.y - 0.05, pose.heading + 0.03 * off));
            let wild = if step == 4 { 0.8 } else { 0.0 };
            let scan = landmarks.map(|landmark| {
                let [range, bearing] = MODEL.expected(pose.compose(T_ROBOT_SENSOR), landmark);
                let noise = Symmetric2::new(0.04, 0.0, 0.0025);
                Measured { value: [range + 0.15 * off + wild, bearing - 0.04 * off], noise, tail }
            });
            history.explained(scan.into_iter(), |_, j| j as u32);
            history.step_done(0);
        }
        let sights = by_landmark(&history.seen_by(0), |_| true);
        (
            history,
            sights,
            Solution { trajectory: Trajectory { start, poses }, landmarks: vec![[4.2, 2.7], [1.8, -3.3]] },
        )
    }

    fn graph<'a>(
        (history, effort): (&'a History, &'a Effort),
        landmarks: Vec<Sights>,
        first_free: usize,
    ) -> Graph<'a, RangeBearing> {
        let mountings = &[T_ROBOT_SENSOR];
        Graph { history, models: &[MODEL], mountings, likelihood_exponent: 0.7, first_free, landmarks, effort }
    }

    #[test]
    fn the_descent_is_minus_the_gradient_of_the_cost() {
        for (tail, first_free) in [(Tail::Gaussian, 0), (Tail::StudentT(4.0), 0), (Tail::Gaussian, 2)] {
            let (history, sights, solution) = example(tail);
            let effort = Effort::any();
            let graph = graph((&history, &effort), sights, first_free);
            let mut equations = graph.equations(6);
            graph.linearize(&solution, &mut equations);
            let descent = &equations.descent;
            assert_eq!(descent.len(), 3 * (6 - first_free) + 4);
            for i in 0..descent.len() {
                let h = 1e-6;
                let cost = |sign: f64| {
                    let mut step = vec![0.0; descent.len()];
                    step[i] = sign * h;
                    graph.cost(&graph.moved(&solution, &step))
                };
                let numeric = (cost(-1.0) - cost(1.0)) / (2.0 * h);
                assert!(
                    (numeric - descent[i]).abs() < 1e-5 * (1.0 + numeric.abs()),
                    "{tail:?} {i}: {numeric} {}",
                    descent[i]
                );
            }
        }
    }

    #[test]
    fn from_the_mode_one_more_step_leads_nowhere() {
        for tail in [Tail::Gaussian, Tail::StudentT(4.0)] {
            let (history, sights, guess) = example(tail);
            let effort = Effort::any();
            let graph = graph((&history, &effort), sights, 0);
            let before = graph.cost(&guess);
            let mode = graph.solve(guess).unwrap();
            assert!(graph.cost(&mode.solution) < before);
            let mut equations = graph.equations(6);
            graph.linearize(&mode.solution, &mut equations);
            let step = mode.factor.solve(&equations.descent);
            let promised: f64 = step.iter().zip(&equations.descent).map(|(s, d)| 0.5 * s * d).sum();
            assert!((0.0..SMALL_GAIN).contains(&promised), "{promised}");
        }
    }

    #[test]
    fn a_problem_that_takes_too_much_is_not_solved() {
        let (history, sights, guess) = example(Tail::Gaussian);
        let effort = Effort::any();
        assert!(graph((&history, &effort), sights.clone(), 0).solve(guess.clone()).is_some());
        assert!(effort.done() > 0.0 && effort.refused().is_none());
        let tight = Effort::up_to(1.0);
        assert!(graph((&history, &tight), sights, 0).solve(guess).is_none());
        assert!(tight.done() == 0.0 && tight.refused().is_some_and(|work| work > 1.0));
    }

    #[test]
    fn problems_that_take_too_much_together_are_not_gone_on_with() {
        let (history, sights, guess) = example(Tail::Gaussian);
        let one = Effort::any();
        graph((&history, &one), sights.clone(), 0).solve(guess.clone()).unwrap();
        let together = Effort::in_all(2.5 * one.done());
        let solved =
            (0..9).take_while(|_| graph((&history, &together), sights.clone(), 0).solve(guess.clone()).is_some());
        assert_eq!(solved.count(), 2);
        assert!(together.done() <= 2.5 * one.done() && together.refused().is_some());
    }

    #[test]
    fn a_guess_without_an_end_gives_no_mode() {
        let (history, sights, mut guess) = example(Tail::Gaussian);
        guess.landmarks[0] = [f64::NAN, 0.0];
        assert!(graph((&history, &Effort::any()), sights, 0).solve(guess).is_none());
    }
}
