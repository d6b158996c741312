//! What the filter asks of a sensor: many landmarks, from many poses, in one call.

use crate::error::Result;
use crate::geometry::Pose;
use crate::measurement::{Births, MeasurementModel};
use crate::normal::{Matrix, Normal};
use serde::{Deserialize, Serialize};

/// What the sensor reports for the first number of a true measurement: scale · true + bias.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Calibration {
    /// Reported per true unit.
    pub scale: f64,
    /// Added to what is reported.
    pub bias: f64,
}

impl Calibration {
    /// A sensor that reports what is true.
    pub const NONE: Self = Self { scale: 1.0, bias: 0.0 };

    /// What is true where this was reported.
    pub fn corrected<const Z: usize>(&self, mut reported: [f64; Z]) -> [f64; Z] {
        reported[0] = (reported[0] - self.bias) / self.scale;
        reported
    }

    /// What is reported where this is true.
    pub fn reported<const Z: usize>(&self, mut expected: [f64; Z]) -> [f64; Z] {
        expected[0] = self.scale * expected[0] + self.bias;
        expected
    }
}

/// A landmark to be looked at.
#[derive(Clone, Copy, Debug)]
pub struct Request<const Z: usize> {
    /// From where.
    pub T_world_sensor: Pose,
    /// Where it may be, metres.
    pub landmark: [f64; 2],
    /// What was reported of it.
    pub measured: [f64; Z],
    /// How the sensor reports.
    pub calibration: Calibration,
}

/// A landmark, looked at.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Look<const Z: usize> {
    /// Reported minus expected.
    pub innovation: [f64; Z],
    /// First number that is true, which is the derivative of what is reported by the scale.
    pub by_scale: f64,
    /// Derivative of what is reported by the landmark's position.
    pub by_landmark: Matrix<Z, 2>,
    /// Derivative of what is reported by the sensor's pose.
    pub by_pose: Matrix<Z, 3>,
}

/// A sensor whose sightings name their landmarks and need not place them.
pub trait Sensing<const Z: usize>: Send + Sync {
    /// Looks at all of them; as many answers.
    ///
    /// **Errors:** those of a sensor of one's own.
    fn look(&self, requests: &[Request<Z>]) -> Result<Vec<Look<Z>>>;

    /// R: covariance of what is reported.
    fn noise(&self) -> Matrix<Z, Z>;

    /// Which of the two values of a sighting its numbers are: 0 for the range, 1 for the bearing.
    fn columns(&self) -> [usize; Z] {
        std::array::from_fn(|i| i)
    }

    /// How far the landmark is, where a sighting says so: for the limits of the sensor.
    fn distance(&self, measured: &[f64; Z]) -> Option<f64>;

    /// Where a landmark may be that was sighted once, from each of these poses: Gaussians with their shares.
    ///
    /// **Errors:** those of a sensor of one's own.
    fn births(&self, sightings: &[(Pose, [f64; Z])], noise: &Matrix<Z, Z>) -> Result<Vec<Vec<(f64, Normal<2>)>>>;
}

impl<const Z: usize, M: Births<Z, 2>> Sensing<Z> for M {
    fn look(&self, requests: &[Request<Z>]) -> Result<Vec<Look<Z>>> {
        let look = |request: &Request<Z>| {
            let mut seen = self.linearize(request.T_world_sensor, request.landmark);
            let expected = request.calibration.reported(seen.expected);
            seen.by_landmark[0] = seen.by_landmark[0].map(|v| v * request.calibration.scale);
            seen.by_pose[0] = seen.by_pose[0].map(|v| v * request.calibration.scale);
            Look {
                innovation: self.innovation(request.measured, expected),
                by_scale: seen.expected[0],
                by_landmark: seen.by_landmark,
                by_pose: seen.by_pose,
            }
        };
        Ok(requests.iter().map(look).collect())
    }

    fn noise(&self) -> Matrix<Z, Z> {
        MeasurementModel::noise(self)
    }

    fn columns(&self) -> [usize; Z] {
        let bearing_alone = Z == 1 && self.components()[0].name == "bearing";
        std::array::from_fn(|i| i + usize::from(bearing_alone))
    }

    fn distance(&self, measured: &[f64; Z]) -> Option<f64> {
        self.components().iter().position(|component| component.name == "range").map(|i| measured[i])
    }

    fn births(&self, sightings: &[(Pose, [f64; Z])], noise: &Matrix<Z, Z>) -> Result<Vec<Vec<(f64, Normal<2>)>>> {
        Ok(sightings.iter().map(|(sensor, measured)| Births::births(self, *sensor, *measured, noise)).collect())
    }
}
