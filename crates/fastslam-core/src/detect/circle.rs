//! A circle through an arc of points, with what the beams beside it say about its width.

/// Where an object ends: the line of sight halfway between the last beam on it and the first beside it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Edge {
    /// Where the beam was sent from.
    pub origin: [f64; 2],
    /// Unit vector.
    pub direction: [f64; 2],
    /// +1 on the side of larger angles, −1 on the other.
    pub side: f64,
    /// How far the true edge may be off, across the line of sight, per metre of range.
    pub std_rad: f64,
    /// A beam of finite width is echoed by an object that its axis misses by up to this angle.
    pub overhang_rad: f64,
}

/// What is known before the fit: errors of the sensor and the size of the objects.
#[derive(Clone, Copy, Debug)]
pub(super) struct Noise {
    /// Of one range.
    pub range_std_m: f64,
    /// Of the direction of one beam.
    pub beam_std_rad: f64,
    /// Deviation of the surface from a circle.
    pub roughness_std_m: f64,
    /// Expected radius, used only where an end of the object cannot be seen.
    pub radius_m: f64,
    /// Spread of the radius.
    pub radius_std_m: f64,
}

/// Centre, radius, and the covariance of (x, y, radius).
#[derive(Clone, Copy, Debug)]
pub(super) struct Circle {
    pub center: [f64; 2],
    pub radius: f64,
    pub covariance: [[f64; 3]; 3],
    /// Root mean square of the distances to the circle in units of their standard deviation.
    pub normalized_residual: f64,
}

/// The points of an arc as seen from the sensor, and the ends that are free.
#[derive(Clone, Copy, Debug)]
pub(super) struct Arc<'a> {
    /// Relative to `origin`.
    pub points: &'a [[f64; 2]],
    /// Where the middle beam was sent from.
    pub origin: [f64; 2],
    /// Ends that are not hidden.
    pub edges: [Option<Edge>; 2],
}

/// Least-squares circle through the points by a linear system (Kåsa): a start for [`refine`].
///
/// **Source:** Kåsa, "A circle fitting procedure and its error analysis", IEEE Trans. Instrum. Meas. 25, 1976.
pub(super) fn algebraic(points: &[[f64; 2]]) -> Option<([f64; 2], f64)> {
    if points.len() < 4 {
        return None;
    }
    let scale = 1.0 / points.len() as f64;
    let mean = points.iter().fold([0.0; 2], |m, p| [m[0] + scale * p[0], m[1] + scale * p[1]]);
    let (mut normal, mut right) = ([[0.0; 3]; 3], [0.0; 3]);
    for p in points {
        let (x, y) = (p[0] - mean[0], p[1] - mean[1]);
        accumulate(&mut normal, &mut right, [x, y, 1.0], x * x + y * y, 1.0);
    }
    let [a, b, c] = solve(&normal, right)?;
    let center = [0.5 * a, 0.5 * b];
    let radius_squared = c + center[0] * center[0] + center[1] * center[1];
    (radius_squared > 0.0).then(|| ([mean[0] + center[0], mean[1] + center[1]], radius_squared.sqrt()))
}

/// Gauss–Newton on the distances to the circle, the tangents at the free ends and, where an end is hidden, the prior
/// of the radius.
///
/// A distance has the variance of its range seen at the incidence of the beam: σ_r² cos²φ + (r σ_b sin φ)² plus that of
/// the surface. The incidence φ comes from how far the beam passes the centre, which the error of its range does not
/// change: were it taken from the point, near points would weigh less than far ones. A range error ε moves the point by ε cos φ across the circle and, to second order, by ε² sin²φ / 2R
/// outwards; that mean is taken off, or near circles would come out too large.
pub(super) fn refine(arc: &Arc, start: ([f64; 2], f64), noise: &Noise) -> Option<Circle> {
    let (mut center, mut radius) = start;
    let mut residual = 0.0;
    let mut information = [[0.0; 3]; 3];
    for _ in 0..12 {
        let mut gradient = [0.0; 3];
        information = [[0.0; 3]; 3];
        residual = add_points(arc, (center, radius), noise, (&mut information, &mut gradient));
        add_edges(arc, (center, radius), (&mut information, &mut gradient));
        if arc.edges.iter().any(Option::is_none) {
            let weight = 1.0 / (noise.radius_std_m * noise.radius_std_m);
            accumulate(&mut information, &mut gradient, [0.0, 0.0, 1.0], noise.radius_m - radius, weight);
        }
        let step = solve(&information, gradient)?;
        center = [center[0] + step[0], center[1] + step[1]];
        // A step may not turn the circle inside out.
        radius = (radius + step[2]).max(0.2 * radius);
        if step.iter().all(|s| s.abs() < 1e-6) {
            break;
        }
    }
    let columns = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(|unit| solve(&information, unit));
    let [Some(a), Some(b), Some(c)] = columns else { return None };
    let finite = radius.is_finite() && center.iter().all(|v| v.is_finite());
    finite.then_some(Circle { center, radius, covariance: [a, b, c], normalized_residual: residual })
}

type Normal<'a> = (&'a mut [[f64; 3]; 3], &'a mut [f64; 3]);

/// Adds the points' equations and returns the root mean square of their normalised residuals.
fn add_points(arc: &Arc, (center, radius): ([f64; 2], f64), noise: &Noise, normal: Normal) -> f64 {
    let range_variance = noise.range_std_m * noise.range_std_m;
    let beam_variance = noise.beam_std_rad * noise.beam_std_rad;
    let mut sum = 0.0;
    for p in arc.points {
        let to_point = [p[0] - center[0], p[1] - center[1]];
        let distance = norm(to_point).max(1e-12);
        let range_squared = p[0] * p[0] + p[1] * p[1];
        let unit = [to_point[0] / distance, to_point[1] / distance];
        let across = center[0] * p[1] - center[1] * p[0];
        let sin_squared = (across * across / (range_squared * radius * radius).max(1e-12)).min(1.0);
        let cos_squared = 1.0 - sin_squared;
        let variance = range_variance * cos_squared
            + range_squared * beam_variance * sin_squared
            + noise.roughness_std_m * noise.roughness_std_m;
        let bias = 0.5 * range_variance * sin_squared / radius;
        let error = distance - radius - bias;
        sum += error * error / variance;
        accumulate(normal.0, normal.1, [unit[0], unit[1], 1.0], error, 1.0 / variance);
    }
    (sum / arc.points.len() as f64).sqrt()
}

fn add_edges(arc: &Arc, (center, radius): ([f64; 2], f64), normal: Normal) {
    for edge in arc.edges.iter().flatten() {
        let from_edge =
            [center[0] + arc.origin[0] - edge.origin[0], center[1] + arc.origin[1] - edge.origin[1]];
        let across = edge.side * (from_edge[0] * edge.direction[1] - from_edge[1] * edge.direction[0]);
        let distance = norm(from_edge).max(1e-6);
        let std = edge.std_rad * distance;
        let row = [edge.side * edge.direction[1], -edge.side * edge.direction[0], -1.0];
        let error = radius + edge.overhang_rad * distance - across;
        accumulate(normal.0, normal.1, row, error, 1.0 / (std * std));
    }
}

/// Adds weight · rowᵀ(row, error) to the normal equations; only the lower triangle is used.
#[inline]
fn accumulate(matrix: &mut [[f64; 3]; 3], right: &mut [f64; 3], row: [f64; 3], error: f64, weight: f64) {
    for i in 0..3 {
        let scaled = weight * row[i];
        right[i] += scaled * error;
        for j in 0..=i {
            matrix[i][j] += scaled * row[j];
        }
    }
}

/// Solves a symmetric system given by its lower triangle; None where it is not positive definite.
fn solve(a: &[[f64; 3]; 3], b: [f64; 3]) -> Option<[f64; 3]> {
    let mut l = [[0.0; 3]; 3];
    for i in 0..3 {
        for j in 0..=i {
            let sum = (0..j).fold(a[i][j], |sum, k| sum - l[i][k] * l[j][k]);
            if i == j {
                if !(sum > 1e-13 * a[i][i].abs() && sum.is_finite()) {
                    return None;
                }
                l[i][i] = sum.sqrt();
            } else {
                l[i][j] = sum / l[j][j];
            }
        }
    }
    let mut x = b;
    for i in 0..3 {
        x[i] = (0..i).fold(x[i], |sum, k| sum - l[i][k] * x[k]) / l[i][i];
    }
    for i in (0..3).rev() {
        x[i] = (i + 1..3).fold(x[i], |sum, k| sum - l[k][i] * x[k]) / l[i][i];
    }
    Some(x)
}

pub(super) fn norm(v: [f64; 2]) -> f64 {
    (v[0] * v[0] + v[1] * v[1]).sqrt()
}
