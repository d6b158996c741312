//! Measurement models of any size: how many numbers a sighting has, and how many coordinates a landmark.

use super::{Cartesian, MeasurementModel, RangeBearing};
use crate::geometry::Pose;
use crate::normal::{Cholesky, Matrix, Normal};
use crate::real::{Dual, Real};

/// Numbers that derivatives are taken by, at most: three of a pose, three of a landmark.
const VARIABLES: usize = 6;

/// One number of a sighting.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Component {
    /// What it is: `range`, `bearing`.
    pub name: &'static str,
    /// Its unit: `m`, `rad`.
    pub unit: &'static str,
    /// The key of its noise in `sensor` of the configuration.
    pub noise_key: &'static str,
}

/// An expected measurement with its derivatives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Derivatives<const Z: usize, const D: usize> {
    /// Expected measurement.
    pub expected: [f64; Z],
    /// G_θ: by the landmark's position.
    pub by_landmark: Matrix<Z, D>,
    /// G_s: by the sensor's pose (x, y, heading).
    pub by_pose: Matrix<Z, 3>,
}

/// How a sensor sees a point landmark of `D` coordinates in `Z` numbers, which need not say where it is.
///
/// [`MeasurementModel`] is for sensors in the plane of which one sighting places a landmark. This is for the others: one
/// sighting leaves a landmark anywhere on a ring or a ray, which [`births`](Self::births) gives as several Gaussians.
/// [`crate::testing::check_observation`] is its conformance suite.
pub trait Observation<const Z: usize, const D: usize>: Send + Sync {
    /// g: the measurement that the sensor at `T_world_sensor` should make of a landmark.
    fn expected<R: Real>(&self, T_world_sensor: Pose<R>, landmark_in_world: [R; D]) -> [R; Z];

    /// Measured minus expected, angles wrapped.
    fn innovation<R: Real>(&self, measured: [R; Z], expected: [R; Z]) -> [R; Z];

    /// R: covariance of the measurement.
    fn noise(&self) -> Matrix<Z, Z>;

    /// Names, units and configuration keys of the numbers.
    fn components(&self) -> [Component; Z];

    /// Where a landmark may be that was sighted once: Gaussians with their shares, which sum to 1.
    fn births(&self, T_world_sensor: Pose, measured: [f64; Z], noise: &Matrix<Z, Z>) -> Vec<(f64, Normal<D>)>;

    /// g with its Jacobians, by automatic differentiation unless the model has a closed form.
    fn differentiate(&self, T_world_sensor: Pose, landmark_in_world: [f64; D]) -> Derivatives<Z, D> {
        let values = T_world_sensor.to_array();
        let variable = |i: usize, value: f64| Dual::<VARIABLES>::variable(value, i);
        let pose = Pose::new(variable(0, values[0]), variable(1, values[1]), variable(2, values[2]));
        let landmark = std::array::from_fn(|i| variable(3 + i, landmark_in_world[i]));
        let z = self.expected(pose, landmark);
        Derivatives {
            expected: z.map(|v| v.value),
            by_landmark: z.map(|v| std::array::from_fn(|i| v.gradient[3 + i])),
            by_pose: z.map(|v| std::array::from_fn(|i| v.gradient[i])),
        }
    }
}

/// The one Gaussian at a place from which one sighting says as many numbers as a landmark has: Σ = (Gᵀ R⁻¹ G)⁻¹. None
/// where the place cannot be told.
pub fn birth_at<const D: usize>(
    mean: [f64; D],
    by_landmark: &Matrix<D, D>,
    noise: &Matrix<D, D>,
) -> Vec<(f64, Normal<D>)> {
    let covariance = || {
        let noise = Cholesky::of(noise)?;
        // Column by column of G: R⁻¹ G.
        let columns: Matrix<D, D> = std::array::from_fn(|c| noise.solve(&std::array::from_fn(|z| by_landmark[z][c])));
        let information =
            std::array::from_fn(|a| std::array::from_fn(|b| (0..D).map(|z| by_landmark[z][a] * columns[b][z]).sum()));
        Some(Cholesky::of(&information)?.inverse())
    };
    covariance().map(|covariance| (1.0, Normal { mean, covariance })).into_iter().collect()
}

/// A model of the plane of which one sighting places a landmark.
macro_rules! placing {
    ($model:ty, $components:expr) => {
        impl Observation<2, 2> for $model {
            fn expected<R: Real>(&self, T_world_sensor: Pose<R>, landmark_in_world: [R; 2]) -> [R; 2] {
                MeasurementModel::expected(self, T_world_sensor, landmark_in_world)
            }
            fn innovation<R: Real>(&self, measured: [R; 2], expected: [R; 2]) -> [R; 2] {
                MeasurementModel::innovation(self, measured, expected)
            }
            fn noise(&self) -> Matrix<2, 2> {
                let noise = self.noise_covariance();
                [[noise.xx, noise.xy], [noise.xy, noise.yy]]
            }
            fn components(&self) -> [Component; 2] {
                $components
            }
            fn births(&self, sensor: Pose, measured: [f64; 2], noise: &Matrix<2, 2>) -> Vec<(f64, Normal<2>)> {
                let mean = self.inverse(sensor, measured);
                birth_at(mean, &self.linearize(sensor, mean).by_landmark, noise)
            }
        }
    };
}

placing!(
    RangeBearing,
    [
        Component { name: "range", unit: "m", noise_key: "range_std_m" },
        Component { name: "bearing", unit: "rad", noise_key: "bearing_std_rad" },
    ]
);
placing!(
    Cartesian,
    [
        Component { name: "x", unit: "m", noise_key: "position_std_m" },
        Component { name: "y", unit: "m", noise_key: "position_std_m" },
    ]
);
