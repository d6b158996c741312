//! The decision of one particle about one scan: the likeliest landmark of each sighting, one after the other.

use super::choice::{best_choice, order_decisions, Candidates, Scratch};
use super::hypothesis::Hypothesis;
use super::rules::Rules;
use super::settings::Exclusion;
use super::table::Decision;

/// Outcome of a scan for one hypothesis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Outcome {
    /// Log-likelihood of the scan, tempered.
    pub log_weight: f64,
    /// Whether the scan was too large for its method.
    pub fell_back: bool,
}

/// Decides about every sighting of a scan for one hypothesis and returns its log-likelihood, tempered.
///
/// **Source:** `montemerlo2002fastslam`, eqs. 14 and 15: the likeliest landmark, or a new one when even that is less
/// likely than the threshold.
pub fn decide<H: Hypothesis>(
    rules: &Rules,
    among: Candidates<'_>,
    hypothesis: &mut H,
    scratch: &mut Scratch,
    decisions: &mut [Decision],
) -> f64 {
    let mut log_weight = 0.0;
    order_decisions(rules, among, hypothesis, scratch);
    let Scratch { used, order, .. } = scratch;
    used.clear();
    for &mut index in order {
        let choice = best_choice(rules, among, index, hypothesis, used);
        let (decision, log_density) = choice.decision(rules);
        if let Decision::Landmark(candidate) = decision {
            hypothesis.accept(candidate, &among.scan[index]);
            if rules.exclusion == Exclusion::OneSighting {
                used.push(candidate);
            }
        }
        decisions[index] = decision;
        log_weight += rules.likelihood_exponent * log_density;
    }
    log_weight
}
