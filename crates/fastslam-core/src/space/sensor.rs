//! Sensors in space: three numbers of a landmark, of which one sighting places it.

use super::matrix::Rows;
use super::settings::{Camera, SpaceSensor, SpaceSensorModel};
use crate::measurement::Component;
use crate::normal::Matrix;
use crate::real::Real;

/// How a sensor sees a point of its own frame in three numbers.
///
/// Poses do not enter: what depends on them is the same for all sensors, and stands in one place
/// ([`super::look::Eye::look`]). [`crate::testing::check_spatial_model`] is the conformance suite.
pub trait Spatial: Send + Sync {
    /// g: the measurement of a point in the sensor's frame.
    fn expected<R: Real>(&self, point_in_sensor: [R; 3]) -> [R; 3];

    /// g with its derivative by the point.
    fn linearize<R: Real>(&self, point_in_sensor: [R; 3]) -> ([R; 3], Rows<R, 3, 3>);

    /// Measured minus expected, angles wrapped.
    fn innovation<R: Real>(&self, measured: [R; 3], expected: [R; 3]) -> [R; 3];

    /// g⁻¹; `None` for a measurement that no point makes.
    fn inverse(&self, measured: [f64; 3]) -> Option<[f64; 3]>;

    /// Whether a point lies where the sensor can see at all, however far.
    fn sees(&self, _point_in_sensor: [f64; 3]) -> bool {
        true
    }

    /// R: covariance of the measurement.
    fn noise(&self) -> Matrix<3, 3>;

    /// Names, units and configuration keys of the numbers.
    fn components(&self) -> [Component; 3];
}

/// The noise of independent numbers.
fn diagonal(std: [f64; 3]) -> Matrix<3, 3> {
    let mut out = [[0.0; 3]; 3];
    (0..3).for_each(|i| out[i][i] = std[i] * std[i]);
    out
}

#[inline(always)]
fn difference<R: Real>(a: [R; 3], b: [R; 3]) -> [R; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// A landmark's coordinates in the sensor's frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// Standard deviation of each coordinate.
    pub position_std_m: [f64; 3],
}

impl Spatial for Point {
    #[inline(always)]
    fn expected<R: Real>(&self, point_in_sensor: [R; 3]) -> [R; 3] {
        point_in_sensor
    }

    #[inline(always)]
    fn linearize<R: Real>(&self, point: [R; 3]) -> ([R; 3], Rows<R, 3, 3>) {
        let (zero, one) = (R::constant(0.0), R::constant(1.0));
        (point, [[one, zero, zero], [zero, one, zero], [zero, zero, one]])
    }

    #[inline(always)]
    fn innovation<R: Real>(&self, measured: [R; 3], expected: [R; 3]) -> [R; 3] {
        difference(measured, expected)
    }

    fn inverse(&self, measured: [f64; 3]) -> Option<[f64; 3]> {
        Some(measured)
    }

    fn noise(&self) -> Matrix<3, 3> {
        diagonal(self.position_std_m)
    }

    fn components(&self) -> [Component; 3] {
        ["x", "y", "z"].map(|name| Component { name, unit: "m", noise_key: "position_std_m" })
    }
}

/// Range, bearing counter-clockwise from ahead (x), and elevation above the sensor's own plane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RangeBearingElevation {
    /// Metres, radians, radians.
    pub std: [f64; 3],
}

impl Spatial for RangeBearingElevation {
    #[inline(always)]
    fn expected<R: Real>(&self, [x, y, z]: [R; 3]) -> [R; 3] {
        let level = x * x + y * y;
        [(level + z * z).sqrt(), R::atan2(y, x), R::atan2(z, level.sqrt())]
    }

    #[inline(always)]
    fn linearize<R: Real>(&self, [x, y, z]: [R; 3]) -> ([R; 3], Rows<R, 3, 3>) {
        let level = x * x + y * y;
        let (square, flat) = (level + z * z, level.sqrt());
        let range = square.sqrt();
        let by_range = [x / range, y / range, z / range];
        let by_bearing = [-y / level, x / level, R::constant(0.0)];
        let slope = z / (square * flat);
        let by_elevation = [-x * slope, -y * slope, flat / square];
        ([range, R::atan2(y, x), R::atan2(z, flat)], [by_range, by_bearing, by_elevation])
    }

    #[inline(always)]
    fn innovation<R: Real>(&self, measured: [R; 3], expected: [R; 3]) -> [R; 3] {
        let [range, bearing, elevation] = difference(measured, expected);
        [range, bearing.wrap_angle(), elevation]
    }

    fn inverse(&self, [range, bearing, elevation]: [f64; 3]) -> Option<[f64; 3]> {
        let ((s, c), (up, level)) = (bearing.sin_cos(), elevation.sin_cos());
        // Straight up or down a bearing says nothing.
        let usable = range > 0.0 && level > 1e-3 && elevation.abs() < std::f64::consts::FRAC_PI_2;
        usable.then_some([range * level * c, range * level * s, range * up])
    }

    fn noise(&self) -> Matrix<3, 3> {
        diagonal(self.std)
    }

    fn components(&self) -> [Component; 3] {
        let angle = |name, noise_key| Component { name, unit: "rad", noise_key };
        [
            Component { name: "range", unit: "m", noise_key: "range_std_m" },
            angle("bearing", "bearing_std_rad"),
            angle("elevation", "elevation_std_rad"),
        ]
    }
}

/// A pair of rectified cameras: column and row in the left image, and the disparity, pixels. The sensor's frame is that of
/// the left camera, z ahead, x right, y down.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stereo {
    /// Its optics.
    pub camera: Camera,
    /// Covariance of the three numbers, px².
    pub noise_px2: Matrix<3, 3>,
}

impl Spatial for Stereo {
    #[inline(always)]
    fn expected<R: Real>(&self, [x, y, z]: [R; 3]) -> [R; 3] {
        let Camera { fu_px, fv_px, cu_px, cv_px, baseline_m } = self.camera;
        let number = R::constant;
        [number(fu_px) * x / z + number(cu_px), number(fv_px) * y / z + number(cv_px), number(fu_px * baseline_m) / z]
    }

    #[inline(always)]
    fn linearize<R: Real>(&self, point: [R; 3]) -> ([R; 3], Rows<R, 3, 3>) {
        let Camera { fu_px, fv_px, baseline_m, .. } = self.camera;
        let [x, y, z] = point;
        let (zero, near) = (R::constant(0.0), R::constant(1.0) / z);
        let (across, down) = (R::constant(fu_px) * near, R::constant(fv_px) * near);
        let by_disparity = -(R::constant(baseline_m) * across) * near;
        let by_point =
            [[across, zero, -(across * x) * near], [zero, down, -(down * y) * near], [zero, zero, by_disparity]];
        (self.expected(point), by_point)
    }

    #[inline(always)]
    fn innovation<R: Real>(&self, measured: [R; 3], expected: [R; 3]) -> [R; 3] {
        difference(measured, expected)
    }

    fn inverse(&self, [column, row, disparity]: [f64; 3]) -> Option<[f64; 3]> {
        let Camera { fu_px, fv_px, cu_px, cv_px, baseline_m } = self.camera;
        let depth = fu_px * baseline_m / disparity;
        (disparity > 0.0).then_some([(column - cu_px) * depth / fu_px, (row - cv_px) * depth / fv_px, depth])
    }

    fn sees(&self, [_, _, z]: [f64; 3]) -> bool {
        z > 0.0
    }

    fn noise(&self) -> Matrix<3, 3> {
        self.noise_px2
    }

    fn components(&self) -> [Component; 3] {
        let of = |name, noise_key| Component { name, unit: "px", noise_key };
        [of("column", "column_std_px"), of("row", "row_std_px"), of("disparity", "column_std_px")]
    }
}

impl Stereo {
    /// From the noise of a column and of a row in either image: both rows say the same, and their mean is the row; the
    /// disparity is left column minus right column.
    pub fn new(camera: Camera, column_std_px: f64, row_std_px: f64) -> Self {
        let (column, row) = (column_std_px * column_std_px, row_std_px * row_std_px);
        let noise_px2 = [[column, 0.0, column], [0.0, 0.5 * row, 0.0], [column, 0.0, 2.0 * column]];
        Self { camera, noise_px2 }
    }
}

/// The sensor of a configuration: which model, as one type.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Model {
    /// Coordinates.
    Point(Point),
    /// Polar.
    RangeBearingElevation(RangeBearingElevation),
    /// Pixels.
    Stereo(Stereo),
}

impl From<&SpaceSensor> for Model {
    fn from(sensor: &SpaceSensor) -> Self {
        match sensor.model {
            SpaceSensorModel::Point => Self::Point(Point { position_std_m: sensor.position_std_m }),
            SpaceSensorModel::RangeBearingElevation => Self::RangeBearingElevation(RangeBearingElevation {
                std: [sensor.range_std_m, sensor.bearing_std_rad, sensor.elevation_std_rad],
            }),
            SpaceSensorModel::Stereo => {
                Self::Stereo(Stereo::new(sensor.camera, sensor.column_std_px, sensor.row_std_px))
            }
        }
    }
}
