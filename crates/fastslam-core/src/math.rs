//! Elementary functions with the same bits on every machine.
//!
//! Every function is a straight line of additions, multiplications, divisions, square roots and selections,
//! without a fused multiply-add and without a branch, so a loop over a slice turns into vector code and gives the
//! same result on every instruction set. Tests hold each to a stated error in units in the last place.
//!
//! **Source:** reductions and coefficients are those of fdlibm (`sin_cos`, `exp`, `ln`) and Cephes (`atan2`).

/// 2^52 + 2^51: adding and subtracting it rounds a double of magnitude below 2^51 to the nearest integer.
const ROUNDING: f64 = 6_755_399_441_055_744.0;
const TAU_INVERSE: f64 = 1.0 / std::f64::consts::TAU;

/// The nearest integer, ties to even, for |x| < 2^51.
#[inline(always)]
pub fn round(x: f64) -> f64 {
    (x + ROUNDING) - ROUNDING
}

/// The same angle in [−π, π].
#[inline(always)]
pub fn wrap_angle(angle_rad: f64) -> f64 {
    angle_rad - std::f64::consts::TAU * round(angle_rad * TAU_INVERSE)
}

/// Sine and cosine for |x| below 10⁵, within 2 ulp (near a zero of the result: of 10⁻⁹).
#[inline(always)]
pub fn sin_cos(x: f64) -> (f64, f64) {
    const PIO2_1: f64 = 1.570_796_326_734_125_6;
    const PIO2_2: f64 = 6.077_100_506_303_966e-11;
    const PIO2_3: f64 = 2.022_266_248_795_950_6e-21;
    let quadrant = x * std::f64::consts::FRAC_2_PI + ROUNDING;
    let n = quadrant - ROUNDING;
    let r = ((x - n * PIO2_1) - n * PIO2_2) - n * PIO2_3;
    let z = r * r;
    let sin_r = r + r
        * z
        * (-1.666_666_666_666_663_2e-1
            + z * (8.333_333_333_322_49e-3
                + z * (-1.984_126_982_985_795e-4
                    + z * (2.755_731_370_707_006_8e-6
                        + z * (-2.505_076_025_340_686_3e-8 + z * 1.589_690_995_211_55e-10)))));
    let half_z = 0.5 * z;
    let w = 1.0 - half_z;
    let cos_r = w
        + (((1.0 - w) - half_z)
            + z * z
                * (4.166_666_666_666_66e-2
                    + z * (-1.388_888_888_887_411e-3
                        + z * (2.480_158_728_947_673e-5
                            + z * (-2.755_731_435_139_066_3e-7
                                + z * (2.087_572_321_298_175e-9 + z * -1.135_964_755_778_819_5e-11))))));
    // The low bits of the rounded quotient are the quadrant, also for negative ones (two's complement).
    let bits = quadrant.to_bits();
    let swap = bits & 1 == 1;
    let sine = if swap { cos_r } else { sin_r };
    let cosine = if swap { sin_r } else { cos_r };
    let sine_sign = (bits & 2) << 62;
    let cosine_sign = (bits.wrapping_add(1) & 2) << 62;
    (f64::from_bits(sine.to_bits() ^ sine_sign), f64::from_bits(cosine.to_bits() ^ cosine_sign))
}

/// Angle of the vector (x, y) in [−π, π] for finite arguments, within 2 ulp; 0 at the origin.
#[inline(always)]
pub fn atan2(y: f64, x: f64) -> f64 {
    use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI};
    const PI_LOW: f64 = 1.224_646_799_147_353_2e-16;
    let (ax, ay) = (x.abs(), y.abs());
    let steep = ay > ax;
    let large = if steep { ay } else { ax };
    let small = if steep { ax } else { ay };
    let upper = small > 0.66 * large;
    let numerator = if upper { small - large } else { small };
    let denominator = if upper { small + large } else { large };
    let t = numerator / if denominator == 0.0 { 1.0 } else { denominator };
    let z = t * t;
    let p = (((-8.750_608_600_031_904e-1 * z - 1.615_753_718_733_365_2e1) * z - 7.500_855_792_314_705e1) * z
        - 1.228_866_684_490_136_1e2)
        * z
        - 6.485_021_904_942_025e1;
    let q = ((((z + 2.485_846_490_142_306_3e1) * z + 1.650_270_098_316_988_5e2) * z + 4.328_810_604_912_902_5e2) * z
        + 4.853_903_996_359_137e2)
        * z
        + 1.945_506_571_482_614e2;
    let polynomial = z * (p / q) * t + t;
    let octant = if upper { FRAC_PI_4 + (polynomial + 0.25 * PI_LOW) } else { polynomial };
    let quadrant = if steep { FRAC_PI_2 - (octant - 0.5 * PI_LOW) } else { octant };
    let half = if x < 0.0 { PI - (quadrant - PI_LOW) } else { quadrant };
    half.copysign(y)
}

/// 2^k for an integer −1022 ≤ k ≤ 1023 held in a double.
#[inline(always)]
fn power_of_two(k: f64) -> f64 {
    f64::from_bits((k + (ROUNDING + 1023.0)).to_bits() << 52)
}

/// Exponential within 1 ulp; 0 below −745.2, infinity above 709.8.
#[inline(always)]
pub fn exp(x: f64) -> f64 {
    const LN2_HIGH: f64 = 6.931_471_803_691_238e-1;
    const LN2_LOW: f64 = 1.908_214_929_270_587_7e-10;
    let x = if x > 800.0 { 800.0 } else { x };
    let x = if x < -800.0 { -800.0 } else { x };
    let k = round(x * std::f64::consts::LOG2_E);
    let high = x - k * LN2_HIGH;
    let low = k * LN2_LOW;
    let r = high - low;
    let z = r * r;
    let c = r - z
        * (1.666_666_666_666_660_2e-1
            + z * (-2.777_777_777_701_559_3e-3
                + z * (6.613_756_321_437_934e-5 + z * (-1.653_390_220_546_525_2e-6 + z * 4.138_136_797_057_238e-8))));
    let y = 1.0 + ((r * c / (2.0 - c) - low) + high);
    let k_half = round(k * 0.5);
    y * power_of_two(k_half) * power_of_two(k - k_half)
}

/// Natural logarithm within 1 ulp; −∞ at 0, NaN below.
#[inline(always)]
pub fn ln(x: f64) -> f64 {
    const LN2_HIGH: f64 = 6.931_471_803_691_238e-1;
    const LN2_LOW: f64 = 1.908_214_929_270_587_7e-10;
    const SQRT_HALF_BITS: u64 = 0x3fe6_a09e << 32;
    const ONE_BITS: u64 = 0x3ff0_0000 << 32;
    const TWO_52: f64 = 4_503_599_627_370_496.0;
    let subnormal = x < f64::MIN_POSITIVE;
    let scaled = if subnormal { x * 18_014_398_509_481_984.0 } else { x };
    let shift = if subnormal { 54.0 } else { 0.0 };
    let bits = scaled.to_bits().wrapping_add(ONE_BITS - SQRT_HALF_BITS);
    // The exponent field, as a double without an integer conversion (which old vector units lack).
    let k = (f64::from_bits(TWO_52.to_bits() | (bits >> 52)) - TWO_52) - (1023.0 + shift);
    let mantissa = f64::from_bits((bits & 0x000f_ffff_ffff_ffff).wrapping_add(SQRT_HALF_BITS));
    let f = mantissa - 1.0;
    let s = f / (2.0 + f);
    let z = s * s;
    let w = z * z;
    let even = w * (3.999_999_999_940_942e-1 + w * (2.222_219_843_214_978_4e-1 + w * 1.531_383_769_920_937_3e-1));
    let odd = z
        * (6.666_666_666_666_735e-1
            + w * (2.857_142_874_366_239e-1 + w * (1.818_357_216_161_805e-1 + w * 1.479_819_860_511_658_6e-1)));
    let half_square = 0.5 * f * f;
    let result = k * LN2_HIGH - ((half_square - (s * (half_square + (even + odd)) + k * LN2_LOW)) - f);
    let result = if x == f64::INFINITY { f64::INFINITY } else { result };
    let result = if x == 0.0 { f64::NEG_INFINITY } else { result };
    if x >= 0.0 {
        result
    } else {
        f64::NAN
    }
}

/// The probability that belongs to log-odds.
#[inline(always)]
pub fn logistic(log_odds: f64) -> f64 {
    1.0 / (1.0 + exp(-log_odds))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// |a − b| in units in the last place of `b`, at least that of `floor`.
    fn ulps(a: f64, b: f64, floor: f64) -> f64 {
        let magnitude = b.abs().max(floor);
        let unit = f64::from_bits(magnitude.to_bits() + 1) - magnitude;
        (a - b).abs() / unit
    }

    fn sweep(low: f64, high: f64, n: u32) -> impl Iterator<Item = f64> {
        (0..=n).map(move |i| low + (high - low) * f64::from(i) / f64::from(n))
    }

    #[test]
    fn sine_and_cosine_agree_with_libm() {
        let mut worst = 0.0_f64;
        for x in sweep(-20.0, 20.0, 200_001).chain(sweep(-1e5, 1e5, 100_003)) {
            let (s, c) = sin_cos(x);
            // Near a zero of the function the absolute error of the reduction counts.
            worst = worst.max(ulps(s, libm::sin(x), 1e-9)).max(ulps(c, libm::cos(x), 1e-9));
        }
        assert!(worst <= 2.0, "worst error {worst} ulp");
    }

    #[test]
    fn arc_tangent_agrees_with_libm_in_all_quadrants() {
        let mut worst = 0.0_f64;
        for angle in sweep(-3.2, 3.2, 100_003) {
            for radius in [1e-300, 3e-5, 1.0, 77.0, 1e200] {
                let (y, x) = (radius * libm::sin(angle), radius * libm::cos(angle));
                worst = worst.max(ulps(atan2(y, x), libm::atan2(y, x), 1e-300));
            }
        }
        assert!(worst <= 2.0, "worst error {worst} ulp");
        assert_eq!(atan2(0.0, 0.0), 0.0);
        assert_eq!(atan2(0.0, -1.0), std::f64::consts::PI);
        assert_eq!(atan2(-0.0, -1.0), -std::f64::consts::PI);
        assert_eq!(atan2(1.0, 0.0), std::f64::consts::FRAC_PI_2);
    }

    #[test]
    fn exponential_agrees_with_libm_and_saturates() {
        let mut worst = 0.0_f64;
        for x in sweep(-708.0, 709.7, 300_007).chain(sweep(-1.0, 1.0, 100_003)) {
            worst = worst.max(ulps(exp(x), libm::exp(x), 0.0));
        }
        assert!(worst <= 1.0, "worst error {worst} ulp");
        assert_eq!(exp(0.0), 1.0);
        assert_eq!(exp(f64::NEG_INFINITY), 0.0);
        assert_eq!(exp(-746.0), 0.0);
        assert_eq!(exp(710.0), f64::INFINITY);
        assert!(exp(f64::NAN).is_nan());
    }

    #[test]
    fn logarithm_agrees_with_libm_and_has_its_limits() {
        let mut worst = 0.0_f64;
        for x in sweep(-700.0, 700.0, 300_007).map(libm::exp).chain(sweep(0.5, 2.0, 100_003)) {
            worst = worst.max(ulps(ln(x), libm::log(x), 0.0));
        }
        assert!(worst <= 1.0, "worst error {worst} ulp");
        assert_eq!(ln(1.0), 0.0);
        assert_eq!(ln(0.0), f64::NEG_INFINITY);
        assert_eq!(ln(f64::INFINITY), f64::INFINITY);
        assert!(ln(-1.0).is_nan() && ln(f64::NAN).is_nan());
        assert!(ulps(ln(5e-324), libm::log(5e-324), 0.0) <= 1.0);
    }

    #[test]
    fn wrapping_keeps_the_angle_and_bounds_it() {
        for x in sweep(-50.0, 50.0, 10_007) {
            let wrapped = wrap_angle(x);
            assert!(wrapped.abs() <= std::f64::consts::PI + 1e-15);
            assert!((libm::sin(wrapped) - libm::sin(x)).abs() < 1e-13);
            assert!((libm::cos(wrapped) - libm::cos(x)).abs() < 1e-13);
        }
    }
}
