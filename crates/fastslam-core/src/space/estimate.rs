//! Mean and covariance of many poses, and of many maps.

use super::map::Slot;
use super::matrix::full;
use super::pose::SpacePose;
use crate::normal::{congruence, Matrix, Normal};
use serde::{Deserialize, Serialize};

/// Where the robot is.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SpaceEstimate {
    /// `T_world_robot`.
    pub mean: SpacePose,
    /// Of ξ in `T_world_robot Exp(ξ)`: shift in m and turn in rad, in the robot's axes.
    pub covariance: Matrix<6, 6>,
}

impl SpaceEstimate {
    /// The moments of a mixture: shares, means and covariances; about that with the largest share.
    pub fn of_mixture(parts: &[(f64, Self)]) -> Self {
        let about = parts.iter().fold((f64::NEG_INFINITY, SpacePose::default()), |best, (share, part)| {
            if *share > best.0 {
                (*share, part.mean)
            } else {
                best
            }
        });
        let back = about.1.inverse();
        let normals: Vec<(f64, Normal<6>)> = parts
            .iter()
            .filter(|(share, _)| *share > 0.0)
            .map(|(share, part)| {
                let mean = back.compose(part.mean).log();
                (*share, Normal { mean, covariance: part.covariance })
            })
            .collect();
        let Normal { mean, covariance } = Normal::of_mixture(normals.iter().map(|(share, part)| (*share, part)));
        Self { mean: about.1.compose(SpacePose::exp(mean)), covariance }
    }

    /// After a motion.
    pub fn after(&self, motion: &super::motion::SpaceMotion) -> Self {
        let carried = congruence(&motion.mean.inverse().adjoint(), &self.covariance);
        Self { mean: self.mean.compose(motion.mean), covariance: crate::normal::sum(&carried, &motion.covariance) }
    }
}

/// A landmark of the map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpaceLandmark {
    /// Its name.
    pub identity: u32,
    /// How often it was seen.
    pub sightings: u32,
    /// Where it is in the world, metres.
    pub place: Normal<3>,
}

/// The moments of a landmark over the particles.
pub fn landmark(slot: &Slot, weights: &[f64]) -> SpaceLandmark {
    let parts: Vec<(f64, Normal<3>)> = weights
        .iter()
        .enumerate()
        .filter(|(_, weight)| **weight > 0.0)
        .map(|(particle, weight)| {
            let own = slot.of(particle);
            (*weight, Normal { mean: own.mean, covariance: full(own.covariance) })
        })
        .collect();
    let place = Normal::of_mixture(parts.iter().map(|(weight, part)| (*weight, part)));
    SpaceLandmark { identity: slot.identity, sightings: slot.sightings, place }
}
