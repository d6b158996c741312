//! When paths must be drawn anew: when the filter is about to decide, or has decided, what its particles cannot know.
//!
//! - *A loop in sight*: an old landmark may be in view, the way since it was last seen is long enough for others to be
//!   meant, and the particles have forgotten most of that way (they descend from one or two). A draw first gives them
//!   back their spread.
//! - *Ambiguous landmarks*: where particles disagree so much about the place of an old landmark that others are as likely
//!   to lie there, none of them decides. The sighting founds a landmark, and joint evidence decides at a draw.
//! - *Suspects*: landmarks founded where an old one may lie. A few together are enough to close a loop.
//!
//! All draws together are allowed twice the work of the filter itself, counted by sizes, not by the clock.

use super::need::Need;
use super::scan::ScanSighting;
use super::FastSlam;
use crate::association::{area_m2, disagreement_m2, CandidateTable, GATE};
use crate::config::Algorithm;
use crate::geometry::Pose;
use crate::measurement::MeasurementModel;

/// A landmark is ambiguous where so many others are expected within the region (99 %) in which it may lie.
const MOST_RIVALS: f64 = 0.05;
/// Particles know better than the sensor where to look for a landmark as long as it may lie in no more than so many
/// areas that one of them looks at: twice the sensor's error in each direction.
const MOST_GATES: f64 = 4.0;

/// An old landmark whose place odometry alone does not know well enough.
struct Doubt {
    candidate: u32,
    /// Landmarks around, per square metre.
    density: f64,
    /// Area in which one particle looks for it.
    gate_m2: f64,
    /// Steps since it was seen.
    ago: usize,
}

impl<M: MeasurementModel> FastSlam<M> {
    /// Takes the landmarks from the candidates that no particle can tell from others; what they explain founds landmarks,
    /// which a draw joins with them if the evidence says so. Returns whether a draw is needed first.
    pub(super) fn leave_ambiguous_to_draws(&mut self, table: &mut CandidateTable, may_draw: bool) -> bool {
        let doubts = self.doubts(table);
        if doubts.is_empty() {
            return false;
        }
        if may_draw && self.settings.config.algorithm == Algorithm::Fastslam2 && self.has_forgotten(&doubts) {
            return true;
        }
        let [x, y, heading, ..] = self.work.beliefs.outline();
        let mut ambiguous = vec![false; table.slots.len()];
        for doubt in doubts {
            let area_m2 = disagreement_m2([x, y, heading], &table.rows(doubt.candidate)).unwrap_or(0.0);
            ambiguous[doubt.candidate as usize] = self.is_ambiguous(area_m2, doubt.density, doubt.gate_m2);
        }
        table.of_sighting.iter_mut().for_each(|found| found.retain(|c| !ambiguous[*c as usize]));
        false
    }

    /// Whether the particles go back to one at the half of the way since some of these landmarks were seen, and to one at
    /// the last draw.
    fn has_forgotten(&self, doubts: &[Doubt]) -> bool {
        let Some(rejuvenation) = &self.state.rejuvenation else { return false };
        let Some(need) = rejuvenation.need.as_ref().filter(|need| need.is_affordable()) else { return false };
        let longest = doubts.iter().map(|doubt| doubt.ago).max().unwrap_or(0);
        let since_draw = need.drift.steps() - rejuvenation.last.min(need.drift.steps());
        let back = (longest / 2).min(since_draw);
        rejuvenation.history.is_between_steps() && self.state.path.distinct_ancestors(back) < 2
    }

    /// Whether a landmark that may lie anywhere in an area is one of several, and most particles look beside it.
    fn is_ambiguous(&self, area_m2: f64, density: f64, sensor_m2: f64) -> bool {
        area_m2 > MOST_GATES * sensor_m2 && area_m2 * density > MOST_RIVALS
    }

    /// Area in which a particle looks for a landmark that it expects here, square metres.
    fn gate_m2(&self, at: [f64; 2], from: Pose) -> f64 {
        let range_m = (at[0] - from.x).hypot(at[1] - from.y);
        let noise = self.models.measurement.noise_covariance();
        let exponent = self.settings.config.filter.likelihood_exponent;
        area_m2(noise.xx * noise.yy) * range_m / exponent
    }

    /// Candidates that odometry alone cannot tell from others.
    fn doubts(&mut self, table: &CandidateTable) -> Vec<Doubt> {
        let Some(rejuvenation) = self.state.rejuvenation.take() else { return Vec::new() };
        let mut doubts = Vec::new();
        if let Some(need) = &rejuvenation.need {
            let best = self.state.particles.best();
            let known = self.state.particles.landmarks[best] as usize;
            for (candidate, &slot) in table.slots.iter().enumerate() {
                let candidate = candidate as u32;
                let birth = self.state.landmarks.birth(slot);
                if self.state.given.is_sure(birth) {
                    continue;
                }
                let Some(at) = table.gaussian(candidate, best).map(|g| g.mean) else { continue };
                let (covariance, ago) = need.relation(self.state.given.clan(birth), at);
                let area_m2 = area_m2(covariance.determinant());
                let gate_m2 = self.gate_m2(at, self.state.particles.pose(best));
                if !self.is_ambiguous(area_m2, f64::INFINITY, gate_m2) {
                    continue;
                }
                let density = self.state.landmarks.density((best, known), at, area_m2.sqrt());
                if self.is_ambiguous(area_m2, density, gate_m2) {
                    doubts.push(Doubt { candidate, density, gate_m2, ago });
                }
            }
        }
        self.state.rejuvenation = Some(rejuvenation);
        doubts
    }

    /// Takes note of what the best particle sighted and founded in a scan.
    pub(super) fn note_need(&mut self, scan: &[ScanSighting], matched: &[u32], founded: &[u32]) {
        let Some(mut rejuvenation) = self.state.rejuvenation.take() else { return };
        if let Some(need) = &mut rejuvenation.need {
            need.scanned(scan.len(), self.state.particles.len());
            for &slot in founded {
                need.suspects += u32::from(self.is_suspect(need, slot));
            }
            for slot in matched.iter().chain(founded) {
                need.sighted(self.state.given.clan(self.state.landmarks.birth(*slot)) as u32);
            }
        }
        self.state.rejuvenation = Some(rejuvenation);
    }

    /// Whether an older landmark may lie where this one was founded.
    fn is_suspect(&mut self, need: &Need, founded: u32) -> bool {
        let best = self.state.particles.best();
        let mut row = vec![0.0; self.state.landmarks.columns()];
        if !self.state.landmarks.read_row(founded, best, &mut row) {
            return false;
        }
        let at = [row[crate::landmark::column::MEAN_X], row[crate::landmark::column::MEAN_Y]];
        let birth = self.state.landmarks.birth(founded);
        let sensor = self.models.measurement.noise_covariance().scaled(2.0);
        let tolerance = sensor.xx.max(sensor.yy * self.settings.config.sensor.max_range_m.powi(2));
        let farthest = need.drift.of_place(at, 0).largest_eigenvalue() + tolerance;
        let reach_m = (GATE * farthest).sqrt().min(self.settings.config.sensor.max_range_m);
        let near = self.state.landmarks.places_near(best, at, reach_m);
        near.into_iter().any(|(slot, place)| {
            let older = self.state.given.clan(self.state.landmarks.birth(slot));
            if older >= birth || need.last_seen.get(older as usize).is_some_and(|s| *s as usize >= need.drift.steps()) {
                return false;
            }
            let (c, _) = need.relation(older, place);
            let [x, y] = [place[0] - at[0], place[1] - at[1]];
            let (xx, yy) = (c.xx + tolerance, c.yy + tolerance);
            let distance = (yy * x * x - 2.0 * c.xy * x * y + xx * y * y) / (xx * yy - c.xy * c.xy);
            distance <= GATE
        })
    }
}
