//! Where the numbers of a landmark of `D` coordinates stand in the rows of a map, and Gaussians in and out of them.

use crate::gaussian::GaussianOf;
use crate::store::{Rows, RowsMut};

/// The columns of a landmark of `D` coordinates: the number of its sightings (0 where a map lacks it), its mean, and the
/// upper triangle of its covariance by rows. In maps of which some landmarks have names, one more behind them.
#[derive(Clone, Copy, Debug)]
pub struct Columns<const D: usize>;

impl<const D: usize> Columns<D> {
    /// Number of sightings.
    pub const SIGHTINGS: usize = 0;
    /// How many columns every landmark has.
    pub const COUNT: usize = 1 + D + D * (D + 1) / 2;
    /// One more than the identity that the landmark was seen with, 0 for none.
    pub const IDENTITY: usize = Self::COUNT;

    /// Of a coordinate of the mean, metres.
    pub const fn mean(axis: usize) -> usize {
        1 + axis
    }

    /// Of an entry of the covariance, square metres.
    pub const fn covariance(a: usize, b: usize) -> usize {
        let (row, column) = if a <= b { (a, b) } else { (b, a) };
        1 + D + row * (2 * D - row - 1) / 2 + column
    }

    /// The mean in one particle's numbers.
    #[inline(always)]
    pub fn mean_of(row: &[f64]) -> [f64; D] {
        std::array::from_fn(|axis| row[Self::mean(axis)])
    }

    /// The Gaussian in one particle's numbers.
    #[inline(always)]
    pub fn gaussian_of<G: GaussianOf<D>>(row: &[f64]) -> G {
        G::from_entries(Self::mean_of(row), |a, b| row[Self::covariance(a, b)])
    }

    /// The Gaussian of particle `i`; `None` where it is absent.
    #[inline(always)]
    pub fn gaussian_in<G: GaussianOf<D>>(rows: &Rows<'_>, i: usize) -> Option<G> {
        let number = |column: usize| rows.column(column)[i];
        let mean = || std::array::from_fn(|axis| number(Self::mean(axis)));
        (number(Self::SIGHTINGS) != 0.0).then(|| G::from_entries(mean(), |a, b| number(Self::covariance(a, b))))
    }

    /// One particle's numbers of a landmark that was seen so often; `row` may be longer.
    pub fn write<G: GaussianOf<D>>(sightings: f64, gaussian: &G, row: &mut [f64]) {
        row[Self::SIGHTINGS] = sightings;
        Self::each(gaussian, |column, value| row[column] = value);
    }

    /// Puts a Gaussian in the place of that of particle `i`.
    pub fn put<G: GaussianOf<D>>(gaussian: &G, rows: &mut RowsMut<'_>, i: usize) {
        Self::each(gaussian, |column, value| rows.column(column)[i] = value);
    }

    fn each<G: GaussianOf<D>>(gaussian: &G, mut to: impl FnMut(usize, f64)) {
        for (axis, value) in gaussian.mean().into_iter().enumerate() {
            to(Self::mean(axis), value);
            (axis..D).for_each(|other| to(Self::covariance(axis, other), gaussian.covariance(axis, other)));
        }
    }

    /// Puts the product of two landmarks of one map into the row of one of them; spread where both may be beside the
    /// truth. `pair` is where they stood, the one that stays first.
    pub fn fuse<G: GaussianOf<D>>(rows: &mut RowsMut<'_>, i: usize, pair: [&Rows<'_>; 2], unsure: bool) {
        let [Some(a), Some(b)] = pair.map(|rows| Self::gaussian_in::<G>(rows, i)) else { return };
        let counts = pair.map(|rows| rows.column(Self::SIGHTINGS)[i]);
        let both = if unsure { a.spread_product(&b, counts) } else { a.product(&b) };
        // Ellipses without width have no product in doubles: the first one stands for both.
        let both = if both.is_usable() { both } else { a };
        rows.column(Self::SIGHTINGS)[i] = counts[0] + counts[1];
        Self::put(&both, rows, i);
    }

    /// A landmark as the weighted mixture of what the particles that hold it have; `None` where these have no weight.
    pub fn mixture<G: GaussianOf<D>>(rows: &Rows<'_>, weights: &[f64]) -> Option<G> {
        let (mut mass, mut mean) = (0.0, [0.0; D]);
        let held = |(i, w): (usize, &f64)| Some((*w, Self::gaussian_in::<G>(rows, i)?));
        for (w, landmark) in weights.iter().enumerate().filter_map(held) {
            mass += w;
            let own = landmark.mean();
            (0..D).for_each(|axis| mean[axis] += w * own[axis]);
        }
        if mass == 0.0 {
            return None;
        }
        let parts = weights.iter().enumerate().filter_map(held).map(|(w, landmark)| (w / mass, landmark));
        Some(G::mixture_about(mean.map(|value| value / mass), parts))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Whether the numbers of a row stand one after the other, the triangle by rows.
    fn check<const D: usize>() -> usize {
        let mut next = Columns::<D>::SIGHTINGS + 1;
        for axis in 0..D {
            assert_eq!(Columns::<D>::mean(axis), next);
            next += 1;
        }
        for a in 0..D {
            for b in a..D {
                assert_eq!([Columns::<D>::covariance(a, b), Columns::<D>::covariance(b, a)], [next; 2]);
                next += 1;
            }
        }
        assert_eq!([Columns::<D>::COUNT, Columns::<D>::IDENTITY], [next; 2]);
        next
    }

    #[test]
    fn columns_follow_one_another_in_any_dimension() {
        assert_eq!([check::<1>(), check::<2>(), check::<3>(), check::<4>()], [3, 6, 10, 15]);
    }
}
