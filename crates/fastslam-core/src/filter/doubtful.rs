//! Landmarks that may not exist explain what nothing else does, and change neither poses nor weights.

use super::beliefs::Beliefs;
use super::landmarks::Landmarks;
use super::setup::Setup;
use super::state::State;
use super::work::Associating;
use crate::association::{Belief, CandidateTable, Decision, Rules, ScanSighting};
use crate::gaussian::Gaussian;
use crate::math;
use crate::measurement::Placing;

/// The rules of association, with the clutter that was learned where none is told.
pub(super) fn rules<M: Placing>(setup: &Setup<M>, landmarks: &Landmarks) -> Rules {
    let rules = setup.settings.rules;
    let told = setup.settings.config.association.clutter_density.is_some();
    match &landmarks.fading {
        Some(fading) if !told && !fading.is_credulous() => {
            let clutter = fading.clutter_density() * setup.models.measurement().unmeasured_extent();
            let density = math::exp(rules.log_new_density) + clutter;
            Rules { log_unexplained_density: math::ln(density), ..rules }
        }
        _ => rules,
    }
}

/// Sets the candidates aside that may not exist.
pub(super) fn set_doubtful_aside(state: &State, associating: &mut Associating) {
    let Associating { table: CandidateTable { slots, of_sighting, .. }, doubtful, .. } = associating;
    doubtful.iter_mut().for_each(Vec::clear);
    doubtful.resize_with(of_sighting.len(), Vec::new);
    if state.landmarks.fading.as_ref().is_some_and(|fading| !fading.is_credulous()) {
        for (found, aside) in of_sighting.iter_mut().zip(doubtful) {
            aside.extend(found.iter().copied().filter(|c| !is_trusted(state, slots[*c as usize])));
            found.retain(|c| !aside.contains(c));
        }
    }
}

/// Gives sightings that nothing else explains to the likeliest of the candidates that were set aside, which come back to
/// the others. It changes decisions only, neither beliefs nor weights.
pub(super) fn explain_by_doubtful<M: Placing>(
    setup: &Setup<M>,
    beliefs: &Beliefs,
    associating: &mut Associating,
    scan: &[ScanSighting],
) {
    let Associating { table, doubtful, decisions, .. } = associating;
    if doubtful.iter().all(Vec::is_empty) {
        return;
    }
    for (particle, mine) in decisions.chunks_exact_mut(scan.len()).enumerate() {
        for j in (0..scan.len()).filter(|j| !doubtful[*j].is_empty()) {
            if mine[j] == Decision::New {
                let free = doubtful[j].iter().copied().filter(|c| !mine.contains(&Decision::Landmark(*c)));
                let known = free.filter_map(|candidate| Some((candidate, table.gaussian(candidate, particle)?)));
                if let Some(candidate) = likeliest(setup, &beliefs.get(particle), &scan[j], known) {
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
fn likeliest<M: Placing>(
    setup: &Setup<M>,
    belief: &Belief,
    sighting: &ScanSighting,
    candidates: impl Iterator<Item = (u32, Gaussian)>,
) -> Option<u32> {
    let near = candidates.filter_map(|(candidate, landmark)| {
        let (model, T_robot_sensor) = (setup.models.measurement(), setup.models.T_robot_sensor);
        let fit = belief.fit(model, T_robot_sensor, &landmark, &sighting.measured);
        (fit.mahalanobis_squared <= setup.settings.rules.gate).then_some((fit.log_likelihood, candidate))
    });
    near.max_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, candidate)| candidate)
}

/// Whether a landmark is believed to exist; one of a given map is, and so is what somebody gave a name.
fn is_trusted(state: &State, slot: u32) -> bool {
    let birth = state.landmarks.birth(slot);
    is_vouched_for(state, slot) || state.landmarks.fading.as_ref().is_none_or(|fading| fading.trusts(birth))
}

/// Whether somebody says that a landmark exists: a given map, or who named it.
pub(super) fn is_vouched_for(state: &State, slot: u32) -> bool {
    let known = state.landmarks.slot(slot);
    known.is_some_and(|known| known.identity.is_some() || state.given.of(known.birth).is_some())
}
