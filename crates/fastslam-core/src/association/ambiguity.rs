//! Landmarks whose place as the robot sees it is known too badly for the nearest one to be the right one.
//!
//! Before a loop closes, particles differ in how they relate to the old part of the map. Each has gates as narrow as if
//! its pose were the truth, so that among many some match a landmark by chance; weights then take chance for evidence,
//! and the particles without the match are resampled away. Where other landmarks are about as likely to lie in the
//! region over which particles disagree, no particle decides: the sighting founds a landmark, and whether that is an
//! old one is left to the joint evidence of whole groups when paths are drawn anew.

use crate::gaussian::ellipse_area;
use crate::landmark::column;
use crate::math;
use crate::store::Rows;

/// χ² that a two-dimensional Gaussian stays below with 99 %.
pub const GATE: f64 = 9.21;

/// Area of the ellipse that holds 99 % of a Gaussian whose covariance has this determinant (m⁴), square metres.
pub fn area_m2(determinant: f64) -> f64 {
    ellipse_area(GATE, determinant)
}

/// Area of the ellipse that holds 99 % of the places of a landmark in the robot frames of the particles that hold it,
/// square metres; `None` when fewer than two do.
///
/// **Shapes:** x, y (m) and heading (rad) of every particle, and the rows of the landmark.
pub fn disagreement_m2([x, y, heading]: [&[f64]; 3], rows: &Rows<'_>) -> Option<f64> {
    let (sightings, at) = (rows.column(column::SIGHTINGS), [column::MEAN_X, column::MEAN_Y].map(|c| rows.column(c)));
    let mut sum = Moments::default();
    // Differences from one of the particles, so that nothing cancels far from the origin.
    let mut origin = None;
    for i in (0..x.len()).filter(|i| sightings[*i] != 0.0) {
        let (s, c) = math::sin_cos(heading[i]);
        let (dx, dy) = (at[0][i] - x[i], at[1][i] - y[i]);
        let [u, v] = [c * dx + s * dy, c * dy - s * dx];
        let [u0, v0] = *origin.get_or_insert([u, v]);
        sum.add([u - u0, v - v0]);
    }
    (sum.count >= 2.0).then(|| area_m2(sum.covariance_determinant()))
}

/// Sums over particles of a place (x, y) and of its products (xx, xy, yy).
#[derive(Default)]
struct Moments {
    count: f64,
    first: [f64; 2],
    second: [f64; 3],
}

impl Moments {
    fn add(&mut self, [x, y]: [f64; 2]) {
        self.count += 1.0;
        self.first.iter_mut().zip([x, y]).for_each(|(sum, value)| *sum += value);
        self.second.iter_mut().zip([x * x, x * y, y * y]).for_each(|(sum, value)| *sum += value);
    }

    fn covariance_determinant(&self) -> f64 {
        let [x, y] = self.first.map(|sum| sum / self.count);
        let [xx, xy, yy] = self.second.map(|sum| sum / self.count);
        (xx - x * x) * (yy - y * y) - (xy - x * y) * (xy - x * y)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The columns of one landmark in maps that all have it at (5, 1), but for the last, which lacks it.
    fn landmark(particles: usize) -> Vec<f64> {
        let mut values = vec![0.0; particles * column::COUNT];
        values[column::MEAN_X * particles..][..particles].fill(5.0);
        values[column::MEAN_Y * particles..][..particles].fill(1.0);
        values[column::SIGHTINGS * particles..][..particles - 1].fill(3.0);
        values
    }

    #[test]
    fn what_all_particles_see_alike_has_no_area() {
        let values = landmark(4);
        let same = [1.0; 4];
        assert!(disagreement_m2([&same, &same, &same], &Rows::new(&values, 4)).unwrap() < 1e-9);
    }

    #[test]
    fn the_area_is_that_of_the_ellipse_of_the_particles_that_hold_it() {
        // Four holders at the corners of a rectangle of 2 by 4 m: variances 1 and 4; the fifth does not count.
        let values = landmark(5);
        let (x, y) = ([-1.0, 1.0, -1.0, 1.0, 90.0], [-2.0, -2.0, 2.0, 2.0, 90.0]);
        for heading in [0.0, 0.8] {
            let area = disagreement_m2([&x, &y, &[heading; 5]], &Rows::new(&values, 5)).unwrap();
            let expected = std::f64::consts::PI * GATE * 2.0;
            assert!((area - expected).abs() < 1e-9, "{area} for {expected}");
        }
    }

    #[test]
    fn one_particle_knows_no_disagreement() {
        let values = landmark(2);
        assert_eq!(disagreement_m2([&[0.0, 1.0], &[0.0; 2], &[0.0; 2]], &Rows::new(&values, 2)), None);
    }
}
