//! Named landmarks that come back after a long way.
//!
//! A landmark that is named far from where the map has it shows either a misread name or how far the robot has drifted
//! since it saw that landmark last (`diagnosis/misfits.rs` decides). Then a draw of whole paths spreads the correction
//! over the way, which particles that have forgotten it cannot.

use super::doubts::{gate_m2, have_forgotten, is_ambiguous};
use super::need::Need;
use super::setup::Setup;
use super::state::State;
use crate::association::{area_m2, ScanSighting, GATE};
use crate::diagnosis::misfits::Misplaced;
use crate::diagnosis::names::IMPLAUSIBLE;
use crate::geometry::{Pose, Symmetric2};
use crate::landmark::{first_sighting, Gaussian, Measured};
use crate::measurement::Placing;

/// Notes whether the rounds of a scan show landmarks since whose last sighting the particles have forgotten the way, where
/// odometry alone does not relate the two as well as one sighting does, and that they are not where they are expected.
pub(super) fn note_returns<M: Placing>(setup: &Setup<M>, state: &mut State, rounds: &[Vec<ScanSighting>]) {
    let Some(need) = need_of(state) else { return };
    let best = state.particles.best();
    let belief = state.belief_of(setup.settings.config.algorithm, best);
    let (model, T_robot_sensor) = (setup.models.measurement(), setup.models.T_robot_sensor);
    let gate = GATE * state.diagnosis.watch.noise.usual_excess();
    let ago = |sighting: &ScanSighting| {
        let slot = state.landmarks.named(sighting)?;
        let (landmark, _) = state.landmarks.held_by(best, slot)?;
        let (drift, ago) = relation(state, need, slot, landmark.mean)?;
        let gate_m2 = gate_m2(setup, landmark.mean, belief.mean);
        let fit = belief.fit(model, T_robot_sensor, &landmark, &sighting.measured);
        let is_vague = is_ambiguous(area_m2(drift.determinant()), f64::INFINITY, gate_m2);
        (is_vague && fit.mahalanobis_squared > gate).then_some(ago)
    };
    let longest = || rounds.iter().flatten().filter_map(ago).max();
    let forgotten = need.is_affordable() && longest().is_some_and(|steps| have_forgotten(state, need, steps));
    if let Some(rejuvenation) = &mut state.rejuvenation {
        rejuvenation.returns.are_forgotten = forgotten;
    }
}

fn need_of(state: &State) -> Option<&Need> {
    state.rejuvenation.as_ref()?.need.as_ref()
}

/// How far odometry may have led the robot astray relative to a landmark since it was seen, and how many steps ago that
/// was; `None` where the landmark is known beside what was seen.
fn relation(state: &State, need: &Need, slot: u32, place: [f64; 2]) -> Option<(Symmetric2, usize)> {
    let birth = state.landmarks.birth(slot);
    (!state.given.is_sure(birth)).then(|| need.relation(state.given.clan(birth), place))
}

/// Where the map has the landmark that a sighting names, and where the best particle sees it.
pub(super) fn misplaced<M: Placing>(setup: &Setup<M>, state: &State, sighting: &ScanSighting) -> Option<Misplaced> {
    let (identity, slot) = (sighting.identity?, state.landmarks.named(sighting)?);
    let best = state.particles.best();
    let (held, _) = state.landmarks.held_by(best, slot)?;
    let belief = state.belief_of(setup.settings.config.algorithm, best);
    let (model, T_robot_sensor, measured) =
        (setup.models.measurement(), setup.models.T_robot_sensor, &sighting.measured);
    let shown = shown(model, belief.mean.compose(T_robot_sensor), measured, held.mean);
    let misfit = Misplaced::new(identity, (held.mean, held.covariance), (shown.mean, shown.covariance));
    let drift = need_of(state).and_then(|need| Some((need, relation(state, need, slot, held.mean)?)));
    let turn = drift.and_then(|(need, (drift, ago))| {
        let c = held.covariance;
        let covariance = Symmetric2::new(c.xx + drift.xx, c.xy + drift.xy, c.yy + drift.yy);
        let fit = belief.fit(model, T_robot_sensor, &Gaussian { covariance, ..held }, measured);
        let explains = fit.mahalanobis_squared <= IMPLAUSIBLE * state.diagnosis.watch.noise.usual_excess();
        explains.then(|| need.drift.of_heading(need.drift.steps().saturating_sub(ago + 1)))
    });
    Some(Misplaced { turn, ..misfit })
}

/// Where a sighting shows a landmark that the map has here: what is not measured is as that has it.
pub(crate) fn shown<M: Placing>(model: &M, sensor: Pose, measured: &Measured, held_m: [f64; 2]) -> Gaussian {
    let value = model.completed(measured.value, model.expected(sensor, held_m));
    if model.places() {
        return first_sighting(model, sensor, value, measured.noise);
    }
    let variance = model.position_variance(value, measured.noise);
    Gaussian { mean: model.inverse(sensor, value), covariance: Symmetric2::new(variance, 0.0, variance) }
}
