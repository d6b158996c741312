//! What the filter knows of the landmarks of a given map.
//!
//! Their births are the lowest numbers: what the map knows of a landmark is found by its birth.

use crate::geometry::Pose;
use crate::given::{GivenLandmark, Role};
use crate::smoothing::Known;
use serde::{Deserialize, Serialize};

/// What was given, and what became of it.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(super) struct Given {
    /// By birth.
    pub landmarks: Vec<GivenLandmark>,
    /// In how many scans the best particle has sighted each, and in how many it missed it though it was in view.
    pub seen: Vec<[u32; 2]>,
    /// Whether some landmark of the map was sighted.
    pub is_entered: bool,
    /// Mean of the poses at the start, where it is not the configured one.
    pub start: Option<Pose>,
}

impl Given {
    /// What the map says of a landmark, by its birth; `None` for those of the filter's own.
    pub fn of(&self, birth: u64) -> Option<&GivenLandmark> {
        self.landmarks.get(birth as usize)
    }

    /// Whether nothing may change a landmark.
    pub fn is_fixed(&self, birth: u64) -> bool {
        self.of(birth).is_some_and(|landmark| landmark.role == Role::Fixed)
    }

    /// What a draw of paths must know of a landmark.
    pub fn known(&self, birth: u64) -> Known {
        match self.of(birth) {
            None => Known::Nothing,
            Some(landmark) if landmark.role == Role::Fixed => Known::Place(landmark.place),
            Some(landmark) => Known::Prior(landmark.place),
        }
    }

    /// Whether particles decide about a landmark themselves, however long ago it was seen: fixed ones, and those of a
    /// map of which nothing was seen yet, since the particles are spread as the start is uncertain.
    pub fn is_sure(&self, birth: u64) -> bool {
        self.of(birth).is_some_and(|landmark| landmark.role == Role::Fixed || !self.is_entered)
    }

    /// The birth that stands for what a landmark is tied to: all of a map lie together, whichever was seen last.
    pub fn clan(&self, birth: u64) -> u64 {
        if birth < self.landmarks.len() as u64 {
            0
        } else {
            birth
        }
    }

    /// What became of a landmark; `None` for the filter's own.
    pub fn used(&self, birth: u64) -> Option<GivenUse> {
        let landmark = self.of(birth)?;
        let [sighted, missed] = self.seen.get(birth as usize).copied().unwrap_or_default();
        Some(GivenUse { role: landmark.role, sighted, missed })
    }
}

/// What became of a given landmark.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GivenUse {
    /// What sightings may do to it.
    pub role: Role,
    /// Scans in which the best particle sighted it.
    pub sighted: u32,
    /// Scans in which it was in view and not sighted.
    pub missed: u32,
}
