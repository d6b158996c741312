//! Optimal assignment: the likeliest explanation of all sightings of a scan together.
//!
//! Every landmark explains at most one sighting, and every sighting has a dummy of its own that stands for whatever the
//! map lacks. Where a detection probability is known, the likelihoods hold the odds of seeing the landmark over missing
//! it, so that the cost of a miss is counted as well.

use super::choice::{best_choice, Candidates, Scratch};
use super::hypothesis::Hypothesis;
use super::rules::Rules;
use super::table::Decision;
use crate::density::Fit;

/// The cost of what is impossible: finite, so that sums stay numbers.
const IMPOSSIBLE: f64 = 1e12;

/// The one-to-one assignment of rows to columns with the least total cost; there must be at least as many columns.
///
/// `costs[r * columns + c]`, finite. Returns the column of every row. O(rows² · columns).
///
/// **Source:** `jonker1987shortest`, shortest augmenting paths with dual prices.
pub fn assign(costs: &[f64], rows: usize, columns: usize) -> Vec<usize> {
    let mut assignment = Assignment::of(rows, columns);
    for row in 1..=rows {
        assignment.add(row, costs);
    }
    let mut of_row = vec![0; rows];
    for column in 1..=columns {
        if assignment.holder[column] != 0 {
            of_row[assignment.holder[column] - 1] = column - 1;
        }
    }
    of_row
}

/// The cheapest assignment of the rows so far. Rows and columns count from 1; 0 is a column that nobody wants.
struct Assignment {
    row_price: Vec<f64>,
    column_price: Vec<f64>,
    /// The row that holds each column; 0 for none.
    holder: Vec<usize>,
    /// The column before each on the shortest path to it.
    previous: Vec<usize>,
}

impl Assignment {
    fn of(rows: usize, columns: usize) -> Self {
        Self {
            row_price: vec![0.0; rows + 1],
            column_price: vec![0.0; columns + 1],
            holder: vec![0; columns + 1],
            previous: vec![0; columns + 1],
        }
    }

    /// Assigns one more row: along the shortest path to a free column every holder takes the next column.
    fn add(&mut self, row: usize, costs: &[f64]) {
        let columns = self.holder.len() - 1;
        self.holder[0] = row;
        let mut at = 0;
        let (mut reach, mut done) = (vec![f64::INFINITY; columns + 1], vec![false; columns + 1]);
        while self.holder[at] != 0 {
            done[at] = true;
            let (nearest, next) = self.nearest(at, costs, &mut reach, &done);
            self.raise_prices(nearest, &mut reach, &done);
            at = next;
        }
        while at != 0 {
            self.holder[at] = self.holder[self.previous[at]];
            at = self.previous[at];
        }
    }

    /// The nearest column that the paths did not reach yet, with its distance, once they may go on from column `at`.
    fn nearest(&mut self, at: usize, costs: &[f64], reach: &mut [f64], done: &[bool]) -> (f64, usize) {
        let columns = self.holder.len() - 1;
        let from = self.holder[at];
        let (mut nearest, mut next) = (f64::INFINITY, 0);
        for column in 1..=columns {
            if done[column] {
                continue;
            }
            let reduced = costs[(from - 1) * columns + column - 1] - self.row_price[from] - self.column_price[column];
            if reduced < reach[column] {
                (reach[column], self.previous[column]) = (reduced, at);
            }
            if reach[column] < nearest {
                (nearest, next) = (reach[column], column);
            }
        }
        (nearest, next)
    }

    /// Changes the prices so that what was reached costs nothing.
    fn raise_prices(&mut self, by: f64, reach: &mut [f64], done: &[bool]) {
        for column in 0..self.holder.len() {
            if done[column] {
                self.row_price[self.holder[column]] += by;
                self.column_price[column] -= by;
            } else {
                reach[column] -= by;
            }
        }
    }
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
        Candidates { scan, of_sighting }: Candidates<'_>,
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
            costs[row * (landmarks + rows) + landmarks + row] = -rules.log_unexplained_density;
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
    /// explanation is worse, `least_lead` at least; the least ambiguous first.
    fn pairs(&self, least_lead: f64) -> Vec<(usize, u32, f64, f64)> {
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
                if margin >= least_lead {
                    pairs.push((row, self.candidates[column], fit.log_likelihood, margin));
                }
            }
        }
        pairs.sort_by(|a, b| b.3.total_cmp(&a.3));
        pairs
    }
}

/// Decides about a scan for one hypothesis by optimal assignment and returns the log-likelihood, tempered.
///
/// Names come first. Of the rest the least ambiguous pair of the best assignment refines the pose, and the others are
/// assigned anew with it. What is left over shows no landmark of the map.
pub fn decide_assignment<H: Hypothesis>(
    rules: &Rules,
    among: Candidates<'_>,
    hypothesis: &mut H,
    scratch: &mut Scratch,
    decisions: &mut [Decision],
) -> f64 {
    scratch.used.clear();
    let mut deciding = Deciding {
        rules,
        among,
        hypothesis,
        used: &mut scratch.used,
        decisions,
        log_density: 0.0,
        left: (0..among.scan.len()).filter(|j| among.scan[*j].identity.is_none()).collect(),
    };
    deciding.decide_named();
    while deciding.assign_some() {}
    deciding.found_or_ignore();
    rules.likelihood_exponent * deciding.log_density
}

/// What is decided so far.
struct Deciding<'a, H> {
    rules: &'a Rules,
    among: Candidates<'a>,
    hypothesis: &'a mut H,
    /// Candidates that explain a sighting already.
    used: &'a mut Vec<u32>,
    decisions: &'a mut [Decision],
    log_density: f64,
    /// Sightings without a decision.
    left: Vec<usize>,
}

impl<H: Hypothesis> Deciding<'_, H> {
    /// Those of which somebody says what they show.
    fn decide_named(&mut self) {
        for index in (0..self.among.scan.len()).filter(|j| self.among.scan[*j].identity.is_some()) {
            let (decision, density) = self.likeliest(index);
            if let Decision::Landmark(candidate) = decision {
                self.hypothesis.accept(candidate, &self.among.scan[index]);
                self.used.push(candidate);
            }
            self.decisions[index] = decision;
            self.log_density += density;
        }
    }

    /// Takes over the surest pair of the best assignment of the rest, or all where the pose is known; tells whether to
    /// go on.
    fn assign_some(&mut self) -> bool {
        let sightings = std::mem::take(&mut self.left);
        let round = Round::new(self.rules, self.among, self.hypothesis, self.used, sightings);
        let pairs = round.pairs(self.rules.least_lead);
        // Nothing that is decided can change the rest when the pose is known.
        let certain = self.hypothesis.pose_is_certain();
        let take = if certain { pairs.len() } else { pairs.len().min(1) };
        self.left = round.sightings.clone();
        for &(row, candidate, density, _) in &pairs[..take] {
            let index = round.sightings[row];
            self.hypothesis.accept(candidate, &self.among.scan[index]);
            self.used.push(candidate);
            self.decisions[index] = Decision::Landmark(candidate);
            self.log_density += density;
            self.left.retain(|j| *j != index);
        }
        !certain && !pairs.is_empty()
    }

    /// What no landmark explains is new where it lies far enough from all.
    fn found_or_ignore(&mut self) {
        for index in std::mem::take(&mut self.left) {
            self.decisions[index] = match self.likeliest(index).0 {
                Decision::New => Decision::New,
                _ => Decision::Ignored,
            };
            self.log_density += self.rules.log_unexplained_density;
        }
    }

    fn likeliest(&self, index: usize) -> (Decision, f64) {
        best_choice(self.rules, self.among, index, self.hypothesis, self.used).decision(self.rules)
    }
}
