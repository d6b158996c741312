//! The chain of live stamps: who descends from whom, for the generations that some block still carries.

use super::arena::{Arena, Place};
use serde::{Deserialize, Serialize};

/// No level, no slot.
pub(super) const NONE: u32 = u32::MAX;
/// Composed maps kept at most. A step that touches landmarks of more stamps composes some of them again.
const MAPS: usize = 32;

/// One generation at which some block was touched last.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Level {
    /// Lineages of that generation that are still told apart: each is a row in every block of this level.
    pub(super) rows: u32,
    /// How many of them had a descendant when that was last counted.
    pub(super) alive: u32,
    /// Number of blocks.
    pub(super) blocks: u32,
    /// The blocks of this level form a list; this is its head.
    pub(super) first_block: u32,
    pub(super) older: u32,
    pub(super) younger: u32,
    pub(super) generation: u64,
    /// For each lineage its parent in the next older level; of the oldest level, the one lineage that began it all.
    parents: Place,
    /// Which composed map may be this level's.
    map: u32,
}

/// Levels from the newest to the oldest, and the lineage of every particle.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Chain {
    levels: Vec<Level>,
    vacant: Vec<u32>,
    pub(super) newest: u32,
    /// Number of resamplings so far.
    pub(super) generation: u64,
    /// Lineage of each particle in the newest level.
    current: Vec<u32>,
    parents: Arena<u32>,
    /// Maps of the present generation from particles to lineages, and the levels that they belong to.
    #[serde(skip)]
    maps: Vec<(u32, Vec<u32>)>,
    #[serde(skip)]
    maps_in_use: usize,
    #[serde(skip)]
    next_map: usize,
    #[serde(skip)]
    scratch: [Vec<u32>; 2],
    /// Which lineages of a level have a descendant; kept for its memory.
    #[serde(skip)]
    has_descendant: Vec<bool>,
}

impl Chain {
    pub(super) fn new(particles: usize) -> Self {
        Self {
            levels: Vec::new(),
            vacant: Vec::new(),
            newest: NONE,
            generation: 0,
            current: vec![0; particles],
            parents: Arena::default(),
            maps: Vec::new(),
            maps_in_use: 0,
            next_map: 0,
            scratch: [Vec::new(), Vec::new()],
            has_descendant: Vec::new(),
        }
    }

    pub(super) fn particles(&self) -> usize {
        self.current.len()
    }

    pub(super) fn level(&self, level: u32) -> &Level {
        &self.levels[level as usize]
    }

    pub(super) fn level_mut(&mut self, level: u32) -> &mut Level {
        &mut self.levels[level as usize]
    }

    /// Rows of a block of this level.
    pub(super) fn rows(&self, level: u32) -> usize {
        self.levels[level as usize].rows as usize
    }

    /// Whether row i of this level's blocks is that of particle i.
    pub(super) fn in_particle_order(&self, level: u32) -> bool {
        level == self.newest && self.levels[level as usize].generation == self.generation
    }

    /// The level of the present generation, at most one, in which every particle is a lineage.
    pub(super) fn stamp(&mut self) -> u32 {
        if self.newest != NONE && self.in_particle_order(self.newest) {
            return self.newest;
        }
        let particles = self.current.len();
        let parents = self.parents.allocate(particles);
        self.parents.get_mut(parents, particles).copy_from_slice(&self.current);
        for (i, lineage) in self.current.iter_mut().enumerate() {
            *lineage = i as u32;
        }
        let older = self.newest;
        self.newest = self.add_level(particles, parents, self.generation, [older, NONE]);
        self.newest
    }

    /// The level of one lineage from which all particles descend, while there is no other; `None` when there is.
    pub(super) fn root(&mut self) -> Option<u32> {
        if self.newest == NONE {
            let parents = self.parents.allocate(1);
            self.parents.get_mut(parents, 1)[0] = 0;
            self.newest = self.add_level(1, parents, self.generation, [NONE, NONE]);
            // Its rows are not in the order of the particles, as those of an earlier generation are not.
            self.generation += 1;
            self.maps_in_use = 0;
            self.next_map = 0;
        }
        let Level { rows, older, generation, .. } = self.levels[self.newest as usize];
        (rows == 1 && older == NONE && generation < self.generation).then_some(self.newest)
    }

    /// Particle i becomes a copy of the former particle `ancestor_indices[i]`.
    pub(super) fn resample(&mut self, ancestor_indices: &[u32]) {
        let current = &mut self.scratch[0];
        current.clear();
        current.extend(ancestor_indices.iter().map(|&ancestor| self.current[ancestor as usize]));
        std::mem::swap(current, &mut self.current);
        self.generation += 1;
        self.maps_in_use = 0;
        self.next_map = 0;
    }

    /// Counts the lineages that have a descendant, level by level from the newest to older ones, and tells `counted`
    /// each level with the count of before. Returns the oldest level it came to.
    ///
    /// A lineage without a descendant hangs at its sister's parent from then on, so that it keeps no older one alive.
    /// The count ends beyond `until` at a level that has lost at most `few` lineages. **Why:** no older one has lost
    /// more of them; for `few` = 0 all counts are exact.
    pub(super) fn count_alive(&mut self, few: u32, mut until: u32, mut counted: impl FnMut(&Level, u32)) -> u32 {
        let Self { levels, parents, current, has_descendant: own, .. } = self;
        let (mut at, mut last) = (self.newest, NONE);
        while at != NONE {
            let children = match levels.get(last as usize) {
                None => &current[..],
                Some(younger) => {
                    let children = parents.get_mut(younger.parents, younger.rows as usize);
                    leave_to_the_living(children, own);
                    children
                }
            };
            own.clear();
            own.resize(levels[at as usize].rows as usize, false);
            children.iter().for_each(|&lineage| own[lineage as usize] = true);
            let alive = own.iter().map(|&alive| u32::from(alive)).sum();
            let level = &mut levels[at as usize];
            if until == NONE && level.alive - alive <= few {
                break;
            }
            let before = std::mem::replace(&mut level.alive, alive);
            counted(level, before);
            until = if at == until { NONE } else { until };
            (last, at) = (at, level.older);
        }
        last
    }

    /// Lineage in `level` of every particle. Composed once per level and generation.
    ///
    /// **Why from the old end:** old levels have few lineages, so this costs the sum of the lineages of the younger
    /// levels, about M ln(age); from the young end it would be M for each of them.
    pub(super) fn map(&mut self, level: u32) -> &[u32] {
        if level == self.newest {
            return &self.current;
        }
        if let Some(index) = self.cached(level) {
            return &self.maps[index].1;
        }
        let index = self.reserve_map(level);
        let mut map = std::mem::take(&mut self.maps[index].1);
        let [mut composed, mut next] = std::mem::take(&mut self.scratch);
        let mut at = self.levels[level as usize].younger;
        composed.clear();
        composed.extend_from_slice(self.parents_of(at));
        loop {
            let rest = if at == self.newest {
                Some(&self.current)
            } else {
                self.cached(at).map(|cached| &self.maps[cached].1)
            };
            if let Some(rest) = rest {
                compose(&composed, rest, &mut map);
                break;
            }
            at = self.levels[at as usize].younger;
            compose(&composed, self.parents_of(at), &mut next);
            std::mem::swap(&mut composed, &mut next);
        }
        self.scratch = [composed, next];
        self.maps[index].1 = map;
        &self.maps[index].1
    }

    /// Lineage in `level` of one particle.
    pub(super) fn lineage(&self, level: u32, particle: usize) -> usize {
        if self.rows(level) == 1 {
            return 0;
        }
        if let Some(index) = self.cached(level) {
            return self.maps[index].1[particle] as usize;
        }
        let (mut at, mut lineage) = (self.newest, self.current[particle]);
        while at != level {
            lineage = self.parents_of(at)[lineage as usize];
            at = self.levels[at as usize].older;
        }
        lineage as usize
    }

    /// Parents of a level's lineages in the next older level.
    pub(super) fn parents_of(&self, level: u32) -> &[u32] {
        let level = &self.levels[level as usize];
        self.parents.get(level.parents, level.rows as usize)
    }

    /// Takes a level without blocks out of the chain: its successor's parents become its own parents.
    pub(super) fn splice(&mut self, level: u32) {
        let Level { rows, older, younger, parents, map, .. } = self.levels[level as usize];
        let own = self.parents.get(parents, rows as usize);
        if younger == NONE {
            self.newest = older;
            self.current.iter_mut().for_each(|lineage| *lineage = own[*lineage as usize]);
        } else {
            self.levels[younger as usize].older = older;
            let Level { parents: target, rows: count, .. } = self.levels[younger as usize];
            let (own, target) = self.parents.pair((parents, rows as usize), (target, count as usize));
            target.iter_mut().for_each(|parent| *parent = own[*parent as usize]);
        }
        if older != NONE {
            self.levels[older as usize].younger = younger;
        }
        if let Some((owner, _)) = self.maps.get_mut(map as usize).filter(|(owner, _)| *owner == level) {
            *owner = NONE;
        }
        self.parents.free(parents, rows as usize);
        self.vacant.push(level);
    }

    /// Puts a level of the surviving lineages above `level`, if some of its lineages have no descendant any more.
    ///
    /// The new level's parents are the survivors' numbers, so moving a block up to it drops the dead rows. When all
    /// have moved, splicing the old level completes the pruning; in between the chain is valid at any moment.
    pub(super) fn split_survivors(&mut self, level: u32) -> Option<u32> {
        let rows = self.rows(level);
        let Level { younger, generation, .. } = self.levels[level as usize];
        let children = if younger == NONE {
            &mut self.current[..]
        } else {
            let Level { parents, rows, .. } = self.levels[younger as usize];
            self.parents.get_mut(parents, rows as usize)
        };
        let [number, old_number] = &mut self.scratch;
        for of_all in [&mut *number, &mut *old_number] {
            of_all.clear();
            of_all.resize(rows, 0);
        }
        children.iter().for_each(|&lineage| number[lineage as usize] = 1);
        // Without branches: who dies is not to be guessed.
        let mut survivors = 0;
        for (old, number) in number.iter_mut().enumerate() {
            old_number[survivors as usize] = old as u32;
            survivors += std::mem::replace(number, survivors);
        }
        if survivors as usize == rows {
            return None;
        }
        children.iter_mut().for_each(|lineage| *lineage = number[*lineage as usize]);
        let parents = self.parents.allocate(survivors as usize);
        let target = self.parents.get_mut(parents, survivors as usize);
        target.copy_from_slice(&old_number[..survivors as usize]);
        let above = self.add_level(survivors as usize, parents, generation, [level, younger]);
        if younger == NONE {
            self.newest = above;
        }
        Some(above)
    }

    pub(super) fn bytes(&self) -> usize {
        let maps: usize = self.maps.iter().map(|(_, map)| map.capacity()).sum();
        let scratch: usize = self.scratch.iter().map(Vec::capacity).sum();
        self.levels.capacity() * size_of::<Level>()
            + self.has_descendant.capacity()
            + self.parents.bytes()
            + self.maps.capacity() * size_of::<(u32, Vec<u32>)>()
            + (self.vacant.capacity() + self.current.capacity() + maps + scratch) * size_of::<u32>()
    }

    fn add_level(&mut self, rows: usize, parents: Place, generation: u64, [older, younger]: [u32; 2]) -> u32 {
        let level = Level {
            rows: rows as u32,
            alive: rows as u32,
            blocks: 0,
            first_block: NONE,
            older,
            younger,
            generation,
            parents,
            map: NONE,
        };
        let index = match self.vacant.pop() {
            Some(index) => {
                self.levels[index as usize] = level;
                index
            }
            None => {
                self.levels.push(level);
                (self.levels.len() - 1) as u32
            }
        };
        if older != NONE {
            self.levels[older as usize].younger = index;
        }
        if younger != NONE {
            self.levels[younger as usize].older = index;
        }
        index
    }

    fn cached(&self, level: u32) -> Option<usize> {
        let index = self.levels[level as usize].map as usize;
        (index < self.maps_in_use && self.maps[index].0 == level).then_some(index)
    }

    /// A buffer for the map of a level; that of another level is given up when there are too many.
    fn reserve_map(&mut self, level: u32) -> usize {
        let index = self.next_map;
        self.next_map = (index + 1) % MAPS;
        self.maps_in_use = self.maps_in_use.max(index + 1);
        if index == self.maps.len() {
            self.maps.push((level, Vec::new()));
        }
        self.maps[index].0 = level;
        self.levels[level as usize].map = index as u32;
        index
    }
}

/// Gives the parent of a living lineage to those without a descendant.
fn leave_to_the_living(parents: &mut [u32], has_descendant: &[bool]) {
    let Some(living) = has_descendant.iter().position(|alive| *alive) else { return };
    let common = parents[living];
    for (parent, &alive) in parents.iter_mut().zip(has_descendant) {
        *parent = if alive { *parent } else { common };
    }
}

/// `out[i] = first[second[i]]`.
fn compose(first: &[u32], second: &[u32], out: &mut Vec<u32>) {
    out.clear();
    out.extend(second.iter().map(|&i| first[i as usize]));
}
