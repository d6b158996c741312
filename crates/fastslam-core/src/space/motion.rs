//! How the robot moves in space: body velocities that hold, with noise in the body's axes.

use super::pose::{series, SpacePose, Twist};
use super::settings::SpaceMotionNoise;
use crate::error::{Error, Result};
use crate::limits;
use crate::normal::{congruence, sum, Matrix};
use serde::{Deserialize, Serialize};

/// A motion with its uncertainty: the covariance of ξ in `T Exp(ξ)`.
///
/// It is the same for all particles, since it lives in the body's axes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SpaceMotion {
    /// The pose after the motion in the frame of that before it.
    pub mean: SpacePose,
    /// (shift in m, turn in rad) in the axes after the motion.
    pub covariance: Matrix<6, 6>,
}

impl Default for SpaceMotion {
    fn default() -> Self {
        Self { mean: SpacePose::default(), covariance: [[0.0; 6]; 6] }
    }
}

impl SpaceMotion {
    /// That of a body velocity (m/s, rad/s) that holds for `dt_s`: Exp(ν dt + n), with n ~ N(0, diag(σ²) dt), which
    /// perturbs the end by J_r n.
    ///
    /// **Errors:** [`Error::Input`] for a velocity that no robot could have, or a duration below zero.
    pub fn of(noise: &SpaceMotionNoise, velocity: Twist, dt_s: f64) -> Result<Self> {
        let (most, longest) = (limits::LARGEST_RATE, limits::LONGEST_S);
        if !velocity.iter().all(|v| v.abs() <= most) || !(0.0..=longest).contains(&dt_s) {
            let expected = format!("expected finite numbers, at most {most:e}, and dt_s from 0 to {longest:e}");
            return Err(Error::Input(format!("velocity {velocity:?} for {dt_s} s: {expected}")));
        }
        let way = velocity.map(|v| v * dt_s);
        if !way[3..].iter().all(|turn| turn.abs() <= limits::WIDEST_RAD) {
            return Err(Error::Input(format!("a turn by {:?} rad in one row, expected less", &way[3..])));
        }
        let mut spread = [[0.0; 6]; 6];
        for i in 0..3 {
            spread[i][i] = noise.position_std_m_per_sqrt_s[i].powi(2) * dt_s;
            spread[3 + i][3 + i] = noise.turn_std_rad_per_sqrt_s[i].powi(2) * dt_s;
        }
        let covariance = congruence(&series(&way, -0.5, 1.0 / 6.0), &spread);
        Ok(Self { mean: SpacePose::exp(way), covariance })
    }

    /// This motion, then another one.
    pub fn then(&self, next: &Self) -> Self {
        let carried = congruence(&next.mean.inverse().adjoint(), &self.covariance);
        Self { mean: self.mean.compose(next.mean), covariance: sum(&carried, &next.covariance) }
    }

    /// L with L Lᵀ = covariance, also where it has no width in some direction.
    pub fn root(&self) -> Matrix<6, 6> {
        let a = &self.covariance;
        let mut l = [[0.0; 6]; 6];
        for j in 0..6 {
            let rest = a[j][j] - (0..j).map(|k| l[j][k] * l[j][k]).sum::<f64>();
            // What is left of a direction without width is rounding.
            if rest > 1e-14 * a[j][j] {
                l[j][j] = rest.sqrt();
                for i in j + 1..6 {
                    l[i][j] = (a[i][j] - (0..j).map(|k| l[i][k] * l[j][k]).sum::<f64>()) / l[j][j];
                }
            }
        }
        l
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::space::matrix::multiply_transposed;

    fn noise() -> SpaceMotionNoise {
        let (position_std_m_per_sqrt_s, turn_std_rad_per_sqrt_s) = ([0.05, 0.04, 0.0], [0.1, 0.2, 0.4]);
        SpaceMotionNoise { position_std_m_per_sqrt_s, turn_std_rad_per_sqrt_s, ..SpaceMotionNoise::default() }
    }

    const VELOCITY: Twist = [0.3, -0.1, 0.05, 0.2, -0.4, 0.7];

    #[test]
    fn parts_of_a_row_make_the_whole() {
        let whole = SpaceMotion::of(&noise(), VELOCITY, 0.4).unwrap();
        let part = SpaceMotion::of(&noise(), VELOCITY, 0.1).unwrap();
        let made = (0..4).fold(SpaceMotion::default(), |sum, _| sum.then(&part));
        assert!(whole.mean.inverse().compose(made.mean).log().iter().all(|v| v.abs() < 1e-12));
        // A row errs by one velocity all along, its parts by one each: of what an error of a turn, 0.4 √T at most, makes of
        // the way (0.13 m) and of the turn (0.33 rad), the first is a quarter and the second a third.
        let apart = |size: f64| size * size * 0.4 * 0.4 * 0.4 / 12.0;
        for i in 0..6 {
            let (a, b) = (whole.covariance[i][i], made.covariance[i][i]);
            assert!((a - b).abs() < apart(if i < 3 { 0.13 } else { 0.33 }) + 0.01 * a, "{i}: {a} {b}");
        }
    }

    #[test]
    fn the_root_of_a_flat_covariance_is_one() {
        for dt_s in [0.0, 0.1, 2.0] {
            let motion = SpaceMotion::of(&noise(), VELOCITY, dt_s).unwrap();
            let root = motion.root();
            let square = multiply_transposed(&root, &root);
            for i in 0..6 {
                for j in 0..6 {
                    assert!((square[i][j] - motion.covariance[i][j]).abs() < 1e-15);
                }
            }
        }
    }

    #[test]
    fn what_no_robot_does_is_refused() {
        for (velocity, dt_s) in [([f64::NAN; 6], 0.1), ([0.0; 6], -0.1), ([1e7; 6], 0.1), ([9e5; 6], 1.0)] {
            assert!(SpaceMotion::of(&noise(), velocity, dt_s).is_err(), "{velocity:?} {dt_s}");
        }
    }
}
