//! What many scans say of several noises together: sums, how far chance reaches, and factors of the variances.

use super::innovations::Found;
use serde::{Deserialize, Serialize};

/// A noise is judged by so many independent numbers, or not at all: less than that is chance, and in the end rounding.
const NUMBERS_MIN: f64 = 25.0;
/// The same where it contributes less than this fraction to what is expected of the numbers.
const SMALLEST_SHARE: f64 = 1e-3;
/// Standard errors between an estimate and the ends of its interval: a false alarm of one noise in about 700 windows.
const INTERVAL_STD_ERRORS: f64 = 3.0;
/// Noises that are told apart no better than this are not told apart: the determinant of what they contribute, each
/// scaled to 1.
const SMALLEST_DETERMINANT: f64 = 1e-3;

/// What tells how far neighbours in a series repeat each other.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub(super) struct Series {
    count: f64,
    last: f64,
    sum: f64,
    squares: f64,
    /// Products with the value before.
    lagged: f64,
}

impl Series {
    pub fn add(&mut self, value: f64) {
        self.lagged += if self.count > 0.0 { value * self.last } else { 0.0 };
        self.last = value;
        self.sum += value;
        self.squares += value * value;
        self.count += 1.0;
    }

    /// How many neighbours are worth one independent value, from the first autocorrelation ρ: (1 + ρ) / (1 − ρ), at
    /// least 1.
    pub fn repetition(&self) -> f64 {
        let mean = self.sum / self.count;
        let variance = self.squares / self.count - mean * mean;
        if self.count < 3.0 || variance <= 1e-12 * mean * mean {
            return 1.0;
        }
        let covariance = self.lagged / (self.count - 1.0) - mean * mean;
        let correlation = (covariance / variance).clamp(0.0, 0.95);
        (1.0 + correlation) / (1.0 - correlation)
    }
}

/// What was found of some noises in many scans, summed, with the products that tell how far chance reaches.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(super) struct Totals<const K: usize> {
    pub sum: Found<K>,
    /// Σ squares squaresᵀ, Σ squares expectedᵀ, Σ expected expectedᵀ.
    #[serde(with = "crate::stored_arrays")]
    products: [[[f64; K]; K]; 3],
    #[serde(with = "serde_arrays")]
    surplus: [Series; K],
}

impl<const K: usize> Default for Totals<K> {
    fn default() -> Self {
        Self { sum: Found::default(), products: [[[0.0; K]; K]; 3], surplus: [Series::default(); K] }
    }
}

impl<const K: usize> Totals<K> {
    pub fn add(&mut self, found: &Found<K>) {
        let Found { squares, expected, shares } = found;
        for k in 0..K {
            self.sum.squares[k] += squares[k];
            self.sum.expected[k] += expected[k];
            self.surplus[k].add(squares[k] - expected[k]);
            for l in 0..K {
                self.sum.shares[k][l] += shares[k][l];
                self.products[0][k][l] += squares[k] * squares[l];
                self.products[1][k][l] += squares[k] * expected[l];
                self.products[2][k][l] += expected[k] * expected[l];
            }
        }
    }

    /// Covariance of the sums of squares, from how they vary about a fixed multiple of their expectation, with
    /// neighbours that repeat each other counted as one.
    pub fn chance(&self) -> [[f64; K]; K] {
        let scale: [f64; K] =
            std::array::from_fn(|k| self.sum.squares[k] / self.sum.expected[k].max(f64::MIN_POSITIVE));
        let repetition = self.surplus.map(|series| series.repetition().sqrt());
        let [qq, qt, tt] = &self.products;
        let entry = |k: usize, l: usize| {
            let about = qq[k][l] - scale[l] * qt[k][l] - scale[k] * qt[l][k] + scale[k] * scale[l] * tt[k][l];
            repetition[k] * repetition[l] * about
        };
        std::array::from_fn(|k| std::array::from_fn(|l| entry(k, l)))
    }

    /// The noises that enough independent numbers tell of.
    pub fn observed(&self) -> [bool; K] {
        std::array::from_fn(|k| {
            let (squares, expected, own) = (self.sum.squares[k], self.sum.expected[k], self.sum.shares[k][k]);
            // What is much larger than expected shows itself by that.
            let enough = squares.max(expected) >= NUMBERS_MIN && expected >= 0.1 * NUMBERS_MIN;
            enough && own > SMALLEST_SHARE * expected
        })
    }
}

/// Factors of variances, with their covariance; only where observed.
#[derive(Clone, Copy, Debug)]
pub(super) struct Factors<const K: usize> {
    pub observed: [bool; K],
    pub values: [f64; K],
    pub covariance: [[f64; K]; K],
}

impl<const K: usize> Factors<K> {
    /// Solves `shares` f = `squares` for the observed factors; `None` where these are not told apart.
    pub fn solve(
        observed: [bool; K],
        shares: &[[f64; K]; K],
        squares: &[f64; K],
        chance: &[[f64; K]; K],
    ) -> Option<Self> {
        let inverse = inverted_where(observed, shares)?;
        let product = |row: &[f64; K], column: &dyn Fn(usize) -> f64| (0..K).map(|l| row[l] * column(l)).sum::<f64>();
        let values = std::array::from_fn(|k| product(&inverse[k], &|l| squares[l]));
        let left: [[f64; K]; K] =
            std::array::from_fn(|k| std::array::from_fn(|m| product(&inverse[k], &|l| chance[l][m])));
        let covariance = std::array::from_fn(|k| std::array::from_fn(|m| product(&left[k], &|l| inverse[m][l])));
        Some(Self { observed, values, covariance })
    }

    /// Each as a factor of the standard deviation, with its interval.
    pub fn of_std(&self, k: usize) -> Option<[f64; 3]> {
        let reach = INTERVAL_STD_ERRORS * self.covariance[k][k].max(0.0).sqrt();
        let root = |offset: f64| (self.values[k] + offset).max(0.0).sqrt();
        let interval = [root(0.0), root(-reach), root(reach)];
        (self.observed[k] && interval.iter().all(|value| value.is_finite())).then_some(interval)
    }
}

/// The inverse of the rows and columns that are observed, 0 elsewhere; `None` where it hardly exists.
fn inverted_where<const K: usize>(observed: [bool; K], a: &[[f64; K]; K]) -> Option<[[f64; K]; K]> {
    let mut rows = *a;
    let mut inverse: [[f64; K]; K] = std::array::from_fn(|k| std::array::from_fn(|l| f64::from(u8::from(k == l))));
    let mut determinant = 1.0;
    for k in (0..K).filter(|k| observed[*k]) {
        let pivot = rows[k][k];
        determinant *= pivot / a[k][k];
        if determinant.is_nan() || determinant <= SMALLEST_DETERMINANT {
            return None;
        }
        (0..K).for_each(|l| (rows[k][l], inverse[k][l]) = (rows[k][l] / pivot, inverse[k][l] / pivot));
        for i in (0..K).filter(|i| observed[*i] && *i != k) {
            let factor = rows[i][k];
            (0..K).for_each(|l| {
                (rows[i][l], inverse[i][l]) = (rows[i][l] - factor * rows[k][l], inverse[i][l] - factor * inverse[k][l])
            });
        }
    }
    let kept = |k: usize, l: usize| if observed[k] && observed[l] { inverse[k][l] } else { 0.0 };
    Some(std::array::from_fn(|k| std::array::from_fn(|l| kept(k, l))))
}
