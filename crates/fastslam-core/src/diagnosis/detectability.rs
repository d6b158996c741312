//! How probable it is that a landmark in view is sighted, by where it stands before the sensor: learned from the run.
//!
//! One number for a whole sensor is wrong nearly everywhere: detectors see less of what is far, of what is at the border
//! of the view, and nothing of what stands behind something else.

use crate::math;
use crate::measurement::Common;
use serde::{Deserialize, Serialize};

/// Rings of the view: each ends at 1/√2 of the range of the one around it, the innermost takes the rest.
const RINGS: usize = 10;
/// Equal sectors of the field of view.
const SECTORS: usize = 6;
/// Looks that a ring needs before anything is known of it.
const LOOKS_TO_KNOW: f64 = 20.0;
/// What was learned of its ring counts for so many looks in a sector.
const LOOKS_BEFORE: f64 = 10.0;
/// However well a detector has done, one look in so many may fail: by a thing that hides another, for one.
const MOST: f64 = 0.9;

/// Where a landmark stands before the sensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Place {
    ring: usize,
    sector: usize,
}

/// Looks, and how many of them found the landmark.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
struct Looks {
    looks: u32,
    found: u32,
}

impl Looks {
    /// The share that found the landmark; 0 where there were none.
    fn found_share(self) -> f64 {
        f64::from(self.found) / f64::from(self.looks.max(1))
    }

    /// The same, with what was expected before counting for as much as so many looks.
    fn share(self, expected: f64) -> f64 {
        (f64::from(self.found) + LOOKS_BEFORE * expected) / (f64::from(self.looks) + LOOKS_BEFORE)
    }
}

/// How often landmarks in view were sighted.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Detectability {
    near_m: f64,
    far_m: f64,
    half_view_rad: f64,
    places: Vec<Looks>,
    rings: Vec<Looks>,
}

impl Detectability {
    /// Of a sensor of which nothing is known but its limits.
    pub fn new(sensor: &Common) -> Self {
        Self {
            near_m: sensor.min_range_m,
            far_m: sensor.max_range_m,
            half_view_rad: 0.5 * sensor.field_of_view_rad,
            places: vec![Looks::default(); RINGS * SECTORS],
            rings: vec![Looks::default(); RINGS],
        }
    }

    /// The farthest that is in view, metres.
    pub fn far_m(&self) -> f64 {
        self.far_m
    }

    /// Range times field of view, m·rad.
    pub fn area(&self) -> f64 {
        2.0 * self.half_view_rad * self.far_m
    }

    /// Where something stands before the sensor; `None` where the sensor does not see.
    pub fn place(&self, range_m: f64, bearing_rad: f64) -> Option<Place> {
        if !(range_m > self.near_m && range_m < self.far_m && bearing_rad.abs() < self.half_view_rad) {
            return None;
        }
        let halvings = 2.0 * math::ln(self.far_m / range_m) / std::f64::consts::LN_2;
        let share = 0.5 * (bearing_rad / self.half_view_rad + 1.0);
        let sector = (share * SECTORS as f64) as usize;
        Some(Place { ring: (halvings as usize).min(RINGS - 1), sector: sector.min(SECTORS - 1) })
    }

    /// A landmark that is known to exist was in view.
    pub fn looked(&mut self, place: Place, sighted: bool) {
        for looks in [&mut self.rings[place.ring], &mut self.places[place.ring * SECTORS + place.sector]] {
            looks.looks = looks.looks.saturating_add(1);
            looks.found = looks.found.saturating_add(u32::from(sighted));
        }
    }

    /// The probability that a landmark here is sighted; `None` while too little was seen around here.
    pub fn probability(&self, place: Place) -> Option<f64> {
        let ring = self.rings[place.ring];
        let known = f64::from(ring.looks) >= LOOKS_TO_KNOW;
        known.then(|| self.here(place).share(ring.found_share()).min(MOST))
    }

    fn here(&self, place: Place) -> Looks {
        self.places[place.ring * SECTORS + place.sector]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measurement::Sensor;

    fn sensor() -> Detectability {
        let common = *Sensor::default().common();
        Detectability::new(&Common { min_range_m: 0.5, max_range_m: 16.0, field_of_view_rad: 3.0, ..common })
    }

    #[test]
    fn what_the_sensor_does_not_see_has_no_place() {
        let known = sensor();
        for (range_m, bearing_rad) in [(0.4, 0.0), (16.1, 0.0), (2.0, 1.6), (2.0, -1.6)] {
            assert_eq!(known.place(range_m, bearing_rad), None, "{range_m} m, {bearing_rad} rad");
        }
        let at = |range_m, bearing_rad| known.place(range_m, bearing_rad).unwrap();
        assert_eq!(at(15.9, -1.49), Place { ring: 0, sector: 0 });
        assert_eq!(at(8.1, 1.49), Place { ring: 1, sector: SECTORS - 1 });
        assert_eq!(at(7.9, 0.01), Place { ring: 2, sector: SECTORS / 2 });
    }

    #[test]
    fn rings_and_sectors_are_told_apart_and_nothing_is_known_without_looks() {
        let mut known = sensor();
        let [near, far, aside] = [(2.0, 0.1), (15.0, 0.1), (2.0, 1.4)].map(|(r, b)| known.place(r, b).unwrap());
        for look in 0..400 {
            known.looked(near, look % 10 != 0);
            known.looked(far, look % 10 == 0);
            known.looked(aside, look % 2 == 0);
        }
        let close = |place, expected: f64| (known.probability(place).unwrap() - expected).abs() < 0.02;
        assert!(close(near, 0.9) && close(far, 0.1) && close(aside, 0.5));
        assert_eq!(known.probability(known.place(5.0, 0.0).unwrap()), None);
    }
}
