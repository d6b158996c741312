//! Importance weights in the log domain.

use crate::error::{Error, Result};
use crate::math;
use crate::vector::{self, vectorized};
use serde::{Deserialize, Serialize};

/// Normalised weights of the particles with what their sum says.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Weights {
    /// Normalised, linear; they sum to 1.
    pub values: Vec<f64>,
    /// 1 / Σ weight², between 1 and the number of particles.
    pub effective_sample_size: f64,
    /// ln of the mean of the unnormalised weights: the increment of the log evidence since they were all zero.
    pub log_mean: f64,
}

impl Weights {
    /// Normalises `log_weight`; a NaN counts as zero weight.
    ///
    /// **Errors:** [`Error::AllWeightsZero`] with `step` when no particle has any weight.
    pub fn normalize(&mut self, log_weight: &[f64], step: u64) -> Result<()> {
        let maximum = log_weight.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        if !maximum.is_finite() {
            return Err(Error::AllWeightsZero { step });
        }
        self.values.clear();
        let n = log_weight.len();
        self.values.resize(n, 0.0);
        let values = &mut self.values[..n];
        let (sum, squares) = vectorized(
            #[inline(always)]
            || {
                for i in 0..n {
                    let w = log_weight[i];
                    values[i] = if w.is_nan() { 0.0 } else { math::exp(w - maximum) };
                }
                let sum = vector::sum(n, |i| values[i]);
                for i in 0..n {
                    values[i] /= sum;
                }
                (sum, vector::sum(n, |i| values[i] * values[i]))
            },
        );
        self.effective_sample_size = 1.0 / squares;
        self.log_mean = maximum + math::ln(sum / log_weight.len() as f64);
        Ok(())
    }

    /// [`Self::normalize`]; what the sum of the weights has gained is evidence for the configuration.
    pub fn renormalize(&mut self, log_weight: &[f64], step: u64) -> Result<f64> {
        let before = self.log_mean;
        self.normalize(log_weight, step)?;
        Ok(self.log_mean - before)
    }

    /// Whether the effective sample size is below this share of the particles; of 1 it always is, but for rounding.
    pub fn are_uneven(&self, threshold: f64) -> bool {
        threshold >= 1.0 || self.effective_sample_size < threshold * self.values.len() as f64
    }

    /// Equal weights of so many particles, as after resampling.
    pub fn restart(&mut self, count: usize) {
        self.values.clear();
        self.values.resize(count, 1.0 / count as f64);
        self.effective_sample_size = count as f64;
        self.log_mean = 0.0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn normalized(log_weight: &[f64]) -> Result<Weights> {
        let mut weights = Weights::default();
        weights.normalize(log_weight, 9)?;
        Ok(weights)
    }

    #[test]
    fn huge_negative_weights_do_not_underflow() {
        let weights = normalized(&[-1e6, -1e6 + 3.0_f64.ln()]).unwrap();
        assert!((weights.values[0] - 0.25).abs() < 1e-9 && (weights.values[1] - 0.75).abs() < 1e-9);
        assert!((weights.effective_sample_size - 1.6).abs() < 1e-9);
        assert!((weights.log_mean - (-1e6 + 2.0_f64.ln())).abs() < 1e-9);
    }

    #[test]
    fn one_particle_has_all_the_weight() {
        let weights = normalized(&[f64::NEG_INFINITY, 5.0, f64::NAN]).unwrap();
        assert_eq!(weights.values, vec![0.0, 1.0, 0.0]);
        assert_eq!(weights.effective_sample_size, 1.0);
        assert!(weights.are_uneven(0.34) && !weights.are_uneven(0.33) && weights.are_uneven(1.0));
    }

    #[test]
    fn the_evidence_is_what_the_mean_weight_has_gained() {
        let mut weights = Weights::default();
        weights.restart(2);
        let gained = weights.renormalize(&[0.0, 2.0_f64.ln()], 0).unwrap();
        assert!((gained - 1.5_f64.ln()).abs() < 1e-15);
        assert!((weights.renormalize(&[1.0, 1.0 + 2.0_f64.ln()], 1).unwrap() - 1.0).abs() < 1e-15);
    }

    #[test]
    fn no_weight_at_all_is_an_error_with_the_step() {
        assert_eq!(normalized(&[f64::NEG_INFINITY; 3]), Err(Error::AllWeightsZero { step: 9 }));
        assert_eq!(normalized(&[f64::NAN; 2]), Err(Error::AllWeightsZero { step: 9 }));
    }
}
