//! Whether a robot in a kept map still sees that map.
//!
//! One that starts somewhat beside where it thinks maps everything anew beside the map, and each scan fits what it has
//! mapped itself. What it does not do any more is to see what was kept.

use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// Sightings whose range and bearing are remembered.
const REMEMBERED: usize = 32;
/// What lies nearer and less aside than this share of them is in view, however far the sensor is said to see.
const VIEW_SHARE: f64 = 0.75;
/// As many of the latest looks at the map are judged together as had so many kept landmarks in view.
const IN_VIEW: u32 = 20;
/// But no more looks than this.
const LOOKS: usize = 40;
/// The map may be left where fewer of them were sighted.
const SIGHTED_MIN: f64 = 0.2;
/// And is where no more of the sightings of known landmarks show kept ones. **Why:** some detectors see one thing of
/// many at a time, but then that is a kept one.
const OF_KEPT_MAX: f64 = 0.5;

/// What a look showed, and the scans since the one before.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
struct Look {
    /// Kept landmarks in view, and how many of them were sighted.
    in_view: u32,
    sighted: u32,
    /// Sightings of known landmarks, and how many of them showed kept ones.
    known: u32,
    kept: u32,
}

impl Look {
    fn add(&mut self, other: &Self) {
        self.in_view += other.in_view;
        self.sighted += other.sighted;
        self.known += other.known;
        self.kept += other.kept;
    }
}

/// What was seen lately of a kept map.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct KeptMap {
    /// How many landmarks were kept: theirs are the lowest births.
    landmarks: u64,
    /// Ranges, and bearings without their sign, of the latest sightings of known landmarks.
    ranges_m: VecDeque<f64>,
    bearings_rad: VecDeque<f64>,
    /// The latest looks, and the one at hand.
    looks: VecDeque<Look>,
    now: Look,
}

impl KeptMap {
    /// Of so many landmarks.
    pub fn of(landmarks: u64) -> Self {
        Self { landmarks, ..Self::default() }
    }

    /// Whether a landmark is one of those that were kept.
    pub fn holds(&self, birth: u64) -> bool {
        birth < self.landmarks
    }

    /// Takes note of a sighting of a known landmark, kept or not.
    pub fn sighted(&mut self, [range_m, bearing_rad]: [f64; 2], birth: u64) {
        if self.landmarks > 0 {
            self.now.known += 1;
            self.now.kept += u32::from(self.holds(birth));
            push(&mut self.ranges_m, REMEMBERED, range_m);
            push(&mut self.bearings_rad, REMEMBERED, bearing_rad.abs());
        }
    }

    /// The range, and the bearing to both sides, within which most sightings lie; nothing while there are few.
    pub fn reach(&self) -> Option<(f64, f64)> {
        (self.ranges_m.len() == REMEMBERED).then(|| (most(&self.ranges_m), most(&self.bearings_rad)))
    }

    /// A kept landmark is within reach.
    pub fn looked(&mut self, sighted: bool) {
        self.now.in_view += 1;
        self.now.sighted += u32::from(sighted);
    }

    /// Ends a look. What was seen where nothing of the map is in view says nothing.
    pub fn end(&mut self) {
        let now = std::mem::take(&mut self.now);
        if now.in_view == 0 {
            return;
        }
        push(&mut self.looks, LOOKS, now);
        let mut rest = self.total().in_view;
        while let Some(oldest) = self.looks.front().filter(|oldest| rest - oldest.in_view >= IN_VIEW) {
            rest -= oldest.in_view;
            self.looks.pop_front();
        }
    }

    /// Maps were joined: what was seen before says nothing any more.
    pub fn closed(&mut self) {
        self.looks.clear();
    }

    /// Whether hardly anything of the map is sighted where it should be, and what is sighted is something else.
    pub fn is_left(&self) -> bool {
        let Look { in_view, sighted, known, kept } = self.total();
        in_view >= IN_VIEW
            && f64::from(sighted) < SIGHTED_MIN * f64::from(in_view)
            && f64::from(kept) <= OF_KEPT_MAX * f64::from(known)
    }

    /// All looks that are judged, together.
    fn total(&self) -> Look {
        self.looks.iter().fold(Look::default(), |mut total, look| {
            total.add(look);
            total
        })
    }
}

fn push<T>(latest: &mut VecDeque<T>, most: usize, value: T) {
    if latest.len() == most {
        latest.pop_front();
    }
    latest.push_back(value);
}

fn most(values: &VecDeque<f64>) -> f64 {
    let mut sorted: Vec<f64> = values.iter().copied().collect();
    sorted.sort_by(f64::total_cmp);
    sorted[(VIEW_SHARE * (sorted.len() - 1) as f64) as usize]
}

#[cfg(test)]
mod tests {
    use super::*;

    const OWN: u64 = 99;

    /// A scan of a landmark of its own, after which some of the kept ones are looked for.
    fn look(map: &mut KeptMap, in_view: u32, sighted: u32) {
        map.sighted([3.0, 0.2], OWN);
        (0..sighted).for_each(|k| map.sighted([3.0, 0.2], u64::from(k)));
        (0..in_view).for_each(|k| map.looked(k < sighted));
        map.end();
    }

    #[test]
    fn a_map_of_which_nothing_is_sighted_is_left_until_it_is_sighted_again() {
        let mut map = KeptMap::of(30);
        (0..3).for_each(|_| look(&mut map, 5, 0));
        assert!(!map.is_left());
        look(&mut map, 5, 0);
        assert!(map.is_left());
        (0..2).for_each(|_| look(&mut map, 5, 4));
        assert!(!map.is_left());
    }

    #[test]
    fn a_third_that_is_sighted_is_no_sign_and_where_few_are_in_view_it_takes_longer() {
        let mut map = KeptMap::of(30);
        (0..40).for_each(|_| look(&mut map, 6, 2));
        assert!(!map.is_left());
        let mut sparse = KeptMap::of(30);
        (0..IN_VIEW - 1).for_each(|_| look(&mut sparse, 1, 0));
        assert!(!sparse.is_left());
        look(&mut sparse, 1, 0);
        assert!(sparse.is_left());
    }

    #[test]
    fn a_detector_that_sees_little_but_that_of_the_map_is_no_sign() {
        let mut map = KeptMap::of(30);
        for look in 0..40 {
            (0..5).for_each(|k| map.looked(look % 2 == 0 && k == 0));
            map.sighted([3.0, 0.2], 4);
            map.end();
        }
        assert!(!map.is_left());
        (0..20).for_each(|_| look(&mut map, 5, 0));
        assert!(map.is_left());
    }

    #[test]
    fn what_was_seen_outside_the_map_says_nothing() {
        let mut map = KeptMap::of(30);
        for _ in 0..50 {
            (0..9).for_each(|_| map.sighted([3.0, 0.2], OWN));
            map.end();
        }
        for _ in 0..40 {
            (0..5).for_each(|_| map.looked(false));
            map.sighted([3.0, 0.2], 4);
            map.end();
            assert!(!map.is_left());
        }
    }

    #[test]
    fn what_is_in_reach_follows_from_the_sightings_and_not_from_what_the_sensor_is_said_to_see() {
        let mut map = KeptMap::of(3);
        (0..REMEMBERED - 1).for_each(|k| map.sighted([0.1 * k as f64, if k % 2 == 0 { 0.4 } else { -0.4 }], OWN));
        assert_eq!(map.reach(), None);
        map.sighted([0.0, 0.0], OWN);
        let (range_m, bearing_rad) = map.reach().unwrap();
        assert!((2.1..2.5).contains(&range_m) && bearing_rad == 0.4);
        assert!(map.holds(2) && !map.holds(3));
    }
}
