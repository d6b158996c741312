//! The reference store: every particle owns every landmark, once it was touched.

use super::{LandmarkStore, Rows, RowsMut, StoreRef, StoreUsage};
use serde::{Deserialize, Serialize};

/// One full block of rows per landmark, copied at every resampling: O(M K). A landmark that came with one row for all maps is
/// that row until it is changed.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct DenseStore {
    particles: usize,
    columns: usize,
    /// By slot: a row of each particle, column after column; one row of all; or nothing.
    blocks: Vec<Vec<f64>>,
    empty: Vec<f64>,
    /// Rows of a landmark that is one row, while it is read.
    #[serde(skip)]
    spread: Vec<f64>,
}

impl DenseStore {
    /// An empty store for `particles` maps with `columns` numbers per landmark.
    pub fn new(particles: usize, columns: usize) -> Self {
        Self { particles, columns, blocks: Vec::new(), empty: vec![0.0; particles * columns], spread: Vec::new() }
    }
}

/// The same row `particles` times, column after column.
fn spread_out(row: &[f64], particles: usize, out: &mut Vec<f64>) {
    out.clear();
    row.iter().for_each(|value| out.resize(out.len() + particles, *value));
}

impl DenseStore {
    /// Room for a slot.
    fn block_mut(&mut self, slot: u32) -> &mut Vec<f64> {
        let slot = slot as usize;
        if slot >= self.blocks.len() {
            self.blocks.resize_with(slot + 1, Vec::new);
        }
        &mut self.blocks[slot]
    }
}

impl LandmarkStore for DenseStore {
    fn particle_count(&self) -> usize {
        self.particles
    }

    fn insert(&mut self, slot: u32, values: &[f64]) {
        self.update(slot, None, &mut |rows| rows.values.copy_from_slice(values));
    }

    fn insert_shared(&mut self, slot: u32, row: &[f64]) {
        let held = if row[0] == 0.0 { Vec::new() } else { row.to_vec() };
        *self.block_mut(slot) = held;
    }

    fn remove(&mut self, slot: u32) {
        if let Some(block) = self.blocks.get_mut(slot as usize) {
            *block = Vec::new();
        }
    }

    fn read(&mut self, slot: u32) -> Rows<'_> {
        match self.blocks.get(slot as usize) {
            Some(block) if block.len() == self.empty.len() => Rows::new(block, self.particles),
            Some(row) if !row.is_empty() => {
                spread_out(row, self.particles, &mut self.spread);
                Rows::new(&self.spread, self.particles)
            }
            _ => Rows::new(&self.empty, self.particles),
        }
    }

    fn read_row(&self, slot: u32, particle: usize, out: &mut [f64]) -> bool {
        match self.blocks.get(slot as usize) {
            Some(block) if !block.is_empty() => {
                let rows = block.len() / self.columns;
                let row = if rows == self.particles { particle } else { 0 };
                for (c, value) in out.iter_mut().enumerate() {
                    *value = block[c * rows + row];
                }
                out[0] != 0.0
            }
            _ => false,
        }
    }

    fn holders(&mut self, slot: u32) -> usize {
        self.read(slot).column(0).iter().filter(|value| **value != 0.0).count()
    }

    fn update(&mut self, slot: u32, _changed: Option<&[bool]>, change: &mut dyn FnMut(RowsMut<'_>)) {
        let (particles, columns) = (self.particles, self.columns);
        let block = self.block_mut(slot);
        if block.len() != particles * columns {
            let row = std::mem::take(block);
            spread_out(&row, particles, block);
            block.resize(particles * columns, 0.0);
        }
        change(RowsMut::new(block, particles));
        for particle in 0..particles {
            if block[particle] == 0.0 {
                (1..columns).for_each(|c| block[c * particles + particle] = 0.0);
            }
        }
    }

    fn resample(&mut self, ancestor_indices: &[u32]) {
        let full = self.empty.len();
        for block in self.blocks.iter_mut().filter(|block| block.len() == full && full > 0) {
            let mut copy = Vec::with_capacity(ancestor_indices.len() * self.columns);
            for column in block.chunks_exact(self.particles) {
                copy.extend(ancestor_indices.iter().map(|&a| column[a as usize]));
            }
            *block = copy;
        }
        self.particles = ancestor_indices.len();
        self.empty = vec![0.0; self.particles * self.columns];
    }

    fn usage(&self) -> StoreUsage {
        let values: usize = self.blocks.iter().map(Vec::capacity).sum();
        StoreUsage {
            rows: self.blocks.iter().map(|block| block.len() / self.columns).sum(),
            bytes: (values + self.spread.capacity()) * size_of::<f64>()
                + self.blocks.capacity() * size_of::<Vec<f64>>(),
        }
    }

    fn kind(&self) -> StoreRef<'_> {
        StoreRef::Dense(self)
    }
}
