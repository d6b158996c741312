//! The invariants of the chain, of the blocks and of the sweep, and the memory that they promise.

use super::super::TreeStore;
use super::*;
use crate::random::{Purpose, RandomSource, Stream};
use crate::resampling::{resample, ResamplingScheme};
use std::collections::{BTreeMap, BTreeSet};

const COLUMNS: usize = 2;

impl LineageStore {
    /// Panics when the store contradicts itself; returns the number of levels.
    fn check_invariants(&self) -> usize {
        let (mut level, mut younger, mut levels, mut rows) = (self.chain.newest, NONE, 0, 0);
        let mut seen = BTreeSet::new();
        while level != NONE {
            levels += 1;
            let (mut slot, mut previous) = (self.chain.level(level).first_block, NONE);
            assert!(slot != NONE || level == self.sweep.survivors, "only the sweep may hold a level without blocks");
            while slot != NONE {
                let block = self.block(slot);
                assert_eq!((block.level, block.previous), (level, previous), "list of level {level} at slot {slot}");
                assert!(seen.insert(slot));
                assert_eq!(self.values.get(block.place, self.length(level)).len(), self.length(level));
                rows += self.chain.rows(level);
                (previous, slot) = (slot, block.next);
            }
            let older = self.chain.level(level).older;
            let limit = if older == NONE { 1 } else { self.chain.rows(older) };
            assert!(self.chain.parents_of(level).iter().all(|&parent| (parent as usize) < limit), "parents in range");
            if younger == NONE {
                let rows = self.chain.rows(level);
                assert!((0..self.particle_count()).all(|i| self.chain.lineage(level, i) < rows));
            }
            (younger, level) = (level, older);
        }
        let held = (0..self.blocks.len() as u32).filter(|&slot| self.block(slot).level != NONE).count();
        assert_eq!((seen.len(), rows), (held, self.rows), "every block is in the list of its level");
        levels
    }

    /// Sweeps until nothing is left to do, as if there had been time.
    fn sweep_fully(&mut self) {
        self.rest();
        let mut level = self.chain.newest;
        while level != NONE {
            self.sweep.level = level;
            level = self.chain.level(level).older;
        }
        self.begin_sweep(0, 0);
        self.sweep(usize::MAX);
        assert_eq!(self.sweep.level, NONE);
    }

    /// Panics when some lineage has no descendant.
    fn check_pruned(&self) {
        let mut descended: BTreeSet<usize> = BTreeSet::new();
        let mut level = self.chain.newest;
        if level != NONE {
            descended.extend((0..self.particle_count()).map(|i| self.chain.lineage(level, i)));
        }
        while level != NONE {
            assert_eq!(descended.len(), self.chain.rows(level), "every lineage has a descendant");
            descended = self.chain.parents_of(level).iter().map(|&parent| parent as usize).collect();
            level = self.chain.level(level).older;
        }
    }
}

/// Who touched each particle's copy of each landmark last: the definition of what the store must tell apart.
#[derive(Default)]
struct Ancestry {
    touched_by: BTreeMap<u32, Vec<usize>>,
    touches: usize,
}

impl Ancestry {
    fn touch(&mut self, slot: u32, particles: usize) {
        self.touched_by.insert(slot, (self.touches..self.touches + particles).collect());
        self.touches += particles;
    }

    fn resample(&mut self, ancestors: &[u32]) {
        for touched_by in self.touched_by.values_mut() {
            *touched_by = ancestors.iter().map(|&a| touched_by[a as usize]).collect();
        }
    }

    fn distinct(&self) -> usize {
        self.touched_by.values().map(|touched_by| touched_by.iter().collect::<BTreeSet<_>>().len()).sum()
    }
}

fn draws() -> Stream {
    RandomSource::new(11).stream(Purpose::Simulation, 0)
}

/// Ancestors drawn systematically from log-normal weights whose logarithms have this standard deviation.
fn ancestors(particles: usize, count: usize, step: u32, log_weight_std: f64) -> Vec<u32> {
    let normals = (0..particles).map(|i| draws().normal_pair(i as u32, step)[0]);
    let weights: Vec<f64> = normals.map(|normal| (log_weight_std * normal).exp()).collect();
    let total: f64 = weights.iter().sum();
    let weights: Vec<f64> = weights.iter().map(|weight| weight / total).collect();
    let stream = RandomSource::new(12).stream(Purpose::Resampling, u64::from(step));
    let mut out = Vec::new();
    resample(ResamplingScheme::Systematic, &weights, count, stream, &mut out);
    out
}

fn touch(store: &mut dyn LandmarkStore, slot: u32) {
    store.update(slot, None, &mut |rows| {
        let [presence, value] = rows.columns::<COLUMNS>();
        for i in 0..presence.len() {
            presence[i] += 1.0;
            value[i] += 0.5 * i as f64 + f64::from(slot);
        }
    });
}

#[test]
fn rows_are_the_distinct_last_touches_and_the_live_leaves_of_the_tree() {
    let mut particles = 48;
    let mut store = LineageStore::new(particles, COLUMNS);
    let mut tree = TreeStore::new(particles, COLUMNS);
    let mut ancestry = Ancestry::default();
    let mut levels = 0;
    for step in 0..600_u32 {
        // A window of landmarks slides over 200, twice around.
        for slot in (0..4).map(|j| (step / 3 + 5 * j) % 200) {
            touch(&mut store, slot);
            touch(&mut tree, slot);
            ancestry.touch(slot, particles);
        }
        let count = if step % 97 == 0 { 30 + (step as usize % 40) } else { particles };
        let chosen = ancestors(particles, count, step, 0.7);
        store.resample(&chosen);
        tree.resample(&chosen);
        ancestry.resample(&chosen);
        particles = count;
        if step % 13 == 0 {
            levels = levels.max(store.check_invariants());
            let mut pruned = store.clone();
            pruned.sweep_fully();
            pruned.check_invariants();
            pruned.check_pruned();
            assert_eq!(pruned.usage().rows, ancestry.distinct(), "step {step}");
            assert_eq!(tree.usage().rows, ancestry.distinct(), "step {step}");
            assert!(store.usage().rows >= ancestry.distinct());
            (0..200).for_each(|slot| assert_eq!(pruned.read(slot), tree.read(slot), "step {step} slot {slot}"));
        }
    }
    assert!(levels > 100, "the chain was long enough to be a test: {levels}");
}

#[test]
fn rows_are_at_any_time_within_a_fifth_of_the_least() {
    let mut checked = 0;
    for (particles, steps_per_resampling) in [(20, 1), (100, 1), (100, 3), (250, 2)] {
        let mut store = LineageStore::new(particles, COLUMNS);
        let mut tree = TreeStore::new(particles, COLUMNS);
        for step in 0..1_500_u32 {
            // Every third step sees a new landmark; each is seen five times, so that many levels have one block.
            let view = |j: u32| (step / 3 + 3 * j + step % 3).min(step);
            for store in [&mut store as &mut dyn LandmarkStore, &mut tree] {
                (0..5).for_each(|j| touch(store, view(j)));
                if step % steps_per_resampling == 0 {
                    store.resample(&ancestors(particles, particles, step, 0.8));
                }
            }
            let (rows, leaves) = (store.usage().rows, tree.usage().rows);
            assert!(10 * rows <= 12 * leaves, "M = {particles}, step {step}: {rows} rows for {leaves} leaves");
            checked += 1;
        }
        store.check_invariants();
    }
    assert_eq!(checked, 6_000);
}

#[test]
fn what_a_resampling_leaves_undone_the_touches_after_it_do() {
    let particles = 50;
    let mut store = LineageStore::new(particles, COLUMNS);
    (0..300).for_each(|slot| touch(&mut store, slot));
    store.resample(&ancestors(particles, particles, 0, 1.5));
    let mut pruned = store.clone();
    pruned.sweep_fully();
    let least = pruned.usage().rows;
    let before = store.usage().rows;
    assert!(10 * before > 12 * least, "one call has not moved 300 landmarks: {before} rows, {least} at least");
    (0..300).for_each(|_| touch(&mut store, 0));
    // The landmark that was touched has all of its rows again.
    assert!(store.usage().rows * 10 <= 12 * (least + particles), "{} rows, {least} at least", store.usage().rows);
}

#[test]
fn where_nobody_dies_resampling_moves_no_row_and_the_next_touch_moves_one_block() {
    let mut store = LineageStore::new(4, COLUMNS);
    (0..50).for_each(|slot| touch(&mut store, slot));
    let places: Vec<Place> = store.blocks.iter().map(|block| block.place).collect();
    store.resample(&[1, 0, 2, 3]);
    touch(&mut store, 7);
    assert_eq!(store.read(7).column(0), &[2.0; 4]);
    assert_eq!(store.read(7).column(1), &[14.5, 14.5, 16.0, 17.0]);
    let moved = places.iter().zip(&store.blocks).filter(|(place, block)| **place != block.place).count();
    assert_eq!(moved, 1);
}

#[test]
fn reading_neither_rebases_nor_allocates_rows() {
    let mut store = LineageStore::new(4, COLUMNS);
    (0..5).for_each(|slot| touch(&mut store, slot));
    store.resample(&[3, 3, 3, 1]);
    let before = (store.usage().rows, store.chain.newest, store.check_invariants());
    assert_eq!(store.read(2).column(1), &[3.5, 3.5, 3.5, 2.5]);
    assert_eq!((store.usage().rows, store.chain.newest, store.check_invariants()), before);
}

#[test]
fn landmarks_of_lost_particles_are_freed_by_the_sweep() {
    let mut store = LineageStore::new(8, COLUMNS);
    let mut values = vec![0.0; 8 * COLUMNS];
    (values[5], values[13]) = (1.0, 4.0);
    store.insert(3, &values);
    touch(&mut store, 4);
    assert_eq!((store.holders(3), store.holders(4), store.holders(99)), (1, 8, 0));
    store.resample(&[0, 1, 2, 3, 5, 5, 5, 7]);
    assert_eq!((store.holders(3), store.read(3).column(1)[5]), (3, 4.0));
    store.resample(&[0, 1, 2, 3, 3, 3, 3, 7]);
    assert_eq!(store.holders(3), 0);
    assert_eq!(store.block(3).level, NONE, "no particle holds it, so nothing is kept");
    assert!((5..=6).contains(&store.usage().rows), "five survivors' rows of the other landmark, and a fifth at most");
}

#[test]
fn a_steady_state_needs_no_more_memory() {
    let mut store = LineageStore::new(64, COLUMNS);
    let mut run = |steps: std::ops::Range<u32>| {
        for step in steps {
            (0..6).for_each(|j| touch(&mut store, (step / 4 + 7 * j) % 120));
            if step % 3 == 0 {
                store.resample(&ancestors(64, 64, step, 0.8));
            }
        }
        store.usage().bytes
    };
    let warm = run(0..4_000);
    assert_eq!(run(4_000..12_000), warm);
}

#[test]
fn an_empty_population_holds_nothing() {
    let mut store = LineageStore::new(3, COLUMNS);
    (0..20).for_each(|slot| touch(&mut store, slot));
    store.resample(&[]);
    touch(&mut store, 5);
    store.sweep_fully();
    store.check_invariants();
    assert_eq!((store.usage().rows, store.particle_count(), store.read(1).column(0).len()), (0, 0, 0));
}
