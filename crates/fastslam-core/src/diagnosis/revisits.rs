//! Whether landmarks are sighted again when the robot comes back to where they stand.
//!
//! A field that was mapped twice looks well to everything that judges scan by scan: each scan fits the newer copy. But
//! the older copy stands in full view and is never sighted any more. So does what was carried away, and what the robot
//! only believes to be in view because it is lost: whoever comes back and finds nothing has a wrong map or a wrong pose.

use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// A landmark that was out of view for so many looks is visited again.
///
/// **Why:** one at the border of the view comes and goes; that tells nothing of a return.
const LOOKS_AWAY: u32 = 25;
/// A visit in which nothing was sighted counts once chance would do that so rarely, given how often the landmark was
/// sighted before.
const RARELY: f64 = 0.01;
/// Looks that a visit takes at least before it counts as one in which nothing was sighted.
const LOOKS_MIN: u32 = 4;
/// A landmark that was sighted in fewer than this share of its looks is no witness.
const SHARE_MIN: f64 = 0.4;
/// Visits that are averaged.
const RECENT: usize = 12;
/// Of these at least so many must be known, and this share of them in vain, for a warning.
const RECENT_MIN: usize = 6;
const MANY_IN_VAIN: f64 = 0.6;

/// What came of the last visit to a landmark that was known from an earlier one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
enum Outcome {
    /// It was never visited again, or not long enough.
    #[default]
    Open,
    /// It was sighted.
    Found,
    /// It was in view, again and again, and was not sighted.
    Vain,
}

/// The visit to a landmark that goes on, or was the last.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
struct Visit {
    /// Number of the last look that had it in view.
    look: u32,
    /// Looks of this visit.
    looks: u32,
    /// Whether it was known from an earlier visit.
    is_return: bool,
    /// Whether this visit has come to its outcome.
    is_decided: bool,
    /// Log of the probability that chance hides it from all looks of this visit.
    log_hidden: f64,
    outcome: Outcome,
}

/// How often the robot came back to a landmark, by what came of it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Returns {
    /// Landmarks to which it came back.
    pub visited: u32,
    /// Those of them that were in view and not sighted, the last time.
    pub in_vain: u32,
}

/// The visits to all landmarks.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(super) struct Revisits {
    /// By birth.
    visits: Vec<Visit>,
    /// Number of the look at hand.
    look: u32,
    /// Whether the last visits were in vain.
    recent: VecDeque<bool>,
}

impl Revisits {
    /// Begins a look at the map.
    pub fn begin(&mut self) {
        self.look = self.look.saturating_add(1);
    }

    /// A landmark is in view that was sighted in this share of its looks before.
    pub fn in_view(&mut self, birth: u64, sighted: bool, share: f64) {
        let place = birth as usize;
        if self.visits.len() <= place {
            self.visits.resize(place + 1, Visit::default());
        }
        let (look, visit) = (self.look, &mut self.visits[place]);
        if visit.looks > 0 && look - visit.look > LOOKS_AWAY {
            *visit = Visit { is_return: share >= SHARE_MIN, outcome: visit.outcome, ..Visit::default() };
        }
        visit.look = look;
        visit.looks += 1;
        if sighted {
            return self.sighted(birth);
        }
        visit.log_hidden += crate::math::ln(1.0 - share.min(0.9));
        let hidden = visit.looks >= LOOKS_MIN && visit.log_hidden < crate::math::ln(RARELY);
        if visit.is_return && !visit.is_decided && hidden {
            (visit.is_decided, visit.outcome) = (true, Outcome::Vain);
            self.note(true);
        }
    }

    /// A landmark was sighted, in a scan that is looked at or not.
    pub fn sighted(&mut self, birth: u64) {
        let Some(visit) = self.visits.get_mut(birth as usize) else { return };
        let news = visit.is_return && !visit.is_decided;
        if news || visit.outcome == Outcome::Vain {
            visit.outcome = Outcome::Found;
        }
        visit.is_decided |= visit.is_return;
        if news {
            self.note(false);
        }
    }

    fn note(&mut self, in_vain: bool) {
        if self.recent.len() == RECENT {
            self.recent.pop_front();
        }
        self.recent.push_back(in_vain);
    }

    /// Another landmark went over into this one: what was in vain is explained.
    pub fn merged(&mut self, birth: u64) {
        if let Some(visit) = self.visits.get_mut(birth as usize) {
            if visit.outcome == Outcome::Vain {
                visit.outcome = Outcome::Found;
            }
        }
    }

    /// A loop was closed: what was in vain before says nothing any more.
    pub fn closed(&mut self) {
        self.recent.clear();
    }

    /// Whether most landmarks to which the robot came back lately were not sighted.
    pub fn are_in_vain(&self) -> bool {
        let in_vain = self.recent.iter().filter(|in_vain| **in_vain).count();
        self.recent.len() >= RECENT_MIN && in_vain as f64 >= MANY_IN_VAIN * self.recent.len() as f64
    }

    /// What came of the returns to these landmarks.
    pub fn of(&self, births: impl Iterator<Item = u64>) -> Returns {
        let mut returns = Returns::default();
        for visit in births.filter_map(|birth| self.visits.get(birth as usize)) {
            returns.visited += u32::from(visit.outcome != Outcome::Open);
            returns.in_vain += u32::from(visit.outcome == Outcome::Vain);
        }
        returns
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TREE: u64 = 3;

    /// So many looks at the tree, then so many elsewhere.
    fn visit(revisits: &mut Revisits, looks: u32, sighted: impl Fn(u32) -> bool, share: f64) {
        for look in 0..looks {
            revisits.begin();
            revisits.in_view(TREE, sighted(look), share);
        }
        (0..=LOOKS_AWAY).for_each(|_| revisits.begin());
    }

    fn returns(revisits: &Revisits) -> [u32; 2] {
        let Returns { visited, in_vain } = revisits.of([TREE, 99].into_iter());
        [visited, in_vain]
    }

    #[test]
    fn a_first_visit_says_nothing_of_returns() {
        let mut revisits = Revisits::default();
        visit(&mut revisits, 20, |_| false, 0.8);
        assert_eq!(returns(&revisits), [0, 0]);
    }

    #[test]
    fn a_landmark_that_is_missed_when_chance_would_show_it_was_visited_in_vain() {
        let mut revisits = Revisits::default();
        visit(&mut revisits, 10, |_| true, 0.8);
        visit(&mut revisits, LOOKS_MIN - 1, |_| false, 0.9);
        assert_eq!(returns(&revisits), [0, 0], "too short a look");
        visit(&mut revisits, 8, |_| false, 0.5);
        assert_eq!(returns(&revisits), [1, 1]);
        visit(&mut revisits, 1, |_| true, 0.5);
        assert_eq!(returns(&revisits), [1, 0], "it was there all the time");
    }

    #[test]
    fn who_is_seldom_sighted_is_no_witness_and_who_is_hidden_for_long_is_missed() {
        let mut revisits = Revisits::default();
        visit(&mut revisits, 10, |look| look % 3 == 0, 0.3);
        visit(&mut revisits, 30, |_| false, 0.3);
        assert_eq!(returns(&revisits), [0, 0]);
        visit(&mut revisits, 6, |_| false, 0.5);
        assert_eq!(returns(&revisits), [0, 0], "one in 64 is no proof");
        visit(&mut revisits, 7, |_| false, 0.5);
        assert_eq!(returns(&revisits), [1, 1]);
    }

    #[test]
    fn many_visits_in_vain_are_a_warning_until_the_loop_is_closed() {
        let mut revisits = Revisits::default();
        for birth in 0..RECENT_MIN as u64 {
            assert!(!revisits.are_in_vain());
            for round in 0..2 {
                for _ in 0..8 {
                    revisits.begin();
                    revisits.in_view(birth, round == 0, 0.9);
                }
                (0..=LOOKS_AWAY).for_each(|_| revisits.begin());
            }
        }
        assert!(revisits.are_in_vain());
        revisits.merged(0);
        assert_eq!(revisits.of(0..9), Returns { visited: RECENT_MIN as u32, in_vain: RECENT_MIN as u32 - 1 });
        revisits.closed();
        assert!(!revisits.are_in_vain());
    }
}
