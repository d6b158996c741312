//! Sightings whose names do not fit: were the names misread, or is the robot elsewhere?
//!
//! A misread name shows its landmark anywhere. A robot that is not where the filter thinks sees all landmarks moved
//! alike: as a rigid body, and where it has only drifted, by the same way. So sightings are compared with each other,
//! those of a scan and those that were left out lately; what agrees is believed.

use crate::association::GATE;
use crate::geometry::Symmetric2;
use serde::{Deserialize, Serialize};

/// Misfits that were left out are kept for comparison over so many scans, and so many of them at most.
///
/// **Why:** what a robot that is elsewhere sees comes together; misread names of a long time would agree by chance.
const SCANS_KEPT: u64 = 10;
const KEPT: usize = 16;
/// A sighting that does not fit, in the world.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Misplaced {
    pub identity: u32,
    /// Where the map has the landmark, metres.
    pub held_m: [f64; 2],
    /// Where the sighting shows it, metres.
    pub shown_m: [f64; 2],
    /// Variance of either along any direction, without the pose, square metres.
    pub variance_m2: f64,
    /// Variance of the robot's turn since it saw the landmark last, rad², where its drift since then explains the misfit.
    pub turn: Option<f64>,
}

impl Misplaced {
    /// Of a landmark and a sighting, each with its covariance.
    pub fn new(
        identity: u32,
        (held_m, held): ([f64; 2], Symmetric2),
        (shown_m, shown): ([f64; 2], Symmetric2),
    ) -> Self {
        let variance_m2 = held.largest_eigenvalue() + shown.largest_eigenvalue();
        Self { identity, held_m, shown_m, variance_m2, turn: None }
    }

    /// Whether the two lie as far from each other as their landmarks do: one rigid motion of the robot may explain both.
    fn fits_with(&self, other: &Self, excess: f64) -> bool {
        let distance = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]);
        let off = distance(self.shown_m, other.shown_m) - distance(self.held_m, other.held_m);
        let variance = self.variance_m2 + other.variance_m2;
        self.identity != other.identity && off * off <= GATE * excess * variance
    }

    /// Whether drift explains both, and the same drift.
    fn drifted_with(&self, other: &Self, excess: f64) -> bool {
        let (Some(turn), Some(others)) = (self.turn, other.turn) else { return false };
        let [held, moved] = [0, 1].map(|i| {
            let [a, b] = [self, other].map(|one| (one.held_m[i], one.shown_m[i]));
            [a.0 - b.0, (a.1 - a.0) - (b.1 - b.0)]
        });
        let turned = turn.max(others) * (held[0] * held[0] + moved[0] * moved[0]);
        let off = held[1] * held[1] + moved[1] * moved[1];
        let variance = self.variance_m2 + other.variance_m2 + turned;
        self.identity != other.identity && off <= GATE * excess * variance
    }
}

/// Misfits that were left out lately.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct Lately {
    scans: u64,
    /// With the scan of each.
    left_out: Vec<(u64, Misplaced)>,
}

impl Lately {
    /// Which of the misfits of a scan are believed: those that agree with another by drift, or with two others, of
    /// different names, as a rigid body with more names than fit in the scan. Where the pose is doubted and nothing in the
    /// scan fits, with one; or alone, where the scan shows no other name.
    pub fn believe(&mut self, scan: &[Misplaced], beside: &Beside) -> Vec<bool> {
        let Beside { fits: others, excess, pose_is_doubted } = *beside;
        self.scans += 1;
        if scan.is_empty() {
            return Vec::new();
        }
        self.left_out.retain(|(of, _)| of + SCANS_KEPT > self.scans);
        let all: Vec<&Misplaced> = scan.iter().chain(self.left_out.iter().map(|(_, one)| one)).collect();
        let fits = |a: &Misplaced, b: &Misplaced| a.fits_with(b, excess);
        let is_believed = |one: &Misplaced| {
            let partners: Vec<&Misplaced> = all.iter().copied().filter(|other| fits(one, other)).collect();
            let body = partners.iter().map(|a| partners.iter().filter(|b| fits(a, b)).count() + 2).max();
            let doubted = pose_is_doubted && others == 0;
            all.iter().any(|other| one.drifted_with(other, excess))
                || body.is_some_and(|names| names > others.max(2))
                || (doubted && (scan.len() == 1 || !partners.is_empty()))
        };
        let believed: Vec<bool> = scan.iter().map(is_believed).collect();
        if believed.iter().any(|one| *one) {
            // The pose will be another one.
            self.left_out.clear();
        }
        let left_out = scan.iter().zip(&believed).filter(|(_, believed)| !**believed);
        self.left_out.extend(left_out.map(|(one, _)| (self.scans, *one)));
        self.left_out.drain(..self.left_out.len().saturating_sub(KEPT));
        believed
    }
}

/// What else is known where sightings do not fit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Beside {
    /// Known names of the scan that fit.
    pub fits: usize,
    /// By how much squared errors exceed what the noise explains.
    pub excess: f64,
    /// Whether much did not fit lately.
    pub pose_is_doubted: bool,
}

#[cfg(test)]
mod tests {
    use super::*;

    const HELD: [[f64; 2]; 4] = [[0.0, 0.0], [4.0, 1.0], [-3.0, 7.0], [9.0, -2.0]];

    fn misplaced(identity: usize, shown_m: [f64; 2], turn: Option<f64>) -> Misplaced {
        Misplaced { identity: identity as u32, held_m: HELD[identity], shown_m, variance_m2: 0.01, turn }
    }

    fn beside(fits: usize, pose_is_doubted: bool) -> Beside {
        Beside { fits, excess: 1.0, pose_is_doubted }
    }

    /// Turned by a radian and moved.
    fn carried(identity: usize) -> Misplaced {
        let ([x, y], (s, c)) = (HELD[identity], 1.0_f64.sin_cos());
        misplaced(identity, [c * x - s * y + 20.0, s * x + c * y - 5.0], None)
    }

    /// Drifted by a metre and a half.
    fn drifted(identity: usize) -> Misplaced {
        let [x, y] = HELD[identity];
        misplaced(identity, [x + 1.5, y + 0.2], Some(1e-4))
    }

    #[test]
    fn misread_names_are_not_believed_however_many() {
        let mut lately = Lately::default();
        let elsewhere = [[30.0, 2.0], [-8.0, 14.0], [5.0, -21.0], [17.0, 60.0]];
        for (name, shown) in elsewhere.into_iter().enumerate() {
            assert_eq!(lately.believe(&[misplaced(name, shown, Some(1e-4))], &beside(4, false)), [false]);
        }
        // Nor one name that is misread the same way again and again.
        for _ in 0..20 {
            assert_eq!(lately.believe(&[misplaced(0, [30.0, 2.0], Some(1e-4))], &beside(4, false)), [false]);
        }
    }

    #[test]
    fn two_that_drift_explains_alike_are_believed_in_one_scan_or_in_two() {
        assert_eq!(Lately::default().believe(&[drifted(0), drifted(2)], &beside(4, false)), [true, true]);
        let mut lately = Lately::default();
        assert_eq!(lately.believe(&[drifted(1)], &beside(4, false)), [false]);
        assert_eq!(
            lately.believe(&[misplaced(3, [0.0, 0.0], Some(1e-4)), drifted(2)], &beside(4, false)),
            [false, true]
        );
        assert_eq!(lately.left_out.len(), 1);
    }

    #[test]
    fn three_that_moved_as_one_body_are_believed_and_two_only_where_the_pose_is_doubted() {
        assert_eq!(Lately::default().believe(&[0, 1, 3].map(carried), &beside(2, false)), [true; 3]);
        assert_eq!(Lately::default().believe(&[0, 1, 3].map(carried), &beside(3, false)), [false; 3]);
        assert_eq!(Lately::default().believe(&[0, 1].map(carried), &beside(0, false)), [false; 2]);
        assert_eq!(Lately::default().believe(&[0, 1].map(carried), &beside(0, true)), [true; 2]);
        let strange = misplaced(2, [1.0, 1.0], None);
        assert_eq!(Lately::default().believe(&[carried(0), strange], &beside(0, true)), [false; 2]);
    }

    #[test]
    fn a_name_alone_is_believed_where_the_pose_is_doubted() {
        assert_eq!(Lately::default().believe(&[carried(1)], &beside(0, true)), [true]);
        assert_eq!(Lately::default().believe(&[carried(1)], &beside(1, true)), [false]);
    }
}
