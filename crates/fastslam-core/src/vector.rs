//! Runs a loop with the widest vector unit that the machine has.
//!
//! The passes over particles are plain loops over columns. Compiled inside a function that may use AVX2 or AVX-512 they
//! become vector code; since no operation is reordered or contracted, every level gives the same bits.

/// A set of vector instructions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Level {
    /// What every processor of the architecture has: SSE2, NEON.
    Baseline,
    /// Four lanes of f64.
    Avx2,
    /// Eight lanes of f64.
    Avx512,
}

impl Level {
    /// The levels that this machine has, narrowest first.
    pub fn available() -> Vec<Level> {
        let all = [Level::Baseline, Level::Avx2, Level::Avx512];
        all.into_iter().filter(|level| level.is_available()).collect()
    }

    #[cfg(target_arch = "x86_64")]
    fn is_available(self) -> bool {
        match self {
            Level::Baseline => true,
            Level::Avx2 => pulp::x86::V3::is_available(),
            Level::Avx512 => pulp::x86::V4::is_available(),
        }
    }

    #[cfg(not(target_arch = "x86_64"))]
    fn is_available(self) -> bool {
        self == Level::Baseline
    }
}

/// Calls `f` compiled for the widest level of this machine. Everything that it calls must be `#[inline(always)]`.
#[inline(always)]
pub fn vectorized<R>(f: impl FnOnce() -> R) -> R {
    #[cfg(target_arch = "x86_64")]
    {
        match pulp::x86::Arch::new() {
            pulp::x86::Arch::V4(simd) => return simd.vectorize(f),
            pulp::x86::Arch::V3(simd) => return simd.vectorize(f),
            _ => {}
        }
    }
    f()
}

/// Calls `f` compiled for one level, which the machine must have; else for the baseline.
#[inline(always)]
pub fn vectorized_at<R>(level: Level, f: impl FnOnce() -> R) -> R {
    #[cfg(target_arch = "x86_64")]
    {
        match level {
            Level::Avx512 => {
                if let Some(simd) = pulp::x86::V4::try_new() {
                    return simd.vectorize(f);
                }
            }
            Level::Avx2 => {
                if let Some(simd) = pulp::x86::V3::try_new() {
                    return simd.vectorize(f);
                }
            }
            Level::Baseline => {}
        }
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = level;
    f()
}

/// The most lanes that a vector unit has.
const LANES: usize = 8;

/// Sum in a fixed order that vector units of up to eight lanes can follow.
#[inline(always)]
pub fn sum(count: usize, term: impl Fn(usize) -> f64) -> f64 {
    let mut lanes = [0.0; LANES];
    let whole = count - count % LANES;
    let mut i = 0;
    while i < whole {
        for (lane, total) in lanes.iter_mut().enumerate() {
            *total += term(i + lane);
        }
        i += LANES;
    }
    for (lane, total) in lanes.iter_mut().enumerate().take(count - whole) {
        *total += term(whole + lane);
    }
    ((lanes[0] + lanes[1]) + (lanes[2] + lanes[3])) + ((lanes[4] + lanes[5]) + (lanes[6] + lanes[7]))
}

/// Folds columns of numbers, `N` for each of `count` places, in lanes that vector units of up to eight can follow: place i
/// goes to lane i mod 8. `neutral` changes no lane.
///
/// **Why columns first:** a loop of eight rounds that does more than to add is unrolled, and then is no vector code any more.
#[inline(always)]
fn fold<const N: usize>(
    count: usize,
    neutral: [f64; N],
    numbers: impl Fn(usize) -> [f64; N],
    join: impl Fn(f64, f64) -> f64,
) -> [[f64; LANES]; N] {
    const CHUNK: usize = 64;
    let mut lanes = neutral.map(|number| [number; LANES]);
    for first in (0..count).step_by(CHUNK) {
        let width = CHUNK.min(count - first);
        let mut columns = neutral.map(|number| [number; CHUNK]);
        for i in 0..width {
            let numbers = numbers(first + i);
            for which in 0..N {
                columns[which][i] = numbers[which];
            }
        }
        for which in 0..N {
            for eight in columns[which].chunks_exact(LANES).take(width.div_ceil(LANES)) {
                for lane in 0..LANES {
                    lanes[which][lane] = join(lanes[which][lane], eight[lane]);
                }
            }
        }
    }
    lanes
}

/// Several sums at once, each as [`sum`] makes it.
#[inline(always)]
pub fn sums<const N: usize>(count: usize, terms: impl Fn(usize) -> [f64; N]) -> [f64; N] {
    // A sum that began with 0 is not −0, so that one more 0 changes no bit.
    let lanes = fold(
        count,
        [0.0; N],
        terms,
        #[inline(always)]
        |total, term| total + term,
    );
    lanes.map(|l| ((l[0] + l[1]) + (l[2] + l[3])) + ((l[4] + l[5]) + (l[6] + l[7])))
}

/// Whether any of these is true, without a branch for each: made for a pass over particles.
#[inline]
pub fn any(flags: &[bool]) -> bool {
    flags.iter().fold(false, |any, flag| any | flag)
}

/// The least number in each of several columns, of which those that are none do not count; ∞ without any.
#[inline(always)]
pub fn leasts<const N: usize>(count: usize, numbers: impl Fn(usize) -> [f64; N]) -> [f64; N] {
    let lanes = fold(
        count,
        [f64::INFINITY; N],
        numbers,
        // One instruction, unlike `f64::min`.
        #[inline(always)]
        |least, number| if number < least { number } else { least },
    );
    lanes.map(|lanes| lanes.into_iter().fold(f64::INFINITY, f64::min))
}

/// The least and the largest of some numbers, of which those that are none do not count; (∞, −∞) without any.
#[inline(always)]
pub fn range(count: usize, number: impl Fn(usize) -> f64) -> (f64, f64) {
    let [least, most] = leasts(
        count,
        #[inline(always)]
        |i| [number(i), -number(i)],
    );
    (least, -most)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_range_is_that_of_all_numbers_that_are_some() {
        let numbers: Vec<f64> =
            (0..40).map(|i| if i % 7 == 3 { f64::NAN } else { (f64::from(i) * 2.3).sin() }).collect();
        for count in 0..numbers.len() {
            let some = || numbers[..count].iter().copied().filter(|number| !number.is_nan());
            let expected = (some().fold(f64::INFINITY, f64::min), some().fold(f64::NEG_INFINITY, f64::max));
            assert_eq!(range(count, |i| numbers[i]), expected);
        }
    }

    #[test]
    fn every_level_gives_the_same_bits() {
        let x: Vec<f64> = (0..1003).map(|i| (f64::from(i) * 0.7).sin() * 40.0).collect();
        let pass = || {
            let mut out = vec![0.0; x.len()];
            for i in 0..x.len() {
                let (s, c) = crate::math::sin_cos(x[i]);
                out[i] = crate::math::atan2(s * 2.0, c) + crate::math::ln(x[i] * x[i] + 1e-3) + crate::math::exp(-x[i]);
            }
            (out.iter().map(|v| v.to_bits()).collect::<Vec<_>>(), sum(x.len(), |i| out[i]).to_bits())
        };
        let levels = Level::available();
        assert!(levels.contains(&Level::Baseline));
        for level in levels {
            assert_eq!(vectorized_at(level, pass), pass(), "{level:?}");
        }
        assert_eq!(vectorized(pass), pass());
    }

    #[test]
    fn one_of_many_is_enough() {
        for count in 0..70 {
            assert!(!any(&vec![false; count]));
            assert!((0..count).all(|at| any(&(0..count).map(|i| i == at).collect::<Vec<_>>())));
        }
    }

    #[test]
    fn the_sum_has_all_terms() {
        for count in 0..40 {
            let terms = |i: usize| [(i as f64).sin(), 1.0 / (i as f64 + 0.3)];
            assert_eq!(sums(count, terms), [sum(count, |i| terms(i)[0]), sum(count, |i| terms(i)[1])]);
            assert_eq!(sum(count, |i| i as f64), (count * count.saturating_sub(1) / 2) as f64);
        }
    }
}
