//! Where a landmark may be in one particle's map: one Gaussian, or several with their odds.

use super::past::Noise;
use super::sensing::Look;
use crate::gaussian::{Gaussian, GaussianOf};
use crate::math;
use crate::normal::{congruence, sum, Matrix, Normal};
use serde::{Deserialize, Serialize};

/// Components with a smaller share of the likeliest one's are dropped.
const LEAST_SHARE: f64 = 1e-4;
/// With so much of all shares a component is the landmark.
const CERTAIN: f64 = 0.999;
/// Components nearer than this (Mahalanobis distance squared of their difference) become one.
const SAME: f64 = 0.5;
/// A landmark counts as placed when its longest axis is shorter than this fraction of its distance.
///
/// **Why:** then the curvature of a ring, half of σ² / r, is a twentieth of σ.
const NARROW: f64 = 0.1;

/// A component.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(super) struct Part {
    /// Logarithm of its share; the shares sum to 1.
    pub log_share: f64,
    pub gaussian: Gaussian,
}

/// Where a landmark may be.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) enum Place {
    One(Gaussian),
    Many(Vec<Part>),
}

impl Place {
    /// After a first sighting; nowhere where the sensor gave no component.
    pub fn born(components: &[(f64, Normal<2>)]) -> Option<Self> {
        let usable = components.iter().filter(|(share, _)| *share > 0.0);
        let parts: Vec<Part> = usable
            .map(|(share, normal)| Part { log_share: math::ln(*share), gaussian: Gaussian::from(*normal) })
            .filter(|part| part.gaussian.is_usable())
            .collect();
        match parts[..] {
            [] => None,
            [part] => Some(Self::One(part.gaussian)),
            _ => {
                let mut place = Self::Many(parts);
                place.normalize();
                Some(place)
            }
        }
    }

    /// The components.
    pub fn parts(&self) -> Vec<Part> {
        match self {
            Self::One(gaussian) => vec![Part { log_share: 0.0, gaussian: *gaussian }],
            Self::Many(parts) => parts.clone(),
        }
    }

    /// The Gaussian of a landmark that is placed, as seen from here.
    pub fn placed(&self, [x, y]: [f64; 2]) -> Option<Gaussian> {
        let Self::One(gaussian) = self else { return None };
        let distance = (gaussian.mean[0] - x).hypot(gaussian.mean[1] - y);
        let longest = gaussian.covariance.largest_eigenvalue().sqrt();
        (longest < NARROW * distance.max(longest)).then_some(*gaussian)
    }

    /// Takes in a sighting, of which `looks` are those at the components, and gives the logarithm of its likelihood;
    /// minus infinity, and nothing is changed, where it cannot be computed.
    pub fn correct<const Z: usize>(&mut self, looks: &[Look<Z>], noise: &Noise<Z>) -> f64 {
        let mut parts = self.parts();
        let mut total = f64::NEG_INFINITY;
        for (part, look) in parts.iter_mut().zip(looks) {
            let likelihood = part.correct(look, noise).filter(|v| v.is_finite()).unwrap_or(f64::NEG_INFINITY);
            part.log_share += likelihood;
            total = log_sum(total, part.log_share);
        }
        if !total.is_finite() {
            return f64::NEG_INFINITY;
        }
        match (&mut *self, parts.as_slice()) {
            (Self::One(gaussian), [part]) => *gaussian = part.gaussian,
            _ => {
                *self = Self::Many(parts);
                self.normalize();
                self.thin();
            }
        }
        total
    }

    /// Makes the shares sum to 1.
    fn normalize(&mut self) {
        let Self::Many(parts) = self else { return };
        let total = parts.iter().fold(f64::NEG_INFINITY, |sum, part| log_sum(sum, part.log_share));
        parts.iter_mut().for_each(|part| part.log_share -= total);
    }

    /// Drops what the evidence has ruled out, and makes one of what has become one.
    fn thin(&mut self) {
        let Self::Many(parts) = self else { return };
        parts.sort_by(|a, b| b.log_share.total_cmp(&a.log_share));
        let least = parts[0].log_share + math::ln(LEAST_SHARE);
        parts.retain(|part| part.log_share >= least);
        let mut kept: Vec<Part> = Vec::with_capacity(parts.len());
        for part in parts.iter() {
            let near = |other: &&mut Part| other.gaussian.distance_squared(&part.gaussian, 0.0) < SAME;
            match kept.iter_mut().find(near) {
                Some(other) => *other = other.merged(part),
                None => kept.push(*part),
            }
        }
        *parts = kept;
        self.normalize();
        let Self::Many(parts) = self else { return };
        if let Some(part) = parts.iter().find(|part| part.log_share >= math::ln(CERTAIN)) {
            *self = Self::One(part.gaussian);
        }
    }

    /// Mean and covariance of all components together.
    pub fn moments(&self) -> Normal<2> {
        let parts: Vec<(f64, Normal<2>)> =
            self.parts().iter().map(|part| (math::exp(part.log_share), part.gaussian.normal())).collect();
        Normal::of_mixture(parts.iter().map(|(share, normal)| (*share, normal)))
    }

    /// Whether its numbers can be computed with.
    pub fn is_usable(&self) -> bool {
        match self {
            Self::One(gaussian) => gaussian.is_usable(),
            Self::Many(parts) => parts.iter().all(|part| part.log_share.is_finite() && part.gaussian.is_usable()),
        }
    }
}

impl Part {
    /// As [`crate::landmark::correct`], for any number of numbers; `None` where nothing can be said, and nothing is
    /// changed.
    fn correct<const Z: usize>(&mut self, look: &Look<Z>, noise: &Noise<Z>) -> Option<f64> {
        let seen = (&look.innovation, &look.by_landmark);
        let (corrected, fitted) = self.gaussian.normal().corrected(seen, &noise.covariance, noise.tail)?;
        let corrected = Gaussian::from(corrected);
        if corrected.is_usable() {
            self.gaussian = corrected;
        }
        Some(fitted.log_likelihood)
    }

    fn merged(&self, other: &Self) -> Self {
        let log_share = log_sum(self.log_share, other.log_share);
        let (a, b) = (self.gaussian.normal(), other.gaussian.normal());
        let shares = [self.log_share, other.log_share].map(|log| math::exp(log - log_share));
        let gaussian = Gaussian::from(Normal::of_mixture([(shares[0], &a), (shares[1], &b)].into_iter()));
        Self { log_share, gaussian }
    }
}

/// Q = G_θ Σ G_θᵀ + R.
pub(super) fn spread_of<const Z: usize>(look: &Look<Z>, landmark: &Gaussian, noise: &Matrix<Z, Z>) -> Matrix<Z, Z> {
    sum(&congruence(&look.by_landmark, &landmark.normal().covariance), noise)
}

/// ln(eᵃ + eᵇ).
pub(super) fn log_sum(a: f64, b: f64) -> f64 {
    let (most, least) = if a > b { (a, b) } else { (b, a) };
    if least == f64::NEG_INFINITY {
        return most;
    }
    most + math::ln(1.0 + math::exp(least - most))
}

#[cfg(test)]
mod tests {
    use super::super::sensing::{Calibration, Request, Sensing};
    use super::*;
    use crate::density::Tail;
    use crate::geometry::{Pose, Symmetric2};
    use crate::measurement::RangeOnly;

    const MODEL: RangeOnly = RangeOnly { range_std_m: 0.3 };
    const BEACON: [f64; 2] = [8.0, 6.0];

    fn heard_from(place: Option<Place>, poses: &[[f64; 2]], off_m: f64) -> Place {
        let noise = Noise { covariance: Sensing::noise(&MODEL), tail: Tail::Gaussian };
        poses
            .iter()
            .fold(place, |place, &[x, y]| {
                let (pose, range) = (Pose::new(x, y, 0.0), (BEACON[0] - x).hypot(BEACON[1] - y) + off_m);
                let Some(mut place) = place else {
                    let births = Sensing::births(&MODEL, &[(pose, [range])], &noise.covariance).unwrap();
                    return Place::born(&births[0]);
                };
                let request = |part: &Part| Request {
                    T_world_sensor: pose,
                    landmark: part.gaussian.mean,
                    measured: [range],
                    calibration: Calibration::NONE,
                };
                let looks = MODEL.look(&place.parts().iter().map(request).collect::<Vec<_>>()).unwrap();
                assert!(place.correct(&looks, &noise).is_finite());
                Some(place)
            })
            .unwrap()
    }

    #[test]
    fn a_straight_drive_leaves_two_places_and_a_turn_leaves_one() {
        let straight: Vec<[f64; 2]> = (0..30).map(|i| [0.5 * f64::from(i), 0.0]).collect();
        let place = heard_from(None, &straight, 0.0);
        let Place::Many(parts) = &place else { panic!("one place after a straight drive: {place:?}") };
        let sides = |sign: f64| {
            let near = |part: &&Part| (part.gaussian.mean[1] - sign * 6.0).abs() < 0.5;
            parts.iter().filter(near).map(|part| part.log_share.exp()).sum::<f64>()
        };
        assert!((sides(1.0) - 0.5).abs() < 0.05 && (sides(-1.0) - 0.5).abs() < 0.05, "{parts:?}");
        assert!(place.placed([15.0, 0.0]).is_none());
        let turned: Vec<[f64; 2]> = (0..30).map(|i| [15.0, 0.3 * f64::from(i)]).collect();
        let place = heard_from(Some(place), &turned, 0.0);
        let found = place.placed([15.0, 9.0]).expect("one place after a turn");
        assert!((found.mean[0] - 8.0).hypot(found.mean[1] - 6.0) < 0.3, "{found:?}");
    }

    #[test]
    fn a_sighting_that_cannot_be_computed_changes_nothing() {
        let mut place = Place::One(Gaussian { mean: BEACON, covariance: Symmetric2::new(1.0, 0.0, 1.0) });
        let look = Look { innovation: [f64::NAN], by_scale: 1.0, by_landmark: [[1.0, 0.0]], by_pose: [[0.0; 3]] };
        let noise = Noise { covariance: [[0.1]], tail: Tail::Gaussian };
        assert_eq!(place.correct(&[look], &noise), f64::NEG_INFINITY);
        assert!(matches!(place, Place::One(gaussian) if gaussian.mean == BEACON));
    }
}
