//! The default store: landmark-major blocks that follow their lineages lazily.
//!
//! One block per landmark holds a row for each lineage that was alive when the landmark was last touched. Resampling
//! moves no Gaussian; a landmark catches up with all resamplings since its last touch in one gather when it is touched
//! again. Rows without descendants are swept away a little at every call. `docs/lineage-store.md` explains it.

use serde::{Deserialize, Serialize};
mod arena;
mod chain;

use super::{LandmarkStore, Rows, RowsMut, StoreRef, StoreUsage};
use crate::workers::{Workers, PART};
use arena::{Arena, Place};
use chain::{Chain, Level, NONE};

/// Dead rows are pruned until the rows are at most so many hundredths of those counted alive.
const ROWS_PERCENT: usize = 118;
/// Levels of which this share or more is dead are pruned in any case, in sixteenths.
const DEAD_ALWAYS: usize = 6;
/// Deaths are not counted further where they cannot make up more than one in so many rows.
const DEATHS_COUNTED: usize = 128;
/// Up to so many particles, rows that are read several times are put in particle order first; more would fill the caches.
const FEW: usize = 1024;
/// What a resampling and what a touch may prune, in landmarks with all their rows.
const PRUNED_AT_ONCE: [usize; 2] = [32, 1];

/// Blocks stamped by generation: O(M) per touch and per resampling whatever the number of landmarks, and memory for
/// the distinct rows only.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct LineageStore {
    columns: usize,
    chain: Chain,
    /// By slot.
    blocks: Vec<Block>,
    values: Arena<f64>,
    rows: usize,
    /// Number of blocks.
    held: usize,
    /// Rows that some particle descends from, as far as they were counted.
    alive: usize,
    /// Rows of the landmark that is being read, in particle order.
    #[serde(skip)]
    scratch: Vec<f64>,
    sweep: Sweep,
    #[serde(skip)]
    workers: Workers,
}

/// The rows of one landmark: as many as its level has lineages, column after column.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
struct Block {
    /// No level: the slot is empty, and no map holds the landmark.
    level: u32,
    /// Neighbours in the list of the level.
    previous: u32,
    next: u32,
    place: Place,
}

const EMPTY: Block = Block { level: NONE, previous: NONE, next: NONE, place: Place::EMPTY };

/// Where the sweep from older to younger levels stands.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
struct Sweep {
    /// The level to be looked at next; none between two sweeps.
    level: u32,
    /// The level that its blocks are moving to, without the dead rows.
    survivors: u32,
    /// The share of dead rows from which a level is pruned while there are too many of them, in sixteenths.
    dead: usize,
    /// Rows are too many above so many hundredths of those alive.
    rows_percent: usize,
}

const AT_REST: Sweep = Sweep { level: NONE, survivors: NONE, dead: 0, rows_percent: ROWS_PERCENT };

/// The dead share of a level's rows in sixteenths.
fn dead_share(level: &Level) -> usize {
    (16 * (level.rows - level.alive) / level.rows.max(1)) as usize
}

impl LineageStore {
    /// An empty store for `particles` maps with `columns` numbers per landmark.
    pub fn new(particles: usize, columns: usize) -> Self {
        Self {
            columns,
            chain: Chain::new(particles),
            blocks: Vec::new(),
            values: Arena::default(),
            rows: 0,
            alive: 0,
            held: 0,
            scratch: Vec::new(),
            sweep: AT_REST,
            workers: Workers::default(),
        }
    }

    fn block(&self, slot: u32) -> Block {
        self.blocks.get(slot as usize).copied().unwrap_or(EMPTY)
    }

    /// Numbers in a block of this level.
    fn length(&self, level: u32) -> usize {
        self.chain.rows(level) * self.columns
    }

    /// Puts a block with unspecified values into an empty slot.
    fn create(&mut self, slot: u32, level: u32) -> Place {
        if slot as usize >= self.blocks.len() {
            self.blocks.resize(slot as usize + 1, EMPTY);
        }
        let place = self.values.allocate(self.length(level));
        self.link(slot, level, place);
        place
    }

    /// Empties a slot. Its level, when this was its last block, leaves the chain.
    fn discard(&mut self, slot: u32) {
        let Block { level, place, .. } = self.unlink(slot);
        self.values.free(place, self.length(level));
        self.drop_if_empty(level);
    }

    fn link(&mut self, slot: u32, level: u32, place: Place) {
        let of = self.chain.level_mut(level);
        let next = std::mem::replace(&mut of.first_block, slot);
        of.blocks += 1;
        self.held += 1;
        self.rows += of.rows as usize;
        self.alive += of.alive as usize;
        if next != NONE {
            self.blocks[next as usize].previous = slot;
        }
        self.blocks[slot as usize] = Block { level, previous: NONE, next, place };
    }

    fn unlink(&mut self, slot: u32) -> Block {
        let block = std::mem::replace(&mut self.blocks[slot as usize], EMPTY);
        let of = self.chain.level_mut(block.level);
        of.blocks -= 1;
        self.held -= 1;
        self.rows -= of.rows as usize;
        self.alive -= of.alive as usize;
        if block.previous == NONE {
            of.first_block = block.next;
        } else {
            self.blocks[block.previous as usize].next = block.next;
        }
        if block.next != NONE {
            self.blocks[block.next as usize].previous = block.previous;
        }
        block
    }

    fn drop_if_empty(&mut self, level: u32) {
        if self.chain.level(level).first_block != NONE {
            return;
        }
        let younger = self.chain.level(level).younger;
        self.chain.splice(level);
        let survivors = self.sweep.survivors;
        if level == survivors {
            // Its blocks were all touched; what is left below it is looked at again.
            self.sweep.survivors = NONE;
        } else if level == self.sweep.level {
            self.sweep.level = younger;
            self.sweep.survivors = NONE;
            if survivors != NONE {
                self.drop_if_empty(survivors);
            }
        }
    }

    /// Moves a block to a younger level. Returns how many numbers it wrote.
    fn rebase(&mut self, slot: u32, level: u32, through: Through) -> usize {
        let old = self.unlink(slot);
        let (from, to) = (self.length(old.level), self.length(level));
        let place = self.values.allocate(to);
        let (source, target) = self.values.pair((old.place, from), (place, to));
        let lineages = match through {
            Through::Map if from == self.columns => &[],
            Through::Map => self.chain.map(old.level),
            Through::Parents => self.chain.parents_of(level),
        };
        gather(&self.workers, source, target, lineages);
        self.values.free(old.place, from);
        self.link(slot, level, place);
        self.drop_if_empty(old.level);
        to
    }

    /// Makes absent rows zero; frees the block when all are.
    fn tidy(&mut self, slot: u32) {
        let Block { level, place, .. } = self.block(slot);
        let rows = self.chain.rows(level);
        let values = self.values.get_mut(place, rows * self.columns);
        let (presence, others) = values.split_at_mut(rows);
        let absent = presence.iter().filter(|value| **value == 0.0).count();
        if absent == rows {
            self.discard(slot);
        } else if absent > 0 {
            for column in others.chunks_exact_mut(rows) {
                // A selection, not a branch: vector code.
                column.iter_mut().zip(&*presence).for_each(|(v, p)| *v = if *p == 0.0 { 0.0 } else { *v });
            }
        }
    }

    /// Counts the dead rows after a resampling and begins a sweep that leaves at most `rows_percent` hundredths of those
    /// alive.
    fn begin_sweep(&mut self, few: usize, rows_percent: usize) {
        let unfinished = self.rest();
        let (mut dead, mut gone) = ([0; 17], 0);
        let generation = self.chain.generation;
        let few = u32::try_from(few).unwrap_or(u32::MAX);
        let oldest = self.chain.count_alive(few, unfinished, |level, before| {
            gone += (before - level.alive) as usize * level.blocks as usize;
            if level.generation + 1 < generation {
                dead[dead_share(level)] += (level.rows - level.alive) as usize * level.blocks as usize;
            }
        });
        self.alive -= gone;
        let too_many = self.rows.saturating_sub(self.alive * rows_percent / 100);
        let mut enough = 0;
        let share = (1..=16).rev().find(|&share| {
            enough += dead[share];
            enough >= too_many
        });
        self.sweep = Sweep { level: oldest, dead: share.unwrap_or(0), rows_percent, ..AT_REST };
    }

    /// Leaves a sweep where it is, and returns that.
    fn rest(&mut self) -> u32 {
        let survivors = std::mem::replace(&mut self.sweep.survivors, NONE);
        if survivors != NONE {
            self.drop_if_empty(survivors);
        }
        std::mem::replace(&mut self.sweep, AT_REST).level
    }

    /// Whether a level's dead rows are to be dropped now.
    ///
    /// **Why not those of the youngest levels, if it can be helped:** landmarks in view are touched soon, which drops
    /// them for nothing.
    fn is_worth_pruning(&self, level: u32) -> bool {
        let level = self.chain.level(level);
        let (dead, in_view) = (dead_share(level), level.generation + 1 >= self.chain.generation);
        let too_many = self.rows * 100 > self.alive * self.sweep.rows_percent;
        level.alive < level.rows
            && (too_many && (in_view || dead >= self.sweep.dead) || dead >= DEAD_ALWAYS && !in_view)
    }

    /// Goes on with the sweep until about `budget` numbers were moved.
    fn sweep(&mut self, budget: usize) {
        let mut moved = 0;
        while self.sweep.level != NONE && moved < budget {
            let Sweep { level, survivors, .. } = self.sweep;
            let wanted = self.is_worth_pruning(level);
            if wanted && survivors != NONE {
                let slot = self.chain.level(level).first_block;
                moved += self.rebase(slot, survivors, Through::Parents);
                self.tidy(slot);
            } else if let Some(survivors) = wanted.then(|| self.chain.split_survivors(level)).flatten() {
                moved += self.chain.rows(level);
                self.sweep.survivors = survivors;
            } else {
                self.sweep.level = self.chain.level(level).younger;
                self.sweep.survivors = NONE;
                if survivors != NONE {
                    self.drop_if_empty(survivors);
                }
            }
        }
    }

    /// Prunes what a call may.
    fn prune(&mut self, blocks: usize) {
        self.sweep(blocks * self.columns * self.chain.particles());
    }
}

/// How the rows of a block find their values in the older level.
#[derive(Clone, Copy, Debug)]
enum Through {
    /// From the particles, by the composed map.
    Map,
    /// From the survivors, which are the next younger level.
    Parents,
}

/// `target[c][i] = source[c][lineages[i]]`; no lineages mean that all rows are copies of the only one.
fn gather(workers: &Workers, source: &[f64], target: &mut [f64], lineages: &[u32]) {
    if target.is_empty() {
        return;
    }
    if lineages.is_empty() {
        let to = target.len() / source.len();
        target.chunks_exact_mut(to).zip(source).for_each(|(target, value)| target.fill(*value));
        return;
    }
    let to = lineages.len();
    let from = source.len() * to / target.len();
    // Three columns side by side, so that an index is read and checked once for all of them.
    let (mut source, mut target) = (source.chunks_exact(from), target.chunks_exact_mut(to));
    while let (Some(a), Some(x)) = (source.next(), target.next()) {
        if let (Some(b), Some(y)) = (source.next(), target.next()) {
            match (source.next(), target.next()) {
                (Some(c), Some(z)) => gather_columns(workers, [a, b, c], [x, y, z], lineages),
                _ => gather_columns(workers, [a, b], [x, y], lineages),
            }
        } else {
            gather_columns(workers, [a], [x], lineages);
        }
    }
}

fn gather_columns<const N: usize>(workers: &Workers, source: [&[f64]; N], target: [&mut [f64]; N], lineages: &[u32]) {
    workers.share(target, PART, &|first, target: [&mut [f64]; N]| {
        let lineages = &lineages[first..][..target[0].len()];
        gather_part(source, target, lineages);
    });
}

#[inline(never)] // On its own the compiler sees that the columns are of one length, and checks an index once.
fn gather_part<const N: usize>(source: [&[f64]; N], target: [&mut [f64]; N], lineages: &[u32]) {
    let (from, to) = (source[0].len(), lineages.len());
    let source = source.map(|column| &column[..from]);
    let target = target.map(|column| &mut column[..to]);
    for (i, &lineage) in lineages.iter().enumerate() {
        for column in 0..N {
            target[column][i] = source[column][lineage as usize];
        }
    }
}

impl LandmarkStore for LineageStore {
    fn particle_count(&self) -> usize {
        self.chain.particles()
    }

    fn insert(&mut self, slot: u32, values: &[f64]) {
        self.remove(slot);
        let level = self.chain.stamp();
        let place = self.create(slot, level);
        self.values.get_mut(place, values.len()).copy_from_slice(values);
        self.tidy(slot);
        self.prune(PRUNED_AT_ONCE[1]);
    }

    fn insert_shared(&mut self, slot: u32, row: &[f64]) {
        self.remove(slot);
        let Some(level) = self.chain.root() else {
            let particles = self.chain.particles();
            return self.insert(slot, &row.iter().flat_map(|value| vec![*value; particles]).collect::<Vec<f64>>());
        };
        let place = self.create(slot, level);
        self.values.get_mut(place, row.len()).copy_from_slice(row);
        self.tidy(slot);
    }

    fn remove(&mut self, slot: u32) {
        if self.block(slot).level != NONE {
            self.discard(slot);
        }
    }

    fn read(&mut self, slot: u32) -> Rows<'_> {
        let particles = self.chain.particles();
        let Block { level, place, .. } = self.block(slot);
        if level != NONE && self.chain.in_particle_order(level) {
            return Rows::new(self.values.get(place, self.length(level)), particles);
        }
        self.scratch.resize(particles * self.columns, 0.0);
        if level == NONE {
            self.scratch.fill(0.0);
        } else {
            let length = self.length(level);
            let lineages = if length == self.columns { &[] } else { self.chain.map(level) };
            gather(&self.workers, self.values.get(place, length), &mut self.scratch, lineages);
        }
        Rows::new(&self.scratch, particles)
    }

    fn copy_rows(&mut self, slot: u32, out: &mut [f64]) {
        let Block { level, place, .. } = self.block(slot);
        if level == NONE || self.chain.in_particle_order(level) {
            out.copy_from_slice(self.read(slot).values);
            return;
        }
        // Gathered to where they are wanted, not by way of the scratch rows.
        let length = self.length(level);
        let lineages = if length == self.columns { &[] } else { self.chain.map(level) };
        gather(&self.workers, self.values.get(place, length), out, lineages);
    }

    fn expect_reads(&mut self, slot: u32) {
        let level = self.block(slot).level;
        let particles = self.chain.particles();
        // One row for all is kept as it is: it is no dearer to read.
        if level == NONE || particles > FEW || self.chain.rows(level) == 1 || self.chain.in_particle_order(level) {
            return;
        }
        let level = self.chain.stamp();
        self.rebase(slot, level, Through::Map);
        self.prune(PRUNED_AT_ONCE[1]);
    }

    fn read_row(&self, slot: u32, particle: usize, out: &mut [f64]) -> bool {
        let Block { level, place, .. } = self.block(slot);
        if level == NONE {
            return false;
        }
        let lineage = self.chain.lineage(level, particle);
        let values = self.values.get(place, self.length(level));
        for (value, column) in out.iter_mut().zip(values.chunks_exact(self.chain.rows(level))) {
            *value = column[lineage];
        }
        out[0] != 0.0
    }

    fn holders(&mut self, slot: u32) -> usize {
        let Block { level, place, .. } = self.block(slot);
        if level == NONE {
            return 0;
        }
        let rows = self.chain.rows(level);
        let presence = self.values.get(place, rows);
        let present = presence.iter().filter(|value| **value != 0.0).count();
        if present == 0 || present == rows {
            return if present == 0 { 0 } else { self.chain.particles() };
        }
        self.chain.map(level).iter().filter(|&&lineage| presence[lineage as usize] != 0.0).count()
    }

    fn update(&mut self, slot: u32, _changed: Option<&[bool]>, change: &mut dyn FnMut(RowsMut<'_>)) {
        let particles = self.chain.particles();
        let length = particles * self.columns;
        let level = self.chain.stamp();
        let stamped = self.block(slot).level;
        if stamped == NONE {
            let place = self.create(slot, level);
            self.values.get_mut(place, length).fill(0.0);
        } else if stamped != level {
            self.rebase(slot, level, Through::Map);
        }
        let place = self.block(slot).place;
        change(RowsMut::new(self.values.get_mut(place, length), particles));
        self.tidy(slot);
        self.prune(PRUNED_AT_ONCE[1]);
    }

    fn resample(&mut self, ancestor_indices: &[u32]) {
        self.chain.resample(ancestor_indices);
        self.begin_sweep(self.alive / (DEATHS_COUNTED * self.held.max(1)), ROWS_PERCENT);
        self.prune(PRUNED_AT_ONCE[0]);
    }

    fn set_workers(&mut self, workers: &Workers) {
        self.workers = workers.clone();
    }

    fn usage(&self) -> StoreUsage {
        let bytes = self.values.bytes()
            + self.chain.bytes()
            + self.blocks.capacity() * size_of::<Block>()
            + self.scratch.capacity() * size_of::<f64>();
        StoreUsage { rows: self.rows, bytes }
    }

    fn kind(&self) -> StoreRef<'_> {
        StoreRef::Lineage(self)
    }
}

#[cfg(test)]
mod tests;
