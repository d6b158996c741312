//! Populations of maps: for every particle and landmark a few numbers, surviving resampling.
//!
//! All stores keep one contract, [`LandmarkStore`], and give the same bits; they differ in what resampling and
//! touching a landmark cost. The unit of access is a landmark (a *slot*) with one row per particle, in particle order,
//! as columns, so that one vectorised pass can update a landmark in all maps.

mod dense;
mod lineage;
mod tree;

pub use dense::DenseStore;
pub use lineage::LineageStore;
pub use tree::TreeStore;

use crate::workers::Workers;
use schemars::JsonSchema;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// Which store holds the maps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum StoreKind {
    /// Every particle owns a full array: O(M K) per resampling. The reference.
    Dense,
    /// A persistent balanced binary tree per particle, as in the paper: O(M log K) per update, O(M) per resampling.
    Tree,
    /// Landmark-major blocks that follow their lineages lazily: O(M) per update and per resampling.
    #[default]
    Lineage,
}

impl StoreKind {
    /// An empty store for `particles` maps with `columns` numbers per landmark.
    pub fn create(self, particles: usize, columns: usize) -> Box<dyn LandmarkStore> {
        match self {
            Self::Dense => Box::new(DenseStore::new(particles, columns)),
            Self::Tree => Box::new(TreeStore::new(particles, columns)),
            Self::Lineage => Box::new(LineageStore::new(particles, columns)),
        }
    }
}

/// The rows of one landmark in particle order: column c of particle i is `values[c * rows + i]`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rows<'a> {
    values: &'a [f64],
    rows: usize,
}

impl<'a> Rows<'a> {
    /// A view of columns laid out one after the other, each `rows` long.
    pub fn new(values: &'a [f64], rows: usize) -> Self {
        Self { values, rows }
    }

    /// Column `index`, one number per particle.
    pub fn column(&self, index: usize) -> &'a [f64] {
        &self.values[index * self.rows..(index + 1) * self.rows]
    }

    /// All columns, one after the other.
    pub fn values(&self) -> &'a [f64] {
        self.values
    }

    /// Whether every number is one, and at most `limit`.
    pub fn is_within(&self, limit: f64) -> bool {
        self.values.iter().all(|value| value.abs() <= limit)
    }
}

/// [`Rows`] that may be changed.
#[derive(Debug)]
pub struct RowsMut<'a> {
    values: &'a mut [f64],
    rows: usize,
}

impl<'a> RowsMut<'a> {
    /// A view of columns laid out one after the other, each `rows` long.
    pub fn new(values: &'a mut [f64], rows: usize) -> Self {
        Self { values, rows }
    }

    /// The first `N` columns, to be written side by side. There must be that many.
    pub fn columns<const N: usize>(self) -> [&'a mut [f64]; N] {
        let mut rest = self.values;
        std::array::from_fn(|_| {
            let (column, tail) = std::mem::take(&mut rest).split_at_mut(self.rows);
            rest = tail;
            column
        })
    }

    /// The same to be read.
    pub fn as_rows(&self) -> Rows<'_> {
        Rows { values: self.values, rows: self.rows }
    }

    /// Column `index`.
    pub fn column(&mut self, index: usize) -> &mut [f64] {
        &mut self.values[index * self.rows..(index + 1) * self.rows]
    }
}

/// What a store occupies.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StoreUsage {
    /// Rows held: one per landmark and distinct copy of it.
    pub rows: usize,
    /// Bytes of rows and of what is needed to find them.
    pub bytes: usize,
}

/// A population of maps.
///
/// A row with zero in column 0 is *absent*: that particle's map lacks the landmark, and its other numbers are zero
/// when it is read. Slots are small numbers chosen by the caller, who may use one again after removing it.
pub trait LandmarkStore: Send + Sync {
    /// Number of maps.
    fn particle_count(&self) -> usize;

    /// Adds a landmark, with the rows of all particles as columns one after the other. What the slot held is gone.
    fn insert(&mut self, slot: u32, values: &[f64]);

    /// Adds a landmark whose row is the same in all maps: one row, which is copied where a map changes it. What the slot
    /// held is gone.
    fn insert_shared(&mut self, slot: u32, row: &[f64]);

    /// Empties a slot in all maps.
    fn remove(&mut self, slot: u32);

    /// The rows of a landmark. All are absent when the slot is empty.
    fn read(&mut self, slot: u32) -> Rows<'_>;

    /// Copies the rows of a landmark in particle order, column after column. All are absent when the slot is empty.
    fn copy_rows(&mut self, slot: u32, out: &mut [f64]) {
        out.copy_from_slice(self.read(slot).values);
    }

    /// Prepares for several reads of a landmark before the next resampling; changes nothing of what they give.
    fn expect_reads(&mut self, _slot: u32) {}

    /// The numbers of one particle's landmark; false when it is absent.
    fn read_row(&self, slot: u32, particle: usize, out: &mut [f64]) -> bool;

    /// Number of maps that hold a landmark. Zero means that its slot can be used again.
    fn holders(&mut self, slot: u32) -> usize;

    /// Changes a landmark through `change`, which sees the rows of all particles and may alter those that `changed`
    /// marks (all when there is no mask). Of an empty slot it sees absent rows, which it may fill.
    fn update(&mut self, slot: u32, changed: Option<&[bool]>, change: &mut dyn FnMut(RowsMut<'_>));

    /// Map i becomes a copy of the former map `ancestor_indices[i]`; their number may change.
    fn resample(&mut self, ancestor_indices: &[u32]);

    /// Threads that may share the particles of a touch.
    fn set_workers(&mut self, _workers: &Workers) {}

    /// What the population occupies.
    fn usage(&self) -> StoreUsage;

    /// Which of the stores this is.
    fn kind(&self) -> StoreRef<'_>;
}

/// One of the stores.
#[derive(Clone, Copy, Debug, Serialize)]
pub enum StoreRef<'a> {
    /// The reference.
    Dense(&'a DenseStore),
    /// That of the paper.
    Tree(&'a TreeStore),
    /// The default.
    Lineage(&'a LineageStore),
}

/// What [`StoreRef`] writes, read again.
#[derive(Deserialize)]
enum Stored {
    Dense(Box<DenseStore>),
    Tree(Box<TreeStore>),
    Lineage(Box<LineageStore>),
}

impl Clone for Box<dyn LandmarkStore> {
    /// An independent copy of the whole population.
    fn clone(&self) -> Self {
        match self.kind() {
            StoreRef::Dense(store) => Box::new(store.clone()),
            StoreRef::Tree(store) => Box::new(store.clone()),
            StoreRef::Lineage(store) => Box::new(store.clone()),
        }
    }
}

impl Serialize for Box<dyn LandmarkStore> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.kind().serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for Box<dyn LandmarkStore> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Ok(match Stored::deserialize(deserializer)? {
            Stored::Dense(store) => store,
            Stored::Tree(store) => store,
            Stored::Lineage(store) => store,
        })
    }
}

#[cfg(test)]
mod tests;
