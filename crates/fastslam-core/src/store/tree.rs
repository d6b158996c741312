//! The paper's store: a persistent balanced binary tree of landmarks per particle.
//!
//! All trees live in one arena and share subtrees; a reference count per node says by how many parents it is held.
//! Resampling copies roots. Changing a landmark copies the nodes on its path that are shared and reuses the others in
//! place. **Source:** `montemerlo2002fastslam`, section 3.3 and figure 2.

use super::{LandmarkStore, Rows, RowsMut, StoreRef, StoreUsage};
use rustc_hash::FxHashMap;
use serde::{Deserialize, Serialize};

/// "No node": an empty subtree.
const NONE: u32 = u32::MAX;

/// Persistent binary trees with path copying: O(M log K) per update, O(M) per resampling.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct TreeStore {
    columns: usize,
    /// Root of each particle's tree.
    roots: Vec<u32>,
    /// Levels of inner nodes above the leaves; a tree has room for 2^height landmarks.
    height: u32,
    inner: Arena<[u32; 2]>,
    leaf: Arena<()>,
    /// Numbers of leaf i at `i * columns`.
    leaf_values: Vec<f64>,
    /// Rows of the landmark that is being read or updated, in particle order.
    scratch: Vec<f64>,
}

/// Nodes with reference counts and a list of free ones.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Arena<T> {
    nodes: Vec<T>,
    references: Vec<u32>,
    free: Vec<u32>,
}

impl<T> Arena<T> {
    fn new() -> Self {
        Self { nodes: Vec::new(), references: Vec::new(), free: Vec::new() }
    }

    /// A node held once.
    fn allocate(&mut self, node: T) -> u32 {
        if let Some(index) = self.free.pop() {
            self.nodes[index as usize] = node;
            self.references[index as usize] = 1;
            index
        } else {
            self.nodes.push(node);
            self.references.push(1);
            (self.nodes.len() - 1) as u32
        }
    }

    /// One holder less; true when it was the last.
    fn release(&mut self, index: u32) -> bool {
        let references = &mut self.references[index as usize];
        *references -= 1;
        if *references == 0 {
            self.free.push(index);
        }
        *references == 0
    }

    fn live(&self) -> usize {
        self.nodes.len() - self.free.len()
    }
}

impl TreeStore {
    /// An empty store for `particles` maps with `columns` numbers per landmark.
    pub fn new(particles: usize, columns: usize) -> Self {
        Self {
            columns,
            roots: vec![NONE; particles],
            height: 0,
            inner: Arena::new(),
            leaf: Arena::new(),
            leaf_values: Vec::new(),
            scratch: vec![0.0; particles * columns],
        }
    }

    /// Adds roots above the present ones until `slot` has a place.
    fn grow_for(&mut self, slot: u32) {
        while u64::from(slot) >= 1 << self.height {
            let height = self.height;
            self.replant([height, height + 1], |store, root| {
                if root == NONE {
                    return NONE;
                }
                store.hold(root, height);
                store.inner.allocate([root, NONE])
            });
            self.height += 1;
        }
    }

    /// Gives the particles of one tree one new tree, held once, which `make` makes of it. The levels are the heights of
    /// the old and the new trees.
    fn replant(&mut self, [before, after]: [u32; 2], make: impl Fn(&mut Self, u32) -> u32) {
        let (old, mut trees) = (self.roots.clone(), FxHashMap::default());
        for (particle, root) in old.iter().enumerate() {
            let tree = match trees.get(root) {
                Some(&tree) => {
                    self.hold(tree, after);
                    tree
                }
                None => make(self, *root),
            };
            trees.insert(*root, tree);
            self.roots[particle] = tree;
        }
        old.into_iter().for_each(|root| self.release(root, before));
    }

    /// Leaf of a slot under a root.
    fn find(&self, root: u32, slot: u32) -> u32 {
        if u64::from(slot) >= 1 << self.height {
            return NONE;
        }
        let mut node = root;
        for level in (0..self.height).rev() {
            if node == NONE {
                return NONE;
            }
            node = self.inner.nodes[node as usize][(slot >> level & 1) as usize];
        }
        node
    }

    /// One holder more of a subtree whose root stands `level` levels above the leaves.
    fn hold(&mut self, node: u32, level: u32) {
        if node != NONE {
            let references = if level == 0 { &mut self.leaf.references } else { &mut self.inner.references };
            references[node as usize] += 1;
        }
    }

    /// One holder less; what nobody holds any more is freed.
    fn release(&mut self, node: u32, level: u32) {
        if node == NONE {
            return;
        }
        if level == 0 {
            self.leaf.release(node);
        } else if self.inner.release(node) {
            for child in self.inner.nodes[node as usize] {
                self.release(child, level - 1);
            }
        }
    }

    /// The node itself if it has one holder, else a copy that takes over one of the holds; a new node for none.
    fn unshare(&mut self, node: u32, level: u32) -> u32 {
        let references = if level == 0 { &mut self.leaf.references } else { &mut self.inner.references };
        if node != NONE {
            if references[node as usize] == 1 {
                return node;
            }
            references[node as usize] -= 1;
        }
        if level == 0 {
            return self.copy_leaf(node);
        }
        let children = if node == NONE { [NONE, NONE] } else { self.inner.nodes[node as usize] };
        for child in children {
            self.hold(child, level - 1);
        }
        self.inner.allocate(children)
    }

    fn copy_leaf(&mut self, source: u32) -> u32 {
        let leaf = self.leaf.allocate(());
        let (from, to) = (source as usize * self.columns, leaf as usize * self.columns);
        self.leaf_values.resize(self.leaf.nodes.len() * self.columns, 0.0);
        if source != NONE {
            self.leaf_values.copy_within(from..from + self.columns, to);
        }
        leaf
    }

    /// Replaces the leaf of a slot in one particle's tree by what `replace` makes of it, copying shared nodes on
    /// its path.
    fn replace_leaf(&mut self, particle: usize, slot: u32, replace: impl FnOnce(&mut Self, u32) -> u32) {
        if self.height == 0 {
            self.roots[particle] = replace(self, self.roots[particle]);
            return;
        }
        let mut node = self.unshare(self.roots[particle], self.height);
        self.roots[particle] = node;
        for level in (1..self.height).rev() {
            let side = (slot >> level & 1) as usize;
            let child = self.unshare(self.inner.nodes[node as usize][side], level);
            self.inner.nodes[node as usize][side] = child;
            node = child;
        }
        let side = (slot & 1) as usize;
        let leaf = replace(self, self.inner.nodes[node as usize][side]);
        self.inner.nodes[node as usize][side] = leaf;
    }

    /// A tree like this one, held once, with a leaf in a slot; the rest of it is shared.
    fn with_leaf(&mut self, node: u32, level: u32, slot: u32, leaf: u32) -> u32 {
        let Some(below) = level.checked_sub(1) else {
            self.hold(leaf, 0);
            return leaf;
        };
        let mut children = if node == NONE { [NONE, NONE] } else { self.inner.nodes[node as usize] };
        let side = (slot >> below & 1) as usize;
        children[side] = self.with_leaf(children[side], below, slot, leaf);
        self.hold(children[1 - side], below);
        self.inner.allocate(children)
    }

    /// Writes one particle's row from `values` (columns one after the other); absent rows get no leaf.
    fn write_row(&mut self, particle: usize, slot: u32, values: &[f64]) {
        let rows = self.roots.len();
        if values[particle] == 0.0 {
            if self.find(self.roots[particle], slot) != NONE {
                self.replace_leaf(particle, slot, |store, leaf| {
                    store.release(leaf, 0);
                    NONE
                });
            }
            return;
        }
        self.replace_leaf(particle, slot, |store, leaf| {
            let leaf = store.unshare(leaf, 0);
            let row = &mut store.leaf_values[leaf as usize * store.columns..][..store.columns];
            for (c, value) in row.iter_mut().enumerate() {
                *value = values[c * rows + particle];
            }
            leaf
        });
    }

    /// Fills `scratch` with the rows of a landmark.
    fn gather(&mut self, slot: u32) {
        let rows = self.roots.len();
        for (particle, &root) in self.roots.iter().enumerate() {
            let leaf = self.find(root, slot);
            for c in 0..self.columns {
                self.scratch[c * rows + particle] =
                    if leaf == NONE { 0.0 } else { self.leaf_values[leaf as usize * self.columns + c] };
            }
        }
    }
}

impl LandmarkStore for TreeStore {
    fn particle_count(&self) -> usize {
        self.roots.len()
    }

    fn insert(&mut self, slot: u32, values: &[f64]) {
        self.grow_for(slot);
        for particle in 0..self.roots.len() {
            self.write_row(particle, slot, values);
        }
    }

    /// One leaf for all; particles of one tree have one tree afterwards too.
    fn insert_shared(&mut self, slot: u32, row: &[f64]) {
        self.remove(slot);
        if row[0] == 0.0 {
            return;
        }
        self.grow_for(slot);
        let leaf = self.copy_leaf(NONE);
        self.leaf_values[leaf as usize * self.columns..][..self.columns].copy_from_slice(row);
        let height = self.height;
        self.replant([height, height], |store, root| store.with_leaf(root, height, slot, leaf));
        self.leaf.release(leaf);
    }

    fn remove(&mut self, slot: u32) {
        let absent = vec![0.0; self.roots.len()];
        for particle in 0..self.roots.len() {
            self.write_row(particle, slot, &absent);
        }
    }

    fn read(&mut self, slot: u32) -> Rows<'_> {
        self.gather(slot);
        Rows::new(&self.scratch, self.roots.len())
    }

    fn read_row(&self, slot: u32, particle: usize, out: &mut [f64]) -> bool {
        let leaf = self.find(self.roots[particle], slot);
        if leaf != NONE {
            out.copy_from_slice(&self.leaf_values[leaf as usize * self.columns..][..self.columns]);
        }
        leaf != NONE
    }

    fn holders(&mut self, slot: u32) -> usize {
        self.roots.iter().filter(|&&root| self.find(root, slot) != NONE).count()
    }

    fn update(&mut self, slot: u32, changed: Option<&[bool]>, change: &mut dyn FnMut(RowsMut<'_>)) {
        self.grow_for(slot);
        self.gather(slot);
        let mut values = std::mem::take(&mut self.scratch);
        let rows = self.roots.len();
        change(RowsMut::new(&mut values, rows));
        for particle in 0..rows {
            // A row that was and stays absent needs no path.
            if changed.is_none_or(|mask| mask[particle]) {
                self.write_row(particle, slot, &values);
            }
        }
        self.scratch = values;
    }

    fn resample(&mut self, ancestor_indices: &[u32]) {
        let old = std::mem::take(&mut self.roots);
        self.roots.extend(ancestor_indices.iter().map(|&a| old[a as usize]));
        for &root in &self.roots.clone() {
            self.hold(root, self.height);
        }
        for root in old {
            self.release(root, self.height);
        }
        self.scratch.resize(self.roots.len() * self.columns, 0.0);
    }

    fn usage(&self) -> StoreUsage {
        let bytes = self.inner.nodes.capacity() * size_of::<[u32; 2]>()
            + (self.inner.references.capacity() + self.leaf.references.capacity()) * size_of::<u32>()
            + (self.inner.free.capacity() + self.leaf.free.capacity() + self.roots.capacity()) * size_of::<u32>()
            + self.leaf_values.capacity() * size_of::<f64>();
        StoreUsage { rows: self.leaf.live(), bytes }
    }

    fn kind(&self) -> StoreRef<'_> {
        StoreRef::Tree(self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn store_with(landmarks: u32, particles: usize) -> TreeStore {
        let mut store = TreeStore::new(particles, 2);
        for slot in 0..landmarks {
            let values: Vec<f64> = (0..2 * particles).map(|i| f64::from(slot) + i as f64 + 1.0).collect();
            store.insert(slot, &values);
        }
        store
    }

    #[test]
    fn resampling_shares_and_updating_copies_one_path() {
        let mut store = store_with(1024, 2);
        store.resample(&[0, 0]);
        let (inner, leaves) = (store.inner.live(), store.leaf.live());
        assert_eq!((inner, leaves), (1023, 1024), "one whole tree is left");
        store.update(77, Some(&[false, true]), &mut |mut rows| rows.column(1)[1] = -5.0);
        assert_eq!((store.inner.live() - inner, store.leaf.live() - leaves), (10, 1), "ten inner nodes and a leaf");
        store.update(77, Some(&[false, true]), &mut |mut rows| rows.column(1)[1] = -6.0);
        assert_eq!(store.inner.live() - inner, 10, "a path of one's own is updated in place");
        assert_eq!(store.read(77).column(1), &[80.0, -6.0]);
    }

    #[test]
    fn a_given_landmark_is_one_leaf_in_one_tree_until_a_map_changes_it() {
        let mut store = TreeStore::new(50, 2);
        (0..64).for_each(|slot| store.insert_shared(slot, &[1.0, f64::from(slot)]));
        assert_eq!((store.inner.live(), store.leaf.live()), (63, 64), "one whole tree");
        store
            .update(9, Some(&std::array::from_fn::<bool, 50, _>(|i| i == 3)), &mut |mut rows| rows.column(1)[3] = -1.0);
        assert_eq!((store.inner.live(), store.leaf.live()), (63 + 6, 64 + 1), "six inner nodes and a leaf of its own");
        store.insert_shared(9, &[2.0, 7.0]);
        assert_eq!(store.read(9).column(1), &[7.0; 50]);
        (0..64).for_each(|slot| store.remove(slot));
        assert_eq!(store.leaf.live(), 0);
    }

    #[test]
    fn nothing_is_left_when_everything_was_removed() {
        let mut store = store_with(37, 5);
        store.resample(&[4, 4, 1, 0, 0, 0]);
        for slot in 0..37 {
            store.remove(slot);
        }
        assert_eq!(store.leaf.live(), 0);
        store.resample(&[]);
        assert_eq!(store.inner.live(), 0);
    }
}
