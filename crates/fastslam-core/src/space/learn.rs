//! What residuals say of the noise, for whoever wants to learn it.

use super::draw::whole;
use super::graph::{moved, Problem, Solution};
use super::sensor::Spatial;
use super::wide::LANES;
use crate::random::Stream;

/// Blocks of draws that the expectation is taken over.
const BLOCKS: usize = 2;

/// Squared residuals over what the noise explains: 1 where it is right.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ratios {
    /// Of the motion: shift and turn, by axis.
    pub motion: [f64; 6],
    /// Of the numbers of the sensor.
    pub sensor: [f64; 3],
}

/// The expectation over the posterior of path and map, by draws from it: residuals at the mode alone are too small, since it
/// follows the noise.
///
/// A variance times its ratio is the maximisation step of the EM algorithm: doing so again and again learns the noise.
pub fn ratios<M: Spatial>(problem: &Problem<'_, M>, solution: &Solution, stream: Stream) -> Option<Ratios> {
    let (mut sums, mut draws) = (([0.0; 6], [0.0; 3]), 0.0);
    for block in 0..BLOCKS {
        let off = whole(solution, block, stream);
        for lane in 0..LANES {
            let step: Vec<f64> = off.iter().map(|wide| wide.0[lane]).collect();
            draws += f64::from(u8::from(problem.add_ratios(&moved(&solution.at, &step, 1.0), &mut sums)));
        }
    }
    let (scans, sightings) = (problem.past.scans.len() as f64, problem.past.sightings.len() as f64);
    let found =
        Ratios { motion: sums.0.map(|sum| sum / (draws * scans)), sensor: sums.1.map(|sum| sum / (draws * sightings)) };
    found.motion.iter().chain(&found.sensor).all(|v| v.is_finite()).then_some(found)
}
