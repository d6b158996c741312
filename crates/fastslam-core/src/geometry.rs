//! Planar rigid transforms and symmetric matrices in closed form.

use crate::real::Real;

/// A rigid transform of the plane, `T_a_b`: takes coordinates in frame b to coordinates in frame a.
///
/// **Frame and units:** x and y in metres, heading in radians counter-clockwise. The tangent order is (x, y, heading).
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Pose<R = f64> {
    /// Metres.
    pub x: R,
    /// Metres.
    pub y: R,
    /// Radians.
    pub heading: R,
}

impl<R: Real> Pose<R> {
    /// From x, y in metres and heading in radians.
    #[inline(always)]
    pub fn new(x: R, y: R, heading: R) -> Self {
        Self { x, y, heading }
    }

    /// `T_a_b * T_b_c = T_a_c`, heading wrapped.
    #[inline(always)]
    pub fn compose(self, other: Self) -> Self {
        let (s, c) = self.heading.sin_cos();
        Self {
            x: self.x + c * other.x - s * other.y,
            y: self.y + s * other.x + c * other.y,
            heading: (self.heading + other.heading).wrap_angle(),
        }
    }

    /// `T_b_a`.
    pub fn inverse(self) -> Self {
        let (s, c) = self.heading.sin_cos();
        Self { x: -(c * self.x + s * self.y), y: s * self.x - c * self.y, heading: -self.heading }
    }

    /// Coordinates in a of a point given in b.
    #[inline(always)]
    pub fn transform(self, point: [R; 2]) -> [R; 2] {
        let (s, c) = self.heading.sin_cos();
        [self.x + c * point[0] - s * point[1], self.y + s * point[0] + c * point[1]]
    }

    /// The transform that a constant body velocity reaches: (forward, left, turn) integrated over its time.
    #[inline(always)]
    pub fn from_twist(forward: R, left: R, turn: R) -> Self {
        let half = turn * R::constant(0.5);
        let (s, c) = half.sin_cos();
        let chord = half.sinc();
        Self { x: chord * (c * forward - s * left), y: chord * (s * forward + c * left), heading: turn }
    }

    /// The twist whose exponential this is: the inverse of [`Pose::from_twist`] for |heading| < π.
    pub fn to_twist(self) -> [R; 3] {
        let half = self.heading * R::constant(0.5);
        let (s, c) = half.sin_cos();
        let chord = half.sinc();
        [(c * self.x + s * self.y) / chord, (c * self.y - s * self.x) / chord, self.heading]
    }
}

impl Pose {
    /// The part `fraction` in [0, 1] of this motion, along its arc.
    pub fn fraction(self, fraction: f64) -> Self {
        let [forward, left, turn] = self.to_twist();
        Self::from_twist(forward * fraction, left * fraction, turn * fraction)
    }

    /// As an array (x, y, heading).
    pub fn to_array(self) -> [f64; 3] {
        [self.x, self.y, self.heading]
    }

    /// Whether all three numbers are finite.
    pub fn is_finite(self) -> bool {
        self.x.is_finite() && self.y.is_finite() && self.heading.is_finite()
    }
}

impl From<[f64; 3]> for Pose {
    fn from([x, y, heading]: [f64; 3]) -> Self {
        Self { x, y, heading }
    }
}

/// A symmetric 2×2 matrix.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Symmetric2<R = f64> {
    /// Element (0, 0).
    pub xx: R,
    /// Elements (0, 1) and (1, 0).
    pub xy: R,
    /// Element (1, 1).
    pub yy: R,
}

impl<R: Real> Symmetric2<R> {
    /// From its three distinct elements.
    #[inline(always)]
    pub fn new(xx: R, xy: R, yy: R) -> Self {
        Self { xx, xy, yy }
    }

    /// Determinant.
    #[inline(always)]
    pub fn determinant(self) -> R {
        self.xx * self.yy - self.xy * self.xy
    }

    /// This matrix times a number.
    #[inline(always)]
    pub fn scaled(self, factor: R) -> Self {
        Self { xx: self.xx * factor, xy: self.xy * factor, yy: self.yy * factor }
    }

    /// J S Jᵀ for a 2×2 matrix J in row order.
    #[inline(always)]
    pub fn transformed(self, j: [[R; 2]; 2]) -> Self {
        let [[a, b], [c, d]] = j;
        let (ax, ay) = (a * self.xx + b * self.xy, a * self.xy + b * self.yy);
        let (cx, cy) = (c * self.xx + d * self.xy, c * self.xy + d * self.yy);
        Self { xx: ax * a + ay * b, xy: ax * c + ay * d, yy: cx * c + cy * d }
    }
}

impl Symmetric2 {
    /// Whether it is finite and positive definite.
    pub fn is_positive_definite(self) -> bool {
        self.xx > 0.0 && self.determinant() > 0.0 && self.yy.is_finite() && self.xx.is_finite()
    }

    /// The larger eigenvalue.
    pub fn largest_eigenvalue(self) -> f64 {
        let mean = 0.5 * (self.xx + self.yy);
        let half_difference = 0.5 * (self.xx - self.yy);
        mean + (half_difference * half_difference + self.xy * self.xy).sqrt()
    }
}

/// A symmetric 3×3 matrix over (x, y, heading), in row order.
pub type Matrix3 = [[f64; 3]; 3];

/// A B.
#[inline(always)]
pub fn multiply3(a: &Matrix3, b: &Matrix3) -> Matrix3 {
    std::array::from_fn(|i| std::array::from_fn(|j| (0..3).map(|k| a[i][k] * b[k][j]).sum()))
}

/// The pose after a motion, and its derivative by the pose.
pub fn moved_by(pose: Pose, motion: Pose) -> (Pose, Matrix3) {
    let moved = pose.compose(motion);
    let by_pose = [[1.0, 0.0, pose.y - moved.y], [0.0, 1.0, moved.x - pose.x], [0.0, 0.0, 1.0]];
    (moved, by_pose)
}

/// J S Jᵀ.
#[inline(always)]
pub fn transform3(j: &Matrix3, s: &Matrix3) -> Matrix3 {
    let js = multiply3(j, s);
    std::array::from_fn(|i| std::array::from_fn(|k| (0..3).map(|l| js[i][l] * j[k][l]).sum()))
}

/// Whether it is finite and symmetric and has no negative direction, to rounding.
pub fn is_covariance3(c: &Matrix3) -> bool {
    // All minors; rounding is in proportion to the entries.
    let minor = |i: usize, j: usize| c[i][i] * c[j][j] - c[i][j] * c[i][j] >= -1e-12 * c[i][i] * c[j][j];
    let determinant = c[0][0] * (c[1][1] * c[2][2] - c[1][2] * c[1][2])
        - c[0][1] * (c[0][1] * c[2][2] - c[1][2] * c[0][2])
        + c[0][2] * (c[0][1] * c[1][2] - c[1][1] * c[0][2]);
    c.iter().flatten().all(|v| v.is_finite())
        && (0..3).all(|i| c[i][i] >= 0.0 && (0..i).all(|j| c[i][j] == c[j][i]))
        && minor(0, 1)
        && minor(0, 2)
        && minor(1, 2)
        && determinant >= -1e-12 * c[0][0] * c[1][1] * c[2][2]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::f64::consts::PI;

    fn close(a: Pose, b: Pose) -> bool {
        (a.x - b.x).abs() < 1e-9 && (a.y - b.y).abs() < 1e-9 && (a.heading - b.heading).wrap_angle().abs() < 1e-9
    }

    fn any_pose() -> impl Strategy<Value = Pose> {
        let heading = prop_oneof![Just(0.0), -1e-8..1e-8, -3.2..3.2, PI - 1e-7..PI, -PI..-PI + 1e-7];
        (-50.0..50.0, -50.0..50.0, heading).prop_map(|(x, y, h)| Pose::new(x, y, h))
    }

    proptest! {
        #[test]
        fn a_pose_times_its_inverse_is_the_identity(pose in any_pose()) {
            prop_assert!(close(pose.compose(pose.inverse()), Pose::default()));
        }

        #[test]
        fn composition_is_associative_and_acts_on_points(a in any_pose(), b in any_pose(), c in any_pose()) {
            prop_assert!(close(a.compose(b).compose(c), a.compose(b.compose(c))));
            let point = [0.3, -1.7];
            let [x, y] = a.compose(b).transform(point);
            let [u, v] = a.transform(b.transform(point));
            prop_assert!((x - u).abs() < 1e-9 && (y - v).abs() < 1e-9);
        }

        #[test]
        fn the_twist_of_an_arc_gives_it_back(f in -5.0..5.0_f64, l in -1.0..1.0_f64, t in -3.0..3.0_f64) {
            let [forward, left, turn] = Pose::from_twist(f, l, t).to_twist();
            prop_assert!((forward - f).abs() < 1e-9 && (left - l).abs() < 1e-9 && turn == t);
        }

        #[test]
        fn two_parts_of_an_arc_make_the_whole(f in -5.0..5.0_f64, l in -1.0..1.0_f64, t in -3.0..3.0_f64, part in 0.0..1.0_f64) {
            let whole = Pose::from_twist(f, l, t);
            prop_assert!(close(whole.fraction(part).compose(whole.fraction(1.0 - part)), whole));
        }
    }

    #[test]
    fn a_quarter_circle_ends_where_it_should() {
        let quarter = std::f64::consts::FRAC_PI_2;
        let arc = Pose::from_twist(2.0 * quarter, 0.0, quarter);
        assert!(close(arc, Pose::new(2.0, 2.0, quarter)), "{arc:?}");
    }

    #[test]
    fn eigenvalue_and_congruence_of_a_known_matrix() {
        let s = Symmetric2::new(2.0, 1.0, 2.0);
        assert!((s.largest_eigenvalue() - 3.0).abs() < 1e-15);
        assert_eq!(s.transformed([[1.0, 2.0], [0.0, 3.0]]), Symmetric2::new(14.0, 15.0, 18.0));
        assert!(!Symmetric2::new(1.0, 2.0, 1.0).is_positive_definite());
    }
}
