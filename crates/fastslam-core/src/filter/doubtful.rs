//! Landmarks that may not exist explain what nothing else does, and change neither poses nor weights.

use super::FastSlam;
use crate::association::{CandidateTable, Decision, Rules, ScanSighting};
use crate::math;
use crate::measurement::MeasurementModel;

impl<M: MeasurementModel> FastSlam<M> {
    /// The rules of association, with the clutter that was learned where none is told.
    pub(super) fn rules(&self) -> Rules {
        let rules = self.settings.rules;
        let told = self.settings.config.association.clutter_density.is_some();
        match &self.state.landmarks.fading {
            Some(fading) if !told && !fading.is_credulous() => {
                let density = math::exp(rules.log_new_density) + fading.clutter_density();
                Rules { log_unexplained_density: math::ln(density), ..rules }
            }
            _ => rules,
        }
    }

    /// Sets the candidates aside that may not exist.
    pub(super) fn set_doubtful_aside(&mut self, table: &mut CandidateTable) {
        let mut doubtful = std::mem::take(&mut self.work.associating.doubtful);
        doubtful.iter_mut().for_each(Vec::clear);
        doubtful.resize_with(table.of_sighting.len(), Vec::new);
        if self.state.landmarks.fading.as_ref().is_some_and(|fading| !fading.is_credulous()) {
            let CandidateTable { slots, of_sighting, .. } = table;
            for (found, aside) in of_sighting.iter_mut().zip(&mut doubtful) {
                aside.extend(found.iter().copied().filter(|c| !self.is_trusted(slots[*c as usize])));
                found.retain(|c| !aside.contains(c));
            }
        }
        self.work.associating.doubtful = doubtful;
    }

    /// Gives sightings that nothing else explains to the likeliest of the candidates that were set aside, which come
    /// back to the others.
    pub(super) fn explain_by_doubtful(
        &self,
        scan: &[ScanSighting],
        decisions: &mut [Decision],
        table: &mut CandidateTable,
    ) {
        let doubtful = &self.work.associating.doubtful;
        if doubtful.iter().all(Vec::is_empty) {
            return;
        }
        for (particle, mine) in decisions.chunks_exact_mut(scan.len()).enumerate() {
            for j in (0..scan.len()).filter(|j| !doubtful[*j].is_empty()) {
                if mine[j] == Decision::New {
                    let free = doubtful[j].iter().copied().filter(|c| !mine.contains(&Decision::Landmark(*c)));
                    if let Some(candidate) = self.likeliest(particle, &scan[j], free, table) {
                        mine[j] = Decision::Landmark(candidate);
                    }
                }
            }
        }
        for (found, aside) in table.of_sighting.iter_mut().zip(doubtful) {
            found.extend_from_slice(aside);
            found.sort_unstable();
        }
    }

    /// The likeliest of some candidates within the gate, as one particle has them.
    fn likeliest(
        &self,
        particle: usize,
        sighting: &ScanSighting,
        candidates: impl Iterator<Item = u32>,
        table: &CandidateTable,
    ) -> Option<u32> {
        let (belief, gate) = (self.work.beliefs.get(particle), self.settings.rules.gate);
        let near = candidates.filter_map(|candidate| {
            let landmark = table.gaussian(candidate, particle)?;
            let (model, T_robot_sensor) = (&self.models.measurement, self.models.T_robot_sensor);
            let fit = belief.fit(model, T_robot_sensor, &landmark, &sighting.measured);
            (fit.mahalanobis_squared <= gate).then_some((fit.log_likelihood, candidate))
        });
        near.max_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, candidate)| candidate)
    }

    /// Whether a landmark is believed to exist; one of a given map is, and so is what somebody gave a name.
    fn is_trusted(&self, slot: u32) -> bool {
        let birth = self.state.landmarks.birth(slot);
        self.is_vouched_for(slot) || self.state.landmarks.fading.as_ref().is_none_or(|fading| fading.trusts(birth))
    }

    /// Whether somebody says that a landmark exists: a given map, or who named it.
    pub(super) fn is_vouched_for(&self, slot: u32) -> bool {
        let known = self.state.landmarks.slot(slot);
        known.is_some_and(|known| known.identity.is_some() || self.state.given.of(known.birth).is_some())
    }
}
