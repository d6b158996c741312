//! What each noise of a motion adds to its covariance, one by one.

use super::{ConditionedControl, Motion, MotionModel};
use crate::geometry::{transform3, Matrix3, Pose};
use crate::real::Dual;

/// Coordinates of a control in which its noise is independent.
pub const CONTROL_NOISES: usize = 3;

/// Keys of a configuration that set one noise of the motion together, so that one factor is told for all of them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NoiseKeys {
    /// What is uncertain, in a word or two.
    pub what: &'static str,
    /// Keys in the section `motion`.
    pub keys: &'static [&'static str],
    /// 1 where they are standard deviations, 2 where they are variances.
    pub power: u8,
    /// The coordinates of a control that it makes uncertain.
    pub coordinates: [bool; CONTROL_NOISES],
}

/// A motion with the covariances that its noises add, in the frame of its start; their sum is that of the motion.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MotionByNoise {
    /// `T_start_now`.
    pub mean: Pose,
    /// One per entry of [`Motion::noises`].
    pub covariances: [Matrix3; CONTROL_NOISES],
}

impl MotionByNoise {
    /// One control more, to first order.
    pub(super) fn extended<M: MotionModel>(
        &self,
        model: &M,
        control: ConditionedControl,
        noises: &[NoiseKeys],
    ) -> Self {
        let start = [self.mean.x, self.mean.y, self.mean.heading];
        let variable = |value: [f64; 3], offset: usize| -> [Dual<6>; 3] {
            std::array::from_fn(|i| Dual::variable(value[i], offset + i))
        };
        let [x, y, heading] = variable(start, 0);
        let end = Pose::new(x, y, heading).compose(model.relative_motion(variable(control.mean, 3), control.dt_s));
        let rows = [end.x.gradient, end.y.gradient, end.heading.gradient];
        let by_start: Matrix3 = rows.map(|g| [g[0], g[1], g[2]]);
        let mut covariances = self.covariances;
        for (noise, covariance) in noises.iter().zip(&mut covariances) {
            *covariance = transform3(&by_start, covariance);
            for c in (0..CONTROL_NOISES).filter(|c| noise.coordinates[*c]) {
                let variance = control.std[c] * control.std[c];
                for i in 0..3 {
                    (0..3).for_each(|j| covariance[i][j] += rows[i][3 + c] * variance * rows[j][3 + c]);
                }
            }
        }
        Self { mean: Pose::new(end.x.value, end.y.value, end.heading.value), covariances }
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
        const FIRST: [bool; CONTROL_NOISES] = [true, false, false];
        const SECOND: [bool; CONTROL_NOISES] = [false, true, false];
        const THIRD: [bool; CONTROL_NOISES] = [false, false, true];
        const fn std(what: &'static str, keys: &'static [&'static str], coordinates: [bool; 3]) -> NoiseKeys {
            NoiseKeys { what, keys, power: 1, coordinates }
        }
        const fn variance(what: &'static str, keys: &'static [&'static str], coordinates: [bool; 3]) -> NoiseKeys {
            NoiseKeys { what, keys, power: 2, coordinates }
        }
        const LATERAL: NoiseKeys = std("sideways slip", &["lateral_std_m_per_s"], THIRD);
        const SPEED: NoiseKeys = std("speed", &["speed_std_m_per_s"], FIRST);
        match self {
            Self::Velocity(_) => const { &[SPEED, std("yaw rate", &["yaw_rate_std_rad_per_s"], SECOND), LATERAL] },
            Self::Ackermann(_) => const { &[SPEED, std("steering angle", &["steering_std_rad"], SECOND), LATERAL] },
            Self::Increments(_) => {
                const {
                    &[
                        std("displacement ahead", &["x_std_m"], FIRST),
                        std("displacement sideways", &["y_std_m"], SECOND),
                        std("turn", &["heading_std_rad"], THIRD),
                    ]
                }
            }
            Self::Odometry(_) => {
                const {
                    &[
                        variance("turn", &["alpha1", "alpha2"], [true, false, true]),
                        variance("translation", &["alpha3", "alpha4"], SECOND),
                    ]
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Ackermann, Increments, MotionGaussian, Odometry, Velocity};
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
                whole = model.extend(&whole, control, 0.1);
                apart = model.extend_by_noise(&apart, control, 0.1);
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
            let coordinates = |c: usize| model.noises().iter().filter(|noise| noise.coordinates[c]).count();
            assert_eq!([0, 1, 2].map(coordinates), [1; 3]);
        }
    }
}
