//! The particle filter for sensors of which one sighting does not place a landmark: range alone, bearing alone, or a
//! sensor of one's own. Landmarks are known by name; of bearings every particle decides itself where they have none
//! ([`choose`]).
//!
//! As in FastSLAM a particle is a path with a map of independent landmarks; here a landmark may be a mixture of Gaussians
//! ([`place`]): a ring or a ray, of which the evidence leaves one. Scale and bias of the sensor are part of a particle.
//! What is lost by resampling is drawn anew from the posterior over the whole path ([`graph`], [`anew`]).
//!
//! It is a filter beside [`crate::filter::FastSlam`], and not a case of it, since there a landmark is one row of fixed
//! columns in kernels over all particles, which is what makes it fast; see `docs/adr/0008-partial-sensors.md`.
//!
//! **Source:** `blanco2008efficient` for rings of Gaussians within particles.

mod anew;
mod choose;
mod estimate;
mod gauge;
mod graph;
mod past;
mod place;
mod scan;
mod sensing;
mod state;
mod story;
mod unnamed;

pub use sensing::{Calibration, Look, Request, Sensing};

use crate::association::Identities;
use crate::belief::Belief;
use crate::config::{Algorithm, AssociationMode, Config, ParticleNumber};
use crate::error::{Error, Result};
use crate::filter::{draw_pose, StepInfo};
use crate::geometry::Pose;
use crate::limits::LARGEST_STATE;
use crate::measurement::{BearingOnly, BearingSensor, RangeErrors, RangeOnly, RangeSensor, Sensor};
use crate::motion::RowPart;
use crate::random::{Purpose, RandomSource};
use crate::sighting::Sighting;
use crate::snapshot::{content, open, seal, Head, Holds};
use crate::workers::Workers;
use graph::Prior;
use state::{Cloud, State, Unnamed};

/// What a sensor that reports ranges alone may be off by where the configuration does not say: 5 % and half a metre.
const USUAL_STD: [f64; 2] = [0.05, 0.5];

/// FastSLAM with landmarks that a sighting does not place.
///
/// ```
/// use fastslam_core::{config::Config, measurement::{SensorModel, SensorSettings}, partial::PartialSlam, sighting::Sighting};
/// let sensor = SensorSettings { model: SensorModel::Range, ..Default::default() }.into();
/// let config = Config { sensor, ..Config::default() };
/// let mut filter = PartialSlam::range_only(config)?;
/// filter.update(0.0, &[Sighting::range(4.0, Some(7))])?;
/// assert!(!filter.map().landmarks[0].confirmed); // Somewhere on a ring.
/// # Ok::<(), fastslam_core::error::Error>(())
/// ```
pub struct PartialSlam<S, const Z: usize> {
    config: Config,
    sensor: S,
    T_robot_sensor: Pose,
    prior: Prior,
    random: RandomSource,
    workers: Workers,
    state: State,
}

impl PartialSlam<RangeOnly, 1> {
    /// A filter on ranges alone, at the configured initial pose with an empty map.
    ///
    /// **Errors:** an invalid configuration, or one that asks for what this filter cannot do.
    pub fn range_only(config: Config) -> Result<Self> {
        match config.sensor {
            Sensor::Range(RangeSensor { model, .. }) => Self::learning(config, model),
            other => Err(Error::parameter("sensor.model", other.model().name(), "range")),
        }
    }
}

impl PartialSlam<BearingOnly, 1> {
    /// A filter on bearings alone, at the configured initial pose with an empty map. Landmarks lie within the configured
    /// limits of the range.
    ///
    /// **Errors:** as [`PartialSlam::range_only`].
    pub fn bearing_only(config: Config) -> Result<Self> {
        check_names(&config)?;
        Self::on_bearings(config)
    }

    fn on_bearings(config: Config) -> Result<Self> {
        let Sensor::Bearing(BearingSensor { bearing_std_rad, bearing_bias_rad, common }) = config.sensor else {
            return Err(Error::parameter("sensor.model", config.sensor.model().name(), "bearing"));
        };
        let (nearest_m, farthest_m) = (common.min_range_m, common.max_range_m);
        if nearest_m > farthest_m {
            let expected = format!("at most sensor.max_range_m = {farthest_m}");
            return Err(Error::parameter("sensor.min_range_m", nearest_m, expected));
        }
        let model = BearingOnly { bearing_std_rad, nearest_m, farthest_m };
        let mean = Calibration { scale: 1.0, bias: bearing_bias_rad };
        Self::with_sensor(config, model, Prior { mean, std: [0.0; 2] })
    }

    /// The same where sightings have no names, or those are not used: every particle decides what they show.
    ///
    /// **Errors:** as [`PartialSlam::range_only`].
    pub fn bearing_only_unnamed(config: Config) -> Result<Self> {
        let mut filter = Self::on_bearings(config)?;
        filter.state.unnamed = Some(Unnamed::new(filter.config.filter.particles as usize));
        Ok(filter)
    }
}

impl<S: Sensing<Z>, const Z: usize> PartialSlam<S, Z> {
    /// A filter for a sensor of one's own whose first number is a range of which scale and bias are to be learned, as
    /// `Config::sensor` says. It brings its own noise; the limits, the tail and the mounting are those of `Config::sensor`.
    ///
    /// **Errors:** as [`PartialSlam::range_only`].
    pub fn learning(config: Config, sensor: S) -> Result<Self> {
        check_names(&config)?;
        let RangeErrors { range_scale, range_bias_m, range_scale_std, range_bias_std_m } = config.sensor.range_errors();
        let std = [range_scale_std, range_bias_std_m];
        let std = std::array::from_fn(|i| std[i].unwrap_or(USUAL_STD[i]));
        let mean = Calibration { scale: range_scale, bias: range_bias_m };
        Self::with_sensor(config, sensor, Prior { mean, std })
    }

    /// A filter for a sensor of one's own that reports what is true; otherwise as [`PartialSlam::learning`].
    ///
    /// **Errors:** as [`PartialSlam::range_only`].
    pub fn new(config: Config, sensor: S) -> Result<Self> {
        check_names(&config)?;
        Self::with_sensor(config, sensor, Prior { mean: Calibration::NONE, std: [0.0; 2] })
    }

    fn with_sensor(config: Config, sensor: S, prior: Prior) -> Result<Self> {
        config.validate()?;
        check(&config)?;
        let random = RandomSource::new(config.seed);
        let state = State::new(&config, vec![prior.mean; config.filter.particles as usize]);
        let workers = Workers::new(1)?;
        let T_robot_sensor = config.sensor.T_robot_sensor();
        Ok(Self { config, sensor, T_robot_sensor, prior, random, workers, state })
    }

    /// The configuration in force.
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// Moves the robot by a row of odometry, or a part of it.
    ///
    /// **Errors:** [`Error::Input`] for a control that no robot could follow; the filter is then as it was.
    pub fn advance(&mut self, part: &RowPart) -> Result<()> {
        let motion = self.config.motion.of(part)?;
        self.state.cloud.pending = self.state.cloud.pending.then(&motion).checked(part)?;
        Ok(())
    }

    /// Processes all sightings of one stamp (there may be none).
    ///
    /// **Errors:** [`Error::AllWeightsZero`] when no particle can explain the sightings, [`Error::NotFinite`] when the step
    /// would leave a number that is none, and what a sensor of one's own reports. The filter is then as it was, to the
    /// last bit.
    pub fn update(&mut self, stamp_s: f64, sightings: &[Sighting]) -> Result<StepInfo> {
        let before = self.state.before(self.draw_is_due_after(1));
        let done = self.take_in(stamp_s, sightings);
        if done.is_err() {
            self.state.go_back(before);
        }
        done
    }

    /// Draws the poses from the beliefs. As long as nothing is weighed the first particle is where it most likely is, so
    /// that a first guess of the path is at hand.
    fn sample(&mut self, beliefs: &[Belief]) {
        let learning = self.is_learning();
        let stream = self.random.stream(Purpose::Proposal, self.state.counters.samplings);
        for (i, belief) in beliefs.iter().enumerate() {
            let ([a, b], [c, _]) = (stream.normal_pair(i as u32, 0), stream.normal_pair(i as u32, 1));
            let likeliest = learning && i == 0;
            let pose = if likeliest { belief.mean } else { draw_pose(belief, [a, b, c]) };
            self.state.cloud.particles.set_pose(i, pose);
        }
        self.state.counters.samplings += 1;
    }

    /// Errors unless all numbers of the particles can be computed with.
    fn check_numbers(&self) -> Result<()> {
        let step = self.state.counters.steps;
        let cloud = &self.state.cloud;
        let sound = |values: &[f64]| values.iter().all(|v| v.abs() <= LARGEST_STATE);
        let Cloud { particles, maps, .. } = cloud;
        for (what, sound) in [
            ("a pose", sound(&particles.x) && sound(&particles.y) && sound(&particles.heading)),
            ("the pose", sound(&cloud.estimate.mean.to_array()) && cloud.estimate.covariance.iter().all(|r| sound(r))),
            ("a landmark", maps.iter().flatten().all(place::Place::is_usable)),
        ] {
            if !sound {
                return Err(Error::NotFinite { step, what });
            }
        }
        Ok(())
    }

    /// The state as bytes, from which [`PartialSlam::restore`] goes on to the same bits; `note` is kept in its head.
    pub fn save(&self, note: &str) -> Result<Vec<u8>> {
        let head = Head::new(&self.config, self.identities(), note)?;
        match &self.state.unnamed {
            Some(unnamed) => seal(&head, &(&self.state, unnamed)),
            None => seal(&head, &self.state),
        }
    }

    /// Takes over a state that was saved by a filter of this configuration and sensor.
    ///
    /// **Errors:** [`Error::Input`] when the bytes are no snapshot, of another format, damaged, or of another
    /// configuration; the filter is then as it was.
    pub fn restore(&mut self, snapshot: &[u8]) -> Result<()> {
        let (head, stored) = open(snapshot, Holds::Filter)?;
        head.check(&self.config, self.identities())?;
        if self.state.unnamed.is_none() {
            self.state = content(&stored)?;
        } else {
            let (state, unnamed): (State, Unnamed) = content(&stored)?;
            self.state = State { unnamed: Some(unnamed), ..state };
        }
        Ok(())
    }

    /// Which sightings it takes to have a name.
    fn identities(&self) -> Identities {
        match self.state.unnamed {
            Some(_) => Identities::None,
            None => Identities::All,
        }
    }
}

/// Errors that name what this filter cannot do.
fn check(config: &Config) -> Result<()> {
    let only = "with sensors that do not place a landmark";
    if config.algorithm == Algorithm::Ekf {
        return Err(Error::parameter("algorithm", "ekf", format!("fastslam1 or fastslam2 {only}")));
    }
    if config.filter.adaptive.number != ParticleNumber::Fixed {
        return Err(Error::parameter("filter.adaptive.number", "kld", format!("fixed {only}")));
    }
    Ok(())
}

/// An error where names are not to be used.
fn check_names(config: &Config) -> Result<()> {
    if config.association.mode == AssociationMode::Known {
        return Ok(());
    }
    let expected = "known identities with sensors that do not place a landmark, but for bearings alone";
    Err(Error::parameter("association.mode", "unknown", expected))
}
