//! The joint Gaussian over how far the landmarks of each pair are apart, and what it says of sets of pairs.

use crate::density::LN_TAU;
use crate::gaussian::{mahalanobis_squared, Inverse};
use crate::geometry::Symmetric2;
use crate::math;

/// Largest squared Mahalanobis distance of two landmarks that may be one: 99.9 % of χ² with two degrees of freedom.
pub const GATE: f64 = 13.8;

/// An older and a younger landmark.
pub type Pair = [usize; 2];

/// A pair that may be one thing.
#[derive(Clone, Copy, Debug)]
pub struct Candidate {
    /// Which.
    pub pair: Pair,
    /// ln of the odds of one thing against two but for the difference of their places, whose density has the unit
    /// 1/m².
    pub log_odds: f64,
}

/// Pairs, and ln of how many times likelier it is that each of them is one thing than that all are two.
#[derive(Clone, Debug)]
pub struct Set {
    /// Which.
    pub pairs: Vec<Pair>,
    /// ln of the odds.
    pub log_odds: f64,
}

impl Set {
    /// Whether it makes one of the two landmarks one with a third.
    pub fn contradicts(&self, pair: Pair) -> bool {
        self.pairs.iter().any(|own| exclude(*own, pair) && *own != pair)
    }
}

/// Whether two pairs share a landmark, so that at most one of them is one thing.
fn exclude(a: Pair, b: Pair) -> bool {
    a.iter().any(|landmark| b.contains(landmark))
}

/// Mean and covariance of the differences of several pairs, two coordinates each.
#[derive(Clone, Debug)]
pub struct Differences {
    mean: Vec<[f64; 2]>,
    /// In row order.
    covariance: Vec<f64>,
}

impl Differences {
    /// `covariance` gives that of two coordinates, each a pair and 0 or 1; `tolerance_m2` is added to the variances.
    pub fn new(mean: Vec<[f64; 2]>, tolerance_m2: f64, covariance: impl Fn(Pair, Pair) -> f64) -> Self {
        let size = 2 * mean.len();
        let number = |i: usize| {
            let (row, column) = (i / size, i % size);
            let tolerance = if row == column { tolerance_m2 } else { 0.0 };
            tolerance + covariance([row / 2, row % 2], [column / 2, column % 2])
        };
        let covariance = (0..size * size).map(number).collect();
        Self { mean, covariance }
    }

    /// The same where what moves all pairs, which lie here, as one rigid body varies so many times as much.
    pub fn with_rigid_variance(mut self, places: &[[f64; 2]], times: f64) -> Self {
        let modes = rigid_modes(places);
        let (size, more) = (2 * self.mean.len(), times - 1.0);
        let along = |mode: &[f64], row: usize| -> f64 {
            self.covariance[row * size..][..size].iter().zip(mode).map(|(value, part)| value * part).sum()
        };
        let images: Vec<Vec<f64>> = modes.iter().map(|mode| (0..size).map(|row| along(mode, row)).collect()).collect();
        for (one, image) in modes.iter().zip(&images) {
            for other in &modes {
                let shared: f64 = image.iter().zip(other).map(|(value, part)| value * part).sum();
                for (i, value) in self.covariance.iter_mut().enumerate() {
                    *value += more * shared * one[i / size] * other[i % size];
                }
            }
        }
        self
    }

    /// The set that begins with one pair and takes in the likeliest remaining pair, given those before, while it gains.
    ///
    /// `None` when the first pair is out of its gate.
    pub fn grow(&self, candidates: &[Candidate], first: usize) -> Option<Set> {
        let mut given = self.clone();
        let mut set = Set { pairs: Vec::new(), log_odds: given.gain(candidates, first)? };
        let mut next = first;
        loop {
            set.pairs.push(candidates[next].pair);
            given.condition(next);
            let open = (0..candidates.len()).filter(|i| set.pairs.iter().all(|p| !exclude(*p, candidates[*i].pair)));
            let gains = open.filter_map(|i| given.gain(candidates, i).map(|gain| (gain, i)));
            let Some((gain, likeliest)) = gains.max_by(|a, b| a.0.total_cmp(&b.0)).filter(|(gain, _)| *gain > 0.0)
            else {
                return Some(set);
            };
            set.log_odds += gain;
            next = likeliest;
        }
    }

    /// ln of the odds that all of these are one thing each; that of nothing when one of them is out of its gate.
    pub fn log_odds_of(&self, candidates: &[Candidate], pairs: &[Pair]) -> f64 {
        let mut given = self.clone();
        let mut sum = 0.0;
        for pair in pairs {
            let Some(i) = candidates.iter().position(|c| c.pair == *pair) else { continue };
            let Some(gain) = given.gain(candidates, i) else { return f64::NEG_INFINITY };
            sum += gain;
            given.condition(i);
        }
        sum
    }

    /// ln of the odds of a pair, given those before; `None` when it is out of the gate.
    fn gain(&self, candidates: &[Candidate], i: usize) -> Option<f64> {
        let block = self.block(i);
        let (determinant, distance) = (block.determinant(), mahalanobis_squared(self.mean[i], block));
        let inside = determinant > 0.0 && distance <= GATE;
        inside.then(|| candidates[i].log_odds - LN_TAU - 0.5 * (math::ln(determinant) + distance))
    }

    /// Makes the landmarks of a pair one.
    fn condition(&mut self, i: usize) {
        let size = 2 * self.mean.len();
        let (inverse, [x, y]) = (Inverse::of(self.block(i)), self.mean[i]);
        let columns: Vec<[f64; 2]> = (0..size).map(|r| [0, 1].map(|c| self.covariance[r * size + 2 * i + c])).collect();
        for (row, own) in columns.iter().enumerate() {
            let gain = inverse.times(*own);
            self.mean[row / 2][row % 2] -= gain[0] * x + gain[1] * y;
            for (value, [c, d]) in self.covariance[row * size..][..size].iter_mut().zip(&columns) {
                *value -= gain[0] * c + gain[1] * d;
            }
        }
    }

    /// The covariance of one pair.
    fn block(&self, i: usize) -> Symmetric2 {
        let size = 2 * self.mean.len();
        let at = |r: usize, c: usize| self.covariance[(2 * i + r) * size + 2 * i + c];
        Symmetric2::new(at(0, 0), at(0, 1), at(1, 1))
    }
}

/// Unit vectors along which all differences at these places move as one: along x, along y, turned about their middle.
fn rigid_modes(places: &[[f64; 2]]) -> Vec<Vec<f64>> {
    let count = places.len() as f64;
    let middle = [0, 1].map(|axis| places.iter().map(|place| place[axis]).sum::<f64>() / count);
    let along = |axis: usize| (0..2 * places.len()).map(|i| if i % 2 == axis { 1.0 } else { 0.0 }).collect();
    let turned = places.iter().flat_map(|place| [middle[1] - place[1], place[0] - middle[0]]).collect();
    let mut modes: Vec<Vec<f64>> = vec![along(0), along(1), turned];
    modes.retain_mut(|mode| {
        let length = mode.iter().map(|part| part * part).sum::<f64>().sqrt();
        mode.iter_mut().for_each(|part| *part /= length);
        length > 0.0
    });
    modes
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Three pairs that share an error of 1 m² and have 0.01 m² each of their own; the third shares the younger landmark of
    /// the first.
    fn three(mean: [[f64; 2]; 3]) -> (Differences, Vec<Candidate>) {
        let covariance = |[p, a]: Pair, [q, b]: Pair| match (a == b, p == q) {
            (false, _) => 0.0,
            (true, false) => 1.0,
            (true, true) => 1.01,
        };
        let pairs = [[0, 5], [1, 6], [2, 5]];
        let candidates = pairs.map(|pair| Candidate { pair, log_odds: 3.0 });
        (Differences::new(mean.to_vec(), 0.0, covariance), candidates.to_vec())
    }

    #[test]
    fn one_after_the_other_gives_the_joint_density() {
        let (differences, candidates) = three([[1.0, -1.0], [1.1, -0.9], [9.0, 9.0]]);
        let got = differences.log_odds_of(&candidates, &[[0, 5], [1, 6]]);
        // Each axis: covariance [[1.01, 1], [1, 1.01]], determinant 0.0201.
        let axis = |a: f64, b: f64| {
            let squared = (1.01 * a * a - 2.0 * a * b + 1.01 * b * b) / 0.0201;
            -LN_TAU - 0.5 * 0.0201_f64.ln() - 0.5 * squared
        };
        let joint = 6.0 + axis(1.0, 1.1) + axis(-1.0, -0.9);
        assert!((got - joint).abs() < 1e-9, "{got} for {joint}");
    }

    #[test]
    fn a_set_takes_each_landmark_once_and_only_what_fits() {
        let (differences, candidates) = three([[1.0, -1.0], [1.1, -0.9], [1.0, -1.1]]);
        let set = differences.grow(&candidates, 0).unwrap();
        assert_eq!(set.pairs, vec![[0, 5], [1, 6]]);
        assert!((set.log_odds - differences.log_odds_of(&candidates, &set.pairs)).abs() < 1e-12);
        assert!(set.contradicts([2, 5]) && !set.contradicts([0, 5]) && !set.contradicts([3, 7]));
        // Half a metre from the first one is five standard deviations of their difference's difference.
        let (differences, candidates) = three([[1.0, -1.0], [1.5, -1.5], [9.0, 9.0]]);
        assert_eq!(differences.grow(&candidates, 0).unwrap().pairs, vec![[0, 5]]);
        assert!(differences.grow(&candidates, 2).is_none());
        assert_eq!(differences.log_odds_of(&candidates, &[[0, 5], [1, 6]]), f64::NEG_INFINITY);
    }

    #[test]
    fn what_moves_all_as_one_body_varies_more_and_nothing_else_does() {
        let places = [[0.0, 0.0], [4.0, 0.0], [0.0, 3.0], [5.0, 7.0]];
        let own = |[p, a]: Pair, [q, b]: Pair| if (p, a) == (q, b) { 0.01 } else { 0.0 };
        let wide = Differences::new(vec![[0.0; 2]; 4], 0.0, own).with_rigid_variance(&places, 100.0);
        let variance = |of: &dyn Fn(usize) -> [f64; 2]| {
            let direction: Vec<f64> = (0..4).flat_map(of).collect();
            let length: f64 = direction.iter().map(|part| part * part).sum();
            let at = |i: usize, j: usize| wide.covariance[8 * i + j] * direction[i] * direction[j];
            (0..64).map(|i| at(i / 8, i % 8)).sum::<f64>() / length
        };
        for rigid in
            [&(|_| [1.0, 0.0]) as &dyn Fn(usize) -> [f64; 2], &|_| [0.0, 1.0], &|i| [-places[i][1], places[i][0]]]
        {
            assert!((variance(rigid) - 1.0).abs() < 1e-9, "{}", variance(rigid));
        }
        // Stretched about the middle.
        assert!((variance(&|i| [places[i][0] - 2.25, places[i][1] - 2.5]) - 0.01).abs() < 1e-9);
    }
}
