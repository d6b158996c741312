//! Rotation, translation, rotation.

use super::{ConditionedControl, ControlTiming, MotionModel};
use crate::error::{non_negative, Error, Result};
use crate::geometry::Pose;
use crate::math::{atan2, wrap_angle};
use crate::real::Real;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Odometry as a turn, a straight move and a second turn, with noise in proportion to all three.
///
/// **Control:** (dx in m, dy in m, dheading in rad): the pose now in the frame of the pose at the previous row.
/// A move backwards is a negative translation, not two half turns.
/// **Source:** `thrun2005probabilistic`, table 5.6; the alphas multiply squared motions and give variances.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Odometry {
    /// Variance of a turn per squared turn [rad²/rad²].
    pub alpha1: f64,
    /// Variance of a turn per squared translation [rad²/m²].
    pub alpha2: f64,
    /// Variance of the translation per squared translation [m²/m²].
    pub alpha3: f64,
    /// Variance of the translation per squared turn [m²/rad²].
    pub alpha4: f64,
}

impl Default for Odometry {
    fn default() -> Self {
        Self { alpha1: 0.01, alpha2: 0.001, alpha3: 0.01, alpha4: 0.001 }
    }
}

impl MotionModel for Odometry {
    fn timing(&self) -> ControlTiming {
        ControlTiming::Increment
    }

    fn condition(&self, [dx, dy, dheading]: [f64; 3], dt_s: f64) -> ConditionedControl {
        let distance = (dx * dx + dy * dy).sqrt();
        // The direction of a move of a few micrometres is noise; a turn on the spot has none.
        let direction = if distance < 1e-6 { 0.0 } else { atan2(dy, dx) };
        let backwards = direction.abs() > std::f64::consts::FRAC_PI_2;
        let (turn1, translation) =
            if backwards { (wrap_angle(direction + std::f64::consts::PI), -distance) } else { (direction, distance) };
        let turn2 = wrap_angle(dheading - turn1);
        let (t1, s, t2) = (turn1 * turn1, translation * translation, turn2 * turn2);
        ConditionedControl {
            mean: [turn1, translation, turn2],
            std: [
                (self.alpha1 * t1 + self.alpha2 * s).sqrt(),
                (self.alpha3 * s + self.alpha4 * (t1 + t2)).sqrt(),
                (self.alpha1 * t2 + self.alpha2 * s).sqrt(),
            ],
            dt_s,
        }
    }

    #[inline(always)]
    fn relative_motion<R: Real>(&self, [turn1, translation, turn2]: [R; 3], _dt_s: f64) -> Pose<R> {
        let (s, c) = turn1.sin_cos();
        Pose::new(translation * c, translation * s, turn1 + turn2)
    }

    fn validate(&self) -> Result<()> {
        for (key, value) in
            [("alpha1", self.alpha1), ("alpha2", self.alpha2), ("alpha3", self.alpha3), ("alpha4", self.alpha4)]
        {
            non_negative(key, value)?;
        }
        if self.alpha1 + self.alpha2 + self.alpha3 + self.alpha4 == 0.0 {
            return Err(Error::parameter("alpha1", 0.0, "at least one alpha above 0"));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_mean_motion_is_the_measured_displacement() {
        let model = Odometry::default();
        for control in [[1.0, 0.2, 0.5], [-1.0, 0.1, -0.3], [0.0, 0.0, 2.0], [0.3, -0.4, 3.0]] {
            let conditioned = model.condition(control, 1.0);
            let motion = model.relative_motion(conditioned.mean, 1.0);
            assert!((motion.x - control[0]).abs() < 1e-12 && (motion.y - control[1]).abs() < 1e-12);
            assert!(wrap_angle(motion.heading - control[2]).abs() < 1e-12);
        }
    }

    #[test]
    fn reversing_is_as_certain_as_driving() {
        let model = Odometry::default();
        assert_eq!(model.condition([1.0, 0.0, 0.0], 1.0).std, model.condition([-1.0, 0.0, 0.0], 1.0).std);
    }
}
