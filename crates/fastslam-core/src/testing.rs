//! Conformance suites that every model must pass; users run theirs through them too.
//!
//! Each returns the number of cases that it saw, so that a test can assert that there were any.

use crate::density::Tail;
use crate::geometry::{is_covariance3, Pose};
use crate::measurement::{Births, MeasurementModel, Placing};
use crate::motion::{ControlTiming, MotionGaussian, MotionModel, RowMotion};
use crate::normal::{self, Cholesky};
use crate::random::{Purpose, RandomSource};
use crate::real::Real;

mod spatial;

pub use spatial::check_spatial_model;

/// A failed conformance check: what was compared, and where.
#[derive(Clone, Debug, PartialEq)]
pub struct Nonconformance(pub String);

fn expect(ok: bool, message: impl FnOnce() -> String) -> Result<(), Nonconformance> {
    if ok {
        Ok(())
    } else {
        Err(Nonconformance(message()))
    }
}

/// A uniform number in [low, high] for case `case`.
fn draw(case: u32, number: u32, low: f64, high: f64) -> f64 {
    low + (high - low) * RandomSource::new(20).stream(Purpose::Simulation, 0).uniform(case, number)
}

/// Checks a model that places landmarks on generic geometries and on headings near ±π.
///
/// - both Jacobians against differences taken through the innovation;
/// - the inverse, then the expected measurement, gives the measurement back;
/// - the innovation of a measurement with itself is zero;
/// - the noise covariance is positive definite; everything is finite.
pub fn check_placing_model<M: Placing>(model: &M) -> Result<usize, Nonconformance> {
    let cases = 500;
    expect(model.noise_covariance().is_positive_definite(), || "noise covariance is not positive definite".into())?;
    for case in 0..cases {
        let near_pi = case % 5 == 0;
        let heading =
            if near_pi { std::f64::consts::PI - draw(case, 3, -1e-6, 1e-6) } else { draw(case, 3, -3.1, 3.1) };
        let pose = Pose::new(draw(case, 1, -30.0, 30.0), draw(case, 2, -30.0, 30.0), heading);
        let (distance, direction) = (draw(case, 4, 0.5, 60.0), draw(case, 5, -3.1, 3.1));
        let landmark = [pose.x + distance * direction.cos(), pose.y + distance * direction.sin()];
        check_derivatives(model, pose, landmark)?;
        let z = model.expected(pose, landmark);
        let back = model.inverse(pose, z);
        expect((back[0] - landmark[0]).hypot(back[1] - landmark[1]) < 1e-9 * distance.max(1.0), || {
            format!("inverse at {pose:?}: {back:?} is not {landmark:?}")
        })?;
        let zero = model.innovation(z, z);
        expect(zero == [0.0, 0.0], || format!("innovation of {z:?} with itself is {zero:?}"))?;
    }
    Ok(cases as usize)
}

/// Checks a measurement model of any size on generic geometries and on headings near ±π.
///
/// - both Jacobians against differences taken through the innovation;
/// - the innovation of a measurement with itself is zero;
/// - the noise is symmetric and positive definite, and the components have names;
/// - the births are covariances whose shares sum to 1, and are consistent: the landmark is near one of them, and each
///   explains the sighting to within what its width and curvature allow.
pub fn check_measurement_model<M, const Z: usize, const D: usize>(model: &M) -> Result<usize, Nonconformance>
where
    M: Births<Z, D>,
{
    let (cases, noise) = (300, model.noise());
    let symmetric = (0..Z).all(|a| (0..Z).all(|b| noise[a][b] == noise[b][a]));
    expect(symmetric && Cholesky::of(&noise).is_some(), || format!("noise {noise:?} is no covariance"))?;
    expect(model.components().iter().all(|c| !c.name.is_empty() && !c.unit.is_empty()), || "a nameless number".into())?;
    for case in 0..cases {
        let near_pi = case % 5 == 0;
        let heading =
            if near_pi { std::f64::consts::PI - draw(case, 3, -1e-6, 1e-6) } else { draw(case, 3, -3.1, 3.1) };
        let pose = Pose::new(draw(case, 1, -30.0, 30.0), draw(case, 2, -30.0, 30.0), heading);
        let (distance, direction) = (draw(case, 4, 0.5, 60.0), draw(case, 5, -3.1, 3.1));
        let ahead =
            [pose.x + distance * direction.cos(), pose.y + distance * direction.sin(), draw(case, 6, -3.0, 3.0)];
        let landmark = std::array::from_fn(|d| ahead[d]);
        check_derivatives(model, pose, landmark)?;
        let z = model.expected(pose, landmark);
        let zero = model.innovation(z, z);
        expect(zero == [0.0; Z], || format!("innovation of {z:?} with itself is {zero:?}"))?;
        check_births(model, pose, landmark).map_err(|e| Nonconformance(format!("{pose:?}, {landmark:?}: {}", e.0)))?;
    }
    Ok(cases as usize)
}

fn check_derivatives<M, const Z: usize, const D: usize>(
    model: &M,
    pose: Pose,
    landmark: [f64; D],
) -> Result<(), Nonconformance>
where
    M: MeasurementModel<Z, D>,
{
    let (linear, h) = (model.linearize(pose, landmark), 1e-6);
    for index in 0..3 + D {
        let moved = |by: f64| {
            let (mut robot, mut place) = (pose.to_array(), landmark);
            match index.checked_sub(3) {
                None => robot[index] += by,
                Some(d) => place[d] += by,
            }
            model.expected(Pose::new(robot[0], robot[1], robot[2]), place)
        };
        let difference = model.innovation(moved(h), moved(-h)).map(|d| d / (2.0 * h));
        for row in 0..Z {
            let derivative = if index < 3 { linear.by_pose[row][index] } else { linear.by_landmark[row][index - 3] };
            expect((derivative - difference[row]).abs() < 1e-6 * (1.0 + difference[row].abs()), || {
                format!(
                    "derivative of number {row} by variable {index} at {pose:?}, {landmark:?}: {derivative} against {}",
                    difference[row]
                )
            })?;
        }
    }
    let agreement = model.innovation(linear.expected, model.expected(pose, landmark));
    expect(agreement.iter().all(|v| v.abs() < 1e-12), || format!("linearize and expected differ by {agreement:?}"))
}

fn check_births<M, const Z: usize, const D: usize>(
    model: &M,
    pose: Pose,
    landmark: [f64; D],
) -> Result<(), Nonconformance>
where
    M: Births<Z, D>,
{
    let (z, noise) = (model.expected(pose, landmark), model.noise());
    let births = model.births(pose, z, &noise);
    let total: f64 = births.iter().map(|(share, _)| share).sum();
    expect(births.iter().all(|(share, _)| *share > 0.0) && (total - 1.0).abs() < 1e-9, || {
        format!("the shares of {} births sum to {total}", births.len())
    })?;
    let mut nearest = f64::INFINITY;
    for (_, birth) in &births {
        let off = std::array::from_fn(|d| landmark[d] - birth.mean[d]);
        let fitted = normal::fit(&off, &birth.covariance, Tail::Gaussian);
        let Some(fitted) = fitted else {
            return Err(Nonconformance(format!("a birth of covariance {:?}", birth.covariance)));
        };
        nearest = nearest.min(fitted.mahalanobis_squared);
        let seen = model.linearize(pose, birth.mean);
        let innovation = model.innovation(z, seen.expected);
        let spread = normal::sum(&normal::congruence(&seen.by_landmark, &birth.covariance), &noise);
        let explained =
            normal::fit(&innovation, &spread, Tail::Gaussian).is_some_and(|fit| fit.mahalanobis_squared < 1.0);
        expect(explained, || format!("a birth at {:?} does not explain its sighting {z:?}", birth.mean))?;
    }
    expect(nearest < 1.5, || format!("the nearest birth lies {nearest} (Mahalanobis squared) from the landmark"))
}

/// Checks a motion model on generic controls, at rest, backwards, at tiny turns and in rows without duration.
///
/// - its parts make the row, wherever it is cut: mean and covariance to rounding;
/// - its diffusion is finite, symmetric and not negative in any direction;
/// - a row without duration moves a held control nowhere.
pub fn check_motion_model<M: MotionModel>(model: &M) -> Result<usize, Nonconformance> {
    model.validate().map_err(|e| Nonconformance(e.to_string()))?;
    let cases = 300;
    for case in 0..cases {
        let scale = [1.0, 1e-8, 0.0][case as usize % 3];
        let control = [draw(case, 1, -2.0, 3.0), draw(case, 2, -0.7, 0.7) * scale, draw(case, 3, -1.0, 1.0) * scale];
        let row_s = if case % 10 == 0 { 0.0 } else { draw(case, 4, 0.01, 1.5) };
        let row = model.row(control, row_s);
        check_diffusion(&row).map_err(|e| Nonconformance(format!("control {control:?} for {row_s} s: {}", e.0)))?;
        let nowhere = row_s > 0.0 || model.timing() == ControlTiming::Increment || row.twist == [0.0; 3];
        expect(nowhere, || format!("control {control:?} moves by {:?} in no time", row.twist))?;
        let cuts = [draw(case, 5, 0.0, 1.0), draw(case, 6, 0.0, 1.0), draw(case, 7, 0.0, 1e-3)];
        check_cutting(&row, &cuts)?;
    }
    Ok(cases as usize)
}

fn check_diffusion(row: &RowMotion) -> Result<(), Nonconformance> {
    let c = &row.diffusion();
    let finite = row.twist.iter().all(|v| v.is_finite());
    expect(finite && is_covariance3(c), || format!("{:?} with {c:?}, which is no covariance", row.twist))
}

/// Cuts a row at some shares of it and compares what the parts make with the whole.
pub fn check_cutting(row: &RowMotion, cuts: &[f64]) -> Result<(), Nonconformance> {
    let mut cuts: Vec<f64> = cuts.iter().copied().chain([0.0, 1.0]).collect();
    cuts.sort_by(f64::total_cmp);
    let parts = cuts.windows(2).map(|cut| row.part(cut[1] - cut[0]));
    let made = parts.fold(MotionGaussian::default(), |sum, part| sum.then(&part));
    let whole = row.part(1.0);
    let way = 1.0 + row.twist[0].hypot(row.twist[1]);
    let turned = (whole.mean.heading - made.mean.heading).wrap_angle().abs();
    let apart = (whole.mean.x - made.mean.x).abs() + (whole.mean.y - made.mean.y).abs() + turned;
    expect(apart < 1e-13 * way, || format!("{row:?} cut at {cuts:?}: {made:?} against {whole:?}"))?;
    let c = &row.diffusion();
    let largest = c[0][0] + c[1][1] + c[2][2] * way * way;
    for i in 0..3 {
        for j in 0..3 {
            let apart = (whole.covariance[i][j] - made.covariance[i][j]).abs();
            expect(apart <= 1e-13 * largest, || format!("{row:?} cut at {cuts:?}: {made:?} against {whole:?}"))?;
        }
    }
    Ok(())
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::measurement::{birth_at, BearingOnly, Cartesian, Component, RangeBearing, RangeOnly};
    use crate::motion::{Ackermann, Increments, Odometry, Velocity};
    use crate::normal::Normal;

    #[test]
    fn every_measurement_model_conforms() {
        assert_eq!(check_placing_model(&RangeBearing { range_std_m: 0.1, bearing_std_rad: 0.02 }), Ok(500));
        assert_eq!(check_placing_model(&Cartesian { position_std_m: 0.1 }), Ok(500));
    }

    /// A point in space as a sensor with a heading sees it.
    pub(crate) struct Point;
    impl MeasurementModel<3, 3> for Point {
        fn expected<R: Real>(&self, sensor: Pose<R>, landmark: [R; 3]) -> [R; 3] {
            let [x, y] = sensor.inverse().transform([landmark[0], landmark[1]]);
            [x, y, landmark[2]]
        }
        fn innovation<R: Real>(&self, measured: [R; 3], expected: [R; 3]) -> [R; 3] {
            std::array::from_fn(|i| measured[i] - expected[i])
        }
        fn noise(&self) -> [[f64; 3]; 3] {
            [[0.04, 0.01, 0.0], [0.01, 0.05, 0.002], [0.0, 0.002, 0.02]]
        }
        fn components(&self) -> [Component; 3] {
            ["x", "y", "z"].map(|name| Component { name, unit: "m", noise_key: "position_std_m" })
        }
    }
    impl Births<3, 3> for Point {
        fn births(&self, sensor: Pose, z: [f64; 3], noise: &[[f64; 3]; 3]) -> Vec<(f64, Normal<3>)> {
            let [x, y] = sensor.transform([z[0], z[1]]);
            let mean = [x, y, z[2]];
            birth_at(mean, &self.linearize(sensor, mean).by_landmark, noise)
        }
    }

    #[test]
    fn models_of_every_size_conform() {
        assert_eq!(check_measurement_model::<_, 1, 2>(&RangeOnly { range_std_m: 0.3 }), Ok(300));
        let bearing = BearingOnly { bearing_std_rad: 0.02, nearest_m: 0.4, farthest_m: 80.0 };
        assert_eq!(check_measurement_model::<_, 1, 2>(&bearing), Ok(300));
        assert_eq!(
            check_measurement_model::<_, 2, 2>(&RangeBearing { range_std_m: 0.1, bearing_std_rad: 0.02 }),
            Ok(300)
        );
        assert_eq!(check_measurement_model::<_, 2, 2>(&Cartesian { position_std_m: 0.1 }), Ok(300));
        assert_eq!(check_measurement_model::<_, 3, 3>(&Point), Ok(300));
    }

    /// Half a ring: the landmark behind the sensor is in no birth.
    struct HalfRing(RangeOnly);
    impl MeasurementModel<1, 2> for HalfRing {
        fn expected<R: Real>(&self, sensor: Pose<R>, landmark: [R; 2]) -> [R; 1] {
            self.0.expected(sensor, landmark)
        }
        fn innovation<R: Real>(&self, measured: [R; 1], expected: [R; 1]) -> [R; 1] {
            self.0.innovation(measured, expected)
        }
        fn noise(&self) -> [[f64; 1]; 1] {
            self.0.noise()
        }
        fn components(&self) -> [Component; 1] {
            self.0.components()
        }
    }
    impl Births<1, 2> for HalfRing {
        fn births(&self, sensor: Pose, z: [f64; 1], noise: &[[f64; 1]; 1]) -> Vec<(f64, Normal<2>)> {
            let mut births = self.0.births(sensor, z, noise);
            births.truncate(births.len() / 2);
            births.iter_mut().for_each(|(share, _)| *share *= 2.0);
            births
        }
    }

    #[test]
    fn the_suite_rejects_births_that_miss_the_landmark() {
        assert!(check_measurement_model::<_, 1, 2>(&HalfRing(RangeOnly { range_std_m: 0.3 })).is_err());
    }

    #[test]
    fn every_motion_model_conforms() {
        assert_eq!(check_motion_model(&Velocity::default()), Ok(300));
        assert_eq!(check_motion_model(&Ackermann::default()), Ok(300));
        assert_eq!(check_motion_model(&Odometry::default()), Ok(300));
        assert_eq!(check_motion_model(&Increments::default()), Ok(300));
    }

    struct WrongSign;
    impl MeasurementModel<2, 2> for WrongSign {
        fn expected<R: Real>(&self, T_world_sensor: Pose<R>, landmark_in_world: [R; 2]) -> [R; 2] {
            RangeBearing { range_std_m: 1.0, bearing_std_rad: 1.0 }.expected(T_world_sensor, landmark_in_world)
        }
        fn innovation<R: Real>(&self, measured: [R; 2], expected: [R; 2]) -> [R; 2] {
            // The classic slip: the bearing is not wrapped.
            [measured[0] - expected[0], measured[1] - expected[1]]
        }
        fn noise(&self) -> [[f64; 2]; 2] {
            [[1.0, 0.0], [0.0, 1.0]]
        }
        fn components(&self) -> [Component; 2] {
            RangeBearing { range_std_m: 1.0, bearing_std_rad: 1.0 }.components()
        }
    }
    impl Placing for WrongSign {
        fn inverse<R: Real>(&self, T_world_sensor: Pose<R>, measured: [R; 2]) -> [R; 2] {
            let (s, c) = (T_world_sensor.heading - measured[1]).sin_cos();
            [T_world_sensor.x + measured[0] * c, T_world_sensor.y + measured[0] * s]
        }
        fn range(&self, measured: [f64; 2]) -> f64 {
            measured[0]
        }
        fn position_variance(&self, _measured: [f64; 2], _noise: crate::geometry::Symmetric2) -> f64 {
            1.0
        }
    }

    #[test]
    fn the_suite_rejects_a_wrong_model() {
        assert!(check_placing_model(&WrongSign).is_err());
    }
}
