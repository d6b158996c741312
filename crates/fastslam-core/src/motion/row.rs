//! A row of odometry as a constant twist with a diffusion, and any part of it.

use super::gaussian::MotionGaussian;
use crate::geometry::{Matrix3, Pose};
use crate::math;
use crate::real::Real;

/// Most noises of a model that a log may tell apart.
pub const CONTROL_NOISES: usize = 3;

/// What a whole row says: the robot moves with a constant twist, and meanwhile noise diffuses in the robot's frame.
///
/// **Why:** only a diffusion can be cut: what its parts add is what the whole adds, wherever the row is cut.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RowMotion {
    /// Motion forward and left in metres and turn in radians, over the row.
    pub twist: [f64; 3],
    /// Covariances of (forward, left, turn) that gather over the row, in the frame of the robot on its way: one per
    /// entry of [`super::Motion::noises`]. Only their sum need be one.
    pub by_noise: [Matrix3; CONTROL_NOISES],
    /// That of the rest: noise in proportion to the motion, or all of it where the log states a row's covariance.
    pub rest: Matrix3,
}

impl RowMotion {
    /// A row whose noises gather these covariances.
    pub fn new(twist: [f64; 3], by_noise: [Matrix3; CONTROL_NOISES]) -> Self {
        Self { twist, by_noise, rest: Matrix3::default() }
    }

    /// A row whose end has the sum of the covariances `stated` of (x, y, heading) in the frame of its start.
    ///
    /// No diffusion is narrower aside than the heading's share of it: over a straight row of length L with heading
    /// deviation σ that is L σ / √12. Where less is stated, position gets the least that makes it a diffusion, which
    /// counts as of the noise `widening`. Where a row turns by more than a right angle, the turn blurs what differs
    /// between ahead and aside.
    pub fn reaching(twist: [f64; 3], stated: [Matrix3; CONTROL_NOISES], widening: usize) -> Self {
        let arc = Arc::new(twist);
        let mut by_noise: [Matrix3; CONTROL_NOISES] = stated.map(|noise| arc.diffusion_of(&noise).into());
        let told = sum(&by_noise);
        let needed = Matrix3::from(Moments::from(&told).definite());
        let wider = &mut by_noise[widening];
        (0..3).for_each(|i| (0..3).for_each(|j| wider[i][j] += needed[i][j] - told[i][j]));
        Self::new(twist, by_noise)
    }

    /// A row whose end has the covariance `stated`, which no noise of a model explains; widened as in
    /// [`Self::reaching`].
    pub fn stating(twist: [f64; 3], stated: &Matrix3) -> Self {
        let rest = Arc::new(twist).diffusion_of(stated).definite().into();
        Self { twist, by_noise: Default::default(), rest }
    }

    /// The same row with noise in proportion to it: variances (forward, left, turn) as gathered over the row.
    pub fn adding(mut self, variances: [f64; 3]) -> Self {
        (0..3).for_each(|i| self.rest[i][i] += variances[i]);
        self
    }

    /// Covariance of (forward, left, turn) that gathers over the row, in the frame of the robot on its way.
    pub fn diffusion(&self) -> Matrix3 {
        let [a, b] = [sum(&self.by_noise), self.rest];
        std::array::from_fn(|i| std::array::from_fn(|j| a[i][j] + b[i][j]))
    }

    /// The motion of a share of the row. Parts composed with [`MotionGaussian::then`] make the whole.
    ///
    /// **Source:** the covariance is the integral of A C Aᵀ over the part, with A what a small motion on the way does
    /// to the end; see `docs/equations.md`.
    pub fn part(&self, share: f64) -> MotionGaussian {
        self.on(&self.arc(share), share)
    }

    /// The motion of a share of the row, and the covariances that each noise adds to it.
    pub(super) fn part_with_noises(&self, share: f64) -> (MotionGaussian, [Matrix3; CONTROL_NOISES]) {
        let arc = self.arc(share);
        (self.on(&arc, share), self.by_noise.map(|noise| arc.covariance_of(&noise, share)))
    }

    fn arc(&self, share: f64) -> Arc {
        Arc::new(self.twist.map(|v| v * share))
    }

    fn on(&self, arc: &Arc, share: f64) -> MotionGaussian {
        let [forward, left, turn] = self.twist.map(|v| v * share);
        let covariance = arc.covariance_of(&self.diffusion(), share);
        MotionGaussian { mean: Pose::from_twist(forward, left, turn), covariance }
    }
}

fn sum(noises: &[Matrix3; CONTROL_NOISES]) -> Matrix3 {
    std::array::from_fn(|i| std::array::from_fn(|j| noises[0][i][j] + noises[1][i][j] + noises[2][i][j]))
}

/// Least factor by which a turn may be said to have blurred the direction of a row's noise: that of a right angle.
pub(super) const LEAST_BLUR: f64 = std::f64::consts::FRAC_2_PI;

/// Integrals along an arc, seen from its middle; vectors of the plane are complex numbers.
///
/// With z the place at time t in [-1/2, 1/2] and θ the turn: s1 = ∫ e^{iθt}, s2 = ∫ e^{2iθt}, i u way = ∫ z,
/// i v way = ∫ e^{iθt} z, q |way|² = ∫ |z|², r way² = ∫ z².
struct Arc {
    /// Forward and left, as if it were straight.
    way: [f64; 2],
    /// Direction of the end, cosine and sine.
    half: [f64; 2],
    /// Place of the end.
    end: [f64; 2],
    s1: f64,
    s2: f64,
    u: f64,
    v: f64,
    q: f64,
    r: f64,
}

impl Arc {
    fn new([forward, left, turn]: [f64; 3]) -> Self {
        let (k1, k2) = (missing_of_sinc(0.5 * turn), missing_of_sinc(turn));
        let (sine, cosine) = math::sin_cos(0.5 * turn);
        let end = Pose::from_twist(0.5 * forward, 0.5 * left, 0.5 * turn);
        Self {
            way: [forward, left],
            half: [cosine, sine],
            end: [end.x, end.y],
            s1: (0.5 * turn).sinc(),
            s2: turn.sinc(),
            u: 0.25 * turn * k1,
            v: turn * (k2 - 0.25 * k1),
            q: 0.5 * k1,
            r: k2 - 0.5 * k1,
        }
    }

    /// Covariance of the end in the axes of the start, for the share of a row that this arc is.
    fn covariance_of(&self, diffusion: &Matrix3, share: f64) -> Matrix3 {
        let noise = Moments::from(&diffusion.map(|row| row.map(|v| v * share)));
        let (way, heading) = (self.way, noise.heading);
        let (bend, swing) = (times(way, noise.cross), times(way, way));
        let middle = Moments {
            heading,
            cross: [0, 1].map(|i| self.s1 * noise.cross[i] + self.u * way[i] * heading),
            trace: noise.trace - 2.0 * self.u * dot(noise.cross, way) + self.q * dot(way, way) * heading,
            twice: [0, 1].map(|i| self.s2 * noise.twice[i] + 2.0 * self.v * bend[i] - self.r * swing[i] * heading),
        };
        middle.moved(self.end).rotated(self.half).into()
    }

    /// The inverse of [`Self::covariance_of`] for a whole row, but for the blur of wide turns.
    fn diffusion_of(&self, stated: &Matrix3) -> Moments {
        let middle = Moments::from(stated).rotated([self.half[0], -self.half[1]]).moved(self.end.map(|v| -v));
        let (way, heading) = (self.way, middle.heading);
        let cross = [0, 1].map(|i| (middle.cross[i] - self.u * way[i] * heading) / self.s1);
        let trace = middle.trace + 2.0 * self.u * dot(cross, way) - self.q * dot(way, way) * heading;
        let (bend, swing) = (times(way, cross), times(way, way));
        let twice = [0, 1].map(|i| {
            let unblurred = middle.twice[i] - 2.0 * self.v * bend[i] + self.r * swing[i] * heading;
            unblurred / self.s2.max(LEAST_BLUR)
        });
        Moments { heading, cross, trace, twice }
    }
}

/// (1 − sin(x)/x) / x², continued by 1/6 at zero.
fn missing_of_sinc(x: f64) -> f64 {
    let square = x * x;
    if square >= 1.0 {
        return (1.0 - x.sinc()) / square;
    }
    // 1/3! − x²/5! + x⁴/7! … to x¹⁴/17!: what is left out is below 1e-17.
    let (mut sum, mut number) = (0.0, 17.0);
    while number > 2.0 {
        sum = (1.0 - square * sum) / (number * (number - 1.0));
        number -= 2.0;
    }
    sum
}

/// Second moments of an error with a place d and a heading n, in complex numbers.
#[derive(Clone, Copy)]
struct Moments {
    /// E n².
    heading: f64,
    /// E d n.
    cross: [f64; 2],
    /// E |d|².
    trace: f64,
    /// E d².
    twice: [f64; 2],
}

impl From<&Matrix3> for Moments {
    fn from([[xx, xy, xh], [_, yy, yh], [_, _, hh]]: &Matrix3) -> Self {
        Self { heading: *hh, cross: [*xh, *yh], trace: xx + yy, twice: [xx - yy, 2.0 * xy] }
    }
}

impl From<Moments> for Matrix3 {
    fn from(Moments { heading, cross: [xh, yh], trace, twice }: Moments) -> Self {
        let (xx, yy, xy) = (0.5 * (trace + twice[0]), 0.5 * (trace - twice[0]), 0.5 * twice[1]);
        [[xx, xy, xh], [xy, yy, yh], [xh, yh, heading]]
    }
}

impl Moments {
    /// Of the error that this one makes at `place`: d + i place n.
    fn moved(self, place: [f64; 2]) -> Self {
        let swing = [-place[1], place[0]];
        let (bend, twice) = (times(swing, self.cross), times(swing, swing));
        Self {
            heading: self.heading,
            cross: [0, 1].map(|i| self.cross[i] + swing[i] * self.heading),
            trace: self.trace + 2.0 * dot(self.cross, swing) + dot(swing, swing) * self.heading,
            twice: [0, 1].map(|i| self.twice[i] + 2.0 * bend[i] + twice[i] * self.heading),
        }
    }

    /// In axes turned back by `direction`, a number of size 1.
    fn rotated(self, direction: [f64; 2]) -> Self {
        let cross = times(direction, self.cross);
        Self { cross, twice: times(times(direction, direction), self.twice), ..self }
    }

    /// The least more of noise in place that makes a covariance of it.
    fn definite(self) -> Self {
        let Self { heading, cross, trace, twice } = self;
        if heading <= 0.0 {
            return Self { heading: 0.0, cross: [0.0; 2], ..self }.with_definite_place([0.0, 0.0, 0.0]);
        }
        let by_heading = times(cross, cross).map(|v| v / heading);
        let explained = [dot(cross, cross) / heading, by_heading[0], by_heading[1]];
        Self { heading, cross, trace, twice }.with_definite_place(explained)
    }

    /// What of the place the heading does not explain (trace and twice of which are given) made definite.
    fn with_definite_place(self, explained: [f64; 3]) -> Self {
        let own = [self.twice[0] - explained[1], self.twice[1] - explained[2]];
        let (trace, size) = (self.trace - explained[0], dot(own, own).sqrt());
        if size <= trace {
            return self;
        }
        // The eigenvalues are half of trace ± size: the smaller becomes 0.
        let largest = (0.5 * (trace + size)).max(0.0);
        let shrunk = if size > 0.0 { largest / size } else { 0.0 };
        let twice = [0, 1].map(|i| explained[i + 1] + own[i] * shrunk);
        Self { trace: explained[0] + largest, twice, ..self }
    }
}

fn times(a: [f64; 2], b: [f64; 2]) -> [f64; 2] {
    [a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0]]
}

/// Real part of a times the conjugate of b.
fn dot(a: [f64; 2], b: [f64; 2]) -> f64 {
    a[0] * b[0] + a[1] * b[1]
}
