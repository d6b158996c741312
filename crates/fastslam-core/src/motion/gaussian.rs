//! A motion with its uncertainty: composed, turned into the world's axes, and sampled.

use super::part::RowPart;
use super::PoseColumns;
use crate::error::{Error, Result};
use crate::geometry::{multiply3, transform3, Matrix3, Pose};
use crate::limits::LARGEST_STATE;
use crate::math;
use crate::random::Stream;
use crate::vector::vectorized;
use serde::{Deserialize, Serialize};

/// Above this spread of the heading the motion since the last sighting is sampled rather than linearised on.
const LARGEST_LINEARISED_HEADING_STD_RAD: f64 = 0.2;

/// A motion of the robot as a Gaussian in the frame of its start.
#[derive(Clone, Copy, Debug, PartialEq, Default, Serialize, Deserialize)]
pub struct MotionGaussian {
    /// `T_start_now`.
    pub mean: Pose,
    /// Covariance of (x, y, heading) of `mean`, in the frame of the start.
    pub covariance: Matrix3,
}

impl MotionGaussian {
    /// Covariance of the pose reached from a start with this heading, in the world's axes.
    #[inline(always)]
    pub fn covariance_in_world(&self, heading: f64) -> Matrix3 {
        let (s, c) = math::sin_cos(heading);
        let [[xx, xy, xh], [_, yy, yh], [_, _, hh]] = self.covariance;
        let (cross, twice) = (s * c * (xx - yy) + (c * c - s * s) * xy, 2.0 * s * c * xy);
        let (along, across) = (c * xh - s * yh, s * xh + c * yh);
        [
            [c * c * xx - twice + s * s * yy, cross, along],
            [cross, s * s * xx + twice + c * c * yy, across],
            [along, across, hh],
        ]
    }

    /// This motion followed by another, to first order.
    ///
    /// **Source:** P ← F P Fᵀ + G Σ Gᵀ, with F, G the derivatives of the composed pose by both motions.
    pub fn then(&self, next: &MotionGaussian) -> MotionGaussian {
        let (s, c) = math::sin_cos(self.mean.heading);
        let step = next.mean;
        let by_start = [[1.0, 0.0, -s * step.x - c * step.y], [0.0, 1.0, c * step.x - s * step.y], [0.0, 0.0, 1.0]];
        let rotation = [[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]];
        let old = multiply3(&by_start, &self.covariance);
        let old = multiply3(&old, &transpose(&by_start));
        let new = transform3(&rotation, &next.covariance);
        MotionGaussian {
            mean: self.mean.compose(step),
            covariance: symmetrized(&std::array::from_fn(|i| std::array::from_fn(|j| old[i][j] + new[i][j]))),
        }
    }

    /// This motion, or an error that names the control that made it too large to compute with.
    pub(crate) fn checked(self, part: &RowPart) -> Result<Self> {
        let numbers = self.mean.to_array().into_iter().chain(self.covariance.into_iter().flatten());
        if numbers.into_iter().all(|v| v.abs() <= LARGEST_STATE) {
            return Ok(self);
        }
        let RowPart { control, row_s, .. } = part;
        Err(Error::Input(format!("control {control:?} for {row_s} s: no robot moves that far, or as uncertainly")))
    }

    /// Whether it may stay pending: its heading is certain enough for what later sightings say of it to be linear.
    pub(crate) fn can_be_linearised_on(&self) -> bool {
        self.covariance[2][2].sqrt() < LARGEST_LINEARISED_HEADING_STD_RAD
    }

    /// Moves every particle by a sample of the motion (the proposal of FastSLAM 1.0).
    ///
    /// The noise is Gaussian in the body's frame at the end, as a twist: a heading error bends the way, so that the
    /// cloud is curved as that of many small steps is.
    ///
    /// **Shapes:** the three columns have one number per particle. **Source:** `montemerlo2002fastslam`, eq. 2.
    pub fn sample(&self, stream: Stream, poses: PoseColumns<'_>) {
        let PoseColumns { first_particle, x, y, heading } = poses;
        let n = x.len();
        let (y, heading) = (&mut y[..n], &mut heading[..n]);
        let root = self.root_at_end();
        let mean = self.mean;
        let (sine, cosine) = math::sin_cos(mean.heading);
        let third = root.left[2] > 0.0;
        vectorized(
            #[inline(always)]
            || {
                for i in 0..n {
                    let particle = first_particle + i as u32;
                    let [a, b] = stream.normal_pair(particle, 0);
                    let c = if third { stream.normal_pair(particle, 1)[0] } else { 0.0 };
                    let noise = Pose::from_twist(
                        root.forward[0] * b + root.forward[1] * a,
                        root.left[0] * b + root.left[1] * a + root.left[2] * c,
                        root.turn * b,
                    );
                    let motion = Pose::new(
                        mean.x + cosine * noise.x - sine * noise.y,
                        mean.y + sine * noise.x + cosine * noise.y,
                        mean.heading + noise.heading,
                    );
                    let moved = Pose::new(x[i], y[i], heading[i]).compose(motion);
                    (x[i], y[i], heading[i]) = (moved.x, moved.y, moved.heading);
                }
            },
        );
    }

    /// A root of the covariance in the axes of the end; of a singular one too.
    fn root_at_end(&self) -> Root {
        let [[xx, xy, xh], [_, yy, yh], [_, _, hh]] = self.covariance_in_world(-self.mean.heading);
        let turn = hh.max(0.0).sqrt();
        let (x_turn, y_turn) = (over(xh, turn), over(yh, turn));
        let x = left_of(xx, x_turn * x_turn);
        let y_x = over(xy - x_turn * y_turn, x);
        let y = left_of(yy, y_turn * y_turn + y_x * y_x);
        Root { turn, forward: [x_turn, x], left: [y_turn, y_x, y] }
    }
}

/// A lower triangular root: what each coordinate takes of independent normal numbers (turn, forward, left).
#[derive(Clone, Copy)]
struct Root {
    turn: f64,
    forward: [f64; 2],
    left: [f64; 3],
}

/// Below this share of itself what is left of a variance is rounding.
const ROUNDING: f64 = 1e-14;

/// Standard deviation of what a part of a variance leaves.
fn left_of(variance: f64, part: f64) -> f64 {
    let rest = variance - part;
    if rest > ROUNDING * variance {
        rest.sqrt()
    } else {
        0.0
    }
}

/// `covariance / std`, and nothing where there is no deviation.
fn over(covariance: f64, std: f64) -> f64 {
    if std > 0.0 {
        covariance / std
    } else {
        0.0
    }
}

/// Without what rounding makes of symmetry.
pub(super) fn symmetrized(m: &Matrix3) -> Matrix3 {
    std::array::from_fn(|i| std::array::from_fn(|j| 0.5 * (m[i][j] + m[j][i])))
}

fn transpose(m: &Matrix3) -> Matrix3 {
    std::array::from_fn(|i| std::array::from_fn(|j| m[j][i]))
}
