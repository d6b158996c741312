//! The posterior over paths: an ancestry forest of poses, pruned to the survivors.
//!
//! **Source:** `jacob2015path`: with pruning the expected size is T + O(M log M) nodes.

use crate::geometry::Pose;

const NONE: u32 = u32::MAX;

#[derive(Clone, Copy, Debug)]
struct Node {
    pose: Pose,
    step: u32,
    parent: u32,
    /// Children, plus one while a particle stands on the node.
    holders: u32,
}

/// Paths of all particles as a forest that shares common pasts.
#[derive(Clone, Debug, Default)]
pub struct PathForest {
    nodes: Vec<Node>,
    free: Vec<u32>,
    /// Node of each particle's latest pose.
    tips: Vec<u32>,
    stamps_s: Vec<f64>,
}

impl PathForest {
    /// An empty forest for `particles` paths.
    pub fn new(particles: usize) -> Self {
        Self { tips: vec![NONE; particles], ..Self::default() }
    }

    /// Appends one pose to each particle's path.
    pub fn extend(&mut self, stamp_s: f64, pose_of: impl Fn(usize) -> Pose) {
        let step = self.stamps_s.len() as u32;
        self.stamps_s.push(stamp_s);
        for particle in 0..self.tips.len() {
            // The particle moves from the old tip to the new node, which holds the old tip in its stead.
            let node = Node { pose: pose_of(particle), step, parent: self.tips[particle], holders: 1 };
            self.tips[particle] = match self.free.pop() {
                Some(index) => {
                    self.nodes[index as usize] = node;
                    index
                }
                None => {
                    self.nodes.push(node);
                    (self.nodes.len() - 1) as u32
                }
            };
        }
    }

    /// Path i becomes a copy of the former path `ancestor_indices[i]`; paths without a descendant are forgotten.
    pub fn resample(&mut self, ancestor_indices: &[u32]) {
        let old = std::mem::take(&mut self.tips);
        self.tips.extend(ancestor_indices.iter().map(|&a| old[a as usize]));
        for &tip in self.tips.iter().filter(|tip| **tip != NONE) {
            self.nodes[tip as usize].holders += 1;
        }
        for tip in old {
            self.release(tip);
        }
    }

    /// All paths become one, `poses`, but for the last pose, which `last` gives for each particle.
    ///
    /// `poses` has one pose for every [`PathForest::extend`] so far, the last included.
    pub fn replace(&mut self, poses: &[Pose], last: impl Fn(usize) -> Pose) {
        self.nodes.clear();
        self.free.clear();
        let Some(trunk) = poses.len().checked_sub(1) else { return };
        for (step, &pose) in poses[..trunk].iter().enumerate() {
            let parent = step.checked_sub(1).map_or(NONE, |parent| parent as u32);
            self.nodes.push(Node { pose, step: step as u32, parent, holders: 1 });
        }
        let parent = trunk.checked_sub(1).map_or(NONE, |parent| parent as u32);
        if parent != NONE {
            self.nodes[parent as usize].holders = self.tips.len() as u32;
        }
        for (particle, tip) in self.tips.iter_mut().enumerate() {
            *tip = self.nodes.len() as u32;
            self.nodes.push(Node { pose: last(particle), step: trunk as u32, parent, holders: 1 });
        }
    }

    fn release(&mut self, mut index: u32) {
        while index != NONE {
            let node = &mut self.nodes[index as usize];
            node.holders -= 1;
            if node.holders > 0 {
                return;
            }
            self.free.push(index);
            index = node.parent;
        }
    }

    /// The path of one particle: stamps in seconds and poses `T_world_robot`, oldest first.
    pub fn path(&self, particle: usize) -> Vec<(f64, Pose)> {
        let mut path = Vec::new();
        let mut index = self.tips[particle];
        while index != NONE {
            let node = self.nodes[index as usize];
            path.push((self.stamps_s[node.step as usize], node.pose));
            index = node.parent;
        }
        path.reverse();
        path
    }

    /// Poses that are held.
    pub fn live_nodes(&self) -> usize {
        self.nodes.len() - self.free.len()
    }

    /// Distinct poses of the surviving paths `steps` steps ago (1 when they have coalesced, 0 before the start).
    pub fn distinct_ancestors(&self, steps: usize) -> usize {
        let Some(step) = self.stamps_s.len().checked_sub(steps + 1) else { return 0 };
        let mut front: Vec<u32> = self.tips.iter().copied().filter(|tip| *tip != NONE).collect();
        loop {
            front.sort_unstable();
            front.dedup();
            let newest = front.iter().map(|i| self.nodes[*i as usize].step).max();
            if front.is_empty() || newest.is_none_or(|newest| newest as usize <= step) {
                return front.len();
            }
            for index in &mut front {
                let node = self.nodes[*index as usize];
                if node.step as usize > step {
                    *index = node.parent;
                }
            }
            front.retain(|index| *index != NONE);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn forest_after(ancestors: &[&[u32]]) -> PathForest {
        let mut forest = PathForest::new(ancestors[0].len());
        for (t, a) in ancestors.iter().enumerate() {
            forest.extend(t as f64, |i| Pose::new(t as f64, i as f64, 0.0));
            forest.resample(a);
        }
        forest
    }

    #[test]
    fn a_path_follows_its_ancestors() {
        let forest = forest_after(&[&[0, 1, 2], &[2, 2, 0], &[1, 1, 1]]);
        let path: Vec<(f64, f64)> = forest.path(0).iter().map(|(t, pose)| (*t, pose.y)).collect();
        // Particle 0 came from particle 1 of step 2, that from particle 2 of step 1.
        assert_eq!(path, vec![(0.0, 2.0), (1.0, 2.0), (2.0, 1.0)]);
    }

    #[test]
    fn only_survivors_are_kept() {
        let forest = forest_after(&[&[0, 1, 2], &[2, 2, 0], &[1, 1, 1]]);
        assert_eq!(forest.live_nodes(), 3);
        assert_eq!(forest.distinct_ancestors(0), 1);
        let forest = forest_after(&[&[0, 1, 2], &[2, 2, 0]]);
        assert_eq!(forest.live_nodes(), 4);
        assert_eq!(forest.distinct_ancestors(1), 2);
        assert_eq!(forest.distinct_ancestors(2), 0);
    }

    #[test]
    fn the_number_of_paths_may_change() {
        let mut forest = forest_after(&[&[0, 1, 1]]);
        forest.resample(&[0, 0, 1, 2, 2]);
        assert_eq!(forest.path(4)[0].1.y, 1.0);
        forest.resample(&[0]);
        assert_eq!(forest.live_nodes(), 1);
    }
}
