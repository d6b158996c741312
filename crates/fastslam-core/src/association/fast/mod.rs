//! Decisions of many particles at once, by maximum likelihood or drawn, as passes of vector code over blocks of
//! particles.
//!
//! Every particle gets what [`super::decide()`] or [`super::decide_sampled()`] gives it alone, bit by bit: the same
//! operations in the same order. What differs from particle to particle (which sighting it decides next, which candidates
//! its map has) is gathered into columns before the arithmetic.

mod draw;
mod drawn;
mod lanes;

use super::rules::Rules;
use super::settings::{AssociationOrder, Exclusion, Method};
use super::table::{CandidateTable, Decision, Evidence};
use crate::density::Tail;
use crate::geometry::Pose;
use crate::landmark::column;
use crate::measurement::Placing;
use crate::random::Stream;
use crate::sighting::{Measured, ScanSighting};
use drawn::Drawn;
pub use lanes::BLOCK;
use lanes::{rank, Best, Candidate, Column, Lanes, Sight, ZERO};

/// Passes go over a multiple of this many particles, so that no vector unit has a remainder to do one by one.
const VECTOR: usize = 8;

/// Scans of more sightings than this are sorted particle by particle: counting costs the square of the sightings.
const MOST_COUNTED: usize = 128;

/// A scan and what it is compared with.
#[derive(Debug)]
pub struct Question<'a, M> {
    /// The rules.
    pub rules: &'a Rules,
    /// How the sensor measures.
    pub model: &'a M,
    /// Where the sensor is on the robot.
    pub T_robot_sensor: Pose,
    /// What was sighted.
    pub scan: &'a [ScanSighting],
    /// What may have been sighted.
    pub table: &'a CandidateTable,
    /// What speaks for that beside the place.
    pub evidence: &'a Evidence,
    /// Chance, where decisions are drawn: a number by particle and sighting.
    pub stream: Stream,
}

/// What at most [`BLOCK`] particles make of it.
#[derive(Debug)]
pub struct Answers<'a> {
    /// Beliefs as columns: mean (x, y, heading), then the covariance's xx, xy, xh, yy, yh, hh. Refined on return.
    pub beliefs: [&'a mut [f64]; 9],
    /// As many per particle as there are sightings.
    pub decisions: &'a mut [Decision],
    /// Log-likelihood of the scan, tempered.
    pub log_likelihood: &'a mut [f64],
}

/// What the particles of a block have to remember; kept from block to block.
#[derive(Clone, Debug, Default)]
pub struct Workspace {
    lanes: Box<Lanes>,
    best: Box<Best>,
    drawn: Box<Drawn>,
    /// Those of the table, in the maps of the block.
    candidates: Vec<Candidate>,
    /// What each particle compares with when it comes to that: for each another one.
    gathered: Box<Candidate>,
    /// Pairs of a sighting with a candidate of its own, sighting by sighting.
    pairs: Vec<u32>,
    /// Per sighting, the first of its pairs; and their number.
    first_pair: Vec<u32>,
    /// Per pair, what speaks for it beside the place; empty where nothing speaks for any.
    evidence: Vec<Column>,
    /// Per pair, how well the two fit by the beliefs before the scan, the evidence included.
    fits: Vec<[Column; 2]>,
    /// Per sighting, by how much its best explanation beats the next.
    margins: Vec<[i64; BLOCK]>,
    /// Per rank, which sighting each particle decides then.
    order: Vec<[u32; BLOCK]>,
    /// Margins of one particle that ascend where they descend, with the sightings.
    keys: Vec<(i64, u32)>,
}

/// In which order the particles of a block decide.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Order {
    /// As the sightings come; no pose can be refined.
    Certain,
    /// As the sightings come.
    Given,
    /// Each its own.
    Own,
}

/// Whether the particles can decide about a scan together: each sighting by itself, nobody names a landmark, and the noise
/// has one kind of tail.
pub fn applies(method: Method, scan: &[ScanSighting]) -> bool {
    let tail = scan.first().map(|sighting| sighting.measured.tail);
    matches!(method, Method::MaximumLikelihood | Method::Sampled)
        && scan.iter().all(|sighting| sighting.identity.is_none() && Some(sighting.measured.tail) == tail)
}

/// Decides about every sighting of a scan to which this [`applies`], for a block of particles that begins with number
/// `first`.
///
/// **Source:** as [`super::decide()`] and [`super::decide_sampled()`].
pub fn decide_block<M: Placing>(
    question: &Question<'_, M>,
    first: usize,
    answers: Answers<'_>,
    workspace: &mut Workspace,
) {
    let Answers { mut beliefs, decisions, log_likelihood } = answers;
    let count = log_likelihood.len().min(BLOCK);
    let tail = question.scan.first().map_or(Tail::Gaussian, |sighting| sighting.measured.tail);
    tail.vectorized(
        #[inline(always)]
        |tail| {
            let mut block = Block { question, tail, first, count, workspace };
            block.load(&beliefs);
            let order = block.put_in_order();
            for rank in 0..question.scan.len() {
                if question.rules.method == Method::Sampled {
                    block.draw(rank, order, decisions);
                } else {
                    block.choose(rank, order);
                    block.settle(rank, order, decisions);
                }
            }
            block.store(&mut beliefs, log_likelihood);
        },
    );
}

/// One block at work.
struct Block<'a, 'b, M> {
    question: &'a Question<'b, M>,
    tail: Tail,
    first: usize,
    count: usize,
    workspace: &'a mut Workspace,
}

impl<'b, M: Placing> Block<'_, 'b, M> {
    /// Particles, with those that only fill the last vector.
    #[inline(always)]
    fn width(&self) -> usize {
        self.count.next_multiple_of(VECTOR).min(BLOCK)
    }

    /// How sightings are seen.
    #[inline(always)]
    fn sight(&self) -> Sight<'b, M> {
        Sight { model: self.question.model, tail: self.tail }
    }

    /// Takes the beliefs over, and the candidates.
    #[inline(always)]
    fn load(&mut self, beliefs: &[&mut [f64]; 9]) {
        let (width, count, first, table) = (self.width(), self.count, self.first, self.question.table);
        let Workspace { lanes, candidates, pairs, first_pair, evidence, .. } = &mut *self.workspace;
        for (column, belief) in lanes.belief.iter_mut().zip(beliefs) {
            column[..count].copy_from_slice(&belief[..count]);
        }
        lanes.begin(width, self.question.T_robot_sensor);
        candidates.resize_with(table.slots.len(), Candidate::default);
        for (candidate, number) in candidates.iter_mut().zip(0..) {
            take(&mut candidate.presence, count, table.values_from(number, column::SIGHTINGS, first));
            candidate.is_held = candidate.presence[..count].iter().any(|presence| *presence != 0.0);
            for (column, index) in candidate.gaussian.iter_mut().zip(column::MEAN_X..) {
                take(column, count, table.values_from(number, index, first));
            }
        }
        pairs.clear();
        first_pair.clear();
        for candidates in &table.of_sighting {
            first_pair.push(pairs.len() as u32);
            pairs.extend_from_slice(candidates);
        }
        first_pair.push(pairs.len() as u32);
        let speaks = &self.question.evidence;
        evidence.resize(if speaks.of(0).is_some() { pairs.len() } else { 0 }, ZERO);
        for (own, pair) in evidence.iter_mut().zip(0..) {
            take(own, count, speaks.values_from(pair, first));
        }
    }

    /// Gives the beliefs back, and the log-likelihoods.
    #[inline(always)]
    fn store(&self, beliefs: &mut [&mut [f64]; 9], log_likelihood: &mut [f64]) {
        let lanes = &self.workspace.lanes;
        for (column, belief) in lanes.belief.iter().zip(beliefs) {
            belief[..self.count].copy_from_slice(&column[..self.count]);
        }
        log_likelihood[..self.count].copy_from_slice(&lanes.log_likelihood[..self.count]);
    }

    /// Compares every sighting with every candidate of its own, by the beliefs before the scan.
    #[inline(always)]
    fn compare_all(&mut self, certain: bool) {
        let (width, tail, Question { model, scan, .. }) = (self.width(), self.tail, self.question);
        let Workspace { lanes, candidates, pairs, first_pair, evidence, fits, .. } = &mut *self.workspace;
        fits.resize(pairs.len(), [ZERO; 2]);
        for (sighting, range) in scan.iter().zip(first_pair.windows(2)) {
            let range = range[0] as usize..range[1] as usize;
            let measured = Measured { tail, ..sighting.measured };
            for (candidate, fit) in pairs[range.clone()].iter().zip(&mut fits[range]) {
                let candidate = &candidates[*candidate as usize];
                if !candidate.is_held {
                    continue;
                }
                if certain {
                    lanes.compare_certain(width, *model, &measured, candidate, fit);
                } else {
                    lanes.compare(width, *model, &measured, candidate, fit);
                }
            }
        }
        for ([log_likelihood, _], evidence) in fits.iter_mut().zip(evidence) {
            log_likelihood.iter_mut().zip(evidence).for_each(|(value, more)| *value += *more);
        }
    }

    /// The order in which each particle decides, as `order_decisions` has it.
    #[inline(always)]
    fn put_in_order(&mut self) -> Order {
        let (width, sightings) = (self.width(), self.question.scan.len());
        if self.workspace.lanes.uncertain[..self.count].iter().all(|uncertain| *uncertain == 0.0) {
            self.compare_all(true);
            return Order::Certain;
        }
        if self.question.rules.order != AssociationOrder::LeastAmbiguousFirst || sightings < 2 {
            return Order::Given;
        }
        self.compare_all(false);
        self.workspace.margins.resize(sightings, [0; BLOCK]);
        self.workspace.order.resize(sightings, [0; BLOCK]);
        for j in 0..sightings {
            self.choose_before(j);
            let Workspace { best, margins, lanes, .. } = &mut *self.workspace;
            best.margins(width, self.question.rules.log_unexplained_density, &lanes.uncertain, &mut margins[j]);
        }
        self.rank_all();
        Order::Own
    }

    /// Puts the sightings of each particle in order, the largest margin first; of equal ones the earlier first.
    #[inline(always)]
    fn rank_all(&mut self) {
        let (sightings, count) = (self.question.scan.len(), self.count);
        let Workspace { margins, order, keys, .. } = &mut *self.workspace;
        if sightings > MOST_COUNTED {
            for i in 0..count {
                keys.clear();
                keys.extend(margins[..sightings].iter().zip(0..).map(|(margins, j)| (!margins[i], j)));
                keys.sort_unstable();
                order.iter_mut().zip(&*keys).for_each(|(order, (_, j))| order[i] = *j);
            }
            return;
        }
        let mut ranks = [0; BLOCK];
        for j in 0..sightings {
            rank(&margins[..sightings], j, &mut ranks);
            for (i, rank) in ranks[..count].iter().enumerate() {
                order[*rank as usize][i] = j as u32;
            }
        }
    }

    /// The best candidate of a sighting by the beliefs before the scan.
    #[inline(always)]
    fn choose_before(&mut self, j: usize) {
        let width = self.width();
        let Workspace { best, candidates, fits, pairs, first_pair, .. } = &mut *self.workspace;
        best.clear(self.question.rules.log_unexplained_density);
        let range = first_pair[j] as usize..first_pair[j + 1] as usize;
        for (place, (candidate, fits)) in pairs[range.clone()].iter().zip(&fits[range]).enumerate() {
            best.weigh_all(width, place, &candidates[*candidate as usize].presence, fits);
        }
    }

    /// The best candidate of the sighting that is next.
    #[inline(always)]
    fn choose(&mut self, rank: usize, order: Order) {
        let (width, sight) = (self.width(), self.sight());
        self.workspace.best.clear(self.question.rules.log_unexplained_density);
        match order {
            Order::Certain => self.choose_before(rank),
            Order::Given => {
                self.set_measured(rank);
                let range = self.workspace.first_pair[rank] as usize..self.workspace.first_pair[rank + 1] as usize;
                for (place, pair) in range.enumerate() {
                    self.set_evidence(pair);
                    let Workspace { lanes, best, candidates, pairs, .. } = &mut *self.workspace;
                    let candidate = &candidates[pairs[pair] as usize];
                    if candidate.is_held {
                        lanes.consider(width, &sight, place, candidate, best);
                    }
                }
            }
            Order::Own => {
                for place in 0..self.gather_measured(rank) {
                    self.gather_candidates(rank, place);
                    let Workspace { lanes, best, gathered, .. } = &mut *self.workspace;
                    lanes.consider(width, &sight, place, gathered, best);
                }
            }
        }
    }

    /// All particles decide about the same sighting.
    #[inline(always)]
    fn set_measured(&mut self, j: usize) {
        let numbers = numbers(&self.question.scan[j].measured);
        for (column, number) in self.workspace.lanes.measured.iter_mut().zip(numbers) {
            *column = [number; BLOCK];
        }
    }

    /// All particles consider the same pair.
    #[inline(always)]
    fn set_evidence(&mut self, pair: usize) {
        if let Some(evidence) = self.workspace.evidence.get(pair) {
            self.workspace.lanes.evidence = *evidence;
        }
    }

    /// The sighting that each particle decides; returns how many candidates one of these has at most.
    #[inline(always)]
    fn gather_measured(&mut self, rank: usize) -> usize {
        let Workspace { lanes, order, first_pair, .. } = &mut *self.workspace;
        let mut most = 0;
        for (i, &j) in order[rank][..self.count].iter().enumerate() {
            let numbers = numbers(&self.question.scan[j as usize].measured);
            for (column, number) in lanes.measured.iter_mut().zip(numbers) {
                column[i] = number;
            }
            most = most.max(first_pair[j as usize + 1] - first_pair[j as usize]);
        }
        most as usize
    }

    /// The candidate of each particle that stands at `place` among those of its sighting.
    #[inline(always)]
    fn gather_candidates(&mut self, rank: usize, place: usize) {
        let Workspace { lanes, gathered, order, candidates, pairs, first_pair, evidence, .. } = &mut *self.workspace;
        for (i, &j) in order[rank][..self.count].iter().enumerate() {
            let pair = first_pair[j as usize] as usize + place;
            if pair >= first_pair[j as usize + 1] as usize {
                gathered.presence[i] = 0.0;
                continue;
            }
            if let Some(evidence) = evidence.get(pair) {
                lanes.evidence[i] = evidence[i];
            }
            let candidate = &candidates[pairs[pair] as usize];
            gathered.presence[i] = candidate.presence[i];
            for (column, own) in gathered.gaussian.iter_mut().zip(&candidate.gaussian) {
                column[i] = own[i];
            }
        }
    }

    /// Decides about the sighting that is next by its best candidate.
    #[inline(always)]
    fn settle(&mut self, rank: usize, order: Order, decisions: &mut [Decision]) {
        let (width, rules) = (self.width(), self.question.rules);
        let Workspace { lanes, best, .. } = &mut *self.workspace;
        let densities = [rules.log_new_density, rules.log_unexplained_density];
        best.settle(
            width,
            [rules.gate, rules.least_lead],
            densities,
            (rules.likelihood_exponent, &mut lanes.log_likelihood),
        );
        self.write_down(rank, order, decisions);
    }

    /// Writes the decisions down and refines the beliefs by them.
    #[inline(always)]
    fn write_down(&mut self, rank: usize, order: Order, decisions: &mut [Decision]) {
        let (width, sight, question) = (self.width(), self.sight(), self.question);
        let (rules, sightings) = (question.rules, question.scan.len());
        let Workspace { lanes, best, order: own, candidates, pairs, first_pair, .. } = &mut *self.workspace;
        for i in 0..self.count {
            let j = if order == Order::Own { own[rank][i] as usize } else { rank };
            decisions[i * sightings + j] = if best.accepted[i] != 0.0 {
                let candidate = pairs[first_pair[j] as usize + best.place[i] as usize];
                if rules.exclusion == Exclusion::OneSighting {
                    candidates[candidate as usize].presence[i] = 0.0;
                }
                Decision::Landmark(candidate)
            } else if best.ignored[i] != 0.0 {
                Decision::Ignored
            } else {
                Decision::New
            };
        }
        if order != Order::Certain {
            lanes.refine(width, &sight, question.T_robot_sensor, best);
        }
    }
}

/// Takes the first `count` numbers over, with those that follow where there are any: beyond the count anything may stand.
///
/// **Why:** a copy whose length is known is a few instructions, any other is a call.
#[inline(always)]
fn take(column: &mut Column, count: usize, values: &[f64]) {
    match values.first_chunk() {
        Some(whole) => *column = *whole,
        None => column[..count].copy_from_slice(&values[..count]),
    }
}

/// A sighting as it stands in [`Lanes::measured`].
#[inline(always)]
fn numbers(measured: &Measured) -> [f64; 5] {
    let Measured { value: [a, b], noise, .. } = *measured;
    [a, b, noise.xx, noise.xy, noise.yy]
}

#[cfg(test)]
mod tests;
