//! One map with a belief about the pose: what the rules of association ask of it.

use super::table::{CandidateTable, FitTable};
use crate::belief::Belief;
use crate::density::Fit;
use crate::geometry::Pose;
use crate::measurement::Placing;
use crate::sighting::{Measured, ScanSighting};

/// One map with a belief about the pose, as the rules of association see it.
pub trait Hypothesis {
    /// Whether the pose is known, so that no sighting can refine it.
    fn pose_is_certain(&self) -> bool;
    /// How well a sighting fits a candidate; `None` where the map lacks it. `pair` is the number of the sighting and the
    /// place of the candidate among those of the sighting.
    fn fit(&self, pair: [usize; 2], candidate: u32, measured: &Measured) -> Option<Fit>;
    /// Identity that a candidate was seen with, plus one; 0 for none.
    fn identity_mark(&self, candidate: u32) -> f64;
    /// Takes a sighting for one of a candidate: the belief is refined by it.
    fn accept(&mut self, candidate: u32, sighting: &ScanSighting);
}

/// A particle and the candidates in its map.
pub struct ParticleHypothesis<'a, M> {
    /// How the sensor measures.
    pub model: &'a M,
    /// Where the sensor is on the robot.
    pub T_robot_sensor: Pose,
    /// What may have been sighted.
    pub table: &'a CandidateTable,
    /// How well it fits, with the belief before the scan.
    pub fits: &'a FitTable,
    /// Which particle.
    pub particle: usize,
    /// What it believes before the scan.
    pub belief: Belief,
    /// What it believes once a sighting refined that, with the pose of the sensor.
    pub refined: Option<(Belief, Pose)>,
}

// Derived, it would ask the model for the same.
impl<M> Clone for ParticleHypothesis<'_, M> {
    fn clone(&self) -> Self {
        Self { ..*self }
    }
}

impl<M: Placing> Hypothesis for ParticleHypothesis<'_, M> {
    fn pose_is_certain(&self) -> bool {
        self.belief.covariance == [[0.0; 3]; 3]
    }

    #[inline(always)]
    fn fit(&self, [sighting, place]: [usize; 2], candidate: u32, measured: &Measured) -> Option<Fit> {
        match &self.refined {
            None => self.table.holds(candidate, self.particle).then(|| self.fits.get(sighting, place, self.particle)),
            Some((belief, T_world_sensor)) => {
                let landmark = self.table.gaussian(candidate, self.particle)?;
                let mut fit = belief.judge(&belief.view(self.model, *T_world_sensor, &landmark, measured));
                fit.log_likelihood += self.fits.evidence(sighting, place, self.particle);
                Some(fit)
            }
        }
    }

    #[inline(always)]
    fn identity_mark(&self, candidate: u32) -> f64 {
        self.table.identity_mark(candidate, self.particle)
    }

    fn accept(&mut self, candidate: u32, sighting: &ScanSighting) {
        if self.pose_is_certain() {
            return;
        }
        if let Some(landmark) = self.table.gaussian(candidate, self.particle) {
            let mut belief = self.refined.map_or(self.belief, |(belief, _)| belief);
            belief.refine(self.model, self.T_robot_sensor, &landmark, &sighting.measured);
            self.refined = Some((belief, belief.mean.compose(self.T_robot_sensor)));
        }
    }
}
