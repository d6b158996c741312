//! Landmarks that stand for one thing become one.
//!
//! Different particles may have created their own landmark for it: then no map changes, but the landmark is stored,
//! found and reported once. Or one map holds two: given the path their Gaussians are independent, so that their product
//! is what all sightings together say.

use super::landmarks::{Landmarks, EXISTENCE_COLUMNS};
use super::merger::Merger;
use super::setup::Settings;
use super::state::{Maps, State};
use super::work::{Claims, Correcting};
use crate::association::{Decision, Merging};
use crate::density::chi_squared_2;
use crate::diagnosis::health::Watch;
use crate::gaussian::{Gaussian, GaussianOf};
use crate::landmark::{column, Planar};
use crate::smoothing::RARE;
use crate::store::Rows;
use std::cell::LazyCell;

/// Duplicates are looked for in every so many steps.
const PERIOD: u64 = 8;

/// The particles in which a landmark goes over into another: taken as it is, or combined with what is there.
struct Union {
    moved: Vec<bool>,
    fused: Vec<bool>,
}

impl Union {
    /// Where either happens.
    fn touched(&self) -> Vec<bool> {
        self.moved.iter().zip(&self.fused).map(|(moved, fused)| *moved || *fused).collect()
    }
}

/// The maps, and who must hear of landmarks that become one.
pub(super) struct Unions<'a> {
    settings: &'a Merging,
    maps: Maps<'a>,
    merger: &'a mut Merger,
    watch: &'a mut Watch,
}

/// Whether duplicates are looked for in this step.
pub(super) fn is_due(step: u64) -> bool {
    step.is_multiple_of(PERIOD)
}

impl<'a> Unions<'a> {
    /// Of the filter.
    pub fn of(settings: &'a Settings, state: &'a mut State) -> Self {
        let State { particles, landmarks, given, merger, diagnosis, .. } = state;
        Self {
            settings: &settings.config.association.merging,
            maps: Maps { particles, landmarks, given },
            merger,
            watch: &mut diagnosis.watch,
        }
    }

    /// Notes which landmarks the best particle sighted together in a scan.
    pub fn note_sighted_together(&mut self, claims: Claims<'_>, founded: &[(usize, u32)]) {
        let (landmarks, particles) = (&self.maps.landmarks, &self.maps.particles);
        let of = |j: usize| founded.iter().find(|(index, _)| *index == j).map(|(_, slot)| *slot);
        let slot = |(j, decision): (usize, &Decision)| match decision {
            Decision::Landmark(candidate) => Some(claims.table.slots[*candidate as usize]),
            Decision::New => of(j),
            Decision::Ignored => None,
        };
        let slots = claims.of(particles.best()).iter().enumerate().filter_map(slot);
        // What was removed since has no birth.
        self.merger.note_all(slots.filter_map(|slot| landmarks.slot(slot)).map(|slot| slot.birth));
    }

    /// Merges what means one thing near the sightings of a scan; returns how many the best particle held twice.
    pub fn merge_near(&mut self, claims: Claims<'_>, correcting: &Correcting) -> u32 {
        let founded = correcting.founded.iter().map(|(_, slot)| *slot);
        let mut slots: Vec<u32> = claims.table.slots.iter().copied().chain(founded).collect();
        let first_birth = correcting.first_birth;
        slots.retain(|slot| self.maps.landmarks.slot(*slot).is_some_and(|s| s.birth < first_birth));
        slots.sort_unstable_by_key(|slot| self.maps.landmarks.birth(*slot));
        let mut merged = 0;
        for (place, &younger) in slots.iter().enumerate() {
            for &older in &slots[..place] {
                if [older, younger].iter().all(|slot| self.maps.landmarks.slot(*slot).is_some()) {
                    merged += self.merge(older, younger);
                }
            }
        }
        merged
    }

    /// Merges a landmark into an older one wherever both mean one thing; returns whether the best particle held both.
    fn merge(&mut self, older: u32, younger: u32) -> u32 {
        let landmarks = &mut *self.maps.landmarks;
        let gate = chi_squared_2(self.settings.gate_probability).sqrt();
        if !landmarks.may_touch([older, younger], gate, self.settings.tolerance_std_m) {
            return 0;
        }
        let births = [older, younger].map(|slot| landmarks.birth(slot));
        // Two of a given map are two.
        if self.maps.given.of(births[1]).is_some() {
            return 0;
        }
        let together = f64::from(self.merger.together(births[0], births[1]));
        let sighted = landmarks.read(younger).column(column::SIGHTINGS);
        if sighted.iter().all(|sightings| are_two(together, *sightings)) {
            return 0;
        }
        let (n, columns) = (self.maps.particles.len(), landmarks.columns());
        let copy = |rows: Rows<'_>| (0..columns).map(|c| rows.column(c)).collect::<Vec<_>>().concat();
        let (old, young) = (copy(landmarks.read(older)), copy(landmarks.read(younger)));
        let (old, young) = (Rows::new(&old, n), Rows::new(&young, n));
        let Some(union) = self.union(&old, &young, together) else { return 0 };
        if !self.maps.is_fixed(older) {
            let unsure = self.settings.tolerance_std_m > 0.0;
            self.maps.landmarks.update(older, Some(&union.touched()), |mut rows| {
                for i in 0..n {
                    if union.moved[i] {
                        (0..columns).for_each(|c| rows.column(c)[i] = young.column(c)[i]);
                    } else if union.fused[i] {
                        Planar::fuse::<Gaussian>(&mut rows, i, [&old, &young], unsure);
                    }
                }
            });
        }
        self.settle([older, younger], &union);
        u32::from(union.fused[self.maps.particles.best()])
    }

    /// Makes a landmark that all maps hold one with another that they all hold too, whose Gaussians know of it already.
    pub fn unite(&mut self, [older, younger]: [u32; 2]) {
        let n = self.maps.particles.len();
        if !self.maps.is_fixed(older) {
            let more = self.maps.landmarks.read(younger).column(column::SIGHTINGS).to_vec();
            self.maps.landmarks.update(older, None, |mut rows| {
                rows.column(column::SIGHTINGS).iter_mut().zip(&more).for_each(|(count, more)| *count += more);
            });
        }
        self.settle([older, younger], &Union { moved: vec![false; n], fused: vec![true; n] });
    }

    /// Tells the watch that loops were closed.
    pub fn closed(&mut self) {
        self.watch.closed();
    }

    /// Everything but the Gaussians of two landmarks that became one.
    fn settle(&mut self, [older, younger]: [u32; 2], union: &Union) {
        let touched = union.touched();
        let Maps { particles, landmarks, given } = &mut self.maps;
        let births = [older, younger].map(|slot| landmarks.birth(slot));
        self.merger.united.insert(births[1], births[0]);
        self.watch.merged(births[0]);
        if !given.is_fixed(births[0]) {
            merge_existence(landmarks, [older, younger], &touched);
            if let Some(appearances) = &mut landmarks.appearances {
                appearances.merge(younger, older, [&union.moved, &union.fused]);
            }
        }
        landmarks.clear_rows(younger, &touched);
        if landmarks.holders(younger) == 0 {
            self.merger.rename(births[1], births[0]);
            landmarks.remove(younger);
        }
        particles.landmarks.iter_mut().zip(&union.fused).for_each(|(count, fused)| *count -= u32::from(*fused));
    }

    /// Where the two landmarks mean one thing: nearer to each other than the gate, and hardly ever sighted together.
    /// `None` when nowhere.
    fn union(&self, old: &Rows<'_>, young: &Rows<'_>, together: f64) -> Option<Union> {
        let n = self.maps.particles.len();
        let gate = chi_squared_2(self.settings.gate_probability);
        let tolerance = self.settings.tolerance_std_m * self.settings.tolerance_std_m;
        let has_names = self.maps.landmarks.columns() > column::IDENTITY;
        let named = |i: usize| has_names && young.column(column::IDENTITY)[i] != 0.0;
        let elsewhere = LazyCell::new(|| average(old, n));
        let mut union = Union { moved: vec![false; n], fused: vec![false; n] };
        for i in (0..n).filter(|i| !named(*i)) {
            let Some(b) = Planar::gaussian_in::<Gaussian>(young, i) else { continue };
            let own = Planar::gaussian_in(old, i);
            let Some(a) = own.or_else(|| *elsewhere) else { continue };
            let sightings = young.column(column::SIGHTINGS)[i];
            if are_two(together, sightings) {
                continue;
            }
            if a.distance_squared(&b, tolerance) <= gate {
                let target = if own.is_some() { &mut union.fused } else { &mut union.moved };
                target[i] = true;
            }
        }
        (union.moved.contains(&true) || union.fused.contains(&true)).then_some(union)
    }
}

/// Whether landmarks that were sighted together in so many scans are two things, the younger with so many sightings.
fn are_two(together: f64, sightings: f64) -> bool {
    together * RARE > sightings
}

/// The better of the two beliefs that a merged landmark exists.
fn merge_existence(landmarks: &mut Landmarks, [older, younger]: [u32; 2], touched: &[bool]) {
    let n = touched.len();
    let Some(store) = &mut landmarks.existence else { return };
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

/// Mean over the maps that hold a landmark, with its spread between and within them.
fn average(rows: &Rows<'_>, n: usize) -> Option<Gaussian> {
    let held: Vec<Gaussian> = (0..n).filter_map(|i| Planar::gaussian_in(rows, i)).collect();
    if held.is_empty() {
        return None;
    }
    let share = 1.0 / held.len() as f64;
    let mean = [0, 1].map(|axis| held.iter().map(|l| share * l.mean[axis]).sum::<f64>());
    Some(Gaussian::mixture_about(mean, held.iter().map(|landmark| (share, *landmark))))
}
