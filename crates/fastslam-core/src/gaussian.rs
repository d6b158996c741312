//! Gaussians of landmarks: what maps ask of them, and the closed forms of the plane.

use crate::density::{Fit, Tail, LN_TAU};
use crate::geometry::Symmetric2;
use crate::limits::LARGEST_STATE;
use crate::math;

/// νᵀ adj(S) ν: the squared Mahalanobis distance times the determinant.
#[inline(always)]
fn adjoint_form([a, b]: [f64; 2], s: Symmetric2) -> f64 {
    s.yy * a * a - 2.0 * s.xy * a * b + s.xx * b * b
}

/// νᵀ S⁻¹ ν.
#[inline(always)]
pub fn mahalanobis_squared(innovation: [f64; 2], s: Symmetric2) -> f64 {
    adjoint_form(innovation, s) / s.determinant()
}

/// ln N(ν; 0, Q) (with the tail of the noise in place of the normal one) and νᵀQ⁻¹ν for a 2×2 Q.
#[inline(always)]
pub fn fit_with_tail(innovation: [f64; 2], q: Symmetric2, tail: Tail) -> Fit {
    tail.log_likelihood(fit(innovation, q))
}

/// ln N(ν; 0, Q) and νᵀQ⁻¹ν for a 2×2 Q.
#[inline(always)]
pub fn fit(innovation: [f64; 2], q: Symmetric2) -> Fit {
    let determinant = q.determinant();
    let mahalanobis_squared = adjoint_form(innovation, q) / determinant;
    Fit { log_likelihood: -0.5 * (mahalanobis_squared + math::ln(determinant)) - LN_TAU, mahalanobis_squared }
}

/// G Σ Gᵀ + R.
#[inline(always)]
pub fn innovation_covariance(by_landmark: [[f64; 2]; 2], covariance: Symmetric2, noise: Symmetric2) -> Symmetric2 {
    let q = covariance.transformed(by_landmark);
    Symmetric2::new(q.xx + noise.xx, q.xy + noise.xy, q.yy + noise.yy)
}

/// Area of the ellipse within a squared Mahalanobis distance of a Gaussian whose covariance has this determinant.
pub fn ellipse_area(gate: f64, determinant: f64) -> f64 {
    std::f64::consts::PI * gate * determinant.max(0.0).sqrt()
}

/// J⁻¹ of a 2×2 matrix in row order.
#[inline(always)]
pub fn inverted([[a, b], [c, d]]: [[f64; 2]; 2]) -> [[f64; 2]; 2] {
    let inverse = 1.0 / (a * d - b * c);
    [[d * inverse, -b * inverse], [-c * inverse, a * inverse]]
}

/// S⁻¹ of a symmetric 2×2 matrix, divided once.
#[derive(Clone, Copy, Debug)]
pub struct Inverse {
    of: Symmetric2,
    /// 1 / |S|.
    pub reciprocal: f64,
}

impl Inverse {
    /// Not finite where S is singular.
    #[inline(always)]
    pub fn of(s: Symmetric2) -> Self {
        Self { of: s, reciprocal: 1.0 / s.determinant() }
    }

    /// adj(S) = |S| S⁻¹.
    #[inline(always)]
    pub fn adjugate(&self) -> Symmetric2 {
        Symmetric2::new(self.of.yy, -self.of.xy, self.of.xx)
    }

    /// S⁻¹.
    #[inline(always)]
    pub fn matrix(&self) -> Symmetric2 {
        self.adjugate().scaled(self.reciprocal)
    }

    /// S⁻¹ v.
    #[inline(always)]
    pub fn times(&self, [a, b]: [f64; 2]) -> [f64; 2] {
        let Symmetric2 { xx, xy, yy } = self.of;
        [(a * yy - b * xy) * self.reciprocal, (b * xx - a * xy) * self.reciprocal]
    }

    /// νᵀ S⁻¹ ν.
    #[inline(always)]
    pub fn form(&self, innovation: [f64; 2]) -> f64 {
        adjoint_form(innovation, self.of) * self.reciprocal
    }
}

/// What maps ask of the Gaussian of a landmark of `D` coordinates.
///
/// [`Gaussian`] answers in closed forms of the plane, [`crate::normal::Normal`] in any dimension.
pub trait GaussianOf<const D: usize>: Copy {
    /// With the entries of a covariance, of which those with `row <= column` are asked.
    fn from_entries(mean: [f64; D], covariance: impl Fn(usize, usize) -> f64) -> Self;

    /// Position in the world, metres.
    fn mean(&self) -> [f64; D];

    /// An entry of the covariance, square metres.
    fn covariance(&self, row: usize, column: usize) -> f64;

    /// Whether its numbers are of a size to compute with, and its covariance has a width in every direction.
    fn is_usable(&self) -> bool;

    /// The squared Mahalanobis distance of two landmarks, with this variance added to that of their difference.
    fn distance_squared(&self, other: &Self, more: f64) -> f64;

    /// The normalised product of two Gaussians; not usable where one of them lacks a width.
    fn product(&self, other: &Self) -> Self;

    /// The mixture of `parts` (share and component) whose mean this is: covariance within plus between them.
    fn mixture_about(mean: [f64; D], parts: impl Iterator<Item = (f64, Self)>) -> Self {
        let mut covariance = [[0.0; D]; D];
        for (share, part) in parts {
            let off: [f64; D] = difference(part.mean(), mean);
            for a in 0..D {
                for b in a..D {
                    covariance[a][b] += share * (part.covariance(a, b) + off[a] * off[b]);
                }
            }
        }
        Self::from_entries(mean, |a, b| covariance[a][b])
    }

    /// The product, as uncertain as the two disagree: the variance between them, by their numbers of sightings, is added.
    ///
    /// **Why:** two places that lie apart by more than their covariances allow say that a particle's own error is larger
    /// than it knows; without this the sightings of one of them would found a duplicate again.
    fn spread_product(&self, other: &Self, [m, n]: [f64; 2]) -> Self {
        let both = self.product(other);
        let between = m * n / ((m + n) * (m + n));
        let off: [f64; D] = difference(self.mean(), other.mean());
        Self::from_entries(both.mean(), |a, b| both.covariance(a, b) + between * off[a] * off[b])
    }
}

fn difference<const D: usize>(a: [f64; D], b: [f64; D]) -> [f64; D] {
    std::array::from_fn(|axis| a[axis] - b[axis])
}

/// A landmark's Gaussian in one map of the plane.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Gaussian {
    /// Position in the world, metres.
    pub mean: [f64; 2],
    /// Square metres.
    pub covariance: Symmetric2,
}

impl GaussianOf<2> for Gaussian {
    #[inline(always)]
    fn from_entries(mean: [f64; 2], covariance: impl Fn(usize, usize) -> f64) -> Self {
        Self { mean, covariance: Symmetric2::new(covariance(0, 0), covariance(0, 1), covariance(1, 1)) }
    }

    #[inline(always)]
    fn mean(&self) -> [f64; 2] {
        self.mean
    }

    #[inline(always)]
    fn covariance(&self, row: usize, column: usize) -> f64 {
        let Symmetric2 { xx, xy, yy } = self.covariance;
        [xx, xy, yy][row + column]
    }

    fn is_usable(&self) -> bool {
        let numbers = [self.mean[0], self.mean[1], self.covariance.xx, self.covariance.yy];
        numbers.iter().all(|value| value.abs() <= LARGEST_STATE) && self.covariance.is_positive_definite()
    }

    #[inline(always)]
    fn distance_squared(&self, other: &Self, more: f64) -> f64 {
        let (p, q) = (&self.covariance, &other.covariance);
        let s = Symmetric2::new(p.xx + q.xx + more, p.xy + q.xy, p.yy + q.yy + more);
        // Not `difference`: that may be left a call, for every map of a pass.
        mahalanobis_squared([self.mean[0] - other.mean[0], self.mean[1] - other.mean[1]], s)
    }

    fn product(&self, other: &Self) -> Self {
        let inverse = |s: &Symmetric2| {
            let d = s.determinant();
            Symmetric2::new(s.yy / d, -s.xy / d, s.xx / d)
        };
        let (p, q) = (inverse(&self.covariance), inverse(&other.covariance));
        let covariance = inverse(&Symmetric2::new(p.xx + q.xx, p.xy + q.xy, p.yy + q.yy));
        let push = |s: &Symmetric2, m: [f64; 2]| [s.xx * m[0] + s.xy * m[1], s.xy * m[0] + s.yy * m[1]];
        let (u, v) = (push(&p, self.mean), push(&q, other.mean));
        Self { mean: push(&covariance, [u[0] + v[0], u[1] + v[1]]), covariance }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_likelihood_is_the_normal_density() {
        // Q = diag(4, 9), ν = (2, 3): d² = 2, density exp(-1) / (2π · 6).
        let fit = fit([2.0, 3.0], Symmetric2::new(4.0, 0.0, 9.0));
        assert!((fit.mahalanobis_squared - 2.0).abs() < 1e-15);
        let density = (-1.0_f64).exp() / (std::f64::consts::TAU * 6.0);
        assert!((fit.log_likelihood - density.ln()).abs() < 1e-14);
    }

    #[test]
    fn the_inverse_solves_and_is_that_of_the_general_form() {
        let s = Symmetric2::new(4.0, 1.0, 2.0);
        let inverse = Inverse::of(s);
        let [x, y] = inverse.times([3.0, -1.0]);
        assert!((s.xx * x + s.xy * y - 3.0).abs() < 1e-15 && (s.xy * x + s.yy * y + 1.0).abs() < 1e-15);
        let [[xx, xy], [_, yy]] = inverted([[4.0, 1.0], [1.0, 2.0]]);
        assert_eq!(inverse.matrix(), Symmetric2::new(xx, xy, yy));
        let distance = 3.0 * x - y;
        assert!((inverse.form([3.0, -1.0]) - distance).abs() < 1e-14);
        assert!((mahalanobis_squared([3.0, -1.0], s) - distance).abs() < 1e-14);
        // A circle of radius 2 holds the distances up to 4 of the unit Gaussian.
        assert!((ellipse_area(4.0, 1.0) - 4.0 * std::f64::consts::PI).abs() < 1e-14 && ellipse_area(4.0, -1e-9) == 0.0);
    }

    #[test]
    fn the_product_weighs_by_precision() {
        let a = Gaussian { mean: [0.0, 0.0], covariance: Symmetric2::new(1.0, 0.0, 4.0) };
        let b = Gaussian { mean: [4.0, 5.0], covariance: Symmetric2::new(3.0, 0.0, 1.0) };
        let both = a.product(&b);
        // 1/1 against 1/3, and 1/4 against 1/1.
        assert!((both.mean[0] - 1.0).abs() < 1e-14 && (both.mean[1] - 4.0).abs() < 1e-14);
        assert!((both.covariance.xx - 0.75).abs() < 1e-14 && (both.covariance.yy - 0.8).abs() < 1e-14);
        assert!((a.distance_squared(&b, 0.0) - (16.0 / 4.0 + 25.0 / 5.0)).abs() < 1e-12);
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
