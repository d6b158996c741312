//! Which poses of a path are steps of a past from which others were forgotten.

use crate::geometry::Pose;
use crate::math;
use crate::motion::MotionGaussian;
use serde::{Deserialize, Serialize};

/// Which poses of a path are steps of the past.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Keyframes {
    /// Place in the path of each of the first steps.
    pub(super) places: Vec<u32>,
    /// Steps that were forgotten: behind the first ones each pose is a step.
    pub(super) forgotten: usize,
    /// With fewer steps than this none is forgotten.
    pub(super) enough: usize,
}

impl Keyframes {
    /// The place in the path of a step.
    pub fn place(&self, step: usize) -> usize {
        self.places.get(step).map_or(step + self.forgotten, |place| *place as usize)
    }

    /// The first of so many steps that is among the latest `window` poses of the path.
    pub fn first_within(&self, window: usize, steps: usize) -> usize {
        let first = (steps + self.forgotten).saturating_sub(window);
        (0..steps).rposition(|step| self.place(step) < first).map_or(0, |before| before + 1)
    }

    /// Number of poses of the path of so many steps.
    pub fn path_length(&self, steps: usize) -> usize {
        steps + self.forgotten
    }

    /// The poses of a path that are steps, so many in all; `None` where the path has not as many.
    pub fn of(&self, path: &[Pose], steps: usize) -> Option<Vec<Pose>> {
        (path.len() == self.path_length(steps)).then(|| (0..steps).map(|step| path[self.place(step)]).collect())
    }

    /// The path whose steps have these poses; between two it runs as it did before, the difference spread over the way.
    pub fn fill(&self, start: Pose, before: &[Pose], steps: &[Pose]) -> Vec<Pose> {
        let mut path = Vec::with_capacity(before.len());
        let (mut was, mut is) = (start, start);
        for (step, &pose) in steps.iter().enumerate() {
            let (first, end) = (path.len(), self.place(step));
            let by_former = is.compose(was.inverse());
            let by_next = pose.compose(before[end].inverse());
            for place in first..end {
                let share = (place + 1 - first) as f64 / (end + 1 - first) as f64;
                path.push(between(by_former.compose(before[place]), by_next.compose(before[place]), share));
            }
            path.push(pose);
            (was, is) = (before[end], pose);
        }
        path
    }
}

fn between(a: Pose, b: Pose, share: f64) -> Pose {
    let turn = math::wrap_angle(b.heading - a.heading);
    Pose::new(a.x + share * (b.x - a.x), a.y + share * (b.y - a.y), math::wrap_angle(a.heading + share * turn))
}

/// The motions with those that lead to a step that is gone as a part of the next.
pub(super) fn merged(motions: &[MotionGaussian], stays: &[bool]) -> Vec<MotionGaussian> {
    let (mut merged, mut so_far) = (Vec::new(), None);
    for (motion, stays) in motions.iter().zip(stays) {
        let whole = so_far.map_or(*motion, |before: MotionGaussian| before.then(motion));
        so_far = (!stays).then_some(whole);
        merged.extend(stays.then_some(whole));
    }
    merged
}
