//! Draws of whole paths from the posterior, with the landmarks that follow from each.

use super::conditional::Draws;
use super::factor::{Lanes, LANES};
use super::graph::{Graph, Mode};
use crate::geometry::{Pose, Symmetric2};
use crate::landmark::Gaussian;
use crate::math;
use crate::measurement::Placing;
use crate::random::Stream;
use crate::vector::vectorized;

/// Draws from the posterior.
pub struct Drawn {
    /// Pose at the last step, those of particles first.
    pub last_poses: Vec<Pose>,
    /// Landmark by landmark, one Gaussian per draw.
    pub landmarks: Vec<Gaussian>,
}

/// How to draw.
pub struct Sampling {
    /// Random numbers.
    pub stream: Stream,
    /// Number of draws that become particles.
    pub count: usize,
    /// Draws at least, whatever becomes of them.
    pub least: usize,
    /// Distance from the mode, 1 for that of the posterior.
    pub spread: f64,
}

/// Draws paths from the Laplace approximation at a mode, with the landmarks that follow from each path.
pub fn draw<M: Placing>(graph: &Graph<'_, M>, mode: &Mode, sampling: &Sampling) -> Drawn {
    let count = sampling.count.max(sampling.least);
    let (held, free) = mode.solution.trajectory.poses.split_at(graph.first_free);
    let mut draws = Draws {
        first_free: graph.first_free,
        poses: vec![[[0.0; LANES]; 3]; free.len()],
        held: held.iter().enumerate().map(|(step, pose)| pose.compose(graph.T_robot_sensor(step))).collect(),
        landmarks: vec![[[0.0; LANES]; 2]; graph.landmarks.len()],
    };
    let nothing = Gaussian { mean: [0.0; 2], covariance: Symmetric2::default() };
    let mut drawn =
        Drawn { last_poses: Vec::with_capacity(count), landmarks: vec![nothing; count * graph.landmarks.len()] };
    let mut numbers = vec![[0.0; LANES]; mode.factor.size()];
    let sightings: usize = graph.landmarks.iter().map(|sights| sights.seen.len()).sum();
    let each = 0.06 * (mode.factor.numbers() + LANES * sightings) as f64;
    graph.effort.spend(each * sampling.count.div_ceil(LANES) as f64);
    for first in (0..count).step_by(LANES) {
        fill_normal(&mut numbers, sampling, first as u32);
        mode.factor.draw(&mut numbers, |variable, lanes| place(variable, lanes, mode, &mut draws));
        let lanes = LANES.min(count - first);
        if let Some([x, y, heading]) = draws.poses.last() {
            drawn.last_poses.extend((0..lanes).map(|i| Pose::new(x[i], y[i], math::wrap_angle(heading[i]))));
        }
        draws.move_to_sensor(|step| graph.T_robot_sensor(step));
        for k in 0..graph.landmarks.len() {
            let gaussians = draws.landmark_given_paths(graph, k);
            drawn.landmarks[k * count + first..][..lanes].copy_from_slice(&gaussians[..lanes]);
        }
    }
    drawn
}

/// Normal numbers, addressed by particle and variable.
pub fn fill_normal(numbers: &mut [Lanes], sampling: &Sampling, first_particle: u32) {
    let (stream, spread) = (sampling.stream, sampling.spread);
    vectorized(
        #[inline(always)]
        || {
            for (pair, rows) in numbers.chunks_mut(2).enumerate() {
                for lane in 0..LANES {
                    let drawn = stream.normal_pair(first_particle + lane as u32, pair as u32);
                    for (row, number) in rows.iter_mut().zip(drawn) {
                        row[lane] = spread * number;
                    }
                }
            }
        },
    );
}

/// Adds the deviations of one variable to the mode.
fn place(variable: usize, deviations: &Lanes, mode: &Mode, draws: &mut Draws) {
    let free = &mode.solution.trajectory.poses[draws.first_free..];
    let around = |center: f64| deviations.map(|d| center + d);
    match variable.checked_sub(3 * free.len()) {
        None => {
            let (row, coordinate) = (variable / 3, variable % 3);
            draws.poses[row][coordinate] = around(free[row].to_array()[coordinate]);
        }
        Some(of_landmarks) => {
            let (landmark, coordinate) = (of_landmarks / 2, of_landmarks % 2);
            draws.landmarks[landmark][coordinate] = around(mode.solution.landmarks[landmark][coordinate]);
        }
    }
}
