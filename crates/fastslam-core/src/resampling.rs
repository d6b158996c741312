//! Resampling: which ancestor each new particle copies.

use crate::random::Stream;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// How ancestors are drawn. Every scheme gives each particle M·weight offspring on average.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ResamplingScheme {
    /// One random offset for evenly spaced points: the fewest surprises, and the default.
    #[default]
    Systematic,
    /// One random point in each of M equal strata.
    Stratified,
    /// ⌊M·weight⌋ copies for certain, the rest at random.
    Residual,
    /// M independent draws.
    Multinomial,
}

/// Entry i of a column becomes the former entry `ancestor_indices[i]`; `spare` is memory to work with.
pub fn follow<T: Copy>(column: &mut Vec<T>, ancestor_indices: &[u32], spare: &mut Vec<T>) {
    spare.clear();
    spare.extend(ancestor_indices.iter().map(|&a| column[a as usize]));
    std::mem::swap(column, spare);
}

/// Draws `count` ancestors, in ascending order, into `ancestor_indices`.
///
/// `weights` are normalised; a particle of zero weight is never chosen.
/// **Source:** `douc2005comparison`.
pub fn resample(
    scheme: ResamplingScheme,
    weights: &[f64],
    count: usize,
    stream: Stream,
    ancestor_indices: &mut Vec<u32>,
) {
    Resampler::default().draw(scheme, weights, count, stream, ancestor_indices);
}

/// What drawing needs to remember; kept for its memory.
#[derive(Clone, Debug, Default)]
pub struct Resampler {
    points: Vec<f64>,
    rest: Vec<f64>,
}

impl Resampler {
    /// [`resample`], without asking for memory once it has drawn as many.
    pub fn draw(
        &mut self,
        scheme: ResamplingScheme,
        weights: &[f64],
        count: usize,
        stream: Stream,
        ancestor_indices: &mut Vec<u32>,
    ) {
        ancestor_indices.clear();
        let n = count as f64;
        match scheme {
            ResamplingScheme::Systematic => {
                let offset = stream.uniform(0, 0);
                inverse_cdf(weights, (0..count).map(|i| (i as f64 + offset) / n), ancestor_indices);
            }
            ResamplingScheme::Stratified => {
                let points = (0..count).map(|i| (i as f64 + stream.uniform(i as u32, 0)) / n);
                inverse_cdf(weights, points, ancestor_indices);
            }
            ResamplingScheme::Multinomial => {
                self.sort_uniforms(count, stream);
                inverse_cdf(weights, self.points.iter().copied(), ancestor_indices);
            }
            ResamplingScheme::Residual => self.draw_residual(weights, count, stream, ancestor_indices),
        }
    }

    fn sort_uniforms(&mut self, count: usize, stream: Stream) {
        self.points.clear();
        self.points.extend((0..count).map(|i| stream.uniform(i as u32, 0)));
        self.points.sort_unstable_by(f64::total_cmp);
    }

    fn draw_residual(&mut self, weights: &[f64], count: usize, stream: Stream, ancestor_indices: &mut Vec<u32>) {
        let n = count as f64;
        // Rounding may make the certain copies one too many only if the weights sum to more than 1; the cut is exact.
        for (i, weight) in weights.iter().enumerate() {
            let room = count - ancestor_indices.len();
            ancestor_indices.extend(std::iter::repeat_n(i as u32, ((weight * n).floor() as usize).min(room)));
        }
        let left = count - ancestor_indices.len();
        if left > 0 {
            self.rest.clear();
            self.rest.extend(weights.iter().map(|w| (w * n - (w * n).floor()).max(0.0)));
            self.sort_uniforms(left, stream);
            inverse_cdf(&self.rest, self.points.iter().copied(), ancestor_indices);
            ancestor_indices.sort_unstable();
        }
    }
}

/// Appends, for each point of an ascending sequence in [0, 1), the first index whose cumulative mass exceeds it.
///
/// The mass need not sum to 1: points are scaled to the total and kept strictly below it.
fn inverse_cdf(mass: &[f64], points: impl Iterator<Item = f64>, out: &mut Vec<u32>) {
    let total: f64 = mass.iter().sum();
    let last = mass.iter().rposition(|m| *m > 0.0).unwrap_or(0);
    let mut index = 0;
    let mut cumulative = mass.first().copied().unwrap_or(0.0);
    for point in points {
        let target = point * total;
        while cumulative <= target && index < last {
            index += 1;
            cumulative += mass[index];
        }
        out.push(index as u32);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Purpose, RandomSource};

    const SCHEMES: [ResamplingScheme; 4] = [
        ResamplingScheme::Systematic,
        ResamplingScheme::Stratified,
        ResamplingScheme::Residual,
        ResamplingScheme::Multinomial,
    ];

    fn counts(scheme: ResamplingScheme, weights: &[f64], count: usize, step: u64) -> Vec<u32> {
        let mut ancestors = Vec::new();
        resample(scheme, weights, count, RandomSource::new(5).stream(Purpose::Resampling, step), &mut ancestors);
        assert_eq!(ancestors.len(), count);
        assert!(ancestors.is_sorted());
        let mut counts = vec![0; weights.len()];
        for a in ancestors {
            counts[a as usize] += 1;
        }
        counts
    }

    #[test]
    fn offspring_are_right_on_average() {
        let weights = [0.05, 0.0, 0.5, 0.13, 0.32];
        let (count, runs) = (7, 20_000_u32);
        for scheme in SCHEMES {
            let mut sums = [0.0; 5];
            for run in 0..runs {
                for (sum, c) in sums.iter_mut().zip(counts(scheme, &weights, count, u64::from(run))) {
                    *sum += f64::from(c);
                }
            }
            for (i, (sum, weight)) in sums.iter().zip(weights).enumerate() {
                // Offspring of multinomial resampling, the noisiest, have variance M w (1 - w); 4 standard errors.
                let expected = count as f64 * weight;
                let bound = 4.0 * (expected * (1.0 - weight) / f64::from(runs)).sqrt();
                let mean = sum / f64::from(runs);
                assert!(
                    (mean - expected).abs() <= bound,
                    "{scheme:?} particle {i}: {mean} against {expected} ± {bound}"
                );
            }
        }
    }

    #[test]
    fn systematic_offspring_differ_by_less_than_one_from_their_mean() {
        let weights = [0.3, 0.21, 0.19, 0.3];
        for step in 0..200 {
            for (c, w) in counts(ResamplingScheme::Systematic, &weights, 10, step).into_iter().zip(weights) {
                assert!((f64::from(c) - 10.0 * w).abs() < 1.0);
            }
        }
    }

    #[test]
    fn equal_weights_leave_every_particle_in_place() {
        for scheme in [ResamplingScheme::Systematic, ResamplingScheme::Residual] {
            assert_eq!(counts(scheme, &[0.25; 4], 4, 1), vec![1; 4]);
        }
    }

    #[test]
    fn extreme_points_choose_the_ends_and_never_a_weightless_particle() {
        let mut out = Vec::new();
        let mass = [0.0, 0.1, 0.2, 0.7, 0.0];
        inverse_cdf(&mass, [0.0, 1.0 - f64::EPSILON / 2.0].into_iter(), &mut out);
        assert_eq!(out, vec![1, 3]);
    }

    #[test]
    fn the_number_of_particles_may_change() {
        assert_eq!(counts(ResamplingScheme::Systematic, &[0.5, 0.5], 6, 0), vec![3, 3]);
        assert_eq!(counts(ResamplingScheme::Residual, &[0.25; 4], 2, 0).iter().sum::<u32>(), 2);
    }
}
