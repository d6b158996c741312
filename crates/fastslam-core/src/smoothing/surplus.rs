//! Landmarks that are one too many: three, say, where two stand so close together that one is taken for the other.
//!
//! A wild sighting founds a landmark beside two, and each of the three takes its share of what shows these. Any two of
//! them are sighted together at times, so that no pair is one thing; but no scan shows more than two. Such a landmark can
//! be done without: scan by scan its neighbours explain what it did, each still sighted once. That fits little worse, and
//! explains why scans that show two never show the third as well, though they show neighbours further away.
//!
//! Of n + 1 things each of which a scan shows with probability p, one that shows n or more misses one with odds of
//! (n + 1) (1 − p) to p; of n things, surely.

use super::closing::{Closing, RARE};
use super::differences::GATE;
use super::graph::{Graph, Mode, Sights};
use super::history::Seen;
use super::second_thoughts::{Related, SecondThoughts};
use crate::association::assign;
use crate::math;
use crate::measurement::Placing;

/// Neighbours at most that explain the sightings of a landmark in its place.
const NEAREST: usize = 6;
/// What a sighting costs that nothing explains, in nats: as one at the gate.
const UNEXPLAINED: f64 = 0.5 * GATE;

/// How things are where the neighbours of a landmark explain its sightings.
struct Without {
    landmark: usize,
    /// Its neighbours.
    places: Vec<usize>,
    /// What each of them is sighted by then.
    seen: Vec<Vec<Seen>>,
    /// How many sightings each of them has got.
    got: Vec<usize>,
    /// How many sightings nothing explains.
    unexplained: usize,
    /// How much worse the sightings fit where nothing moves.
    loss: f64,
    /// ln of how many times likelier the scans are without the landmark, as far as fit says nothing of it.
    log_odds: f64,
}

impl<M: Placing> Graph<'_, M> {
    /// Does without the landmarks that are one too many by what the scans show and miss; returns the mode then, and what
    /// becomes of their sightings.
    pub(super) fn without_surplus(
        &mut self,
        mut mode: Mode,
        closing: &Closing<'_>,
        related: &Related,
    ) -> (Mode, SecondThoughts) {
        let mut before = None;
        while let Some((landmarks, solved)) = self.without_one(&mode, closing, related) {
            before = before.or_else(|| Some(self.births()));
            (self.landmarks, mode) = (landmarks, solved);
        }
        let thoughts = before.map(|before| SecondThoughts::between(&before, &self.births()));
        (mode, thoughts.unwrap_or_default())
    }

    /// The landmarks without one that can be done without, the likeliest first, and the mode then.
    fn without_one(&self, mode: &Mode, closing: &Closing<'_>, related: &Related) -> Option<(Vec<Sights>, Mode)> {
        let mut beside = vec![Vec::new(); self.landmarks.len()];
        for [a, b] in self.related_pairs(mode, related) {
            beside[a].push(b);
            beside[b].push(a);
        }
        let crowded = (0..beside.len()).filter(|k| !beside[*k].is_empty());
        let mut ways: Vec<Without> = crowded.filter_map(|k| self.without(k, &beside[k], mode)).collect();
        ways.retain(|way| way.log_odds > 0.0);
        ways.sort_by(|a, b| (b.log_odds - b.loss).total_cmp(&(a.log_odds - a.loss)));
        ways.into_iter().find_map(|way| {
            let log_odds = way.log_odds;
            let (landmarks, solved) = self.solved_with(self.gone(way), mode)?;
            (solved.cost - mode.cost + closing.log_odds <= log_odds).then_some((landmarks, solved))
        })
    }

    /// The landmarks with the sightings that they have then.
    fn gone(&self, way: Without) -> Vec<Sights> {
        let mut landmarks = self.landmarks.clone();
        landmarks[way.landmark].seen.clear();
        for (place, seen) in way.places.into_iter().zip(way.seen) {
            let birth = landmarks[place].birth;
            landmarks[place].seen = seen.into_iter().map(|seen| Seen { birth, ..seen }).collect();
        }
        landmarks
    }

    /// How it is without a landmark; `None` where its neighbours cannot explain it.
    fn without(&self, landmark: usize, beside: &[usize], mode: &Mode) -> Option<Without> {
        let places = self.nearest(landmark, beside, mode);
        let seen = places.iter().map(|place| self.landmarks[*place].seen.clone()).collect();
        let mut way =
            Without { landmark, got: vec![0; places.len()], places, seen, unexplained: 0, loss: 0.0, log_odds: 0.0 };
        let own = &self.landmarks[landmark].seen;
        for &seen in own {
            self.hand_over(seen, mode, &mut way);
            if RARE * way.unexplained as f64 > own.len() as f64 {
                return None;
            }
        }
        let (group, scans) = way.heirs(own.len())?;
        let shown = self.shown_together(&group, &scans, mode)?;
        // Any of the group may be the one that a scan misses.
        let each = math::ln(1.0 + shown / (group.len() as f64 * (1.0 - shown)));
        let unexplained = self.likelihood_exponent * UNEXPLAINED * way.unexplained as f64;
        way.log_odds = self.looks(scans.iter(), mode) * each - unexplained;
        Some(way)
    }

    /// The nearest of the landmarks that stand beside one.
    fn nearest(&self, landmark: usize, beside: &[usize], mode: &Mode) -> Vec<usize> {
        let at = &mode.solution.landmarks;
        let squared = |k: usize| [0, 1].map(|axis| (at[k][axis] - at[landmark][axis]).powi(2)).iter().sum::<f64>();
        let mut nearest = beside.to_vec();
        nearest.sort_by(|a, b| squared(*a).total_cmp(&squared(*b)));
        nearest.truncate(NEAREST);
        nearest
    }

    /// Gives a sighting of the landmark to one of its neighbours, and those of them that its scan shows to others, as all
    /// together fit best.
    fn hand_over(&self, seen: Seen, mode: &Mode, way: &mut Without) {
        let mut claims = vec![(way.landmark, seen)];
        for (&place, shown) in way.places.iter().zip(&mut way.seen) {
            let scan = shown.partition_point(|s| s.step < seen.step)..shown.partition_point(|s| s.step <= seen.step);
            claims.extend(shown.drain(scan).map(|seen| (place, seen)));
        }
        let columns = way.places.len() + claims.len();
        let mut costs = vec![self.likelihood_exponent * UNEXPLAINED; claims.len() * columns];
        for ((_, seen), costs) in claims.iter().zip(costs.chunks_exact_mut(columns)) {
            costs.iter_mut().zip(&way.places).for_each(|(cost, place)| *cost = self.loss(seen, *place, mode));
        }
        let chosen = assign(&costs, claims.len(), columns);
        for ((&(from, seen), costs), column) in claims.iter().zip(costs.chunks_exact(columns)).zip(chosen) {
            way.loss += costs[column] - self.loss(&seen, from, mode);
            way.take(from, seen, column);
        }
    }

    /// What a sighting of a landmark adds to the cost.
    fn loss(&self, seen: &Seen, landmark: usize, mode: &Mode) -> f64 {
        let at = (mode.solution.landmarks[landmark], &self.landmarks[landmark].known);
        let distance = self.view(&mode.solution.trajectory, at, seen).distance;
        self.likelihood_exponent * self.history.sighting(seen.sighting).tail.loss_of(2, distance)
    }
}

impl Without {
    /// Gives a sighting that was taken for landmark `from` to a neighbour; beyond these are columns for none.
    fn take(&mut self, from: usize, seen: Seen, column: usize) {
        let Some(&to) = self.places.get(column) else {
            self.unexplained += 1;
            return;
        };
        self.got[column] += usize::from(to != from);
        let at = self.seen[column].partition_point(|other| other.sighting < seen.sighting);
        self.seen[column].insert(at, seen);
    }

    /// The landmarks that take the place of this one, of which there were so many sightings, and this one, with the scans
    /// that show all of them; `None` where none does.
    fn heirs(&self, sightings: usize) -> Option<(Vec<usize>, Vec<Seen>)> {
        let is_heir = |place: &usize| RARE * self.got[*place] as f64 > sightings as f64;
        let heirs: Vec<usize> = (0..self.places.len()).filter(is_heir).collect();
        let (first, others) = heirs.split_first()?;
        let shows = |seen: &[Seen], step: u32| seen.binary_search_by_key(&step, |s| s.step).is_ok();
        let is_full = |one: &&Seen| others.iter().all(|heir| shows(&self.seen[*heir], one.step));
        let scans: Vec<Seen> = self.seen[*first].iter().filter(is_full).copied().collect();
        let group = heirs.iter().map(|heir| self.places[*heir]).chain([self.landmark]).collect();
        (!scans.is_empty()).then_some((group, scans))
    }
}
