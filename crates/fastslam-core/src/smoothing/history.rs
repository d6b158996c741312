//! What smoothing needs to know of the past: motions, sightings, and to which landmark each particle gave them.

use super::keyframes::{merged, Keyframes};
use crate::geometry::Pose;
use crate::motion::MotionGaussian;
use crate::sighting::Measured;
use rustc_hash::{FxHashMap, FxHasher};
use serde::{Deserialize, Serialize};
use std::hash::{Hash, Hasher};
use std::ops::Range;

/// A sighting that belongs to no landmark of a particle's map.
pub const NO_LANDMARK: u32 = u32::MAX;

/// No scan before this one.
const NONE: u32 = u32::MAX;
/// With fewer explanations than this none is looked for that nobody holds.
const FEW_EXPLANATIONS: usize = 4096;

/// One scan as one or more particles explained it.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
struct Explanation {
    /// That of the scan before.
    previous: u32,
    step: u32,
    first_sighting: u32,
    first_choice: u32,
    count: u32,
}

/// Motions, sightings and associations since the start.
///
/// Associations are a forest like that of the paths, but shared by all particles that decided alike.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct History {
    /// Motion from the pose before to the pose of each step.
    motions: Vec<MotionGaussian>,
    /// Motion since the last step.
    pending: MotionGaussian,
    sightings: Vec<Measured>,
    explanations: Vec<Explanation>,
    /// Births of landmarks, or [`NO_LANDMARK`].
    choices: Vec<u32>,
    /// Latest explanation of each particle.
    tips: Vec<u32>,
    /// Explanations of the scan at hand by a hash of (previous, choices).
    #[serde(skip)]
    known: FxHashMap<u64, u32>,
    /// Kept for its memory.
    #[serde(skip)]
    chosen: Vec<u32>,
    /// Sensors that made the steps, up to the last that was not made by the first one; behind the others in a snapshot,
    /// which older formats did not have.
    #[serde(skip)]
    pub sensors: Vec<u8>,
    /// Explanations from which on those that no particle holds any more are looked for.
    crowded: usize,
    /// Which poses of the path are steps; behind the others in a snapshot, which older formats did not have.
    #[serde(skip)]
    pub keyframes: Keyframes,
}

/// A sighting of a landmark: number of the step and of the sighting.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Seen {
    /// Birth of the landmark.
    pub birth: u32,
    /// Step, from 0.
    pub step: u32,
    /// Place in [`History::sighting`].
    pub sighting: u32,
}

impl History {
    /// Nothing yet, for so many particles.
    pub fn new(particles: usize) -> Self {
        Self { tips: vec![NONE; particles], ..Self::default() }
    }

    /// The robot moved.
    pub fn moved(&mut self, motion: &MotionGaussian) {
        self.pending = self.pending.then(motion);
    }

    /// A pose was added to every path, for a scan of this sensor; returns the motion that led to it.
    pub fn step_done(&mut self, sensor: usize) -> MotionGaussian {
        let motion = std::mem::take(&mut self.pending);
        if sensor > 0 {
            self.sensors.resize(self.motions.len(), 0);
            self.sensors.push(sensor as u8);
        }
        self.motions.push(motion);
        motion
    }

    /// The sensor that made the scan of a step.
    pub fn sensor(&self, step: usize) -> usize {
        self.sensors.get(step).map_or(0, |sensor| usize::from(*sensor))
    }

    /// The motion since the last step.
    pub fn pending(&self) -> &MotionGaussian {
        &self.pending
    }

    /// All of it for somebody else; what is left knows the motion since the last step, and nothing before.
    pub fn hand_over(&mut self) -> Self {
        let left = Self { pending: self.pending, tips: vec![NONE; self.tips.len()], ..Self::default() };
        std::mem::replace(self, left)
    }

    /// A scan was explained: `choice_of(particle, sighting)` is the birth of a landmark, or [`NO_LANDMARK`].
    pub fn explained(&mut self, scan: impl Iterator<Item = Measured>, choice_of: impl Fn(usize, usize) -> u32) {
        self.forget_what_nobody_holds();
        let (first_sighting, count) = self.remember(scan);
        self.known.clear();
        let mut chosen = std::mem::take(&mut self.chosen);
        let mut latest: Option<(u32, u32)> = None;
        for particle in 0..self.tips.len() {
            chosen.clear();
            chosen.extend((0..count as usize).map(|j| choice_of(particle, j)));
            let previous = self.tips[particle];
            // Neighbours of one past mostly decide alike.
            let new = match latest {
                Some((of, new)) if of == previous && *self.choices_in(new) == *chosen => new,
                _ => self.explanation(previous, first_sighting, &chosen),
            };
            latest = Some((previous, new));
            self.tips[particle] = new;
        }
        self.chosen = chosen;
    }

    /// The explanation of the scan at hand by these choices, a new one if there is none yet.
    fn explanation(&mut self, previous: u32, first_sighting: u32, choices: &[u32]) -> u32 {
        let mut hasher = FxHasher::default();
        (previous, choices).hash(&mut hasher);
        let mut hash = hasher.finish();
        while let Some(&known) = self.known.get(&hash) {
            if self.explanations[known as usize].previous == previous && self.choices_in(known) == choices {
                return known;
            }
            hash = hash.wrapping_add(1);
        }
        let new = self.explain(previous, first_sighting, choices);
        self.known.insert(hash, new);
        new
    }

    /// What an explanation takes the sightings of its scan for.
    fn choices_in(&self, explanation: u32) -> &[u32] {
        let Explanation { first_choice, count, .. } = self.explanations[explanation as usize];
        &self.choices[first_choice as usize..(first_choice + count) as usize]
    }

    /// Forgets explanations from which no particle descends, once there are twice as many as were left the last time.
    fn forget_what_nobody_holds(&mut self) {
        if self.explanations.len() < self.crowded.max(FEW_EXPLANATIONS) {
            return;
        }
        self.retain(Some);
        self.crowded = 2 * self.explanations.len();
    }

    /// Keeps of the explanations that some particle holds those that `kept` gives back, as it gives them back.
    fn retain(&mut self, kept: impl Fn(Explanation) -> Option<Explanation>) {
        let mut held = vec![false; self.explanations.len()];
        for &tip in &self.tips {
            let mut index = tip;
            while index != NONE && !std::mem::replace(&mut held[index as usize], true) {
                index = self.explanations[index as usize].previous;
            }
        }
        let (explanations, choices) = (std::mem::take(&mut self.explanations), std::mem::take(&mut self.choices));
        let mut places = vec![NONE; explanations.len()];
        let place = |places: &[u32], index: u32| if index == NONE { NONE } else { places[index as usize] };
        for (index, old) in explanations.into_iter().enumerate().filter(|(index, _)| held[*index]) {
            let previous = place(&places, old.previous);
            let Some(new) = kept(old) else {
                places[index] = previous;
                continue;
            };
            places[index] = self.explanations.len() as u32;
            let first_choice = self.choices.len() as u32;
            self.choices
                .extend_from_slice(&choices[old.first_choice as usize..(old.first_choice + old.count) as usize]);
            self.explanations.push(Explanation { previous, first_choice, ..new });
        }
        self.tips.iter_mut().for_each(|tip| *tip = place(&places, *tip));
    }

    /// The landmarks that some particle sighted in each step: step and birth, in this order, each once.
    pub(super) fn births_by_step(&self) -> Vec<(u32, u32)> {
        let mut sighted: Vec<(u32, u32)> = Vec::with_capacity(self.choices.len());
        // They are in the order of their steps: to sort each step takes a fraction of what sorting all takes.
        for of_step in self.explanations.chunk_by(|one, next| one.step == next.step) {
            let first = sighted.len();
            for Explanation { step, first_choice, count, .. } in of_step {
                let choices = &self.choices[*first_choice as usize..(first_choice + count) as usize];
                sighted.extend(choices.iter().filter(|birth| **birth != NO_LANDMARK).map(|birth| (*step, *birth)));
            }
            sighted[first..].sort_unstable();
        }
        debug_assert!(sighted.is_sorted());
        sighted.dedup();
        sighted
    }

    /// Forgets the steps that do not stay, with what was sighted in them; the last one stays.
    pub(super) fn keep_steps(&mut self, stays: &[bool]) {
        let number = numbers(stays);
        let mut is_kept = vec![false; self.sightings.len()];
        for Explanation { step, first_sighting, count, .. } in &self.explanations {
            if stays[*step as usize] {
                is_kept[*first_sighting as usize..(first_sighting + count) as usize].fill(true);
            }
        }
        let sighting = numbers(&is_kept);
        let kept = |old: Explanation| {
            let (step, first_sighting) = (number[old.step as usize], sighting[old.first_sighting as usize]);
            stays[old.step as usize].then_some(Explanation { step, first_sighting, ..old })
        };
        self.retain(kept);
        self.motions = merged(&self.motions, stays);
        retain_marked(&mut self.sightings, &is_kept);
        retain_marked(&mut self.sensors, stays);
    }

    /// A scan was explained by all particles in the same way.
    pub fn explained_alike(&mut self, scan: impl Iterator<Item = Measured>, choices: &[u32]) {
        self.forget_what_nobody_holds();
        let (first_sighting, _) = self.remember(scan);
        let mut latest: Option<(u32, u32)> = None;
        for particle in 0..self.tips.len() {
            let previous = self.tips[particle];
            // Particles that always decide alike share one past.
            let new = match latest {
                Some((of, new)) if of == previous => new,
                _ => self.explain(previous, first_sighting, choices),
            };
            latest = Some((previous, new));
            self.tips[particle] = new;
        }
    }

    /// Adds sightings; returns the first and how many.
    fn remember(&mut self, scan: impl Iterator<Item = Measured>) -> (u32, u32) {
        let first = self.sightings.len() as u32;
        self.sightings.extend(scan);
        (first, self.sightings.len() as u32 - first)
    }

    fn explain(&mut self, previous: u32, first_sighting: u32, choices: &[u32]) -> u32 {
        let (step, first_choice) = (self.motions.len() as u32, self.choices.len() as u32);
        self.choices.extend_from_slice(choices);
        let count = choices.len() as u32;
        self.explanations.push(Explanation { previous, step, first_sighting, first_choice, count });
        self.explanations.len() as u32 - 1
    }

    /// Gives sightings to other landmarks, or to [`NO_LANDMARK`], in all pasts.
    pub fn give(&mut self, sightings: impl Iterator<Item = (u32, u32)>) {
        let births: FxHashMap<u32, u32> = sightings.collect();
        for explanation in self.explanations.iter().filter(|_| !births.is_empty()) {
            for j in 0..explanation.count {
                if let Some(birth) = births.get(&(explanation.first_sighting + j)) {
                    self.choices[(explanation.first_choice + j) as usize] = *birth;
                }
            }
        }
    }

    /// Particle i takes over the past of the former particle `ancestor_indices[i]`.
    pub fn resample(&mut self, ancestor_indices: &[u32]) {
        self.tips = ancestor_indices.iter().map(|&a| self.tips[a as usize]).collect();
    }

    /// Whether no scan was explained since the last step.
    pub fn is_between_steps(&self) -> bool {
        self.explanations.last().is_none_or(|last| (last.step as usize) < self.motions.len())
    }

    /// Steps done.
    pub fn steps(&self) -> usize {
        self.motions.len()
    }

    /// Motion that led to the pose of a step.
    pub fn motion(&self, step: usize) -> &MotionGaussian {
        &self.motions[step]
    }

    /// A sighting.
    pub fn sighting(&self, index: u32) -> &Measured {
        &self.sightings[index as usize]
    }

    /// All sightings that one particle gave to a landmark, in the order of time.
    pub fn seen_by(&self, particle: usize) -> Vec<Seen> {
        let mut seen = Vec::new();
        let mut index = self.tips[particle];
        while index != NONE {
            let Explanation { previous, step, first_sighting, first_choice, count } = self.explanations[index as usize];
            let choices = &self.choices[first_choice as usize..(first_choice + count) as usize];
            for (j, birth) in choices.iter().enumerate().rev().filter(|(_, birth)| **birth != NO_LANDMARK) {
                seen.push(Seen { birth: *birth, step, sighting: first_sighting + j as u32 });
            }
            index = previous;
        }
        seen.reverse();
        seen
    }
}

/// How many are marked before each, and in all.
fn numbers(marked: &[bool]) -> Vec<u32> {
    let mut count = 0;
    let mut numbers: Vec<u32> = Vec::with_capacity(marked.len() + 1);
    numbers.push(0);
    numbers.extend(marked.iter().map(|marked| {
        count += u32::from(*marked);
        count
    }));
    numbers
}

fn retain_marked<T>(values: &mut Vec<T>, marked: &[bool]) {
    let mut marks = marked.iter();
    values.retain(|_| marks.next().is_some_and(|marked| *marked));
}

/// Where the robot was at each step, as one particle has it.
#[derive(Clone, Debug)]
pub struct Trajectory {
    /// Pose before the first step.
    pub start: Pose,
    /// One pose per step.
    pub poses: Vec<Pose>,
}

impl Trajectory {
    /// The pose before a step.
    pub fn before(&self, step: usize) -> Pose {
        step.checked_sub(1).map_or(self.start, |previous| self.poses[previous])
    }

    /// Steps that may move when all before `first` stand still.
    pub fn free(&self, first: usize) -> Range<usize> {
        first.min(self.poses.len())..self.poses.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::density::Tail;
    use crate::geometry::Symmetric2;

    fn measured(value: f64) -> Measured {
        Measured { value: [value, 0.0], noise: Symmetric2::new(1.0, 0.0, 1.0), tail: Tail::Gaussian }
    }

    #[test]
    fn particles_that_decide_alike_share_an_explanation() {
        let mut history = History::new(3);
        history.explained(
            [1.0, 2.0].map(measured).into_iter(),
            |i, j| if i == 2 && j == 1 { NO_LANDMARK } else { j as u32 },
        );
        history.step_done(0);
        assert_eq!(history.explanations.len(), 2);
        history.resample(&[2, 0, 0]);
        history.explained_alike([3.0].map(measured).into_iter(), &[7]);
        history.step_done(0);
        let births = |particle| history.seen_by(particle).iter().map(|s| (s.birth, s.step)).collect::<Vec<_>>();
        assert_eq!(births(0), vec![(0, 0), (7, 1)]);
        assert_eq!(births(1), vec![(0, 0), (1, 0), (7, 1)]);
        assert_eq!(history.sighting(history.seen_by(1)[2].sighting).value[0], 3.0);
        assert_eq!(history.steps(), 2);
    }

    #[test]
    fn what_no_particle_holds_is_forgotten_and_nothing_else() {
        let mut history = History::new(4);
        let steps = 3 * FEW_EXPLANATIONS as u32;
        for step in 0..steps {
            history.explained([f64::from(step)].map(measured).into_iter(), |i, _| 4 * step + i as u32);
            history.step_done(0);
            if step % 2 == 1 {
                history.resample(&[1, 2, 2, 0]);
            }
        }
        assert!(
            history.explanations.len() < 2 * (steps as usize + 8) + FEW_EXPLANATIONS,
            "{}",
            history.explanations.len()
        );
        let births: Vec<u32> = history.seen_by(0).iter().map(|seen| seen.birth).collect();
        assert_eq!(births.len(), steps as usize);
        // Particle 0 came from 1 at the last step, which came from 2 two steps before, and that always from itself.
        for (step, birth) in births.iter().enumerate() {
            let ancestor = if step as u32 + 2 < steps { 2 } else { 1 };
            assert_eq!(*birth, 4 * step as u32 + ancestor, "step {step}");
        }
    }
}
