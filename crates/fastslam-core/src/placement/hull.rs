//! The area of a convex hull.

/// Of the hull of points, m².
///
/// **Source:** Andrew's monotone chain, and the shoelace formula.
pub fn area(points: &[[f64; 2]]) -> f64 {
    let mut sorted = points.to_vec();
    sorted.sort_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
    let lower = chain(sorted.iter());
    let upper = chain(sorted.iter().rev());
    let ring: Vec<[f64; 2]> = lower.into_iter().chain(upper).collect();
    let twice: f64 =
        (0..ring.len()).map(|i| (ring[i], ring[(i + 1) % ring.len()])).map(|(a, b)| a[0] * b[1] - a[1] * b[0]).sum();
    0.5 * twice.abs()
}

/// The points of one side, without its last.
fn chain<'a>(points: impl Iterator<Item = &'a [f64; 2]>) -> Vec<[f64; 2]> {
    let mut side: Vec<[f64; 2]> = Vec::new();
    for &point in points {
        while side.len() >= 2 && turn(side[side.len() - 2], side[side.len() - 1], point) <= 0.0 {
            side.pop();
        }
        side.push(point);
    }
    side.pop();
    side
}

fn turn(a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> f64 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}
