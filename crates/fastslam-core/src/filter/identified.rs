//! Steps in which every sighting has an identity: nothing to decide, and the same landmark for all particles.

use super::beliefs::Refinement;
use super::scan::ScanSighting;
use super::{FastSlam, StepInfo};
use crate::error::Result;
use crate::landmark::{first_rows, Correction};
use crate::measurement::MeasurementModel;
use crate::workers::PART;
use std::sync::atomic::{AtomicU32, Ordering::Relaxed};

impl<M: MeasurementModel> FastSlam<M> {
    /// FastSLAM 1.0 after its poses were sampled: correct and weigh, then resample.
    ///
    /// **Source:** `montemerlo2002fastslam`, sections 3.1 and 3.2.
    pub(super) fn step_identified_1(&mut self, scan: &[ScanSighting], info: &mut StepInfo) -> Result<()> {
        self.place_sensors();
        self.clear_log_likelihood();
        for sighting in scan {
            let Some(slot) = self.known_slot(sighting) else {
                self.insert_for_all(sighting, info);
                continue;
            };
            self.correct_all(slot, sighting, info);
        }
        self.weigh();
        let before = self.state.weights.log_mean;
        self.weights_now()?;
        info.weighing.log_likelihood += self.state.weights.log_mean - before;
        self.estimate_particles();
        if self.resample_if_needed(info) {
            self.restart_weights();
        }
        self.state.counters.samplings += 1;
        self.count_given_names(scan);
        self.remember_identified(scan);
        Ok(())
    }

    /// FastSLAM 2.0: refine the proposal and weigh, resample, then sample the poses and correct the landmarks there.
    ///
    /// **Source:** `montemerlo2003fastslam`, eqs. 9–19. **Why:** the weight (evidence form) does not depend on the
    /// sampled pose, so resampling comes first and copies of one ancestor get different poses. The landmarks are
    /// corrected at the sampled pose, not at the predicted one as eq. 17 prints it: only that converges.
    pub(super) fn step_identified_2(&mut self, scan: &[ScanSighting], info: &mut StepInfo) -> Result<()> {
        self.believe();
        self.clear_log_likelihood();
        for sighting in scan {
            let Some(slot) = self.known_slot(sighting) else { continue };
            let rows = self.state.landmarks.read(slot);
            let (model, T_robot_sensor) = (&self.models.measurement, self.models.T_robot_sensor);
            let refinement = Refinement { model, T_robot_sensor, measured: &sighting.measured, rows };
            let whole = (self.work.beliefs.columns_mut(), self.work.log_likelihood.as_mut_slice());
            self.workers.share(whole, PART, &|first, (beliefs, log_likelihood)| {
                refinement.apply(first, beliefs, log_likelihood);
            });
        }
        self.weigh();
        self.weigh_resample_sample(&mut Vec::new(), info)?;
        for sighting in scan {
            let Some(slot) = self.known_slot(sighting) else {
                self.insert_for_all(sighting, info);
                continue;
            };
            self.correct_all(slot, sighting, info);
        }
        self.count_given_names(scan);
        self.remember_identified(scan);
        Ok(())
    }

    /// Corrects a landmark in every map and adds to the log-likelihoods of the step.
    fn correct_all(&mut self, slot: u32, sighting: &ScanSighting, info: &mut StepInfo) {
        if self.is_fixed(slot) {
            return self.weigh_fixed(slot, sighting, None);
        }
        let (models, workers, work) = (&self.models, &self.workers, &mut self.work);
        let log_likelihood = &mut work.log_likelihood;
        let correction = Correction {
            model: &models.measurement,
            poses: &work.correcting.sensor_poses,
            measured: sighting.measured,
            mask: None,
        };
        let repaired = AtomicU32::new(0);
        self.state.landmarks.update(slot, None, |rows| {
            let whole = (rows.columns(), log_likelihood.as_mut_slice());
            workers.share(whole, PART, &|first, (rows, log_likelihood)| {
                repaired.fetch_add(correction.apply(first, rows, log_likelihood), Relaxed);
            });
        });
        info.repaired += repaired.into_inner();
        self.learn_appearance(slot, sighting);
    }

    fn learn_appearance(&mut self, slot: u32, sighting: &ScanSighting) {
        if let Some(appearances) = &mut self.state.landmarks.appearances {
            appearances.learn(slot, &vec![true; self.state.particles.len()], sighting.appearance);
        }
    }

    fn clear_log_likelihood(&mut self) {
        self.work.log_likelihood.clear();
        self.work.log_likelihood.resize(self.state.particles.len(), 0.0);
    }

    /// Multiplies the weights by the likelihoods of the step.
    fn weigh(&mut self) {
        let exponent = self.settings.rules.likelihood_exponent;
        for (i, log_likelihood) in self.work.log_likelihood.iter().enumerate() {
            self.state.particles.log_weight[i] += exponent * log_likelihood;
            self.state.particles.score[i] += exponent * log_likelihood;
        }
    }

    pub(super) fn known_slot(&self, sighting: &ScanSighting) -> Option<u32> {
        sighting.identity.and_then(|identity| self.state.landmarks.of_identity(identity).first().copied())
    }

    fn insert_for_all(&mut self, sighting: &ScanSighting, info: &mut StepInfo) {
        let columns = self.state.landmarks.columns();
        first_rows(
            &self.models.measurement,
            &self.work.correcting.sensor_poses,
            sighting.measured,
            None,
            columns,
            &mut self.work.correcting.rows,
        );
        let slot = self.state.landmarks.insert(sighting.identity, &self.work.correcting.rows, 0.0);
        self.learn_appearance(slot, sighting);
        self.state.particles.landmarks.iter_mut().for_each(|count| *count += 1);
        info.changes.new_landmarks += 1;
    }
}
