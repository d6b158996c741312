//! Rotations and rigid transforms of space.

use super::matrix::{cross, dot, multiply, Rows};
use crate::math;
use crate::real::Real;
use serde::{Deserialize, Serialize};

/// A rotation as a unit quaternion: takes coordinates in frame b to coordinates in frame a.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Rotation<R = f64> {
    /// Cosine of half the angle.
    pub w: R,
    /// Axis times the sine of half the angle.
    pub v: [R; 3],
}

impl Default for Rotation {
    fn default() -> Self {
        Self { w: 1.0, v: [0.0; 3] }
    }
}

impl<R: Real> Rotation<R> {
    /// `R_a_b * R_b_c = R_a_c`.
    #[inline(always)]
    pub fn compose(self, other: Self) -> Self {
        let (p, q) = (self.v, other.v);
        let turn = cross(p, q);
        let mut v = turn;
        for i in 0..3 {
            v[i] = self.w * q[i] + other.w * p[i] + turn[i];
        }
        Self { w: self.w * other.w - dot(&p, &q), v }
    }

    /// `R_b_a`.
    #[inline(always)]
    pub fn inverse(self) -> Self {
        Self { w: self.w, v: [-self.v[0], -self.v[1], -self.v[2]] }
    }

    /// Of unit length again, after roundings.
    #[inline(always)]
    pub fn normalized(self) -> Self {
        let scale = R::constant(1.0) / (self.w * self.w + dot(&self.v, &self.v)).sqrt();
        Self { w: self.w * scale, v: [self.v[0] * scale, self.v[1] * scale, self.v[2] * scale] }
    }

    /// As a matrix in row order.
    #[inline(always)]
    pub fn matrix(self) -> Rows<R, 3, 3> {
        let Self { w, v: [x, y, z] } = self;
        let two = R::constant(2.0);
        let one = R::constant(1.0);
        [
            [one - two * (y * y + z * z), two * (x * y - w * z), two * (x * z + w * y)],
            [two * (x * y + w * z), one - two * (x * x + z * z), two * (y * z - w * x)],
            [two * (x * z - w * y), two * (y * z + w * x), one - two * (x * x + y * y)],
        ]
    }

    /// Coordinates in a of a vector given in b: v + 2 u × (u × v + w v).
    #[inline(always)]
    pub fn turn(self, vector: [R; 3]) -> [R; 3] {
        let mut inner = cross(self.v, vector);
        for i in 0..3 {
            inner[i] = inner[i] + self.w * vector[i];
        }
        let outer = cross(self.v, inner);
        let two = R::constant(2.0);
        [vector[0] + two * outer[0], vector[1] + two * outer[1], vector[2] + two * outer[2]]
    }

    /// The rotation about an axis by an angle: their product, radians.
    #[inline(always)]
    pub fn from_vector(vector: [R; 3]) -> Self {
        let half = R::constant(0.5) * length(vector);
        let scale = R::constant(0.5) * half.sinc();
        let w = half.sin_cos().1;
        Self { w, v: [vector[0] * scale, vector[1] * scale, vector[2] * scale] }
    }
}

/// The length of a vector, never quite zero, so that it has a derivative.
#[inline(always)]
fn length<R: Real>(vector: [R; 3]) -> R {
    (dot(&vector, &vector) + R::constant(1e-300)).sqrt()
}

impl Rotation {
    /// Axis times angle, the angle in [0, π]: the inverse of [`Rotation::from_vector`].
    pub fn to_vector(self) -> [f64; 3] {
        let sine = length(self.v);
        let sign = if self.w < 0.0 { -1.0 } else { 1.0 };
        let scale = sign * 2.0 * math::atan2(sine, self.w.abs()) / sine;
        let scale = if sine < 1e-100 { 2.0 * sign } else { scale };
        self.v.map(|v| v * scale)
    }
}

/// A rigid transform of space, `T_a_b`: takes coordinates in frame b to coordinates in frame a.
///
/// **Frame and units:** metres. Perturbations are on the right, `T_a_b Exp(ξ)`, with ξ = (shift in m, turn in rad) in the
/// axes of b.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SpacePose<R = f64> {
    /// Turns coordinates.
    pub rotation: Rotation<R>,
    /// Of the origin of b in a, metres.
    pub position: [R; 3],
}

impl Default for SpacePose {
    fn default() -> Self {
        Self { rotation: Rotation::default(), position: [0.0; 3] }
    }
}

/// Shift and turn.
pub type Twist<R = f64> = [R; 6];

impl<R: Real> SpacePose<R> {
    /// `T_a_b * T_b_c = T_a_c`.
    #[inline(always)]
    pub fn compose(self, other: Self) -> Self {
        let position = self.transform(other.position);
        Self { rotation: self.rotation.compose(other.rotation).normalized(), position }
    }

    /// `T_b_a`.
    #[inline(always)]
    pub fn inverse(self) -> Self {
        let rotation = self.rotation.inverse();
        let [x, y, z] = rotation.turn(self.position);
        Self { rotation, position: [-x, -y, -z] }
    }

    /// Coordinates in a of a point given in b.
    #[inline(always)]
    pub fn transform(self, point: [R; 3]) -> [R; 3] {
        let turned = self.rotation.turn(point);
        [self.position[0] + turned[0], self.position[1] + turned[1], self.position[2] + turned[2]]
    }

    /// The transform that a constant body velocity reaches: (shift, turn) integrated over its time.
    #[inline(always)]
    pub fn exp(twist: Twist<R>) -> Self {
        let [x, y, z, a, b, c] = twist;
        let (shift, turn) = ([x, y, z], [a, b, c]);
        let angle = length(turn);
        let half = (R::constant(0.5) * angle).sinc();
        let first = R::constant(0.5) * half * half;
        // Rounding of the difference is as small as what it is multiplied with.
        let second = (R::constant(1.0) - angle.sinc()) / (angle * angle);
        let once = cross(turn, shift);
        let twice = cross(turn, once);
        let mut position = shift;
        for i in 0..3 {
            position[i] = shift[i] + first * once[i] + second * twice[i];
        }
        Self { rotation: Rotation::from_vector(turn), position }
    }
}

impl SpacePose {
    /// The same in all particles.
    #[inline(always)]
    pub fn constant<R: Real>(self) -> SpacePose<R> {
        let [x, y, z] = self.position;
        let [a, b, c] = self.rotation.v;
        let number = R::constant;
        let rotation = Rotation { w: number(self.rotation.w), v: [number(a), number(b), number(c)] };
        SpacePose { rotation, position: [number(x), number(y), number(z)] }
    }

    /// The twist whose exponential this is: the inverse of [`SpacePose::exp`] for turns below π.
    pub fn log(self) -> Twist {
        let turn = self.rotation.to_vector();
        let angle = length(turn);
        let half = 0.5 * angle;
        let (s, c) = math::sin_cos(half);
        let second = if half < 1e-3 { 1.0 / 12.0 } else { (1.0 - half * c / s) / (angle * angle) };
        let once = cross(turn, self.position);
        let twice = cross(turn, once);
        let shift: [f64; 3] = std::array::from_fn(|i| self.position[i] - 0.5 * once[i] + second * twice[i]);
        [shift[0], shift[1], shift[2], turn[0], turn[1], turn[2]]
    }

    /// Ad(T): T Exp(ξ) = Exp(Ad(T) ξ) T.
    pub fn adjoint(self) -> Rows<f64, 6, 6> {
        let turn = self.rotation.matrix();
        twice(&turn, &multiply(&skew(self.position), &turn))
    }

    /// Whether all its numbers are finite.
    pub fn is_finite(self) -> bool {
        self.position.iter().chain(&self.rotation.v).all(|v| v.is_finite()) && self.rotation.w.is_finite()
    }

    /// As x, y, z in metres and the quaternion w, x, y, z.
    pub fn to_array(self) -> [f64; 7] {
        let ([x, y, z], Rotation { w, v: [a, b, c] }) = (self.position, self.rotation);
        [x, y, z, w, a, b, c]
    }
}

/// `[v]×`: the matrix of the cross product with v.
pub fn skew([x, y, z]: [f64; 3]) -> Rows<f64, 3, 3> {
    [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]
}

/// ad(ξ): the derivative of Ad(Exp(ξ)) at zero.
pub fn small_adjoint(twist: &Twist) -> Rows<f64, 6, 6> {
    let [x, y, z, a, b, c] = *twist;
    twice(&skew([a, b, c]), &skew([x, y, z]))
}

/// The matrix that turns both parts of a twist, and takes something of the second to the first.
fn twice(turn: &Rows<f64, 3, 3>, across: &Rows<f64, 3, 3>) -> Rows<f64, 6, 6> {
    let mut out = [[0.0; 6]; 6];
    for i in 0..3 {
        for j in 0..3 {
            out[i][j] = turn[i][j];
            out[i][3 + j] = across[i][j];
            out[3 + i][3 + j] = turn[i][j];
        }
    }
    out
}

/// I + a ad(ξ) + b ad(ξ)²: the right Jacobian of Exp with (−1/2, 1/6), its inverse with (1/2, 1/12), to third order.
pub fn series(twist: &Twist, first: f64, second: f64) -> Rows<f64, 6, 6> {
    let ad = small_adjoint(twist);
    let square = multiply(&ad, &ad);
    std::array::from_fn(|i| {
        std::array::from_fn(|j| f64::from(u8::from(i == j)) + first * ad[i][j] + second * square[i][j])
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::space::matrix::apply;
    use proptest::prelude::*;

    fn close(a: SpacePose, b: SpacePose) -> bool {
        a.inverse().compose(b).log().iter().all(|v| v.abs() < 1e-9)
    }

    fn any_twist() -> impl Strategy<Value = Twist> {
        let turn = || prop_oneof![Just(0.0), -1e-8..1e-8, -1.7..1.7];
        (-5.0..5.0, -5.0..5.0, -5.0..5.0, turn(), turn(), turn()).prop_map(|(x, y, z, a, b, c)| [x, y, z, a, b, c])
    }

    proptest! {
        #[test]
        fn a_pose_times_its_inverse_is_the_identity(twist in any_twist()) {
            let pose = SpacePose::exp(twist);
            prop_assert!(close(pose.compose(pose.inverse()), SpacePose::default()));
        }

        #[test]
        fn composition_is_associative_and_acts_on_points(a in any_twist(), b in any_twist(), c in any_twist()) {
            let (a, b, c) = (SpacePose::exp(a), SpacePose::exp(b), SpacePose::exp(c));
            prop_assert!(close(a.compose(b).compose(c), a.compose(b.compose(c))));
            let point = [0.3, -1.7, 2.2];
            let (p, q) = (a.compose(b).transform(point), a.transform(b.transform(point)));
            prop_assert!((0..3).all(|i| (p[i] - q[i]).abs() < 1e-9));
            let rows = a.rotation.matrix();
            let (p, q) = (apply(&rows, &point), a.rotation.turn(point));
            prop_assert!((0..3).all(|i| (p[i] - q[i]).abs() < 1e-12));
        }

        #[test]
        fn the_twist_of_a_pose_gives_it_back(twist in any_twist()) {
            let back = SpacePose::exp(twist).log();
            prop_assert!((0..6).all(|i| (back[i] - twist[i]).abs() < 1e-8), "{twist:?} {back:?}");
        }

        #[test]
        fn the_adjoint_moves_a_perturbation_to_the_left(pose in any_twist(), twist in any_twist()) {
            let pose = SpacePose::exp(pose);
            let moved = apply(&pose.adjoint(), &twist);
            prop_assert!(close(pose.compose(SpacePose::exp(twist)), SpacePose::exp(moved).compose(pose)));
        }

        #[test]
        fn the_right_jacobian_is_a_derivative_and_its_inverse_undoes_it(twist in any_twist()) {
            let small = twist.map(|v| 0.05 * v);
            let (forth, back) = (series(&small, -0.5, 1.0 / 6.0), series(&small, 0.5, 1.0 / 12.0));
            // |ad| is below 0.5 here, and what is left out a 24th of its cube.
            let bound = 6e-3;
            let product = multiply(&forth, &back);
            let step = 1e-6;
            for k in 0..6 {
                let nudge: Twist = std::array::from_fn(|i| if i == k { step } else { 0.0 });
                let nudged: Twist = std::array::from_fn(|i| small[i] + nudge[i]);
                let moved = SpacePose::exp(small).inverse().compose(SpacePose::exp(nudged)).log();
                for i in 0..6 {
                    prop_assert!((moved[i] / step - forth[i][k]).abs() < bound);
                    prop_assert!((product[i][k] - f64::from(u8::from(i == k))).abs() < bound);
                }
            }
        }
    }

    #[test]
    fn a_quarter_turn_about_the_vertical_ends_where_it_should() {
        let quarter = std::f64::consts::FRAC_PI_2;
        let arc = SpacePose::exp([2.0 * quarter, 0.0, 0.3, 0.0, 0.0, quarter]);
        let expected = [2.0, 2.0, 0.3];
        assert!((0..3).all(|i| (arc.position[i] - expected[i]).abs() < 1e-12), "{arc:?}");
        let north = arc.rotation.turn([1.0, 0.0, 0.0]);
        assert!(north[0].abs() < 1e-12 && (north[1] - 1.0).abs() < 1e-12);
    }
}
