//! Direction of a landmark, and nothing else: cameras and direction finders.

use super::{Births, Component, Linearization, MeasurementModel};
use crate::geometry::Pose;
use crate::math;
use crate::normal::{turned, Matrix, Normal};
use crate::real::Real;

/// Distance of each Gaussian of a ray from the sensor, in that of the one before.
const RATIO: f64 = 1.8;
/// Standard deviation of each along the ray, in its distance: their sum is even to a fifth over the logarithm of it.
const RELATIVE_STD: f64 = 0.3;

/// Bearing.
///
/// **Measurement:** (bearing in rad, counter-clockwise from straight ahead,); g = atan2(θ_y − s_y, θ_x − s_x) − s_φ.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BearingOnly {
    /// Standard deviation of the bearing.
    pub bearing_std_rad: f64,
    /// Nothing is nearer.
    pub nearest_m: f64,
    /// Nothing is farther.
    pub farthest_m: f64,
}

impl MeasurementModel<1, 2> for BearingOnly {
    fn expected<R: Real>(&self, T_world_sensor: Pose<R>, landmark_in_world: [R; 2]) -> [R; 1] {
        let dx = landmark_in_world[0] - T_world_sensor.x;
        let dy = landmark_in_world[1] - T_world_sensor.y;
        [(R::atan2(dy, dx) - T_world_sensor.heading).wrap_angle()]
    }

    fn innovation<R: Real>(&self, measured: [R; 1], expected: [R; 1]) -> [R; 1] {
        [(measured[0] - expected[0]).wrap_angle()]
    }

    fn noise(&self) -> Matrix<1, 1> {
        [[self.bearing_std_rad * self.bearing_std_rad]]
    }

    fn components(&self) -> [Component; 1] {
        [Component { name: "bearing", unit: "rad", noise_key: "bearing_std_rad" }]
    }

    fn linearize(&self, T_world_sensor: Pose, landmark_in_world: [f64; 2]) -> Linearization<1, 2> {
        let (dx, dy) = (landmark_in_world[0] - T_world_sensor.x, landmark_in_world[1] - T_world_sensor.y);
        let squared = dx * dx + dy * dy;
        // At the landmark itself no direction is better than another: a sighting there moves nothing.
        let inverse = if squared > 0.0 { 1.0 / squared } else { 0.0 };
        let (x, y) = (-dy * inverse, dx * inverse);
        let expected = math::wrap_angle(math::atan2(dy, dx) - T_world_sensor.heading);
        Linearization { expected: [expected], by_landmark: [[x, y]], by_pose: [[-x, -y, -1.0]] }
    }
}

impl Births<1, 2> for BearingOnly {
    /// A ray of Gaussians at geometric distances: all scales are alike until there is parallax.
    ///
    /// **Source:** `sola2005undelayed`: Gaussians whose widths are in a fixed ratio to their distances, which are in geometric
    /// progression.
    fn births(&self, T_world_sensor: Pose, [bearing_rad]: [f64; 1], noise: &Matrix<1, 1>) -> Vec<(f64, Normal<2>)> {
        let (s, c) = math::sin_cos(math::wrap_angle(T_world_sensor.heading + bearing_rad));
        let scales = math::ln(self.farthest_m / self.nearest_m) / math::ln(RATIO);
        let count = scales.ceil().max(1.0);
        let ratio = math::exp(math::ln(self.farthest_m / self.nearest_m) / count);
        let mut distance_m = self.nearest_m;
        (0..=count as u32)
            .map(|_| {
                let mean = [T_world_sensor.x + distance_m * c, T_world_sensor.y + distance_m * s];
                let (along, across) = ((RELATIVE_STD * distance_m).powi(2), distance_m * distance_m * noise[0][0]);
                let covariance = turned([along, across], (s, c));
                distance_m *= ratio;
                (1.0 / (count + 1.0), Normal { mean, covariance })
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::density::Tail;
    use crate::normal::fit;

    #[test]
    fn the_ray_is_even_over_the_logarithm_of_the_distance_and_as_wide_as_the_noise() {
        let model = BearingOnly { bearing_std_rad: 0.02, nearest_m: 0.5, farthest_m: 200.0 };
        let sensor = Pose::new(3.0, -2.0, 2.9);
        let ray = model.births(sensor, [0.7], &model.noise());
        assert!(ray.len() == 12 && (ray.iter().map(|(share, _)| share).sum::<f64>() - 1.0).abs() < 1e-12);
        let density = |distance_m: f64, off_rad: f64| {
            let (s, c) = (2.9 + 0.7 + off_rad).sin_cos();
            let at = [sensor.x + distance_m * c, sensor.y + distance_m * s];
            let part = |(share, normal): &(f64, Normal<2>)| {
                let off = [at[0] - normal.mean[0], at[1] - normal.mean[1]];
                share * fit(&off, &normal.covariance, Tail::Gaussian).unwrap().log_likelihood.exp()
            };
            // By the logarithm of the distance and the angle.
            distance_m * distance_m * ray.iter().map(part).sum::<f64>()
        };
        let along: Vec<f64> =
            (0..500).map(|i| density(2.0 * (f64::from(i) / 500.0 * 25.0_f64.ln()).exp(), 0.0)).collect();
        let (least, most) = (along.iter().copied().fold(f64::MAX, f64::min), along.iter().copied().fold(0.0, f64::max));
        assert!(least / most > 0.8, "{least} to {most}");
        // Two standard deviations aside.
        let aside = density(10.0, 0.04) / density(10.0, 0.0);
        assert!((aside - (-2.0_f64).exp()).abs() < 0.05, "{aside}");
    }
}
