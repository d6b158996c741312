//! The methods of association, and what speaks for a landmark beside its place.

use super::existence::add_detection_odds;
use super::scan::ScanSighting;
use super::FastSlam;
use crate::association::{
    decide, decide_assignment, decide_joint, decide_sampled, CandidateTable, Decision, Hypothesis, Outcome, Rules,
    Scratch,
};
use crate::config::Method;
use crate::measurement::MeasurementModel;

/// Decides about a scan for one hypothesis by the configured method; `draw(j)` is a uniform number for sighting j.
pub(super) fn explain<H: Hypothesis + Clone>(
    rules: &Rules,
    (scan, of_sighting): (&[ScanSighting], &[Vec<u32>]),
    hypothesis: &mut H,
    scratch: &mut Scratch,
    draw: impl Fn(usize) -> f64,
    decisions: &mut [Decision],
) -> Outcome {
    let log_weight = match rules.method {
        Method::MaximumLikelihood => decide(rules, scan, of_sighting, hypothesis, scratch, decisions),
        Method::Sampled => decide_sampled(rules, (scan, of_sighting), hypothesis, scratch, draw, decisions),
        Method::Assignment => decide_assignment(rules, scan, of_sighting, hypothesis, scratch, decisions),
        Method::Joint => return decide_joint(rules, scan, of_sighting, hypothesis, scratch, decisions),
    };
    Outcome { log_weight, fell_back: false }
}

impl<M: MeasurementModel> FastSlam<M> {
    /// Adds to the table of fits what speaks for each pair beside the place: appearance, and the odds of a detection.
    pub(super) fn gather_evidence(&mut self, scan: &[ScanSighting], table: &CandidateTable) {
        if self.state.landmarks.appearances.is_none()
            && self.settings.config.association.detection_probability.is_none()
        {
            return;
        }
        let mut fits = std::mem::take(&mut self.work.associating.fits);
        fits.add_evidence(table, |j, candidate, evidence| {
            let slot = table.slots[candidate as usize];
            add_detection_odds(&self.settings, &mut self.state.landmarks, slot, evidence);
            if let Some(appearances) = &mut self.state.landmarks.appearances {
                appearances.add_evidence(slot, scan[j].appearance, evidence);
            }
        });
        self.work.associating.fits = fits;
    }
}
