//! Steps in which particles decide which landmark a sighting shows.

use super::beliefs::{belief_in, set_belief_in};
use super::extent::Extent;
use super::scan_methods::explain;
use super::{FastSlam, Particles, StepInfo};
use crate::association::{fast, CandidateTable, Decision, ParticleHypothesis};
use crate::config::{Algorithm, ExistenceForm, MergingRule, Method};
use crate::error::Result;
use crate::landmark::{column, first_rows, Correction};
use crate::measurement::MeasurementModel;
use crate::motion::MotionGaussian;
use crate::random::Purpose;
use crate::workers::{Shares, PART};
use std::sync::atomic::{AtomicU32, Ordering::Relaxed};

pub(super) use crate::association::ScanSighting;

impl<M: MeasurementModel> FastSlam<M> {
    /// One scan with unknown identities: associate and weigh, resample, sample the poses, correct the landmarks.
    ///
    /// **Source:** `montemerlo2002fastslam`, eqs. 14 and 15; `montemerlo2003fastslam`, section 4. In FastSLAM 1.0 the
    /// poses are samples already, and the beliefs about them have no spread.
    pub(super) fn step_associating(&mut self, scan: &[ScanSighting], info: &mut StepInfo) -> Result<()> {
        self.believe();
        let mut table = std::mem::take(&mut self.table);
        self.find_candidates(scan, &mut table);
        let mut decisions = std::mem::take(&mut self.decisions);
        self.decide(scan, &table, &mut decisions, info);
        self.examine_decided(scan, &decisions, &table);
        self.weigh_resample_sample(&mut decisions, info)?;
        let first_birth = self.landmarks.births();
        self.founded.clear();
        self.sighting_densities.clear();
        if self.config.association.existence.form == ExistenceForm::Bayes {
            self.sighting_densities.resize(table.slots.len() * self.particles.len(), 0.0);
        }
        let (mut decided, mut births) = (std::mem::take(&mut self.decided), std::mem::take(&mut self.births));
        births.clear();
        for (j, sighting) in scan.iter().enumerate() {
            births.push(self.landmarks.births());
            decided.clear();
            decided.extend(decisions.iter().skip(j).step_by(scan.len()).map(Decision::number));
            self.correct_decided((j, sighting), &decided, &table, info);
        }
        self.remember_decided(scan, &decisions, &table, &births);
        if self.judges_existence() && !scan.is_empty() {
            self.judge_existence(&decisions, &table, first_birth, info);
        }
        if self.config.association.merging.rule != MergingRule::Never && !scan.is_empty() {
            self.merge_duplicates(&decisions, &table, first_birth, info);
        }
        (self.table, self.decisions, self.decided, self.births) = (table, decisions, decided, births);
        Ok(())
    }

    /// Every particle's decisions (an equal share each), with its belief refined and its weight changed by them.
    fn decide(
        &mut self,
        scan: &[ScanSighting],
        table: &CandidateTable,
        decisions: &mut Vec<Decision>,
        info: &mut StepInfo,
    ) {
        decisions.clear();
        decisions.resize(self.particles.len() * scan.len(), Decision::Ignored);
        if scan.is_empty() {
            return;
        }
        self.log_likelihood.clear();
        self.log_likelihood.resize(self.particles.len(), 0.0);
        if self.decides_by_place_alone() && fast::applies(scan) {
            self.decide_together(scan, table, decisions);
        } else {
            info.fell_back += self.decide_each(scan, table, decisions);
        }
        for (i, increment) in self.log_likelihood.iter().enumerate() {
            self.particles.log_weight[i] += increment;
            self.particles.score[i] += increment;
        }
    }

    /// Decisions of blocks of particles, in passes of vector code.
    fn decide_together(&mut self, scan: &[ScanSighting], table: &CandidateTable, decisions: &mut [Decision]) {
        let Self { model, rules, deciding, beliefs, log_likelihood, .. } = self;
        let question = fast::Question { rules, model, T_robot_sensor: self.T_robot_sensor, scan, table };
        let whole =
            (beliefs.columns_mut(), Shares { entries: decisions, each: scan.len() }, log_likelihood.as_mut_slice());
        self.workers.share(whole, fast::BLOCK, &|first, (beliefs, decisions, log_likelihood)| {
            let answers = fast::Answers { beliefs, decisions: decisions.entries, log_likelihood };
            deciding.with(|(workspace, _)| fast::decide_block(&question, first, answers, workspace));
        });
    }

    /// Decisions of the particles one by one; returns how many fell back to a simpler method.
    fn decide_each(&mut self, scan: &[ScanSighting], table: &CandidateTable, decisions: &mut [Decision]) -> u32 {
        let (model, T_robot_sensor) = (&self.model, self.T_robot_sensor);
        let beliefs = &self.beliefs;
        self.fits.fill(table, |j, candidate, log_likelihood, distance| {
            let columns = [log_likelihood, distance];
            beliefs.fit(model, T_robot_sensor, &scan[j].measured, &table.rows(candidate), columns);
        });
        self.gather_evidence(scan, table);
        let stream = self.random.stream(Purpose::Association, self.samplings);
        let Self { model, rules, deciding, beliefs, log_likelihood, fits, .. } = self;
        let (model, fits, fell_back) = (&*model, &*fits, AtomicU32::new(0));
        let whole =
            (beliefs.columns_mut(), Shares { entries: decisions, each: scan.len() }, log_likelihood.as_mut_slice());
        self.workers.share(whole, fast::BLOCK, &|first, (mut beliefs, decisions, log_likelihood)| {
            let shares = decisions.entries.chunks_exact_mut(scan.len());
            for (i, (mine, increment)) in shares.zip(log_likelihood).enumerate() {
                let (belief, particle) = (belief_in(&beliefs, i), first + i);
                let mut one =
                    ParticleHypothesis { model, T_robot_sensor, table, fits, particle, belief, refined: None };
                let draw = |j: usize| stream.uniform(particle as u32, j as u32);
                let outcome = deciding
                    .with(|(_, scratch)| explain(rules, (scan, &table.of_sighting), &mut one, scratch, draw, mine));
                *increment = outcome.log_weight;
                fell_back.fetch_add(u32::from(outcome.fell_back), Relaxed);
                if let Some((refined, _)) = one.refined {
                    set_belief_in(&mut beliefs, i, &refined);
                }
            }
        });
        fell_back.into_inner()
    }

    /// Whether nothing but the place of a landmark says how well it explains a sighting, and the likeliest is taken.
    fn decides_by_place_alone(&self) -> bool {
        self.rules.method == Method::MaximumLikelihood
            && self.landmarks.appearances.is_none()
            && self.config.association.detection_probability.is_none()
    }

    /// What each particle believes about the robot's pose before the scan.
    pub(super) fn believe(&mut self) {
        let Particles { x, y, heading, .. } = &self.particles;
        match self.config.algorithm {
            Algorithm::Fastslam1 => self.beliefs.certain(x, y, heading),
            _ => self.beliefs.predict(x, y, heading, &self.pending),
        }
    }

    /// Normalises the weights, estimates the pose, resamples if needed, and samples the poses from the beliefs.
    ///
    /// `decisions` (an equal share per particle) follow the ancestors like everything else.
    pub(super) fn weigh_resample_sample(&mut self, decisions: &mut Vec<Decision>, info: &mut StepInfo) -> Result<()> {
        let before = self.weights.log_mean;
        self.weights_now()?;
        info.log_likelihood += self.weights.log_mean - before;
        self.estimate_from_beliefs();
        if self.resample_if_needed(info) {
            self.restart_weights();
            let share = decisions.len() / self.beliefs.len();
            self.beliefs.resample(&self.ancestor_indices);
            std::mem::swap(&mut self.former_decisions, decisions);
            decisions.clear();
            for &a in &self.ancestor_indices {
                decisions.extend_from_slice(&self.former_decisions[a as usize * share..][..share]);
            }
        }
        self.sample_poses();
        self.place_sensors();
        Ok(())
    }

    /// Draws every particle's pose from its belief.
    fn sample_poses(&mut self) {
        if self.config.algorithm == Algorithm::Fastslam2 {
            let stream = self.random.stream(Purpose::Proposal, self.samplings);
            let Particles { x, y, heading, .. } = &mut self.particles;
            let (beliefs, whole) = (&self.beliefs, [x, y, heading].map(Vec::as_mut_slice));
            self.workers.share(whole, PART, &|first, poses| beliefs.sample(stream, first, poses));
            self.pending = MotionGaussian::default();
        }
        self.samplings += 1;
    }

    /// Where the sensor is in every particle.
    pub(super) fn place_sensors(&mut self) {
        let particles = &self.particles;
        self.sensor_poses.set(&particles.x, &particles.y, &particles.heading, self.T_robot_sensor);
    }

    /// The landmarks that some particle might see in each sighting, with their rows.
    fn find_candidates(&mut self, scan: &[ScanSighting], table: &mut CandidateTable) {
        let extent = Extent::of(&self.beliefs, self.T_robot_sensor);
        table.clear(scan.len());
        (table.particles, table.columns) = (self.particles.len(), self.landmarks.columns());
        let mut slots = std::mem::take(&mut self.slots);
        slots.clear();
        for (sighting, found) in scan.iter().zip(&mut table.of_sighting) {
            let reach = [self.gate_radius, self.lever_arm_m];
            let region = extent
                .region_of(&self.model, &sighting.measured, reach)
                .unwrap_or_else(|| self.beliefs.region_of(&self.model, self.T_robot_sensor, &sighting.measured, reach));
            self.landmarks.find(&region, found);
            if let Some(identity) = sighting.identity {
                found.extend_from_slice(self.landmarks.of_identity(identity));
            }
            slots.extend_from_slice(found);
        }
        slots.sort_unstable_by_key(|slot| self.landmarks.birth(*slot));
        slots.dedup();
        for &slot in &slots {
            if self.landmarks.holders(slot) == 0 {
                self.landmarks.remove(slot);
                continue;
            }
            self.landmarks.append_rows(slot, &mut table.values);
            table.slots.push(slot);
        }
        self.slots = slots;
        table.number_candidates();
    }

    /// Corrects, creates or leaves landmarks as every particle decided about one sighting.
    fn correct_decided(
        &mut self,
        (j, sighting): (usize, &ScanSighting),
        decided: &[u32],
        table: &CandidateTable,
        info: &mut StepInfo,
    ) {
        let mark = sighting.identity.map(|identity| f64::from(identity) + 1.0);
        let mut mask = std::mem::take(&mut self.mask);
        for &candidate in &table.of_sighting[j] {
            mask.clear();
            mask.extend(decided.iter().map(|d| *d == candidate));
            if !mask.contains(&true) {
                continue;
            }
            let slot = table.slots[candidate as usize];
            let Self { model, sensor_poses: poses, log_likelihood, workers, .. } = self;
            log_likelihood.clear();
            log_likelihood.resize(mask.len(), 0.0);
            let correction =
                Correction { model: &*model, poses: &*poses, measured: sighting.measured, mask: Some(&mask) };
            let repaired = AtomicU32::new(0);
            self.landmarks.update(slot, Some(&mask), |mut rows| {
                if let Some(mark) = mark {
                    let column = rows.column(column::IDENTITY);
                    (0..mask.len()).filter(|i| mask[*i]).for_each(|i| column[i] = mark);
                }
                let whole = (rows.columns(), log_likelihood.as_mut_slice());
                workers.share(whole, PART, &|first, (rows, log_likelihood)| {
                    repaired.fetch_add(correction.apply(first, rows, log_likelihood), Relaxed);
                });
            });
            info.repaired += repaired.into_inner();
            if let Some(identity) = sighting.identity {
                self.landmarks.mark_identity(slot, identity);
            }
            if let Some(appearances) = &mut self.landmarks.appearances {
                appearances.learn(slot, &mask, sighting.appearance);
            }
            if self.config.association.existence.form == ExistenceForm::Bayes {
                let densities = &mut self.sighting_densities[candidate as usize * mask.len()..][..mask.len()];
                let chosen = (0..mask.len()).filter(|i| mask[*i]);
                chosen.for_each(|i| densities[i] = self.log_likelihood[i]);
            }
        }
        mask.clear();
        mask.extend(decided.iter().map(|d| *d == Decision::New.number()));
        if mask.contains(&true) {
            let slot = self.create_where(&mask, sighting);
            self.founded.push((j, slot));
            info.new_landmarks += 1;
        }
        self.mask = mask;
        info.ignored += u32::from(decided[self.particles.best()] == Decision::Ignored.number());
    }

    /// Creates a landmark in the maps that `mask` marks; returns its slot.
    fn create_where(&mut self, mask: &[bool], sighting: &ScanSighting) -> u32 {
        let columns = self.landmarks.columns();
        first_rows(&self.model, &self.sensor_poses, sighting.measured, Some(mask), columns, &mut self.scratch);
        if let (Some(identity), true) = (sighting.identity, columns > column::IDENTITY) {
            let marks = &mut self.scratch[column::IDENTITY * mask.len()..];
            marks.iter_mut().zip(mask).filter(|(_, new)| **new).for_each(|(mark, _)| *mark = f64::from(identity) + 1.0);
        }
        let log_odds = self.initial_log_odds();
        let slot = self.landmarks.insert(sighting.identity, &self.scratch, log_odds);
        if let Some(appearances) = &mut self.landmarks.appearances {
            appearances.learn(slot, mask, sighting.appearance);
        }
        mask.iter().zip(&mut self.particles.landmarks).for_each(|(new, count)| *count += u32::from(*new));
        slot
    }
}
