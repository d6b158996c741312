//! The default store: landmark-major blocks that follow their lineages lazily.
//!
//! One block per landmark holds a row for each lineage that was alive when the landmark was last touched. Resampling
//! moves no Gaussian; a landmark catches up with all resamplings since its last touch in one gather when it is touched
//! again. Rows without descendants are swept away a little at every call. `docs/lineage-store.md` explains it.

mod arena;
mod chain;

use super::{LandmarkStore, Rows, RowsMut, StoreUsage};
use arena::{Arena, Place};
use chain::{Chain, NONE};

/// Generations between the beginnings of two sweeps.
const SWEEP_EVERY: u64 = 8;
/// What a call may spend on the sweep, in numbers moved per number of a landmark with all its rows.
const SWEEP_SHARE_MAX: usize = 2;

/// Blocks stamped by generation: O(M) per touch and per resampling whatever the number of landmarks, and memory for
/// the distinct rows only.
#[derive(Clone, Debug)]
pub struct LineageStore {
    columns: usize,
    chain: Chain,
    /// By slot.
    blocks: Vec<Block>,
    values: Arena<f64>,
    rows: usize,
    /// Rows of the landmark that is being read, in particle order.
    scratch: Vec<f64>,
    sweep: Sweep,
}

/// The rows of one landmark: as many as its level has lineages, column after column.
#[derive(Clone, Copy, Debug)]
struct Block {
    /// No level: the slot is empty, and no map holds the landmark.
    level: u32,
    /// Neighbours in the list of the level.
    previous: u32,
    next: u32,
    place: Place,
}

const EMPTY: Block = Block { level: NONE, previous: NONE, next: NONE, place: Place::EMPTY };

/// Where the sweep from the newest level to the oldest stands.
#[derive(Clone, Debug)]
struct Sweep {
    /// The level to be looked at next; none between two sweeps.
    level: u32,
    /// The level that its blocks are moving to, without the dead rows.
    survivors: u32,
    /// Generation at which the previous sweep began: older levels lose lineages only if a younger one did.
    since: u64,
    /// Generation at which this sweep began, or began and ended.
    begun: u64,
    /// Numbers moved since, and calls that had a share in it.
    moved: usize,
    calls: usize,
    /// What a call moves, so that the sweep takes as many calls as the previous one had until this one began.
    slice: usize,
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
            scratch: Vec::new(),
            sweep: Sweep { level: NONE, survivors: NONE, since: 0, begun: 0, moved: 0, calls: 0, slice: 0 },
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
        let next = std::mem::replace(&mut self.chain.level_mut(level).first_block, slot);
        if next != NONE {
            self.blocks[next as usize].previous = slot;
        }
        self.blocks[slot as usize] = Block { level, previous: NONE, next, place };
        self.rows += self.chain.rows(level);
    }

    fn unlink(&mut self, slot: u32) -> Block {
        let block = std::mem::replace(&mut self.blocks[slot as usize], EMPTY);
        if block.previous == NONE {
            self.chain.level_mut(block.level).first_block = block.next;
        } else {
            self.blocks[block.previous as usize].next = block.next;
        }
        if block.next != NONE {
            self.blocks[block.next as usize].previous = block.previous;
        }
        self.rows -= self.chain.rows(block.level);
        block
    }

    fn drop_if_empty(&mut self, level: u32) {
        if self.chain.level(level).first_block != NONE {
            return;
        }
        let older = self.chain.level(level).older;
        self.chain.splice(level);
        let survivors = self.sweep.survivors;
        if level == survivors {
            // Its blocks were all touched; what is left below it is looked at again.
            self.sweep.survivors = NONE;
        } else if level == self.sweep.level {
            self.sweep.level = older;
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
        gather(source, target, self.columns, lineages);
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
                column.iter_mut().zip(&*presence).filter(|(_, p)| **p == 0.0).for_each(|(value, _)| *value = 0.0);
            }
        }
    }

    /// Goes on with the sweep until about `budget` numbers were moved.
    fn sweep(&mut self, budget: usize) {
        let limit = self.sweep.moved.saturating_add(budget);
        while self.sweep.moved < limit {
            let Sweep { level, survivors, since, .. } = self.sweep;
            if survivors != NONE {
                let slot = self.chain.level(level).first_block;
                self.sweep.moved += self.rebase(slot, survivors, Through::Parents);
                self.tidy(slot);
            } else if self.chain.worth_visiting(level, since) {
                self.sweep.moved += self.chain.rows(level);
                match self.chain.split_survivors(level) {
                    Some(survivors) => self.sweep.survivors = survivors,
                    None => self.sweep.level = self.chain.level(level).older,
                }
            } else {
                self.sweep.level = NONE;
                return;
            }
        }
    }

    /// The share of a call in the sweep.
    ///
    /// **Why:** a sweep at one go would make one step slow. It is spread evenly over the calls of its period; one
    /// that is late goes on at a pace that keeps up with any caller, for what it has to do is in proportion to the
    /// blocks that were touched.
    fn sweep_slice(&mut self) {
        let most = SWEEP_SHARE_MAX * self.columns * self.chain.particles();
        let due = self.chain.generation >= self.sweep.begun + SWEEP_EVERY;
        let late = due && self.sweep.level != NONE;
        if due && !late {
            let Sweep { begun, moved, calls, .. } = self.sweep;
            self.sweep = Sweep {
                level: self.chain.newest,
                survivors: NONE,
                since: begun,
                begun: self.chain.generation,
                moved: 0,
                calls: 0,
                slice: (moved + moved / 4) / calls.max(1),
            };
        }
        self.sweep.calls += 1;
        self.sweep(if late { most } else { self.sweep.slice.clamp(most / 16, most) });
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
fn gather(source: &[f64], target: &mut [f64], columns: usize, lineages: &[u32]) {
    if target.is_empty() {
        return;
    }
    let (from, to) = (source.len() / columns, target.len() / columns);
    for (source, target) in source.chunks_exact(from).zip(target.chunks_exact_mut(to)) {
        if from == 1 {
            target.fill(source[0]);
        } else {
            target.iter_mut().zip(lineages).for_each(|(value, &lineage)| *value = source[lineage as usize]);
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
        self.sweep_slice();
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
            gather(self.values.get(place, length), &mut self.scratch, self.columns, lineages);
        }
        Rows::new(&self.scratch, particles)
    }

    fn append_rows(&mut self, slot: u32, out: &mut Vec<f64>) {
        let Block { level, place, .. } = self.block(slot);
        if level == NONE || self.chain.in_particle_order(level) {
            out.extend_from_slice(self.read(slot).values);
            return;
        }
        // Gathered to where they are wanted, not by way of the scratch rows.
        let (begin, length) = (out.len(), self.length(level));
        out.resize(begin + self.chain.particles() * self.columns, 0.0);
        let lineages = if length == self.columns { &[] } else { self.chain.map(level) };
        gather(self.values.get(place, length), &mut out[begin..], self.columns, lineages);
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
        self.sweep_slice();
    }

    fn resample(&mut self, ancestor_indices: &[u32]) {
        self.chain.resample(ancestor_indices);
        self.sweep_slice();
    }

    fn usage(&self) -> StoreUsage {
        let bytes = self.values.bytes()
            + self.chain.bytes()
            + self.blocks.capacity() * size_of::<Block>()
            + self.scratch.capacity() * size_of::<f64>();
        StoreUsage { rows: self.rows, bytes }
    }

    fn snapshot(&self) -> Box<dyn LandmarkStore> {
        Box::new(self.clone())
    }
}

#[cfg(test)]
mod tests;
