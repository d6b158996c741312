//! What speaks for and against landmarks: how often they are sighted when they should be.
//!
//! A false sighting founds a landmark like any other; what tells them apart is what comes after. How often a landmark is
//! sighted from where the robot is has been learned from those that are confirmed ([`Detectability`]); nothing is held
//! against a landmark where that is not known. What was founded and confirmed, or has faded, says what to believe of the
//! next one that is founded: with a detector that makes nothing up, each is believed at once; in clutter, none is before
//! it was sighted again. `looking.rs` takes the looks, `doubtful.rs` says what may not be believed yet.

use crate::association::Identities;
use crate::config::{Config, Removal};
use crate::diagnosis::detectability::{Detectability, Place};
use crate::diagnosis::looks::is_another_look;
use crate::geometry::Pose;
use crate::math;
use crate::measurement::Common;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// In one look of so many at least, something else is taken for a landmark that does not exist: sightings of what nobody
/// founded a landmark for are not counted.
const CHANCE_MIN: f64 = 0.05;
/// A landmark fades when it is so much less likely to exist than when it was founded, in nats, and its log-odds lie
/// below the second number: of one that was as good as sure to be real when it was founded, more is asked.
const FADED: [f64; 2] = [-4.6, -2.3];
/// Log-odds above which a landmark is believed to exist: nine to one.
const TRUSTED: f64 = 2.2;
/// Log-odds above which it is confirmed: a hundred to one.
const SURE: f64 = 4.6;
/// Landmarks that are taken to have turned out real before any did.
const REAL_BEFORE: f64 = 5.0;

/// What is known of one of several sensors.
#[derive(Clone, Serialize, Deserialize)]
pub(super) struct Acuity {
    detectability: Detectability,
    /// Where it was at the last look.
    last: Option<Pose>,
}

impl Acuity {
    /// Of a sensor of which nothing is known but its limits.
    pub fn new(sensor: &Common) -> Self {
        Self { detectability: Detectability::new(sensor), last: None }
    }
}

/// What speaks for and against the landmarks, and what is known of the sensor.
#[derive(Clone, Serialize, Deserialize)]
pub(super) struct Fading {
    detectability: Detectability,
    /// Where the sensor was at the last look.
    last: Option<Pose>,
    /// By birth, how much more or less likely it is that a landmark exists than when it was founded, in nats; without
    /// bound for those that are confirmed.
    evidence: BTreeMap<u64, f64>,
    /// Landmarks that were confirmed, and those that have faded.
    confirmed: u64,
    faded: u64,
    scans: u64,
}

/// A look at a landmark in view.
#[derive(Clone, Copy, Debug)]
pub(super) struct Look {
    pub slot: u32,
    pub place: Place,
    pub sighted: bool,
    /// Area in which a sighting is taken for it, m·rad.
    pub gate_area: f64,
    /// Whether it was sighted often enough to be confirmed.
    pub is_often_sighted: bool,
    /// What the probability that a landmark in view is sighted was told to be at best.
    pub told_detection: Option<f64>,
}

impl Fading {
    /// Nothing yet; `None` where landmarks do not fade.
    pub fn of(config: &Config, identities: Identities) -> Option<Self> {
        let fades = identities != Identities::All && config.association.existence.removal == Removal::Unconfirmed;
        fades.then(|| Self {
            detectability: Detectability::new(config.sensor.common()),
            last: None,
            evidence: BTreeMap::new(),
            confirmed: 0,
            faded: 0,
            scans: 0,
        })
    }

    /// Exchanges what is known of the sensor that looks with that of another one.
    pub fn swap(&mut self, other: &mut Acuity) {
        std::mem::swap(&mut self.detectability, &mut other.detectability);
        std::mem::swap(&mut self.last, &mut other.last);
    }

    /// A scan came.
    pub fn scanned(&mut self) {
        self.scans += 1;
    }

    /// Whether a look from here says anything new; then it counts as taken.
    pub fn begins(&mut self, sensor: Pose) -> bool {
        let new = self.last.is_none_or(|last| is_another_look(last, sensor, self.far_m()));
        if new {
            self.last = Some(sensor);
        }
        new
    }

    /// The farthest that the sensor sees, metres.
    pub fn far_m(&self) -> f64 {
        self.detectability.far_m()
    }

    /// Where something stands before the sensor; `None` where the sensor does not see.
    pub fn place(&self, [range_m, bearing_rad]: [f64; 2]) -> Option<Place> {
        self.detectability.place(range_m, bearing_rad)
    }

    /// Whether nothing that was founded has faded yet: then all of it is believed.
    pub fn is_credulous(&self) -> bool {
        self.faded == 0
    }

    /// Whether a landmark is believed to exist.
    pub fn trusts(&self, birth: u64) -> bool {
        self.is_credulous() || self.log_odds(birth, self.faded) > TRUSTED
    }

    /// Whether nothing speaks against a landmark, or it is believed to exist all the same.
    pub fn may_exist(&self, birth: u64) -> bool {
        self.trusts(birth) || self.evidence(birth) >= 0.0
    }

    /// Density of false sightings so far, 1/(m·rad): those that founded what has faded.
    pub fn clutter_density(&self) -> f64 {
        self.faded as f64 / (self.scans.max(1) as f64 * self.detectability.area())
    }

    /// Takes note of a look at a landmark, for the existence of which somebody may vouch; returns whether it has faded.
    pub fn looked(&mut self, birth: u64, look: &Look, vouched_for: bool) -> bool {
        if vouched_for || self.evidence(birth) == f64::INFINITY {
            self.detectability.looked(look.place, look.sighted);
            return false;
        }
        *self.evidence.entry(birth).or_insert(0.0) += self.news(look);
        if look.is_often_sighted && (self.is_credulous() || self.log_odds(birth, self.faded) > SURE) {
            self.evidence.insert(birth, f64::INFINITY);
            self.confirmed += 1;
        }
        // As if this one had faded too.
        let faded = self.evidence(birth) < FADED[0] && self.log_odds(birth, self.faded + 1) < FADED[1];
        if faded {
            self.evidence.remove(&birth);
            self.faded += 1;
        }
        faded
    }

    fn evidence(&self, birth: u64) -> f64 {
        self.evidence.get(&birth).copied().unwrap_or(0.0)
    }

    /// The log-odds that a landmark exists: those of all that were founded, so many of which have faded, and what speaks
    /// for and against this one.
    fn log_odds(&self, birth: u64, faded: u64) -> f64 {
        math::ln((self.confirmed as f64 + REAL_BEFORE) / faded as f64) + self.evidence(birth)
    }

    /// By how much a look changes the log-odds that a landmark exists, ln P_D / P_c or ln (1 − P_D) / (1 − P_c): P_D the
    /// probability that the sensor shows it, P_c that chance does.
    fn news(&self, look: &Look) -> f64 {
        let Some(learned) = self.detectability.probability(look.place) else { return 0.0 };
        let shown = learned.min(look.told_detection.unwrap_or(1.0));
        let chance = (1.0 - math::exp(-look.gate_area * self.clutter_density())).max(CHANCE_MIN);
        if look.sighted {
            math::ln(shown / chance).max(0.0)
        } else {
            math::ln((1.0 - shown) / (1.0 - chance)).min(0.0)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fading() -> Fading {
        let config = Config::default();
        Fading::of(&config, Identities::None).unwrap()
    }

    fn look(fading: &Fading, sighted: bool, is_often_sighted: bool) -> Look {
        let place = fading.place([3.0, 0.1]).unwrap();
        Look { slot: 0, place, sighted, gate_area: 1e-3, is_often_sighted, told_detection: None }
    }

    /// A landmark that was sighted so often in a hundred looks.
    fn learn(fading: &mut Fading, birth: u64, sighted: u64) {
        fading.looked(birth, &look(fading, true, true), false);
        (0..100).for_each(|i| assert!(!fading.looked(birth, &look(fading, i < sighted, true), false)));
    }

    #[test]
    fn nothing_fades_before_it_is_known_what_the_sensor_shows() {
        let mut fading = fading();
        assert!((0..1000).all(|_| !fading.looked(7, &look(&fading, false, false), false)));
    }

    #[test]
    fn what_a_good_sensor_misses_fades_sooner_than_what_a_bad_one_misses() {
        let misses = |sighted: u64| {
            let mut fading = fading();
            learn(&mut fading, 0, sighted);
            (1..1000).find(|_| fading.looked(7, &look(&fading, false, false), false))
        };
        let [good, bad, blind] = [90, 40, 1].map(misses);
        assert!(good.is_some_and(|misses| misses <= 4), "{good:?}");
        assert!(bad.is_some_and(|misses| (8..20).contains(&misses)), "{bad:?}");
        assert_eq!(blind, None);
    }

    #[test]
    fn what_is_told_of_the_sensor_is_the_most_that_is_believed_to_be_shown() {
        let news = |told_detection| {
            let mut fading = fading();
            learn(&mut fading, 0, 80);
            fading.news(&Look { told_detection, ..look(&fading, false, false) })
        };
        assert_eq!(news(Some(0.95)), news(None));
        assert!(news(Some(0.3)) > 0.5 * news(None), "{:?} {:?}", news(Some(0.3)), news(None));
    }

    #[test]
    fn what_was_founded_before_says_what_to_believe_of_the_next() {
        let mut fading = fading();
        learn(&mut fading, 0, 80);
        assert!(fading.trusts(1000) && fading.clutter_density() == 0.0);
        for birth in 1..40 {
            fading.scanned();
            while !fading.looked(birth, &look(&fading, false, false), false) {}
        }
        assert!(fading.trusts(0) && !fading.trusts(1000) && fading.may_exist(1000));
        let expected = 1.0 / fading.detectability.area();
        assert!((fading.clutter_density() - expected).abs() < 1e-12);
        fading.looked(1000, &look(&fading, true, false), false);
        assert!(!fading.trusts(1000), "once is not enough in clutter");
        (0..3).for_each(|_| assert!(!fading.looked(1000, &look(&fading, true, false), false)));
        assert!(fading.trusts(1000));
    }
}
