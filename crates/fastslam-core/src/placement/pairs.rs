//! Pairs of landmarks by their distance.

use super::nearest::Nearest;
use std::f64::consts::PI;

/// More pairs than this are not kept: the longest are left out.
const MOST_PAIRS: f64 = 500_000.0;

/// Pairs of a map's landmarks, shortest first.
#[derive(Clone, Debug)]
pub struct Pairs {
    lengths: Vec<f64>,
    ends: Vec<[u32; 2]>,
    longest_m: f64,
}

impl Pairs {
    /// Of points with finite coordinates.
    pub fn new(points: &[[f64; 2]], nearest: &Nearest) -> Self {
        let count = points.len() as f64;
        let mut longest_m = f64::INFINITY;
        if count * count / 2.0 > MOST_PAIRS {
            longest_m = nearest.cell_m() * (2.0 * MOST_PAIRS / (PI * count)).sqrt();
        }
        let mut found = loop {
            match gathered(points, nearest, longest_m) {
                Some(found) => break found,
                // Landmarks stand closer in places than on average.
                None => longest_m *= 0.7,
            }
        };
        found.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let (lengths, ends) = found.into_iter().unzip();
        Self { lengths, ends, longest_m }
    }

    /// The length up to which all pairs are here.
    pub fn longest_m(&self) -> f64 {
        self.longest_m
    }

    /// Those whose length is within a tolerance of `length_m`.
    pub fn near(&self, length_m: f64, tolerance_m: f64) -> &[[u32; 2]] {
        let begin = self.lengths.partition_point(|length| *length < length_m - tolerance_m);
        let end = self.lengths.partition_point(|length| *length <= length_m + tolerance_m);
        &self.ends[begin..end]
    }
}

/// All pairs up to a length; None where there are far too many.
fn gathered(points: &[[f64; 2]], nearest: &Nearest, longest_m: f64) -> Option<Vec<(f64, [u32; 2])>> {
    let mut found: Vec<(f64, [u32; 2])> = Vec::new();
    for (row, point) in points.iter().enumerate() {
        let mut keep = |other: usize, distance2: f64| {
            if other > row && distance2 <= longest_m * longest_m {
                found.push((distance2.sqrt(), [row as u32, other as u32]));
            }
        };
        if longest_m.is_finite() {
            nearest.each(*point, longest_m, keep);
        } else {
            for (other, [x, y]) in points.iter().enumerate().skip(row + 1) {
                keep(other, (x - point[0]).powi(2) + (y - point[1]).powi(2));
            }
        }
        if found.len() as f64 > 2.0 * MOST_PAIRS {
            return None;
        }
    }
    Some(found)
}
