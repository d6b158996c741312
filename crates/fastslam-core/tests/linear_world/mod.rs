//! A world in which the exact posterior is known: a robot that never turns sees landmarks through Cartesian sightings,
//! so that motion and measurement are linear and all noise is Gaussian. The posterior is that of one joint Kalman
//! filter over the robot and all landmarks.
//!
//! Landmarks have a flat prior: at a first sighting the joint filter grows by `landmark = robot + sighting − noise`,
//! and the evidence is that of all later sightings given the first ones, which is what the particle filter weighs.

#![allow(dead_code)] // Every test binary compiles its own copy and uses a part of it.

use crate::dense::Matrix;
use fastslam_core::association::Appearance;
use fastslam_core::config::{Algorithm, Config};
use fastslam_core::filter::Sighting;
use fastslam_core::measurement::Cartesian;
use fastslam_core::motion::{Increments, Motion};
use fastslam_core::random::{Purpose, RandomSource, Stream};

pub const MODEL: Cartesian = Cartesian { position_std_m: 0.4 };
pub const MOTION_STD_M: [f64; 2] = [0.3, 0.2];
pub const LANDMARKS: [[f64; 2]; 3] = [[2.0, 1.0], [-1.0, 3.0], [4.0, -2.0]];
/// The last landmark comes late, so that its first sighting is made from an uncertain pose.
const FIRST_SEEN_AT: [usize; 3] = [0, 0, 3];

/// One step of the log: a motion, then the sightings as (landmark, measured).
#[derive(Clone, Debug)]
pub struct Step {
    pub control: [f64; 3],
    pub sightings: Vec<(usize, [f64; 2])>,
}

/// Eight steps. At step 0 the robot stands at the known origin.
pub fn simulate(seed: u64) -> Vec<Step> {
    let stream = |step: usize| RandomSource::new(seed).stream(Purpose::Simulation, step as u64);
    let mut robot = [0.0; 2];
    (0..9)
        .map(|t| {
            let control = if t == 0 { [0.0; 3] } else { [0.5, 0.1 * t as f64, 0.0] };
            let noise = stream(t).normal_pair(99, 0);
            if t > 0 {
                (0..2).for_each(|axis| robot[axis] += control[axis] + MOTION_STD_M[axis] * noise[axis]);
            }
            Step { control, sightings: sightings_at(t, robot, stream(t)) }
        })
        .collect()
}

fn sightings_at(t: usize, robot: [f64; 2], stream: Stream) -> Vec<(usize, [f64; 2])> {
    let visible = |n: &usize| t == FIRST_SEEN_AT[*n] || (t > FIRST_SEEN_AT[*n] && !(t + n).is_multiple_of(3));
    (0..LANDMARKS.len())
        .filter(visible)
        .map(|n| {
            let noise = stream.normal_pair(n as u32, 0);
            let seen = |axis: usize| LANDMARKS[n][axis] - robot[axis] + MODEL.position_std_m * noise[axis];
            (n, [seen(0), seen(1)])
        })
        .collect()
}

/// What the filter is told about this world.
pub fn config(algorithm: Algorithm, particles: u32, seed: u64) -> Config {
    let mut config = Config { seed, algorithm, ..Config::default() };
    config.motion = Motion::Increments(Increments {
        x_std_m: MOTION_STD_M[0],
        y_std_m: MOTION_STD_M[1],
        heading_std_rad: 0.0,
        ..Increments::default()
    });
    config.filter.particles = particles;
    // A Cartesian sighting is as good near the sensor as far from it.
    config.sensor.change(|s| s.min_range_m = 1e-9);
    config.sensor.change(|s| s.max_range_m = 1e6);
    config
}

pub fn sighting((landmark, value): (usize, [f64; 2])) -> Sighting {
    Sighting { value, identity: Some(landmark as u32), noise: None, appearance: Appearance::default() }
}

/// Mean and covariance of (robot, landmarks in the order of their first sighting), and the log evidence.
#[derive(Clone, Debug)]
pub struct Exact {
    pub mean: Matrix,
    pub covariance: Matrix,
    pub log_evidence: f64,
    order: Vec<usize>,
}

/// The joint Kalman filter over a log.
pub fn exact(steps: &[Step]) -> Exact {
    let mut filter =
        Exact { mean: Matrix::zeros(2, 1), covariance: Matrix::zeros(2, 2), log_evidence: 0.0, order: Vec::new() };
    for (t, step) in steps.iter().enumerate() {
        for axis in 0..2 {
            filter.mean[axis] += step.control[axis];
            filter.covariance[(axis, axis)] += if t > 0 { MOTION_STD_M[axis].powi(2) } else { 0.0 };
        }
        for &(landmark, value) in &step.sightings {
            match filter.order.iter().position(|known| *known == landmark) {
                Some(at) => filter.condition(2 + 2 * at, value),
                None => filter.grow(landmark, value),
            }
        }
    }
    filter
}

impl Exact {
    fn noise() -> Matrix {
        Matrix::identity(2) * MODEL.position_std_m.powi(2)
    }

    fn condition(&mut self, at: usize, value: [f64; 2]) {
        let mut h = Matrix::zeros(2, self.mean.len());
        for axis in 0..2 {
            h[(axis, axis)] = -1.0;
            h[(axis, at + axis)] = 1.0;
        }
        let innovation = Matrix::column(&value) - &h * &self.mean;
        let cross = &self.covariance * h.transpose();
        let s = &h * &cross + Self::noise();
        let (inverse, determinant) = s.inverse();
        assert!(determinant > 0.0 && s[(0, 0)] > 0.0, "not positive definite");
        let squared = (innovation.transpose() * &inverse * &innovation)[0];
        self.log_evidence -= 0.5 * (squared + determinant.ln()) + std::f64::consts::TAU.ln();
        let gain = cross * inverse;
        self.mean = &self.mean + &gain * innovation;
        self.covariance = &self.covariance - gain.transforms(&s);
    }

    fn grow(&mut self, landmark: usize, value: [f64; 2]) {
        let n = self.mean.len();
        self.order.push(landmark);
        self.mean =
            Matrix::from_fn(n + 2, 1, |i, _| if i < n { self.mean[i] } else { self.mean[i - n] + value[i - n] });
        let source = |i: usize| if i < n { i } else { i - n };
        self.covariance = Matrix::from_fn(n + 2, n + 2, |i, j| {
            let own = if i >= n && j >= n { Self::noise()[(i - n, j - n)] } else { 0.0 };
            self.covariance[(source(i), source(j))] + own
        });
    }
}
