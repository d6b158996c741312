//! A motion that nobody measures: velocities in the robot's own axes that wander.
//!
//! Along and about each axis the velocity ν is a Gaussian of standard deviation σ that forgets: white noise on the acceleration
//! drives it, and it decays with a time τ (Ornstein and Uhlenbeck; a random walk where τ is long). From one scan to the next,
//! in the logarithm ξ = log(T_a⁻¹ T_b), an axis is then a Kalman filter of two numbers,
//!
//! ```text
//! ξ  = a ν + n₁    a = τ (1 − φ),  φ = exp(−x),  x = Δ / τ
//! ν' = φ ν + n₂    (n₁, n₂) ~ N(0, σ² [τ² (2x − 3 + 4φ − φ²), τ (1 − φ)²; ·, 1 − φ²])
//! ```
//!
//! A turn that a gyro has measured takes the place of a ν about its axis, with a noise of its own.
//!
//! **Source:** `barfoot2017state`, section 11.1, with the velocities of the pose before held on the way.

use super::motion::SpaceMotion;
use super::pose::{series, SpacePose, Twist};
use super::settings::{SpaceMotionKind, SpaceMotionNoise};
use crate::math;
use crate::normal::{product, Matrix};
use serde::{Deserialize, Serialize};

/// The least width of a way and of a change of velocity: a micrometre and a microradian, which no sensor tells from none.
const LEAST_VARIANCE: f64 = 1e-12;

/// The way from one scan to the next.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Leg {
    /// What is measured of ξ; zero along and about the axes whose velocity wanders.
    pub measured: Twist,
    /// a: time for which the velocity before counts, by axis; zero where it is measured.
    pub reach_s: [f64; 6],
    /// φ: part of the velocity before that is kept; zero where it is measured.
    pub kept: [f64; 6],
    /// K: by how much the velocity changes for a way that is longer than expected by one.
    pub gain: [f64; 6],
    /// The information about (n₁, n₂) by axis: that of the way, that of both, that of the velocity.
    pub information: [[f64; 3]; 6],
}

/// A leg before what lies at its end is looked at.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ahead {
    /// The leg.
    pub leg: Leg,
    /// Variance of ξ by axis, the velocity's own included.
    pub way: [f64; 6],
    /// Variance of the velocity by axis once ξ is known.
    pub after: [f64; 6],
}

/// Whether each axis wanders.
pub fn wanders(kind: SpaceMotionKind) -> [bool; 6] {
    match kind {
        SpaceMotionKind::Odometry => [false; 6],
        SpaceMotionKind::Gyro => [true, true, true, false, false, false],
        SpaceMotionKind::Wandering => [true; 6],
    }
}

/// σ² by axis.
pub fn variances(noise: &SpaceMotionNoise) -> [f64; 6] {
    let ([x, y, z], [a, b, c]) = (noise.velocity_std_m_per_s, noise.rate_std_rad_per_s);
    [x, y, z, a, b, c].map(|std| std * std)
}

impl Ahead {
    /// After a time, and turns that were measured meanwhile, from velocities of these variances; the first leg knows the
    /// velocity before it by them alone.
    pub fn of(
        noise: &SpaceMotionNoise,
        variance: &[f64; 6],
        (dt_s, measured): (f64, &SpaceMotion),
        is_first: bool,
    ) -> Self {
        let (wandering, settled) = (wanders(noise.kind), variances(noise));
        let forgetting = Forgetting::after(dt_s, noise.velocity_time_s);
        let turned = measured.mean.log();
        let (mut leg, mut way, mut after) = (Leg::default(), [0.0; 6], *variance);
        for i in 0..6 {
            if !wandering[i] {
                leg.measured[i] = turned[i];
                way[i] = measured.covariance[i][i] + LEAST_VARIANCE;
                leg.information[i] = [1.0 / way[i], 0.0, 1.0];
                continue;
            }
            let [s, c, v] = forgetting.grown(settled[i], variance[i]);
            (leg.reach_s[i], leg.kept[i], leg.gain[i]) = (forgetting.reach_s, forgetting.kept, c / s);
            (way[i], after[i]) = (s, v - c * c / s);
            leg.information[i] = inverse(if is_first { [s, c, v] } else { forgetting.grown(settled[i], 0.0) });
        }
        Self { leg, way, after }
    }
}

/// What a time does to a velocity of standard deviation one.
struct Forgetting {
    reach_s: f64,
    kept: f64,
    noise: [f64; 3],
}

impl Forgetting {
    fn after(dt_s: f64, time_s: f64) -> Self {
        let x = dt_s / time_s;
        let kept = math::exp(-x);
        let lost = 1.0 - kept;
        // The difference below loses all digits of a short time.
        let way = if x < 0.03 {
            x * x * x * (2.0 / 3.0 - 0.5 * x + 7.0 / 30.0 * x * x)
        } else {
            2.0 * x - 3.0 + 4.0 * kept - kept * kept
        };
        let noise = [time_s * time_s * way, time_s * lost * lost, lost * (1.0 + kept)];
        Self { reach_s: time_s * lost, kept, noise }
    }

    /// Variance of the way, its covariance with the velocity, and the velocity's variance, from one that had `variance`.
    fn grown(&self, settled: f64, variance: f64) -> [f64; 3] {
        let &Self { reach_s, kept, noise: [way, both, velocity] } = self;
        [
            variance * reach_s * reach_s + settled * way + LEAST_VARIANCE,
            variance * reach_s * kept + settled * both,
            variance * kept * kept + settled * velocity + LEAST_VARIANCE,
        ]
    }
}

fn inverse([a, b, c]: [f64; 3]) -> [f64; 3] {
    let determinant = a * c - b * b;
    [c / determinant, -b / determinant, a / determinant]
}

impl Leg {
    /// ξ of a robot with this velocity.
    pub fn way(&self, velocity: &Twist) -> Twist {
        std::array::from_fn(|i| self.reach_s[i] * velocity[i] + self.measured[i])
    }

    /// The velocity of a robot that went this way, φ ν + K (ξ − a ν).
    pub fn followed(&self, velocity: &Twist, (before, after): (SpacePose, SpacePose)) -> Twist {
        let (way, gone) = (self.way(velocity), before.inverse().compose(after).log());
        std::array::from_fn(|i| self.kept[i] * velocity[i] + self.gain[i] * (gone[i] - way[i]))
    }

    /// (n₁, n₂) of two poses with their velocities, and T_a⁻¹ T_b.
    pub fn residual(&self, before: (SpacePose, &Twist), after: (SpacePose, &Twist)) -> ([f64; 12], SpacePose) {
        let step = before.0.inverse().compose(after.0);
        let (way, gone) = (self.way(before.1), step.log());
        let changed = |i: usize| after.1[i] - self.kept[i] * before.1[i];
        (std::array::from_fn(|i| if i < 6 { gone[i] - way[i] } else { changed(i - 6) }), step)
    }

    /// 1 along and about the axes whose velocity wanders, otherwise 0.
    fn carries(&self, axis: usize) -> f64 {
        f64::from(u8::from(self.kept[axis] > 0.0))
    }

    /// χ² of a residual, by axis.
    pub fn squared(&self, residual: &[f64; 12]) -> [f64; 6] {
        std::array::from_fn(|i| {
            let ([a, b, c], way, change) = (self.information[i], residual[i], self.carries(i) * residual[6 + i]);
            a * way * way + 2.0 * b * way * change + c * change * change
        })
    }

    /// Numbers whose squares χ² is made of, by axis.
    pub fn numbers(&self) -> [f64; 6] {
        std::array::from_fn(|i| 1.0 + self.carries(i))
    }

    /// Derivatives of the residual by what is before, and by what is after, and its information.
    pub fn linearized(&self, step: SpacePose) -> [Matrix<12, 12>; 3] {
        let by_end = series(&step.log(), 0.5, 1.0 / 12.0);
        let by_begin = product(&by_end, &step.inverse().adjoint());
        let (mut begin, mut end, mut information) = ([[0.0; 12]; 12], [[0.0; 12]; 12], [[0.0; 12]; 12]);
        for i in 0..6 {
            for j in 0..6 {
                (begin[i][j], end[i][j]) = (-by_begin[i][j], by_end[i][j]);
            }
            (begin[i][6 + i], begin[6 + i][6 + i], end[6 + i][6 + i]) = (-self.reach_s[i], -self.kept[i], 1.0);
            let [way, both, change] = self.information[i];
            (information[i][i], information[i][6 + i]) = (way, both);
            (information[6 + i][i], information[6 + i][6 + i]) = (both, change);
        }
        [begin, end, information]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::normal::congruence;
    use crate::normal::sum;

    /// F and Q of one axis for a time.
    fn model(dt_s: f64, time_s: f64) -> (Matrix<2, 2>, Matrix<2, 2>) {
        let Forgetting { reach_s, kept, noise: [a, b, c] } = Forgetting::after(dt_s, time_s);
        ([[1.0, reach_s], [0.0, kept]], [[a, b], [b, c]])
    }

    #[test]
    fn parts_of_a_leg_make_the_whole() {
        // Below the time from where on the difference is taken, about it, and long after a velocity is forgotten.
        for (dt_s, parts) in [(0.02, 4), (0.1, 2), (0.1, 8), (1.0, 5), (30.0, 6)] {
            let (mut f, mut q) = ([[1.0, 0.0], [0.0, 1.0]], [[0.0; 2]; 2]);
            let (step, noise) = model(dt_s / f64::from(parts), 2.0);
            for _ in 0..parts {
                (f, q) = (product(&step, &f), sum(&congruence(&step, &q), &noise));
            }
            let (whole_f, whole_q) = model(dt_s, 2.0);
            for i in 0..2 {
                for j in 0..2 {
                    assert!((f[i][j] - whole_f[i][j]).abs() < 1e-12, "{dt_s} {parts}");
                    // The difference of numbers of size one, and what the series leaves out: 0.03³ / 7 of it.
                    assert!(
                        (q[i][j] - whole_q[i][j]).abs() < 1e-6 * whole_q[i][j],
                        "{dt_s} {parts}: {q:?} {whole_q:?}"
                    );
                }
            }
        }
    }

    #[test]
    fn a_short_leg_is_that_of_a_random_walk_and_a_long_one_forgets() {
        let (dt_s, time_s) = (0.1, 1e4);
        let (f, q) = model(dt_s, time_s);
        let per_s = 2.0 / time_s;
        let walk = [per_s * dt_s * dt_s * dt_s / 3.0, per_s * dt_s * dt_s / 2.0, per_s * dt_s];
        assert!((f[0][1] - dt_s).abs() < 1e-6);
        assert!([q[0][0], q[0][1], q[1][1]].iter().zip(&walk).all(|(a, b)| (a / b - 1.0).abs() < 1e-4));
        let (f, q) = model(1e3, 1.0);
        assert!(f[1][1] < 1e-300 && (q[1][1] - 1.0).abs() < 1e-12 && (q[0][0] - 1997.0).abs() < 1e-9);
    }

    #[test]
    fn derivatives_are_those_of_the_residual() {
        let noise = SpaceMotionNoise { kind: SpaceMotionKind::Gyro, ..SpaceMotionNoise::default() };
        let measured = SpaceMotion::of(&noise, [0.0, 0.0, 0.0, 0.3, -0.2, 0.5], 0.2).unwrap();
        for kind in [SpaceMotionKind::Gyro, SpaceMotionKind::Wandering] {
            let noise = SpaceMotionNoise { kind, ..noise.clone() };
            let leg = Ahead::of(&noise, &variances(&noise), (0.2, &measured), false).leg;
            let begin = (SpacePose::exp([1.0, 2.0, -0.5, 0.3, 0.8, -0.4]), [0.4, -0.2, 0.1, 0.2, -0.1, 0.3]);
            let end = (
                begin.0.compose(SpacePose::exp([0.1, -0.05, 0.02, 0.05, -0.04, 0.1])),
                [0.5, -0.1, 0.2, 0.1, 0.0, 0.2],
            );
            let (_, step) = leg.residual((begin.0, &begin.1), (end.0, &end.1));
            let [by_begin, by_end, _] = leg.linearized(step);
            let h = 1e-6;
            for k in 0..12 {
                let nudged = |at: (SpacePose, Twist), sign: f64| {
                    let by = |i: usize| if i == k { sign * h } else { 0.0 };
                    let pose = at.0.compose(SpacePose::exp(std::array::from_fn(by)));
                    (pose, std::array::from_fn(|i| at.1[i] + by(6 + i)))
                };
                for (is_begin, jacobian) in [(true, &by_begin), (false, &by_end)] {
                    let residual = |sign: f64| {
                        let a = if is_begin { nudged(begin, sign) } else { begin };
                        let b = if is_begin { end } else { nudged(end, sign) };
                        leg.residual((a.0, &a.1), (b.0, &b.1)).0
                    };
                    let (up, down) = (residual(1.0), residual(-1.0));
                    for i in 0..12 {
                        // The inverse Jacobian is a series to third order, of a turn of 0.12.
                        let by = (up[i] - down[i]) / (2.0 * h);
                        assert!((by - jacobian[i][k]).abs() < 1e-5, "{kind:?} {i} {k}: {by} {}", jacobian[i][k]);
                    }
                }
            }
        }
    }
}
