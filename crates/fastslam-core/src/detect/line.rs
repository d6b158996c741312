//! Straight lines through points, with their covariance.

use super::beams::{Beams, Echo};
use super::segments::Segment;
use crate::geometry::Symmetric2;

/// A straight piece of wall: points p with normal · p = distance.
#[derive(Clone, Copy, Debug)]
pub(super) struct Line {
    pub first: usize,
    pub last: usize,
    pub hits: usize,
    pub normal: [f64; 2],
    pub distance: f64,
    /// Middle of the points, where direction and offset are independent.
    pub middle: [f64; 2],
    pub offset_variance: f64,
    pub angle_variance: f64,
    pub length: f64,
    /// Root mean square distance of the points.
    pub residual: f64,
}

/// The line of least squared distances through the hits of a segment; None where they do not spread.
pub(super) fn fit(beams: &Beams, segment: Segment, range_std_m: f64) -> Option<Line> {
    let hits = || (segment.first..=segment.last).map(|i| beams.index(i)).filter(|&i| beams.echo[i] == Echo::Hit);
    let n = segment.hits as f64;
    let middle = hits().map(|i| beams.point(i)).fold([0.0; 2], |m, p| [m[0] + p[0] / n, m[1] + p[1] / n]);
    let spread = hits().map(|i| beams.point(i)).fold(Symmetric2::new(0.0, 0.0, 0.0), |s, p| {
        let (x, y) = (p[0] - middle[0], p[1] - middle[1]);
        Symmetric2::new(s.xx + x * x, s.xy + x * y, s.yy + y * y)
    });
    let along = spread.largest_eigenvalue();
    let across = (spread.xx + spread.yy - along).max(0.0);
    // The direction of the larger eigenvector, from the better conditioned of its two forms.
    let (x, y) = if spread.xx > spread.yy { (along - spread.yy, spread.xy) } else { (spread.xy, along - spread.xx) };
    let length = (x * x + y * y).sqrt();
    if !(length > 0.0 && length.is_finite() && along > 0.0) {
        return None;
    }
    let normal = [-y / length, x / length];
    let project = |i: usize| {
        let p = beams.point(i);
        (p[0] * x + p[1] * y) / length
    };
    let ends = [project(beams.index(segment.first)), project(beams.index(segment.last))];
    let variance = range_std_m * range_std_m;
    Some(Line {
        first: segment.first,
        last: segment.last,
        hits: segment.hits,
        normal,
        distance: normal[0] * middle[0] + normal[1] * middle[1],
        middle,
        offset_variance: variance / n,
        angle_variance: variance / along,
        length: (ends[1] - ends[0]).abs(),
        residual: (across / n).sqrt(),
    })
}

/// Where two lines meet, with the covariance; None where they are parallel.
pub(super) fn intersection(a: &Line, b: &Line) -> Option<([f64; 2], Symmetric2)> {
    let determinant = a.normal[0] * b.normal[1] - a.normal[1] * b.normal[0];
    if determinant.abs() < 1e-6 {
        return None;
    }
    let inverse = [
        [b.normal[1] / determinant, -a.normal[1] / determinant],
        [-b.normal[0] / determinant, a.normal[0] / determinant],
    ];
    let point = [
        inverse[0][0] * a.distance + inverse[0][1] * b.distance,
        inverse[1][0] * a.distance + inverse[1][1] * b.distance,
    ];
    // Each line is off, at the corner, by its offset and by its turn about its middle.
    let off = |line: &Line| {
        let arm = [point[0] - line.middle[0], point[1] - line.middle[1]];
        line.offset_variance + line.angle_variance * (arm[0] * arm[0] + arm[1] * arm[1])
    };
    Some((point, Symmetric2::new(off(a), 0.0, off(b)).transformed(inverse)))
}
