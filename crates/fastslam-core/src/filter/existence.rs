//! The life of landmarks: sightings speak for them, scans that should have shown them and did not speak against them.
//!
//! **Source:** `montemerlo2003fastslam`, eq. 22: log-odds per particle and landmark, counted up when it is sighted and
//! down when it lies in view and is not. They are kept apart from the Gaussians, which a missed landmark leaves alone.
//! In place of fixed numbers they can follow Bayes' rule; and where the probability of a detection is known, a map that
//! holds landmarks in view that were not sighted loses weight.

use super::landmarks::EXISTENCE_COLUMNS;
use super::work::{Judging, Verdict};
use super::{FastSlam, Particles, StepInfo};
use crate::association::{Box2, CandidateTable, Decision};
use crate::config::{AssociationConfig, ExistenceForm, Removal};
use crate::landmark::column;
use crate::math;
use crate::measurement::MeasurementModel;
use crate::vector::vectorized;

impl<M: MeasurementModel> FastSlam<M> {
    /// Whether scans are judged by what they should have shown.
    pub(super) fn judges_existence(&self) -> bool {
        let association = &self.settings.config.association;
        let counts = association.existence.removal == Removal::WhenMissed
            || association.existence.form == ExistenceForm::Bayes
            || association.detection_probability.is_some();
        self.state.landmarks.existence.is_some() && counts
    }

    /// The log-odds of a landmark at its first sighting.
    pub(super) fn initial_log_odds(&self) -> f64 {
        let settings = &self.settings.config.association.existence;
        match (settings.form, self.settings.rules.initial_log_odds) {
            (ExistenceForm::Bayes, Some(log_odds)) => log_odds,
            _ => settings.initial_log_odds,
        }
    }

    /// Adds to every particle's number the odds that a landmark is sighted rather than missed, r P_D / (1 − r P_D), as
    /// a logarithm.
    ///
    /// **Why:** every landmark in view costs ln(1 − r P_D), sighted or not ([`Self::judge_existence`]); a sighting takes
    /// that back.
    pub(super) fn add_detection_odds(&mut self, slot: u32, evidence: &mut [f64]) {
        let Some(detection) = self.settings.config.association.detection_probability else { return };
        let Some(existence) = &mut self.state.landmarks.existence else { return };
        let log_odds = existence.read(slot).column(1);
        for (value, log_odds) in evidence.iter_mut().zip(log_odds) {
            let seen = math::logistic(*log_odds) * detection;
            *value += math::ln(seen / (1.0 - seen));
        }
    }

    /// Whether the best particle's landmark counts as real.
    pub(super) fn is_confirmed(&mut self, slot: u32, sightings: f64) -> bool {
        if self.state.given.of(self.state.landmarks.birth(slot)).is_some() {
            return true;
        }
        let best = self.state.particles.best();
        let settings = &self.settings.config.association.existence;
        let Some(existence) = &mut self.state.landmarks.existence else { return true };
        let likely = match settings.form {
            ExistenceForm::Counted => true,
            ExistenceForm::Bayes => existence.read(slot).column(1)[best] >= settings.confirmed_log_odds,
        };
        likely && sightings >= f64::from(settings.confirmed_sightings)
    }

    /// Counts a scan for and against every landmark in view, and removes what no longer exists in a particle's map.
    ///
    /// `decisions` are those of the particles as they stand now, an equal share each. Landmarks born after
    /// `first_birth` came with this scan and are not judged by it.
    pub(super) fn judge_existence(
        &mut self,
        decisions: &[Decision],
        table: &CandidateTable,
        first_birth: u64,
        info: &mut StepInfo,
    ) {
        let mut judging = std::mem::take(&mut self.work.judging);
        let Judging { in_reach, sighted, verdicts, .. } = &mut judging;
        in_reach.clear();
        self.state.landmarks.find(&self.view_region(), in_reach);
        in_reach.extend_from_slice(&table.slots);
        in_reach.sort_unstable_by_key(|slot| self.state.landmarks.birth(*slot));
        in_reach.dedup();
        note_sighted(decisions, table.slots.len(), self.state.particles.len(), sighted);
        verdicts.clear();
        verdicts.resize(self.state.particles.len(), Verdict::Unseen);
        for place in 0..judging.in_reach.len() {
            let (slot, verdicts) = (judging.in_reach[place], &mut judging.verdicts);
            // Candidates that nobody holds any more are gone; they have no birth.
            if self.state.landmarks.birth(slot) >= first_birth {
                continue;
            }
            self.find_in_view(slot, verdicts);
            if let Some(candidate) = table.slots.iter().position(|s| *s == slot) {
                let sighted = &judging.sighted[candidate * verdicts.len()..][..verdicts.len()];
                // Only Bayes' rule asks for densities.
                let densities =
                    self.work.correcting.sighting_densities.get(candidate * verdicts.len()..).unwrap_or_default();
                for (i, verdict) in verdicts.iter_mut().enumerate().filter(|(i, _)| sighted[*i]) {
                    *verdict = Verdict::Sighted(densities.get(i).copied().unwrap_or_default());
                }
            }
            let in_view = judging.verdicts.iter().any(|v| *v != Verdict::Unseen);
            if in_view && self.is_fixed(slot) {
                self.weigh_missed(slot, &judging.verdicts);
            } else if in_view {
                info.removed += self.count(slot, &mut judging);
            }
        }
        self.work.judging = judging;
    }

    /// A box around everything that any particle's sensor can see for sure.
    fn view_region(&self) -> Box2 {
        let reach = self.settings.config.association.existence.range_fraction * self.settings.config.sensor.max_range_m;
        let mut region = Box2::EMPTY;
        for i in 0..self.state.particles.len() {
            region.include([self.work.correcting.sensor_poses.x[i], self.work.correcting.sensor_poses.y[i]], reach);
        }
        region
    }

    /// Where a landmark is surely in view and would have been sighted.
    fn find_in_view(&mut self, slot: u32, verdicts: &mut [Verdict]) {
        let settings = &self.settings.config.association.existence;
        let reach = settings.range_fraction * self.settings.config.sensor.max_range_m;
        let near = self.settings.config.sensor.min_range_m;
        let half_view = 0.5 * settings.view_fraction * self.settings.config.sensor.field_of_view_rad;
        let rows = self.state.landmarks.read(slot);
        let (count, x, y) = (rows.column(column::SIGHTINGS), rows.column(column::MEAN_X), rows.column(column::MEAN_Y));
        let n = verdicts.len();
        let poses = &self.work.correcting.sensor_poses;
        let (count, x, y) = (&count[..n], &x[..n], &y[..n]);
        let (sensor_x, sensor_y, heading) = (&poses.x[..n], &poses.y[..n], &poses.heading[..n]);
        vectorized(
            #[inline(always)]
            || {
                for i in 0..n {
                    let (dx, dy) = (x[i] - sensor_x[i], y[i] - sensor_y[i]);
                    let range_squared = dx * dx + dy * dy;
                    // No branches: the loop must stay a straight line to become vector code.
                    let reachable = (count[i] != 0.0) & (range_squared < reach * reach) & (range_squared > near * near);
                    let bearing = math::wrap_angle(math::atan2(dy, dx) - heading[i]);
                    let seen = reachable & (bearing.abs() < half_view);
                    verdicts[i] = if seen { Verdict::Missed } else { Verdict::Unseen };
                }
            },
        );
    }

    /// What a scan says against the maps that have a landmark in view, where nothing changes the landmark itself.
    fn weigh_missed(&mut self, slot: u32, verdicts: &[Verdict]) {
        let Some(detection) = self.settings.config.association.detection_probability else { return };
        let Some(existence) = &mut self.state.landmarks.existence else { return };
        let log_odds = existence.read(slot).column(1);
        let Particles { log_weight, score, .. } = &mut self.state.particles;
        for (i, _) in verdicts.iter().enumerate().filter(|(_, verdict)| **verdict != Verdict::Unseen) {
            let exists = math::logistic(log_odds[i]);
            let missed = self.settings.rules.likelihood_exponent * math::ln(1.0 - exists * detection);
            log_weight[i] += missed;
            score[i] += missed;
        }
    }

    /// Counts one scan for a landmark in every map and removes it from those in which it no longer exists. Returns
    /// whether the best particle lost it.
    fn count(&mut self, slot: u32, judging: &mut Judging) -> u32 {
        let Judging { verdicts, judged, dead, .. } = judging;
        let association = &self.settings.config.association;
        let settings = &association.existence;
        let lowest = self.initial_log_odds() + settings.lowest_log_odds - settings.initial_log_odds;
        let missed_log_odds = match (settings.form, association.detection_probability) {
            (ExistenceForm::Bayes, Some(detection)) => -math::ln(1.0 - detection),
            _ => settings.missed_log_odds,
        };
        // Below this its odds would round to nothing, and nothing could bring it back.
        let floor = lowest.min(-50.0) - 1.0;
        let (exponent, removes) = (self.settings.rules.likelihood_exponent, settings.removal == Removal::WhenMissed);
        judged.clear();
        judged.extend(verdicts.iter().map(|v| *v != Verdict::Unseen));
        dead.clear();
        dead.resize(verdicts.len(), false);
        let Particles { log_weight, score, .. } = &mut self.state.particles;
        let Some(existence) = &mut self.state.landmarks.existence else { return 0 };
        existence.update(slot, Some(judged), &mut |rows| {
            let [present, log_odds] = rows.columns::<EXISTENCE_COLUMNS>();
            for (i, verdict) in verdicts.iter().enumerate().filter(|(_, v)| **v != Verdict::Unseen) {
                if present[i] == 0.0 {
                    continue;
                }
                if let Some(detection) = association.detection_probability {
                    let missed = exponent * math::ln(1.0 - math::logistic(log_odds[i]) * detection);
                    log_weight[i] += missed;
                    score[i] += missed;
                }
                log_odds[i] = match verdict {
                    Verdict::Sighted(density) => {
                        (log_odds[i] + gained(association, *density)).min(settings.highest_log_odds)
                    }
                    _ => (log_odds[i] - missed_log_odds).max(floor),
                };
                if removes && log_odds[i] < lowest {
                    dead[i] = true;
                    (present[i], log_odds[i]) = (0.0, 0.0);
                }
            }
        });
        if !dead.contains(&true) {
            return 0;
        }
        self.state.landmarks.update(slot, Some(dead), |mut rows| {
            let count = rows.column(column::SIGHTINGS);
            (0..dead.len()).filter(|i| dead[*i]).for_each(|i| count[i] = 0.0);
        });
        let Particles { landmarks, .. } = &mut self.state.particles;
        landmarks.iter_mut().zip(&*dead).for_each(|(count, dead)| *count -= u32::from(*dead));
        if self.state.landmarks.holders(slot) == 0 {
            self.state.landmarks.remove(slot);
        }
        u32::from(dead[self.state.particles.best()])
    }
}

/// What a sighting with this log-likelihood adds to the log-odds: ln(1 − P_D + P_D N / λ_c), or a fixed number.
fn gained(association: &AssociationConfig, log_likelihood: f64) -> f64 {
    match (association.existence.form, association.detection_probability, association.clutter_density) {
        (ExistenceForm::Bayes, Some(detection), Some(clutter)) => {
            math::ln(1.0 - detection + detection * math::exp(log_likelihood) / clutter)
        }
        _ => association.existence.sighted_log_odds,
    }
}

/// Notes which particle took some sighting for which candidate.
fn note_sighted(decisions: &[Decision], candidates: usize, particles: usize, sighted: &mut Vec<bool>) {
    sighted.clear();
    sighted.resize(candidates * particles, false);
    let share = decisions.len() / particles;
    for (i, mine) in decisions.chunks_exact(share).enumerate() {
        for decision in mine {
            if let Decision::Landmark(candidate) = decision {
                sighted[*candidate as usize * particles + i] = true;
            }
        }
    }
}
