//! Walls at grazing incidence: their ranges jump from beam to beam, so that they fall into pieces as small as rocks.

use super::beams::{Beams, Echo};
use super::circle::Noise;
use super::line::{self, Line};
use super::segments::{after, before, Segment};

/// So many echoes beside a piece are looked at, on either side.
const NEIGHBOURS: usize = 2;

/// Two points always lie on a line.
const LEAST_FOR_A_LINE: usize = 3;

/// Whether the echoes next to a piece lie on one straight line with it: on one side, or one on each.
///
/// A free-standing object is not in line with the background beside it but by chance, and hardly with two points of it.
pub(super) fn goes_on(beams: &Beams, segment: Segment, noise: &Noise, max_normalized_residual: f64) -> bool {
    let low = run(beams, |m| before(beams, segment, m));
    let high = run(beams, |m| after(beams, segment, m));
    let n = beams.len();
    [(low, 0), (0, high), (low.min(1), high.min(1))].into_iter().any(|(low, high)| {
        // Counted on over the seam, so that the first beam does not come out below 0.
        let shift = if segment.first < low { n } else { 0 };
        let (first, last) = (segment.first + shift - low, segment.last + shift + high);
        let wider = Segment { first, last, hits: segment.hits + low + high };
        let enough = low + high >= NEIGHBOURS && wider.hits > LEAST_FOR_A_LINE && last < 2 * n;
        enough
            && line::fit(beams, wider, noise.range_std_m)
                .is_some_and(|line| normalized_residual(beams, &line, noise) <= max_normalized_residual)
    })
}

/// Whether a straight line explains the points of a piece at least as well as a circle with this normalised residual.
pub(super) fn is_straight(beams: &Beams, segment: Segment, noise: &Noise, circle_residual: f64) -> bool {
    segment.hits >= LEAST_FOR_A_LINE
        && line::fit(beams, segment, noise.range_std_m).is_some_and(|line| {
            let fitted = 2.0 / line.hits as f64;
            normalized_residual(beams, &line, noise) * (1.0 - fitted).sqrt() <= circle_residual
        })
}

/// Echoes in a row beside a piece, NEIGHBOURS at most.
fn run(beams: &Beams, beside: impl Fn(usize) -> Option<usize>) -> usize {
    (1..=NEIGHBOURS).take_while(|&m| beside(m).is_some_and(|i| beams.echo[i] == Echo::Hit)).count()
}

/// Root mean square distance from the line in standard deviations, which shrink with the angle to the beams.
fn normalized_residual(beams: &Beams, line: &Line, noise: &Noise) -> f64 {
    let hits = (line.first..=line.last).map(|i| beams.index(i)).filter(|&i| beams.echo[i] == Echo::Hit);
    let sum: f64 = hits
        .map(|i| {
            let (p, d, n) = (beams.point(i), beams.direction[i], line.normal);
            let distance = n[0] * p[0] + n[1] * p[1] - line.distance;
            let (across, along) = (n[0] * d[0] + n[1] * d[1], n[0] * d[1] - n[1] * d[0]);
            let variance = (noise.range_std_m * across).powi(2)
                + (beams.range[i] * noise.beam_std_rad * along).powi(2)
                + noise.roughness_std_m * noise.roughness_std_m;
            distance * distance / variance
        })
        .sum();
    // Two numbers were fitted.
    (sum / (line.hits as f64 - 2.0)).sqrt()
}
