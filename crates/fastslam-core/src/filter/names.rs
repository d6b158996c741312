//! Sightings whose name cannot be right, with known identities.

use super::landmarks::Landmarks;
use super::setup::Setup;
use super::state::State;
use super::StepInfo;
use crate::association::ScanSighting;
use crate::diagnosis::names::{Doubt, Misfit, NamedPlace, IMPLAUSIBLE};
use crate::geometry::Symmetric2;
use crate::landmark::{column, Gaussian, Measured};
use crate::measurement::Placing;
use crate::sighting::{Seen, Taken};

/// Leaves out the sightings of a scan that name a landmark which no particle can have seen there, while the others fit;
/// removes landmarks that were founded by such a sighting.
pub(super) fn doubt_names<M: Placing>(
    setup: &Setup<M>,
    state: &mut State,
    seen: &mut Vec<Seen>,
    scan: &mut Vec<ScanSighting>,
    info: &mut StepInfo,
) {
    let mut known = 0;
    let mut misfits: Vec<usize> = Vec::new();
    let best = state.particles.best();
    for (j, sighting) in scan.iter().enumerate() {
        let Some(slot) = state.landmarks.named(sighting) else { continue };
        known += 1;
        if is_implausible(setup, state, sighting, slot, best) {
            misfits.push(j);
        }
    }
    if !state.diagnosis.watch.names.may_doubt(known, misfits.len()) {
        return;
    }
    for &j in misfits.iter().rev() {
        if doubt_name(setup, state, &scan[j]) == Doubt::LeaveOut {
            let value = scan.remove(j).measured.value;
            seen.push(Seen { value, taken: Taken::Nothing });
            info.left_out.ignored += 1;
        }
    }
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
    let (model, T_robot_sensor) = (&setup.models.measurement, setup.models.T_robot_sensor);
    let others = (0..state.particles.len()).filter(|i| *i != first);
    std::iter::once(first).chain(others).all(|particle| {
        held_by(&state.landmarks, particle, slot).is_none_or(|(landmark, _)| {
            let belief = state.belief_of(setup.settings.config.algorithm, particle);
            belief.fit(model, T_robot_sensor, &landmark, &sighting.measured).mahalanobis_squared > gate
        })
    })
}

fn doubt_name<M: Placing>(setup: &Setup<M>, state: &mut State, sighting: &ScanSighting) -> Doubt {
    let best = state.particles.best();
    let (Some(identity), Some(slot)) = (sighting.identity, state.landmarks.named(sighting)) else {
        return Doubt::LeaveOut;
    };
    let belief = state.belief_of(setup.settings.config.algorithm, best);
    let (model, T_robot_sensor) = (&setup.models.measurement, setup.models.T_robot_sensor);
    let position_m = model.inverse(belief.mean.compose(T_robot_sensor), sighting.measured.value);
    let held = held_by(&state.landmarks, best, slot)
        .map_or(NamedPlace::default(), |(landmark, sightings)| NamedPlace { position_m: landmark.mean, sightings });
    let names = &mut state.diagnosis.watch.names;
    let agrees = names.other_place(identity).is_some_and(|mean| {
        let landmark = Gaussian { mean, covariance: Symmetric2::default() };
        // As uncertain as one more sighting.
        let measured = Measured { noise: sighting.measured.noise.scaled(2.0), ..sighting.measured };
        belief.fit(model, T_robot_sensor, &landmark, &measured).mahalanobis_squared <= IMPLAUSIBLE
    });
    let doubt = names.doubt(&Misfit { identity, position_m, agrees, held });
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

/// A landmark as a particle has it, and how often it was seen.
fn held_by(landmarks: &Landmarks, particle: usize, slot: u32) -> Option<(Gaussian, u32)> {
    let mut row = [0.0; column::COUNT];
    let found = landmarks.read_row(slot, particle, &mut row[..landmarks.columns()]);
    let covariance = Symmetric2::new(row[column::COV_XX], row[column::COV_XY], row[column::COV_YY]);
    let mean = [row[column::MEAN_X], row[column::MEAN_Y]];
    (found && row[column::SIGHTINGS] > 0.0).then(|| (Gaussian { mean, covariance }, row[column::SIGHTINGS] as u32))
}
