//! Several particles side by side in one number, which a processor with vector units works on at once.

use crate::math;
use crate::real::Real;
use serde::{Deserialize, Serialize};
use std::ops::{Add, Div, Mul, Neg, Sub};

/// Particles that a pass works on side by side.
pub const LANES: usize = 8;

/// One number of [`LANES`] particles.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Wide(pub [f64; LANES]);

impl Wide {
    #[inline(always)]
    fn map(self, f: impl Fn(f64) -> f64) -> Self {
        let mut out = self;
        for lane in 0..LANES {
            out.0[lane] = f(self.0[lane]);
        }
        out
    }

    #[inline(always)]
    fn zip(self, other: Self, f: impl Fn(f64, f64) -> f64) -> Self {
        let mut out = self;
        for lane in 0..LANES {
            out.0[lane] = f(self.0[lane], other.0[lane]);
        }
        out
    }

    /// Natural logarithm.
    #[inline(always)]
    pub fn ln(self) -> Self {
        self.map(math::ln)
    }
}

impl Add for Wide {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        self.zip(other, |a, b| a + b)
    }
}

impl Sub for Wide {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        self.zip(other, |a, b| a - b)
    }
}

impl Mul for Wide {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        self.zip(other, |a, b| a * b)
    }
}

impl Div for Wide {
    type Output = Self;
    #[inline(always)]
    fn div(self, other: Self) -> Self {
        self.zip(other, |a, b| a / b)
    }
}

impl Neg for Wide {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        self.map(|a| -a)
    }
}

impl Real for Wide {
    #[inline(always)]
    fn constant(value: f64) -> Self {
        Self([value; LANES])
    }
    /// There is no one value: nothing branches on it.
    #[inline(always)]
    fn value(self) -> f64 {
        f64::NAN
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        self.map(f64::sqrt)
    }
    #[inline(always)]
    fn sin_cos(self) -> (Self, Self) {
        (self.map(|a| math::sin_cos(a).0), self.map(|a| math::sin_cos(a).1))
    }
    #[inline(always)]
    fn atan2(y: Self, x: Self) -> Self {
        y.zip(x, math::atan2)
    }
    #[inline(always)]
    fn sinc(self) -> Self {
        self.map(Real::sinc)
    }
    #[inline(always)]
    fn wrap_angle(self) -> Self {
        self.map(math::wrap_angle)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_lane_is_the_number_alone() {
        let a = Wide(std::array::from_fn(|i| 0.37 * i as f64 - 1.1));
        let b = Wide(std::array::from_fn(|i| 2.5 - 0.21 * i as f64));
        for lane in 0..LANES {
            let (x, y) = (a.0[lane], b.0[lane]);
            let pairs = [
                ((a + b).0[lane], x + y),
                ((a - b).0[lane], x - y),
                ((a * b).0[lane], x * y),
                ((a / b).0[lane], x / y),
                ((-a).0[lane], -x),
                (b.sqrt().0[lane], Real::sqrt(y)),
                (b.ln().0[lane], math::ln(y)),
                (a.sin_cos().0 .0[lane], math::sin_cos(x).0),
                (a.sin_cos().1 .0[lane], math::sin_cos(x).1),
                (Wide::atan2(a, b).0[lane], math::atan2(x, y)),
                (a.sinc().0[lane], Real::sinc(x)),
                ((a * Wide::constant(9.0)).wrap_angle().0[lane], math::wrap_angle(9.0 * x)),
            ];
            for (wide, single) in pairs {
                assert_eq!(wide.to_bits(), single.to_bits());
            }
        }
    }
}
