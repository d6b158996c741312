//! The life of landmarks: the settings.

use crate::error::{finite, fraction, positive, Error, Result};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The life of landmarks: log-odds of existence, kept per particle, and when a landmark counts as confirmed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ExistenceConfig {
    /// Whether landmarks are ever removed.
    pub removal: Removal,
    /// How the log-odds change.
    pub form: ExistenceForm,
    /// Log-odds of a landmark at its first sighting; `bayes` starts at
    /// ln(`new_landmark_density` / `clutter_density`) instead.
    pub initial_log_odds: f64,
    /// Added by every sighting (`counted`).
    pub sighted_log_odds: f64,
    /// Taken away by every scan in which the landmark is in view and not sighted (`counted`).
    pub missed_log_odds: f64,
    /// Below this a landmark is removed. `bayes` removes it as far below its own beginning as this lies below
    /// `initial_log_odds`.
    pub lowest_log_odds: f64,
    /// A landmark is provisional until it was sighted so often. Provisional landmarks are marked in the map and are
    /// no part of its evaluation.
    pub confirmed_sightings: u32,
    /// With `bayes`, a landmark is provisional below this as well.
    pub confirmed_log_odds: f64,
    /// More than this is not counted, so that a landmark that was taken away can still disappear.
    pub highest_log_odds: f64,
    /// In view is only what is nearer than this fraction of the sensor's range.
    pub range_fraction: f64,
    /// In view is only what lies in this fraction of the field of view.
    pub view_fraction: f64,
}

/// Whether landmarks are ever removed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Removal {
    /// Never, as in the original paper.
    Never,
    /// When they were never confirmed, and the sensor should have shown them and did not. How often it shows what is
    /// there, by range and bearing, is learned from the confirmed ones; where that is not known, nothing is removed.
    #[default]
    Unconfirmed,
    /// When they are in view and missed much more often than they are seen. For sensors whose range and field of view
    /// are set as they are, and that see most of what is in view.
    WhenMissed,
}

impl Default for ExistenceConfig {
    fn default() -> Self {
        Self {
            removal: Removal::default(),
            form: ExistenceForm::default(),
            initial_log_odds: 1.0,
            sighted_log_odds: 1.0,
            missed_log_odds: 0.3,
            lowest_log_odds: -0.5,
            confirmed_sightings: 5,
            confirmed_log_odds: 3.0,
            highest_log_odds: 20.0,
            range_fraction: 0.8,
            view_fraction: 0.9,
        }
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

impl ExistenceConfig {
    pub(super) fn validate(&self) -> Result<()> {
        finite("initial_log_odds", self.initial_log_odds)?;
        positive("sighted_log_odds", self.sighted_log_odds)?;
        positive("missed_log_odds", self.missed_log_odds)?;
        fraction("range_fraction", self.range_fraction)?;
        fraction("view_fraction", self.view_fraction)?;
        finite("lowest_log_odds", self.lowest_log_odds)?;
        finite("confirmed_log_odds", self.confirmed_log_odds)?;
        if self.lowest_log_odds >= self.initial_log_odds {
            return Err(Error::parameter("lowest_log_odds", self.lowest_log_odds, "less than initial_log_odds"));
        }
        if finite("highest_log_odds", self.highest_log_odds)? < self.initial_log_odds {
            return Err(Error::parameter("highest_log_odds", self.highest_log_odds, "at least initial_log_odds"));
        }
        Ok(())
    }
}
