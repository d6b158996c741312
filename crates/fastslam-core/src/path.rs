//! The posterior over paths: an ancestry forest of poses, pruned to the survivors.
//!
//! **Source:** `jacob2015path`: with pruning the expected size is T + O(M log M) nodes.

use crate::geometry::Pose;
use crate::resampling::follow;
use crate::shared::Shared;
use crate::workers::Workers;
use serde::{Deserialize, Serialize};
use std::cell::Cell;

const NONE: u32 = u32::MAX;

/// One pose of a path.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
struct Node<P> {
    pose: P,
    step: u32,
}

/// Where a node hangs; apart from the poses, for resampling changes nothing else.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
struct Link {
    parent: u32,
    /// Children, plus the particles that stand on the node.
    holders: u32,
}

/// Paths of all particles as a forest that shares common pasts; poses are of the plane, or of space.
///
/// A copy shares what neither changes, which after hours is nearly all.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct PathForest<P = Pose> {
    nodes: Shared<Node<P>>,
    links: Shared<Link>,
    free: Vec<u32>,
    /// Node of each particle's latest pose.
    tips: Vec<u32>,
    /// Kept for their memory.
    #[serde(skip)]
    former_tips: Vec<u32>,
    #[serde(skip)]
    offspring: Vec<u32>,
    #[serde(skip)]
    letting_go: Vec<u32>,
    /// So many of the nodes, from the first on, are those of the first steps in all paths.
    #[serde(skip)]
    trunk: usize,
    stamps_s: Shared<f64>,
}

impl<P: Copy + Default + Send + Sync> PathForest<P> {
    /// An empty forest for `particles` paths.
    pub fn new(particles: usize) -> Self {
        Self { tips: vec![NONE; particles], ..Self::default() }
    }

    /// Appends one pose to each particle's path.
    pub fn extend(&mut self, stamp_s: f64, workers: &Workers, pose_of: impl Fn(usize) -> P + Sync) {
        let step = self.stamps_s.len() as u32;
        self.stamps_s.push(stamp_s);
        let Self { nodes, links, free, tips, former_tips, .. } = self;
        std::mem::swap(tips, former_tips);
        let particles = former_tips.len();
        let first_new = nodes.len();
        tips.clear();
        tips.extend(free.drain(free.len().saturating_sub(particles)..).rev());
        tips.extend((first_new..).map(|index| index as u32).take(particles - tips.len()));
        let total = first_new.max(tips.last().map_or(0, |tip| *tip as usize + 1));
        let tips = &*tips;
        // They lie all over the memory: two threads wait for it less than one.
        workers.both(
            particles,
            || {
                nodes.fill_to(total, &Node { pose: P::default(), step });
                nodes.change(tips.iter().copied(), |particle, node| *node = Node { pose: pose_of(particle), step });
            },
            || {
                links.fill_to(total, &Link { parent: NONE, holders: 0 });
                // The particle moves from the old tip to the new node, which holds the old tip in its stead.
                links.change(tips.iter().copied(), |particle, link| {
                    *link = Link { parent: former_tips[particle], holders: 1 };
                });
            },
        );
    }

    /// Path i becomes a copy of the former path `ancestor_indices[i]`; paths without a descendant are forgotten.
    pub fn resample(&mut self, ancestor_indices: &[u32]) {
        self.offspring.clear();
        self.offspring.resize(self.tips.len(), 0);
        ancestor_indices.iter().for_each(|&a| self.offspring[a as usize] += 1);
        follow(&mut self.tips, ancestor_indices, &mut self.former_tips);
        // Gains first, so that nothing is forgotten that is held again. Most tips keep their one particle and are not
        // looked at.
        let family = || self.former_tips.iter().copied().zip(self.offspring.iter().copied());
        let gains = || family().filter(|(tip, offspring)| *offspring > 1 && *tip != NONE);
        let mut more = gains().map(|(_, offspring)| offspring - 1);
        self.links.change(gains().map(|(tip, _)| tip), |_, link| link.holders += more.next().unwrap_or(0));
        self.letting_go.clear();
        let childless = self.former_tips.iter().zip(&self.offspring).filter(|(tip, n)| **n == 0 && **tip != NONE);
        self.letting_go.extend(childless.map(|(tip, _)| *tip));
        self.release();
    }

    /// All paths become one, `poses`, but for the last pose, which `last` gives for each particle.
    ///
    /// `poses` has one pose for every [`PathForest::extend`] so far, the last included.
    pub fn replace(&mut self, poses: &[P], last: impl Fn(usize) -> P) {
        self.nodes.clear();
        self.links.clear();
        self.free.clear();
        self.trunk = 0;
        let Some(trunk) = poses.len().checked_sub(1) else { return };
        self.trunk = trunk;
        for (step, &pose) in poses[..trunk].iter().enumerate() {
            let parent = step.checked_sub(1).map_or(NONE, |parent| parent as u32);
            self.nodes.push(Node { pose, step: step as u32 });
            self.links.push(Link { parent, holders: 1 });
        }
        let parent = trunk.checked_sub(1).map_or(NONE, |parent| parent as u32);
        if parent != NONE {
            self.links[parent as usize].holders = self.tips.len() as u32;
        }
        for (particle, tip) in self.tips.iter_mut().enumerate() {
            *tip = self.nodes.len() as u32;
            self.nodes.push(Node { pose: last(particle), step: trunk as u32 });
            self.links.push(Link { parent, holders: 1 });
        }
    }

    /// Takes one holder from each node of `letting_go`, and forgets those that nobody holds any more.
    ///
    /// **Why level by level:** with many particles every look at a link misses the cache; here one does not wait for
    /// another, and nothing branches on what it finds.
    fn release(&mut self) {
        let Self { links, letting_go, free, .. } = self;
        while !letting_go.is_empty() {
            let (mut gone, indices) = (0, Cell::from_mut(letting_go.as_mut_slice()).as_slice_of_cells());
            links.change(indices.iter().map(Cell::get), |k, link| {
                link.holders -= 1;
                indices[gone].set(indices[k].get());
                gone += usize::from(link.holders == 0);
            });
            letting_go.truncate(gone);
            free.extend_from_slice(letting_go);
            letting_go.iter_mut().for_each(|index| *index = links[*index as usize].parent);
            letting_go.retain(|index| *index != NONE);
        }
    }

    /// The path of one particle: stamps in seconds and poses `T_world_robot`, oldest first.
    pub fn path(&self, particle: usize) -> Vec<(f64, P)> {
        let mut path = Vec::new();
        let mut index = self.tips[particle];
        while index != NONE {
            let node = self.nodes[index as usize];
            path.push((self.stamps_s[node.step as usize], node.pose));
            index = self.links[index as usize].parent;
        }
        path.reverse();
        path
    }

    /// Number of poses on the path of one particle.
    pub fn length(&self, particle: usize) -> usize {
        self.nodes.get(self.tips[particle] as usize).map_or(0, |node| node.step as usize + 1)
    }

    /// Poses on the path of one particle at these places, which increase; `None` where it is shorter.
    ///
    /// **Why not [`PathForest::path`]**: after hours a copy of all of it takes longer than a step may.
    pub fn poses_at(&self, particle: usize, places: &[usize]) -> Option<Vec<P>> {
        let (mut index, mut poses) = (self.tips[particle], Vec::with_capacity(places.len()));
        for &place in places.iter().rev() {
            index = self.ancestor(index, place)?;
            poses.push(self.nodes[index as usize].pose);
        }
        poses.reverse();
        Some(poses)
    }

    /// The node of a step on the path that ends at a later one, or at itself.
    fn ancestor(&self, mut index: u32, step: usize) -> Option<u32> {
        while (index as usize) >= self.trunk {
            let node = self.nodes.get(index as usize)?;
            if node.step as usize <= step {
                return (node.step as usize == step).then_some(index);
            }
            index = self.links[index as usize].parent;
        }
        (step <= index as usize).then_some(step as u32)
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
                if self.nodes[*index as usize].step as usize > step {
                    *index = self.links[*index as usize].parent;
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
            forest.extend(t as f64, &Workers::default(), |i| Pose::new(t as f64, i as f64, 0.0));
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
    fn poses_at_some_places_are_those_of_the_path() {
        let mut forest = forest_after(&[&[0, 1, 2], &[2, 2, 0], &[1, 1, 1]]);
        let check = |forest: &PathForest| {
            for particle in 0..3 {
                let path = forest.path(particle);
                assert_eq!(forest.length(particle), path.len());
                for places in [vec![], (0..path.len()).collect(), vec![0, path.len() - 1], vec![1]] {
                    let expected: Vec<Pose> = places.iter().map(|place: &usize| path[*place].1).collect();
                    assert_eq!(forest.poses_at(particle, &places), Some(expected), "{places:?}");
                }
                assert_eq!(forest.poses_at(particle, &[path.len()]), None);
            }
        };
        check(&forest);
        forest.replace(&[7.0, 8.0, 9.0].map(|x| Pose::new(x, 0.0, 0.0)), |i| Pose::new(9.0, i as f64, 0.0));
        check(&forest);
        for ancestors in [[2, 0, 0], [0, 0, 1], [2, 1, 1]] {
            forest.extend(9.0, &Workers::default(), |i| Pose::new(10.0, i as f64, 1.0));
            forest.resample(&ancestors);
            check(&forest);
        }
        assert_eq!(PathForest::<Pose>::new(1).poses_at(0, &[0]), None);
    }

    #[test]
    fn a_copy_goes_on_alone_and_shares_the_past() {
        let steps = 20_000;
        let ancestors = |step: usize| if step.is_multiple_of(3) { [1, 1, 0] } else { [0, 1, 2] };
        let go_on = |forest: &mut PathForest, from: usize, offset: f64| {
            for step in from..from + 50 {
                forest.extend(step as f64, &Workers::default(), |i| Pose::new(step as f64, i as f64 + offset, 0.0));
                forest.resample(&ancestors(step));
            }
        };
        let mut ours = PathForest::new(3);
        (0..steps).step_by(50).for_each(|from| go_on(&mut ours, from, 0.0));
        let (mut theirs, before) = (ours.clone(), ours.path(0));
        go_on(&mut ours, steps, 0.5);
        assert_eq!(theirs.path(0), before);
        go_on(&mut theirs, steps, 0.5);
        assert_eq!(theirs.path(2), ours.path(2));
        // Of each list the end was copied, and begun where that was full, however many steps there are.
        let copied = ours.nodes.own_chunks() + ours.links.own_chunks() + ours.stamps_s.own_chunks();
        assert!(copied <= 6, "{copied} chunks");
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
