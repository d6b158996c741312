//! Counter-based random numbers: a draw is a function of (seed, step, particle, purpose) and of nothing else, so
//! neither the order of evaluation nor the number of threads can change it.
//!
//! **Source:** Salmon, Moraes, Dror, Shaw, "Parallel random numbers: as easy as 1, 2, 3", SC 2011 (Philox4x32-10).

use crate::math;

/// Philox4x32 with ten rounds: four words from a counter of four words under a key of two.
///
/// The words stand in the lower halves of wider ones, whose upper halves mean nothing: so it is vector code in a pass over
/// particles.
#[inline(always)]
pub fn philox(counter: [u32; 4], mut key: [u32; 2]) -> [u32; 4] {
    const WORD: u64 = 0xffff_ffff;
    let [a, b, c, d] = counter;
    let mut wide = [u64::from(a), u64::from(b), u64::from(c), u64::from(d)];
    for round in 0..10 {
        if round > 0 {
            key = [key[0].wrapping_add(0x9E37_79B9), key[1].wrapping_add(0xBB67_AE85)];
        }
        let a = (wide[0] & WORD) * 0xD251_1F53;
        let b = (wide[2] & WORD) * 0xCD9E_8D57;
        wide = [(b >> 32) ^ wide[1] ^ u64::from(key[0]), b, (a >> 32) ^ wide[3] ^ u64::from(key[1]), a];
    }
    [wide[0] as u32, wide[1] as u32, wide[2] as u32, wide[3] as u32]
}

/// What a draw is for: streams of different purposes never overlap.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Purpose {
    /// Noise of the motion model.
    Motion = 0,
    /// Resampling of particles.
    Resampling = 1,
    /// Sampling of the pose from the measurement-informed proposal.
    Proposal = 2,
    /// Sampling of data associations.
    Association = 3,
    /// Everything that a simulation draws.
    Simulation = 4,
    /// Moves that rejuvenate particles.
    Rejuvenation = 5,
    /// Poses at a start that is not known exactly.
    Start = 6,
    /// Errors of imagined runs.
    Errors = 7,
}

/// The random numbers of one run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RandomSource {
    key: [u32; 2],
}

impl RandomSource {
    /// All draws are determined by `seed`.
    pub fn new(seed: u64) -> Self {
        Self { key: [seed as u32, (seed >> 32) as u32] }
    }

    /// The stream of one purpose at one step (or any other running number below 2^56).
    #[inline(always)]
    pub fn stream(self, purpose: Purpose, step: u64) -> Stream {
        let tag = (step & 0x00ff_ffff_ffff_ffff) | ((purpose as u64) << 56);
        Stream { key: self.key, low: tag as u32, high: (tag >> 32) as u32 }
    }
}

/// Draws addressed by a particle (or any index) and a draw number.
#[derive(Clone, Copy, Debug)]
pub struct Stream {
    key: [u32; 2],
    low: u32,
    high: u32,
}

impl Stream {
    /// Two independent uniform numbers in the open interval (0, 1), 52 bits each.
    #[inline(always)]
    pub fn uniform_pair(self, particle: u32, draw: u32) -> [f64; 2] {
        let [a, b, c, d] = philox([particle, draw, self.low, self.high], self.key);
        [unit_interval(a, b), unit_interval(c, d)]
    }

    /// 128 independent bits.
    #[inline(always)]
    pub fn words(self, index: u32, draw: u32) -> [u32; 4] {
        philox([index, draw, self.low, self.high], self.key)
    }

    /// One uniform number in (0, 1).
    #[inline(always)]
    pub fn uniform(self, particle: u32, draw: u32) -> f64 {
        self.uniform_pair(particle, draw)[0]
    }

    /// Two independent standard normal numbers (Box–Muller).
    #[inline(always)]
    pub fn normal_pair(self, particle: u32, draw: u32) -> [f64; 2] {
        let [u, v] = self.uniform_pair(particle, draw);
        let radius = (-2.0 * math::ln(u)).sqrt();
        let (s, c) = math::sin_cos(std::f64::consts::TAU * v);
        [radius * c, radius * s]
    }
}

/// Two words as a double in (0, 1): never 0, never 1.
#[inline(always)]
fn unit_interval(high: u32, low: u32) -> f64 {
    let bits = (u64::from(high) << 20) | u64::from(low >> 12);
    // A double in [1, 2) from 52 bits, moved by half a step so that both ends stay open.
    f64::from_bits(0x3ff0_0000_0000_0000 | bits) - (1.0 - f64::EPSILON / 2.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn philox_gives_the_published_answers() {
        assert_eq!(philox([0; 4], [0; 2]), [0x6627_e8d5, 0xe169_c58d, 0xbc57_ac4c, 0x9b00_dbd8]);
        assert_eq!(philox([u32::MAX; 4], [u32::MAX; 2]), [0x408f_276d, 0x41c8_3b0e, 0xa20b_c7c6, 0x6d54_51fd]);
        assert_eq!(
            philox([0x243f_6a88, 0x85a3_08d3, 0x1319_8a2e, 0x0370_7344], [0xa409_3822, 0x299f_31d0]),
            [0xd16c_fe09, 0x94fd_cceb, 0x5001_e420, 0x2412_6ea1]
        );
    }

    #[test]
    fn the_open_interval_is_open() {
        assert!(unit_interval(0, 0) > 0.0);
        assert!(unit_interval(u32::MAX, u32::MAX) < 1.0);
    }

    #[test]
    fn normal_numbers_have_the_moments_of_the_normal_distribution() {
        let stream = RandomSource::new(7).stream(Purpose::Motion, 3);
        let n = 200_000_u32;
        let mut sums = [0.0; 4];
        let mut product = 0.0;
        for particle in 0..n {
            let [a, b] = stream.normal_pair(particle, 1);
            product += a * b;
            for x in [a, b] {
                for (power, sum) in sums.iter_mut().enumerate() {
                    *sum += x.powi(power as i32 + 1);
                }
            }
        }
        let count = 2.0 * f64::from(n);
        // Standard errors of the first four sample moments: sqrt(var(x^k) / n) with var 1, 2, 15, 96; bound 4 of them.
        let expected = [(0.0, 1.0), (1.0, 2.0), (0.0, 15.0), (3.0, 96.0)];
        for (sum, (mean, variance)) in sums.iter().zip(expected) {
            let bound = 4.0 * f64::sqrt(variance / count);
            assert!((sum / count - mean).abs() < bound, "moment {} against {mean} ± {bound}", sum / count);
        }
        assert!((product / f64::from(n)).abs() < 4.0 / f64::from(n).sqrt());
    }

    #[test]
    fn streams_differ_by_every_part_of_their_address() {
        let base = RandomSource::new(1);
        let draw = |s: RandomSource, p, step, i, d| s.stream(p, step).uniform(i, d);
        let values = [
            draw(base, Purpose::Motion, 0, 0, 0),
            draw(base, Purpose::Resampling, 0, 0, 0),
            draw(base, Purpose::Motion, 1, 0, 0),
            draw(base, Purpose::Motion, 1 << 33, 0, 0),
            draw(base, Purpose::Motion, 0, 1, 0),
            draw(base, Purpose::Motion, 0, 0, 1),
            draw(RandomSource::new(2), Purpose::Motion, 0, 0, 0),
            draw(RandomSource::new(1 << 40), Purpose::Motion, 0, 0, 0),
        ];
        for (i, a) in values.iter().enumerate() {
            for b in &values[..i] {
                assert_ne!(a, b);
            }
        }
    }
}
