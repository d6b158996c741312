//! Optimal assignment: the likeliest explanation of all sightings of a scan together.
//!
//! Every landmark explains at most one sighting, and every sighting has a dummy of its own that stands for whatever the
//! map lacks. Where a detection probability is known, the likelihoods hold the odds of seeing the landmark over missing
//! it, so that the cost of a miss is counted as well.

use super::choice::{best_choice, Scratch};
use super::hypothesis::Hypothesis;
use super::rules::Rules;
use super::table::Decision;
use crate::density::Fit;
use crate::sighting::ScanSighting;

/// The cost of what is impossible: finite, so that sums stay numbers.
const IMPOSSIBLE: f64 = 1e12;

/// The one-to-one assignment of rows to columns with the least total cost; there must be at least as many columns.
///
/// `costs[r * columns + c]`, finite. Returns the column of every row. O(rows² · columns).
///
/// **Source:** `jonker1987shortest`, shortest augmenting paths with dual prices.
pub fn assign(costs: &[f64], rows: usize, columns: usize) -> Vec<usize> {
    // Prices of rows and columns; the row that holds each column; index 0 is a column that nobody wants.
    let (mut row_price, mut column_price) = (vec![0.0; rows + 1], vec![0.0; columns + 1]);
    let mut holder = vec![0_usize; columns + 1];
    let mut previous = vec![0_usize; columns + 1];
    for row in 1..=rows {
        holder[0] = row;
        let mut at = 0;
        let (mut reach, mut done) = (vec![f64::INFINITY; columns + 1], vec![false; columns + 1]);
        while holder[at] != 0 {
            done[at] = true;
            let from = holder[at];
            let (mut nearest, mut next) = (f64::INFINITY, 0);
            for column in 1..=columns {
                if done[column] {
                    continue;
                }
                let reduced = costs[(from - 1) * columns + column - 1] - row_price[from] - column_price[column];
                if reduced < reach[column] {
                    (reach[column], previous[column]) = (reduced, at);
                }
                if reach[column] < nearest {
                    (nearest, next) = (reach[column], column);
                }
            }
            for column in 0..=columns {
                if done[column] {
                    row_price[holder[column]] += nearest;
                    column_price[column] -= nearest;
                } else {
                    reach[column] -= nearest;
                }
            }
            at = next;
        }
        while at != 0 {
            holder[at] = holder[previous[at]];
            at = previous[at];
        }
    }
    let mut of_row = vec![0; rows];
    for column in 1..=columns {
        if holder[column] != 0 {
            of_row[holder[column] - 1] = column - 1;
        }
    }
    of_row
}

/// The sightings that are still undecided against the landmarks that are left.
struct Round {
    sightings: Vec<usize>,
    candidates: Vec<u32>,
    /// Cost per sighting of every candidate, then of every sighting's dummy.
    costs: Vec<f64>,
    fits: Vec<Option<Fit>>,
}

impl Round {
    fn new<H: Hypothesis>(
        rules: &Rules,
        (scan, of_sighting): (&[ScanSighting], &[Vec<u32>]),
        hypothesis: &H,
        used: &[u32],
        sightings: Vec<usize>,
    ) -> Self {
        let mut candidates: Vec<u32> = sightings.iter().flat_map(|j| of_sighting[*j].iter().copied()).collect();
        candidates.sort_unstable();
        candidates.dedup();
        candidates.retain(|candidate| !used.contains(candidate));
        let (rows, landmarks) = (sightings.len(), candidates.len());
        let mut costs = vec![IMPOSSIBLE; rows * (landmarks + rows)];
        let mut fits = vec![None; rows * landmarks];
        for (row, &j) in sightings.iter().enumerate() {
            costs[row * (landmarks + rows) + landmarks + row] = -rules.log_new_density;
            for (place, candidate) in of_sighting[j].iter().enumerate() {
                let Ok(column) = candidates.binary_search(candidate) else { continue };
                let Some(fit) = hypothesis.fit([j, place], *candidate, &scan[j].measured) else { continue };
                if fit.mahalanobis_squared <= rules.gate && fit.log_likelihood.is_finite() {
                    costs[row * (landmarks + rows) + column] = -fit.log_likelihood;
                    fits[row * landmarks + column] = Some(fit);
                }
            }
        }
        Self { sightings, candidates, costs, fits }
    }

    /// The pairs of the best assignment: row, candidate, log-likelihood, and by how much the row's next best
    /// explanation is worse; the least ambiguous first.
    fn pairs(&self) -> Vec<(usize, u32, f64, f64)> {
        let (rows, landmarks) = (self.sightings.len(), self.candidates.len());
        let columns = landmarks + rows;
        let mut pairs = Vec::new();
        for (row, column) in assign(&self.costs, rows, columns).into_iter().enumerate() {
            let costs = &self.costs[row * columns..][..columns];
            if column >= landmarks {
                continue;
            }
            let others = costs.iter().enumerate().filter(|(c, _)| *c != column).map(|(_, cost)| *cost);
            if let Some(fit) = self.fits[row * landmarks + column] {
                let margin = others.fold(f64::INFINITY, f64::min) - costs[column];
                pairs.push((row, self.candidates[column], fit.log_likelihood, margin));
            }
        }
        pairs.sort_by(|a, b| b.3.total_cmp(&a.3));
        pairs
    }
}

/// Decides about a scan for one hypothesis by optimal assignment and returns the log-likelihood, tempered.
///
/// The least ambiguous pair of the best assignment refines the pose, and the rest is assigned anew with it.
pub fn decide_assignment<H: Hypothesis>(
    rules: &Rules,
    scan: &[ScanSighting],
    of_sighting: &[Vec<u32>],
    hypothesis: &mut H,
    scratch: &mut Scratch,
    decisions: &mut [Decision],
) -> f64 {
    let used = &mut scratch.used;
    used.clear();
    let mut log_density = 0.0;
    for index in (0..scan.len()).filter(|j| scan[*j].identity.is_some()) {
        let choice = best_choice(rules, (index, &scan[index]), &of_sighting[index], hypothesis, used);
        let (decision, density) = choice.decision(rules);
        if let Decision::Landmark(candidate) = decision {
            hypothesis.accept(candidate, &scan[index]);
            used.push(candidate);
        }
        decisions[index] = decision;
        log_density += density;
    }
    let mut left: Vec<usize> = (0..scan.len()).filter(|j| scan[*j].identity.is_none()).collect();
    loop {
        let round = Round::new(rules, (scan, of_sighting), hypothesis, used, left);
        let pairs = round.pairs();
        // Nothing that is decided can change the rest when the pose is known.
        let certain = hypothesis.pose_is_certain();
        let take = if certain { pairs.len() } else { pairs.len().min(1) };
        left = round.sightings.clone();
        for &(row, candidate, density, _) in &pairs[..take] {
            let index = round.sightings[row];
            hypothesis.accept(candidate, &scan[index]);
            used.push(candidate);
            decisions[index] = Decision::Landmark(candidate);
            log_density += density;
            left.retain(|j| *j != index);
        }
        if certain || pairs.is_empty() {
            break;
        }
    }
    for index in left {
        let choice = best_choice(rules, (index, &scan[index]), &of_sighting[index], hypothesis, used);
        decisions[index] = match choice.decision(rules).0 {
            Decision::New => Decision::New,
            _ => Decision::Ignored,
        };
        log_density += rules.log_new_density;
    }
    rules.likelihood_exponent * log_density
}
