//! Rotation, translation, rotation.

use super::settings::variance_of;
use super::{twist_of, ControlTiming, Correction, MotionModel, Proportional, RowMotion};
use crate::error::{non_negative, Error, Result};
use crate::geometry::{transform3, Pose};
use crate::math::{atan2, sin_cos, wrap_angle};
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
    /// Systematic errors of the odometry.
    pub correction: Correction,
    /// Noise in proportion to what was driven and turned whose parts add up, beside that of the alphas.
    pub proportional: Proportional,
}

impl Default for Odometry {
    fn default() -> Self {
        Self {
            alpha1: 0.01,
            alpha2: 0.001,
            alpha3: 0.01,
            alpha4: 0.001,
            correction: Correction::default(),
            proportional: Proportional::default(),
        }
    }
}

/// A motion as first turn, translation and second turn.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Turns {
    mean: [f64; 3],
    variance: [f64; 3],
}

impl Odometry {
    fn turns_of(&self, Pose { x, y, heading }: Pose) -> Turns {
        let distance = (x * x + y * y).sqrt();
        // The direction of a move of a few micrometres is noise; a turn on the spot has none.
        let direction = if distance < 1e-6 { 0.0 } else { atan2(y, x) };
        let backwards = direction.abs() > std::f64::consts::FRAC_PI_2;
        let (turn1, translation) =
            if backwards { (wrap_angle(direction + std::f64::consts::PI), -distance) } else { (direction, distance) };
        let turn2 = wrap_angle(heading - turn1);
        let (t1, s, t2) = (turn1 * turn1, translation * translation, turn2 * turn2);
        Turns {
            mean: [turn1, translation, turn2],
            variance: [
                self.alpha1 * t1 + self.alpha2 * s,
                self.alpha3 * s + self.alpha4 * (t1 + t2),
                self.alpha1 * t2 + self.alpha2 * s,
            ],
        }
    }
}

impl MotionModel for Odometry {
    fn timing(&self) -> ControlTiming {
        ControlTiming::Increment
    }

    fn row(&self, control: [f64; 3], row_s: f64) -> RowMotion {
        let twist = self.correction.truth_of(twist_of(control), row_s);
        let [forward, left, turn] = twist;
        let turns = self.turns_of(Pose::from_twist(forward, left, turn));
        let (s, c) = sin_cos(turns.mean[0]);
        let translation = turns.mean[1];
        let by_turns = [[-s * translation, c, 0.0], [c * translation, s, 0.0], [1.0, 0.0, 1.0]];
        let [first, moved, second] = turns.variance;
        let of_turns = [[first, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, second]];
        let stated = [of_turns, variance_of(1, moved), [[0.0; 3]; 3]].map(|noise| transform3(&by_turns, &noise));
        RowMotion::reaching(twist, stated, 0).adding(self.proportional.variances(twist))
    }

    fn validate(&self) -> Result<()> {
        for (key, value) in
            [("alpha1", self.alpha1), ("alpha2", self.alpha2), ("alpha3", self.alpha3), ("alpha4", self.alpha4)]
        {
            non_negative(key, value)?;
        }
        self.correction.validate()?;
        self.proportional.validate()?;
        if self.alpha1 + self.alpha2 + self.alpha3 + self.alpha4 + self.proportional.distance_std_m_per_sqrt_m == 0.0 {
            return Err(Error::parameter("alpha1", 0.0, "at least one alpha above 0"));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_with_equal_turns_keeps_the_covariance_of_the_book() {
        // Turns of 0.3 rad and 2 m between them: the noise of each by hand, the first turn swinging the translation.
        let model = Odometry::default();
        let (turn, way) = (0.3_f64, 2.0_f64);
        let (s, c) = (turn.sin(), turn.cos());
        let variance_of_turn = 0.01 * 0.09 + 0.001 * 4.0;
        let variance_of_way = 0.01 * 4.0 + 0.001 * 0.18;
        let expected = [
            [
                s * s * 4.0 * variance_of_turn + c * c * variance_of_way,
                s * c * (variance_of_way - 4.0 * variance_of_turn),
                -s * way * variance_of_turn,
            ],
            [0.0, c * c * 4.0 * variance_of_turn + s * s * variance_of_way, c * way * variance_of_turn],
            [0.0, 0.0, 2.0 * variance_of_turn],
        ];
        let whole = model.row([way * c, way * s, 0.6], 1.0).part(1.0);
        assert!((whole.mean.x - way * c).abs() < 1e-15 && (whole.mean.y - way * s).abs() < 1e-15);
        for i in 0..3 {
            for j in i..3 {
                let (got, want) = (whole.covariance[i][j], expected[i][j]);
                assert!((got - want).abs() < 1e-15, "{i}, {j}: {got} against {want}");
            }
        }
    }

    #[test]
    fn reversing_is_as_certain_as_driving() {
        let model = Odometry::default();
        let variance = |x| model.turns_of(Pose::new(x, 0.0, 0.0)).variance;
        assert_eq!(variance(1.0), variance(-1.0));
    }
}
