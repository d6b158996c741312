//! Every store against a model of independent maps, over random sequences of operations.

use super::*;
use proptest::prelude::*;
use std::collections::BTreeMap;

const COLUMNS: usize = 3;
const SLOTS: u32 = 12;

/// What each particle's map should hold: the plainest thing that could be right.
#[derive(Clone, Debug)]
struct Model {
    maps: Vec<BTreeMap<u32, [f64; COLUMNS]>>,
}

#[derive(Clone, Debug)]
enum Operation {
    Insert { slot: u32, absent: u8 },
    Remove { slot: u32 },
    Update { slot: u32, mask: Option<u8>, amount: f64, drop: bool },
    Resample { choice: Vec<u8> },
    Restore,
}

fn any_operation() -> impl Strategy<Value = Operation> {
    prop_oneof![
        3 => (0..SLOTS, any::<u8>()).prop_map(|(slot, absent)| Operation::Insert { slot, absent }),
        1 => (0..SLOTS).prop_map(|slot| Operation::Remove { slot }),
        6 => (0..SLOTS, any::<Option<u8>>(), -2.0..2.0, prop::bool::weighted(0.1))
            .prop_map(|(slot, mask, amount, drop)| Operation::Update { slot, mask, amount, drop }),
        4 => prop::collection::vec(any::<u8>(), 1..9).prop_map(|choice| Operation::Resample { choice }),
        1 => Just(Operation::Restore),
    ]
}

fn bit(mask: u8, particle: usize) -> bool {
    mask >> (particle % 8) & 1 == 1
}

/// Adds `amount` to the marked rows that are present, or makes them absent.
fn change(rows: RowsMut<'_>, mask: Option<&[bool]>, amount: f64, drop: bool) {
    let [count, first, second] = rows.columns::<COLUMNS>();
    for i in 0..count.len() {
        if count[i] != 0.0 && mask.is_none_or(|m| m[i]) {
            count[i] = if drop { 0.0 } else { count[i] + 1.0 };
            first[i] += amount;
            second[i] *= amount;
        }
    }
}

struct Population {
    model: Model,
    stores: Vec<(StoreKind, Box<dyn LandmarkStore>)>,
    saved: Option<(Model, Vec<Box<dyn LandmarkStore>>)>,
}

impl Population {
    fn new(particles: usize) -> Self {
        let kinds = [StoreKind::Dense, StoreKind::Tree];
        Self {
            model: Model { maps: vec![BTreeMap::new(); particles] },
            stores: kinds.into_iter().map(|kind| (kind, kind.create(particles, COLUMNS))).collect(),
            saved: None,
        }
    }

    fn apply(&mut self, operation: &Operation) {
        let particles = self.model.maps.len();
        match operation {
            Operation::Insert { slot, absent } => self.insert(*slot, *absent),
            Operation::Remove { slot } => {
                for map in &mut self.model.maps {
                    map.remove(slot);
                }
                self.stores.iter_mut().for_each(|(_, store)| store.remove(*slot));
            }
            Operation::Update { slot, mask, amount, drop } => {
                let mask: Option<Vec<bool>> = mask.map(|m| (0..particles).map(|i| bit(m, i)).collect());
                self.update(*slot, mask.as_deref(), *amount, *drop);
            }
            Operation::Resample { choice } => {
                let mut ancestors: Vec<u32> = choice.iter().map(|c| u32::from(*c) % particles as u32).collect();
                ancestors.sort_unstable();
                self.model.maps = ancestors.iter().map(|&a| self.model.maps[a as usize].clone()).collect();
                self.stores.iter_mut().for_each(|(_, store)| store.resample(&ancestors));
            }
            Operation::Restore => {
                if let Some((model, stores)) = &self.saved {
                    self.model = model.clone();
                    for ((_, store), saved) in self.stores.iter_mut().zip(stores) {
                        *store = saved.snapshot();
                    }
                }
                self.saved = Some((self.model.clone(), self.stores.iter().map(|(_, s)| s.snapshot()).collect()));
            }
        }
    }

    fn insert(&mut self, slot: u32, absent: u8) {
        if self.model.maps.iter().any(|map| map.contains_key(&slot)) {
            return;
        }
        let particles = self.model.maps.len();
        let mut values = vec![0.0; COLUMNS * particles];
        for (i, map) in self.model.maps.iter_mut().enumerate() {
            let row = [f64::from(!bit(absent, i)), f64::from(slot) + i as f64, 0.5];
            for (c, value) in row.into_iter().enumerate() {
                values[c * particles + i] = value;
            }
            if row[0] != 0.0 {
                map.insert(slot, row);
            }
        }
        self.stores.iter_mut().for_each(|(_, store)| store.insert(slot, &values));
    }

    fn update(&mut self, slot: u32, mask: Option<&[bool]>, amount: f64, drop: bool) {
        for (i, map) in self.model.maps.iter_mut().enumerate() {
            if let Some(row) = map.get_mut(&slot).filter(|_| mask.is_none_or(|m| m[i])) {
                *row = [row[0] + 1.0, row[1] + amount, row[2] * amount];
                if drop {
                    map.remove(&slot);
                }
            }
        }
        for (_, store) in &mut self.stores {
            store.update(slot, mask, &mut |rows| change(rows, mask, amount, drop));
        }
    }

    /// Compares every number, bit by bit; returns how many it saw.
    fn check(&mut self) -> usize {
        let mut seen = 0;
        for (kind, store) in &mut self.stores {
            assert_eq!(store.particle_count(), self.model.maps.len());
            for slot in 0..SLOTS {
                for (i, map) in self.model.maps.iter().enumerate() {
                    let expected = map.get(&slot).copied().unwrap_or_default();
                    let rows = store.read(slot);
                    let got: [f64; COLUMNS] = std::array::from_fn(|c| rows.column(c)[i]);
                    assert_eq!(got.map(f64::to_bits), expected.map(f64::to_bits), "{kind:?} slot {slot} particle {i}");
                    let mut row = [0.0; COLUMNS];
                    let present = store.read_row(slot, i, &mut row);
                    assert_eq!(present, map.contains_key(&slot), "{kind:?} slot {slot} particle {i}");
                    assert!(!present || row == expected);
                    seen += 1;
                }
            }
        }
        seen
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]
    #[test]
    fn stores_agree_after_any_sequence_of_operations(
        particles in 1_usize..8,
        operations in prop::collection::vec(any_operation(), 1..60),
    ) {
        let mut population = Population::new(particles);
        for operation in &operations {
            population.apply(operation);
        }
        prop_assert!(population.check() > 0);
    }
}
