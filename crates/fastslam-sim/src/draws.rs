//! Addresses of the random numbers of a simulation.

use fastslam_core::math::exp;
use fastslam_core::random::{Purpose, RandomSource, Stream};

/// Parts of a simulation: their streams never overlap.
#[derive(Clone, Copy, Debug)]
pub enum Part {
    /// Where the landmarks stand.
    World = 0,
    /// Classes and diameters of the landmarks.
    Attributes = 1,
    /// The path.
    Trajectory = 2,
    /// Noise of the odometry, by control.
    Odometry = 3,
    /// Sightings of landmarks, by scan and landmark.
    Sighting = 4,
    /// False sightings, by scan.
    Clutter = 5,
}

/// All random numbers of one simulation.
#[derive(Clone, Copy, Debug)]
pub struct Draws(RandomSource);

impl Draws {
    /// All draws are determined by `seed`.
    pub fn new(seed: u64) -> Self {
        Self(RandomSource::new(seed))
    }

    /// The stream of a part at a running number below 2^48.
    pub fn stream(self, part: Part, index: usize) -> Stream {
        self.0.stream(Purpose::Simulation, ((part as u64) << 48) | index as u64)
    }
}

/// Number of events of a Poisson process with this mean, from the draws of one item of a stream.
///
/// **Source:** the product of uniform numbers (Knuth), the exponential taken out in pieces that cannot underflow.
pub fn poisson(stream: Stream, item: u32, mean: f64) -> u32 {
    let (mut count, mut remaining, mut product) = (0, mean, 1.0);
    let mut draw = 0;
    loop {
        let piece = remaining.min(50.0);
        remaining -= piece;
        product *= exp(piece);
        while product > 1.0 {
            product *= stream.uniform(item, draw);
            draw += 1;
            count += 1;
        }
        if remaining <= 0.0 {
            // The draw that ended the loop is one too many, unless the mean is zero and there was none.
            return if draw == 0 { 0 } else { count - 1 };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn poisson_numbers_have_mean_and_variance_of_their_mean() {
        for mean in [0.3, 4.0, 130.0] {
            let n = 40_000_u32;
            let counts: Vec<f64> =
                (0..n).map(|i| f64::from(poisson(Draws::new(5).stream(Part::Clutter, 0), i, mean))).collect();
            let average = counts.iter().sum::<f64>() / f64::from(n);
            let variance = counts.iter().map(|c| (c - average).powi(2)).sum::<f64>() / f64::from(n);
            // Standard errors: sqrt(λ/n) of the mean, sqrt((λ + 2λ²)/n) of the variance; 4 of them.
            assert!((average - mean).abs() < 4.0 * (mean / f64::from(n)).sqrt(), "{average} against {mean}");
            let bound = 4.0 * ((mean + 2.0 * mean * mean) / f64::from(n)).sqrt();
            assert!((variance - mean).abs() < bound, "{variance} against {mean} ± {bound}");
        }
        assert_eq!(poisson(Draws::new(5).stream(Part::Clutter, 0), 0, 0.0), 0);
    }
}
