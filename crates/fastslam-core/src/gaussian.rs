//! Gaussians of two dimensions: product, distance, moments of a mixture.

use crate::geometry::Symmetric2;
use crate::limits::LARGEST_STATE;

/// A landmark's Gaussian in one map.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Gaussian {
    /// Position in the world, metres.
    pub mean: [f64; 2],
    /// Square metres.
    pub covariance: Symmetric2,
}

impl Gaussian {
    /// The mixture of `parts` (share and component) whose mean this is: covariance within plus between them.
    pub fn mixture_about(mean: [f64; 2], parts: impl Iterator<Item = (f64, Self)>) -> Self {
        let mut covariance = Symmetric2::default();
        for (share, part) in parts {
            let d = [part.mean[0] - mean[0], part.mean[1] - mean[1]];
            covariance.xx += share * (part.covariance.xx + d[0] * d[0]);
            covariance.xy += share * (part.covariance.xy + d[0] * d[1]);
            covariance.yy += share * (part.covariance.yy + d[1] * d[1]);
        }
        Self { mean, covariance }
    }
}

/// The squared Mahalanobis distance of two landmarks, with this variance added to that of their difference.
pub fn distance_squared(a: &Gaussian, b: &Gaussian, more: f64) -> f64 {
    let (p, q) = (&a.covariance, &b.covariance);
    let s = Symmetric2::new(p.xx + q.xx + more, p.xy + q.xy, p.yy + q.yy + more);
    let [x, y] = [a.mean[0] - b.mean[0], a.mean[1] - b.mean[1]];
    (s.yy * x * x - 2.0 * s.xy * x * y + s.xx * y * y) / s.determinant()
}

/// The normalised product of two Gaussians.
pub fn product(a: &Gaussian, b: &Gaussian) -> Gaussian {
    let inverse = |s: &Symmetric2| {
        let d = s.determinant();
        Symmetric2::new(s.yy / d, -s.xy / d, s.xx / d)
    };
    let (p, q) = (inverse(&a.covariance), inverse(&b.covariance));
    let covariance = inverse(&Symmetric2::new(p.xx + q.xx, p.xy + q.xy, p.yy + q.yy));
    let push = |s: &Symmetric2, m: [f64; 2]| [s.xx * m[0] + s.xy * m[1], s.xy * m[0] + s.yy * m[1]];
    let (u, v) = (push(&p, a.mean), push(&q, b.mean));
    Gaussian { mean: push(&covariance, [u[0] + v[0], u[1] + v[1]]), covariance }
}

impl Gaussian {
    /// Whether its numbers are of a size to compute with, and its covariance has a width in every direction.
    pub fn is_usable(&self) -> bool {
        let numbers = [self.mean[0], self.mean[1], self.covariance.xx, self.covariance.yy];
        numbers.iter().all(|value| value.abs() <= LARGEST_STATE) && self.covariance.is_positive_definite()
    }
}

/// The product, as uncertain as the two disagree: the variance between them, by their numbers of sightings, is added.
///
/// **Why:** two places that lie apart by more than their covariances allow say that a particle's own error is larger
/// than it knows; without this the sightings of one of them would found a duplicate again.
pub fn spread_product(a: &Gaussian, b: &Gaussian, [m, n]: [f64; 2]) -> Gaussian {
    let Gaussian { mean, covariance: c } = product(a, b);
    let between = m * n / ((m + n) * (m + n));
    let [x, y] = [a.mean[0] - b.mean[0], a.mean[1] - b.mean[1]];
    Gaussian {
        mean,
        covariance: Symmetric2::new(c.xx + between * x * x, c.xy + between * x * y, c.yy + between * y * y),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_product_weighs_by_precision() {
        let a = Gaussian { mean: [0.0, 0.0], covariance: Symmetric2::new(1.0, 0.0, 4.0) };
        let b = Gaussian { mean: [4.0, 5.0], covariance: Symmetric2::new(3.0, 0.0, 1.0) };
        let both = product(&a, &b);
        // 1/1 against 1/3, and 1/4 against 1/1.
        assert!((both.mean[0] - 1.0).abs() < 1e-14 && (both.mean[1] - 4.0).abs() < 1e-14);
        assert!((both.covariance.xx - 0.75).abs() < 1e-14 && (both.covariance.yy - 0.8).abs() < 1e-14);
        assert!((distance_squared(&a, &b, 0.0) - (16.0 / 4.0 + 25.0 / 5.0)).abs() < 1e-12);
    }

    #[test]
    fn a_mixture_is_as_wide_as_its_parts_and_their_distance() {
        let part = |x: f64| Gaussian { mean: [x, 2.0 * x], covariance: Symmetric2::new(1.0, 0.5, 2.0) };
        // Mean 0.25 · 0 + 0.75 · 4 = 3; between the parts 0.25 · 9 + 0.75 · 1 = 3, times 1, 2 and 4.
        let mixed = Gaussian::mixture_about([3.0, 6.0], [(0.25, part(0.0)), (0.75, part(4.0))].into_iter());
        let Symmetric2 { xx, xy, yy } = mixed.covariance;
        assert!((xx - 4.0).abs() < 1e-14 && (xy - 6.5).abs() < 1e-14 && (yy - 14.0).abs() < 1e-14, "{mixed:?}");
    }
}
