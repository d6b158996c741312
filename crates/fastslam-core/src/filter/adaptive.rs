//! How many particles are enough.

use super::Particles;
use crate::config::{AdaptiveConfig, ParticleNumber};
use crate::density::chi_squared_ratio;
use rustc_hash::FxHashSet;

impl AdaptiveConfig {
    /// Particles after a resampling: enough for the poses of the surviving `ancestors`, at most `maximum`.
    ///
    /// **Source:** `fox2003adapting`: with k bins occupied, M = (k−1)/(2ε) (1 − 2/(9(k−1)) + z √(2/(9(k−1))))³ keeps the
    /// Kullback–Leibler divergence between the sampled and the binned distribution below ε with probability 1 − δ.
    pub(super) fn count(&self, particles: &Particles, ancestors: &[u32], maximum: usize) -> usize {
        match self.number {
            ParticleNumber::Fixed => maximum,
            ParticleNumber::Kld => {
                let least = (self.minimum as usize).min(maximum);
                particles_for(self.occupied(particles, ancestors), self.epsilon, self.delta).clamp(least, maximum)
            }
        }
    }

    /// Bins of pose space in which some ancestor stands.
    fn occupied(&self, particles: &Particles, ancestors: &[u32]) -> usize {
        let bin = |value: f64, size: f64| (value / size).floor() as i64;
        let mut bins = FxHashSet::default();
        for &a in ancestors {
            let pose = particles.pose(a as usize);
            bins.insert([bin(pose.x, self.bin_m), bin(pose.y, self.bin_m), bin(pose.heading, self.bin_rad)]);
        }
        bins.len()
    }
}

/// The bound on the number of particles for k occupied bins.
fn particles_for(bins: usize, epsilon: f64, delta: f64) -> usize {
    if bins < 2 {
        return 1;
    }
    let degrees = (bins - 1) as f64;
    let ratio = chi_squared_ratio(degrees, upper_quantile(delta));
    (degrees / (2.0 * epsilon) * ratio).ceil() as usize
}

/// z with P(Z > z) = δ for a standard normal Z, δ below one half.
///
/// **Source:** `abramowitz1964handbook`, formula 26.2.23; the error is below 4.5e-4.
fn upper_quantile(delta: f64) -> f64 {
    let t = (-2.0 * delta.ln()).sqrt();
    let above = 2.515_517 + t * (0.802_853 + t * 0.010_328);
    let below = 1.0 + t * (1.432_788 + t * (0.189_269 + t * 0.001_308));
    t - above / below
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pose;

    #[test]
    fn the_quantile_is_that_of_the_normal_distribution() {
        for (delta, z) in [(0.05, 1.644_854), (0.01, 2.326_348), (0.001, 3.090_232)] {
            assert!((upper_quantile(delta) - z).abs() < 4.5e-4, "{delta}: {}", upper_quantile(delta));
        }
    }

    #[test]
    fn the_bound_is_half_the_quantile_of_chi_squared_over_epsilon() {
        // χ²_9(0.99) = 21.666, χ²_99(0.99) = 134.64; Wilson and Hilferty err by less than 0.3 %.
        for (bins, quantile) in [(10, 21.666), (100, 134.64)] {
            let expected = quantile / (2.0 * 0.05);
            let found = particles_for(bins, 0.05, 0.01) as f64;
            assert!((found / expected - 1.0).abs() < 0.006, "{bins}: {found} against {expected}");
        }
        assert_eq!(particles_for(1, 0.05, 0.01), 1);
    }

    #[test]
    fn more_spread_asks_for_more_particles_between_the_limits() {
        let settings = AdaptiveConfig { number: ParticleNumber::Kld, ..AdaptiveConfig::default() };
        let mut particles = Particles::at(Pose::new(0.3, -0.2, 0.1), 200);
        let ancestors: Vec<u32> = (0..200).collect();
        assert_eq!(settings.count(&particles, &ancestors, 200), settings.minimum as usize);
        (0..200).for_each(|i| particles.x[i] += if i < 40 { settings.bin_m * i as f64 } else { 0.0 });
        assert_eq!(settings.count(&particles, &ancestors, 200), 200);
        assert_eq!(settings.count(&particles, &ancestors, 3), 3);
        // Only survivors count.
        assert_eq!(settings.count(&particles, &[199; 200], 200), settings.minimum as usize);
        assert_eq!(AdaptiveConfig::default().count(&particles, &ancestors, 200), 200);
    }
}
