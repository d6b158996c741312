//! What landmarks look like: the settings.

use crate::error::{positive, Error, Result};
use crate::math;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

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
    pub(super) fn validate(&self) -> Result<()> {
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
    pub(super) fn validate(&self) -> Result<()> {
        positive("std", self.std)?;
        positive("spread", self.spread)?;
        Ok(())
    }

    /// ln of the density of one measurement at its true value over that of any signature.
    pub fn log_peak(&self) -> f64 {
        math::ln(self.spread / self.std) - 0.5 * crate::density::LN_TAU
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
}
