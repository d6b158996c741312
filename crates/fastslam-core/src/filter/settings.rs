//! Particles, resampling and storage: the settings.

use crate::error::{fraction, non_negative, positive, Error, Result};
use crate::resampling::ResamplingScheme;
use crate::store::StoreKind;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Scans that may pass before a draw is taken over: all of them wait in memory.
const MOST_DELAY_SCANS: u32 = 10_000;
/// Fewer would leave a draw next to nothing of a loop.
const FEWEST_KEYFRAMES: u32 = 20;

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

/// When all particles are drawn anew from the posterior over whole paths, given the best particle's associations.
///
/// It undoes what resampling loses: after a late loop closure the whole path moves, not only the present pose. It
/// remembers all motions and sightings, and a draw takes time in proportion to them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct RejuvenationConfig {
    /// Draw by a schedule: fewest steps (with sightings) between two draws; 0 for none at all, the plain filter. Without
    /// it draws follow need: a loop in sight, landmarks founded where old ones may lie, names that show how far the robot
    /// has drifted, the end of the log.
    pub every_steps: Option<u32>,
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
    /// Steps that the past keeps. Where it has as many, older ones are thinned to keyframes spread evenly over the time,
    /// with those that few landmarks are known by, and what was sighted in between is forgotten: a draw takes no longer
    /// then, however long the log.
    pub keyframes: u32,
    /// Do draws between two steps beside the filter, and take over what comes of one so many scans later; with 0 the step
    /// that asks for a draw does it. The map and the smoothed path are the same; until then the live estimate does not know
    /// of the draw, and no step takes longer for it.
    pub delay_scans: u32,
}

impl RejuvenationConfig {
    /// Whether a draw by schedule is due after so many steps, the last one having been after so many.
    pub(crate) fn is_due(&self, every: u32, steps: f64, last: f64) -> bool {
        steps - last >= f64::from(every).max(self.growth * last)
    }
}

impl Default for RejuvenationConfig {
    fn default() -> Self {
        Self {
            every_steps: None,
            growth: 0.05,
            spread: 1.0,
            closing_odds: 1000.0,
            window_steps: None,
            keyframes: 20_000,
            delay_scans: 0,
        }
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

impl FilterConfig {
    pub(crate) fn validate(&self) -> Result<()> {
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
        if non_negative("rejuvenation.closing_odds", odds)? < 1.0 && odds != 0.0 {
            return Err(Error::parameter("rejuvenation.closing_odds", odds, "0, or at least 1"));
        }
        if self.rejuvenation.window_steps == Some(0) {
            return Err(Error::parameter("rejuvenation.window_steps", 0, "at least 1"));
        }
        if self.rejuvenation.keyframes < FEWEST_KEYFRAMES {
            let fewest = format!("at least {FEWEST_KEYFRAMES}");
            return Err(Error::parameter("rejuvenation.keyframes", self.rejuvenation.keyframes, fewest));
        }
        if self.rejuvenation.delay_scans > MOST_DELAY_SCANS {
            let most = format!("0 to {MOST_DELAY_SCANS}");
            return Err(Error::parameter("rejuvenation.delay_scans", self.rejuvenation.delay_scans, most));
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
