//! The reference store: every particle owns every landmark.

use super::{LandmarkStore, Rows, RowsMut, StoreRef, StoreUsage};
use serde::{Deserialize, Serialize};

/// One full block of rows per landmark, copied at every resampling: O(M K).
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct DenseStore {
    particles: usize,
    columns: usize,
    blocks: Vec<Vec<f64>>,
    empty: Vec<f64>,
}

impl DenseStore {
    /// An empty store for `particles` maps with `columns` numbers per landmark.
    pub fn new(particles: usize, columns: usize) -> Self {
        Self { particles, columns, blocks: Vec::new(), empty: vec![0.0; particles * columns] }
    }
}

impl LandmarkStore for DenseStore {
    fn particle_count(&self) -> usize {
        self.particles
    }

    fn insert(&mut self, slot: u32, values: &[f64]) {
        self.update(slot, None, &mut |rows| rows.values.copy_from_slice(values));
    }

    fn remove(&mut self, slot: u32) {
        if let Some(block) = self.blocks.get_mut(slot as usize) {
            *block = Vec::new();
        }
    }

    fn read(&mut self, slot: u32) -> Rows<'_> {
        match self.blocks.get(slot as usize) {
            Some(block) if !block.is_empty() => Rows::new(block, self.particles),
            _ => Rows::new(&self.empty, self.particles),
        }
    }

    fn read_row(&self, slot: u32, particle: usize, out: &mut [f64]) -> bool {
        match self.blocks.get(slot as usize) {
            Some(block) if !block.is_empty() => {
                for (c, value) in out.iter_mut().enumerate() {
                    *value = block[c * self.particles + particle];
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
        let slot = slot as usize;
        if slot >= self.blocks.len() {
            self.blocks.resize_with(slot + 1, Vec::new);
        }
        let block = &mut self.blocks[slot];
        block.resize(self.particles * self.columns, 0.0);
        change(RowsMut::new(block, self.particles));
        for particle in 0..self.particles {
            if block[particle] == 0.0 {
                (1..self.columns).for_each(|c| block[c * self.particles + particle] = 0.0);
            }
        }
    }

    fn resample(&mut self, ancestor_indices: &[u32]) {
        for block in self.blocks.iter_mut().filter(|block| !block.is_empty()) {
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
        let blocks = self.blocks.iter().filter(|block| !block.is_empty()).count();
        let values: usize = self.blocks.iter().map(Vec::capacity).sum();
        StoreUsage {
            rows: blocks * self.particles,
            bytes: values * size_of::<f64>() + self.blocks.capacity() * size_of::<Vec<f64>>(),
        }
    }

    fn kind(&self) -> StoreRef<'_> {
        StoreRef::Dense(self)
    }
}
