//! The number that models are written in: plain doubles, or doubles that carry derivatives.

use crate::math;
use std::ops::{Add, Div, Mul, Neg, Sub};

/// A real number. A model written over it runs at full speed with `f64` and gives its Jacobian with [`Dual`].
pub trait Real:
    Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Div<Output = Self> + Neg<Output = Self>
{
    /// A constant.
    fn constant(value: f64) -> Self;
    /// The value without derivatives.
    fn value(self) -> f64;
    /// Square root.
    fn sqrt(self) -> Self;
    /// Sine and cosine.
    fn sin_cos(self) -> (Self, Self);
    /// Angle of the vector (x, y).
    fn atan2(y: Self, x: Self) -> Self;
    /// sin(x) / x, continued by 1 at zero.
    fn sinc(self) -> Self;
    /// The same angle in [−π, π]; the derivative is that of the angle.
    fn wrap_angle(self) -> Self;
}

impl Real for f64 {
    #[inline(always)]
    fn constant(value: f64) -> Self {
        value
    }
    #[inline(always)]
    fn value(self) -> f64 {
        self
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        f64::sqrt(self)
    }
    #[inline(always)]
    fn sin_cos(self) -> (Self, Self) {
        math::sin_cos(self)
    }
    #[inline(always)]
    fn atan2(y: Self, x: Self) -> Self {
        math::atan2(y, x)
    }
    #[inline(always)]
    fn sinc(self) -> Self {
        let small = self.abs() < 1e-3;
        let series = 1.0 - self * self * (1.0 / 6.0) * (1.0 - self * self * 0.05);
        let quotient = math::sin_cos(self).0 / if small { 1.0 } else { self };
        if small {
            series
        } else {
            quotient
        }
    }
    #[inline(always)]
    fn wrap_angle(self) -> Self {
        math::wrap_angle(self)
    }
}

/// A value with its derivatives by `N` variables (forward mode).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dual<const N: usize> {
    /// The value.
    pub value: f64,
    /// Derivative by each variable.
    pub gradient: [f64; N],
}

impl<const N: usize> Dual<N> {
    /// Variable number `index` with the given value.
    pub fn variable(value: f64, index: usize) -> Self {
        let mut gradient = [0.0; N];
        gradient[index] = 1.0;
        Self { value, gradient }
    }

    /// f(value) with chain rule: `slope` is f'(value).
    fn chain(self, value: f64, slope: f64) -> Self {
        Self { value, gradient: self.gradient.map(|g| g * slope) }
    }
}

impl<const N: usize> Add for Dual<N> {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self {
            value: self.value + other.value,
            gradient: std::array::from_fn(|i| self.gradient[i] + other.gradient[i]),
        }
    }
}

impl<const N: usize> Sub for Dual<N> {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        self + -other
    }
}

// The product and quotient rules mix operators by nature.
#[allow(clippy::suspicious_arithmetic_impl)]
impl<const N: usize> Mul for Dual<N> {
    type Output = Self;
    fn mul(self, other: Self) -> Self {
        Self {
            value: self.value * other.value,
            gradient: std::array::from_fn(|i| self.gradient[i] * other.value + self.value * other.gradient[i]),
        }
    }
}

#[allow(clippy::suspicious_arithmetic_impl)]
impl<const N: usize> Div for Dual<N> {
    type Output = Self;
    fn div(self, other: Self) -> Self {
        let value = self.value / other.value;
        Self { value, gradient: std::array::from_fn(|i| (self.gradient[i] - value * other.gradient[i]) / other.value) }
    }
}

impl<const N: usize> Neg for Dual<N> {
    type Output = Self;
    fn neg(self) -> Self {
        self.chain(-self.value, -1.0)
    }
}

impl<const N: usize> Real for Dual<N> {
    fn constant(value: f64) -> Self {
        Self { value, gradient: [0.0; N] }
    }
    fn value(self) -> f64 {
        self.value
    }
    fn sqrt(self) -> Self {
        let root = self.value.sqrt();
        self.chain(root, 0.5 / root)
    }
    fn sin_cos(self) -> (Self, Self) {
        let (s, c) = math::sin_cos(self.value);
        (self.chain(s, c), self.chain(c, -s))
    }
    fn atan2(y: Self, x: Self) -> Self {
        let q = x.value * x.value + y.value * y.value;
        Self {
            value: math::atan2(y.value, x.value),
            gradient: std::array::from_fn(|i| (x.value * y.gradient[i] - y.value * x.gradient[i]) / q),
        }
    }
    fn sinc(self) -> Self {
        let h = self.value;
        let slope = if h.abs() < 1e-2 {
            -h / 3.0 * (1.0 - h * h * 0.1 * (1.0 - h * h / 28.0))
        } else {
            let (s, c) = math::sin_cos(h);
            (c - s / h) / h
        };
        self.chain(h.sinc(), slope)
    }
    fn wrap_angle(self) -> Self {
        self.chain(math::wrap_angle(self.value), 1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Derivative of `f` at `x` by central differences in double precision.
    fn slope(f: impl Fn(f64) -> f64, x: f64) -> f64 {
        let h = 1e-5;
        (f(x + h) - f(x - h)) / (2.0 * h)
    }

    #[test]
    fn derivatives_agree_with_differences() {
        let points = [-2.5, -1e-2, -1e-8, 1e-8, 3e-4, 0.3, 1.0, 2.9];
        for x in points {
            let d = Dual::<1>::variable(x, 0);
            let close = |dual: Dual<1>, expected: f64| {
                assert!((dual.gradient[0] - expected).abs() < 1e-8, "at {x}: {} against {expected}", dual.gradient[0]);
            };
            close(d.sin_cos().0, slope(libm::sin, x));
            close(d.sin_cos().1, slope(libm::cos, x));
            close(
                d.sinc(),
                slope(|v| libm::sin(v) / v, x + if x.abs() < 1e-4 { 1e-3 } else { 0.0 })
                    + if x.abs() < 1e-4 { 1e-3 / 3.0 } else { 0.0 },
            );
            close((d * d + Dual::constant(1.0)).sqrt(), slope(|v| (v * v + 1.0).sqrt(), x));
            close(Dual::atan2(d * d, d - Dual::constant(3.0)), slope(|v| libm::atan2(v * v, v - 3.0), x));
            close(d / (d - Dual::constant(7.0)), slope(|v| v / (v - 7.0), x));
        }
    }

    #[test]
    fn sinc_is_continuous_where_the_series_takes_over() {
        for h in [0.0, 1e-9, 9.999e-4, 1.0001e-3, -9.999e-4, 0.5] {
            let exact = if h == 0.0 { 1.0 } else { libm::sin(h) / h };
            assert!((h.sinc() - exact).abs() < 2e-16, "sinc({h})");
        }
    }
}
