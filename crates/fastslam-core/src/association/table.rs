//! The landmarks that a scan may show, how well they fit, and what is decided about each sighting.

use crate::density::Fit;
use crate::gaussian::{Gaussian, GaussianOf};
use crate::landmark::{column, Planar};
use crate::store::Rows;
use rustc_hash::FxHashMap;

/// What a particle decides about a sighting.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Decision {
    /// It shows this landmark (an index into the candidate table).
    Landmark(u32),
    /// It shows a landmark that the map lacks.
    New,
    /// It shows nothing that the map should know.
    Ignored,
}

impl Decision {
    /// The candidate, or a number that is none.
    pub fn number(&self) -> u32 {
        match self {
            Self::Landmark(candidate) => *candidate,
            Self::New => u32::MAX,
            Self::Ignored => u32::MAX - 1,
        }
    }
}

/// Landmarks that some particle might have seen in a scan, with their rows.
#[derive(Clone, Debug, Default)]
pub struct CandidateTable {
    /// Slot of each candidate, in the order of birth.
    pub slots: Vec<u32>,
    /// Candidates of each sighting: indices into `slots`, ascending.
    pub of_sighting: Vec<Vec<u32>>,
    /// Rows of candidate c: `columns` columns of `particles` numbers each. Beyond the candidates there is anything.
    pub values: Vec<f64>,
    /// Particles.
    pub particles: usize,
    /// Columns per candidate.
    pub columns: usize,
    /// Which candidate a slot is.
    index: FxHashMap<u32, u32>,
    /// Lists of candidates of longer scans; kept for their memory.
    spare: Vec<Vec<u32>>,
}

impl CandidateTable {
    /// Empties the table, for so many sightings.
    pub fn clear(&mut self, sightings: usize) {
        self.slots.clear();
        while self.of_sighting.len() > sightings {
            self.spare.extend(self.of_sighting.pop());
        }
        while self.of_sighting.len() < sightings {
            self.of_sighting.push(self.spare.pop().unwrap_or_default());
        }
        self.of_sighting.iter_mut().for_each(Vec::clear);
    }

    /// Turns the slots that [`Self::of_sighting`] names into candidates; those that are none disappear.
    pub fn number_candidates(&mut self) {
        let Self { slots, of_sighting, index, .. } = self;
        index.clear();
        index.extend(slots.iter().copied().zip(0..));
        for found in of_sighting {
            found.retain_mut(|slot| match index.get(slot) {
                Some(candidate) => {
                    *slot = *candidate;
                    true
                }
                None => false,
            });
            found.sort_unstable();
            found.dedup();
        }
    }

    /// Which candidate a slot is, if it is one.
    pub fn candidate_of(&self, slot: u32) -> Option<u32> {
        self.index.get(&slot).copied()
    }

    #[inline(always)]
    fn value(&self, candidate: u32, column: usize, particle: usize) -> f64 {
        self.values[(candidate as usize * self.columns + column) * self.particles + particle]
    }

    /// A column of a candidate from this particle on, and all numbers that stand behind it.
    #[inline(always)]
    pub(super) fn values_from(&self, candidate: u32, column: usize, particle: usize) -> &[f64] {
        &self.values[(candidate as usize * self.columns + column) * self.particles + particle..]
    }

    /// The rows of a candidate.
    pub fn rows(&self, candidate: u32) -> Rows<'_> {
        let size = self.columns * self.particles;
        Rows::new(&self.values[candidate as usize * size..][..size], self.particles)
    }

    /// Whether one particle's map has the landmark.
    #[inline(always)]
    pub(super) fn holds(&self, candidate: u32, particle: usize) -> bool {
        self.value(candidate, column::SIGHTINGS, particle) != 0.0
    }

    /// The landmark in one particle's map, if it is there.
    #[inline(always)]
    pub fn gaussian(&self, candidate: u32, particle: usize) -> Option<Gaussian> {
        if !self.holds(candidate, particle) {
            return None;
        }
        let size = self.columns * self.particles;
        let values = &self.values[candidate as usize * size..][..size];
        let at = |column: usize| values[column * self.particles + particle];
        let mean = std::array::from_fn(|axis| at(Planar::mean(axis)));
        Some(Gaussian::from_entries(mean, |a, b| at(Planar::covariance(a, b))))
    }

    /// Identity that the landmark was seen with in one particle's map, plus one; 0 for none.
    pub(super) fn identity_mark(&self, candidate: u32, particle: usize) -> f64 {
        if self.columns > column::IDENTITY {
            self.value(candidate, column::IDENTITY, particle)
        } else {
            0.0
        }
    }
}

/// What speaks for each pair of a sighting with a candidate of its own beside the place, in every map: logarithms, or none
/// at all.
#[derive(Clone, Debug, Default)]
pub struct Evidence {
    /// One number per particle and pair; pairs in the order of the sightings, then of their candidates.
    values: Vec<f64>,
    particles: usize,
}

impl Evidence {
    /// Forgets what spoke for the pairs of the scan before.
    pub fn clear(&mut self) {
        self.values.clear();
    }

    /// Lets `add` say what speaks for every pair: it gets the sighting, the candidate, and a column of zeros to add
    /// logarithms to.
    pub fn gather(&mut self, table: &CandidateTable, mut add: impl FnMut(usize, u32, &mut [f64])) {
        let n = table.particles;
        self.particles = n;
        self.values.clear();
        for (j, candidates) in table.of_sighting.iter().enumerate() {
            for candidate in candidates {
                let begin = self.values.len();
                self.values.resize(begin + n, 0.0);
                add(j, *candidate, &mut self.values[begin..]);
            }
        }
    }

    /// What speaks for a pair from this particle on, and all numbers that stand behind it.
    #[inline(always)]
    pub(super) fn values_from(&self, pair: usize, particle: usize) -> &[f64] {
        &self.values[pair * self.particles + particle..]
    }

    /// What speaks for a pair in every map; `None` where nothing speaks for any.
    #[inline(always)]
    pub(super) fn of(&self, pair: usize) -> Option<&[f64]> {
        self.values.get(pair * self.particles..(pair + 1) * self.particles).filter(|column| !column.is_empty())
    }
}

/// How well every candidate of every sighting fits in every map, with the beliefs before the scan.
///
/// **Why:** worked out for all particles in passes of vector code, before the particles decide one by one.
#[derive(Clone, Debug, Default)]
pub struct FitTable {
    /// What else speaks for each pair.
    pub evidence: Evidence,
    /// Per sighting, the first of its pairs with a candidate.
    first_pair: Vec<usize>,
    /// Log-likelihoods with the evidence, then squared Mahalanobis distances, of all particles; per pair.
    values: Vec<f64>,
    particles: usize,
}

impl FitTable {
    /// Lays out the pairs of the table, lets `fill` write each, and adds the evidence. `fill` gets the sighting, the
    /// candidate, and the columns of log-likelihoods and squared distances. Where a map lacks the candidate, what is
    /// written does not count.
    pub fn fill(&mut self, table: &CandidateTable, mut fill: impl FnMut(usize, u32, &mut [f64], &mut [f64])) {
        self.particles = table.particles;
        self.first_pair.clear();
        let mut pairs = 0;
        for candidates in &table.of_sighting {
            self.first_pair.push(pairs);
            pairs += candidates.len();
        }
        self.values.resize(2 * self.particles * pairs, 0.0);
        let mut columns = self.values.chunks_exact_mut(2 * self.particles.max(1)).enumerate();
        for (j, candidates) in table.of_sighting.iter().enumerate() {
            for (candidate, (pair, columns)) in candidates.iter().zip(&mut columns) {
                let (log_likelihood, mahalanobis_squared) = columns.split_at_mut(self.particles);
                fill(j, *candidate, log_likelihood, mahalanobis_squared);
                if let Some(evidence) = self.evidence.of(pair) {
                    log_likelihood.iter_mut().zip(evidence).for_each(|(value, more)| *value += *more);
                }
            }
        }
    }

    /// What else speaks for a pair.
    #[inline(always)]
    pub(super) fn evidence(&self, sighting: usize, place: usize, particle: usize) -> f64 {
        self.evidence.of(self.first_pair[sighting] + place).map_or(0.0, |column| column[particle])
    }

    /// The fit of the candidate that stands at `place` among those of a sighting.
    #[inline(always)]
    pub(super) fn get(&self, sighting: usize, place: usize, particle: usize) -> Fit {
        let at = 2 * self.particles * (self.first_pair[sighting] + place) + particle;
        Fit { log_likelihood: self.values[at], mahalanobis_squared: self.values[at + self.particles] }
    }
}
