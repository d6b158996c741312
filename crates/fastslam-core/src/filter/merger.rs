//! What merging remembers of landmarks.

use rustc_hash::{FxHashMap, FxHashSet};
use serde::{Deserialize, Serialize};

/// With fewer pairs than this none is looked for of which a landmark is gone.
const FEW_PAIRS: usize = 4096;

/// What merging remembers.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Merger {
    /// In how many scans the best particle sighted two landmarks, named by their births, the lesser one first.
    together: FxHashMap<(u64, u64), u32>,
    /// Into which landmark another one went over in some map, by their births.
    pub(super) united: FxHashMap<u64, u64>,
    /// Of the landmarks that the best particle sighted; kept for its memory.
    #[serde(skip)]
    births: Vec<u64>,
    /// Pairs from which on those are looked for of which a landmark is gone.
    #[serde(skip)]
    crowded: usize,
}

impl Merger {
    /// Landmarks of these births were sighted together in one more scan.
    pub fn note_all(&mut self, sighted: impl Iterator<Item = u64>) {
        let mut births = std::mem::take(&mut self.births);
        births.clear();
        births.extend(sighted);
        for (place, a) in births.iter().enumerate() {
            births[..place].iter().for_each(|b| self.note(*a, *b, 1));
        }
        self.births = births;
    }

    /// Whether there are so many pairs that those of landmarks that are gone should be forgotten.
    pub fn is_crowded(&self) -> bool {
        self.together.len() >= self.crowded.max(FEW_PAIRS)
    }

    /// Forgets all pairs but those of landmarks of these births, which some map holds: nobody asks for others again.
    pub fn forget_all_but(&mut self, held: &FxHashSet<u64>) {
        self.together.retain(|(a, b), _| held.contains(a) && held.contains(b));
        self.together.shrink_to_fit();
        self.crowded = 2 * self.together.len();
    }

    /// They were sighted together in so many more scans.
    pub fn note(&mut self, a: u64, b: u64, scans: u32) {
        if a != b {
            *self.together.entry((a.min(b), a.max(b))).or_default() += scans;
        }
    }

    /// Scans in which both were sighted.
    pub fn together(&self, a: u64, b: u64) -> u32 {
        self.together.get(&(a.min(b), a.max(b))).copied().unwrap_or(0)
    }

    /// The birth under which a landmark is found in a map, after all that happened to it since; its own when nowhere.
    pub fn present_name(&self, birth: u32, is_held: impl Fn(u32) -> bool) -> u32 {
        let mut name = birth;
        while !is_held(name) {
            // What went over is not held again, so that this ends.
            match self.united.get(&u64::from(name)) {
                Some(older) => name = *older as u32,
                None => return birth,
            }
        }
        name
    }

    /// What holds of landmark `from` holds of `into` from now on.
    pub fn rename(&mut self, from: u64, into: u64) {
        let partner = |(a, b): &(u64, u64)| match (*a == from, *b == from) {
            (true, _) => Some(*b),
            (_, true) => Some(*a),
            _ => None,
        };
        let partners: Vec<(u64, u32)> =
            self.together.iter().filter_map(|(pair, scans)| Some((partner(pair)?, *scans))).collect();
        self.together.retain(|pair, _| partner(pair).is_none());
        partners.into_iter().for_each(|(other, scans)| self.note(other, into, scans));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pairs_of_landmarks_that_are_gone_are_forgotten() {
        let mut merger = Merger::default();
        let kept = 30;
        for step in 0..20_000 {
            // Thirty that stay, of which ten are seen, and a false one.
            let sighted = (0..10).map(|k| (step + k) % kept).chain([kept + step]);
            merger.note_all(sighted);
            if merger.is_crowded() {
                merger.forget_all_but(&(0..kept).chain([kept + step]).collect());
            }
            assert!(merger.together.len() <= FEW_PAIRS + 10, "{step}: {} pairs", merger.together.len());
        }
        assert!(merger.together(0, 9) > 600 && merger.together(kept + 5, 5) == 0);
    }

    #[test]
    fn what_was_seen_together_stays_so_under_another_name() {
        let mut merger = Merger::default();
        merger.note(7, 2, 3);
        merger.note(7, 9, 1);
        merger.note(4, 2, 1);
        merger.rename(7, 4);
        merger.united.extend([(9, 7), (7, 4)]);
        assert_eq!([merger.present_name(9, |b| b == 4), merger.present_name(9, |b| b == 9)], [4, 9]);
        assert_eq!(merger.present_name(9, |_| false), 9);
        assert_eq!([merger.together(4, 2), merger.together(9, 4), merger.together(7, 2)], [4, 1, 0]);
    }
}
