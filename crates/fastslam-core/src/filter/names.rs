//! Sightings whose name cannot be right, with known identities.

use super::returns::misplaced;
use super::setup::Setup;
use super::state::State;
use super::StepInfo;
use crate::association::ScanSighting;
use crate::diagnosis::misfits::Misplaced;
use crate::diagnosis::names::{Doubt, Misfit, NamedPlace, IMPLAUSIBLE};
use crate::geometry::Symmetric2;
use crate::landmark::{Gaussian, Measured};
use crate::measurement::Placing;
use crate::sighting::{Seen, Taken};

/// Leaves out the sightings of a scan that name a landmark which no particle can have seen there, unless others agree
/// that it is the robot which is elsewhere; removes landmarks that were founded by such a sighting.
pub(super) fn doubt_names<M: Placing>(
    setup: &Setup<M>,
    state: &mut State,
    seen: &mut Vec<Seen>,
    scan: &mut Vec<ScanSighting>,
    info: &mut StepInfo,
) {
    let excess = state.diagnosis.watch.noise.usual_excess();
    let (best, mut known) = (state.particles.best(), 0);
    let mut misfits: Vec<(usize, Misplaced)> = Vec::new();
    leave_out_unplaced(setup, state, seen, scan, info);
    for (j, sighting) in scan.iter().enumerate() {
        let Some(slot) = state.landmarks.named(sighting) else { continue };
        known += 1;
        if is_implausible(setup, state, sighting, slot, best) {
            misfits.extend(misplaced(setup, state, sighting).map(|misfit| (j, misfit)));
        }
    }
    let all: Vec<Misplaced> = misfits.iter().map(|(_, misfit)| *misfit).collect();
    let believed = state.diagnosis.watch.names.believe(known, &all, excess);
    for ((j, misfit), believed) in misfits.iter().zip(believed).rev() {
        if believed {
            let returns = state.rejuvenation.as_mut().map(|rejuvenation| &mut rejuvenation.returns);
            returns.into_iter().for_each(|returns| returns.are_sure |= misfit.turn.is_some());
        } else if doubt_name(setup, state, &scan[*j], misfit) == Doubt::LeaveOut {
            let value = scan.remove(*j).measured.value;
            seen.push(Seen { value, taken: Taken::Nothing });
            info.left_out.ignored += 1;
        }
    }
}

/// Leaves out the sightings that name landmarks which are not in the map, of a sensor that does not say where they are.
fn leave_out_unplaced<M: Placing>(
    setup: &Setup<M>,
    state: &State,
    seen: &mut Vec<Seen>,
    scan: &mut Vec<ScanSighting>,
    info: &mut StepInfo,
) {
    if setup.models.measurement().places() {
        return;
    }
    scan.retain(|sighting| {
        let is_known = state.landmarks.named(sighting).is_some();
        if !is_known {
            seen.push(Seen { value: sighting.measured.value, taken: Taken::Nothing });
            info.left_out.ignored += 1;
        }
        is_known
    });
}

/// Whether no particle can have seen its landmark there; nearly always `first`, who is asked first, can.
fn is_implausible<M: Placing>(
    setup: &Setup<M>,
    state: &State,
    sighting: &ScanSighting,
    slot: u32,
    first: usize,
) -> bool {
    let gate = IMPLAUSIBLE * state.diagnosis.watch.noise.usual_excess();
    let (model, T_robot_sensor) = (setup.models.measurement(), setup.models.T_robot_sensor);
    let others = (0..state.particles.len()).filter(|i| *i != first);
    std::iter::once(first).chain(others).all(|particle| {
        state.landmarks.held_by(particle, slot).is_none_or(|(landmark, _)| {
            let belief = state.belief_of(setup.settings.config.algorithm, particle);
            belief.fit(model, T_robot_sensor, &landmark, &sighting.measured).mahalanobis_squared > gate
        })
    })
}

fn doubt_name<M: Placing>(setup: &Setup<M>, state: &mut State, sighting: &ScanSighting, misfit: &Misplaced) -> Doubt {
    let best = state.particles.best();
    let (Some(identity), Some(slot)) = (sighting.identity, state.landmarks.named(sighting)) else {
        return Doubt::LeaveOut;
    };
    let belief = state.belief_of(setup.settings.config.algorithm, best);
    let (model, T_robot_sensor) = (setup.models.measurement(), setup.models.T_robot_sensor);
    // What does not say where a landmark is has none to move.
    if !model.places() {
        return Doubt::LeaveOut;
    }
    let held = state
        .landmarks
        .held_by(best, slot)
        .map_or(NamedPlace::default(), |(landmark, sightings)| NamedPlace { position_m: landmark.mean, sightings });
    let names = &mut state.diagnosis.watch.names;
    let agrees = names.other_place(identity).is_some_and(|mean| {
        let landmark = Gaussian { mean, covariance: Symmetric2::default() };
        // As uncertain as one more sighting.
        let measured = Measured { noise: sighting.measured.noise.scaled(2.0), ..sighting.measured };
        belief.fit(model, T_robot_sensor, &landmark, &measured).mahalanobis_squared <= IMPLAUSIBLE
    });
    let (position_m, may_be_drift) = (misfit.shown_m, misfit.turn.is_some());
    let doubt = names.doubt(&Misfit { identity, position_m, agrees, held, may_be_drift });
    // No sighting founded a landmark of a given map.
    if state.given.of(state.landmarks.birth(slot)).is_some() {
        return Doubt::LeaveOut;
    }
    if doubt == Doubt::Move {
        state.landmarks.remove(slot);
        state.particles.landmarks.iter_mut().for_each(|count| *count = count.saturating_sub(1));
    }
    doubt
}
