//! Joint compatibility: the largest set of pairs that agree with each other under one pose.
//!
//! **Source:** `neira2001jcbb`. The squared joint distance νᵀC⁻¹ν of a set of pairs is the sum of their squared
//! distances taken one after the other, each with the pose refined by those before it, because the landmarks are
//! independent given the pose. A node of the search thus costs one refinement, whatever its depth.

use super::choice::{best_choice, order_decisions, Candidates, Scratch};
use super::decide::{decide, Outcome};
use super::hypothesis::Hypothesis;
use super::rules::{Rules, MOST_JOINT};
use super::table::Decision;

/// So many nodes are searched before the scan is decided one by one.
const MOST_NODES: u32 = 2_000;

/// What is searched, and the best set found so far.
struct Search<'a> {
    rules: &'a Rules,
    among: Candidates<'a>,
    /// The sightings with candidates, in the order of the search.
    order: Vec<usize>,
    /// For every sighting in the order, the place of its candidate among those of the sighting, or none.
    chosen: Vec<Option<usize>>,
    best: Vec<Option<usize>>,
    best_pairs: usize,
    best_distance: f64,
    nodes: u32,
}

impl Search<'_> {
    /// Searches below a node that explains the first `depth` sightings; false when the search became too large.
    fn descend<H: Hypothesis + Clone>(&mut self, hypothesis: &H, depth: usize, pairs: usize, distance: f64) -> bool {
        self.nodes += 1;
        if self.nodes > MOST_NODES {
            return false;
        }
        let within_reach = pairs + self.order.len() - depth;
        if within_reach < self.best_pairs || (within_reach == self.best_pairs && distance >= self.best_distance) {
            return true;
        }
        let Some(&index) = self.order.get(depth) else {
            (self.best_pairs, self.best_distance) = (pairs, distance);
            self.best.clone_from(&self.chosen);
            return true;
        };
        for (candidate_distance, place) in self.compatible(hypothesis, index, pairs, distance) {
            let mut child = hypothesis.clone();
            child.accept(self.among.of_sighting[index][place], &self.among.scan[index]);
            self.chosen[depth] = Some(place);
            if !self.descend(&child, depth + 1, pairs + 1, distance + candidate_distance) {
                return false;
            }
        }
        self.chosen[depth] = None;
        self.descend(hypothesis, depth + 1, pairs, distance)
    }

    /// The candidates that a sighting may take at a node, nearest first: squared distance and place.
    fn compatible<H: Hypothesis>(
        &self,
        hypothesis: &H,
        index: usize,
        pairs: usize,
        distance: f64,
    ) -> Vec<(f64, usize)> {
        let gate = self.rules.joint_gates[pairs + 1];
        let taken = |candidate: u32| {
            let mut before = self.order.iter().zip(&self.chosen);
            before.any(|(j, place)| place.is_some_and(|place| self.among.of_sighting[*j][place] == candidate))
        };
        let mut found: Vec<(f64, usize)> = Vec::new();
        for (place, &candidate) in self.among.of_sighting[index].iter().enumerate() {
            let Some(fit) = hypothesis.fit([index, place], candidate, &self.among.scan[index].measured) else {
                continue;
            };
            let near =
                distance + fit.mahalanobis_squared <= gate && fit.log_likelihood >= self.rules.log_unexplained_density;
            if near && fit.mahalanobis_squared <= self.rules.gate && !taken(candidate) {
                found.push((fit.mahalanobis_squared, place));
            }
        }
        found.sort_by(|a, b| a.0.total_cmp(&b.0));
        found
    }
}

/// Decides about a scan for one hypothesis by joint compatibility. Most pairs count first, then the least distance.
///
/// Sightings with an identity and scans that are too large are decided one by one.
pub fn decide_joint<H: Hypothesis + Clone>(
    rules: &Rules,
    among: Candidates<'_>,
    hypothesis: &mut H,
    scratch: &mut Scratch,
    decisions: &mut [Decision],
) -> Outcome {
    order_decisions(rules, among, hypothesis, scratch);
    let individually = |j: &usize| {
        let choice = best_choice(rules, among, *j, hypothesis, &[]);
        matches!(choice.decision(rules).0, Decision::Landmark(_))
    };
    let order: Vec<usize> = scratch.order.iter().copied().filter(individually).collect();
    let chosen = vec![None; order.len()];
    let mut search = Search {
        rules,
        among,
        chosen: chosen.clone(),
        best: chosen,
        order,
        best_pairs: 0,
        best_distance: f64::INFINITY,
        nodes: 0,
    };
    let named = among.scan.iter().any(|sighting| sighting.identity.is_some());
    if named || search.order.len() > MOST_JOINT || !search.descend(hypothesis, 0, 0, 0.0) {
        let log_weight = decide(rules, among, hypothesis, scratch, decisions);
        return Outcome { log_weight, fell_back: !named };
    }
    let pairs = search.order.iter().copied().zip(search.best.iter().copied()).collect::<Vec<_>>();
    let log_weight = settle(rules, among, hypothesis, &pairs, decisions);
    Outcome { log_weight, fell_back: false }
}

/// Accepts the chosen pairs and calls every other sighting new when it fits nothing that is left, else ignores it.
fn settle<H: Hypothesis>(
    rules: &Rules,
    among: Candidates<'_>,
    hypothesis: &mut H,
    pairs: &[(usize, Option<usize>)],
    decisions: &mut [Decision],
) -> f64 {
    let Candidates { scan, of_sighting } = among;
    let mut log_density = 0.0;
    let mut used = Vec::with_capacity(pairs.len());
    for &(index, place) in pairs {
        let Some(place) = place else { continue };
        let candidate = of_sighting[index][place];
        let fit = hypothesis.fit([index, place], candidate, &scan[index].measured);
        log_density += fit.map_or(rules.log_unexplained_density, |fit| fit.log_likelihood);
        hypothesis.accept(candidate, &scan[index]);
        decisions[index] = Decision::Landmark(candidate);
        used.push(candidate);
    }
    let paired = |index: usize| pairs.iter().any(|(j, place)| *j == index && place.is_some());
    for index in (0..scan.len()).filter(|j| !paired(*j)) {
        let choice = best_choice(rules, among, index, hypothesis, &used);
        decisions[index] = match choice.decision(rules).0 {
            Decision::New => Decision::New,
            _ => Decision::Ignored,
        };
        log_density += rules.log_unexplained_density;
    }
    rules.likelihood_exponent * log_density
}
