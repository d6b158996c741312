//! A spatial index over landmarks for all particles at once.
//!
//! Each landmark is a box that covers its mean in every map, widened by its uncertainty; resampling can only shrink the
//! set of maps, so a box stays valid until its landmark changes. Boxes lie in the cells of a hash grid.

use crate::vector::leasts;
use rustc_hash::FxHashMap;
use serde::{Deserialize, Serialize};

/// A rectangle with sides along the axes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Box2 {
    /// Smallest x and y, metres.
    pub low: [f64; 2],
    /// Largest x and y, metres.
    pub high: [f64; 2],
}

impl Box2 {
    /// The box without points.
    pub const EMPTY: Self = Self { low: [f64::INFINITY; 2], high: [f64::NEG_INFINITY; 2] };

    /// Grows until `point`, widened by `margin`, lies inside.
    #[inline(always)]
    pub fn include(&mut self, point: [f64; 2], margin: f64) {
        for axis in 0..2 {
            self.low[axis] = self.low[axis].min(point[axis] - margin);
            self.high[axis] = self.high[axis].max(point[axis] + margin);
        }
    }

    /// The smallest box around `count` boxes given as (low, high), in a form that vector code can follow.
    #[inline(always)]
    pub fn around(count: usize, part: impl Fn(usize) -> ([f64; 2], [f64; 2])) -> Self {
        let [x, y, far_x, far_y] = leasts(
            count,
            #[inline(always)]
            |i| {
                let ([x, y], [far_x, far_y]) = part(i);
                [x, y, -far_x, -far_y]
            },
        );
        Self { low: [x, y], high: [-far_x, -far_y] }
    }

    /// Whether the two have a point in common.
    #[inline(always)]
    pub fn overlaps(&self, other: &Self) -> bool {
        (0..2).all(|axis| self.low[axis] <= other.high[axis] && other.low[axis] <= self.high[axis])
    }

    fn contains(&self, other: &Self) -> bool {
        (0..2).all(|axis| self.low[axis] <= other.low[axis] && other.high[axis] <= self.high[axis])
    }

    /// By how much two boxes are apart along an axis, at most; infinitely far if one has no points.
    pub fn gap(&self, other: &Self) -> f64 {
        let gap = |axis: usize| (self.low[axis] - other.high[axis]).max(other.low[axis] - self.high[axis]);
        gap(0).max(gap(1))
    }

    /// The longer side.
    pub fn size(&self) -> f64 {
        (self.high[0] - self.low[0]).max(self.high[1] - self.low[1])
    }
}

/// Boxes that would cover more cells than this are kept in a list of their own.
const MOST_CELLS: i64 = 64;

/// Landmarks by place.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Grid {
    cell_m: f64,
    cells: FxHashMap<[i32; 2], Vec<u32>>,
    /// Lists of cells that became empty; kept for their memory.
    spare: Vec<Vec<u32>>,
    large: Vec<u32>,
    /// Box of each slot as it was entered, `EMPTY` when it is not.
    entered: Vec<Box2>,
    /// Query number at which a slot was last reported.
    reported: Vec<u32>,
    query: u32,
}

impl Grid {
    /// An empty index with square cells of this size.
    pub fn new(cell_m: f64) -> Self {
        Self {
            cell_m,
            cells: FxHashMap::default(),
            spare: Vec::new(),
            large: Vec::new(),
            entered: Vec::new(),
            reported: Vec::new(),
            query: 0,
        }
    }

    /// Cells that a box covers: first and last, or `None` when they are too many.
    fn cells_of(&self, area: &Box2) -> Option<([i32; 2], [i32; 2])> {
        let cell = |v: f64| (v / self.cell_m).floor().clamp(-1e9, 1e9) as i32;
        let (low, high) = (area.low.map(cell), area.high.map(cell));
        let span = |axis: usize| i64::from(high[axis]) - i64::from(low[axis]) + 1;
        (span(0).saturating_mul(span(1)) <= MOST_CELLS).then_some((low, high))
    }

    /// Enters a landmark, or moves it to where it is now.
    pub fn set(&mut self, slot: u32, area: Box2) {
        let index = slot as usize;
        if index >= self.entered.len() {
            self.entered.resize(index + 1, Box2::EMPTY);
            self.reported.resize(index + 1, 0);
        }
        let old = self.entered[index];
        if old.contains(&area) && old.size() <= 2.0 * area.size() + 0.5 * self.cell_m {
            return;
        }
        // Entered with room to move, so that small corrections do not touch the cells.
        let room = 0.25 * area.size() + 0.1 * self.cell_m;
        let area = Box2 { low: area.low.map(|v| v - room), high: area.high.map(|v| v + room) };
        let (old_cells, new_cells) = (self.cells_of(&old), self.cells_of(&area));
        self.entered[index] = area;
        if old != Box2::EMPTY && old_cells == new_cells {
            return;
        }
        if old != Box2::EMPTY {
            self.leave(slot, &old);
        }
        match new_cells {
            Some(([x0, y0], [x1, y1])) => {
                for x in x0..=x1 {
                    for y in y0..=y1 {
                        let spare = &mut self.spare;
                        self.cells.entry([x, y]).or_insert_with(|| spare.pop().unwrap_or_default()).push(slot);
                    }
                }
            }
            None => self.large.push(slot),
        }
    }

    /// The box of a landmark as it was entered; that without points where it was not.
    pub fn area(&self, slot: u32) -> Box2 {
        self.entered.get(slot as usize).copied().unwrap_or(Box2::EMPTY)
    }

    /// Takes a landmark out.
    pub fn remove(&mut self, slot: u32) {
        if let Some(area) = self.entered.get(slot as usize).copied().filter(|area| *area != Box2::EMPTY) {
            self.leave(slot, &area);
            self.entered[slot as usize] = Box2::EMPTY;
        }
    }

    fn leave(&mut self, slot: u32, area: &Box2) {
        let drop_from = |list: &mut Vec<u32>| {
            if let Some(at) = list.iter().position(|s| *s == slot) {
                list.swap_remove(at);
            }
        };
        match self.cells_of(area) {
            Some(([x0, y0], [x1, y1])) => {
                for x in x0..=x1 {
                    for y in y0..=y1 {
                        if let Some(list) = self.cells.get_mut(&[x, y]) {
                            drop_from(list);
                            if list.is_empty() {
                                self.spare.extend(self.cells.remove(&[x, y]));
                            }
                        }
                    }
                }
            }
            None => drop_from(&mut self.large),
        }
    }

    /// Appends every landmark whose box overlaps the region, each once, in no particular order.
    pub fn find(&mut self, region: &Box2, out: &mut Vec<u32>) {
        self.query = self.query.wrapping_add(1);
        let Self { cells, large, entered, reported, query, .. } = self;
        let mut visit = |slots: &[u32]| {
            for &slot in slots {
                let index = slot as usize;
                if reported[index] != *query && entered[index].overlaps(region) {
                    reported[index] = *query;
                    out.push(slot);
                }
            }
        };
        visit(large);
        let cell = |v: f64| (v / self.cell_m).floor().clamp(-1e9, 1e9) as i32;
        let (low, high) = (region.low.map(cell), region.high.map(cell));
        let span = |axis: usize| i64::from(high[axis]) - i64::from(low[axis]) + 1;
        if span(0).saturating_mul(span(1)) > cells.len() as i64 {
            cells.values().for_each(|slots| visit(slots));
            return;
        }
        for x in low[0]..=high[0] {
            for y in low[1]..=high[1] {
                if let Some(slots) = cells.get(&[x, y]) {
                    visit(slots);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn any_box() -> impl Strategy<Value = Box2> {
        let size = prop_oneof![0.0..0.5, 0.0..5.0, 0.0..80.0];
        (-40.0..40.0, -40.0..40.0, size.clone(), size)
            .prop_map(|(x, y, w, h): (f64, f64, f64, f64)| Box2 { low: [x, y], high: [x + w, y + h] })
    }

    #[test]
    fn a_box_around_boxes_holds_each_and_no_more() {
        for count in 0..20 {
            let part = |i: usize| ([i as f64 - 3.0, -(i as f64)], [i as f64 + 1.0, 0.5]);
            let around = Box2::around(count, part);
            let mut expected = Box2::EMPTY;
            for (low, high) in (0..count).map(part) {
                expected.include(low, 0.0);
                expected.include(high, 0.0);
            }
            assert_eq!(around, expected);
        }
    }

    proptest! {
        #[test]
        fn nothing_that_overlaps_is_missed(
            boxes in prop::collection::vec((0_u32..40, any_box(), prop::bool::weighted(0.2)), 1..120),
            region in any_box(),
        ) {
            let mut grid = Grid::new(2.0);
            let mut present = std::collections::BTreeMap::new();
            for (slot, area, remove) in boxes {
                if remove {
                    grid.remove(slot);
                    present.remove(&slot);
                } else {
                    grid.set(slot, area);
                    present.insert(slot, area);
                }
            }
            let mut found = Vec::new();
            grid.find(&region, &mut found);
            found.sort_unstable();
            let unique = found.len();
            found.dedup();
            prop_assert_eq!(found.len(), unique, "a landmark was reported twice");
            for (slot, area) in &present {
                prop_assert!(!area.overlaps(&region) || found.contains(slot), "slot {} was missed", slot);
            }
            prop_assert!(found.iter().all(|slot| present.contains_key(slot)));
        }
    }
}
