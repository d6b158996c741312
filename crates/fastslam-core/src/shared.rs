//! A list that copies share until one of them changes its part.

use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::ops::{Index, IndexMut};
use std::sync::Arc;

/// Entries that are copied together when one of them changes: tens of kilobytes.
const CHUNK: usize = 4096;

/// A list in chunks. A copy takes as long as there are chunks; who changes an entry of a chunk that others have too
/// copies that chunk.
///
/// **Why:** a path grows for as long as a robot drives, and a draw beside the filter needs all of it at once.
#[derive(Clone, Debug)]
pub(crate) struct Shared<T> {
    /// All are full but the last; none is empty.
    chunks: Vec<Arc<Vec<T>>>,
}

impl<T> Default for Shared<T> {
    fn default() -> Self {
        Self { chunks: Vec::new() }
    }
}

impl<T> Shared<T> {
    /// Number of entries.
    pub fn len(&self) -> usize {
        self.chunks.last().map_or(0, |last| (self.chunks.len() - 1) * CHUNK + last.len())
    }

    /// The entry at a place; `None` behind the last one.
    pub fn get(&self, place: usize) -> Option<&T> {
        self.chunks.get(place / CHUNK)?.get(place % CHUNK)
    }

    /// Forgets all.
    pub fn clear(&mut self) {
        self.chunks.clear();
    }
}

impl<T: Clone> Shared<T> {
    /// Adds an entry.
    pub fn push(&mut self, entry: T) {
        match self.chunks.last_mut() {
            Some(last) if last.len() < CHUNK => Arc::make_mut(last).push(entry),
            // The first one grows as it must: most lists are short.
            None => self.chunks.push(Arc::new(vec![entry])),
            Some(_) => {
                let mut chunk = Vec::with_capacity(CHUNK);
                chunk.push(entry);
                self.chunks.push(Arc::new(chunk));
            }
        }
    }

    /// Adds copies of an entry until there are so many; none where there are more.
    pub fn fill_to(&mut self, count: usize, entry: &T) {
        while let Some(missing) = count.checked_sub(self.len() + 1) {
            self.push(entry.clone());
            if let Some(last) = self.chunks.last_mut() {
                let full = CHUNK.min(last.len() + missing);
                Arc::make_mut(last).resize(full, entry.clone());
            }
        }
    }

    /// Changes the entries at these places, one after another; `change` gets the number of each place among them.
    ///
    /// **Why not one by one:** whether others have a chunk is asked once for each run of places in it.
    pub fn change(&mut self, places: impl IntoIterator<Item = u32>, mut change: impl FnMut(usize, &mut T)) {
        let mut places = places.into_iter().map(|place| place as usize).enumerate().peekable();
        while let Some(&(_, first)) = places.peek() {
            let number = first / CHUNK;
            let chunk = Arc::make_mut(&mut self.chunks[number]).as_mut_slice();
            while let Some((k, place)) = places.next_if(|(_, place)| place / CHUNK == number) {
                change(k, &mut chunk[place % CHUNK]);
            }
        }
    }

    /// How many of the chunks no other list has.
    #[cfg(test)]
    pub fn own_chunks(&self) -> usize {
        self.chunks.iter().filter(|chunk| Arc::strong_count(chunk) == 1).count()
    }
}

impl<T> Index<usize> for Shared<T> {
    type Output = T;

    fn index(&self, place: usize) -> &T {
        &self.chunks[place / CHUNK][place % CHUNK]
    }
}

impl<T: Clone> IndexMut<usize> for Shared<T> {
    fn index_mut(&mut self, place: usize) -> &mut T {
        &mut Arc::make_mut(&mut self.chunks[place / CHUNK])[place % CHUNK]
    }
}

impl<T> FromIterator<T> for Shared<T> {
    fn from_iter<I: IntoIterator<Item = T>>(entries: I) -> Self {
        let mut entries = entries.into_iter();
        let next_chunk = || {
            let chunk: Vec<T> = entries.by_ref().take(CHUNK).collect();
            (!chunk.is_empty()).then(|| Arc::new(chunk))
        };
        Self { chunks: std::iter::from_fn(next_chunk).collect() }
    }
}

/// As a list of entries, whatever the chunks.
impl<T: Serialize> Serialize for Shared<T> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        use serde::ser::SerializeSeq;
        let mut list = serializer.serialize_seq(Some(self.len()))?;
        self.chunks.iter().flat_map(|chunk| chunk.iter()).try_for_each(|entry| list.serialize_element(entry))?;
        list.end()
    }
}

impl<'de, T: Deserialize<'de>> Deserialize<'de> for Shared<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Vec::deserialize(deserializer).map(|entries: Vec<T>| entries.into_iter().collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_a_list() {
        let mut shared = Shared::default();
        assert_eq!((shared.len(), shared.get(0)), (0, None));
        for k in 0..2 * CHUNK + 3 {
            shared.push(k);
        }
        shared[CHUNK] = 7;
        let expected: Vec<usize> = (0..2 * CHUNK + 3).map(|k| if k == CHUNK { 7 } else { k }).collect();
        assert_eq!(shared.len(), expected.len());
        assert!((0..expected.len()).all(|k| shared[k] == expected[k] && shared.get(k) == Some(&expected[k])));
        assert_eq!((shared.get(expected.len()), shared.get(u32::MAX as usize)), (None, None));
        shared.fill_to(3 * CHUNK, &9);
        shared.fill_to(5, &1);
        assert_eq!((shared.len(), shared[3 * CHUNK - 1], shared[2]), (3 * CHUNK, 9, 2));
        shared.fill_to(5 * CHUNK + 1, &8);
        assert_eq!((shared.len(), shared[3 * CHUNK - 1], shared[3 * CHUNK]), (5 * CHUNK + 1, 9, 8));
        let places = [0, 1, CHUNK as u32, 2, 1];
        shared.change(places, |k, entry| *entry = 10 * *entry + k);
        assert_eq!((shared[0], shared[1], shared[CHUNK], shared[2]), (0, 114, 72, 23));
        shared.clear();
        assert_eq!(shared.len(), 0);
    }

    #[test]
    fn a_copy_shares_what_neither_changes() {
        let mut ours: Shared<usize> = (0..4 * CHUNK).collect();
        let theirs = ours.clone();
        assert_eq!((ours.own_chunks(), theirs.own_chunks()), (0, 0));
        ours[CHUNK + 5] = 0;
        ours.push(1);
        assert_eq!(
            (theirs[CHUNK + 5], theirs.len(), ours[CHUNK + 5], ours.len()),
            (CHUNK + 5, 4 * CHUNK, 0, 4 * CHUNK + 1)
        );
        // What changed, and what is new.
        assert_eq!((ours.own_chunks(), theirs.own_chunks()), (2, 1));
    }

    #[test]
    fn it_is_kept_as_a_list() {
        let entries: Vec<u32> = (0..CHUNK as u32 + 9).collect();
        let shared: Shared<u32> = entries.iter().copied().collect();
        let kept = serde_json::to_string(&shared).unwrap();
        assert_eq!(kept, serde_json::to_string(&entries).unwrap());
        let again: Shared<u32> = serde_json::from_str(&kept).unwrap();
        assert!(again.len() == entries.len() && entries.iter().all(|k| again[*k as usize] == *k));
    }
}
