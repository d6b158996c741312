//! Draws what the sightings of a block of particles show.

use super::lanes::{ABSENT, BLOCK, ZERO};
use super::{Block, Order, Workspace};
use crate::association::table::Decision;
use crate::measurement::Placing;

impl<M: Placing> Block<'_, '_, M> {
    /// Draws what the sighting that is next shows in each map.
    #[inline(always)]
    pub(super) fn draw(&mut self, rank: usize, order: Order, decisions: &mut [Decision]) {
        self.weigh(rank, order);
        let (width, question, first) = (self.width(), self.question, self.first);
        let Workspace { lanes, best, drawn, order: own, candidates, pairs, first_pair, .. } = &mut *self.workspace;
        let sightings = if order == Order::Own { own[rank] } else { [rank as u32; BLOCK] };
        let stream = question.stream;
        for i in 0..width.min(BLOCK) {
            drawn.left[i] = stream.uniform((first + i) as u32, sightings[i]);
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

    /// How likely the first sighting of each particle is as one of each of its candidates, as all were compared before.
    #[inline(always)]
    fn recall(&mut self, most: usize) {
        let Workspace { drawn, order, candidates, fits, pairs, first_pair, .. } = &mut *self.workspace;
        for (i, &j) in order[0][..self.count].iter().enumerate() {
            let range = first_pair[j as usize] as usize..first_pair[j as usize + 1] as usize;
            for (place, weights) in drawn.weights[..most].iter_mut().enumerate() {
                let pair = range.start + place;
                let is_there = pair < range.end && candidates[pairs[pair] as usize].presence[i] != 0.0;
                weights[i] = if is_there { fits[pair][0][i] } else { ABSENT };
            }
        }
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
                    let (candidate, weights) = (&candidates[pairs[pair] as usize], &mut drawn.weights[place]);
                    if candidate.is_held {
                        lanes.judge(width, &sight, candidate, weights);
                    } else {
                        *weights = [ABSENT; BLOCK];
                    }
                }
            }
            Order::Own => self.weigh_own(rank),
        }
    }

    /// [`Self::weigh`] where each particle decides about another sighting.
    #[inline(always)]
    fn weigh_own(&mut self, rank: usize) {
        let (width, sight) = (self.width(), self.sight());
        let most = self.gather_measured(rank);
        self.workspace.drawn.weights.resize(most, ZERO);
        // Nothing has refined the beliefs yet with which the sightings were put in order.
        if rank == 0 {
            return self.recall(most);
        }
        for place in 0..most {
            self.gather_candidates(rank, place);
            let Workspace { lanes, drawn, gathered, .. } = &mut *self.workspace;
            lanes.judge(width, &sight, gathered, &mut drawn.weights[place]);
        }
    }
}
