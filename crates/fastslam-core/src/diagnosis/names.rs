//! Names that contradict themselves: sightings that name a landmark far from where they can show it.
//!
//! Such a sighting was misread, or the landmark was founded by one that was. Several that agree with each other say that
//! the robot is not where the filter thinks (`misfits.rs`); then it is the pose that is wrong, and their names are believed.

use super::misfits::{Beside, Lately, Misplaced};
use rustc_hash::FxHashMap;
use serde::{Deserialize, Serialize};

/// Squared Mahalanobis distance from which on a named landmark is out of the question: seven standard deviations, of
/// errors as large as they usually are.
pub(crate) const IMPLAUSIBLE: f64 = 49.0;
/// Weight of the newest sighting in the moving average of those that do not fit.
const NEWEST: f64 = 0.1;
/// When more of the sightings lately than this do not fit, the pose is doubted rather than the names.
const MOST_DOUBTED: f64 = 1.0 / 3.0;
/// Sightings that agree with each other elsewhere, from which on a place counts as a second one.
const SIGHTINGS_TO_COUNT: u32 = 3;
/// Sightings that must agree elsewhere before they found the landmark anew.
const SIGHTINGS_TO_MOVE: u32 = 2;

/// A place where a name was seen, in the world.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct NamedPlace {
    /// Mean of what the sightings say.
    pub position_m: [f64; 2],
    /// How many.
    pub sightings: u32,
}

/// A name that was seen at two places.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TwoPlaces {
    /// The name.
    pub identity: u32,
    /// Where the map has it.
    pub held: NamedPlace,
    /// Where else it was seen.
    pub other: NamedPlace,
}

/// What becomes of a sighting that does not fit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Doubt {
    /// It is left out.
    LeaveOut,
    /// The landmark stands where it was seen now.
    Move,
}

/// A sighting that does not fit: the name, and where it shows its landmark.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Misfit {
    pub identity: u32,
    pub position_m: [f64; 2],
    /// Whether that is the other place where the name was seen lately.
    pub agrees: bool,
    /// Where the map has the landmark.
    pub held: NamedPlace,
    /// Whether the robot's drift since it saw the landmark explains it as well.
    pub may_be_drift: bool,
}

/// Watches the names.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct Names {
    /// Moving average of the sightings that do not fit.
    misfits: f64,
    /// Where else the doubted names were seen lately.
    doubted: FxHashMap<u32, TwoPlaces>,
    /// The best supported second place of each name so far.
    two_places: FxHashMap<u32, TwoPlaces>,
    /// What was left out lately; behind the others in a snapshot, which older formats did not have.
    #[serde(skip)]
    pub lately: Lately,
}

impl Names {
    /// Takes note of a scan: how many sightings of known landmarks it has, and those that do not fit. Which of these are
    /// believed, since it is the pose that is wrong.
    ///
    /// `excess`: by how much squared errors exceed what the noise explains.
    pub fn believe(&mut self, sightings: usize, misfits: &[Misplaced], excess: f64) -> Vec<bool> {
        if sightings == 0 {
            return Vec::new();
        }
        let share = misfits.len() as f64 / sightings as f64;
        let kept = (1.0 - NEWEST).powi(sightings.min(1000) as i32);
        self.misfits += (1.0 - kept) * (share - self.misfits);
        let fits = sightings - misfits.len();
        self.lately.believe(misfits, &Beside { fits, excess, pose_is_doubted: self.misfits > MOST_DOUBTED })
    }

    /// Where else a name was seen lately.
    pub fn other_place(&self, identity: u32) -> Option<[f64; 2]> {
        self.doubted.get(&identity).map(|two| two.other.position_m)
    }

    /// What becomes of a sighting that does not fit, where names may be doubted.
    pub fn doubt(&mut self, misfit: &Misfit) -> Doubt {
        let Misfit { identity, position_m, agrees, held, may_be_drift } = *misfit;
        let first = NamedPlace { position_m, sightings: 0 };
        let entry = self.doubted.entry(identity).or_insert(TwoPlaces { identity, held, other: first });
        entry.held = held;
        let place = &mut entry.other;
        if !agrees {
            *place = first;
        }
        place.sightings += 1;
        let share = 1.0 / f64::from(place.sightings);
        (0..2).for_each(|i| place.position_m[i] += share * (position_m[i] - place.position_m[i]));
        let found = *entry;
        if !may_be_drift && found.other.sightings.min(found.held.sightings) >= SIGHTINGS_TO_COUNT {
            self.note(found);
        }
        if found.other.sightings >= SIGHTINGS_TO_MOVE && found.other.sightings > found.held.sightings {
            // The former place is the other one now.
            self.doubted.insert(identity, TwoPlaces { identity, held: found.other, other: found.held });
            return Doubt::Move;
        }
        Doubt::LeaveOut
    }

    fn note(&mut self, found: TwoPlaces) {
        let support = |two: &TwoPlaces| two.held.sightings.min(two.other.sightings);
        let known = self.two_places.entry(found.identity).or_insert(found);
        if support(&found) >= support(known) {
            *known = found;
        }
    }

    /// Names that were seen at two places, three times or more at each, in the order of the names.
    pub fn two_places(&self) -> Vec<TwoPlaces> {
        let mut found: Vec<TwoPlaces> = self.two_places.values().copied().collect();
        found.sort_unstable_by_key(|two| two.identity);
        found
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn misfit(position_m: [f64; 2], held: u32, agrees: bool) -> Misfit {
        let held = NamedPlace { position_m: [0.0; 2], sightings: held };
        Misfit { identity: 7, position_m, agrees, held, may_be_drift: false }
    }

    fn misplaced(identity: u32, shown_m: [f64; 2]) -> Misplaced {
        let held_m = [f64::from(identity), 0.0];
        Misplaced { identity, held_m, shown_m, variance_m2: 0.01, turn: None }
    }

    #[test]
    fn one_misfit_among_many_is_left_out_and_what_agrees_is_believed() {
        let mut names = Names::default();
        assert!(names.believe(5, &[], 1.0).is_empty());
        assert_eq!(names.believe(5, &[misplaced(7, [9.0, 9.0])], 1.0), [false]);
        assert_eq!(names.doubt(&misfit([5.0, 0.0], 40, false)), Doubt::LeaveOut);
        // A robot that was carried away sees all moved alike.
        let moved = [1, 4, 9].map(|name| misplaced(name, [f64::from(name) + 3.0, 2.0]));
        assert_eq!(names.believe(4, &moved, 1.0), [true; 3]);
    }

    #[test]
    fn single_sightings_are_judged_by_those_before() {
        let mut names = Names::default();
        (0..20).for_each(|_| assert!(names.believe(1, &[], 1.0).is_empty()));
        let doubted = (0..10).take_while(|_| names.believe(1, &[misplaced(7, [9.0, 9.0])], 1.0) == [false]).count();
        assert_eq!(doubted, 3);
    }

    #[test]
    fn a_landmark_founded_by_a_misread_moves_to_where_it_is_seen() {
        let mut names = Names::default();
        assert_eq!(names.doubt(&misfit([5.0, 0.0], 1, false)), Doubt::LeaveOut);
        assert_eq!(names.doubt(&misfit([5.1, 0.0], 1, true)), Doubt::Move);
        assert_eq!(names.two_places(), vec![]);
    }

    #[test]
    fn a_name_that_is_seen_often_at_two_places_is_told_with_both() {
        let mut names = Names::default();
        for sighting in 0..8 {
            assert_eq!(names.doubt(&misfit([5.0, 1.0], 40, sighting > 0)), Doubt::LeaveOut);
        }
        let found = names.two_places();
        assert_eq!((found.len(), found[0].identity, found[0].other.sightings), (1, 7, 8));
        assert_eq!((found[0].held.sightings, found[0].other.position_m), (40, [5.0, 1.0]));
        let mut names = Names::default();
        for sighting in 0..8 {
            let drift = Misfit { may_be_drift: true, ..misfit([5.0, 1.0], 40, sighting > 0) };
            assert_eq!(names.doubt(&drift), Doubt::LeaveOut);
        }
        assert_eq!(names.two_places(), []);
    }
}
