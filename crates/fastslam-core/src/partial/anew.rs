//! All particles drawn anew from the posterior over the whole path, as least squares has it.

use super::gauge::Gauge;
use super::graph::{Graph, Mode, Solution};
use super::past::Past;
use super::place::Place;
use super::sensing::{Calibration, Request, Sensing};
use super::PartialSlam;
use crate::error::Result;
use crate::filter::PoseEstimate;
use crate::gaussian::{Gaussian, GaussianOf};
use crate::geometry::{Matrix3, Pose, Symmetric2};
use crate::math;
use crate::normal::{Cholesky, Matrix, Normal};
use crate::random::{Purpose, Stream};

/// Steps between two draws at least, where the configuration does not say.
const EVERY_STEPS: u32 = 10;
/// Solutions for one draw at most: with all landmarks that may be placed, and with those of them that are.
const SOLUTIONS: usize = 2;

impl<S: Sensing<Z>, const Z: usize> PartialSlam<S, Z> {
    /// Whether it is time, this many steps from now: after so many steps, and a share of the log so far.
    pub(super) fn draw_is_due_after(&self, steps: usize) -> bool {
        let settings = &self.config.filter.rejuvenation;
        let every = settings.every_steps.unwrap_or(EVERY_STEPS);
        let steps = self.state.past.steps() + steps;
        every > 0 && settings.is_due(every, steps as f64, self.state.counters.drawn_at as f64)
    }

    /// Ends a log: the last draw, with the likeliest path. Tells whether anything changed.
    pub(super) fn finish_log(&mut self) -> bool {
        let fresh = self.state.past.steps() as u64 > self.state.counters.drawn_at;
        self.config.filter.rejuvenation.every_steps != Some(0) && fresh && self.draw_anew().unwrap_or(false)
    }

    /// Draws all particles anew; false, and nothing is changed, where nothing is placed yet or no solution is found.
    ///
    /// Landmarks that the best particle has placed take part. As long as the calibration is to be learned particles take its
    /// error for noise, and cannot tell: then it is those at one place, however uncertain that is there. Whether they are
    /// placed the solution tells, of which the calibration is a part; those that are not are left out of another one.
    ///
    /// **Errors:** those of a sensor of one's own.
    pub(super) fn draw_anew(&mut self) -> Result<bool> {
        self.state.counters.drawn_at = self.state.past.steps() as u64;
        if self.state.unnamed.is_some() {
            return self.draw_decided();
        }
        let mut guess = self.guess(self.state.cloud.particles.best());
        if guess.1.poses.len() != self.state.past.steps() {
            return Ok(false);
        }
        for _ in 0..SOLUTIONS {
            let (number_of, solution) = guess;
            if solution.landmarks.is_empty() {
                break;
            }
            let Some(mode) = self.graph(&self.state.past, &number_of).solve(solution)? else { break };
            let Some((covariance, placed)) = self.covariance(&mode) else { break };
            if placed.iter().all(|placed| *placed) {
                let Some(draws) = self.draws_about(&mode, covariance) else { break };
                let others = self.others(&self.state.past, &number_of, &mode.solution)?;
                self.adopt(&mode.solution, draws, (&number_of, others));
                return Ok(true);
            }
            guess = only(&number_of, mode.solution, &placed);
        }
        Ok(false)
    }

    /// The path, the calibration and the landmarks of a particle that may be placed, with the numbers of these by slot.
    pub(super) fn guess(&self, particle: usize) -> (Vec<Option<usize>>, Solution) {
        let cloud = &self.state.cloud;
        let here = cloud.particles.pose(particle);
        let (mut number_of, mut landmarks) = (Vec::new(), Vec::new());
        for place in &cloud.maps[particle] {
            let gaussian = match place {
                Place::One(gaussian) if self.is_learning() => Some(*gaussian),
                place => place.placed([here.x, here.y]),
            };
            number_of.push(gaussian.map(|_| landmarks.len()));
            landmarks.extend(gaussian.map(|gaussian| gaussian.mean));
        }
        let poses = self.state.path.path(particle).into_iter().map(|(_, pose)| pose).collect();
        (number_of, Solution { poses, landmarks, calibration: cloud.calibrations[particle] })
    }

    pub(super) fn graph<'a>(&'a self, past: &'a Past, number_of: &[Option<usize>]) -> Graph<'a, S> {
        Graph {
            past,
            sensor: &self.sensor,
            T_robot_sensor: self.T_robot_sensor,
            start: self.config.initial_pose.T_world_robot(),
            likelihood_exponent: self.config.filter.likelihood_exponent,
            prior: self.prior,
            number_of: number_of.to_vec(),
        }
    }

    /// Covariance of newest pose, landmarks and calibration, and which landmarks are placed as seen from that pose.
    pub(super) fn covariance(&self, mode: &Mode) -> Option<(Vec<Vec<f64>>, Vec<bool>)> {
        let Solution { poses, landmarks, .. } = &mode.solution;
        let border = 3 * poses.len();
        let variables: Vec<usize> = (border - 3..border + 2 * landmarks.len() + self.prior.free().len()).collect();
        let covariance = mode.factor.covariance(&variables);
        let last = poses[poses.len() - 1];
        let pose = std::array::from_fn(|a| std::array::from_fn(|b| covariance[a][b]));
        let placed = |(k, mean): (usize, &[f64; 2])| {
            let first = 3 + 2 * k;
            let marginal = [0, 1].map(|a| [0, 1].map(|b| covariance[first + a][first + b]));
            let cross = [0, 1].map(|a| [0, 1, 2].map(|b| covariance[first + a][b]));
            let relative = Normal { mean: *mean, covariance: given_pose(marginal, &cross, &pose) };
            Place::One(Gaussian::from(relative)).placed([last.x, last.y]).is_some()
        };
        let placed = landmarks.iter().enumerate().map(placed).collect();
        covariance.iter().flatten().all(|v| v.is_finite()).then_some((covariance, placed))
    }

    /// Draws of what a particle holds, from the Laplace approximation; `None` where that does not hold.
    ///
    /// **Why:** a particle's landmark is a Gaussian given its path, of covariance Λ⁻¹ with Λ what the sightings say of it
    /// alone. The mean of that Gaussian is therefore drawn with Cov(θ) − Λ⁻¹ (the law of total covariance), together with
    /// the newest pose and the calibration; the paths themselves need not be drawn. Where all of it lies together
    /// ([`Gauge`]) no later sighting can tell, so the draws do not differ in that. They come in pairs about the mode, whose
    /// mean is the mode.
    pub(super) fn draws_about(&self, mode: &Mode, mut covariance: Vec<Vec<f64>>) -> Option<Draws> {
        let Solution { poses, landmarks, .. } = &mode.solution;
        let (last, free) = (poses[poses.len() - 1], self.prior.free());
        let marginal = std::array::from_fn(|a| std::array::from_fn(|b| covariance[a][b]));
        let given_path = (0..landmarks.len()).map(|k| take_out_own(mode, k, &mut covariance));
        let given_path = given_path.collect::<Option<Vec<Symmetric2>>>()?;
        let gauge = Gauge::of(last, landmarks, &covariance);
        let about = Laplace { mode: &mode.solution, given_path, root: root(covariance)?, gauge: &gauge, free };
        let stream = self.random.stream(Purpose::Rejuvenation, self.state.counters.draws);
        let spread = self.config.filter.rejuvenation.spread;
        let draws: Vec<Draw> =
            (0..self.state.cloud.particles.len()).map(|particle| about.draw(stream, particle, spread)).collect();
        let sound = |(pose, map, drawn): &Draw| {
            pose.is_finite() && map.iter().all(GaussianOf::is_usable) && drawn.scale > 0.0 && drawn.bias.is_finite()
        };
        draws.iter().all(sound).then_some(Draws { draws, marginal, gauge })
    }

    /// The landmarks that are not placed, as the likeliest path has heard them so far.
    pub(super) fn others(
        &self,
        past: &Past,
        number_of: &[Option<usize>],
        solution: &Solution,
    ) -> Result<Vec<Option<Place>>> {
        let mut places: Vec<Option<Place>> = vec![None; number_of.len()];
        for kept in &past.sightings {
            let one = kept.heard::<Z>();
            // What shows a landmark that takes part, or nothing.
            if number_of.get(one.slot).is_none_or(Option::is_some) {
                continue;
            }
            let sensor = solution.poses[kept.step as usize].compose(self.T_robot_sensor);
            let Some(place) = &mut places[one.slot] else {
                let sighting = (sensor, solution.calibration.corrected(one.measured));
                let births = self.sensor.births(&[sighting], &one.noise.covariance)?;
                places[one.slot] = births.first().and_then(|components| Place::born(components));
                continue;
            };
            let request = |mean: [f64; 2]| Request {
                T_world_sensor: sensor,
                landmark: mean,
                measured: one.measured,
                calibration: solution.calibration,
            };
            let requests: Vec<_> = place.parts().iter().map(|part| request(part.gaussian.mean)).collect();
            place.correct(&self.sensor.look(&requests)?, &one.noise);
        }
        Ok(places)
    }

    /// Makes the draws the particles, and the likeliest path that of all.
    fn adopt(
        &mut self,
        solution: &Solution,
        draws: Draws,
        (number_of, others): (&[Option<usize>], Vec<Option<Place>>),
    ) {
        let last = solution.poses[solution.poses.len() - 1];
        self.state.path.replace(&solution.poses, |_| last);
        let cloud = &mut self.state.cloud;
        cloud.restart_weights();
        cloud.particles.score.fill(0.0);
        cloud.gauge = draws.gauge;
        cloud.estimate = PoseEstimate { mean: last, covariance: draws.marginal };
        for (i, (pose, placed, calibration)) in draws.draws.into_iter().enumerate() {
            cloud.particles.set_pose(i, pose);
            cloud.calibrations[i] = calibration;
            for (slot, place) in cloud.maps[i].iter_mut().enumerate() {
                match (number_of[slot], &others[slot]) {
                    (Some(k), _) => *place = Place::One(placed[k]),
                    (None, Some(other)) => *place = other.clone(),
                    (None, None) => {}
                }
            }
        }
        self.state.counters.draws += 1;
    }
}

/// Pose, placed landmarks and calibration of a particle.
pub(super) type Draw = (Pose, Vec<Gaussian>, Calibration);

/// Draws for all particles.
pub(super) struct Draws {
    pub draws: Vec<Draw>,
    /// Covariance of the newest pose.
    pub marginal: Matrix3,
    pub gauge: Gauge,
}

/// Newest pose, placed landmarks and calibration as all draws lie about them.
struct Laplace<'a> {
    mode: &'a Solution,
    /// Covariance of every landmark where the path is known.
    given_path: Vec<Symmetric2>,
    /// A root of the covariance of all that is drawn: the pose, then the landmarks' means, then the calibration.
    root: Vec<Vec<f64>>,
    gauge: &'a Gauge,
    /// Parameters of the calibration that are drawn.
    free: &'a [usize],
}

impl Laplace<'_> {
    /// The draw of one particle; the odd ones mirror those before them.
    fn draw(&self, stream: Stream, particle: usize, spread: f64) -> Draw {
        let Solution { poses, landmarks, calibration } = self.mode;
        let (last, count) = (poses[poses.len() - 1], self.root.len());
        let (two, sign) = ((particle / 2) as u32, if particle.is_multiple_of(2) { spread } else { -spread });
        let pairs = (0..count.div_ceil(2)).flat_map(|pair| stream.normal_pair(two, pair as u32));
        let normal: Vec<f64> = pairs.map(|n| sign * n).collect();
        let mut off: Vec<f64> = self.root.iter().map(|row| row.iter().zip(&normal).map(|(l, n)| l * n).sum()).collect();
        self.gauge.take_out(last, landmarks, &mut off);
        let pose = Pose::new(last.x + off[0], last.y + off[1], math::wrap_angle(last.heading + off[2]));
        let landmark = |k: usize| Gaussian {
            mean: std::array::from_fn(|d| landmarks[k][d] + off[3 + 2 * k + d]),
            covariance: self.given_path[k],
        };
        let mut drawn = *calibration;
        for (parameter, d) in self.free.iter().zip(&off[3 + 2 * landmarks.len()..]) {
            match parameter {
                0 => drawn.scale += d,
                _ => drawn.bias += d,
            }
        }
        (pose, (0..landmarks.len()).map(landmark).collect(), drawn)
    }
}

/// Takes the covariance Λ⁻¹ that landmark `k` has where the path is known out of that of all that is drawn, and returns
/// it; `None` where nothing was said of it.
fn take_out_own(mode: &Mode, k: usize, covariance: &mut [Vec<f64>]) -> Option<Symmetric2> {
    let own = Cholesky::of(&mode.information[k])?.inverse();
    for (a, row) in own.iter().enumerate() {
        for (b, value) in row.iter().enumerate() {
            covariance[3 + 2 * k + a][3 + 2 * k + b] -= value;
        }
    }
    Some(Symmetric2::new(own[0][0], own[0][1], own[1][1]))
}

/// A solution with only these of its landmarks, and their numbers by slot.
pub(super) fn only(number_of: &[Option<usize>], solution: Solution, chosen: &[bool]) -> (Vec<Option<usize>>, Solution) {
    let mut next = 0..;
    let new: Vec<Option<usize>> = chosen.iter().map(|chosen| if *chosen { next.next() } else { None }).collect();
    let landmarks = solution.landmarks.iter().zip(chosen).filter(|(_, chosen)| **chosen).map(|(at, _)| *at).collect();
    (number_of.iter().map(|number| number.and_then(|k| new[k])).collect(), Solution { landmarks, ..solution })
}

/// The covariance of a landmark where the newest pose is known.
fn given_pose(landmark: Matrix<2, 2>, cross: &Matrix<2, 3>, pose: &Matrix<3, 3>) -> Matrix<2, 2> {
    let Some(factor) = Cholesky::of(pose) else { return landmark };
    let explained = cross.map(|row| factor.solve(&row));
    std::array::from_fn(|a| {
        std::array::from_fn(|b| landmark[a][b] - (0..3).map(|i| explained[a][i] * cross[b][i]).sum::<f64>())
    })
}

/// L with L Lᵀ = A for a matrix without negative directions; pivots that rounding left at or below zero span nothing.
/// `None` for what is no number.
fn root(a: Vec<Vec<f64>>) -> Option<Vec<Vec<f64>>> {
    let n = a.len();
    let mut l = vec![vec![0.0; n]; n];
    for j in 0..n {
        let pivot = a[j][j] - l[j][..j].iter().map(|v| v * v).sum::<f64>();
        if !pivot.is_finite() {
            return None;
        }
        // Less than rounding leaves of the variance itself is nothing.
        let pivot = if pivot > 1e-12 * a[j][j].abs() { pivot.sqrt() } else { 0.0 };
        l[j][j] = pivot;
        for i in j + 1..n {
            let rest = a[i][j] - (0..j).map(|k| l[i][k] * l[j][k]).sum::<f64>();
            l[i][j] = if pivot > 0.0 { rest / pivot } else { 0.0 };
        }
    }
    Some(l)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_root_makes_the_matrix_again_also_a_singular_one() {
        let a = vec![vec![4.0, 2.0, 0.0], vec![2.0, 1.0, 0.0], vec![0.0, 0.0, 9.0]];
        let l = root(a.clone()).unwrap();
        for (i, row) in a.iter().enumerate() {
            for (j, value) in row.iter().enumerate() {
                let made: f64 = (0..3).map(|k| l[i][k] * l[j][k]).sum();
                assert!((made - value).abs() < 1e-12, "{l:?}");
            }
        }
        assert!(root(vec![vec![f64::NAN]]).is_none());
    }
}
