//! Places at which a local map may lie, the best first.

use super::{Inquiry, IN_MAP};
use crate::geometry::Pose;
use crate::math;

/// Pairs of the local map that are looked for, of each of its landmarks.
const MOST_USES: usize = 4;
/// Places that are looked at as a whole.
const MOST_PROPOSALS: usize = 60_000;
/// Local landmarks of which one must lie on the map beside the pair, where there are so many.
const WITNESSES: usize = 3;

/// A pose whose turn is kept as cosine and sine.
#[derive(Clone, Copy)]
struct Laid {
    shift: [f64; 2],
    cosine: f64,
    sine: f64,
}

impl Laid {
    /// The pose that lays a segment on another one, middle on middle; None where one has no length.
    fn on(ours: [[f64; 2]; 2], theirs: [[f64; 2]; 2]) -> Option<Self> {
        let [a, b] = [ours, theirs].map(|[from, to]| [to[0] - from[0], to[1] - from[1]]);
        let size = (a[0].hypot(a[1])) * (b[0].hypot(b[1]));
        if size <= 0.0 {
            return None;
        }
        let cosine = (a[0] * b[0] + a[1] * b[1]) / size;
        let sine = (a[0] * b[1] - a[1] * b[0]) / size;
        let [ours, theirs] = [ours, theirs].map(|[from, to]| [0.5 * (from[0] + to[0]), 0.5 * (from[1] + to[1])]);
        let shift = [theirs[0] - (cosine * ours[0] - sine * ours[1]), theirs[1] - (sine * ours[0] + cosine * ours[1])];
        Some(Self { shift, cosine, sine })
    }

    fn apply(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        [self.shift[0] + self.cosine * x - self.sine * y, self.shift[1] + self.sine * x + self.cosine * y]
    }

    fn pose(&self) -> Pose {
        Pose::new(self.shift[0], self.shift[1], math::atan2(self.sine, self.cosine))
    }
}

impl Inquiry<'_> {
    /// Poses that lay a pair of local landmarks on one of the map, the likeliest first.
    pub(super) fn proposals(&self) -> Vec<Pose> {
        let mut found: Vec<(f64, Laid)> = Vec::new();
        for [first, second] in self.local_pairs() {
            self.lay(first, second, &mut found);
            if found.len() >= MOST_PROPOSALS {
                break;
            }
        }
        found.sort_by(|a, b| b.0.total_cmp(&a.0));
        found.into_iter().map(|(_, laid)| laid.pose()).collect()
    }

    /// Pairs of local landmarks: long ones fix the heading; those that are known well come first among them.
    fn local_pairs(&self) -> Vec<[usize; 2]> {
        let mut pairs: Vec<(f64, [usize; 2])> = Vec::new();
        for (second, b) in self.local.iter().enumerate() {
            for (first, a) in self.local[..second].iter().enumerate() {
                let length2 = (b.mean[0] - a.mean[0]).powi(2) + (b.mean[1] - a.mean[1]).powi(2);
                if length2.sqrt() + self.tolerance_m <= self.chart.pairs.longest_m() {
                    pairs.push(((a.variance + b.variance) / length2.max(1e-18), [first, second]));
                }
            }
        }
        pairs.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        // A far landmark that is in no map must not be in all of the pairs.
        let mut uses = vec![0; self.local.len()];
        let mut chosen = Vec::new();
        for (_, [first, second]) in pairs {
            if uses[first] < MOST_USES && uses[second] < MOST_USES {
                uses[first] += 1;
                uses[second] += 1;
                chosen.push([first, second]);
            }
        }
        chosen
    }

    /// All places of one local pair.
    fn lay(&self, first: usize, second: usize, found: &mut Vec<(f64, Laid)>) {
        let (a, b) = (&self.local[first], &self.local[second]);
        let length_m = (b.mean[0] - a.mean[0]).hypot(b.mean[1] - a.mean[1]);
        let witnesses = self.witnesses(first, second);
        for &[i, j] in self.chart.pairs.near(length_m, self.tolerance_m) {
            for [i, j] in [[i, j], [j, i]] {
                let (c, d) = (&self.chart.marks[i as usize], &self.chart.marks[j as usize]);
                if self.looks(a, c) <= 0.0 || self.looks(b, d) <= 0.0 {
                    continue;
                }
                let Some(laid) = Laid::on([a.mean, b.mean], [c.mean, d.mean]) else {
                    continue;
                };
                if self.is_witnessed(&laid, &witnesses) {
                    found.push((self.score(&laid), laid));
                }
            }
        }
    }

    /// Local landmarks that are known best, beside a pair.
    fn witnesses(&self, first: usize, second: usize) -> Vec<usize> {
        let mut others: Vec<usize> = (0..self.local.len()).filter(|k| *k != first && *k != second).collect();
        others.sort_by(|a, b| self.local[*a].variance.total_cmp(&self.local[*b].variance).then(a.cmp(b)));
        others.truncate(WITNESSES);
        others
    }

    fn is_witnessed(&self, laid: &Laid, witnesses: &[usize]) -> bool {
        witnesses.len() < WITNESSES
            || witnesses
                .iter()
                .any(|&k| self.chart.nearest.within(laid.apply(self.local[k].mean), 1.5 * self.tolerance_m).is_some())
    }

    /// Σ ln of the likelihood ratio of each local landmark, the nearest of the map alone counted.
    fn score(&self, laid: &Laid) -> f64 {
        let ratios = self.local.iter().map(|ours| {
            self.chart
                .nearest
                .within(laid.apply(ours.mean), self.gate_m)
                .map_or(1.0 - IN_MAP, |(row, distance2)| self.ratio(ours, &self.chart.marks[row], distance2))
        });
        // One logarithm of the product of four: none of them is as small as 0.1 or as large as 1e60.
        let mut sum = 0.0;
        let mut product = 1.0;
        for (k, ratio) in ratios.enumerate() {
            product *= ratio.min(1e60);
            if k % 4 == 3 {
                sum += math::ln(product);
                product = 1.0;
            }
        }
        sum + math::ln(product)
    }
}
