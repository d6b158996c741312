//! Every store against a model of independent maps, over random sequences of operations.

use super::*;
use proptest::prelude::*;
use std::collections::BTreeMap;

const COLUMNS: usize = 3;

/// What each particle's map should hold: the plainest thing that could be right.
#[derive(Clone, Debug)]
struct Model {
    slots: u32,
    maps: Vec<BTreeMap<u32, [f64; COLUMNS]>>,
}

#[derive(Clone, Debug)]
enum Operation {
    Insert { slot: u32, absent: u8 },
    Adopt { slot: u32, row: [f64; COLUMNS] },
    Remove { slot: u32 },
    Read { slot: u32 },
    Update { slot: u32, mask: Option<u8>, amount: f64, kind: Change },
    Resample { choice: Vec<u8>, sorted: bool },
    Restore,
}

/// What an update does with the rows that it marks.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Change {
    /// Alters those that are present.
    Alter,
    /// Makes those that are present absent.
    Drop,
    /// Alters those that are present and gives the others a landmark.
    Fill,
}

fn any_operation(slots: u32, particles: std::ops::Range<usize>) -> impl Strategy<Value = Operation> {
    let kind = prop_oneof![8 => Just(Change::Alter), 1 => Just(Change::Drop), 1 => Just(Change::Fill)];
    prop_oneof![
        3 => (0..slots, any::<u8>()).prop_map(|(slot, absent)| Operation::Insert { slot, absent }),
        2 => (0..slots, prop_oneof![9 => Just(1.0), 1 => Just(0.0)], -2.0..2.0)
            .prop_map(|(slot, count, at)| Operation::Adopt { slot, row: [count, at, 0.25] }),
        1 => (0..slots).prop_map(|slot| Operation::Remove { slot }),
        2 => (0..slots).prop_map(|slot| Operation::Read { slot }),
        6 => (0..slots, any::<Option<u8>>(), -2.0..2.0, kind)
            .prop_map(|(slot, mask, amount, kind)| Operation::Update { slot, mask, amount, kind }),
        4 => (prop::collection::vec(any::<u8>(), particles), prop::bool::weighted(0.8))
            .prop_map(|(choice, sorted)| Operation::Resample { choice, sorted }),
        1 => Just(Operation::Restore),
    ]
}

fn bit(mask: u8, particle: usize) -> bool {
    mask >> (particle % 8) & 1 == 1
}

/// What one row becomes.
fn changed(row: [f64; COLUMNS], amount: f64, kind: Change) -> [f64; COLUMNS] {
    match (row[0] == 0.0, kind) {
        (true, Change::Fill) => [1.0, amount, 0.25],
        (true, _) => row,
        // The stores must make the other numbers of an absent row zero.
        (false, Change::Drop) => [0.0, row[1] + amount, row[2]],
        (false, _) => [row[0] + 1.0, row[1] + amount, row[2] * amount],
    }
}

fn change(rows: RowsMut<'_>, mask: Option<&[bool]>, amount: f64, kind: Change) {
    let columns = rows.columns::<COLUMNS>();
    for i in (0..columns[0].len()).filter(|&i| mask.is_none_or(|m| m[i])) {
        let row = changed(std::array::from_fn(|c| columns[c][i]), amount, kind);
        (0..COLUMNS).for_each(|c| columns[c][i] = row[c]);
    }
}

struct Population {
    model: Model,
    stores: Vec<(StoreKind, Box<dyn LandmarkStore>)>,
    saved: Option<(Model, Vec<Box<dyn LandmarkStore>>)>,
}

impl Population {
    fn new(particles: usize, slots: u32) -> Self {
        let kinds = [StoreKind::Dense, StoreKind::Tree, StoreKind::Lineage];
        Self {
            model: Model { slots, maps: vec![BTreeMap::new(); particles] },
            stores: kinds.into_iter().map(|kind| (kind, kind.create(particles, COLUMNS))).collect(),
            saved: None,
        }
    }

    fn apply(&mut self, operation: &Operation) {
        let particles = self.model.maps.len();
        match operation {
            Operation::Insert { slot, absent } => self.insert(*slot, *absent),
            Operation::Adopt { slot, row } => {
                for map in &mut self.model.maps {
                    map.remove(slot);
                    (row[0] != 0.0).then(|| map.insert(*slot, *row));
                }
                self.stores.iter_mut().for_each(|(_, store)| store.insert_shared(*slot, row));
            }
            Operation::Remove { slot } => {
                for map in &mut self.model.maps {
                    map.remove(slot);
                }
                self.stores.iter_mut().for_each(|(_, store)| store.remove(*slot));
            }
            Operation::Read { slot } => assert_eq!(self.check_slot(*slot), particles * self.stores.len()),
            Operation::Update { slot, mask, amount, kind } => {
                let mask: Option<Vec<bool>> = mask.map(|m| (0..particles).map(|i| bit(m, i)).collect());
                self.update(*slot, mask.as_deref(), *amount, *kind);
            }
            Operation::Resample { choice, sorted } => {
                let mut ancestors: Vec<u32> = choice.iter().map(|c| u32::from(*c) % particles as u32).collect();
                if *sorted {
                    ancestors.sort_unstable();
                }
                self.model.maps = ancestors.iter().map(|&a| self.model.maps[a as usize].clone()).collect();
                self.stores.iter_mut().for_each(|(_, store)| store.resample(&ancestors));
            }
            Operation::Restore => {
                if let Some((model, stores)) = &self.saved {
                    self.model = model.clone();
                    for ((_, store), saved) in self.stores.iter_mut().zip(stores) {
                        *store = saved.clone();
                    }
                }
                self.saved = Some((self.model.clone(), self.stores.iter().map(|(_, s)| s.clone()).collect()));
            }
        }
    }

    fn insert(&mut self, slot: u32, absent: u8) {
        let particles = self.model.maps.len();
        let mut values = vec![0.0; COLUMNS * particles];
        for (i, map) in self.model.maps.iter_mut().enumerate() {
            let row = [f64::from(!bit(absent, i)), f64::from(slot) + i as f64, 0.5];
            for (c, value) in row.into_iter().enumerate() {
                values[c * particles + i] = value;
            }
            if row[0] == 0.0 {
                map.remove(&slot);
            } else {
                map.insert(slot, row);
            }
        }
        self.stores.iter_mut().for_each(|(_, store)| store.insert(slot, &values));
    }

    fn update(&mut self, slot: u32, mask: Option<&[bool]>, amount: f64, kind: Change) {
        for (i, map) in self.model.maps.iter_mut().enumerate() {
            if mask.is_none_or(|m| m[i]) {
                let row = changed(map.get(&slot).copied().unwrap_or_default(), amount, kind);
                if row[0] == 0.0 {
                    map.remove(&slot);
                } else {
                    map.insert(slot, row);
                }
            }
        }
        for (_, store) in &mut self.stores {
            store.update(slot, mask, &mut |rows| change(rows, mask, amount, kind));
        }
    }

    /// Compares every number, bit by bit; returns how many rows it saw.
    fn check(&mut self) -> usize {
        (0..self.model.slots).map(|slot| self.check_slot(slot)).sum()
    }

    fn check_slot(&mut self, slot: u32) -> usize {
        let mut seen = 0;
        for (kind, store) in &mut self.stores {
            assert_eq!(store.particle_count(), self.model.maps.len());
            let holders = self.model.maps.iter().filter(|map| map.contains_key(&slot)).count();
            assert_eq!(store.holders(slot), holders, "{kind:?} slot {slot}");
            for (i, map) in self.model.maps.iter().enumerate() {
                let expected = map.get(&slot).copied().unwrap_or_default();
                // Before `read`, which may leave behind what the second look at the same row finds.
                let mut row = [0.0; COLUMNS];
                let present = store.read_row(slot, i, &mut row);
                assert_eq!(present, map.contains_key(&slot), "{kind:?} slot {slot} particle {i}");
                assert!(!present || row == expected, "{kind:?} slot {slot} particle {i}: {row:?}, not {expected:?}");
                let rows = store.read(slot);
                let got: [f64; COLUMNS] = std::array::from_fn(|c| rows.column(c)[i]);
                assert_eq!(got.map(f64::to_bits), expected.map(f64::to_bits), "{kind:?} slot {slot} particle {i}");
                seen += 1;
            }
        }
        seen
    }
}

/// Rows and bytes of `slots` landmarks that are one row each, or one of every particle.
fn usages(kind: StoreKind, particles: usize, slots: u32) -> [(Box<dyn LandmarkStore>, StoreUsage); 2] {
    [true, false].map(|shared| {
        let mut store = kind.create(particles, COLUMNS);
        for slot in 0..slots {
            let row = [1.0, f64::from(slot), 0.5];
            if shared {
                store.insert_shared(slot, &row);
            } else {
                store.insert(slot, &row.map(|value| vec![value; particles]).concat());
            }
        }
        let usage = store.usage();
        (store, usage)
    })
}

#[test]
fn a_given_landmark_is_one_row_in_every_store_and_is_copied_when_it_is_changed() {
    let (particles, slots) = (100, 300);
    for kind in [StoreKind::Dense, StoreKind::Tree, StoreKind::Lineage] {
        let [(mut shared, one), (_, each)] = usages(kind, particles, slots);
        assert_eq!((one.rows, each.rows), (slots as usize, slots as usize * particles), "{kind:?}");
        // A row is 24 bytes; what is needed to find one, and room to grow, are less than ten times as much.
        assert!(one.bytes < 10 * 24 * slots as usize && each.bytes >= 24 * each.rows, "{kind:?}: {one:?} {each:?}");
        // Neither reading nor resampling makes rows of it.
        let ancestors: Vec<u32> = (0..particles as u32).map(|i| i / 3).collect();
        shared.resample(&ancestors);
        assert!((0..slots).all(|slot| shared.read(slot).column(1) == vec![f64::from(slot); particles]));
        assert!((0..slots).all(|slot| shared.holders(slot) == particles));
        assert_eq!(shared.usage().rows, slots as usize, "{kind:?}");
        // A change in one map costs a row where maps are apart, and a row for every particle where they lie side by side.
        let mask: Vec<bool> = (0..particles).map(|i| i == 7).collect();
        shared.update(5, Some(&mask), &mut |mut rows| rows.column(1)[7] = -1.0);
        let more = if kind == StoreKind::Tree { 1 } else { particles - 1 };
        assert_eq!(shared.usage().rows, slots as usize + more, "{kind:?}");
        let expected: Vec<f64> = (0..particles).map(|i| if i == 7 { -1.0 } else { 5.0 }).collect();
        assert_eq!(shared.read(5).column(1), expected);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]
    #[test]
    fn stores_agree_after_any_sequence_of_operations(
        particles in 1_usize..8,
        operations in prop::collection::vec(any_operation(12, 1..9), 1..60),
    ) {
        let mut population = Population::new(particles, 12);
        for operation in &operations {
            population.apply(operation);
        }
        prop_assert!(population.check() > 0);
    }
}

proptest! {
    #![proptest_config(ProptestConfig { max_shrink_iters: 2_000, ..ProptestConfig::with_cases(12) })]
    #[test]
    fn stores_agree_over_long_runs_with_many_particles(
        particles in 16_usize..65,
        operations in prop::collection::vec(any_operation(90, 16..65), 1_500..3_000),
    ) {
        let mut population = Population::new(particles, 90);
        for operation in &operations {
            population.apply(operation);
        }
        prop_assert!(population.check() > 0);
    }
}
