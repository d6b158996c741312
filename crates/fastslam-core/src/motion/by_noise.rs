//! What each noise of a motion adds to its covariance, one by one.

use super::gaussian::MotionGaussian;
use super::row::CONTROL_NOISES;
use super::Motion;
use crate::geometry::{transform3, Matrix3, Pose};
use serde::{Deserialize, Serialize};

/// Keys of a configuration that set one noise of the motion together, so that one factor is told for all of them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NoiseKeys {
    /// What is uncertain, in a word or two.
    pub what: &'static str,
    /// Keys in the section `motion`.
    pub keys: &'static [&'static str],
    /// 1 where they are standard deviations, 2 where they are variances.
    pub power: u8,
}

/// A motion with the covariances that its noises add, in the frame of its start; with what no key of a configuration
/// sets alone ([`super::RowMotion::rest`]) their sum is that of the motion.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MotionByNoise {
    /// `T_start_now`.
    pub mean: Pose,
    /// One per entry of [`Motion::noises`].
    pub covariances: [Matrix3; CONTROL_NOISES],
}

impl MotionByNoise {
    /// This motion followed by another, to first order.
    pub fn then(&self, next: &Self) -> Self {
        let of = |motion: &Self, k: usize| MotionGaussian { mean: motion.mean, covariance: motion.covariances[k] };
        let both: [MotionGaussian; CONTROL_NOISES] = std::array::from_fn(|k| of(self, k).then(&of(next, k)));
        Self { mean: both[0].mean, covariances: both.map(|motion| motion.covariance) }
    }

    /// The covariances in the world's axes, of a motion that ends with this heading.
    pub fn covariances_in_world(&self, heading: f64) -> [Matrix3; CONTROL_NOISES] {
        let (s, c) = crate::math::sin_cos(heading - self.mean.heading);
        let rotation = [[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]];
        self.covariances.map(|covariance| transform3(&rotation, &covariance))
    }
}

impl Motion {
    /// The noises of the model, which the log may tell apart.
    pub fn noises(&self) -> &'static [NoiseKeys] {
        const fn std(what: &'static str, keys: &'static [&'static str]) -> NoiseKeys {
            NoiseKeys { what, keys, power: 1 }
        }
        const fn variance(what: &'static str, keys: &'static [&'static str]) -> NoiseKeys {
            NoiseKeys { what, keys, power: 2 }
        }
        const LATERAL: NoiseKeys = std("sideways slip", &["lateral_std_m_per_s"]);
        const SPEED: NoiseKeys = std("speed", &["speed_std_m_per_s"]);
        match self {
            Self::Velocity(_) => const { &[SPEED, std("yaw rate", &["yaw_rate_std_rad_per_s"]), LATERAL] },
            Self::Ackermann(_) => const { &[SPEED, std("steering angle", &["steering_std_rad"]), LATERAL] },
            Self::Increments(_) => {
                const {
                    &[
                        std("displacement ahead", &["x_std_m"]),
                        std("displacement sideways", &["y_std_m"]),
                        std("turn", &["heading_std_rad"]),
                    ]
                }
            }
            Self::Odometry(_) => {
                const { &[variance("turn", &["alpha1", "alpha2"]), variance("translation", &["alpha3", "alpha4"])] }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Ackermann, Increments, Odometry, RowPart, Velocity};
    use super::*;

    #[test]
    fn the_parts_add_up_to_the_motion() {
        let models = [
            Motion::Velocity(Velocity { lateral_std_m_per_s: 0.1, ..Velocity::default() }),
            Motion::Ackermann(Ackermann { lateral_std_m_per_s: 0.1, ..Ackermann::default() }),
            Motion::Increments(Increments::default()),
            Motion::Odometry(Odometry::default()),
        ];
        for model in models {
            let (mut whole, mut apart) = (MotionGaussian::default(), MotionByNoise::default());
            for i in 0..20 {
                let control = [0.3 + 0.02 * f64::from(i), 0.1 - 0.01 * f64::from(i), 0.05];
                let part = RowPart { share: 0.6, ..RowPart::whole(control, 0.15) };
                let (motion, by_noise) = model.with_noises(&part).unwrap();
                whole = whole.then(&motion);
                apart = apart.then(&by_noise);
            }
            assert!((whole.mean.x - apart.mean.x).abs() < 1e-12);
            for i in 0..3 {
                for j in 0..3 {
                    let sum: f64 = apart.covariances.iter().map(|c| c[i][j]).sum();
                    assert!((sum - whole.covariance[i][j]).abs() < 1e-12, "{model:?} {i} {j}");
                }
            }
            let world = whole.covariance_in_world(0.4);
            let parts = apart.covariances_in_world(0.4 + apart.mean.heading);
            assert!((parts.iter().map(|c| c[0][1]).sum::<f64>() - world[0][1]).abs() < 1e-12);
            let noises = model.noises().len();
            assert!((2..=CONTROL_NOISES).contains(&noises));
            assert!(apart.covariances[..noises].iter().all(|c| c[0][0] + c[1][1] > 0.0), "{model:?}: {apart:?}");
        }
    }
}
