//! Explanations that are drawn in proportion to their likelihood, for the particles of a block at once.

use super::lanes::{Best, Column, BLOCK, ZERO};
use crate::math;

/// The explanations of the sighting that each particle decides.
#[derive(Clone, Debug)]
pub(super) struct Drawn {
    /// By place among the candidates of the sighting: log-likelihoods, [`super::lanes::ABSENT`] where a map lacks the
    /// candidate; then likelihoods over e^h.
    pub weights: Vec<Column>,
    /// h, the highest of the log-likelihoods.
    highest: Column,
    /// Sum of the weights, that of something which the map lacks included; then the log-likelihood of all explanations.
    total: Column,
    /// A uniform number; then how much of the total is left to go through.
    pub left: Column,
}

impl Default for Drawn {
    fn default() -> Self {
        Self { weights: Vec::new(), highest: ZERO, total: ZERO, left: ZERO }
    }
}

impl Drawn {
    /// Picks the explanation at the uniform number, and adds the log-likelihood of all of them, tempered.
    #[inline(always)]
    pub fn pick(
        &mut self,
        width: usize,
        [unexplained, exponent]: [f64; 2],
        best: &mut Best,
        log_likelihood: &mut Column,
    ) {
        let width = width.min(BLOCK);
        self.sum_up(width, unexplained);
        let Self { weights, highest, total, left } = self;
        best.place = [-1.0; BLOCK];
        for i in 0..width {
            left[i] *= total[i];
            total[i] = highest[i] + math::ln(total[i]);
        }
        for i in 0..width {
            log_likelihood[i] += exponent * total[i];
        }
        for (place, weights) in weights.iter().enumerate() {
            for i in 0..width {
                let reached = (best.place[i] < 0.0) & (left[i] < weights[i]);
                best.place[i] = if reached { place as f64 } else { best.place[i] };
                left[i] -= weights[i];
            }
        }
        for i in 0..width {
            best.accepted[i] = if best.place[i] < 0.0 { 0.0 } else { 1.0 };
            best.ignored[i] = 0.0;
        }
    }

    /// Turns log-likelihoods into weights, and sums these up.
    #[inline(always)]
    fn sum_up(&mut self, width: usize, unexplained: f64) {
        let Self { weights, highest, total, .. } = self;
        // As the likeliest candidate is found elsewhere: one that is no number leads until the next.
        *highest = [f64::NAN; BLOCK];
        for log_likelihoods in &*weights {
            for i in 0..width {
                let (value, leader) = (log_likelihoods[i], highest[i]);
                highest[i] = if value <= leader { leader } else { value };
            }
        }
        for i in 0..width {
            highest[i] = if highest[i] > unexplained { highest[i] } else { unexplained };
        }
        *total = ZERO;
        for weights in weights {
            for i in 0..width {
                weights[i] = math::exp(weights[i] - highest[i]);
                total[i] += weights[i];
            }
        }
        for i in 0..width {
            total[i] += math::exp(unexplained - highest[i]);
        }
    }
}
