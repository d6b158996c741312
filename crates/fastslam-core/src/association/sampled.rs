//! Sampled (Monte Carlo) association: explanations are drawn in proportion to their likelihood.
//!
//! Where a scan is ambiguous, particles try different explanations, and the sightings to come decide between them. The
//! weight is the sum of the likelihoods of all explanations that were left, not the likelihood of the drawn one: draw
//! and weight together target the posterior over associations (`algorithms`: the normaliser of the proposal).

use super::choice::{best_choice, order_decisions, Candidates, Scratch};
use super::hypothesis::Hypothesis;
use super::rules::Rules;
use super::settings::Exclusion;
use super::table::Decision;
use crate::math;

/// The rules, and chance: `draw(j)` is a uniform number in (0, 1) for sighting j.
pub struct Sampler<'a, F> {
    /// Of any decision.
    pub rules: &'a Rules,
    /// Uniform numbers.
    pub draw: F,
}

/// Draws the explanation of every sighting of a scan for one hypothesis and returns the log-weight, tempered.
///
/// The least ambiguous sighting comes first (see [`super::AssociationOrder`]), and each refines the pose for the next.
pub fn decide_sampled<H: Hypothesis>(
    Sampler { rules, draw }: &Sampler<'_, impl Fn(usize) -> f64>,
    among: Candidates<'_>,
    hypothesis: &mut H,
    scratch: &mut Scratch,
    decisions: &mut [Decision],
) -> f64 {
    let mut log_weight = 0.0;
    order_decisions(rules, among, hypothesis, scratch);
    scratch.used.clear();
    for place in 0..scratch.order.len() {
        let index = scratch.order[place];
        let sighting = &among.scan[index];
        let (decision, log_density) = if sighting.identity.is_some() {
            best_choice(rules, among, index, hypothesis, &scratch.used).decision(rules)
        } else {
            let highest = weigh(rules, among, index, hypothesis, scratch);
            let (decision, log_total) = pick(&among.of_sighting[index], &scratch.weights, draw(index));
            (decision, highest + log_total)
        };
        if let Decision::Landmark(candidate) = decision {
            hypothesis.accept(candidate, sighting);
            if rules.exclusion == Exclusion::OneSighting {
                scratch.used.push(candidate);
            }
        }
        decisions[index] = decision;
        log_weight += rules.likelihood_exponent * log_density;
    }
    log_weight
}

/// The likelihoods of a sighting's explanations over e^h: its candidates, then something that the map lacks. Returns h,
/// the highest of their logarithms.
fn weigh<H: Hypothesis>(
    rules: &Rules,
    among: Candidates<'_>,
    index: usize,
    hypothesis: &H,
    scratch: &mut Scratch,
) -> f64 {
    let Scratch { used, weights, fits, .. } = scratch;
    let measured = &among.scan[index].measured;
    fits.clear();
    fits.extend(among.of_sighting[index].iter().enumerate().map(|(place, candidate)| {
        let fit = if used.contains(candidate) { None } else { hypothesis.fit([index, place], *candidate, measured) };
        fit.map(|fit| fit.log_likelihood)
    }));
    // As the likeliest candidate is found elsewhere: one that is no number leads.
    let leading = fits.iter().flatten().copied().reduce(|leader, next| if next <= leader { leader } else { next });
    let highest = leading.unwrap_or(rules.log_unexplained_density).max(rules.log_unexplained_density);
    weights.clear();
    weights.extend(fits.iter().map(|fit| fit.map_or(0.0, |log_likelihood| math::exp(log_likelihood - highest))));
    weights.push(math::exp(rules.log_unexplained_density - highest));
    highest
}

/// The explanation at a uniform number, and ln of the sum of all weights.
fn pick(candidates: &[u32], weights: &[f64], uniform: f64) -> (Decision, f64) {
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
    (decision, math::ln(total))
}
