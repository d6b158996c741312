//! Gaussians of any dimension: what measurement models of any size need of linear algebra, written once.
//!
//! The kernels of the plane (two numbers, two coordinates) have closed forms of their own in [`crate::gaussian`] and
//! [`crate::landmark`], whose bits and speed are held by tests; what has another size goes through here.

use crate::density::{Fit, Tail, LN_TAU};
use crate::gaussian::{Gaussian, GaussianOf};
use crate::geometry::Symmetric2;
use crate::limits::LARGEST_STATE;
use crate::math;

/// `R` rows of `C` numbers.
pub type Matrix<const R: usize, const C: usize> = [[f64; C]; R];

/// A Gaussian of `D` dimensions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Normal<const D: usize> {
    /// Mean.
    pub mean: [f64; D],
    /// Covariance.
    pub covariance: Matrix<D, D>,
}

/// J Σ Jᵀ, symmetric to the bit.
#[inline(always)]
pub fn congruence<const Z: usize, const D: usize>(j: &Matrix<Z, D>, s: &Matrix<D, D>) -> Matrix<Z, Z> {
    let js = product(j, s);
    let mut out = [[0.0; Z]; Z];
    for a in 0..Z {
        for b in a..Z {
            out[a][b] = dot(&js[a], &j[b]);
            out[b][a] = out[a][b];
        }
    }
    out
}

/// A B.
#[inline(always)]
pub fn product<const A: usize, const B: usize, const C: usize>(a: &Matrix<A, B>, b: &Matrix<B, C>) -> Matrix<A, C> {
    std::array::from_fn(|i| std::array::from_fn(|k| (0..B).map(|j| a[i][j] * b[j][k]).sum()))
}

/// A + B.
#[inline(always)]
pub fn sum<const A: usize, const B: usize>(a: &Matrix<A, B>, b: &Matrix<A, B>) -> Matrix<A, B> {
    std::array::from_fn(|i| std::array::from_fn(|j| a[i][j] + b[i][j]))
}

/// A with every number times a factor.
#[inline(always)]
pub fn scaled<const A: usize, const B: usize>(a: &Matrix<A, B>, factor: f64) -> Matrix<A, B> {
    a.map(|row| row.map(|v| v * factor))
}

/// A covariance with these variances along a direction (sine, cosine) and across it.
pub fn turned([along, across]: [f64; 2], (s, c): (f64, f64)) -> Matrix<2, 2> {
    let xy = s * c * (along - across);
    [[c * c * along + s * s * across, xy], [xy, s * s * along + c * c * across]]
}

#[inline(always)]
fn dot<const N: usize>(a: &[f64; N], b: &[f64; N]) -> f64 {
    (0..N).map(|i| a[i] * b[i]).sum()
}

/// The factor of a positive definite matrix: A = L Lᵀ.
#[derive(Clone, Copy, Debug)]
pub struct Cholesky<const N: usize>(Matrix<N, N>);

impl<const N: usize> Cholesky<N> {
    /// `None` where the matrix is not positive definite, or holds what is no number.
    #[inline(always)]
    pub fn of(a: &Matrix<N, N>) -> Option<Self> {
        Self::of_leading(a, N)
    }

    /// [`Self::of`] the leading `n` rows and columns; the others are taken for those of the identity.
    #[inline(always)]
    pub fn of_leading(a: &Matrix<N, N>, n: usize) -> Option<Self> {
        let mut l = std::array::from_fn(|i| std::array::from_fn(|j| if i == j { 1.0 } else { 0.0 }));
        for i in 0..n {
            for j in 0..=i {
                let rest = a[i][j] - (0..j).map(|k| l[i][k] * l[j][k]).sum::<f64>();
                if i == j {
                    if !(rest > 0.0 && rest.is_finite()) {
                        return None;
                    }
                    l[i][i] = rest.sqrt();
                } else {
                    l[i][j] = rest / l[j][j];
                }
            }
        }
        Some(Self(l))
    }

    /// L⁻¹ b.
    #[inline(always)]
    pub fn whitened(&self, b: &[f64; N]) -> [f64; N] {
        let mut y = *b;
        for i in 0..N {
            y[i] = (y[i] - (0..i).map(|k| self.0[i][k] * y[k]).sum::<f64>()) / self.0[i][i];
        }
        y
    }

    /// A⁻¹ b.
    #[inline(always)]
    pub fn solve(&self, b: &[f64; N]) -> [f64; N] {
        let mut x = self.whitened(b);
        for i in (0..N).rev() {
            x[i] = (x[i] - (i + 1..N).map(|k| self.0[k][i] * x[k]).sum::<f64>()) / self.0[i][i];
        }
        x
    }

    /// A⁻¹.
    pub fn inverse(&self) -> Matrix<N, N> {
        std::array::from_fn(|i| self.solve(&std::array::from_fn(|k| if k == i { 1.0 } else { 0.0 })))
    }

    /// ln |A|.
    #[inline(always)]
    pub fn log_determinant(&self) -> f64 {
        2.0 * (0..N).map(|i| math::ln(self.0[i][i])).sum::<f64>()
    }
}

/// ln N(ν; 0, S), with the tail of the noise in place of the normal one, and νᵀ S⁻¹ ν; `None` where S is no covariance.
#[inline(always)]
pub fn fit<const Z: usize>(innovation: &[f64; Z], s: &Matrix<Z, Z>, tail: Tail) -> Option<Fit> {
    let factor = Cholesky::of(s)?;
    let whitened = factor.whitened(innovation);
    let mahalanobis_squared = dot(&whitened, &whitened);
    let log_likelihood = -0.5 * (mahalanobis_squared + factor.log_determinant() + Z as f64 * LN_TAU)
        + tail.log_excess_of(Z, mahalanobis_squared);
    Some(Fit { log_likelihood, mahalanobis_squared })
}

impl<const D: usize> Normal<D> {
    /// What is left to believe after an innovation ν = H δ + noise of N(0, R), for a deviation δ from the mean; the
    /// change of the mean comes first. `None` where H Σ Hᵀ + R is no covariance.
    ///
    /// **Source:** the Kalman filter, K = Σ Hᵀ S⁻¹, with the covariance in Joseph's form, which keeps it positive
    /// definite whatever the rounding.
    #[inline(always)]
    pub fn given<const Z: usize>(
        covariance: &Matrix<D, D>,
        by: &Matrix<Z, D>,
        innovation: &[f64; Z],
        noise: &Matrix<Z, Z>,
    ) -> Option<Self> {
        let s = Cholesky::of(&sum(&congruence(by, covariance), noise))?;
        // Row d of K is S⁻¹ H Σ_d.
        let gain: Matrix<D, Z> = covariance.map(|row| s.solve(&std::array::from_fn(|z| dot(&by[z], &row))));
        let kept: Matrix<D, D> = std::array::from_fn(|a| {
            std::array::from_fn(|b| {
                let unit = if a == b { 1.0 } else { 0.0 };
                unit - (0..Z).map(|z| gain[a][z] * by[z][b]).sum::<f64>()
            })
        });
        Some(Self {
            mean: gain.map(|row| dot(&row, innovation)),
            covariance: sum(&congruence(&kept, covariance), &congruence(&gain, noise)),
        })
    }

    /// The one Gaussian with the moments of a mixture, given as shares that sum to 1 with their components.
    pub fn of_mixture<'a>(parts: impl Iterator<Item = (f64, &'a Self)> + Clone) -> Self {
        let mut mean = [0.0; D];
        for (share, part) in parts.clone() {
            (0..D).for_each(|d| mean[d] += share * part.mean[d]);
        }
        Self::mixture_about(mean, parts.map(|(share, part)| (share, *part)))
    }

    /// The landmark after a sighting whose innovation has these derivatives by it, and how well that fitted before;
    /// `None` where nothing can be said.
    ///
    /// **Source:** as [`crate::landmark::correct`], which is its instance in the plane, for any number of numbers.
    pub fn corrected<const Z: usize>(
        &self,
        (innovation, by_landmark): (&[f64; Z], &Matrix<Z, D>),
        noise: &Matrix<Z, Z>,
        tail: Tail,
    ) -> Option<(Self, Fit)> {
        let spread = sum(&congruence(by_landmark, &self.covariance), noise);
        let fitted = fit(innovation, &spread, tail)?;
        let widened = scaled(noise, tail.noise_scale_of(Z, fitted.mahalanobis_squared));
        let change = Self::given(&self.covariance, by_landmark, innovation, &widened)?;
        let mean = std::array::from_fn(|d| self.mean[d] + change.mean[d]);
        Some((Self { mean, covariance: change.covariance }, fitted))
    }
}

impl<const D: usize> GaussianOf<D> for Normal<D> {
    fn from_entries(mean: [f64; D], covariance: impl Fn(usize, usize) -> f64) -> Self {
        let entry = |a: usize, b: usize| covariance(a.min(b), a.max(b));
        Self { mean, covariance: std::array::from_fn(|a| std::array::from_fn(|b| entry(a, b))) }
    }

    fn mean(&self) -> [f64; D] {
        self.mean
    }

    fn covariance(&self, row: usize, column: usize) -> f64 {
        self.covariance[row][column]
    }

    fn is_usable(&self) -> bool {
        let variances = (0..D).map(|d| self.covariance[d][d]);
        self.mean.into_iter().chain(variances).all(|value| value.abs() <= LARGEST_STATE)
            && Cholesky::of(&self.covariance).is_some()
    }

    fn distance_squared(&self, other: &Self, more: f64) -> f64 {
        let mut both = sum(&self.covariance, &other.covariance);
        (0..D).for_each(|d| both[d][d] += more);
        let off = std::array::from_fn(|d| self.mean[d] - other.mean[d]);
        Cholesky::of(&both).map_or(f64::NAN, |factor| {
            let whitened = factor.whitened(&off);
            dot(&whitened, &whitened)
        })
    }

    fn product(&self, other: &Self) -> Self {
        // Σ = P (P + Q)⁻¹ Q, and what of the way to the other mean its share says: one factor, of the wider matrix.
        let Some(both) = Cholesky::of(&sum(&self.covariance, &other.covariance)) else {
            return Self { mean: [f64::NAN; D], covariance: [[f64::NAN; D]; D] };
        };
        let gain: Matrix<D, D> = self.covariance.map(|row| both.solve(&row));
        let off: [f64; D] = std::array::from_fn(|d| other.mean[d] - self.mean[d]);
        let covariance = product(&gain, &other.covariance);
        let mean = std::array::from_fn(|d| self.mean[d] + dot(&gain[d], &off));
        Self::from_entries(mean, |a, b| 0.5 * (covariance[a][b] + covariance[b][a]))
    }
}

impl From<Normal<2>> for Gaussian {
    fn from(Normal { mean, covariance: [[xx, xy], [yx, yy]] }: Normal<2>) -> Self {
        Self { mean, covariance: Symmetric2::new(xx, 0.5 * (xy + yx), yy) }
    }
}

impl Gaussian {
    /// With its covariance as rows.
    pub fn normal(&self) -> Normal<2> {
        let Symmetric2 { xx, xy, yy } = self.covariance;
        Normal { mean: self.mean, covariance: [[xx, xy], [xy, yy]] }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gaussian::fit_with_tail;

    const S: Matrix<3, 3> = [[4.0, 1.0, 0.5], [1.0, 3.0, -0.2], [0.5, -0.2, 2.0]];

    #[test]
    fn the_factor_solves_and_has_the_determinant() {
        let factor = Cholesky::of(&S).unwrap();
        let unit = product(&S, &factor.inverse());
        for (i, row) in unit.iter().enumerate() {
            for (j, v) in row.iter().enumerate() {
                assert!((v - f64::from(u8::from(i == j))).abs() < 1e-14, "{unit:?}");
            }
        }
        let determinant = 4.0 * (6.0 - 0.04) - (2.0 + 0.1) + 0.5 * (-0.2 - 1.5);
        assert!((factor.log_determinant() - f64::ln(determinant)).abs() < 1e-14);
        for broken in [[[1.0, 2.0], [2.0, 1.0]], [[0.0, 0.0], [0.0, 1.0]], [[f64::NAN, 0.0], [0.0, 1.0]]] {
            assert!(Cholesky::of(&broken).is_none());
        }
    }

    #[test]
    fn two_dimensions_are_those_of_the_closed_forms() {
        let (innovation, q) = ([0.7, -1.2], Symmetric2::new(2.0, 0.3, 0.9));
        for tail in [Tail::Gaussian, Tail::StudentT(4.0)] {
            let ours = fit(&innovation, &[[2.0, 0.3], [0.3, 0.9]], tail).unwrap();
            let theirs = fit_with_tail(innovation, q, tail);
            assert!((ours.log_likelihood - theirs.log_likelihood).abs() < 1e-14, "{ours:?} {theirs:?}");
            assert!((ours.mahalanobis_squared - theirs.mahalanobis_squared).abs() < 1e-14);
        }
    }

    #[test]
    fn conditioning_is_that_of_one_number_on_another() {
        // x ~ N(0, 4), z = 2 x + noise of variance 9: K = 8 / 25, variance 4 · 9 / 25.
        let posterior = Normal::given(&[[4.0]], &[[2.0]], &[5.0], &[[9.0]]).unwrap();
        assert!((posterior.mean[0] - 1.6).abs() < 1e-15 && (posterior.covariance[0][0] - 1.44).abs() < 1e-15);
        // Seen from one side only: the other direction keeps its width.
        let posterior = Normal::given(&[[4.0, 0.0], [0.0, 7.0]], &[[1.0, 0.0]], &[1.0], &[[4.0]]).unwrap();
        let Normal { mean: [x, y], covariance: [[xx, xy], [_, yy]] } = posterior;
        assert!((x - 0.5).abs() < 1e-15 && (xx - 2.0).abs() < 1e-15);
        assert_eq!((y, xy, yy), (0.0, 0.0, 7.0));
    }

    #[test]
    fn mixtures_have_the_moments_of_the_plane() {
        let parts = [(0.25, [0.0, 0.0]), (0.75, [4.0, 8.0])];
        let covariance = [[1.0, 0.5], [0.5, 2.0]];
        let normals = parts.map(|(share, mean)| (share, Normal { mean, covariance }));
        let ours = Normal::of_mixture(normals.iter().map(|(share, part)| (*share, part)));
        let plane = |mean| Gaussian { mean, covariance: Symmetric2::new(1.0, 0.5, 2.0) };
        let theirs = Gaussian::mixture_about([3.0, 6.0], parts.into_iter().map(|(s, mean)| (s, plane(mean))));
        assert_eq!(ours.mean, theirs.mean);
        assert!((ours.covariance[0][1] - theirs.covariance.xy).abs() < 1e-14);
        assert!((ours.covariance[1][1] - theirs.covariance.yy).abs() < 1e-14);
    }

    #[test]
    fn the_plane_is_an_instance_of_any_dimension() {
        let a = Gaussian { mean: [1.0, -2.0], covariance: Symmetric2::new(0.4, 0.1, 0.9) };
        let b = Gaussian { mean: [1.5, -1.2], covariance: Symmetric2::new(0.7, -0.2, 0.3) };
        let (p, q) = (a.normal(), b.normal());
        let close = |got: Normal<2>, expected: Gaussian| {
            let expected = expected.normal();
            let apart = got
                .mean
                .iter()
                .zip(&expected.mean)
                .chain(got.covariance.iter().flatten().zip(expected.covariance.iter().flatten()));
            assert!(apart.into_iter().all(|(x, y)| (x - y).abs() < 1e-14), "{got:?} {expected:?}");
        };
        close(p.product(&q), a.product(&b));
        close(p.spread_product(&q, [3.0, 5.0]), a.spread_product(&b, [3.0, 5.0]));
        assert!((p.distance_squared(&q, 0.2) - a.distance_squared(&b, 0.2)).abs() < 1e-14);
        let flat = Gaussian { covariance: Symmetric2::new(1.0, 1.0, 1.0), ..a };
        assert!(p.is_usable() && a.is_usable() && !flat.normal().is_usable() && !flat.is_usable());
    }
}
