//! How sure every map is that its landmarks exist, with the odds of sighting them that follow.

use crate::math;
use crate::store::{LandmarkStore, Rows, RowsMut, StoreKind, StoreUsage};
use crate::vector::vectorized;
use crate::workers::Workers;
use rustc_hash::FxHashMap;
use serde::{Deserialize, Serialize};

/// Columns of the store: whether the row counts, and the log-odds.
pub(super) const EXISTENCE_COLUMNS: usize = 2;

/// Log-odds of existence by slot. What follows from those of the last scan's candidates is kept while they last.
#[derive(Clone, Serialize, Deserialize)]
#[serde(transparent)]
pub(super) struct Existence {
    store: Box<dyn LandmarkStore>,
    #[serde(skip)]
    last: Detections,
    /// Those of the scan before, whose memory is used again.
    #[serde(skip)]
    former: Detections,
}

/// The odds that landmarks are sighted rather than missed, as logarithms.
#[derive(Clone, Default)]
struct Detections {
    /// Which column is a slot's, of those that still hold.
    columns: FxHashMap<u32, usize>,
    /// A column of all particles for each candidate.
    values: Vec<f64>,
    /// Probability of the detection of what exists.
    detection: f64,
}

impl Detections {
    /// Of so many maps, map i becomes a copy of map `ancestor_indices[i]`; `spare` is used for its memory.
    fn resample(&mut self, maps: usize, ancestor_indices: &[u32], spare: &mut Vec<f64>) {
        spare.clear();
        for column in self.values.chunks_exact(maps) {
            spare.extend(ancestor_indices.iter().map(|ancestor| column[*ancestor as usize]));
        }
        std::mem::swap(&mut self.values, spare);
    }
}

impl Existence {
    /// For so many empty maps.
    pub fn new(kind: StoreKind, particles: usize) -> Self {
        let store = kind.create(particles, EXISTENCE_COLUMNS);
        Self { store, last: Detections::default(), former: Detections::default() }
    }

    /// Threads that may share the particles of a landmark.
    pub fn set_workers(&mut self, workers: &Workers) {
        self.store.set_workers(workers);
    }

    /// Fills an empty slot with the rows of all particles.
    pub fn insert(&mut self, slot: u32, values: &[f64]) {
        self.last.columns.remove(&slot);
        self.store.insert(slot, values);
    }

    /// Fills an empty slot with a row for all particles.
    pub fn insert_shared(&mut self, slot: u32, row: &[f64]) {
        self.last.columns.remove(&slot);
        self.store.insert_shared(slot, row);
    }

    /// Empties a slot.
    pub fn remove(&mut self, slot: u32) {
        self.last.columns.remove(&slot);
        self.store.remove(slot);
    }

    /// Prepares for several reads of a landmark.
    pub fn expect_reads(&mut self, slot: u32) {
        self.store.expect_reads(slot);
    }

    /// The rows of a landmark in particle order.
    pub fn read(&mut self, slot: u32) -> Rows<'_> {
        self.store.read(slot)
    }

    /// Changes a landmark in the maps that `mask` marks.
    pub fn update(&mut self, slot: u32, mask: &[bool], change: &mut dyn FnMut(RowsMut<'_>)) {
        self.last.columns.remove(&slot);
        self.store.update(slot, Some(mask), change);
    }

    /// Map i becomes a copy of the former map `ancestor_indices[i]`.
    pub fn resample(&mut self, ancestor_indices: &[u32]) {
        self.last.resample(self.store.particle_count(), ancestor_indices, &mut self.former.values);
        self.store.resample(ancestor_indices);
    }

    /// What the numbers occupy.
    pub fn usage(&self) -> StoreUsage {
        self.store.usage()
    }

    /// The odds that each of these landmarks is sighted rather than missed, r P_D / (1 − r P_D), as logarithms: a column of
    /// all particles for each.
    ///
    /// **Why kept:** a scan changes the log-odds of what it should have shown alone, and of few candidates.
    pub fn detection_odds(&mut self, slots: &[u32], detection: f64) -> &[f64] {
        let n = self.store.particle_count();
        let Self { store, last, former } = self;
        std::mem::swap(last, former);
        last.columns.clear();
        last.detection = detection;
        last.values.resize(slots.len() * n, 0.0);
        for (place, (&slot, odds)) in slots.iter().zip(last.values.chunks_exact_mut(n)).enumerate() {
            match former.columns.get(&slot).filter(|_| former.detection == detection) {
                Some(column) => odds.copy_from_slice(&former.values[column * n..][..n]),
                None => write_detection_odds(store.read(slot).column(1), detection, odds),
            }
            last.columns.insert(slot, place);
        }
        &last.values
    }
}

/// Writes the odds of a sighting that follow from log-odds of existence.
fn write_detection_odds(log_odds: &[f64], detection: f64, odds: &mut [f64]) {
    vectorized(
        #[inline(always)]
        || {
            for (value, log_odds) in odds.iter_mut().zip(log_odds) {
                let seen = math::logistic(*log_odds) * detection;
                *value = math::ln(seen / (1.0 - seen));
            }
        },
    );
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn odds_that_were_kept_are_those_of_the_numbers_now() {
        let (n, detection) = (5, 0.3);
        let mut existence = Existence::new(StoreKind::Lineage, n);
        let rows = |first: f64| (0..2 * n).map(|i| if i < n { 1.0 } else { first + i as f64 }).collect::<Vec<_>>();
        (0..4).for_each(|slot| existence.insert(slot, &rows(f64::from(slot) - 8.0)));
        let check = |existence: &mut Existence, slots: &[u32], detection: f64| {
            let kept: Vec<f64> = existence.detection_odds(slots, detection).to_vec();
            assert_eq!(kept.len(), slots.len() * n);
            for (slot, kept) in slots.iter().zip(kept.chunks_exact(n)) {
                let mut anew = vec![0.0; n];
                write_detection_odds(existence.read(*slot).column(1), detection, &mut anew);
                assert_eq!(kept, anew, "landmark {slot}");
            }
        };
        check(&mut existence, &[0, 1, 2], detection);
        check(&mut existence, &[3, 0, 2], detection);
        existence.update(0, &[true; 5], &mut |rows| rows.columns::<2>()[1][3] = 7.0);
        check(&mut existence, &[3, 0, 2, 1], detection);
        existence.resample(&[4, 4, 0, 1, 2]);
        check(&mut existence, &[0, 1, 3], detection);
        existence.remove(1);
        existence.insert(1, &rows(2.5));
        check(&mut existence, &[1, 3], detection);
        check(&mut existence, &[1, 3], 0.9);
    }
}
