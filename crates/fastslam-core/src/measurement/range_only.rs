//! Distance of a landmark, and nothing else: beacons that are heard.

use super::{Births, Component, Linearization, MeasurementModel};
use crate::geometry::Pose;
use crate::math;
use crate::normal::{turned, Matrix, Normal};
use crate::real::Real;
use serde::Serialize;
use std::f64::consts::TAU;

/// Gaussians of a ring at most; a wider ring has wider ones.
const MOST_IN_A_RING: f64 = 128.0;
/// Distance of neighbours in standard deviations along the ring: their sum is even to 3 %.
const SPACING: f64 = 1.5;

/// Range.
///
/// **Measurement:** (range in m,); g = |θ − s|.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct RangeOnly {
    /// Standard deviation of the range.
    pub range_std_m: f64,
}

impl MeasurementModel<1, 2> for RangeOnly {
    fn expected<R: Real>(&self, T_world_sensor: Pose<R>, landmark_in_world: [R; 2]) -> [R; 1] {
        let dx = landmark_in_world[0] - T_world_sensor.x;
        let dy = landmark_in_world[1] - T_world_sensor.y;
        [(dx * dx + dy * dy).sqrt()]
    }

    fn innovation<R: Real>(&self, measured: [R; 1], expected: [R; 1]) -> [R; 1] {
        [measured[0] - expected[0]]
    }

    fn noise(&self) -> Matrix<1, 1> {
        [[self.range_std_m * self.range_std_m]]
    }

    fn components(&self) -> [Component; 1] {
        [Component { name: "range", unit: "m", noise_key: "range_std_m" }]
    }

    fn linearize(&self, T_world_sensor: Pose, landmark_in_world: [f64; 2]) -> Linearization<1, 2> {
        let (dx, dy) = (landmark_in_world[0] - T_world_sensor.x, landmark_in_world[1] - T_world_sensor.y);
        let range = (dx * dx + dy * dy).sqrt();
        // At the landmark itself no direction is better than another: a sighting there moves nothing.
        let inverse = if range > 0.0 { 1.0 / range } else { 0.0 };
        let (x, y) = (dx * inverse, dy * inverse);
        Linearization { expected: [range], by_landmark: [[x, y]], by_pose: [[-x, -y, 0.0]] }
    }
}

impl Births<1, 2> for RangeOnly {
    /// A ring of Gaussians, all alike: σ_r across, and along as wide as the ring is straight to half a σ_r.
    ///
    /// **Source:** `blanco2008efficient`; a chord of half-length σ_t leaves a ring of radius r by σ_t² / 2r.
    fn births(&self, T_world_sensor: Pose, [range_m]: [f64; 1], noise: &Matrix<1, 1>) -> Vec<(f64, Normal<2>)> {
        let across = noise[0][0].sqrt();
        let straight = (range_m * across).sqrt();
        let count = (TAU * range_m / (SPACING * straight)).ceil().clamp(4.0, MOST_IN_A_RING);
        let along = TAU * range_m / (SPACING * count);
        let (radial, tangential) = (across * across, along * along);
        (0..count as u32)
            .map(|i| {
                let (s, c) = math::sin_cos(math::wrap_angle(T_world_sensor.heading + TAU * f64::from(i) / count));
                let mean = [T_world_sensor.x + range_m * c, T_world_sensor.y + range_m * s];
                (1.0 / count, Normal { mean, covariance: turned([radial, tangential], (s, c)) })
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ring_is_even_and_as_wide_as_the_noise() {
        let model = RangeOnly { range_std_m: 0.5 };
        for range_m in [0.6, 5.0, 70.0] {
            let ring = model.births(Pose::new(3.0, -2.0, 0.7), [range_m], &model.noise());
            assert!((ring.iter().map(|(share, _)| share).sum::<f64>() - 1.0).abs() < 1e-12);
            let density = |angle: f64| {
                let (s, c) = angle.sin_cos();
                let at = [3.0 + range_m * c, -2.0 + range_m * s];
                let part = |(share, normal): &(f64, Normal<2>)| {
                    let off = [at[0] - normal.mean[0], at[1] - normal.mean[1]];
                    let fit = crate::normal::fit(&off, &normal.covariance, crate::density::Tail::Gaussian).unwrap();
                    share * fit.log_likelihood.exp()
                };
                ring.iter().map(part).sum::<f64>()
            };
            let around: Vec<f64> = (0..1000).map(|i| density(TAU * f64::from(i) / 1000.0)).collect();
            let (least, most) = around.iter().fold((f64::MAX, 0.0_f64), |(a, b), v| (a.min(*v), b.max(*v)));
            assert!(range_m < 1.0 || least / most > 0.85, "{range_m}: {least} to {most}");
        }
    }
}
