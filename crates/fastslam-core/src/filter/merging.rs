//! Landmarks that stand for one thing become one.
//!
//! Different particles may have created their own landmark for it: then no map changes, but the landmark is stored,
//! found and reported once. Or one map holds two: given the path their Gaussians are independent, so that their product
//! is what all sightings together say.

use super::landmarks::EXISTENCE_COLUMNS;
use super::{FastSlam, Particles, StepInfo};
use crate::association::{CandidateTable, Decision};
use crate::density::chi_squared_2;
use crate::gaussian::{distance_squared, product, spread_product, Gaussian};
use crate::landmark::{column, gaussian_in};
use crate::measurement::MeasurementModel;
use crate::smoothing::RARE;
use crate::store::{Rows, RowsMut};

/// Duplicates are looked for in every so many steps.
const PERIOD: u64 = 8;

/// The particles in which a landmark goes over into another: taken as it is, or combined with what is there.
struct Union {
    moved: Vec<bool>,
    fused: Vec<bool>,
}

impl<M: MeasurementModel> FastSlam<M> {
    /// Notes which landmarks were sighted together and, from time to time, merges those near the scan's sightings.
    pub(super) fn merge_duplicates(
        &mut self,
        decisions: &[Decision],
        table: &CandidateTable,
        first_birth: u64,
        info: &mut StepInfo,
    ) {
        self.note_sighted_together(decisions, table);
        if !self.state.counters.steps.is_multiple_of(PERIOD) {
            return;
        }
        let mut slots: Vec<u32> =
            table.slots.iter().copied().chain(self.work.correcting.founded.iter().map(|(_, s)| *s)).collect();
        slots.retain(|slot| self.state.landmarks.slot(*slot).is_some_and(|s| s.birth < first_birth));
        slots.sort_unstable_by_key(|slot| self.state.landmarks.birth(*slot));
        for (place, &younger) in slots.iter().enumerate() {
            for &older in &slots[..place] {
                if [older, younger].iter().all(|slot| self.state.landmarks.slot(*slot).is_some()) {
                    info.changes.merged += self.merge(older, younger);
                }
            }
        }
    }

    fn note_sighted_together(&mut self, decisions: &[Decision], table: &CandidateTable) {
        let share = decisions.len() / self.state.particles.len();
        let best = self.state.particles.best();
        let founded =
            |j: usize| self.work.correcting.founded.iter().find(|(index, _)| *index == j).map(|(_, slot)| *slot);
        let slot = |(j, decision): (usize, &Decision)| match decision {
            Decision::Landmark(candidate) => Some(table.slots[*candidate as usize]),
            Decision::New => founded(j),
            Decision::Ignored => None,
        };
        let slots = decisions[best * share..][..share].iter().enumerate().filter_map(slot);
        // What was removed since has no birth.
        let mut births = std::mem::take(&mut self.state.merger.births);
        births.clear();
        births.extend(slots.filter_map(|slot| self.state.landmarks.slot(slot)).map(|slot| slot.birth));
        for (place, a) in births.iter().enumerate() {
            births[..place].iter().for_each(|b| self.state.merger.note(*a, *b, 1));
        }
        self.state.merger.births = births;
    }

    /// Merges a landmark into an older one wherever both mean one thing; returns whether the best particle held both.
    fn merge(&mut self, older: u32, younger: u32) -> u32 {
        // Two of a given map are two.
        if self.state.given.of(self.state.landmarks.birth(younger)).is_some() {
            return 0;
        }
        let n = self.state.particles.len();
        let columns = self.state.landmarks.columns();
        let copy = |rows: Rows<'_>, count: usize| (0..count).flat_map(|c| rows.column(c).to_vec()).collect::<Vec<_>>();
        let old = copy(self.state.landmarks.read(older), columns);
        let young = copy(self.state.landmarks.read(younger), columns);
        let (old, young) = (Rows::new(&old, n), Rows::new(&young, n));
        let together =
            self.state.merger.together(self.state.landmarks.birth(older), self.state.landmarks.birth(younger));
        let Some(union) = self.union(&old, &young, f64::from(together)) else { return 0 };
        if self.is_fixed(older) {
            self.settle([older, younger], &union);
            return u32::from(union.fused[self.state.particles.best()]);
        }
        let touched: Vec<bool> = (0..n).map(|i| union.moved[i] || union.fused[i]).collect();
        let unsure = self.settings.config.association.merging.tolerance_std_m > 0.0;
        self.state.landmarks.update(older, Some(&touched), |mut rows| {
            for i in (0..n).filter(|i| touched[*i]) {
                if union.moved[i] {
                    (0..columns).for_each(|c| rows.column(c)[i] = young.column(c)[i]);
                } else {
                    fuse(&mut rows, i, [&old, &young], unsure);
                }
            }
        });
        self.settle([older, younger], &union);
        u32::from(union.fused[self.state.particles.best()])
    }

    /// Makes a landmark that all maps hold one with another that they all hold too, whose Gaussians know of it already.
    pub(super) fn unite(&mut self, [older, younger]: [u32; 2]) {
        let n = self.state.particles.len();
        if !self.is_fixed(older) {
            let more = self.state.landmarks.read(younger).column(column::SIGHTINGS).to_vec();
            self.state.landmarks.update(older, None, |mut rows| {
                rows.column(column::SIGHTINGS).iter_mut().zip(&more).for_each(|(count, more)| *count += more);
            });
        }
        self.settle([older, younger], &Union { moved: vec![false; n], fused: vec![true; n] });
    }

    /// Everything but the Gaussians of two landmarks that became one.
    fn settle(&mut self, [older, younger]: [u32; 2], union: &Union) {
        let touched: Vec<bool> = union.moved.iter().zip(&union.fused).map(|(moved, fused)| *moved || *fused).collect();
        self.state.merger.united.insert(self.state.landmarks.birth(younger), self.state.landmarks.birth(older));
        self.state.diagnosis.watch.merged(self.state.landmarks.birth(older));
        if !self.is_fixed(older) {
            self.merge_existence([older, younger], &touched);
            if let Some(appearances) = &mut self.state.landmarks.appearances {
                appearances.merge(younger, older, [&union.moved, &union.fused]);
            }
        }
        self.forget(younger, older, &touched);
        let Particles { landmarks, .. } = &mut self.state.particles;
        landmarks.iter_mut().zip(&union.fused).for_each(|(count, fused)| *count -= u32::from(*fused));
    }

    /// Takes a landmark out of the maps in which it went over into another.
    fn forget(&mut self, younger: u32, older: u32, touched: &[bool]) {
        self.state.landmarks.clear_rows(younger, touched);
        if self.state.landmarks.holders(younger) == 0 {
            self.state.merger.rename(self.state.landmarks.birth(younger), self.state.landmarks.birth(older));
            self.state.landmarks.remove(younger);
        }
    }

    /// Where the two landmarks mean one thing: nearer to each other than the gate, and hardly ever sighted together.
    /// `None` when nowhere.
    fn union(&self, old: &Rows<'_>, young: &Rows<'_>, together: f64) -> Option<Union> {
        let n = self.state.particles.len();
        let merging = &self.settings.config.association.merging;
        let gate = chi_squared_2(merging.gate_probability);
        let tolerance = merging.tolerance_std_m * merging.tolerance_std_m;
        let named =
            |i: usize| self.state.landmarks.columns() > column::IDENTITY && young.column(column::IDENTITY)[i] != 0.0;
        let elsewhere = average(old, n);
        let mut union = Union { moved: vec![false; n], fused: vec![false; n] };
        for i in (0..n).filter(|i| !named(*i)) {
            let Some(b) = gaussian_in(young, i) else { continue };
            let own = gaussian_in(old, i);
            let Some(a) = own.or(elsewhere) else { continue };
            let sightings = young.column(column::SIGHTINGS)[i];
            if together * RARE > sightings {
                continue;
            }
            if distance_squared(&a, &b, tolerance) <= gate {
                let target = if own.is_some() { &mut union.fused } else { &mut union.moved };
                target[i] = true;
            }
        }
        (union.moved.contains(&true) || union.fused.contains(&true)).then_some(union)
    }

    /// The better of the two beliefs that a merged landmark exists.
    fn merge_existence(&mut self, [older, younger]: [u32; 2], touched: &[bool]) {
        let n = touched.len();
        let Some(store) = &mut self.state.landmarks.existence else { return };
        let young = store.read(younger).column(1).to_vec();
        store.update(older, Some(touched), &mut |rows| {
            let [present, log_odds] = rows.columns::<EXISTENCE_COLUMNS>();
            for i in (0..n).filter(|i| touched[*i]) {
                log_odds[i] = if present[i] == 0.0 { young[i] } else { log_odds[i].max(young[i]) };
                present[i] = 1.0;
            }
        });
        store.update(younger, Some(touched), &mut |rows| {
            let [present, log_odds] = rows.columns::<EXISTENCE_COLUMNS>();
            (0..n).filter(|i| touched[*i]).for_each(|i| (present[i], log_odds[i]) = (0.0, 0.0));
        });
    }
}

/// Puts the product of two landmarks of one map into its row of the older one; spread where both may be beside the truth.
fn fuse(rows: &mut RowsMut<'_>, i: usize, pair: [&Rows<'_>; 2], unsure: bool) {
    let [Some(a), Some(b)] = pair.map(|rows| gaussian_in(rows, i)) else { return };
    let counts = pair.map(|rows| rows.column(column::SIGHTINGS)[i]);
    let both = if unsure { spread_product(&a, &b, counts) } else { product(&a, &b) };
    // Ellipses without width have no product in doubles: the older one stands for both.
    let both = if both.is_usable() { both } else { a };
    rows.column(column::SIGHTINGS)[i] = counts[0] + counts[1];
    rows.column(column::MEAN_X)[i] = both.mean[0];
    rows.column(column::MEAN_Y)[i] = both.mean[1];
    rows.column(column::COV_XX)[i] = both.covariance.xx;
    rows.column(column::COV_XY)[i] = both.covariance.xy;
    rows.column(column::COV_YY)[i] = both.covariance.yy;
}

/// Mean over the maps that hold a landmark, with its spread between and within them.
fn average(rows: &Rows<'_>, n: usize) -> Option<Gaussian> {
    let held: Vec<Gaussian> = (0..n).filter_map(|i| gaussian_in(rows, i)).collect();
    if held.is_empty() {
        return None;
    }
    let share = 1.0 / held.len() as f64;
    let mean = [0, 1].map(|axis| held.iter().map(|l| share * l.mean[axis]).sum::<f64>());
    Some(Gaussian::mixture_about(mean, held.iter().map(|landmark| (share, *landmark))))
}
