//! Explanations that are drawn in proportion to their likelihood, for the particles of a block at once.

use super::lanes::{Best, Column, ABSENT, BLOCK, ZERO};
use super::{Block, Order, Workspace};
use crate::association::table::Decision;
use crate::math;
use crate::measurement::Placing;

/// The explanations of the sighting that each particle decides.
#[derive(Clone, Debug)]
pub(super) struct Drawn {
    /// By place among the candidates of the sighting: log-likelihoods, [`ABSENT`] where a map lacks the candidate; then
    /// likelihoods over e^h.
    weights: Vec<Column>,
    /// h, the highest of the log-likelihoods.
    highest: Column,
    /// Sum of the weights, that of something which the map lacks included.
    total: Column,
    /// A uniform number; then how much of the total is left to go through.
    left: Column,
}

impl Default for Drawn {
    fn default() -> Self {
        Self { weights: Vec::new(), highest: ZERO, total: ZERO, left: ZERO }
    }
}

impl<M: Placing> Block<'_, '_, M> {
    /// Draws what the sighting that is next shows in each map.
    #[inline(always)]
    pub(super) fn draw(&mut self, rank: usize, order: Order, decisions: &mut [Decision]) {
        self.weigh(rank, order);
        let (width, question, first) = (self.width(), self.question, self.first);
        let Workspace { lanes, best, drawn, order: own, candidates, pairs, first_pair, .. } = &mut *self.workspace;
        let sightings = if order == Order::Own { own[rank] } else { [rank as u32; BLOCK] };
        for i in 0..width.min(BLOCK) {
            drawn.left[i] = question.stream.uniform((first + i) as u32, sightings[i]);
        }
        let limits = [question.rules.log_unexplained_density, question.rules.likelihood_exponent];
        drawn.pick(width, limits, best, &mut lanes.log_likelihood);
        for i in (0..self.count).filter(|i| best.accepted[*i] != 0.0) {
            let pair = first_pair[sightings[i] as usize] as usize + best.place[i] as usize;
            let own = &candidates[pairs[pair] as usize].gaussian;
            best.gaussian.iter_mut().zip(own).for_each(|(column, own)| column[i] = own[i]);
        }
        self.write_down(rank, order, decisions);
    }

    /// How likely the sighting that is next is as one of each of its candidates.
    #[inline(always)]
    fn weigh(&mut self, rank: usize, order: Order) {
        let (width, sight) = (self.width(), self.sight());
        match order {
            Order::Certain => {
                let Workspace { drawn, candidates, fits, pairs, first_pair, .. } = &mut *self.workspace;
                let range = first_pair[rank] as usize..first_pair[rank + 1] as usize;
                drawn.weights.resize(range.len(), ZERO);
                for (weights, pair) in drawn.weights.iter_mut().zip(range) {
                    let presence = &candidates[pairs[pair] as usize].presence;
                    for i in 0..BLOCK {
                        weights[i] = if presence[i] != 0.0 { fits[pair][0][i] } else { ABSENT };
                    }
                }
            }
            Order::Given => {
                self.set_measured(rank);
                let range = self.workspace.first_pair[rank] as usize..self.workspace.first_pair[rank + 1] as usize;
                self.workspace.drawn.weights.resize(range.len(), ZERO);
                for (place, pair) in range.enumerate() {
                    self.set_evidence(pair);
                    let Workspace { lanes, drawn, candidates, pairs, .. } = &mut *self.workspace;
                    lanes.judge(width, &sight, &candidates[pairs[pair] as usize], &mut drawn.weights[place]);
                }
            }
            Order::Own => {
                let most = self.gather_measured(rank);
                self.workspace.drawn.weights.resize(most, ZERO);
                for place in 0..most {
                    self.gather_candidates(rank, place);
                    let Workspace { lanes, drawn, gathered, .. } = &mut *self.workspace;
                    lanes.judge(width, &sight, gathered, &mut drawn.weights[place]);
                }
            }
        }
    }
}

impl Drawn {
    /// Picks the explanation at the uniform number, and adds the log-likelihood of all of them, tempered.
    #[inline(always)]
    fn pick(&mut self, width: usize, [unexplained, exponent]: [f64; 2], best: &mut Best, log_likelihood: &mut Column) {
        let width = width.min(BLOCK);
        self.sum_up(width, unexplained);
        let Self { weights, highest, total, left } = self;
        best.place = [-1.0; BLOCK];
        for i in 0..width {
            left[i] *= total[i];
            log_likelihood[i] += exponent * (highest[i] + math::ln(total[i]));
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
