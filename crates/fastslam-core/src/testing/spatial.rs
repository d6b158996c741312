//! The conformance suite of sensors in space.

use super::{draw, expect, Nonconformance};
use crate::normal::Cholesky;
use crate::real::Dual;
use crate::space::look::{Eye, Seat, Stand};
use crate::space::sensor::Spatial;
use crate::space::{SpacePose, Twist};

/// Checks a sensor in space on points all around that it can see, and from poses all around them.
///
/// - the derivative by the point against automatic differentiation;
/// - the derivatives by landmark and pose, through the mounting, against differences;
/// - the inverse, then the expected measurement, gives the measurement back;
/// - the innovation of a measurement with itself is zero, and wraps what is an angle;
/// - the noise covariance is positive definite.
///
/// `farthest_m` says from where points are drawn. Returns how many of them the sensor could see.
pub fn check_spatial_model<M: Spatial>(model: &M, farthest_m: f64) -> Result<usize, Nonconformance> {
    expect(Cholesky::of(&model.noise()).is_some(), || "noise covariance is not positive definite".into())?;
    let mut seen = 0;
    for case in 0..500 {
        let point: [f64; 3] = std::array::from_fn(|i| draw(case, i as u32, -farthest_m, farthest_m));
        let z = model.expected(point);
        let Some(back) = model.inverse(z) else { continue };
        let apart = (0..3).map(|i| (back[i] - point[i]).abs()).fold(0.0, f64::max);
        seen += 1;
        expect(apart < 1e-9 * farthest_m, || format!("inverse of {z:?} is {back:?}, not {point:?}"))?;
        check_point(model, point)?;
        check_look(model, case, point)?;
        let zero = model.innovation(z, z);
        expect(zero == [0.0; 3], || format!("innovation of {z:?} with itself is {zero:?}"))?;
    }
    Ok(seen)
}

fn check_point<M: Spatial>(model: &M, point: [f64; 3]) -> Result<(), Nonconformance> {
    let duals = std::array::from_fn(|i| Dual::<3>::variable(point[i], i));
    let (expected, by_point) = model.linearize(point);
    let automatic = model.expected(duals);
    for row in 0..3 {
        expect((automatic[row].value - expected[row]).abs() < 1e-12 * expected[row].abs().max(1.0), || {
            format!("linearize and expected differ at {point:?}")
        })?;
        for column in 0..3 {
            let (ours, right) = (by_point[row][column], automatic[row].gradient[column]);
            expect((ours - right).abs() < 1e-9 * (1.0 + right.abs()), || {
                format!("derivative of number {row} by coordinate {column} at {point:?}: {ours} against {right}")
            })?;
        }
    }
    Ok(())
}

/// A pose, a mounting and a landmark that the sensor sees at `point`.
fn check_look<M: Spatial>(model: &M, case: u32, point: [f64; 3]) -> Result<(), Nonconformance> {
    let any =
        |first: u32, width: f64| SpacePose::exp(std::array::from_fn(|i| draw(case, first + i as u32, -width, width)));
    let (robot, mounting) = (any(10, 1.7), any(20, 0.9));
    let landmark = robot.compose(mounting).transform(point);
    let seat = Seat::new(mounting);
    let z = model.expected(point);
    let eye = Eye { model, seat: &seat };
    let look = eye.look(&Stand::from(robot), landmark, z);
    let expect_close = |ours: f64, right: f64, what: &str| {
        expect((ours - right).abs() < 1e-5 * (1.0 + right.abs()), || {
            format!("{what} at {point:?}: {ours} against {right}")
        })
    };
    let step = 1e-6;
    for k in 0..9 {
        let at = |step: f64| {
            let twist: Twist = std::array::from_fn(|i| if i == k { step } else { 0.0 });
            let moved = std::array::from_fn(|i| landmark[i] + if i + 6 == k { step } else { 0.0 });
            let pose = if k < 6 { robot.compose(SpacePose::exp(twist)) } else { robot };
            eye.look(&Stand::from(pose), moved, z).innovation
        };
        let (above, below) = (at(step), at(-step));
        for row in 0..3 {
            // The innovation falls where the expected measurement grows.
            let difference = (below[row] - above[row]) / (2.0 * step);
            let ours = if k < 6 { look.by_pose[row][k] } else { look.by_landmark[row][k - 6] };
            expect_close(ours, difference, &format!("derivative of number {row} by variable {k}"))?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measurement::Component;
    use crate::normal::Matrix;
    use crate::real::Real;
    use crate::space::matrix::Rows;
    use crate::space::sensor::{Point, RangeBearingElevation, Stereo};
    use crate::space::settings::Camera;

    #[test]
    fn every_sensor_in_space_conforms() {
        assert_eq!(check_spatial_model(&Point { position_std_m: [0.1, 0.2, 0.3] }, 20.0), Ok(500));
        let polar = RangeBearingElevation { std: [0.1, 0.02, 0.03] };
        assert_eq!(check_spatial_model(&polar, 20.0), Ok(500));
        let seen = check_spatial_model(&Stereo::new(Camera::default(), 2.0, 3.0), 20.0).unwrap();
        assert!((200..300).contains(&seen), "{seen}");
    }

    /// Elevation downwards in the derivative alone.
    struct WrongSign(RangeBearingElevation);
    impl Spatial for WrongSign {
        fn expected<R: Real>(&self, point: [R; 3]) -> [R; 3] {
            self.0.expected(point)
        }
        fn linearize<R: Real>(&self, point: [R; 3]) -> ([R; 3], Rows<R, 3, 3>) {
            let (expected, [range, bearing, elevation]) = self.0.linearize(point);
            (expected, [range, bearing, elevation.map(|v| -v)])
        }
        fn innovation<R: Real>(&self, measured: [R; 3], expected: [R; 3]) -> [R; 3] {
            self.0.innovation(measured, expected)
        }
        fn inverse(&self, measured: [f64; 3]) -> Option<[f64; 3]> {
            self.0.inverse(measured)
        }
        fn noise(&self) -> Matrix<3, 3> {
            self.0.noise()
        }
        fn components(&self) -> [Component; 3] {
            self.0.components()
        }
    }

    #[test]
    fn the_suite_rejects_a_wrong_derivative() {
        assert!(check_spatial_model(&WrongSign(RangeBearingElevation { std: [0.1; 3] }), 20.0).is_err());
    }
}
