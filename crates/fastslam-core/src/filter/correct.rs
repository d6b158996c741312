//! What a scan does to the landmarks of the maps, given the poses: corrections, and new ones.

use super::existence::initial_log_odds;
use super::setup::Setup;
use super::state::{Maps, State};
use super::work::{Associating, Correcting, Work};
use super::StepInfo;
use crate::association::{Decision, ExistenceForm, Identities, ScanSighting};
use crate::landmark::{column, first_rows, Correction, SensorPoses};
use crate::measurement::Placing;
use crate::store::RowsMut;
use crate::workers::PART;
use std::sync::atomic::{AtomicU32, Ordering::Relaxed};

/// Notes where the sensor is in every particle.
pub(super) fn place_sensors<M>(setup: &Setup<M>, state: &State, work: &mut Work) {
    let particles = &state.particles;
    let sensor_poses = &mut work.correcting.sensor_poses;
    sensor_poses.set(&particles.x, &particles.y, &particles.heading, setup.models.T_robot_sensor);
}

/// Corrects the landmarks that the sightings are claimed for, and founds those that are new.
///
/// **Source:** `montemerlo2002fastslam`, section 3.2; `montemerlo2003fastslam`, eq. 17, at the sampled pose.
pub(super) fn correct<M: Placing>(
    setup: &Setup<M>,
    state: &mut State,
    work: &mut Work,
    scan: &[ScanSighting],
    info: &mut StepInfo,
) {
    work.correcting.first_birth = state.landmarks.births();
    if setup.settings.identities == Identities::All {
        correct_named(setup, state, work, scan, info);
    } else {
        correct_decided(setup, state, work, scan, info);
    }
}

/// Corrects or founds the same landmark in all maps; the likelihoods of the sightings add up.
fn correct_named<M: Placing>(
    setup: &Setup<M>,
    state: &mut State,
    work: &mut Work,
    scan: &[ScanSighting],
    info: &mut StepInfo,
) {
    let Work { associating, correcting, log_likelihood, .. } = work;
    let Correcting { sensor_poses, rows, .. } = correcting;
    let mut corrector = Corrector { setup, maps: state.maps(), sensor_poses, rows, log_likelihood };
    for (sighting, slot) in scan.iter().zip(&mut associating.named) {
        if let Some(slot) = *slot {
            info.repaired += corrector.correct(slot, sighting, None);
        } else {
            *slot = Some(corrector.found(sighting, None));
            info.changes.new_landmarks += 1;
        }
    }
}

/// Corrects, founds or leaves landmarks as every particle decided.
fn correct_decided<M: Placing>(
    setup: &Setup<M>,
    state: &mut State,
    work: &mut Work,
    scan: &[ScanSighting],
    info: &mut StepInfo,
) {
    let best = state.particles.best();
    prepare(setup, state.particles.len(), work);
    let Work { associating, correcting, log_likelihood, .. } = work;
    let Associating { table, decisions, decided, .. } = associating;
    let Correcting { sensor_poses, mask, rows, births, founded, sighting_densities, .. } = correcting;
    let mut corrector = Corrector { setup, maps: state.maps(), sensor_poses, rows, log_likelihood };
    for (j, sighting) in scan.iter().enumerate() {
        births.push(corrector.maps.landmarks.births());
        decided.clear();
        decided.extend(decisions.iter().skip(j).step_by(scan.len()).map(Decision::number));
        for &candidate in &table.of_sighting[j] {
            if mark(decided, candidate, mask) {
                corrector.forget_likelihoods(mask.len());
                info.repaired += corrector.correct(table.slots[candidate as usize], sighting, Some(mask));
                note_densities(corrector.log_likelihood, mask, candidate, sighting_densities);
            }
        }
        if mark(decided, Decision::New.number(), mask) {
            founded.push((j, corrector.found(sighting, Some(mask))));
            info.changes.new_landmarks += 1;
        }
        info.left_out.ignored += u32::from(decided[best] == Decision::Ignored.number());
    }
}

/// Forgets what the scan before has founded, and makes room for how likely the sightings of the candidates are where
/// existence follows Bayes' rule.
fn prepare<M>(setup: &Setup<M>, particles: usize, work: &mut Work) {
    let Correcting { births, founded, sighting_densities, .. } = &mut work.correcting;
    births.clear();
    founded.clear();
    // Only what is noted of a scan is looked at: what is left of the one before does no harm.
    let is_wanted = setup.settings.config.association.existence.form == ExistenceForm::Bayes;
    sighting_densities.resize(if is_wanted { work.associating.table.slots.len() * particles } else { 0 }, 0.0);
}

/// Marks the particles that decided so, where there are any; whether there are.
fn mark(decided: &[u32], so: u32, mask: &mut Vec<bool>) -> bool {
    // Most candidates are nobody's: that is seen sooner than marked.
    let is_any = decided.iter().fold(false, |any, d| any | (*d == so));
    if is_any {
        mask.clear();
        mask.extend(decided.iter().map(|d| *d == so));
    }
    is_any
}

/// Notes how likely the sighting of a candidate was, where there is room for it.
fn note_densities(log_likelihood: &[f64], mask: &[bool], candidate: u32, densities: &mut [f64]) {
    if let Some(densities) = densities.get_mut(candidate as usize * mask.len()..).filter(|rest| !rest.is_empty()) {
        let chosen = (0..mask.len()).filter(|i| mask[*i]);
        chosen.for_each(|i| densities[i] = log_likelihood[i]);
    }
}

/// The maps with what changing a landmark in them needs.
struct Corrector<'a, M> {
    setup: &'a Setup<M>,
    maps: Maps<'a>,
    sensor_poses: &'a SensorPoses,
    /// Rows of one landmark, kept for their memory.
    rows: &'a mut Vec<f64>,
    /// Of the sightings since it was cleared, per particle.
    log_likelihood: &'a mut Vec<f64>,
}

impl<M: Placing> Corrector<'_, M> {
    fn forget_likelihoods(&mut self, particles: usize) {
        self.log_likelihood.clear();
        self.log_likelihood.resize(particles, 0.0);
    }

    /// Corrects a landmark in the maps that `mask` marks (all without one) and adds the log-likelihoods of the sighting;
    /// returns in how many maps it had to be repaired.
    fn correct(&mut self, slot: u32, sighting: &ScanSighting, mask: Option<&[bool]>) -> u32 {
        if self.maps.is_fixed(slot) {
            self.weigh_fixed(slot, sighting, mask);
            return 0;
        }
        let name = self.name_to_learn(sighting);
        let Self { setup, maps, sensor_poses, log_likelihood, .. } = self;
        let (model, poses) = (setup.models.measurement(), *sensor_poses);
        let correction = Correction { model, poses, measured: sighting.measured, mask };
        let repaired = AtomicU32::new(0);
        maps.landmarks.update(slot, mask, |mut rows| {
            if let (Some(name), Some(mask)) = (name, mask) {
                write_name(name, mask, rows.column(column::IDENTITY));
            }
            let whole = (rows.columns(), log_likelihood.as_mut_slice());
            setup.workers.share(whole, PART, &|first, (rows, log_likelihood)| {
                repaired.fetch_add(correction.apply(first, rows, log_likelihood), Relaxed);
            });
        });
        if let Some(name) = name {
            maps.landmarks.mark_identity(slot, name);
        }
        self.learn_appearance(slot, sighting, mask);
        repaired.into_inner()
    }

    /// Founds a landmark in the maps that `mask` marks (all without one); returns its slot.
    fn found(&mut self, sighting: &ScanSighting, mask: Option<&[bool]>) -> u32 {
        let (name, particles) = (self.name_to_learn(sighting), self.maps.particles.len());
        let Self { setup, maps, sensor_poses, rows, .. } = self;
        let columns = maps.landmarks.columns();
        let (model, poses, measured) = (setup.models.measurement(), sensor_poses, sighting.measured);
        first_rows(&Correction { model, poses, measured, mask }, columns, rows);
        if let (Some(name), Some(mask)) = (name, mask) {
            write_name(name, mask, &mut rows[column::IDENTITY * particles..]);
        }
        let slot = maps.landmarks.insert(sighting.identity, rows, initial_log_odds(&setup.settings));
        let counts = maps.particles.landmarks.iter_mut().enumerate();
        counts.for_each(|(i, count)| *count += u32::from(mask.is_none_or(|mask| mask[i])));
        self.learn_appearance(slot, sighting, mask);
        slot
    }

    /// Adds the log-likelihoods of a sighting of a landmark that stays as it is.
    fn weigh_fixed(&mut self, slot: u32, sighting: &ScanSighting, mask: Option<&[bool]>) {
        let Self { setup, maps, sensor_poses, rows, log_likelihood } = self;
        rows.resize(sensor_poses.x.len() * maps.landmarks.columns(), 0.0);
        maps.landmarks.copy_rows(slot, rows);
        let (model, poses) = (setup.models.measurement(), *sensor_poses);
        let correction = Correction { model, poses, measured: sighting.measured, mask };
        // Only the likelihoods count; the corrected rows are dropped.
        correction.apply(0, RowsMut::new(rows, poses.x.len()).columns(), log_likelihood);
    }

    /// The name that a landmark gets from a sighting where only some have one: maps may differ in it.
    fn name_to_learn(&self, sighting: &ScanSighting) -> Option<u32> {
        sighting.identity.filter(|_| self.maps.landmarks.columns() > column::IDENTITY)
    }

    fn learn_appearance(&mut self, slot: u32, sighting: &ScanSighting, mask: Option<&[bool]>) {
        let particles = self.maps.particles.len();
        let Some(appearances) = &mut self.maps.landmarks.appearances else { return };
        match mask {
            Some(mask) => appearances.learn(slot, mask, sighting.appearance),
            None => appearances.learn(slot, &vec![true; particles], sighting.appearance),
        }
    }
}

/// Writes a name into the column of names where `mask` says so.
fn write_name(name: u32, mask: &[bool], column: &mut [f64]) {
    column.iter_mut().zip(mask).filter(|(_, marked)| **marked).for_each(|(mark, _)| *mark = f64::from(name) + 1.0);
}
