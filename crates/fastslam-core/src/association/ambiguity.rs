//! Landmarks whose place as the robot sees it is known too badly for the nearest one to be the right one.
//!
//! Before a loop closes, particles differ in how they relate to the old part of the map. Each has gates as narrow as if
//! its pose were the truth, so that among many some match a landmark by chance; weights then take chance for evidence,
//! and the particles without the match are resampled away. Where other landmarks are about as likely to lie in the
//! region over which particles disagree, no particle decides: the sighting founds a landmark, and whether that is an
//! old one is left to the joint evidence of whole groups when paths are drawn anew.

use crate::landmark::column;
use crate::math;
use crate::store::Rows;

/// χ² that a two-dimensional Gaussian stays below with 99 %.
const GATE: f64 = 9.21;

/// Where the particles see a landmark, relative to themselves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Relation {
    /// Mean of the landmark in the world, metres.
    pub landmark_in_world: [f64; 2],
    /// Area of the ellipse that holds 99 % of the places of the landmark in the particles' robot frames, square metres.
    pub area_m2: f64,
}

impl Relation {
    /// How the particles that hold a landmark relate to it; `None` when fewer than two do.
    ///
    /// **Shapes:** x, y (m) and heading (rad) of every particle, and the rows of the landmark.
    pub fn of([x, y, heading]: [&[f64]; 3], rows: &Rows<'_>) -> Option<Self> {
        let (sightings, at) =
            (rows.column(column::SIGHTINGS), [column::MEAN_X, column::MEAN_Y].map(|c| rows.column(c)));
        let mut sum = Moments::default();
        // Differences from one of the particles, so that nothing cancels far from the origin.
        let mut origin = None;
        for i in (0..x.len()).filter(|i| sightings[*i] != 0.0) {
            let (s, c) = math::sin_cos(heading[i]);
            let (dx, dy) = (at[0][i] - x[i], at[1][i] - y[i]);
            let seen = [c * dx + s * dy, c * dy - s * dx, at[0][i], at[1][i]];
            let origin = *origin.get_or_insert(seen);
            sum.add(std::array::from_fn(|k| seen[k] - origin[k]));
        }
        let origin = origin.filter(|_| sum.count >= 2.0)?;
        Some(Self {
            landmark_in_world: [2, 3].map(|k| origin[k] + sum.first[k] / sum.count),
            area_m2: std::f64::consts::PI * GATE * sum.covariance_determinant().max(0.0).sqrt(),
        })
    }
}

/// Sums over particles: of place in the robot's frame (x, y) and in the world (x, y).
#[derive(Default)]
struct Moments {
    count: f64,
    first: [f64; 4],
    second: [f64; 3],
}

impl Moments {
    fn add(&mut self, seen: [f64; 4]) {
        self.count += 1.0;
        self.first.iter_mut().zip(seen).for_each(|(sum, value)| *sum += value);
        let [x, y, ..] = seen;
        self.second.iter_mut().zip([x * x, x * y, y * y]).for_each(|(sum, value)| *sum += value);
    }

    fn covariance_determinant(&self) -> f64 {
        let [x, y, ..] = self.first.map(|sum| sum / self.count);
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
        let relation = Relation::of([&same, &same, &same], &Rows::new(&values, 4)).unwrap();
        assert!(relation.area_m2 < 1e-9, "{relation:?}");
        assert_eq!(relation.landmark_in_world, [5.0, 1.0]);
    }

    #[test]
    fn the_area_is_that_of_the_ellipse_of_the_particles_that_hold_it() {
        // Four holders at the corners of a rectangle of 2 by 4 m: variances 1 and 4; the fifth does not count.
        let values = landmark(5);
        let (x, y) = ([-1.0, 1.0, -1.0, 1.0, 90.0], [-2.0, -2.0, 2.0, 2.0, 90.0]);
        for heading in [0.0, 0.8] {
            let relation = Relation::of([&x, &y, &[heading; 5]], &Rows::new(&values, 5)).unwrap();
            let expected = std::f64::consts::PI * GATE * 2.0;
            assert!((relation.area_m2 - expected).abs() < 1e-9, "{relation:?} for {expected}");
        }
    }

    #[test]
    fn one_particle_knows_no_disagreement() {
        let values = landmark(2);
        assert_eq!(Relation::of([&[0.0, 1.0], &[0.0; 2], &[0.0; 2]], &Rows::new(&values, 2)), None);
    }
}
