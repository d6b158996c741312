//! The one configuration schema. Python and the command line read it from here.

use crate::association::validate_below;
pub use crate::association::{Classes, ExistenceForm, Merging, MergingRule, Method, Signatures};
use crate::error::{finite, positive, Error, Result};
use crate::filter::Sighting;
use crate::geometry::Pose;
use crate::measurement::Sensor;
use crate::motion::Motion;
use crate::resampling::ResamplingScheme;
use crate::store::StoreKind;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Everything that determines a run, given its log.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    /// Seed of all random numbers: the same seed gives the same bits.
    pub seed: u64,
    /// Which filter.
    pub algorithm: Algorithm,
    /// Particles, resampling and storage.
    pub filter: FilterConfig,
    /// How the robot moves.
    pub motion: Motion,
    /// What the robot sees with.
    pub sensor: Sensor,
    /// Which landmark a sighting belongs to.
    pub association: AssociationConfig,
    /// Where the robot starts; it defines the world frame.
    pub initial_pose: InitialPose,
    /// From where on the filter says that it should not be believed; changes no estimate.
    pub health: HealthConfig,
}

/// The algorithms.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Algorithm {
    /// Poses are drawn from the motion model and weighed by the sightings.
    Fastslam1,
    /// Poses are drawn from the motion model conditioned on the sightings.
    #[default]
    Fastslam2,
    /// The extended Kalman filter over the pose and all landmarks together, with their full covariance: O(K²) per
    /// sighting. Particles, resampling and stores mean nothing to it, and it never removes a landmark.
    Ekf,
}

/// Particles, resampling and storage.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct FilterConfig {
    /// Number of particles (M); the start and the most where the number adapts.
    pub particles: u32,
    /// Whether and how the number of particles follows the spread of the poses.
    pub adaptive: AdaptiveConfig,
    /// How the maps are stored; changes speed and memory, never a result.
    pub store: StoreKind,
    /// Worker threads, which share the particles among them; they change speed, never a result.
    pub threads: u32,
    /// When and how to resample.
    pub resampling: ResamplingConfig,
    /// Power to which each sighting's likelihood is raised: 1 is Bayes' rule; 0.2 to 0.5 suits sightings so dense that
    /// their errors repeat.
    pub likelihood_exponent: f64,
    /// When all particles are drawn anew from the posterior over whole paths.
    pub rejuvenation: RejuvenationConfig,
    /// Longest time between recorded poses: a gap without sightings is filled with steps this far apart.
    pub path_period_s: f64,
}

impl Default for FilterConfig {
    fn default() -> Self {
        Self {
            particles: 100,
            adaptive: AdaptiveConfig::default(),
            store: StoreKind::default(),
            threads: 1,
            resampling: ResamplingConfig::default(),
            likelihood_exponent: 1.0,
            rejuvenation: RejuvenationConfig::default(),
            path_period_s: 0.5,
        }
    }
}

/// Whether the number of particles stays as it is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ParticleNumber {
    /// Always `filter.particles`.
    #[default]
    Fixed,
    /// At every resampling as many as the spread of the poses needs (KLD sampling).
    Kld,
}

/// How many particles are kept.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct AdaptiveConfig {
    /// Whether the number follows the spread.
    pub number: ParticleNumber,
    /// Fewest particles.
    pub minimum: u32,
    /// Side of a bin of positions: smaller bins make more particles.
    pub bin_m: f64,
    /// Width of a bin of headings.
    pub bin_rad: f64,
    /// Largest divergence (Kullback and Leibler) between the particles and what they sample.
    pub epsilon: f64,
    /// Probability with which it may be larger.
    pub delta: f64,
}

impl Default for AdaptiveConfig {
    fn default() -> Self {
        Self { number: ParticleNumber::default(), minimum: 10, bin_m: 0.2, bin_rad: 0.05, epsilon: 0.1, delta: 0.01 }
    }
}

/// From where on the filter says that it should not be believed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct HealthConfig {
    /// Steps with sightings over which most of what follows is averaged.
    pub window_steps: u32,
    /// Degraded when squared innovations, normalised, are on average this many times what the noise explains; lost
    /// from four times as many.
    pub largest_innovation_ratio: f64,
    /// Degraded when the effective sample size is on average below this fraction of ten or more particles.
    pub smallest_effective_fraction: f64,
    /// Degraded when nothing was sighted for longer than this.
    pub longest_blindness_s: f64,
    /// Degraded when this fraction of the sightings shows no known landmark where known ones should be in view; lost
    /// halfway from here to all.
    pub largest_unexplained_fraction: f64,
    /// Degraded when the landmarks of the map in view are sighted this many times as often as usual, or less.
    pub smallest_detection_ratio: f64,
    /// Degraded when the position's standard deviation along its longest axis is above this; lost from three times as
    /// much.
    pub largest_position_std_m: f64,
    /// Degraded when the heading's standard deviation is above this; lost from three times as much.
    pub largest_heading_std_rad: f64,
}

impl Default for HealthConfig {
    fn default() -> Self {
        Self {
            window_steps: 20,
            largest_innovation_ratio: 4.0,
            smallest_effective_fraction: 0.02,
            longest_blindness_s: 10.0,
            largest_unexplained_fraction: 0.6,
            smallest_detection_ratio: 0.4,
            largest_position_std_m: 5.0,
            largest_heading_std_rad: 0.3,
        }
    }
}

/// When all particles are drawn anew from the posterior over whole paths, given the best particle's associations.
///
/// It undoes what resampling loses: after a late loop closure the whole path moves, not only the present pose. It
/// remembers all motions and sightings, and a draw takes time in proportion to them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct RejuvenationConfig {
    /// Fewest steps (with sightings) between two draws; 0 for none at all.
    pub every_steps: u32,
    /// Fewest steps between two draws as a fraction of the log so far: with more than 0 the time for all draws together
    /// stays in proportion to the log.
    pub growth: f64,
    /// How far the draws lie from the most probable path: 1 as far as the posterior says. Less keeps the estimate nearer
    /// to it when the next resamplings leave few of the draws, and makes its covariance too small.
    pub spread: f64,
    /// Before a draw, make landmarks of the map one where that is so many times likelier than that they are two: it
    /// closes loops that the associations missed. 0 for never; only where identities are not all known.
    pub closing_odds: f64,
    /// Draw only the poses of this many latest steps and hold the older ones; the whole path without it.
    pub window_steps: Option<u32>,
}

impl Default for RejuvenationConfig {
    fn default() -> Self {
        Self { every_steps: 0, growth: 0.05, spread: 1.0, closing_odds: 1000.0, window_steps: None }
    }
}

/// When and how to resample.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ResamplingConfig {
    /// How ancestors are drawn.
    pub scheme: ResamplingScheme,
    /// Resample when the effective sample size is below this fraction of the particles; 1 resamples at every step
    /// with sightings.
    pub threshold: f64,
}

impl Default for ResamplingConfig {
    fn default() -> Self {
        Self { scheme: ResamplingScheme::Systematic, threshold: 0.5 }
    }
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
    /// Probability that a landmark in view is sighted. With it, a particle whose map holds landmarks in view that were
    /// not sighted loses weight.
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
    #[default]
    Never,
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

/// A pose of the robot in the world.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct InitialPose {
    /// East or along the map's first axis.
    pub x_m: f64,
    /// North or along the map's second axis.
    pub y_m: f64,
    /// Counter-clockwise from the first axis.
    pub heading_rad: f64,
}

impl InitialPose {
    /// As a transform.
    pub fn T_world_robot(&self) -> Pose {
        Pose::new(self.x_m, self.y_m, crate::math::wrap_angle(self.heading_rad))
    }
}

impl Config {
    /// Errors that name the first key out of range.
    pub fn validate(&self) -> Result<()> {
        self.filter.validate().map_err(|e| e.within("filter"))?;
        self.motion.validate()?;
        self.sensor.validate()?;
        self.association.validate().map_err(|e| e.within("association"))?;
        if self.algorithm == Algorithm::Ekf {
            self.association.validate_for_ekf().map_err(|e| e.within("association"))?;
        }
        for (key, value) in [
            ("initial_pose.x_m", self.initial_pose.x_m),
            ("initial_pose.y_m", self.initial_pose.y_m),
            ("initial_pose.heading_rad", self.initial_pose.heading_rad),
        ] {
            finite(key, value)?;
        }
        self.health.validate().map_err(|e| e.within("health"))
    }
}

impl FilterConfig {
    fn validate(&self) -> Result<()> {
        if self.particles == 0 || self.particles > 10_000_000 {
            return Err(Error::parameter("particles", self.particles, "1 to 10,000,000"));
        }
        if self.threads == 0 || self.threads > 1024 {
            return Err(Error::parameter("threads", self.threads, "1 to 1024"));
        }
        fraction("resampling.threshold", self.resampling.threshold)?;
        if !(self.likelihood_exponent > 0.0 && self.likelihood_exponent <= 1.0) {
            return Err(Error::parameter("likelihood_exponent", self.likelihood_exponent, "above 0, at most 1"));
        }
        fraction("rejuvenation.growth", self.rejuvenation.growth)?;
        fraction("rejuvenation.spread", self.rejuvenation.spread)?;
        let odds = self.rejuvenation.closing_odds;
        if !(odds == 0.0 || odds >= 1.0 && odds.is_finite()) {
            return Err(Error::parameter("rejuvenation.closing_odds", odds, "0, or at least 1"));
        }
        if self.rejuvenation.window_steps == Some(0) {
            return Err(Error::parameter("rejuvenation.window_steps", 0, "at least 1"));
        }
        positive("path_period_s", self.path_period_s)?;
        self.adaptive.validate().map_err(|e| e.within("adaptive"))
    }
}

impl AdaptiveConfig {
    fn validate(&self) -> Result<()> {
        if self.minimum == 0 {
            return Err(Error::parameter("minimum", 0, "at least 1"));
        }
        positive("bin_m", self.bin_m)?;
        positive("bin_rad", self.bin_rad)?;
        positive("epsilon", self.epsilon)?;
        if !(self.delta > 0.0 && self.delta < 0.5) {
            return Err(Error::parameter("delta", self.delta, "above 0, below 0.5"));
        }
        Ok(())
    }
}

impl HealthConfig {
    fn validate(&self) -> Result<()> {
        if self.window_steps == 0 {
            return Err(Error::parameter("window_steps", 0, "at least 1"));
        }
        positive("largest_innovation_ratio", self.largest_innovation_ratio)?;
        fraction("smallest_effective_fraction", self.smallest_effective_fraction)?;
        positive("longest_blindness_s", self.longest_blindness_s)?;
        fraction("largest_unexplained_fraction", self.largest_unexplained_fraction)?;
        fraction("smallest_detection_ratio", self.smallest_detection_ratio)?;
        positive("largest_position_std_m", self.largest_position_std_m)?;
        positive("largest_heading_std_rad", self.largest_heading_std_rad)?;
        Ok(())
    }
}

impl AssociationConfig {
    fn validate(&self) -> Result<()> {
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
    pub(crate) fn check_classes(&self, sightings: &[Sighting]) -> Result<()> {
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
    fn validate_for_ekf(&self) -> Result<()> {
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

    /// ln of the most by which anything but the place can raise the likelihood of a landmark.
    pub(crate) fn log_most_evidence(&self) -> f64 {
        let odds = self.detection_probability.map_or(0.0, |p| crate::math::ln(p / (1.0 - p)).max(0.0));
        let classes = self.classes.as_ref().map_or(0.0, |c| crate::math::ln(f64::from(c.number)));
        let signatures = self.signatures.as_ref().map_or(0.0, |s| s.log_peak().max(0.0));
        odds + classes + signatures
    }
}

impl ExistenceConfig {
    fn validate(&self) -> Result<()> {
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
        if !(self.highest_log_odds >= self.initial_log_odds && self.highest_log_odds.is_finite()) {
            return Err(Error::parameter("highest_log_odds", self.highest_log_odds, "at least initial_log_odds"));
        }
        Ok(())
    }
}

fn fraction(key: &str, value: f64) -> Result<f64> {
    if (0.0..=1.0).contains(&value) {
        Ok(value)
    } else {
        Err(Error::parameter(key, value, "0 to 1"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_defaults_are_valid() {
        assert_eq!(Config::default().validate(), Ok(()));
    }

    #[test]
    fn unknown_keys_are_rejected_at_every_level() {
        for text in [
            r#"{"sead": 1}"#,
            r#"{"filter": {"partikles": 1}}"#,
            r#"{"motion": {"model": "velocity", "wheelbase_m": 1}}"#,
            r#"{"sensor": {"mounting": {"z_m": 1}}}"#,
        ] {
            assert!(serde_json::from_str::<Config>(text).is_err(), "{text}");
        }
    }

    #[test]
    fn the_key_of_a_bad_value_is_named() {
        let mut config = Config::default();
        config.sensor.range_std_m = 0.0;
        assert_eq!(
            config.validate().map_err(|e| e.to_string()),
            Err("sensor.range_std_m: got 0, expected a finite number above 0".into())
        );
        let mut config = Config::default();
        config.filter.resampling.threshold = 1.5;
        assert_eq!(
            config.validate().map_err(|e| e.to_string()),
            Err("filter.resampling.threshold: got 1.5, expected 0 to 1".into())
        );
    }
}
