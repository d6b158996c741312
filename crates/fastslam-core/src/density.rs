//! Densities of innovations: how well a sighting fits, how noise falls off, and quantiles of χ².

use crate::math;
use crate::vector::vectorized;
use serde::{Deserialize, Serialize};

/// ln(2π)
pub(crate) const LN_TAU: f64 = 1.837_877_066_409_345_3;

/// How well a sighting fits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fit {
    /// ln N(ν; 0, Q).
    pub log_likelihood: f64,
    /// νᵀ Q⁻¹ ν.
    pub mahalanobis_squared: f64,
}

/// How the noise of a sensor falls off.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Tail {
    /// As the normal distribution.
    Gaussian,
    /// As Student's t with these degrees of freedom.
    StudentT(f64),
    /// The same of a sighting of one number among passes for two ([`crate::measurement::RangeOrBearing`]), but for the
    /// constant of the density.
    StudentTOfOne(f64),
}

impl Tail {
    /// From the configured degrees of freedom.
    pub fn from_degrees_of_freedom(value: Option<f64>) -> Self {
        value.map_or(Self::Gaussian, Self::StudentT)
    }

    /// That of a sighting of one number among passes for two.
    pub(crate) fn of_one(self) -> Self {
        match self {
            Self::StudentT(k) => Self::StudentTOfOne(k),
            other => other,
        }
    }

    /// Makes a pass over particles with this tail as vector code, compiled once for each kind of tail.
    ///
    /// **Why:** a choice within a loop of vector code means that all that may be chosen is computed.
    #[inline(always)]
    pub(crate) fn vectorized<R>(self, pass: impl FnOnce(Self) -> R) -> R {
        vectorized(
            #[inline(always)]
            || self.apart(pass),
        )
    }

    /// [`Self::vectorized`] within vector code.
    #[inline(always)]
    pub(crate) fn apart<R>(self, pass: impl FnOnce(Self) -> R) -> R {
        match self {
            Self::Gaussian => pass(Self::Gaussian),
            Self::StudentT(k) => pass(Self::StudentT(k)),
            Self::StudentTOfOne(k) => pass(Self::StudentTOfOne(k)),
        }
    }

    /// By how much the noise covariance of a sighting this far off is to be scaled: 1 for an ordinary one.
    ///
    /// **Source:** the expectation step of the t-distribution as a scale mixture of normals, (κ + d²) / (κ + 2).
    #[inline(always)]
    pub fn noise_scale(self, mahalanobis_squared: f64) -> f64 {
        match self {
            Self::Gaussian => 1.0,
            Self::StudentT(k) => ((k + mahalanobis_squared) / (k + 2.0)).max(1.0),
            Self::StudentTOfOne(k) => ((k + mahalanobis_squared) / (k + 1.0)).max(1.0),
        }
    }

    /// The logarithm of the density of two dimensions over the normal one. The normalising constant is 1 / 2π for both.
    #[inline(always)]
    pub fn log_excess(self, mahalanobis_squared: f64) -> f64 {
        match self {
            Self::Gaussian => 0.0,
            Self::StudentT(k) => 0.5 * mahalanobis_squared - 0.5 * (k + 2.0) * math::ln(1.0 + mahalanobis_squared / k),
            Self::StudentTOfOne(k) => {
                0.5 * mahalanobis_squared - 0.5 * (k + 1.0) * math::ln(1.0 + mahalanobis_squared / k)
            }
        }
    }

    /// [`Self::noise_scale`] for a sighting of so many numbers: (κ + d²) / (κ + Z), 1 for an ordinary one.
    #[inline(always)]
    pub fn noise_scale_of(self, numbers: usize, mahalanobis_squared: f64) -> f64 {
        match self {
            Self::Gaussian => 1.0,
            Self::StudentT(k) => ((k + mahalanobis_squared) / (k + numbers as f64)).max(1.0),
            Self::StudentTOfOne(_) => self.noise_scale(mahalanobis_squared),
        }
    }

    /// What a sighting of so many numbers this far off costs: half the squared distance, and for the far ones of a heavy
    /// tail the integral of the weight that [`Self::noise_scale_of`] gives.
    pub fn loss_of(self, numbers: usize, mahalanobis_squared: f64) -> f64 {
        let (k, z) = match self {
            Self::Gaussian => return 0.5 * mahalanobis_squared,
            Self::StudentT(k) => (k, numbers as f64),
            Self::StudentTOfOne(k) => (k, 1.0),
        };
        if mahalanobis_squared > z {
            0.5 * (z + (k + z) * math::ln((k + mahalanobis_squared) / (k + z)))
        } else {
            0.5 * mahalanobis_squared
        }
    }

    /// [`Self::log_excess`] for so many numbers: the logarithm of the density of their t-distribution over the normal
    /// one with the same matrix.
    pub fn log_excess_of(self, numbers: usize, mahalanobis_squared: f64) -> f64 {
        let (k, z) = match self {
            Self::Gaussian => return 0.0,
            Self::StudentT(k) => (k, numbers as f64),
            Self::StudentTOfOne(k) => (k, 1.0),
        };
        let constant = ln_gamma(0.5 * (k + z)) - ln_gamma(0.5 * k) - 0.5 * z * math::ln(0.5 * k);
        constant + 0.5 * mahalanobis_squared - 0.5 * (k + z) * math::ln(1.0 + mahalanobis_squared / k)
    }

    /// The Mahalanobis distance at which the logarithm of the density lies `log_ratio` below its peak.
    pub fn reach(self, log_ratio: f64) -> f64 {
        let log_ratio = log_ratio.max(0.0);
        match self {
            Self::Gaussian => (2.0 * log_ratio).sqrt(),
            Self::StudentT(k) => (k * (math::exp(2.0 * log_ratio / (k + 2.0)) - 1.0)).sqrt(),
            Self::StudentTOfOne(k) => (k * (math::exp(2.0 * log_ratio / (k + 1.0)) - 1.0)).sqrt(),
        }
    }

    /// A fit with this tail in place of the normal one.
    #[inline(always)]
    pub(crate) fn log_likelihood(self, gaussian: Fit) -> Fit {
        Fit { log_likelihood: gaussian.log_likelihood + self.log_excess(gaussian.mahalanobis_squared), ..gaussian }
    }
}

/// ln Γ(x) for a positive x.
///
/// **Source:** Stirling's series from 12 on, to 2e-13; below, Γ(x + 1) = x Γ(x).
fn ln_gamma(mut x: f64) -> f64 {
    let mut below = 1.0;
    while x < 12.0 {
        below *= x;
        x += 1.0;
    }
    let square = 1.0 / (x * x);
    let series = (1.0 / 12.0 - square * (1.0 / 360.0 - square * (1.0 / 1260.0 - square / 1680.0))) / x;
    (x - 0.5) * math::ln(x) - x + 0.5 * LN_TAU + series - math::ln(below)
}

/// What χ² with two degrees of freedom stays below with this probability: the square of a gate for a sighting.
pub fn chi_squared_2(probability: f64) -> f64 {
    -2.0 * math::ln(1.0 - probability)
}

/// What χ² with so many degrees of freedom, one or two, stays below with this probability.
pub fn chi_squared(degrees_of_freedom: usize, probability: f64) -> f64 {
    if degrees_of_freedom > 1 || probability >= 1.0 {
        return chi_squared_2(probability);
    }
    let [low, _] = bisected(8.0, 60, |x| within(x) < probability);
    low * low
}

/// Bounds of where what holds at zero ends to hold, below `high`, after so many halvings.
fn bisected(mut high: f64, halvings: u32, holds: impl Fn(f64) -> bool) -> [f64; 2] {
    let mut low = 0.0;
    for _ in 0..halvings {
        let middle = 0.5 * (low + high);
        *(if holds(middle) { &mut low } else { &mut high }) = middle;
    }
    [low, high]
}

/// The probability that a standard normal number is not farther than this from zero.
///
/// √(2/π) e^(−x²/2) Σ x^(2n+1) / (1·3·…·(2n+1)), all terms of which are positive.
fn within(x: f64) -> f64 {
    let (mut term, mut sum) = (x, 0.0);
    for n in 1..200 {
        sum += term;
        term *= x * x / f64::from(2 * n + 1);
    }
    math::exp(-0.5 * (x * x + LN_TAU)) * 2.0 * sum
}

/// What χ² with so many degrees of freedom, any number, stays below with this probability.
///
/// P(χ²_{n+2} > x) = P(χ²_n > x) + (x/2)^(n/2) e^(−x/2) / Γ(n/2 + 1), inverted by bisection.
pub fn chi_squared_of(n: usize, probability: f64) -> f64 {
    if n.is_multiple_of(2) || probability >= 1.0 {
        return chi_squared_of_pairs(n / 2, probability);
    }
    let beyond = |x: f64| {
        // Of one degree: (x/2)^(1/2) e^(−x/2) / Γ(3/2).
        let (mut term, mut sum) =
            ((2.0 * x / std::f64::consts::PI).sqrt() * math::exp(-0.5 * x), 1.0 - within(x.sqrt()));
        for degrees in (1..n).step_by(2) {
            sum += term;
            term *= x / (degrees + 2) as f64;
        }
        sum
    };
    bisected(256.0, 80, |x| beyond(x) > 1.0 - probability)[0]
}

/// What χ² with 2 n degrees of freedom stays below with this probability.
///
/// P(d² > x) = e^(−x/2) Σ_{k<n} (x/2)^k / k!, inverted by bisection.
pub fn chi_squared_of_pairs(n: usize, probability: f64) -> f64 {
    if n == 0 || probability >= 1.0 {
        return if n == 0 { 0.0 } else { f64::INFINITY };
    }
    let beyond = |half: f64| {
        let (mut term, mut sum) = (1.0, 0.0);
        for k in 0..n {
            sum += term;
            term *= half / (k + 1) as f64;
        }
        math::exp(-half) * sum
    };
    let [low, high] = bisected(700.0, 80, |half| beyond(half) > 1.0 - probability);
    low + high
}

/// What χ² stays below, as a multiple of its degrees of freedom, for a standard normal number `z`.
///
/// **Source:** Wilson and Hilferty 1931: the cube root of χ²_ν / ν is nearly normal; good to 3 % from two degrees on.
pub fn chi_squared_ratio(degrees_of_freedom: f64, z: f64) -> f64 {
    let spread = 2.0 / (9.0 * degrees_of_freedom);
    (1.0 - spread + z * spread.sqrt()).max(0.0).powi(3)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_reach_is_where_the_density_has_fallen_that_far() {
        for tail in [Tail::Gaussian, Tail::StudentT(4.0), Tail::StudentT(30.0)] {
            for log_ratio in [0.0, 0.3, 5.0, 12.0] {
                let d2 = tail.reach(log_ratio).powi(2);
                let fallen = 0.5 * d2 - tail.log_excess(d2);
                assert!((fallen - log_ratio).abs() < 1e-12, "{tail:?}: {fallen} against {log_ratio}");
            }
        }
    }

    #[test]
    fn tails_of_any_number_integrate_to_one_and_agree_in_the_plane() {
        for k in [0.5, 3.0, 4.0, 30.0] {
            let tail = Tail::StudentT(k);
            for d2 in [0.0, 0.4, 9.0, 400.0] {
                assert!((tail.log_excess_of(2, d2) - tail.log_excess(d2)).abs() < 1e-11, "{k} {d2}");
                assert!((tail.noise_scale_of(2, d2) - tail.noise_scale(d2)).abs() < 1e-15);
            }
        }
        // One number: the density of t with 3 degrees at 0 is 2 / (π √3), and at √3 a quarter of it.
        let normal = |x: f64| -0.5 * (x * x + LN_TAU);
        let density = |x: f64| (normal(x) + Tail::StudentT(3.0).log_excess_of(1, x * x)).exp();
        let peak = 2.0 / (std::f64::consts::PI * 3.0_f64.sqrt());
        assert!((density(0.0) - peak).abs() < 1e-12, "{} {peak}", density(0.0));
        assert!((density(3.0_f64.sqrt()) - 0.25 * peak).abs() < 1e-12);
        assert!((ln_gamma(0.5) - 0.5 * std::f64::consts::PI.ln()).abs() < 1e-12);
        assert!((ln_gamma(11.0) - 3_628_800.0_f64.ln()).abs() < 1e-12);
    }

    #[test]
    fn the_tail_of_one_number_is_that_of_any_number_but_for_its_constant() {
        let (tail, one) = (Tail::StudentT(4.0), Tail::StudentT(4.0).of_one());
        for d2 in [0.0, 0.4, 9.0, 400.0] {
            let constant = tail.log_excess_of(1, 0.0);
            assert!((one.log_excess(d2) + constant - tail.log_excess_of(1, d2)).abs() < 1e-12);
            assert_eq!(one.noise_scale(d2), tail.noise_scale_of(1, d2));
            assert_eq!(one.loss_of(2, d2), tail.loss_of(1, d2));
            let d2 = one.reach(3.0).powi(2);
            assert!((0.5 * d2 - one.log_excess(d2) - 3.0).abs() < 1e-12);
        }
        assert_eq!(Tail::Gaussian.of_one(), Tail::Gaussian);
    }

    #[test]
    fn quantiles_are_those_of_tables() {
        for (probability, expected) in [(0.5, 0.4549), (0.95, 3.8415), (0.99, 6.6349), (0.99999, 19.511)] {
            assert!((chi_squared(1, probability) - expected).abs() < 1e-3, "{probability}");
        }
        assert_eq!((chi_squared(1, 1.0), chi_squared(2, 0.9)), (f64::INFINITY, chi_squared_2(0.9)));
        assert!((chi_squared_2(0.99) - 9.210_340).abs() < 1e-6);
        // At 99.9 % (z = 3.0902) and 2.5 % (z = -1.96).
        for (degrees, z, expected) in [(2.0, 3.0902, 13.816), (10.0, 3.0902, 29.588), (150.0, -1.96, 117.985)] {
            let got = degrees * chi_squared_ratio(degrees, z);
            assert!((got / expected - 1.0).abs() < 0.03, "{degrees}: {got} for {expected}");
        }
        assert_eq!(chi_squared_ratio(0.1, -3.0), 0.0);
        // At 99 %.
        for (pairs, expected) in [(1, 9.210), (2, 13.277), (5, 23.209), (15, 50.892)] {
            let got = chi_squared_of_pairs(pairs, 0.99);
            assert!((got - expected).abs() < 5e-4, "{pairs}: {got}");
        }
        for (degrees, expected) in [(1, 6.635), (2, 9.210), (3, 11.345), (7, 18.475), (15, 30.578)] {
            assert!((chi_squared_of(degrees, 0.99) - expected).abs() < 1e-3, "{degrees}");
        }
        assert_eq!((chi_squared_of_pairs(3, 1.0), chi_squared_of_pairs(0, 0.99)), (f64::INFINITY, 0.0));
    }
}
