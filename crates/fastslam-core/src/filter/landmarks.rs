//! The landmarks of all maps: the store with names, births and places.

use super::appearance::Appearances;
use super::believed::Existence;
use super::fading::Fading;
use crate::association::{Box2, Grid, Identities, ScanSighting};
use crate::config::Config;
use crate::gaussian::{Gaussian, GaussianOf};
use crate::given::GivenLandmark;
use crate::landmark::{Columns, Planar};
use crate::store::{LandmarkStore, Rows, RowsMut, StoreUsage};
use crate::vector::{range, vectorized};
use crate::workers::Workers;
use rustc_hash::FxHashMap;
use serde::{Deserialize, Serialize};

/// The density of landmarks is that among so many neighbours.
const NEIGHBOURS: usize = 8;

/// A landmark hypothesis, shared by the particles that created it from one sighting.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Slot {
    /// Running number of its creation: names it, and breaks ties.
    pub birth: u64,
    /// Identity that it was created with.
    pub identity: Option<u32>,
}

/// A landmark of one map: its slot and its mean.
pub(super) type Place = (u32, [f64; 2]);

/// Columns of a row at most, with that of names: those of landmarks of four coordinates.
const MOST_COLUMNS: usize = 16;

/// The population of maps with what all particles have in common: landmarks of `D` coordinates, two or more, of which the
/// first two are where the spatial index looks for them.
#[derive(Clone, Serialize, Deserialize)]
pub struct Landmarks<const D: usize = 2> {
    store: Box<dyn LandmarkStore>,
    columns: usize,
    /// Log-odds of existence by slot; only kept when landmarks may be removed.
    pub(super) existence: Option<Existence>,
    /// What landmarks look like by slot; only kept where it is configured.
    pub(super) appearances: Option<Appearances>,
    /// What speaks for and against them, where those fade that were never confirmed; a snapshot has it behind the rest.
    #[serde(skip)]
    pub(super) fading: Option<Fading>,
    slots: Vec<Option<Slot>>,
    free: Vec<u32>,
    births: u64,
    /// Slots that were ever seen with an identity, oldest first.
    of_identity: FxHashMap<u32, Vec<u32>>,
    /// Where landmarks are; only kept when sightings without identity may come.
    grid: Option<Grid>,
    /// Widening of boxes: gate radius in standard deviations.
    gate_radius: f64,
    /// How far the maps agree about landmarks, by slot; what is not known, as after a restored snapshot, may be anything.
    #[serde(skip)]
    spreads: Vec<Option<Spread>>,
}

/// Where the maps have a landmark.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Spread {
    /// A box around its means.
    means: Box2,
    /// The largest trace of its covariances.
    trace: f64,
}

impl Spread {
    /// What the variance along an axis does not exceed, in any map nor as the mean over all: between the maps it is at most
    /// the square of half the box.
    fn variance(&self, axis: usize) -> f64 {
        let half = 0.5 * (self.means.high[axis] - self.means.low[axis]);
        self.trace + half * half
    }

    /// How far the two lie apart along an axis at least; negative where they may overlap.
    fn gap(&self, other: &Self, axis: usize) -> f64 {
        (self.means.low[axis] - other.means.high[axis]).max(other.means.low[axis] - self.means.high[axis])
    }
}

impl<const D: usize> Landmarks<D> {
    /// Empty maps; `cell_m` and `gate_radius` (standard deviations) size the spatial index.
    pub fn new(config: &Config, identities: Identities, cell_m: f64, gate_radius: f64) -> Self {
        let columns = Columns::<D>::COUNT + usize::from(identities == Identities::Some);
        let (kind, particles) = (config.filter.store, config.filter.particles as usize);
        Self {
            store: kind.create(particles, columns),
            columns,
            existence: (identities != Identities::All).then(|| Existence::new(kind, particles)),
            appearances: Appearances::new(kind, particles, &config.association),
            fading: Fading::of(config, identities),
            slots: Vec::new(),
            free: Vec::new(),
            births: 0,
            of_identity: FxHashMap::default(),
            grid: (identities != Identities::All).then(|| Grid::new(cell_m)),
            gate_radius,
            spreads: Vec::new(),
        }
    }

    /// Threads that may share the particles of a landmark.
    pub fn set_workers(&mut self, workers: &Workers) {
        self.store.set_workers(workers);
        if let Some(existence) = &mut self.existence {
            existence.set_workers(workers);
        }
    }

    /// Columns per landmark.
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// Slots that hold a landmark in some map, in the order of birth.
    pub fn live_slots(&self) -> Vec<u32> {
        let mut live: Vec<u32> = (0..self.slots.len() as u32).filter(|s| self.slots[*s as usize].is_some()).collect();
        live.sort_unstable_by_key(|s| self.birth(*s));
        live
    }

    /// What is known of a slot in use.
    pub fn slot(&self, slot: u32) -> Option<Slot> {
        self.slots.get(slot as usize).copied().flatten()
    }

    /// Running number of a slot's creation.
    pub fn birth(&self, slot: u32) -> u64 {
        self.slot(slot).map_or(u64::MAX, |s| s.birth)
    }

    /// Number of landmarks ever created: the birth of the next one.
    pub fn births(&self) -> u64 {
        self.births
    }

    /// The slots seen with an identity, oldest first.
    pub fn of_identity(&self, identity: u32) -> &[u32] {
        self.of_identity.get(&identity).map_or(&[], Vec::as_slice)
    }

    /// The slot of the landmark that a sighting names; `None` when it is new or the sighting has no name.
    pub fn named(&self, sighting: &ScanSighting) -> Option<u32> {
        sighting.identity.and_then(|identity| self.of_identity(identity).first().copied())
    }

    /// Notes that a slot was seen with an identity.
    pub fn mark_identity(&mut self, slot: u32, identity: u32) {
        let slots = self.of_identity.entry(identity).or_default();
        if !slots.contains(&slot) {
            slots.push(slot);
        }
    }

    /// Adds a landmark with the rows of all particles and the log-odds that it exists.
    pub fn insert(&mut self, identity: Option<u32>, values: &[f64], log_odds: f64) -> u32 {
        let slot = self.new_slot(identity);
        self.store.insert(slot, values);
        if let Some(existence) = &mut self.existence {
            let present = values[..self.store.particle_count()].iter().map(|count| f64::from(*count != 0.0));
            let mut rows: Vec<f64> = present.collect();
            rows.extend_from_within(..);
            rows[self.store.particle_count()..].iter_mut().for_each(|value| *value *= log_odds);
            existence.insert(slot, &rows);
        }
        if let Some(appearances) = &mut self.appearances {
            appearances.insert(slot);
        }
        let rows = Rows::new(values, self.store.particle_count());
        let spread = self.grid.is_some().then(|| spread::<D>(&rows));
        self.place(slot, spread);
        slot
    }

    /// Adds a landmark whose row is the same in all maps, with the log-odds that it exists: one row for all particles.
    fn insert_shared(&mut self, identity: Option<u32>, row: &mut [f64], log_odds: f64) -> u32 {
        if let (Some(identity), Some(mark)) = (identity, row.get_mut(Columns::<D>::IDENTITY)) {
            *mark = f64::from(identity) + 1.0;
        }
        let slot = self.new_slot(identity);
        self.store.insert_shared(slot, row);
        if let Some(existence) = &mut self.existence {
            existence.insert_shared(slot, &[1.0, log_odds]);
        }
        if self.grid.is_some() {
            self.update_place(slot);
        }
        slot
    }

    /// A free slot for the next birth.
    fn new_slot(&mut self, identity: Option<u32>) -> u32 {
        let slot = self.free.pop().unwrap_or(self.slots.len() as u32);
        if slot as usize == self.slots.len() {
            self.slots.push(None);
        }
        self.slots[slot as usize] = Some(Slot { birth: self.births, identity });
        self.births += 1;
        if let Some(identity) = identity {
            self.mark_identity(slot, identity);
        }
        slot
    }

    /// Removes a landmark from all maps.
    pub fn remove(&mut self, slot: u32) {
        self.store.remove(slot);
        if let Some(existence) = &mut self.existence {
            existence.remove(slot);
        }
        if let Some(appearances) = &mut self.appearances {
            appearances.remove(slot);
        }
        if let Some(grid) = &mut self.grid {
            grid.remove(slot);
        }
        if self.slots[slot as usize].take().is_some() {
            for slots in self.of_identity.values_mut() {
                slots.retain(|s| *s != slot);
            }
            self.free.push(slot);
        }
    }

    /// Maps that hold a landmark.
    pub fn holders(&mut self, slot: u32) -> usize {
        self.store.holders(slot)
    }

    /// The rows of a landmark in particle order.
    pub fn read(&mut self, slot: u32) -> Rows<'_> {
        self.store.read(slot)
    }

    /// Prepares for several reads of a landmark, and of whether it exists, in this step and those that follow.
    pub fn expect_reads(&mut self, slot: u32) {
        self.store.expect_reads(slot);
        if let Some(existence) = &mut self.existence {
            existence.expect_reads(slot);
        }
    }

    /// Copies the rows of a landmark in particle order, column after column.
    pub fn copy_rows(&mut self, slot: u32, out: &mut [f64]) {
        self.store.copy_rows(slot, out);
    }

    /// One particle's landmark as this kind of Gaussian, and how often it was seen; `None` where it holds none.
    pub fn held_as<G: GaussianOf<D>>(&self, particle: usize, slot: u32) -> Option<(G, u32)> {
        const { assert!(Columns::<D>::COUNT < MOST_COLUMNS) };
        let mut row = [0.0; MOST_COLUMNS];
        let row = &mut row[..self.columns];
        let found = self.read_row(slot, particle, row);
        let count = row[Columns::<D>::SIGHTINGS];
        (found && count > 0.0).then(|| (Columns::<D>::gaussian_of(row), count as u32))
    }

    /// One particle's landmark; false when it is absent.
    pub fn read_row(&self, slot: u32, particle: usize, out: &mut [f64]) -> bool {
        self.store.read_row(slot, particle, out)
    }

    /// Whether somebody said the identity of one particle's landmark.
    pub fn is_named(&self, slot: u32, particle: usize) -> bool {
        let mut row = vec![0.0; self.columns];
        self.columns > Columns::<D>::IDENTITY
            && self.read_row(slot, particle, &mut row)
            && row[Columns::<D>::IDENTITY] != 0.0
    }

    /// Changes a landmark in the maps that `mask` marks (all without one).
    pub fn update(&mut self, slot: u32, mask: Option<&[bool]>, mut change: impl FnMut(RowsMut<'_>)) {
        self.store.update(slot, mask, &mut change);
        if self.grid.is_some() {
            self.update_place(slot);
        }
    }

    /// Makes a landmark absent from the maps that `mask` marks.
    pub fn clear_rows(&mut self, slot: u32, mask: &[bool]) {
        self.update(slot, Some(mask), |mut rows| {
            let count = rows.column(Columns::<D>::SIGHTINGS);
            (0..mask.len()).filter(|i| mask[*i]).for_each(|i| count[i] = 0.0);
        });
    }

    /// Enters a landmark's place into the spatial index.
    fn update_place(&mut self, slot: u32) {
        let spread = spread::<D>(&self.store.read(slot));
        self.place(slot, Some(spread));
    }

    /// Enters a landmark's box into the spatial index: all means, widened by the gate over the largest trace of a covariance
    /// (which bounds its largest eigenvalue).
    fn place(&mut self, slot: u32, spread: Option<Spread>) {
        let (Some(grid), Some(Spread { means, trace })) = (&mut self.grid, spread) else { return };
        if self.spreads.len() <= slot as usize {
            self.spreads.resize(slot as usize + 1, None);
        }
        self.spreads[slot as usize] = spread;
        if means == Box2::EMPTY {
            grid.remove(slot);
            return;
        }
        let margin = self.gate_radius * trace.sqrt();
        grid.set(slot, Box2 { low: means.low.map(|v| v - margin), high: means.high.map(|v| v + margin) });
    }

    /// How far the maps agree about a landmark, where that is known.
    fn spread(&self, slot: u32) -> Option<Spread> {
        self.spreads.get(slot as usize).copied().flatten()
    }

    /// Whether the means of two landmarks lie in any maps within `gate` standard deviations of their difference, to which
    /// `tolerance` is added. Also true of some that do not.
    ///
    /// **Why it is enough:** a squared Mahalanobis distance is no less than that along one axis, d² / s². Twice as much is
    /// asked for, beside which rounding is nothing.
    pub fn may_touch(&self, [a, b]: [u32; 2], gate: f64, tolerance: f64) -> bool {
        let (Some(a), Some(b)) = (self.spread(a), self.spread(b)) else { return true };
        !(0..2).any(|axis| {
            let (gap, variance) = (a.gap(&b, axis), a.variance(axis) + b.variance(axis) + tolerance * tolerance);
            gap > 0.0 && gap * gap > 2.0 * gate * gate * variance
        })
    }

    /// Whether the mean of a landmark lies in a region in any map. Also true of some of which none does.
    pub fn may_lie_in(&self, slot: u32, region: &Box2) -> bool {
        self.spread(slot).is_none_or(|spread| spread.means.overlaps(region))
    }

    /// Appends the landmarks that may lie in a region, in no particular order.
    pub fn find(&mut self, region: &Box2, out: &mut Vec<u32>) {
        if let Some(grid) = &mut self.grid {
            grid.find(region, out);
        }
    }

    /// Landmarks per square metre around a place in one map, which holds `known`: that of the nearest [`NEIGHBOURS`], or
    /// of all where there are fewer. `reach_m` is how far is looked first.
    pub fn density(&mut self, (map, known): (usize, usize), around: [f64; 2], reach_m: f64) -> f64 {
        let enough = known.min(NEIGHBOURS + 1);
        let (mut reach_m, mut squares) = (reach_m, Vec::new());
        // Doubled so often, any reach holds any map.
        for _ in 0..64 {
            squares.clear();
            let squared = |at: [f64; 2]| (at[0] - around[0]).powi(2) + (at[1] - around[1]).powi(2);
            squares.extend(self.places_near(map, around, reach_m).into_iter().map(|(_, at)| squared(at)));
            squares.retain(|squared| *squared <= reach_m * reach_m);
            if squares.len() >= enough {
                break;
            }
            reach_m *= 2.0;
        }
        squares.sort_unstable_by(f64::total_cmp);
        let neighbours = squares.len().min(enough).saturating_sub(1);
        let Some(farthest) = squares.get(neighbours).filter(|_| neighbours > 0) else { return 0.0 };
        neighbours as f64 / (std::f64::consts::PI * farthest)
    }

    /// The landmarks of one map in a square around a place, with their means; a few beside it too.
    pub fn places_near(&mut self, map: usize, around: [f64; 2], reach_m: f64) -> Vec<(u32, [f64; 2])> {
        let region = Box2 { low: around.map(|v| v - reach_m), high: around.map(|v| v + reach_m) };
        let (mut found, mut row) = (Vec::new(), vec![0.0; self.columns]);
        self.find(&region, &mut found);
        found.sort_unstable_by_key(|slot| self.birth(*slot));
        found.dedup();
        let held = |slot: u32| {
            self.read_row(slot, map, &mut row)
                .then(|| (slot, std::array::from_fn(|axis| row[Columns::<D>::mean(axis)])))
        };
        found.into_iter().filter_map(held).collect()
    }

    /// Map i becomes a copy of the former map `ancestor_indices[i]`.
    pub fn resample(&mut self, ancestor_indices: &[u32]) {
        self.store.resample(ancestor_indices);
        if let Some(existence) = &mut self.existence {
            existence.resample(ancestor_indices);
        }
        if let Some(appearances) = &mut self.appearances {
            appearances.resample(ancestor_indices);
        }
    }

    /// What the maps occupy.
    pub fn usage(&self) -> StoreUsage {
        let gaussians = self.store.usage();
        let existence = self.existence.as_ref().map(Existence::usage).unwrap_or_default();
        let looks = self.appearances.as_ref().map(Appearances::usage).unwrap_or_default();
        StoreUsage { rows: gaussians.rows, bytes: gaussians.bytes + existence.bytes + looks.bytes }
    }
}

impl Landmarks {
    /// One particle's landmark, and how often it was seen; `None` where it holds none.
    pub fn held_by(&self, particle: usize, slot: u32) -> Option<(Gaussian, u32)> {
        self.held_as(particle, slot)
    }

    /// Adds a landmark of a given map with the log-odds that it exists.
    pub fn adopt(&mut self, landmark: &GivenLandmark, log_odds: f64) -> u32 {
        let mut row = vec![0.0; self.columns];
        Planar::write(f64::from(landmark.sightings.max(1)), &landmark.place, &mut row);
        let slot = self.insert_shared(landmark.identity, &mut row, log_odds);
        if let Some(appearances) = &mut self.appearances {
            appearances.adopt(slot, landmark.appearance);
        }
        slot
    }
}

/// Means and variances of the first two coordinates.
fn position<'a, const D: usize>(rows: &Rows<'a>) -> [&'a [f64]; 4] {
    let columns = [0, 1].map(|axis| [Columns::<D>::mean(axis), Columns::<D>::covariance(axis, axis)]);
    [columns[0][0], columns[1][0], columns[0][1], columns[1][1]].map(|c| rows.column(c))
}

/// How far the maps agree about the landmark of these rows.
fn spread<const D: usize>(rows: &Rows<'_>) -> Spread {
    let (count, [x, y, xx, yy]) = (rows.column(Columns::<D>::SIGHTINGS), position::<D>(rows));
    let n = count.len();
    let (x, y, xx, yy) = (&x[..n], &y[..n], &xx[..n], &yy[..n]);
    vectorized(
        #[inline(always)]
        || {
            // Absent rows get a box that no minimum or maximum notices.
            let absent = (Box2::EMPTY.low, Box2::EMPTY.high);
            let means = Box2::around(
                n,
                #[inline(always)]
                |i| if count[i] != 0.0 { ([x[i], y[i]], [x[i], y[i]]) } else { absent },
            );
            let (_, trace) = range(
                n,
                #[inline(always)]
                |i| if count[i] != 0.0 { xx[i] + yy[i] } else { 0.0 },
            );
            Spread { means, trace: trace.max(0.0) }
        },
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::density::Tail;
    use crate::geometry::Pose;
    use crate::landmark::{Seen, SensorPoses};
    use crate::measurement::MeasurementModel;
    use crate::normal::{Cholesky, Normal};
    use crate::random::{Purpose, RandomSource};
    use crate::store::StoreKind;
    use crate::testing::tests::Point;

    #[test]
    fn what_may_be_one_is_not_passed_over_and_what_is_far_away_is() {
        let (maps, gate, tolerance) = (8, 2.45, 0.2);
        let mut config = Config::default();
        config.filter.particles = maps as u32;
        let mut landmarks = Landmarks::<2>::new(&config, Identities::None, 1.0, 3.0);
        let stream = RandomSource::new(5).stream(Purpose::Motion, 0);
        let (mut near, mut passed_over) = (0, 0);
        for case in 0..2000 {
            let uniform = |draw: u32| stream.uniform(case, draw);
            let (std_m, apart_m) = (0.02 + uniform(0), 100.0 * uniform(1) * uniform(1));
            let own = |k: u32| {
                let mut rows = vec![0.0; maps * landmarks.columns()];
                for i in 0..maps {
                    let draw = 2 + 64 * k + 8 * i as u32;
                    // Some maps lack it.
                    let count = if uniform(draw) < 0.2 { 0.0 } else { 1.0 };
                    let mean = [f64::from(k) * apart_m + uniform(draw + 1) - 0.5, uniform(draw + 2) - 0.5];
                    let variance = (std_m * uniform(draw + 3)).powi(2);
                    let numbers = [1.0, mean[0], mean[1], variance, 0.0, variance];
                    (0..6).for_each(|column| rows[column * maps + i] = count * numbers[column]);
                }
                rows
            };
            let rows = [own(0), own(1)];
            let slots = rows.each_ref().map(|rows| landmarks.insert(None, rows, 0.0));
            let of = |k: usize, i: usize| Planar::gaussian_in::<Gaussian>(&Rows::new(&rows[k], maps), i);
            let held: Vec<Gaussian> = (0..maps).filter_map(|i| of(0, i)).collect();
            let share = 1.0 / held.len() as f64;
            let mean = [0, 1].map(|axis| held.iter().map(|l| share * l.mean[axis]).sum::<f64>());
            let average = Gaussian::mixture_about(mean, held.iter().map(|l| (share, *l)));
            let is_near = (0..maps).any(|i| {
                let (a, b) = (of(0, i).unwrap_or(average), of(1, i));
                b.is_some_and(|b| a.distance_squared(&b, tolerance * tolerance) <= gate * gate)
            });
            let may = landmarks.may_touch(slots, gate, tolerance);
            assert!(may || !is_near, "case {case}");
            near += u32::from(is_near);
            passed_over += u32::from(!may);
            slots.into_iter().for_each(|slot| landmarks.remove(slot));
        }
        assert!(near > 100 && passed_over > 100, "{near} {passed_over}");
    }

    #[test]
    fn a_name_that_came_later_counts_in_the_maps_that_have_it() {
        let mut config = Config::default();
        config.filter.particles = 2;
        let mut landmarks = Landmarks::<2>::new(&config, Identities::Some, 1.0, 3.0);
        let columns = landmarks.columns();
        let mut rows = vec![1.0; 2 * columns];
        rows[2 * Planar::IDENTITY..].fill(0.0);
        let slot = landmarks.insert(None, &rows, 0.0);
        assert!(!landmarks.is_named(slot, 0) && !landmarks.is_named(slot, 1));
        landmarks.update(slot, Some(&[false, true]), |mut rows| rows.column(Planar::IDENTITY)[1] = 5.0);
        assert!(!landmarks.is_named(slot, 0) && landmarks.is_named(slot, 1));
    }

    /// All that three stores say of the same landmarks in space, as bits.
    fn said(landmarks: &mut Landmarks<3>, slots: &[u32]) -> Vec<u64> {
        let held = |slot: u32, map: usize| landmarks.held_as::<Normal<3>>(map, slot);
        let mut bits = Vec::new();
        for (slot, map) in slots.iter().flat_map(|slot| (0..4).map(move |map| (*slot, map))) {
            let numbers = held(slot, map)
                .map(|(place, count)| [place.mean, place.covariance[0], place.covariance[2], [f64::from(count); 3]]);
            bits.extend(numbers.unwrap_or_default().into_iter().flatten().map(f64::to_bits));
        }
        bits
    }

    /// Two landmarks in space, sighted from four poses, in copied maps, one of them sighted again, and then one.
    fn in_space(kind: StoreKind) -> Vec<u64> {
        let mut config = Config::default();
        (config.filter.particles, config.filter.store) = (4, kind);
        let mut landmarks = Landmarks::<3>::new(&config, Identities::None, 1.0, 3.0);
        assert_eq!(landmarks.columns(), 10);
        let mut poses = SensorPoses::default();
        poses.set(&[0.0, 0.1, 0.2, 0.3], &[0.0; 4], &[0.1, 0.2, 0.3, 0.4], Pose::default());
        let seen =
            |measured| Seen { model: &Point, poses: &poses, measured, noise: Point.noise(), tail: Tail::Gaussian };
        let (mut rows, mut slots) = (Vec::new(), Vec::new());
        for measured in [[5.0, 0.2, 1.0], [5.1, 0.3, 1.1]] {
            seen(measured).first::<3>(landmarks.columns(), &mut rows);
            slots.push(landmarks.insert(None, &rows, 0.0));
        }
        let (older, younger) = (slots[0], slots[1]);
        landmarks.resample(&[0, 1, 1, 3]);
        assert_eq!([1, 2].map(|map| landmarks.held_as::<Normal<3>>(map, older).is_some()), [true; 2]);
        let (before, _): (Normal<3>, _) = landmarks.held_as(2, older).unwrap();
        let mut log_likelihood = [0.0; 4];
        landmarks.update(older, Some(&[true, true, false, true]), |mut rows| {
            let kept = rows.as_rows().column(0).to_vec();
            assert_eq!(kept, [1.0; 4]);
            let untouched: Vec<f64> = (0..10).map(|c| rows.column(c)[2]).collect();
            assert_eq!(seen([5.2, 0.1, 0.9]).correct::<3>(&mut rows, &mut log_likelihood), 0);
            (0..10).for_each(|c| rows.column(c)[2] = untouched[c]);
        });
        // The copy of a map does not change with it.
        assert_eq!(landmarks.held_as(2, older), Some((before, 1)));
        let (after, count): (Normal<3>, _) = landmarks.held_as(1, older).unwrap();
        assert_eq!(count, 2);
        check_update(&before, &after, poses.get(1));
        let mut bits = said(&mut landmarks, &slots);
        bits.extend(log_likelihood.map(f64::to_bits));
        merge_in_space(&mut landmarks, [older, younger]);
        bits.extend(said(&mut landmarks, &slots));
        bits
    }

    /// The information form: Σ'⁻¹ = Σ⁻¹ + Gᵀ R⁻¹ G.
    fn check_update(before: &Normal<3>, after: &Normal<3>, pose: Pose) {
        let inverse = |s: &[[f64; 3]; 3]| Cholesky::of(s).unwrap().inverse();
        let g = Point.linearize(pose, before.mean).by_landmark;
        let transposed = std::array::from_fn(|a| std::array::from_fn(|b| g[b][a]));
        let added = crate::normal::congruence(&transposed, &inverse(&Point.noise()));
        let expected = inverse(&crate::normal::sum(&inverse(&before.covariance), &added));
        for (got, expected) in after.covariance.iter().flatten().zip(expected.iter().flatten()) {
            assert!((got - expected).abs() < 1e-14, "{after:?} {expected:?}");
        }
    }

    /// Makes one of two landmarks in all maps, and looks for it where it is.
    fn merge_in_space(landmarks: &mut Landmarks<3>, [older, younger]: [u32; 2]) {
        let copy = |rows: Rows<'_>| (0..10).flat_map(|c| rows.column(c).to_vec()).collect::<Vec<_>>();
        let pair = [older, younger].map(|slot| copy(landmarks.read(slot)));
        let [old, young] = [0, 1].map(|of| Rows::new(&pair[of], 4));
        let [a, b] = [old, young].map(|rows| Columns::<3>::gaussian_in::<Normal<3>>(&rows, 0).unwrap());
        landmarks.update(older, None, |mut rows| {
            (0..4).for_each(|i| Columns::<3>::fuse::<Normal<3>>(&mut rows, i, [&old, &young], false));
        });
        landmarks.remove(younger);
        assert_eq!(landmarks.live_slots(), [older]);
        let (both, count): (Normal<3>, _) = landmarks.held_as(0, older).unwrap();
        assert_eq!((both, count), (a.product(&b), 3));
        let whole: Normal<3> = Columns::<3>::mixture(&landmarks.read(older), &[0.25; 4]).unwrap();
        assert!(whole.covariance[2][2] >= both.covariance[2][2] && (whole.mean[2] - 1.0).abs() < 0.1);
        assert_eq!(landmarks.places_near(0, [both.mean[0], both.mean[1]], 0.5).len(), 1);
        assert!(landmarks.places_near(0, [-9.0, 4.0], 0.5).is_empty());
    }

    #[test]
    fn landmarks_in_space_are_kept_copied_corrected_and_merged_by_every_store() {
        let [dense, tree, lineage] = [StoreKind::Dense, StoreKind::Tree, StoreKind::Lineage].map(in_space);
        assert_eq!(dense.len(), 2 * 2 * 4 * 12 + 4);
        assert!(dense == tree && dense == lineage);
    }
}
