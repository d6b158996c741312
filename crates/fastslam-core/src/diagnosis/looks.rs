//! Looks at the map: what a scan should have shown of it, and what it showed.

use super::kept_map::KeptMap;
use super::revisits::{Returns, Revisits};
use crate::geometry::Pose;
use serde::{Deserialize, Serialize};

/// A map of which so few landmarks were expected lately says nothing about its age.
const EXPECTED_LATELY_MIN: f64 = 2.0;
/// Looks at the map from which it is known what is usual.
const VIEWS_TO_LEARN: f64 = 20.0;
/// Motion from one look at the map to the next: a fraction of how far the sensor sees, and a turn.
///
/// **Why:** what a robot that stands does not see it will not see in the next scan either; that is one observation.
const LOOK_AGAIN_REACH: f64 = 0.02;
const LOOK_AGAIN_RAD: f64 = 0.1;
/// Looks at a landmark that weigh as much as what is known of the others.
const LOOKS_LIKE_OTHERS: f64 = 2.0;

/// Whether a look from here says anything new after one from there, by a sensor that sees so far.
pub(crate) fn is_another_look(from: Pose, to: Pose, far_m: f64) -> bool {
    let moved = from.inverse().compose(to);
    let far = LOOK_AGAIN_REACH * far_m;
    moved.x.hypot(moved.y) > far || crate::math::wrap_angle(moved.heading).abs() > LOOK_AGAIN_RAD
}

/// Landmarks of the best particle's map that a scan should have shown.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct MapInView {
    /// How many are in view.
    pub landmarks: u32,
    /// How many of these a scan shows that is like those before: the sum of how often each was sighted.
    pub expected: f64,
    /// How many it showed.
    pub sighted: u32,
}

/// A landmark that is in view.
#[derive(Clone, Copy, Debug)]
pub(crate) struct InView {
    /// Running number of its creation.
    pub birth: u64,
    /// Whether the scan shows it.
    pub sighted: bool,
}

/// How often each landmark was looked for, and sighted.
///
/// **Why:** a post behind a car is missed half of the time, and a map is not stale for that: each landmark is held to
/// what it used to be, whatever the others are.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(super) struct Looks {
    /// By birth: looks, and how many of them found it.
    of_landmark: Vec<[u32; 2]>,
    /// The same of all together.
    of_all: [f64; 2],
    /// Where the last one was taken from.
    last: Option<Pose>,
    /// Looks that had landmarks in view; moving averages of how many should have been sighted, and were.
    views: f64,
    expected: f64,
    sighted: f64,
    revisits: Revisits,
    /// Of a robot that began in one.
    #[serde(skip)]
    pub kept_map: KeptMap,
}

impl Looks {
    /// Whether a look at the map from here says anything new; then it counts as taken.
    pub fn begin(&mut self, T_world_robot: Pose, far_m: f64) -> bool {
        let new = self.last.is_none_or(|last| is_another_look(last, T_world_robot, far_m));
        if new {
            self.last = Some(T_world_robot);
            self.revisits.begin();
        }
        new
    }

    /// Where the last one was taken from.
    pub fn last(&mut self) -> &mut Option<Pose> {
        &mut self.last
    }

    /// Takes note of whether a landmark that is in view was sighted, in what the scan shows of the map.
    pub fn looked(&mut self, in_view: &mut MapInView, landmark: InView) {
        let share = self.add(landmark);
        self.revisits.in_view(landmark.birth, landmark.sighted, share);
        in_view.landmarks += 1;
        in_view.expected += share;
        in_view.sighted += u32::from(landmark.sighted);
    }

    /// Takes note of a look; returns the share of looks like it that found the landmark before.
    fn add(&mut self, InView { birth, sighted }: InView) -> f64 {
        let place = birth as usize;
        if self.of_landmark.len() <= place {
            self.of_landmark.resize(place + 1, [0; 2]);
        }
        // One that was hardly looked for is taken to be like the others.
        let usual = if self.of_all[0] > 0.0 { self.of_all[1] / self.of_all[0] } else { 0.5 };
        let [looks, found] = self.of_landmark[place].map(f64::from);
        let share = (found + LOOKS_LIKE_OTHERS * usual) / (looks + LOOKS_LIKE_OTHERS);
        for (count, more) in self.of_landmark[place].iter_mut().zip([true, sighted]) {
            *count += u32::from(more);
        }
        self.of_all[0] += 1.0;
        self.of_all[1] += f64::from(u8::from(sighted));
        share
    }

    /// A landmark was sighted, in a scan that is looked at or not.
    pub fn sighted(&mut self, birth: u64) {
        self.revisits.sighted(birth);
    }

    /// Ends a look; `share` is the weight of the newest one in the averages.
    pub fn end(&mut self, in_view: MapInView, share: f64) {
        self.kept_map.end();
        if in_view.landmarks == 0 {
            return;
        }
        self.views += 1.0;
        let recent = share.max(1.0 / self.views);
        self.expected += recent * (in_view.expected - self.expected);
        self.sighted += recent * (f64::from(in_view.sighted) - self.sighted);
    }

    /// Whether less than this ratio is sighted of the landmarks in view of what used to be of the same ones.
    pub fn find_map_stale(&self, smallest_ratio: f64) -> bool {
        self.views >= VIEWS_TO_LEARN
            && self.expected > EXPECTED_LATELY_MIN
            && self.sighted < smallest_ratio * self.expected
    }

    /// Whether most landmarks to which the robot came back lately were not sighted.
    pub fn find_returns_in_vain(&self) -> bool {
        self.revisits.are_in_vain()
    }

    /// What came of the returns to these landmarks.
    pub fn returns(&self, births: impl Iterator<Item = u64>) -> Returns {
        self.revisits.of(births)
    }

    /// Another landmark went over into this one.
    pub fn merged(&mut self, birth: u64) {
        self.revisits.merged(birth);
    }

    /// Loops were closed.
    pub fn closed(&mut self) {
        self.revisits.closed();
        self.kept_map.closed();
    }
}
