//! The settings of association.

mod existence;
mod looks;
mod merging;

pub use existence::{ExistenceConfig, ExistenceForm, Removal};
pub use looks::{Classes, Signatures};
pub use merging::{Merging, MergingRule};

use crate::error::{finite, fraction, positive, Error, Result};
use crate::math;
use crate::sighting::Sighting;
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

/// Whether to use the identities in a log.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum AssociationMode {
    /// Sightings with an identity are believed; those without are associated.
    #[default]
    Known,
    /// Identities are ignored: every particle decides for every sighting.
    Unknown,
}

/// Whether sightings without an identity may come.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Identities {
    /// Every sighting has one.
    All,
    /// Some have one.
    Some,
    /// None has one, or they are ignored.
    None,
}

impl Identities {
    /// What remains of the log's promise under the configured mode.
    pub(crate) fn heeding(self, mode: AssociationMode) -> Self {
        match mode {
            AssociationMode::Known => self,
            AssociationMode::Unknown => Self::None,
        }
    }
}

/// Which landmark a sighting belongs to when nobody says so; decided by every particle for itself.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct AssociationConfig {
    /// Whether to use the identities in the log.
    pub mode: AssociationMode,
    /// How a particle chooses between the explanations of its sightings.
    pub method: Method,
    /// A sighting belongs to its likeliest landmark if it falls into the region that holds this probability; 1 switches
    /// the test off, as in the original paper.
    pub gate_probability: f64,
    /// A sighting is a new landmark when it falls outside the region of every landmark that holds this probability.
    /// Between the two gates it is ignored.
    pub new_landmark_gate_probability: f64,
    /// Likelihood below which a sighting is a new landmark [1/(m·rad)] (the paper's p₀). Without it, the density at the
    /// outer gate of a landmark as uncertain as one sighting.
    pub new_landmark_density: Option<f64>,
    /// Density of false sightings [1/(m·rad)]: those expected in a scan over the sensor's range times its field of
    /// view. With it, a sighting that no landmark explains founds a landmark whose odds of existing are
    /// `new_landmark_density` over this.
    pub clutter_density: Option<f64>,
    /// Probability that a landmark in view is sighted, at best. How probable it is from where is learned from the run all
    /// the same, and never taken to be more. With `existence.form` `bayes`, or another `existence.removal` than
    /// `unconfirmed`, it is that of everything in view: a particle whose map holds landmarks in view that were not sighted
    /// loses weight.
    pub detection_probability: Option<f64>,
    /// Classes that the detector reports. Without it they are not used.
    pub classes: Option<Classes>,
    /// The signature that the detector measures. Without it none is used.
    pub signatures: Option<Signatures>,
    /// When two landmarks of one map become one.
    pub merging: Merging,
    /// What one landmark may explain in one scan.
    pub exclusion: Exclusion,
    /// In which order the sightings of a scan are decided.
    pub order: AssociationOrder,
    /// How landmarks that should be seen and are not disappear; only where identities are not all known.
    pub existence: ExistenceConfig,
}

/// What one landmark may explain in one scan.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Exclusion {
    /// At most one sighting.
    #[default]
    OneSighting,
    /// Any number of sightings.
    None,
}

/// In which order the sightings of a scan are decided.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum AssociationOrder {
    /// As they come in the log.
    Given,
    /// The least ambiguous first, with the pose refined by it before the rest are judged again (FastSLAM 2.0).
    #[default]
    LeastAmbiguousFirst,
}

impl Default for AssociationConfig {
    fn default() -> Self {
        Self {
            mode: AssociationMode::Known,
            method: Method::default(),
            gate_probability: 0.99,
            new_landmark_gate_probability: 0.999_99,
            new_landmark_density: None,
            clutter_density: None,
            detection_probability: None,
            classes: None,
            signatures: None,
            merging: Merging::default(),
            exclusion: Exclusion::default(),
            order: AssociationOrder::default(),
            existence: ExistenceConfig::default(),
        }
    }
}

impl AssociationConfig {
    pub(crate) fn validate(&self) -> Result<()> {
        fraction("gate_probability", self.gate_probability)?;
        fraction("new_landmark_gate_probability", self.new_landmark_gate_probability)?;
        if self.new_landmark_gate_probability >= 1.0 {
            return Err(Error::parameter("new_landmark_gate_probability", 1, "below 1"));
        }
        if let Some(density) = self.new_landmark_density {
            positive("new_landmark_density", density)?;
        }
        validate_below("clutter_density", self.clutter_density, f64::INFINITY)?;
        validate_below("detection_probability", self.detection_probability, 1.0)?;
        self.classes.as_ref().map_or(Ok(()), Classes::validate).map_err(|e| e.within("classes"))?;
        self.signatures.as_ref().map_or(Ok(()), Signatures::validate).map_err(|e| e.within("signatures"))?;
        self.merging.validate().map_err(|e| e.within("merging"))?;
        if self.existence.form == ExistenceForm::Bayes {
            for (key, value) in
                [("detection_probability", self.detection_probability), ("clutter_density", self.clutter_density)]
            {
                if value.is_none() {
                    return Err(Error::parameter(key, "nothing", "a number, which existence.form bayes needs"));
                }
            }
        }
        self.existence.validate().map_err(|e| e.within("existence"))
    }

    /// An error when a sighting's class is beyond those configured.
    pub fn check_classes(&self, sightings: &[Sighting]) -> Result<()> {
        let Some(classes) = &self.classes else { return Ok(()) };
        match sightings.iter().find_map(|s| s.appearance.class.filter(|class| *class >= classes.number)) {
            Some(class) => Err(Error::Input(format!(
                "class {class} of a sighting: expected 0 to {} (association.classes.number)",
                classes.number - 1
            ))),
            None => Ok(()),
        }
    }

    /// EKF-SLAM knows one way of association and keeps its landmarks for ever.
    pub(crate) fn validate_for_ekf(&self) -> Result<()> {
        let default = Self::default();
        let only = "its default with algorithm ekf";
        if self.method != default.method {
            return Err(Error::parameter("method", format!("{:?}", self.method).to_lowercase(), only));
        }
        for (key, given) in [
            ("detection_probability", self.detection_probability.is_some()),
            ("classes", self.classes.is_some()),
            ("signatures", self.signatures.is_some()),
            ("merging.rule", self.merging.rule != default.merging.rule),
        ] {
            if given {
                return Err(Error::parameter(key, "a value", only));
            }
        }
        Ok(())
    }

    /// The probability that whatever is in view is sighted, where that is told of all of it; else it is learned from where
    /// the sensor shows how much.
    pub(crate) fn detection_of_all_in_view(&self) -> Option<f64> {
        let is_learned =
            self.existence.removal == Removal::Unconfirmed && self.existence.form == ExistenceForm::Counted;
        self.detection_probability.filter(|_| !is_learned)
    }

    /// ln of the most by which anything but the place can raise the likelihood of a landmark.
    pub(crate) fn log_most_evidence(&self) -> f64 {
        let odds = self.detection_of_all_in_view().map_or(0.0, |p| math::ln(p / (1.0 - p)).max(0.0));
        let classes = self.classes.as_ref().map_or(0.0, |c| math::ln(f64::from(c.number)));
        let signatures = self.signatures.as_ref().map_or(0.0, |s| s.log_peak().max(0.0));
        odds + classes + signatures
    }
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
