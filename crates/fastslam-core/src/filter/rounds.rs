//! A scan in rounds that see each identity once at most: what stands around the steps of the algorithm.

use super::estimate::estimate_beliefs;
use super::imagine::{imagine, report_errors};
use super::names::doubt_names;
use super::propose::{keeps_motion_pending, propose};
use super::rejuvenation::{draw_in_place, draws_in_place, leave_draw, rejuvenation_is_due, remember_step, thin_past};
use super::remember::see_named;
use super::returns::note_returns;
use super::settings::Algorithm;
use super::setup::Setup;
use super::state::State;
use super::step::{step, step_fused};
use super::usable::usable;
use super::weigh::normalize;
use super::work::{Moment, Work};
use super::StepInfo;
use crate::association::{Identities, ScanSighting};
use crate::diagnosis::health::Vitals;
use crate::error::Result;
use crate::limits::LARGEST_STATE;
use crate::measurement::Placing;
use crate::motion::MotionByNoise;
use crate::sighting::{deal, Sighting, Skipped};
use crate::step_info::NoiseInWindow;

/// The usable sightings of one stamp, each identity once at most in each round.
pub(super) struct Rounds<'a> {
    pub stamp_s: f64,
    pub rounds: &'a mut [Vec<ScanSighting>],
    /// How far the scan has been taken in.
    pub progress: Progress,
}

/// How far a scan has been taken in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Progress {
    /// Not at all.
    New,
    /// The watch knows of it.
    Begun,
}

/// Parts the usable sightings into scans that see each identity once at most; returns how many there are, one at least.
pub(super) fn fill_rounds<M: Placing>(
    setup: &Setup<M>,
    rounds: &mut Vec<Vec<ScanSighting>>,
    sightings: &[Sighting],
    skipped: &mut Skipped,
) -> usize {
    let (sensor, identities) = (&setup.settings.config.sensor, setup.settings.identities);
    let usable = usable(sensor, identities, setup.models.measurement(), sightings, skipped);
    deal(rounds, usable, |sighting| sighting.identity)
}

/// Processes the rounds of a scan.
pub(super) fn process_rounds<M: Placing>(
    setup: &Setup<M>,
    state: &mut State,
    work: &mut Work,
    Rounds { stamp_s, rounds, progress }: Rounds<'_>,
    info: &mut StepInfo,
) -> Result<()> {
    let names_known = setup.settings.identities == Identities::All;
    work.seen.clear();
    work.imagining.shown.clear();
    if names_known {
        rounds.iter_mut().for_each(|round| doubt_names(setup, state, &mut work.seen, round, info));
        note_returns(setup, state, rounds);
    }
    info.sightings = rounds.iter().map(|round| round.len() as u32).sum();
    if progress == Progress::New {
        state.diagnosis.watch.begin(stamp_s, info.sightings);
    }
    let births_before = state.landmarks.births();
    // The names of a whole round may have been doubted.
    info.sampling.sampled = !rounds.iter().all(|round| keeps_motion_pending(setup, state, round));
    rounds.iter().try_for_each(|round| process(setup, state, work, round, info))?;
    if names_known {
        see_named(setup, state, (rounds, births_before), &mut work.seen);
    }
    if info.sampling.sampled {
        let particles = &state.particles;
        state.path.extend(stamp_s, &setup.workers, |i| particles.pose(i));
        if let Some(motion) = remember_step(setup, state) {
            imagine(setup, state, &mut work.imagining, &motion);
            thin_past(setup, state);
        }
    }
    let is_due = info.sampling.sampled && rejuvenation_is_due(setup, state);
    if is_due && draws_in_place(state) {
        draw_in_place(setup, state, work, info);
    }
    info.landmarks = state.particles.landmarks[state.particles.best()];
    judge_health(setup, state, work, Before { stamp_s, births: births_before }, info);
    report_errors(state);
    state.counters.steps += 1;
    if is_due && !draws_in_place(state) {
        leave_draw(state, work, Moment::AfterScan);
    }
    Ok(())
}

/// One scan with at most one sighting per identity.
fn process<M: Placing>(
    setup: &Setup<M>,
    state: &mut State,
    work: &mut Work,
    scan: &[ScanSighting],
    info: &mut StepInfo,
) -> Result<()> {
    match (setup.settings.config.algorithm, setup.settings.identities) {
        _ if keeps_motion_pending(setup, state, scan) => {
            normalize(state, info)?;
            propose(setup, state, &mut work.beliefs);
            estimate_beliefs(state, &work.beliefs);
            Ok(())
        }
        (Algorithm::Fastslam1, Identities::All) => step_fused(setup, state, work, scan, info),
        _ => step(setup, state, work, scan, info),
    }
}

/// When a scan was made, and how many landmarks had been born before it.
struct Before {
    stamp_s: f64,
    births: u64,
}

/// Gives the verdict on a step.
fn judge_health<M: Placing>(setup: &Setup<M>, state: &mut State, work: &mut Work, before: Before, info: &mut StepInfo) {
    let watch = &mut state.diagnosis.watch;
    info.sampling.particles = state.particles.len() as u32;
    info.matched = watch.matches() as u32;
    if watch.noise.is_report_due() {
        state.diagnosis.noise_report = watch.noise.of_window();
    }
    if info.sightings > 0 {
        state.motions.since_scan = MotionByNoise::default();
    }
    info.noise = NoiseInWindow::from(&state.diagnosis.noise_report);
    let vitals = Vitals {
        stamp_s: before.stamp_s,
        particles: state.particles.len(),
        effective_sample_size: info.weighing.effective_sample_size,
        T_world_robot: state.estimate.mean,
        pose_covariance: state.estimate.covariance,
        births_before: before.births,
        names_known: setup.settings.identities == Identities::All,
        places: setup.models.measurement().places(),
        map_in_view: work.map_in_view.take(),
    };
    let model = setup.models.measurement();
    info.health = watch.judge(&vitals, |sensor, value| model.inverse(sensor, value));
}

/// After a scan to which a measurement model of one's own left no particle any weight: what the scan did to weights is
/// undone by forgetting them all, and what it did to maps by forgetting the landmarks that it made unusable.
pub(super) fn start_anew_with_weights<M>(setup: &Setup<M>, state: &mut State, work: &mut Work) {
    state.particles.log_weight.fill(0.0);
    state.particles.score.fill(0.0);
    state.weights.restart(state.particles.len());
    let mut row = vec![0.0; state.landmarks.columns()];
    for slot in state.landmarks.live_slots() {
        let holders: Vec<usize> =
            (0..state.particles.len()).filter(|i| state.landmarks.read_row(slot, *i, &mut row)).collect();
        if state.landmarks.read(slot).is_within(LARGEST_STATE) {
            continue;
        }
        holders.into_iter().for_each(|i| state.particles.landmarks[i] -= 1);
        state.landmarks.remove(slot);
    }
    propose(setup, state, &mut work.beliefs);
    estimate_beliefs(state, &work.beliefs);
}
