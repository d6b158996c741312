//! Steps in which particles decide which landmark a sighting shows.

use super::scan_methods::explain;
use super::{FastSlam, Particles, StepInfo};
use crate::association::{Belief, CandidateTable, Decision, Outcome, ParticleHypothesis, Scratch};
use crate::config::{Algorithm, ExistenceForm, MergingRule};
use crate::error::Result;
use crate::landmark::{column, correct_rows, first_rows};
use crate::measurement::MeasurementModel;
use crate::motion::MotionGaussian;
use crate::random::Purpose;
use rayon::prelude::*;

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
        let mut decisions = self.decide(scan, &table, info);
        self.examine_decided(scan, &decisions, &table);
        self.weigh_resample_sample(&mut decisions, info)?;
        let first_birth = self.landmarks.births();
        self.founded.clear();
        self.sighting_densities.clear();
        self.sighting_densities.resize(table.slots.len() * self.particles.len(), 0.0);
        let mut births = Vec::with_capacity(scan.len());
        for (j, sighting) in scan.iter().enumerate() {
            births.push(self.landmarks.births());
            let decided: Vec<Decision> = decisions.iter().skip(j).step_by(scan.len()).copied().collect();
            self.correct_decided((j, sighting), &decided, &table, info);
        }
        self.remember_decided(scan, &decisions, &table, &births);
        if self.judges_existence() && !scan.is_empty() {
            self.judge_existence(&decisions, &table, first_birth, info);
        }
        if self.config.association.merging.rule != MergingRule::Never && !scan.is_empty() {
            self.merge_duplicates(&decisions, &table, first_birth, info);
        }
        self.table = table;
        Ok(())
    }

    /// Every particle's decisions (an equal share each), with its belief refined and its weight changed by them.
    fn decide(&mut self, scan: &[ScanSighting], table: &CandidateTable, info: &mut StepInfo) -> Vec<Decision> {
        let mut decisions = vec![Decision::Ignored; self.particles.len() * scan.len()];
        let (model, beliefs, T_robot_sensor) = (&self.model, &self.beliefs, self.T_robot_sensor);
        self.fits.fill(table, |j, candidate, log_likelihood, distance| {
            let columns = [log_likelihood, distance];
            beliefs.fit(model, T_robot_sensor, &scan[j].measured, &table.rows(candidate), columns);
        });
        self.gather_evidence(scan, table);
        let (model, beliefs) = (&self.model, &self.beliefs);
        let stream = self.random.stream(Purpose::Association, self.samplings);
        let (rules, fits) = (&self.rules, &self.fits);
        let one = |scratch: &mut Scratch, (i, mine): (usize, &mut [Decision])| {
            let belief = beliefs.get(i);
            let mut particle =
                ParticleHypothesis { model, T_robot_sensor, table, fits, particle: i, belief, refined: None };
            let draw = |j: usize| stream.uniform(i as u32, j as u32);
            let outcome = explain(rules, (scan, &table.of_sighting), &mut particle, scratch, draw, mine);
            (particle.refined.map_or(belief, |(belief, _)| belief), outcome)
        };
        let share = scan.len().max(1);
        let outcomes: Vec<(Belief, Outcome)> = match &self.workers {
            Some(workers) => workers
                .install(|| decisions.par_chunks_mut(share).enumerate().map_init(Scratch::default, one).collect()),
            None => {
                let mut scratch = Scratch::default();
                decisions.chunks_mut(share).enumerate().map(|share| one(&mut scratch, share)).collect()
            }
        };
        for (i, (belief, outcome)) in outcomes.into_iter().enumerate() {
            self.beliefs.set(i, &belief);
            self.particles.log_weight[i] += outcome.log_weight;
            self.particles.score[i] += outcome.log_weight;
            info.fell_back += u32::from(outcome.fell_back);
        }
        decisions
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
            let old = std::mem::take(decisions);
            for &a in &self.ancestor_indices {
                decisions.extend_from_slice(&old[a as usize * share..][..share]);
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
            self.beliefs.sample(stream, x, y, heading);
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
        let of_sighting: Vec<Vec<u32>> = scan
            .iter()
            .map(|sighting| {
                let mut slots = Vec::new();
                let reach = [self.gate_radius, self.lever_arm_m];
                let region = self.beliefs.region_of(&self.model, self.T_robot_sensor, &sighting.measured, reach);
                self.landmarks.find(&region, &mut slots);
                if let Some(identity) = sighting.identity {
                    slots.extend_from_slice(self.landmarks.of_identity(identity));
                }
                slots
            })
            .collect();
        let mut slots: Vec<u32> = of_sighting.concat();
        slots.sort_unstable_by_key(|slot| self.landmarks.birth(*slot));
        slots.dedup();
        (table.particles, table.columns) = (self.particles.len(), self.landmarks.columns());
        table.slots.clear();
        table.values.clear();
        for slot in slots {
            if self.landmarks.holders(slot) == 0 {
                self.landmarks.remove(slot);
                continue;
            }
            let rows = self.landmarks.read(slot);
            (0..table.columns).for_each(|c| table.values.extend_from_slice(rows.column(c)));
            table.slots.push(slot);
        }
        let index: rustc_hash::FxHashMap<u32, u32> = table.slots.iter().copied().zip(0..).collect();
        table.of_sighting = of_sighting
            .into_iter()
            .map(|slots| {
                let mut found: Vec<u32> = slots.iter().filter_map(|slot| index.get(slot).copied()).collect();
                found.sort_unstable();
                found.dedup();
                found
            })
            .collect();
    }

    /// Corrects, creates or leaves landmarks as every particle decided about one sighting.
    fn correct_decided(
        &mut self,
        (j, sighting): (usize, &ScanSighting),
        decided: &[Decision],
        table: &CandidateTable,
        info: &mut StepInfo,
    ) {
        let mark = sighting.identity.map(|identity| f64::from(identity) + 1.0);
        for &candidate in &table.of_sighting[j] {
            let mask: Vec<bool> = decided.iter().map(|d| *d == Decision::Landmark(candidate)).collect();
            if !mask.contains(&true) {
                continue;
            }
            let slot = table.slots[candidate as usize];
            let (model, poses, log_likelihood) = (&self.model, &self.sensor_poses, &mut self.log_likelihood);
            log_likelihood.clear();
            log_likelihood.resize(mask.len(), 0.0);
            self.landmarks.update(slot, Some(&mask), |mut rows| {
                if let Some(mark) = mark {
                    let column = rows.column(column::IDENTITY);
                    (0..mask.len()).filter(|i| mask[*i]).for_each(|i| column[i] = mark);
                }
                info.repaired += correct_rows(model, poses, sighting.measured, rows, Some(&mask), log_likelihood);
            });
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
        let new: Vec<bool> = decided.iter().map(|d| *d == Decision::New).collect();
        if new.contains(&true) {
            let columns = self.landmarks.columns();
            first_rows(&self.model, &self.sensor_poses, sighting.measured, Some(&new), columns, &mut self.scratch);
            if let (Some(mark), true) = (mark, columns > column::IDENTITY) {
                let n = new.len();
                (0..n).filter(|i| new[*i]).for_each(|i| self.scratch[column::IDENTITY * n + i] = mark);
            }
            let log_odds = self.initial_log_odds();
            let slot = self.landmarks.insert(sighting.identity, &self.scratch, log_odds);
            if let Some(appearances) = &mut self.landmarks.appearances {
                appearances.learn(slot, &new, sighting.appearance);
            }
            self.founded.push((j, slot));
            new.iter().zip(&mut self.particles.landmarks).for_each(|(new, count)| *count += u32::from(*new));
            info.new_landmarks += 1;
        }
        info.ignored += u32::from(decided[self.particles.best()] == Decision::Ignored);
    }
}
