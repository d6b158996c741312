//! Landmarks that stand for one thing become one.
//!
//! Different particles may have created their own landmark for it: then no map changes, but the landmark is stored,
//! found and reported once. Or one map holds two: given the path their Gaussians are independent, so that their product
//! is what all sightings together say.

use super::believed::EXISTENCE_COLUMNS;
use super::landmarks::Landmarks;
use super::merger::Merger;
use super::setup::Settings;
use super::state::{Maps, State};
use super::work::{Claims, Correcting};
use crate::association::{Decision, Merging};
use crate::density::chi_squared_2;
use crate::diagnosis::health::Watch;
use crate::gaussian::{Gaussian, GaussianOf};
use crate::geometry::Symmetric2;
use crate::landmark::{column, Planar};
use crate::smoothing::RARE;
use crate::store::Rows;
use crate::vector::any;
use rustc_hash::FxHashMap;

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
        if self.merger.is_crowded() {
            let held = landmarks.live_slots().into_iter().map(|slot| landmarks.birth(slot)).collect();
            self.merger.forget_all_but(&held);
        }
    }

    /// Merges what means one thing near the sightings of a scan; returns how many the best particle held twice.
    pub fn merge_near(&mut self, claims: Claims<'_>, correcting: &Correcting) -> u32 {
        let founded = correcting.founded.iter().map(|(_, slot)| *slot);
        let mut slots: Vec<u32> = claims.table.slots.iter().copied().chain(founded).collect();
        let first_birth = correcting.first_birth;
        slots.retain(|slot| self.maps.landmarks.slot(*slot).is_some_and(|s| s.birth < first_birth));
        slots.sort_unstable_by_key(|slot| self.maps.landmarks.birth(*slot));
        let (mut merged, mut copies) = (0, Copies::default());
        for (place, &younger) in slots.iter().enumerate() {
            for &older in &slots[..place] {
                if [older, younger].iter().all(|slot| self.maps.landmarks.slot(*slot).is_some()) {
                    merged += self.merge([older, younger], &mut copies);
                }
            }
        }
        merged
    }

    /// Merges a landmark into an older one wherever both mean one thing; returns whether the best particle held both.
    fn merge(&mut self, [older, younger]: [u32; 2], copies: &mut Copies) -> u32 {
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
        let (n, columns) = (self.maps.particles.len(), landmarks.columns());
        let [old, young] = copies.of(landmarks, [older, younger]);
        let (old, young) = (Rows::new(old, n), Rows::new(young, n));
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
        copies.forget([older, younger]);
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
        let near = near(old, young, tolerance, gate)?;
        let [held, sightings] = [old, young].map(|rows| rows.column(column::SIGHTINGS));
        let mut union = Union { moved: vec![false; n], fused: vec![false; n] };
        for i in (0..n).filter(|i| near[*i] && !named(*i) && !are_two(together, sightings[*i])) {
            let target = if held[i] != 0.0 { &mut union.fused } else { &mut union.moved };
            target[i] = true;
        }
        (any(&union.moved) || any(&union.fused)).then_some(union)
    }
}

/// The older of two landmarks as the maps that lack it have it, where they hold the younger: as the mean over those that hold
/// it. Nothing lies near to what no map holds.
fn elsewhere(old: &Rows<'_>, young: &Rows<'_>) -> Gaussian {
    let (held, sighted) = (old.column(column::SIGHTINGS), young.column(column::SIGHTINGS));
    let is_wanted = sighted.iter().zip(held).fold(false, |any, (young, old)| any | ((*young != 0.0) & (*old == 0.0)));
    let nowhere = Gaussian { mean: [f64::NAN; 2], covariance: Symmetric2::new(0.0, 0.0, 0.0) };
    is_wanted.then(|| average(old, held.len())).flatten().unwrap_or(nowhere)
}

/// In which maps two landmarks lie within the gate; `None` when in none.
fn near(old: &Rows<'_>, young: &Rows<'_>, tolerance: f64, gate: f64) -> Option<Vec<bool>> {
    let (lacked, n) = (elsewhere(old, young), old.column(column::SIGHTINGS).len());
    let [held, x, y, xx, xy, yy] = planar(old);
    let (held, x, y, xx, xy, yy) = (&held[..n], &x[..n], &y[..n], &xx[..n], &xy[..n], &yy[..n]);
    let [sighted, px, py, pxx, pxy, pyy] = planar(young);
    let (sighted, px, py, pxx, pxy, pyy) = (&sighted[..n], &px[..n], &py[..n], &pxx[..n], &pxy[..n], &pyy[..n]);
    let is_near = |i: usize| {
        let pick = |own: f64, other: f64| if held[i] != 0.0 { own } else { other };
        let (mean, c) = (lacked.mean, lacked.covariance);
        let older = Gaussian {
            mean: [pick(x[i], mean[0]), pick(y[i], mean[1])],
            covariance: Symmetric2::new(pick(xx[i], c.xx), pick(xy[i], c.xy), pick(yy[i], c.yy)),
        };
        let younger = Gaussian { mean: [px[i], py[i]], covariance: Symmetric2::new(pxx[i], pxy[i], pyy[i]) };
        (sighted[i] != 0.0) & (older.distance_squared(&younger, tolerance) <= gate)
    };
    let near: Vec<bool> = (0..n).map(is_near).collect();
    any(&near).then_some(near)
}

/// Sightings, means, and xx, xy, yy of the covariances.
fn planar<'a>(rows: &Rows<'a>) -> [&'a [f64]; 6] {
    use column::{COV_XX, COV_XY, COV_YY, MEAN_X, MEAN_Y, SIGHTINGS};
    [SIGHTINGS, MEAN_X, MEAN_Y, COV_XX, COV_XY, COV_YY].map(|column| rows.column(column))
}

/// Rows of landmarks in particle order, copied once for all that they are compared with.
#[derive(Default)]
struct Copies(FxHashMap<u32, Vec<f64>>);

impl Copies {
    /// The rows of two landmarks.
    fn of(&mut self, landmarks: &mut Landmarks, slots: [u32; 2]) -> [&[f64]; 2] {
        for slot in slots {
            self.0.entry(slot).or_insert_with(|| landmarks.read(slot).values().to_vec());
        }
        slots.map(|slot| self.0[&slot].as_slice())
    }

    /// What stood there is not so any more.
    fn forget(&mut self, slots: [u32; 2]) {
        slots.iter().for_each(|slot| drop(self.0.remove(slot)));
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
    store.update(older, touched, &mut |rows| {
        let [present, log_odds] = rows.columns::<EXISTENCE_COLUMNS>();
        for i in (0..n).filter(|i| touched[*i]) {
            log_odds[i] = if present[i] == 0.0 { young[i] } else { log_odds[i].max(young[i]) };
            present[i] = 1.0;
        }
    });
    store.update(younger, touched, &mut |rows| {
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
