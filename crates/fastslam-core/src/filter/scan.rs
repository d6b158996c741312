//! Steps in which particles decide which landmark a sighting shows.

use super::beliefs::{belief_in, set_belief_in};
use super::existence;
use super::extent::Extent;
use super::scan_methods::explain;
use super::work::{Claims, Work};
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
        let mut table = self.candidates(scan, info);
        let mut decisions = std::mem::take(&mut self.work.associating.decisions);
        self.decide(scan, &mut table, &mut decisions, info);
        self.refuse_foundings(scan, &mut decisions);
        self.examine_decided(scan, &decisions, &table);
        self.weigh_resample_sample(&mut decisions, info)?;
        self.work.correcting.first_birth = self.state.landmarks.births();
        self.work.correcting.founded.clear();
        self.prepare_densities(table.slots.len());
        let (mut decided, mut births) =
            (std::mem::take(&mut self.work.associating.decided), std::mem::take(&mut self.work.correcting.births));
        births.clear();
        for (j, sighting) in scan.iter().enumerate() {
            births.push(self.state.landmarks.births());
            decided.clear();
            decided.extend(decisions.iter().skip(j).step_by(scan.len()).map(Decision::number));
            self.correct_decided((j, sighting), &decided, &table, info);
        }
        self.remember_decided(scan, &decisions, &table, &births);
        self.note_scan(scan, &decisions, &table, &births);
        self.count_given_decided(scan, &decisions, &table);
        let claims = Claims { scan, decisions: &decisions, table: &table };
        self.fade_unconfirmed(claims, info);
        if existence::is_judged(&self.settings, &self.state.landmarks) && !scan.is_empty() {
            let Work { correcting, judging, .. } = &mut self.work;
            info.changes.removed += existence::judge(&self.settings, self.state.maps(), claims, correcting, judging);
        }
        if self.settings.config.association.merging.rule != MergingRule::Never && !scan.is_empty() {
            self.merge_duplicates(&decisions, &table, self.work.correcting.first_birth, info);
        }
        (
            self.work.associating.table,
            self.work.associating.decisions,
            self.work.associating.decided,
            self.work.correcting.births,
        ) = (table, decisions, decided, births);
        Ok(())
    }

    /// The landmarks that the scan may show, but for those that are left to draws of whole paths.
    fn candidates(&mut self, scan: &[ScanSighting], info: &mut StepInfo) -> CandidateTable {
        let mut table = std::mem::take(&mut self.work.associating.table);
        self.find_candidates(scan, &mut table);
        if self.leave_ambiguous_to_draws(&mut table, true) {
            info.sampling.rejuvenated |= self.rejuvenate();
            info.changes.merged += self.closed();
            self.believe();
            self.find_candidates(scan, &mut table);
            self.leave_ambiguous_to_draws(&mut table, false);
        }
        self.set_doubtful_aside(&mut table);
        table
    }

    /// Takes note of what the best particle made of a scan; where paths are drawn by need, for these too.
    fn note_scan(&mut self, scan: &[ScanSighting], decisions: &[Decision], table: &CandidateTable, births: &[u64]) {
        self.see_decided(scan, decisions, table, births);
        if self.state.rejuvenation.as_ref().is_none_or(|rejuvenation| rejuvenation.need.is_none()) {
            return;
        }
        let best = self.state.particles.best();
        let (mut matched, mut founded) = (Vec::new(), Vec::new());
        for (j, decision) in decisions[best * scan.len()..][..scan.len()].iter().enumerate() {
            match decision {
                Decision::Landmark(candidate) => matched.push(table.slots[*candidate as usize]),
                Decision::New => {
                    founded
                        .extend(self.work.correcting.founded.iter().filter(|(of, _)| *of == j).map(|(_, slot)| *slot));
                }
                Decision::Ignored => {}
            }
        }
        self.note_need(scan, &matched, &founded);
    }

    /// Every particle's decisions (an equal share each), with its belief refined and its weight changed by them; then
    /// those for landmarks that may not exist, which change neither.
    fn decide(
        &mut self,
        scan: &[ScanSighting],
        table: &mut CandidateTable,
        decisions: &mut Vec<Decision>,
        info: &mut StepInfo,
    ) {
        decisions.clear();
        decisions.resize(self.state.particles.len() * scan.len(), Decision::Ignored);
        if scan.is_empty() {
            return;
        }
        self.work.log_likelihood.clear();
        self.work.log_likelihood.resize(self.state.particles.len(), 0.0);
        if self.decides_by_place_alone() && fast::applies(scan) {
            self.decide_together(scan, table, decisions);
        } else {
            info.fell_back += self.decide_each(scan, table, decisions);
        }
        for (i, increment) in self.work.log_likelihood.iter().enumerate() {
            self.state.particles.log_weight[i] += increment;
            self.state.particles.score[i] += increment;
        }
        self.explain_by_doubtful(scan, decisions, table);
    }

    /// Decisions of blocks of particles, in passes of vector code.
    fn decide_together(&mut self, scan: &[ScanSighting], table: &CandidateTable, decisions: &mut [Decision]) {
        let (model, rules) = (&self.models.measurement, &self.rules());
        let Work { associating, beliefs, log_likelihood, .. } = &mut self.work;
        let deciding = &associating.deciding;
        let question = fast::Question { rules, model, T_robot_sensor: self.models.T_robot_sensor, scan, table };
        let whole =
            (beliefs.columns_mut(), Shares { entries: decisions, each: scan.len() }, log_likelihood.as_mut_slice());
        self.workers.share(whole, fast::BLOCK, &|first, (beliefs, decisions, log_likelihood)| {
            let answers = fast::Answers { beliefs, decisions: decisions.entries, log_likelihood };
            deciding.with(|(workspace, _)| fast::decide_block(&question, first, answers, workspace));
        });
    }

    /// Decisions of the particles one by one; returns how many fell back to a simpler method.
    fn decide_each(&mut self, scan: &[ScanSighting], table: &CandidateTable, decisions: &mut [Decision]) -> u32 {
        let (model, T_robot_sensor) = (&self.models.measurement, self.models.T_robot_sensor);
        let beliefs = &self.work.beliefs;
        self.work.associating.fits.fill(table, |j, candidate, log_likelihood, distance| {
            let columns = [log_likelihood, distance];
            beliefs.fit(model, T_robot_sensor, &scan[j].measured, &table.rows(candidate), columns);
        });
        self.gather_evidence(scan, table);
        let stream = self.settings.random.stream(Purpose::Association, self.state.counters.samplings);
        let (model, rules) = (&self.models.measurement, &self.rules());
        let Work { associating, beliefs, log_likelihood, .. } = &mut self.work;
        let (deciding, fits, fell_back) = (&associating.deciding, &associating.fits, AtomicU32::new(0));
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
        self.settings.rules.method == Method::MaximumLikelihood
            && self.state.landmarks.appearances.is_none()
            && self.settings.config.association.detection_probability.is_none()
    }

    /// What each particle believes about the robot's pose before the scan.
    pub(super) fn believe(&mut self) {
        let Particles { x, y, heading, .. } = &self.state.particles;
        match self.settings.config.algorithm {
            Algorithm::Fastslam1 => self.work.beliefs.certain(x, y, heading),
            _ => self.work.beliefs.predict(x, y, heading, &self.state.motions.pending),
        }
    }

    /// Normalises the weights, estimates the pose, resamples if needed, and samples the poses from the beliefs.
    ///
    /// `decisions` (an equal share per particle) follow the ancestors like everything else.
    pub(super) fn weigh_resample_sample(&mut self, decisions: &mut Vec<Decision>, info: &mut StepInfo) -> Result<()> {
        let before = self.state.weights.log_mean;
        self.weights_now()?;
        info.weighing.log_likelihood += self.state.weights.log_mean - before;
        self.estimate_from_beliefs();
        if self.resample_if_needed(info) {
            self.restart_weights();
            let share = decisions.len() / self.work.beliefs.len();
            self.work.beliefs.resample(&self.work.ancestor_indices);
            std::mem::swap(&mut self.work.associating.former_decisions, decisions);
            decisions.clear();
            for &a in &self.work.ancestor_indices {
                decisions.extend_from_slice(&self.work.associating.former_decisions[a as usize * share..][..share]);
            }
        }
        self.sample_poses();
        self.place_sensors();
        Ok(())
    }

    /// Draws every particle's pose from its belief.
    fn sample_poses(&mut self) {
        if self.settings.config.algorithm == Algorithm::Fastslam2 {
            let stream = self.settings.random.stream(Purpose::Proposal, self.state.counters.samplings);
            let Particles { x, y, heading, .. } = &mut self.state.particles;
            let (beliefs, whole) = (&self.work.beliefs, [x, y, heading].map(Vec::as_mut_slice));
            self.workers.share(whole, PART, &|first, poses| beliefs.sample(stream, first, poses));
            self.state.motions.pending = MotionGaussian::default();
        }
        self.state.counters.samplings += 1;
    }

    /// Where the sensor is in every particle.
    pub(super) fn place_sensors(&mut self) {
        let particles = &self.state.particles;
        self.work.correcting.sensor_poses.set(
            &particles.x,
            &particles.y,
            &particles.heading,
            self.models.T_robot_sensor,
        );
    }

    /// The landmarks that some particle might see in each sighting, with their rows.
    fn find_candidates(&mut self, scan: &[ScanSighting], table: &mut CandidateTable) {
        let extent = Extent::of(&self.work.beliefs, self.models.T_robot_sensor);
        table.clear(scan.len());
        (table.particles, table.columns) = (self.state.particles.len(), self.state.landmarks.columns());
        let mut slots = std::mem::take(&mut self.work.associating.slots);
        slots.clear();
        for (sighting, found) in scan.iter().zip(&mut table.of_sighting) {
            let reach = [self.settings.gate_radius, self.models.lever_arm_m];
            let region = extent.region_of(&self.models.measurement, &sighting.measured, reach).unwrap_or_else(|| {
                self.work.beliefs.region_of(
                    &self.models.measurement,
                    self.models.T_robot_sensor,
                    &sighting.measured,
                    reach,
                )
            });
            self.state.landmarks.find(&region, found);
            if let Some(identity) = sighting.identity {
                found.extend_from_slice(self.state.landmarks.of_identity(identity));
            }
            slots.extend_from_slice(found);
        }
        slots.sort_unstable_by_key(|slot| self.state.landmarks.birth(*slot));
        slots.dedup();
        for &slot in &slots {
            if self.state.landmarks.holders(slot) == 0 {
                self.state.landmarks.remove(slot);
                continue;
            }
            self.state.landmarks.append_rows(slot, &mut table.values);
            table.slots.push(slot);
        }
        self.work.associating.slots = slots;
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
        let mut mask = std::mem::take(&mut self.work.correcting.mask);
        for &candidate in &table.of_sighting[j] {
            mask.clear();
            mask.extend(decided.iter().map(|d| *d == candidate));
            if mask.contains(&true) {
                info.repaired += self.correct_where(&mask, sighting, table.slots[candidate as usize]);
                self.note_densities(&mask, candidate);
            }
        }
        mask.clear();
        mask.extend(decided.iter().map(|d| *d == Decision::New.number()));
        if mask.contains(&true) {
            let slot = self.create_where(&mask, sighting);
            self.work.correcting.founded.push((j, slot));
            info.changes.new_landmarks += 1;
        }
        self.work.correcting.mask = mask;
        info.left_out.ignored += u32::from(decided[self.state.particles.best()] == Decision::Ignored.number());
    }

    /// Corrects a landmark in the maps that `mask` marks; returns in how many it had to be repaired.
    fn correct_where(&mut self, mask: &[bool], sighting: &ScanSighting, slot: u32) -> u32 {
        if self.is_fixed(slot) {
            self.work.log_likelihood.clear();
            self.work.log_likelihood.resize(mask.len(), 0.0);
            self.weigh_fixed(slot, sighting, Some(mask));
            return 0;
        }
        let mark = sighting.identity.map(|identity| f64::from(identity) + 1.0);
        let (models, workers, work) = (&self.models, &self.workers, &mut self.work);
        let log_likelihood = &mut work.log_likelihood;
        log_likelihood.clear();
        log_likelihood.resize(mask.len(), 0.0);
        let (model, poses) = (&models.measurement, &work.correcting.sensor_poses);
        let correction = Correction { model, poses, measured: sighting.measured, mask: Some(mask) };
        let repaired = AtomicU32::new(0);
        self.state.landmarks.update(slot, Some(mask), |mut rows| {
            if let Some(mark) = mark {
                let column = rows.column(column::IDENTITY);
                (0..mask.len()).filter(|i| mask[*i]).for_each(|i| column[i] = mark);
            }
            let whole = (rows.columns(), log_likelihood.as_mut_slice());
            workers.share(whole, PART, &|first, (rows, log_likelihood)| {
                repaired.fetch_add(correction.apply(first, rows, log_likelihood), Relaxed);
            });
        });
        if let Some(identity) = sighting.identity {
            self.state.landmarks.mark_identity(slot, identity);
        }
        if let Some(appearances) = &mut self.state.landmarks.appearances {
            appearances.learn(slot, mask, sighting.appearance);
        }
        repaired.into_inner()
    }

    /// Makes room for how likely the sightings of so many candidates are, where existence follows Bayes' rule.
    fn prepare_densities(&mut self, candidates: usize) {
        self.work.correcting.sighting_densities.clear();
        if self.settings.config.association.existence.form == ExistenceForm::Bayes {
            self.work.correcting.sighting_densities.resize(candidates * self.state.particles.len(), 0.0);
        }
    }

    /// Notes how likely the sighting of a candidate was, where existence follows Bayes' rule.
    fn note_densities(&mut self, mask: &[bool], candidate: u32) {
        if self.settings.config.association.existence.form == ExistenceForm::Bayes {
            let Work { correcting, log_likelihood, .. } = &mut self.work;
            let densities = &mut correcting.sighting_densities[candidate as usize * mask.len()..][..mask.len()];
            let chosen = (0..mask.len()).filter(|i| mask[*i]);
            chosen.for_each(|i| densities[i] = log_likelihood[i]);
        }
    }

    /// Creates a landmark in the maps that `mask` marks; returns its slot.
    fn create_where(&mut self, mask: &[bool], sighting: &ScanSighting) -> u32 {
        let columns = self.state.landmarks.columns();
        first_rows(
            &self.models.measurement,
            &self.work.correcting.sensor_poses,
            sighting.measured,
            Some(mask),
            columns,
            &mut self.work.correcting.rows,
        );
        if let (Some(identity), true) = (sighting.identity, columns > column::IDENTITY) {
            let marks = &mut self.work.correcting.rows[column::IDENTITY * mask.len()..];
            marks.iter_mut().zip(mask).filter(|(_, new)| **new).for_each(|(mark, _)| *mark = f64::from(identity) + 1.0);
        }
        let log_odds = existence::initial_log_odds(&self.settings);
        let slot = self.state.landmarks.insert(sighting.identity, &self.work.correcting.rows, log_odds);
        if let Some(appearances) = &mut self.state.landmarks.appearances {
            appearances.learn(slot, mask, sighting.appearance);
        }
        mask.iter().zip(&mut self.state.particles.landmarks).for_each(|(new, count)| *count += u32::from(*new));
        slot
    }
}
