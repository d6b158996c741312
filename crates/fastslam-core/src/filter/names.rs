//! Sightings whose name cannot be right, with known identities.

use super::scan::ScanSighting;
use super::{FastSlam, StepInfo};
use crate::association::Belief;
use crate::config::Algorithm;
use crate::diagnosis::names::{Doubt, Misfit, NamedPlace, IMPLAUSIBLE};
use crate::geometry::Symmetric2;
use crate::landmark::{column, Gaussian, Measured};
use crate::measurement::MeasurementModel;
use crate::sighting::{Seen, Taken};

impl<M: MeasurementModel> FastSlam<M> {
    /// Leaves out the sightings of a scan that name a landmark which no particle can have seen there, while the others
    /// fit; removes landmarks that were founded by such a sighting.
    pub(super) fn doubt_names(&mut self, scan: &mut Vec<ScanSighting>, info: &mut StepInfo) {
        let gate = IMPLAUSIBLE * self.state.diagnosis.watch.noise.usual_excess();
        let best = self.state.particles.best();
        let mut known = 0;
        let mut misfits: Vec<usize> = Vec::new();
        for (j, sighting) in scan.iter().enumerate() {
            let Some(slot) = self.known_slot(sighting) else { continue };
            known += 1;
            if self.is_implausible(sighting, slot, gate, best) {
                misfits.push(j);
            }
        }
        if !self.state.diagnosis.watch.names.may_doubt(known, misfits.len()) {
            return;
        }
        for &j in misfits.iter().rev() {
            if self.doubt_name(&scan[j]) == Doubt::LeaveOut {
                let value = scan.remove(j).measured.value;
                self.work.seen.push(Seen { value, taken: Taken::Nothing });
                info.left_out.ignored += 1;
            }
        }
    }

    /// Whether no particle can have seen its landmark there; nearly always `first`, who is asked first, can.
    fn is_implausible(&self, sighting: &ScanSighting, slot: u32, gate: f64, first: usize) -> bool {
        let others = (0..self.state.particles.len()).filter(|i| *i != first);
        std::iter::once(first).chain(others).all(|particle| {
            self.held_by(particle, slot).is_none_or(|(landmark, _)| {
                let fit = self.belief_of(particle).fit(
                    &self.models.measurement,
                    self.models.T_robot_sensor,
                    &landmark,
                    &sighting.measured,
                );
                fit.mahalanobis_squared > gate
            })
        })
    }

    fn doubt_name(&mut self, sighting: &ScanSighting) -> Doubt {
        let best = self.state.particles.best();
        let (Some(identity), Some(slot)) = (sighting.identity, self.known_slot(sighting)) else {
            return Doubt::LeaveOut;
        };
        let belief = self.belief_of(best);
        let (model, T_robot_sensor) = (&self.models.measurement, self.models.T_robot_sensor);
        let position_m = model.inverse(belief.mean.compose(T_robot_sensor), sighting.measured.value);
        let held = self
            .held_by(best, slot)
            .map_or(NamedPlace::default(), |(landmark, sightings)| NamedPlace { position_m: landmark.mean, sightings });
        let agrees = self.state.diagnosis.watch.names.other_place(identity).is_some_and(|mean| {
            let landmark = Gaussian { mean, covariance: Symmetric2::default() };
            // As uncertain as one more sighting.
            let measured = Measured { noise: sighting.measured.noise.scaled(2.0), ..sighting.measured };
            belief.fit(model, T_robot_sensor, &landmark, &measured).mahalanobis_squared <= IMPLAUSIBLE
        });
        let doubt = self.state.diagnosis.watch.names.doubt(&Misfit { identity, position_m, agrees, held });
        // No sighting founded a landmark of a given map.
        if self.state.given.of(self.state.landmarks.birth(slot)).is_some() {
            return Doubt::LeaveOut;
        }
        if doubt == Doubt::Move {
            self.state.landmarks.remove(slot);
            self.state.particles.landmarks.iter_mut().for_each(|count| *count = count.saturating_sub(1));
        }
        doubt
    }

    /// What a particle believes of the pose before the scan.
    pub(super) fn belief_of(&self, particle: usize) -> Belief {
        let pose = self.state.particles.pose(particle);
        match self.settings.config.algorithm {
            Algorithm::Fastslam1 => Belief { mean: pose, covariance: [[0.0; 3]; 3] },
            _ => Belief {
                mean: pose.compose(self.state.motions.pending.mean),
                covariance: self.state.motions.pending.covariance_in_world(pose.heading),
            },
        }
    }

    /// A landmark as a particle has it, and how often it was seen.
    fn held_by(&self, particle: usize, slot: u32) -> Option<(Gaussian, u32)> {
        let mut row = [0.0; column::COUNT];
        let found = self.state.landmarks.read_row(slot, particle, &mut row[..self.state.landmarks.columns()]);
        let covariance = Symmetric2::new(row[column::COV_XX], row[column::COV_XY], row[column::COV_YY]);
        let mean = [row[column::MEAN_X], row[column::MEAN_Y]];
        (found && row[column::SIGHTINGS] > 0.0).then(|| (Gaussian { mean, covariance }, row[column::SIGHTINGS] as u32))
    }
}
