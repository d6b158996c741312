//! From where each landmark was sighted, so that a wall which hides it from elsewhere is none of its faults.

use crate::math;
use serde::{Deserialize, Serialize};

/// Directions that are told apart: those from which a landmark was never sighted may be hidden.
const DIRECTIONS: usize = 16;
/// A landmark is not hidden so many times as far as it was sighted from in a direction.
const AS_FAR: f64 = 1.2;
/// Steps in which distances are kept, up to as far as the sensor sees.
const STEPS: f64 = 255.0;
/// Hidden is what is missed more often than chance would have it: as rarely as this.
const RARELY: f64 = 0.01;
/// Marks a direction in which a landmark was hidden; more looks in one are not counted.
const HIDDEN: u8 = u8::MAX;

/// From where a landmark is looked for.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Vantage {
    /// Which of the directions.
    direction: usize,
    /// How far, as a share of how far the sensor sees.
    far: f64,
}

impl Vantage {
    /// From a sensor that lies there of the landmark, metres east and north, and sees so far.
    pub fn new([east_m, north_m]: [f64; 2], far_m: f64) -> Self {
        let turn = math::atan2(north_m, east_m) / std::f64::consts::TAU + 1.0;
        let direction = (turn * DIRECTIONS as f64) as usize % DIRECTIONS;
        Self { direction, far: (east_m * east_m + north_m * north_m).sqrt() / far_m }
    }
}

/// What is known of one landmark.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
struct Known {
    /// From how far it was sighted in each direction; 0 for never.
    farthest: [u8; DIRECTIONS],
    /// Looks in each of the others that did not show it; [`HIDDEN`] where these are more than chance.
    missed: [u8; DIRECTIONS],
    /// Directions in which it was hidden since it was sighted last.
    hidden: u8,
}

/// From how far each landmark was sighted in each direction, and how often one was hidden.
///
/// **Why:** a reflector on a rack is in view from every aisle, and sighted from one. What was only there for a while is
/// not sighted from anywhere: it counts as hidden once it is sighted again.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct Directions {
    /// By birth.
    of_landmark: Vec<Known>,
    /// New directions from which a landmark that was known from others was sighted, and from which it was hidden.
    seen: u32,
    hidden: u32,
}

impl Directions {
    /// A landmark was sighted from there.
    pub fn sighted(&mut self, birth: u64, from: Vantage) {
        let place = birth as usize;
        if self.of_landmark.len() <= place {
            self.of_landmark.resize(place + 1, Known::default());
        }
        let known = &mut self.of_landmark[place];
        if known.farthest[from.direction] == 0 && known.farthest != [0; DIRECTIONS] {
            self.seen = self.seen.saturating_add(1);
            if known.missed[from.direction] == HIDDEN {
                // It was not hidden after all; elsewhere it may have been.
                known.hidden = known.hidden.saturating_sub(1);
            }
        }
        self.hidden = self.hidden.saturating_add(u32::from(std::mem::take(&mut known.hidden)));
        let farthest = &mut known.farthest[from.direction];
        *farthest = (*farthest).max((from.far * STEPS).ceil().clamp(1.0, STEPS) as u8);
    }

    /// A landmark was in view from there and was not sighted, as this share of looks sights it.
    pub fn missed(&mut self, birth: u64, from: Vantage, share: f64) {
        let Some(known) = self.of_landmark.get_mut(birth as usize) else { return };
        let farthest = known.farthest.iter().max().map_or(0, |farthest| *farthest);
        let missed = &mut known.missed[from.direction];
        if known.farthest[from.direction] > 0 || !is_as_near(from, farthest) || *missed == HIDDEN {
            return;
        }
        *missed += 1;
        if f64::from(*missed) * math::ln(1.0 - share.min(0.9)) < math::ln(RARELY) {
            *missed = HIDDEN;
            known.hidden += 1;
        }
    }

    /// Whether a landmark that is in view from there shows itself: it was sighted in that direction before, from about
    /// as far, or things are hardly ever hidden here.
    pub fn is_in_sight(&self, birth: u64, from: Vantage) -> bool {
        let farthest = self.of_landmark.get(birth as usize).map_or(0, |known| known.farthest[from.direction]);
        is_as_near(from, farthest) || self.are_hardly_hidden()
    }

    /// Whether landmarks are hidden in fewer than one of a hundred directions in which they are in view.
    fn are_hardly_hidden(&self) -> bool {
        f64::from(self.hidden) + 1.0 < RARELY * (f64::from(self.hidden) + f64::from(self.seen) + 2.0)
    }
}

fn is_as_near(from: Vantage, farthest: u8) -> bool {
    from.far <= AS_FAR * f64::from(farthest) / STEPS
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_landmark_is_in_sight_from_where_it_was_sighted() {
        let mut directions = Directions::default();
        let from = |angle: f64, range_m: f64| Vantage::new([range_m * angle.cos(), range_m * angle.sin()], 20.0);
        assert!(!directions.is_in_sight(3, from(0.1, 1.0)));
        directions.sighted(3, from(0.1, 5.0));
        assert!(directions.is_in_sight(3, from(0.2, 5.0)) && directions.is_in_sight(3, from(0.3, 5.9)));
        assert!(!directions.is_in_sight(3, from(0.1, 6.5)), "something farther may stand before it");
        assert!(!directions.is_in_sight(3, from(-0.1, 5.0)) && !directions.is_in_sight(3, from(3.0, 5.0)));
        assert!(!directions.is_in_sight(2, from(0.1, 5.0)) && !directions.is_in_sight(9, from(0.1, 5.0)));
        directions.sighted(3, from(0.1, 2.0));
        assert!(directions.is_in_sight(3, from(0.1, 5.0)), "the farthest counts");
        directions.sighted(3, from(-3.0, 30.0));
        assert!(directions.is_in_sight(3, from(-3.0, 20.0)));
        assert!(!directions.are_hardly_hidden());
        for k in 0..64 {
            assert!(from(f64::from(k) * 0.1 - std::f64::consts::PI, 1.0).direction < DIRECTIONS);
        }
    }

    #[test]
    fn where_things_are_hardly_ever_hidden_they_are_in_sight_from_everywhere() {
        let from = |direction: usize| Vantage { direction, far: 0.3 };
        let (mut open, mut walled) = (Directions::default(), Directions::default());
        for birth in 0..20 {
            for direction in 0..8 {
                open.sighted(birth, from(direction));
                walled.sighted(birth, from(direction));
                // Behind the wall; seen again, from before it, in the next round.
                (0..6).for_each(|_| walled.missed(birth, from(8 + direction), 0.8));
            }
        }
        assert!(open.is_in_sight(3, from(12)) && !walled.is_in_sight(3, from(12)) && walled.is_in_sight(3, from(1)));
        assert_eq!((walled.seen, walled.hidden), (140, 140));
        // What was there for a while is missed from everywhere and never sighted again.
        (8..16).for_each(|direction| (0..6).for_each(|_| open.missed(3, from(direction), 0.8)));
        assert!(open.is_in_sight(3, from(12)));
        open.sighted(3, from(0));
        assert!(!open.is_in_sight(3, from(12)) && open.hidden == 8);
        // Few looks are chance, and one that is sighted there in the end was not hidden.
        let mut late = Directions::default();
        late.sighted(0, from(0));
        (0..9).for_each(|_| late.missed(0, from(1), 0.3));
        late.sighted(0, from(0));
        assert_eq!((late.seen, late.hidden), (0, 0));
        (0..9).for_each(|_| late.missed(0, from(1), 0.8));
        late.sighted(0, from(1));
        assert_eq!((late.seen, late.hidden), (1, 0));
    }
}
