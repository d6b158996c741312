//! Measurement models of any size: how many numbers a sighting has, and how many coordinates a landmark.

use super::SystematicError;
use crate::density::Tail;
use crate::geometry::{Pose, Symmetric2};
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
pub struct Linearization<const Z: usize, const D: usize> {
    /// Expected measurement.
    pub expected: [f64; Z],
    /// G_θ: derivative by the landmark's position, in row order.
    pub by_landmark: Matrix<Z, D>,
    /// G_s: derivative by the sensor's pose (x, y, heading), in row order.
    pub by_pose: Matrix<Z, 3>,
}

/// How a sensor sees a point landmark of `D` coordinates in `Z` numbers, which need not say where it is.
pub trait MeasurementModel<const Z: usize, const D: usize>: Send + Sync {
    /// g: the measurement that the sensor at `T_world_sensor` should make of a landmark.
    fn expected<R: Real>(&self, T_world_sensor: Pose<R>, landmark_in_world: [R; D]) -> [R; Z];

    /// Measured minus expected, angles wrapped.
    fn innovation<R: Real>(&self, measured: [R; Z], expected: [R; Z]) -> [R; Z];

    /// R: covariance of the measurement.
    fn noise(&self) -> Matrix<Z, Z>;

    /// Names, units and configuration keys of the numbers.
    fn components(&self) -> [Component; Z];

    /// g with its Jacobians. By automatic differentiation unless the model has a closed form, which the conformance
    /// suite checks against it.
    fn linearize(&self, T_world_sensor: Pose, landmark_in_world: [f64; D]) -> Linearization<Z, D> {
        let values = T_world_sensor.to_array();
        let variable = |i: usize, value: f64| Dual::<VARIABLES>::variable(value, i);
        let pose = Pose::new(variable(0, values[0]), variable(1, values[1]), variable(2, values[2]));
        let landmark = std::array::from_fn(|i| variable(3 + i, landmark_in_world[i]));
        let z = self.expected(pose, landmark);
        Linearization {
            expected: z.map(|v| v.value),
            by_landmark: z.map(|v| std::array::from_fn(|i| v.gradient[3 + i])),
            by_pose: z.map(|v| std::array::from_fn(|i| v.gradient[i])),
        }
    }
}

/// A model that says where a landmark may be that was sighted once.
///
/// One sighting may leave it anywhere on a ring or a ray. [`crate::testing::check_measurement_model`] is the conformance
/// suite.
pub trait Births<const Z: usize, const D: usize>: MeasurementModel<Z, D> {
    /// Gaussians with their shares, which sum to 1.
    fn births(&self, T_world_sensor: Pose, measured: [f64; Z], noise: &Matrix<Z, Z>) -> Vec<(f64, Normal<D>)>;
}

/// A model in the plane of which one sighting places a landmark: what the filter of most sensors asks.
///
/// [`crate::testing::check_placing_model`] is its conformance suite.
pub trait Placing: MeasurementModel<2, 2> + 'static {
    /// g⁻¹: where the landmark is.
    fn inverse<R: Real>(&self, T_world_sensor: Pose<R>, measured: [R; 2]) -> [R; 2];

    /// R as a symmetric matrix.
    #[inline(always)]
    fn noise_covariance(&self) -> Symmetric2 {
        let [[xx, xy], [_, yy]] = self.noise();
        Symmetric2::new(xx, xy, yy)
    }

    /// A reported measurement without the sensor's systematic errors; models without such settings leave it as it is.
    fn corrected(&self, reported: [f64; 2], _error: &SystematicError) -> [f64; 2] {
        reported
    }

    /// Whether the numbers of a measurement can be computed with.
    fn is_usable(&self, measured: [f64; 2]) -> bool {
        measured.iter().all(|v| v.is_finite())
    }

    /// Distance of the landmark from the sensor, metres.
    fn range(&self, measured: [f64; 2]) -> f64;

    /// Variance of the landmark's position that the noise of one measurement makes, in the worst direction: an upper
    /// bound, square metres.
    fn position_variance(&self, measured: [f64; 2], noise: Symmetric2) -> f64;

    /// Which of the two numbers the sensor measures. Among sensors that do place their landmarks one may not: see
    /// [`super::RangeOrBearing`].
    #[inline(always)]
    fn measures(&self) -> [bool; 2] {
        [true; 2]
    }

    /// Whether one sighting says where its landmark is. A sensor of which it does not founds none.
    #[inline(always)]
    fn places(&self) -> bool {
        self.measures() == [true; 2]
    }

    /// The tail of its sightings, given that of the noise.
    fn tail(&self, of_noise: Tail) -> Tail {
        if self.places() {
            of_noise
        } else {
            of_noise.of_one()
        }
    }

    /// A covariance that a detector gives, as the filter uses it.
    #[inline(always)]
    fn given_noise(&self, noise: Symmetric2) -> Symmetric2 {
        noise
    }

    /// A measurement with what is expected in place of what is not measured.
    fn completed(&self, measured: [f64; 2], _expected: [f64; 2]) -> [f64; 2] {
        measured
    }

    /// Measurements between which those lie that place a landmark wherever it may be.
    fn extremes(&self, measured: [f64; 2]) -> [[f64; 2]; 4] {
        [measured; 4]
    }

    /// How many units there are of what is not measured: a density of sightings by both numbers, times this, is one by
    /// that which is.
    fn unmeasured_extent(&self) -> f64 {
        1.0
    }
}

impl<M: Placing> Births<2, 2> for M {
    fn births(&self, sensor: Pose, measured: [f64; 2], noise: &Matrix<2, 2>) -> Vec<(f64, Normal<2>)> {
        let mean = self.inverse(sensor, measured);
        birth_at(mean, &self.linearize(sensor, mean).by_landmark, noise)
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
