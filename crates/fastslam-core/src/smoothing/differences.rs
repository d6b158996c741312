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
}
