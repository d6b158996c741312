//! Sampled (Monte Carlo) association: explanations are drawn in proportion to their likelihood.
//!
//! Where a scan is ambiguous, particles try different explanations, and the sightings to come decide between them. The
//! weight is the sum of the likelihoods of all explanations that were left, not the likelihood of the drawn one: draw
//! and weight together target the posterior over associations (`algorithms`: the normaliser of the proposal).

use super::choice::{best_choice, order_decisions, Scratch};
use super::hypothesis::Hypothesis;
use super::rules::Rules;
use super::settings::Exclusion;
use super::table::Decision;
use crate::math;
use crate::sighting::ScanSighting;

/// Draws the explanation of every sighting of a scan for one hypothesis and returns the log-weight, tempered.
///
/// `draw(j)` is a uniform number in (0, 1) for sighting j. The least ambiguous sighting comes first (see
/// [`super::AssociationOrder`]), and each refines the pose for the next.
pub fn decide_sampled<H: Hypothesis>(
    rules: &Rules,
    (scan, of_sighting): (&[ScanSighting], &[Vec<u32>]),
    hypothesis: &mut H,
    scratch: &mut Scratch,
    draw: impl Fn(usize) -> f64,
    decisions: &mut [Decision],
) -> f64 {
    let mut log_weight = 0.0;
    order_decisions(rules, scan, of_sighting, hypothesis, scratch);
    let Scratch { used, order, weights, .. } = scratch;
    used.clear();
    for &mut index in order {
        let sighting = &scan[index];
        let choice = best_choice(rules, (index, sighting), &of_sighting[index], hypothesis, used);
        let (decision, log_density) = if sighting.identity.is_some() {
            choice.decision(rules)
        } else {
            let highest = choice.best.map_or(rules.log_unexplained_density, |(_, fit)| fit.log_likelihood);
            let highest = highest.max(rules.log_unexplained_density);
            weigh(rules, (index, sighting), &of_sighting[index], (hypothesis, used), (highest, weights));
            pick(&of_sighting[index], weights, (highest, draw(index)))
        };
        if let Decision::Landmark(candidate) = decision {
            hypothesis.accept(candidate, sighting);
            if rules.exclusion == Exclusion::OneSighting {
                used.push(candidate);
            }
        }
        decisions[index] = decision;
        log_weight += rules.likelihood_exponent * log_density;
    }
    log_weight
}

/// The likelihoods of a sighting's explanations over e^`highest`: its candidates, then something that the map lacks.
fn weigh<H: Hypothesis>(
    rules: &Rules,
    (index, sighting): (usize, &ScanSighting),
    candidates: &[u32],
    (hypothesis, used): (&H, &[u32]),
    (highest, weights): (f64, &mut Vec<f64>),
) {
    weights.clear();
    weights.extend(candidates.iter().enumerate().map(|(place, candidate)| {
        if used.contains(candidate) {
            return 0.0;
        }
        let fit = hypothesis.fit([index, place], *candidate, &sighting.measured);
        fit.map_or(0.0, |fit| math::exp(fit.log_likelihood - highest))
    }));
    weights.push(math::exp(rules.log_unexplained_density - highest));
}

/// The explanation at a uniform number, and ln of the sum of all likelihoods.
fn pick(candidates: &[u32], weights: &[f64], (highest, uniform): (f64, f64)) -> (Decision, f64) {
    let total: f64 = weights.iter().sum();
    let mut left = uniform * total;
    let mut decision = Decision::New;
    for (candidate, weight) in candidates.iter().zip(weights) {
        if left < *weight {
            decision = Decision::Landmark(*candidate);
            break;
        }
        left -= weight;
    }
    (decision, highest + math::ln(total))
}
