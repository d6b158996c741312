//! Which landmark each sighting shows: the same in all maps where it is named, else as every particle decides; with what
//! that says of the pose and of the weight.

use super::beginning::refuse_foundings;
use super::beliefs::{belief_in, set_belief_in, Beliefs, Refinement};
use super::doubtful::{self, explain_by_doubtful, set_doubtful_aside};
use super::doubts;
use super::existence::detection_odds;
use super::extent::Extent;
use super::landmarks::Landmarks;
use super::propose::propose;
use super::rejuvenation::{draw_in_place, draws_in_place, leave_draw};
use super::setup::{Settings, Setup};
use super::state::State;
use super::weigh::clear_log_likelihood;
use super::work::{Associating, Moment, Work};
use super::StepInfo;
use crate::association::{
    decide, decide_assignment, decide_joint, decide_sampled, fast, Box2, CandidateTable, Candidates, Decision,
    FitTable, Hypothesis, Identities, Method, Outcome, ParticleHypothesis, Rules, Sampler, ScanSighting, Scratch,
};
use crate::landmark::Measured;
use crate::measurement::Placing;
use crate::random::{Purpose, Stream};
use crate::workers::{Shares, PART};
use std::sync::atomic::{AtomicU32, Ordering::Relaxed};

/// Claims the sightings of a scan for landmarks, refines the beliefs by them and says how likely each particle makes
/// the scan.
///
/// **Source:** `montemerlo2002fastslam`, eqs. 14 and 15, for sightings without a name; `montemerlo2003fastslam`, eqs.
/// 9–15, for the beliefs.
pub(super) fn associate<M: Placing>(
    setup: &Setup<M>,
    state: &mut State,
    work: &mut Work,
    scan: &[ScanSighting],
    info: &mut StepInfo,
) {
    if setup.settings.identities == Identities::All {
        clear_log_likelihood(state, work);
        list_named(&state.landmarks, scan, &mut work.associating.named);
        return refine_by_names(setup, state, work, scan);
    }
    find_candidates(setup, state, work, scan);
    let mut doubts = doubts::about(setup, state, &work.associating.table);
    if doubts::ask_for_draw(setup, state, &doubts) {
        if draws_in_place(state) {
            draw_in_place(setup, state, work, info);
            propose(setup, state, &mut work.beliefs);
            find_candidates(setup, state, work, scan);
            doubts = doubts::about(setup, state, &work.associating.table);
        } else {
            leave_draw(state, work, Moment::BeforeScan);
        }
    }
    doubts::strike_out(&doubts, &work.beliefs, &state.landmarks, scan, &mut work.associating.table);
    set_doubtful_aside(state, &mut work.associating);
    clear_log_likelihood(state, work);
    info.fell_back += decide_all(setup, state, work, scan);
    refuse_foundings(setup, &state.given, &work.beliefs, scan, &mut work.associating.decisions);
}

/// The slot of the landmark that each sighting names; none where it is new.
pub(super) fn list_named(landmarks: &Landmarks, scan: &[ScanSighting], named: &mut Vec<Option<u32>>) {
    named.clear();
    named.extend(scan.iter().map(|sighting| landmarks.named(sighting)));
}

/// Refines the beliefs of all particles by the sightings of known landmarks.
fn refine_by_names<M: Placing>(setup: &Setup<M>, state: &mut State, work: &mut Work, scan: &[ScanSighting]) {
    let (model, T_robot_sensor) = (setup.models.measurement(), setup.models.T_robot_sensor);
    for (sighting, slot) in scan.iter().zip(&work.associating.named) {
        let Some(slot) = slot else { continue };
        let rows = state.landmarks.read(*slot);
        let refinement = Refinement { model, T_robot_sensor, measured: &sighting.measured, rows };
        let whole = (work.beliefs.columns_mut(), work.log_likelihood.as_mut_slice());
        setup.workers.share(whole, PART, &|first, (beliefs, log_likelihood)| {
            refinement.apply(first, beliefs, log_likelihood);
        });
    }
}

/// The landmarks that some particle might see in each sighting, with their rows.
fn find_candidates<M: Placing>(setup: &Setup<M>, state: &mut State, work: &mut Work, scan: &[ScanSighting]) {
    let Work { beliefs, associating, .. } = work;
    let Associating { table, slots, .. } = associating;
    let landmarks = &mut state.landmarks;
    let extent = Extent::of(beliefs, setup.models.T_robot_sensor);
    table.clear(scan.len());
    (table.particles, table.columns) = (state.particles.len(), landmarks.columns());
    let size = table.particles * table.columns;
    slots.clear();
    for (sighting, found) in scan.iter().zip(&mut table.of_sighting) {
        let region = region_of(setup, beliefs, &extent, sighting.measured);
        landmarks.find(&region, found);
        if let Some(identity) = sighting.identity {
            found.extend_from_slice(landmarks.of_identity(identity));
        }
        slots.extend_from_slice(found);
    }
    slots.sort_unstable_by_key(|slot| landmarks.birth(*slot));
    slots.dedup();
    for &slot in &*slots {
        if landmarks.holders(slot) == 0 {
            landmarks.remove(slot);
            continue;
        }
        // What stands there from the scan before is written over: zeros would be written for nothing.
        let begin = table.slots.len() * size;
        table.values.resize(table.values.len().max(begin + size), 0.0);
        landmarks.expect_reads(slot);
        landmarks.copy_rows(slot, &mut table.values[begin..][..size]);
        table.slots.push(slot);
    }
    table.number_candidates();
}

/// Where a sighted landmark can be in any map.
fn region_of<M: Placing>(setup: &Setup<M>, beliefs: &Beliefs, extent: &Extent, measured: Measured) -> Box2 {
    let (model, T_robot_sensor) = (setup.models.measurement(), setup.models.T_robot_sensor);
    let reach = [setup.settings.gate_radius, setup.models.lever_arm_m];
    let around = |measured: &Measured| {
        let region = extent.region_of(model, measured, reach);
        region.unwrap_or_else(|| beliefs.region_of(model, T_robot_sensor, measured, reach))
    };
    if model.places() {
        return around(&measured);
    }
    model.extremes(measured.value).into_iter().fold(Box2::EMPTY, |mut all, value| {
        let region = around(&Measured { value, ..measured });
        all.include(region.low, 0.0);
        all.include(region.high, 0.0);
        all
    })
}

/// Every particle's decisions (an equal share each), with its belief refined by them; then those for landmarks that may
/// not exist. Returns how many particles fell back to a simpler method.
fn decide_all<M: Placing>(setup: &Setup<M>, state: &mut State, work: &mut Work, scan: &[ScanSighting]) -> u32 {
    let decisions = &mut work.associating.decisions;
    decisions.clear();
    decisions.resize(state.particles.len() * scan.len(), Decision::Ignored);
    if scan.is_empty() {
        return 0;
    }
    let rules = doubtful::rules(setup, &state.landmarks);
    let stream = setup.settings.random.stream(Purpose::Association, state.counters.samplings);
    gather_evidence(&setup.settings, &mut state.landmarks, scan, &mut work.associating);
    let mut fell_back = 0;
    if fast::applies(rules.method, scan) {
        decide_together(setup, &rules, stream, work, scan);
    } else {
        let Associating { table, fits, .. } = &mut work.associating;
        fill_fits(setup, (&work.beliefs, scan), table, fits);
        fell_back = decide_each(setup, &rules, stream, work, scan);
    }
    explain_by_doubtful(setup, &work.beliefs, &mut work.associating, scan);
    fell_back
}

/// Decisions of blocks of particles, in passes of vector code.
fn decide_together<M: Placing>(
    setup: &Setup<M>,
    rules: &Rules,
    stream: Stream,
    work: &mut Work,
    scan: &[ScanSighting],
) {
    let (model, T_robot_sensor) = (setup.models.measurement(), setup.models.T_robot_sensor);
    let Work { associating, beliefs, log_likelihood, .. } = work;
    let Associating { table, fits, deciding, decisions, .. } = associating;
    let (table, evidence, deciding) = (&*table, &fits.evidence, &*deciding);
    let question = fast::Question { rules, model, T_robot_sensor, scan, table, evidence, stream };
    let whole = (beliefs.columns_mut(), Shares { entries: decisions, each: scan.len() }, log_likelihood.as_mut_slice());
    setup.workers.share(whole, fast::BLOCK, &|first, (beliefs, decisions, log_likelihood)| {
        let answers = fast::Answers { beliefs, decisions: decisions.entries, log_likelihood };
        deciding.with(|(workspace, _)| fast::decide_block(&question, first, answers, workspace));
    });
}

/// How well every candidate fits in every map.
fn fill_fits<M: Placing>(
    setup: &Setup<M>,
    (beliefs, scan): (&Beliefs, &[ScanSighting]),
    table: &CandidateTable,
    fits: &mut FitTable,
) {
    let (model, T_robot_sensor) = (setup.models.measurement(), setup.models.T_robot_sensor);
    fits.fill(table, |j, candidate, log_likelihood, distance| {
        let columns = [log_likelihood, distance];
        beliefs.fit(model, T_robot_sensor, &scan[j].measured, &table.rows(candidate), columns);
    });
}

/// What speaks for each pair beside the place: appearance, and the odds of a detection.
fn gather_evidence(
    settings: &Settings,
    landmarks: &mut Landmarks,
    scan: &[ScanSighting],
    Associating { table, fits, .. }: &mut Associating,
) {
    fits.evidence.clear();
    let (n, Landmarks { existence, appearances, .. }) = (table.particles, landmarks);
    let odds = detection_odds(settings, existence, &table.slots);
    if appearances.is_none() && odds.is_none() {
        return;
    }
    fits.evidence.gather(table, |j, candidate, evidence| {
        let slot = table.slots[candidate as usize];
        if let Some(odds) = odds {
            evidence.copy_from_slice(&odds[candidate as usize * n..][..n]);
        }
        if let Some(appearances) = &mut *appearances {
            appearances.add_evidence(slot, scan[j].appearance, evidence);
        }
    });
}

/// Decisions of the particles one by one; returns how many fell back to a simpler method.
fn decide_each<M: Placing>(
    setup: &Setup<M>,
    rules: &Rules,
    stream: Stream,
    work: &mut Work,
    scan: &[ScanSighting],
) -> u32 {
    let (model, T_robot_sensor) = (setup.models.measurement(), setup.models.T_robot_sensor);
    let Work { associating, beliefs, log_likelihood, .. } = work;
    let Associating { table, fits, deciding, decisions, .. } = associating;
    let (table, fits, deciding, fell_back) = (&*table, &*fits, &*deciding, AtomicU32::new(0));
    let among = Candidates { scan, of_sighting: &table.of_sighting };
    let whole = (beliefs.columns_mut(), Shares { entries: decisions, each: scan.len() }, log_likelihood.as_mut_slice());
    setup.workers.share(whole, fast::BLOCK, &|first, (mut beliefs, decisions, log_likelihood)| {
        let shares = decisions.entries.chunks_exact_mut(scan.len());
        for (i, (mine, increment)) in shares.zip(log_likelihood).enumerate() {
            let (belief, particle) = (belief_in(&beliefs, i), first + i);
            let mut one = ParticleHypothesis { model, T_robot_sensor, table, fits, particle, belief, refined: None };
            let draw = |j: usize| stream.uniform(particle as u32, j as u32);
            let outcome =
                deciding.with(|(_, scratch)| explain(&Sampler { rules, draw }, among, &mut one, scratch, mine));
            *increment = outcome.log_weight;
            fell_back.fetch_add(u32::from(outcome.fell_back), Relaxed);
            if let Some((refined, _)) = one.refined {
                set_belief_in(&mut beliefs, i, &refined);
            }
        }
    });
    fell_back.into_inner()
}

/// Decides about a scan for one hypothesis by the configured method.
fn explain<H: Hypothesis + Clone>(
    sampler: &Sampler<'_, impl Fn(usize) -> f64>,
    among: Candidates<'_>,
    hypothesis: &mut H,
    scratch: &mut Scratch,
    decisions: &mut [Decision],
) -> Outcome {
    let rules = sampler.rules;
    let log_weight = match rules.method {
        Method::MaximumLikelihood => decide(rules, among, hypothesis, scratch, decisions),
        Method::Sampled => decide_sampled(sampler, among, hypothesis, scratch, decisions),
        Method::Assignment => decide_assignment(rules, among, hypothesis, scratch, decisions),
        Method::Joint => return decide_joint(rules, among, hypothesis, scratch, decisions),
    };
    Outcome { log_weight, fell_back: false }
}
