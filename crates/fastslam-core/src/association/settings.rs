//! The settings of association beyond its gates.

use crate::error::{finite, positive, Error, Result};
use crate::math;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// How a particle chooses between the explanations of its sightings.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Method {
    /// The likeliest landmark of each sighting, one sighting after the other.
    #[default]
    MaximumLikelihood,
    /// A landmark drawn in proportion to its likelihood, one sighting after the other; the gates are not used. For
    /// many particles: where a scan is ambiguous they try all explanations, and later sightings choose.
    Sampled,
    /// The likeliest explanation of all sightings of a scan together, each landmark explaining at most one.
    Assignment,
    /// The largest set of sightings that agree with each other under one pose (joint compatibility); for scans of up
    /// to 15 sightings with a candidate, larger ones as with `maximum_likelihood`, and counted.
    Joint,
}

/// Classes that a detector reports: the colour of a cone, the kind of a sign.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Classes {
    /// How many there are.
    pub number: u32,
    /// Probability that the reported class is the true one; the others share the rest.
    pub correct_probability: f64,
}

impl Default for Classes {
    fn default() -> Self {
        Self { number: 2, correct_probability: 0.9 }
    }
}

/// More classes than this are not kept.
const MOST_CLASSES: u32 = 64;

impl Classes {
    pub(crate) fn validate(&self) -> Result<()> {
        if !(2..=MOST_CLASSES).contains(&self.number) {
            return Err(Error::parameter("number", self.number, format!("2 to {MOST_CLASSES}")));
        }
        let chance = 1.0 / f64::from(self.number);
        if !(self.correct_probability >= chance && self.correct_probability < 1.0) {
            let expected = format!("at least {chance} (chance), below 1");
            return Err(Error::parameter("correct_probability", self.correct_probability, expected));
        }
        Ok(())
    }

    /// Probability that `reported` is reported of a landmark of class `truth`.
    pub fn confusion(&self, reported: u32, truth: u32) -> f64 {
        if reported == truth {
            self.correct_probability
        } else {
            (1.0 - self.correct_probability) / f64::from(self.number - 1)
        }
    }
}

/// A number that a detector measures of a landmark and that stays the same: the diameter of a trunk.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Signatures {
    /// Standard deviation of one measurement, in the unit of the signature.
    pub std: f64,
    /// Width of the range in which the signatures of landmarks and of clutter lie.
    pub spread: f64,
}

impl Default for Signatures {
    fn default() -> Self {
        Self { std: 0.1, spread: 1.0 }
    }
}

impl Signatures {
    pub(crate) fn validate(&self) -> Result<()> {
        positive("std", self.std)?;
        positive("spread", self.spread)?;
        Ok(())
    }

    /// ln of the density of one measurement at its true value over that of any signature.
    pub fn log_peak(&self) -> f64 {
        math::ln(self.spread / self.std) - 0.5 * crate::landmark::LN_TAU
    }
}

/// What a detector reports of a landmark beside its place.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Appearance {
    /// Which class, from 0.
    pub class: Option<u32>,
    /// A number that belongs to the landmark.
    pub signature: Option<f64>,
}

/// When two landmarks of one map become one.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Merging {
    /// Whether landmarks are merged.
    pub rule: MergingRule,
    /// Two landmarks are one when their difference lies in the region that holds this probability.
    pub gate_probability: f64,
    /// Added to the standard deviations of the two places: what a particle does not know of its own error.
    pub tolerance_std_m: f64,
}

impl Default for Merging {
    fn default() -> Self {
        Self { rule: MergingRule::default(), gate_probability: 0.95, tolerance_std_m: 0.0 }
    }
}

/// Whether landmarks are merged.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum MergingRule {
    /// Never.
    #[default]
    Never,
    /// Landmarks that lie together and are hardly ever sighted in one scan; and, without a change to any particle, the
    /// landmarks that different particles created for one thing.
    Nearby,
}

impl Merging {
    pub(crate) fn validate(&self) -> Result<()> {
        if !(self.gate_probability > 0.0 && self.gate_probability < 1.0) {
            return Err(Error::parameter("gate_probability", self.gate_probability, "above 0, below 1"));
        }
        if self.tolerance_std_m != 0.0 {
            positive("tolerance_std_m", self.tolerance_std_m)?;
        }
        Ok(())
    }
}

/// How the log-odds of existence change.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ExistenceForm {
    /// By fixed numbers, as in the paper.
    #[default]
    Counted,
    /// By Bayes' rule, from `association.detection_probability` and `association.clutter_density`, which it needs.
    Bayes,
}

/// The probability that belongs to log-odds.
#[inline(always)]
pub(crate) fn logistic(log_odds: f64) -> f64 {
    1.0 / (1.0 + math::exp(-log_odds))
}

/// ln of a probability or a density that must be a finite number above 0, and below `limit`.
pub(crate) fn validate_below(key: &'static str, value: Option<f64>, limit: f64) -> Result<()> {
    match value {
        Some(value) if !(value > 0.0 && value < limit) => {
            Err(Error::parameter(key, value, format!("above 0, below {limit}")))
        }
        Some(value) => finite(key, value).map(|_| ()),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn confusions_sum_to_one() {
        let classes = Classes { number: 3, correct_probability: 0.9 };
        for truth in 0..3 {
            let sum: f64 = (0..3).map(|reported| classes.confusion(reported, truth)).sum();
            assert!((sum - 1.0).abs() < 1e-15);
        }
        assert!((classes.confusion(0, 1) - 0.05).abs() < 1e-15);
    }

    #[test]
    fn impossible_settings_name_their_key() {
        let message = |result: Result<()>| result.map_err(|e| e.to_string()).unwrap_err();
        let classes = Classes { number: 4, correct_probability: 0.2 };
        assert!(message(classes.validate()).starts_with("correct_probability: got 0.2"));
        assert!(message(Classes { number: 1, ..Classes::default() }.validate()).starts_with("number: got 1"));
        assert!(message(Signatures { std: 0.0, spread: 1.0 }.validate()).starts_with("std: got 0"));
        let merging = Merging { gate_probability: 1.0, ..Merging::default() };
        assert!(message(merging.validate()).starts_with("gate_probability: got 1"));
    }
}
