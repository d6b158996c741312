//! When landmarks become one: the settings.

use crate::error::{positive, Error, Result};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

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
    pub(super) fn validate(&self) -> Result<()> {
        if !(self.gate_probability > 0.0 && self.gate_probability < 1.0) {
            return Err(Error::parameter("gate_probability", self.gate_probability, "above 0, below 1"));
        }
        if self.tolerance_std_m != 0.0 {
            positive("tolerance_std_m", self.tolerance_std_m)?;
        }
        Ok(())
    }
}
