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
    /// The true edge lies within this angle of the line of sight, on either side.
    pub half_width_rad: f64,
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

/// Gauss–Newton on the distances of the points from the circle, the tangents at the free ends and, where an end is
/// hidden, the prior of the radius.
///
/// Incidence φ and normal come from how far the beam passes the centre, which the error of its range does not change:
/// taken from the measured point they would correlate with that error and draw the centre towards the sensor. Points count
/// with the variance σ_r² / cos²φ + (r σ_b sin φ)² plus that of the surface: by the range alone grazing points would
/// count most, and as a grazing point goes with an edge just beyond it, that too would draw the centre in. The rest of
/// the bias, to second order, is taken off at the end.
pub(super) fn refine(arc: &Arc, start: ([f64; 2], f64), noise: &Noise) -> Option<Circle> {
    let (mut center, mut radius) = start;
    let (mut information, mut residual) = ([[0.0; 3]; 3], 0.0);
    for _ in 0..MAX_ITERATIONS {
        let mut gradient = [0.0; 3];
        information = [[0.0; 3]; 3];
        residual = add_points(arc, (center, radius), noise, (&mut information, &mut gradient));
        add_edges(arc, (center, radius), noise, (&mut information, &mut gradient));
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
    let covariance = [a, b, c];
    let bias = solve(&information, curvature(arc, (center, radius), &covariance, noise))?;
    center = [center[0] - bias[0], center[1] - bias[1]];
    radius = (radius - bias[2]).max(0.2 * radius);
    let finite = radius.is_finite() && center.iter().all(|v| v.is_finite());
    finite.then_some(Circle { center, radius, covariance, normalized_residual: residual })
}

const MAX_ITERATIONS: usize = 15;
/// Keeps the weight of a beam that only touches the circle above zero.
const MIN_COSINE_SQUARED: f64 = 1e-4;

/// How a beam meets the circle.
struct Look {
    range: f64,
    /// Unit vector of the beam.
    direction: [f64; 2],
    /// Of the angle of incidence.
    sine: f64,
    cosine: f64,
}

fn look(point: [f64; 2], (center, radius): ([f64; 2], f64)) -> Look {
    let range = norm(point).max(1e-9);
    let d = [point[0] / range, point[1] / range];
    let across = center[0] * d[1] - center[1] * d[0];
    let sine = (across / radius).clamp(-1.0, 1.0);
    Look { range, direction: d, sine, cosine: (1.0 - sine * sine).sqrt() }
}

impl Look {
    /// Derivative of the distance from the circle, less its sign: the outward normal where the beam meets the circle, or
    /// is nearest to it, and 1.
    fn row(&self) -> [f64; 3] {
        let d = self.direction;
        [-self.cosine * d[0] - self.sine * d[1], -self.cosine * d[1] + self.sine * d[0], 1.0]
    }

    fn variance(&self, noise: &Noise) -> f64 {
        let range_variance = noise.range_std_m * noise.range_std_m;
        range_variance / (self.cosine * self.cosine).max(MIN_COSINE_SQUARED)
            + (self.range * noise.beam_std_rad * self.sine).powi(2)
            + noise.roughness_std_m * noise.roughness_std_m
    }
}

type Normal<'a> = (&'a mut [[f64; 3]; 3], &'a mut [f64; 3]);

/// Adds the points' equations and returns the root mean square of their normalised residuals.
fn add_points(arc: &Arc, (center, radius): ([f64; 2], f64), noise: &Noise, normal: Normal) -> f64 {
    let mut sum = 0.0;
    for p in arc.points {
        let seen = look(*p, (center, radius));
        let error = norm([p[0] - center[0], p[1] - center[1]]) - radius;
        let variance = seen.variance(noise);
        sum += error * error / variance;
        accumulate(normal.0, normal.1, seen.row(), error, 1.0 / variance);
    }
    (sum / arc.points.len() as f64).sqrt()
}

/// Right-hand side of the equations for the bias of the fit: a centre that is off to one side by t looks t² / 2R too far
/// from points in front of it, on the mean by tᵀCt / 2R with the unit tangent t.
///
/// **Source:** Box, "Bias in nonlinear estimation", J. R. Stat. Soc. B 33, 1971: −½ (JᵀWJ)⁻¹ JᵀW m, mᵢ = tr(C Hᵢ) with
/// the second derivative Hᵢ = ttᵀ / R of the distance.
fn curvature(arc: &Arc, at: ([f64; 2], f64), covariance: &[[f64; 3]; 3], noise: &Noise) -> [f64; 3] {
    let (mut unused, mut right) = ([[0.0; 3]; 3], [0.0; 3]);
    for p in arc.points {
        let seen = look(*p, at);
        let [x, y, _] = seen.row();
        let spread = y * y * covariance[0][0] - 2.0 * x * y * covariance[0][1] + x * x * covariance[1][1];
        accumulate(&mut unused, &mut right, seen.row(), 0.5 * spread / at.1, 1.0 / seen.variance(noise));
    }
    right
}

/// Adds the equation of each free end: the line of sight halfway to the first beam beside the object touches the circle,
/// as far as the interval between the two beams says. A hidden end adds the prior of the radius instead.
fn add_edges(arc: &Arc, (center, radius): ([f64; 2], f64), noise: &Noise, normal: Normal) {
    for edge in &arc.edges {
        let Some(edge) = edge else {
            let weight = 1.0 / (noise.radius_std_m * noise.radius_std_m);
            accumulate(normal.0, normal.1, [0.0, 0.0, 1.0], noise.radius_m - radius, weight);
            continue;
        };
        let from = [center[0] + arc.origin[0] - edge.origin[0], center[1] + arc.origin[1] - edge.origin[1]];
        let distance = norm(from).max(1e-6);
        let across = edge.side * (from[0] * edge.direction[1] - from[1] * edge.direction[0]);
        // Variance of a uniform distribution.
        let variance = (edge.half_width_rad * distance).powi(2) / 3.0;
        let row = [edge.side * edge.direction[1], -edge.side * edge.direction[0], -1.0];
        accumulate(normal.0, normal.1, row, radius + edge.overhang_rad * distance - across, 1.0 / variance);
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
