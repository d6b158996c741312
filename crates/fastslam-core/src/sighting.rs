//! What a detector reports of a landmark, and what a filter makes of it.

use crate::density::Tail;
use crate::geometry::Symmetric2;
use serde::{Deserialize, Serialize};

/// One detection of a landmark.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Sighting {
    /// In the coordinates of the measurement model; (range in m, bearing in rad) for [`crate::measurement::RangeBearing`].
    pub value: [f64; 2],
    /// Which landmark it is, where somebody says so.
    pub identity: Option<u32>,
    /// Covariance of (range, bearing) when the detector gives one.
    pub noise: Option<Symmetric2>,
    /// What it looks like, when the detector says so.
    pub appearance: Appearance,
}

impl Sighting {
    /// Range in metres and bearing in radians, counter-clockwise from the sensor's heading, with the sensor's noise.
    pub fn range_bearing(range_m: f64, bearing_rad: f64, identity: Option<u32>) -> Self {
        Self { value: [range_m, bearing_rad], identity, noise: None, appearance: Appearance::default() }
    }

    /// A range alone, in metres, with the sensor's noise.
    pub fn range(range_m: f64, identity: Option<u32>) -> Self {
        Self::range_bearing(range_m, 0.0, identity)
    }
}

/// All that one sensor saw at one moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scan<'a> {
    /// Seconds.
    pub stamp_s: f64,
    /// Number of the sensor: its place in the order of the names in `Config::sensors`, 0 where there is one.
    pub sensor: usize,
    /// What it saw; there may be nothing.
    pub sightings: &'a [Sighting],
}

impl<'a> Scan<'a> {
    /// Of the only sensor.
    pub fn new(stamp_s: f64, sightings: &'a [Sighting]) -> Self {
        Self { stamp_s, sensor: 0, sightings }
    }
}

/// Deals sightings out into rounds that see each name once at most; returns how many there are, one at least. `rounds` keeps
/// its memory.
///
/// **Why:** two sightings with one identity are not independent given the pose's prior: the second waits for the first.
pub(crate) fn deal<T>(
    rounds: &mut Vec<Vec<T>>,
    sightings: impl Iterator<Item = T>,
    name: impl Fn(&T) -> Option<u32>,
) -> usize {
    rounds.iter_mut().for_each(Vec::clear);
    if rounds.is_empty() {
        rounds.push(Vec::new());
    }
    let mut used = 1;
    for sighting in sightings {
        let own = name(&sighting);
        let free = |round: &Vec<T>| own.is_none() || round.iter().all(|other| name(other) != own);
        let round = rounds[..used].iter().position(free).unwrap_or(used);
        if round == rounds.len() {
            rounds.push(Vec::new());
        }
        rounds[round].push(sighting);
        used = used.max(round + 1);
    }
    used
}

/// What a detector reports of a landmark beside its place.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Appearance {
    /// Which class, from 0.
    pub class: Option<u32>,
    /// A number that belongs to the landmark.
    pub signature: Option<f64>,
}

/// What became of a sighting.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Taken {
    /// It shows this landmark, by birth.
    Landmark(u64),
    /// It founded this one.
    New(u64),
    /// It was left out.
    Nothing,
}

/// A sighting of the last scan, as measured, and what the best hypothesis took it for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Seen {
    /// In the coordinates of the measurement model.
    pub value: [f64; 2],
    /// What it was taken for.
    pub taken: Taken,
}

/// Sightings that could not be used, by reason.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Skipped {
    /// Holds what is no number, or numbers that no landmark gives: a bearing too large for an angle.
    pub not_finite: u32,
    /// Nearer than the sensor's minimum.
    pub too_near: u32,
    /// Farther than the sensor's maximum.
    pub too_far: u32,
    /// Without an identity, though identities are said to be known.
    pub without_identity: u32,
    /// With a covariance of their own that is not positive definite.
    pub bad_covariance: u32,
}

impl Skipped {
    /// Name and number of each reason: all there are, so that nobody keeps a second list.
    pub fn by_reason(&self) -> [(&'static str, u32); 5] {
        let Self { not_finite, too_near, too_far, without_identity, bad_covariance } = *self;
        [
            ("not_finite", not_finite),
            ("too_near", too_near),
            ("too_far", too_far),
            ("without_identity", without_identity),
            ("bad_covariance", bad_covariance),
        ]
    }

    /// Counts those of another step as well.
    pub fn add(&mut self, step: &Self) {
        self.not_finite += step.not_finite;
        self.too_near += step.too_near;
        self.too_far += step.too_far;
        self.without_identity += step.without_identity;
        self.bad_covariance += step.bad_covariance;
    }

    /// All of them.
    pub fn total(&self) -> u32 {
        self.by_reason().iter().map(|(_, count)| count).sum()
    }
}

/// A sighting as the passes over particles need it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Measured {
    /// In the coordinates of the measurement model.
    pub value: [f64; 2],
    /// R of this sighting.
    pub noise: Symmetric2,
    /// How the noise falls off.
    pub tail: Tail,
}

/// A sighting with what the scan knows about it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScanSighting {
    /// Value and noise.
    pub measured: Measured,
    /// Identity, where somebody says it.
    pub identity: Option<u32>,
    /// What it looks like, where the detector says so.
    pub appearance: Appearance,
}
