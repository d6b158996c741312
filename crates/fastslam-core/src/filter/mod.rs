//! The filter: particles over paths, and per particle a map of small Gaussians.

mod adaptive;
mod appearance;
mod beginning;
mod beliefs;
mod doubtful;
mod doubts;
mod estimate;
mod examine;
mod existence;
mod extent;
mod fading;
mod given;
mod identified;
mod landmarks;
mod looking;
mod merger;
mod merging;
mod names;
mod need;
mod ordinary;
mod particles;
mod rejuvenation;
mod scan;
mod scan_methods;
mod seen;
pub mod settings;
mod snapshot;
mod state;
mod usable;
mod work;

pub(crate) use beliefs::draw as draw_pose;

pub use crate::association::Identities;
pub use crate::sighting::{Seen, Sighting, Skipped, Taken};
pub use crate::step_info::{LeftOut, MapChanges, NoiseInWindow, Sampling, StepInfo, Weighing};
pub use estimate::{MapEstimate, MapLandmark};
pub use given::GivenUse;
pub use particles::{mixture, Particles, PoseEstimate};
pub(crate) use usable::usable;

use crate::association::Rules;
use crate::config::{Algorithm, Config};
use crate::diagnosis::health::Vitals;
use crate::diagnosis::{NoiseReport, TwoPlaces};
use crate::error::{Error, Result};
use crate::geometry::Pose;
use crate::limits::LARGEST_STATE;
use crate::measurement::{MeasurementModel, RangeBearing};
use crate::motion::{MotionByNoise, MotionGaussian, PoseColumns, RowPart};
use crate::path::PathForest;
use crate::random::{Purpose, RandomSource};
use crate::store::StoreUsage;
use crate::workers::{Workers, PART};
use landmarks::Landmarks;
use state::State;
use work::Work;

/// Above this spread of the heading the motion since the last sighting is sampled rather than linearised on.
const LARGEST_LINEARISED_HEADING_STD_RAD: f64 = 0.2;

/// FastSLAM 1.0 and 2.0.
///
/// ```
/// use fastslam_core::{config::Config, filter::{FastSlam, Identities, Sighting}};
/// let mut filter = FastSlam::new(Config::default(), Identities::All)?;
/// filter.predict([1.0, 0.1, 0.0], 0.1)?;
/// let tree = Sighting::range_bearing(4.0, 0.3, Some(7));
/// let info = filter.update(0.1, &[tree])?;
/// assert_eq!((info.changes.new_landmarks, filter.map().landmarks.len()), (1, 1));
/// # Ok::<(), fastslam_core::error::Error>(())
/// ```
///
/// `state` is what a later step needs of the earlier ones, and nothing else; `work` is memory that is kept, and what
/// it holds counts for nothing once a step is done.
pub struct FastSlam<M = RangeBearing> {
    models: Models<M>,
    settings: Settings,
    state: State,
    work: Work,
    workers: Workers,
}

/// How the robot sees.
#[derive(Clone, Debug)]
struct Models<M> {
    measurement: M,
    T_robot_sensor: Pose,
    /// How far the sensor stands from the robot's origin.
    lever_arm_m: f64,
}

/// What was configured, with what follows from it.
#[derive(Clone, Debug)]
struct Settings {
    config: Config,
    identities: Identities,
    rules: Rules,
    /// Reach of the association in standard deviations.
    gate_radius: f64,
    random: RandomSource,
}

impl FastSlam {
    /// A filter at the configured initial pose with empty maps.
    ///
    /// `identities` says which sightings will come with one; `Config::association.mode = unknown` overrules it.
    pub fn new(config: Config, identities: Identities) -> Result<Self> {
        config.sensor.check_places()?;
        let model = config.sensor.range_bearing();
        Self::with_model(config, identities, model)
    }
}

impl<M: Clone> Clone for FastSlam<M> {
    /// An independent filter in the same state, which goes on to the same bits.
    fn clone(&self) -> Self {
        let (models, settings, workers) = (self.models.clone(), self.settings.clone(), self.workers.clone());
        Self { models, settings, state: self.state.clone(), work: Work::new(&workers), workers }
    }
}

impl<M: MeasurementModel> FastSlam<M> {
    /// A filter for any measurement model, which brings its own noise; of `Config::sensor` the limits, the tail and
    /// the mounting count.
    pub fn with_model(config: Config, identities: Identities, model: M) -> Result<Self> {
        config.validate()?;
        if config.algorithm == Algorithm::Ekf {
            return Err(Error::parameter("algorithm", "ekf", "fastslam1 or fastslam2; EKF-SLAM is a type of its own"));
        }
        let identities = identities.heeding(config.association.mode);
        let rules = Rules::new(&config, &model);
        let gate_radius = rules.gate_radius(&model, config.sensor.tail());
        let workers = Workers::new(config.filter.threads)?;
        let cell_m = (4.0 * gate_radius * model.noise_covariance().xx.sqrt()).clamp(0.5, 20.0);
        let mut landmarks = Landmarks::new(&config, identities, cell_m, gate_radius);
        landmarks.set_workers(&workers);
        let models = Models {
            measurement: model,
            T_robot_sensor: config.sensor.mounting.T_robot_sensor(),
            lever_arm_m: config.sensor.mounting.x_m.hypot(config.sensor.mounting.y_m),
        };
        let random = RandomSource::new(config.seed);
        let (state, work) = (State::new(&config, identities, landmarks), Work::new(&workers));
        Ok(Self { models, settings: Settings { config, identities, rules, gate_radius, random }, state, work, workers })
    }

    /// The configuration in force.
    pub fn config(&self) -> &Config {
        &self.settings.config
    }

    /// Moves the robot by one control (columns of the motion model) that acts for `dt_s`: a whole row.
    pub fn predict(&mut self, control: [f64; 3], dt_s: f64) -> Result<()> {
        self.advance(&RowPart::whole(control, dt_s))
    }

    /// Moves the robot by a row of odometry, or a part of it.
    ///
    /// FastSLAM 1.0 samples every particle's pose now; 2.0 keeps the motion as a Gaussian until sightings come.
    ///
    /// **Errors:** [`Error::Input`] for a control that no robot could follow; the filter is then as it was.
    pub fn advance(&mut self, part: &RowPart) -> Result<()> {
        let (motion, by_noise) = self.settings.config.motion.with_noises(part)?;
        match self.settings.config.algorithm {
            Algorithm::Fastslam1 => {
                let stream = self.settings.random.stream(Purpose::Motion, self.state.counters.controls);
                let Particles { x, y, heading, .. } = &mut self.state.particles;
                let whole = [x, y, heading].map(Vec::as_mut_slice);
                self.workers.share(whole, PART, &|first, [x, y, heading]| {
                    let first_particle = first as u32;
                    motion.sample(stream, PoseColumns { first_particle, x, y, heading });
                });
            }
            _ => self.state.motions.pending = self.state.motions.pending.then(&motion).checked(part)?,
        }
        self.state.motions.since_scan = self.state.motions.since_scan.then(&by_noise);
        self.remember_motion(&motion);
        self.state.counters.controls += 1;
        Ok(())
    }

    /// Processes all sightings of one stamp (there may be none).
    ///
    /// **Errors:** [`Error::Input`] for a class beyond those configured; [`Error::AllWeightsZero`] when no particle can
    /// explain the sightings; [`Error::NotFinite`] when the step would leave a number that is none. The filter is then
    /// as it was before the scan, and can go on. Only after numbers that are none from a measurement model of one's own
    /// all particles count the same, and landmarks at no place that can be computed with are gone.
    pub fn update(&mut self, stamp_s: f64, sightings: &[Sighting]) -> Result<StepInfo> {
        self.settings.config.association.check_classes(sightings)?;
        let mut info = StepInfo { step: self.state.counters.steps, ..StepInfo::default() };
        let mut rounds = std::mem::take(&mut self.work.rounds);
        let used = self.fill_rounds(&mut rounds, sightings, &mut info.left_out.skipped);
        let done = self.take_in(stamp_s, &mut rounds[..used], &mut info);
        self.work.rounds = rounds;
        done.map(|()| info)
    }

    /// Processes the scan, in rounds that see each identity once at most.
    fn process_rounds(
        &mut self,
        stamp_s: f64,
        rounds: &mut [Vec<scan::ScanSighting>],
        info: &mut StepInfo,
    ) -> Result<()> {
        self.work.seen.clear();
        if self.settings.identities == Identities::All {
            rounds.iter_mut().for_each(|round| self.doubt_names(round, info));
        }
        info.sightings = rounds.iter().map(|round| round.len() as u32).sum();
        self.state.diagnosis.watch.begin(stamp_s, info.sightings);
        let births_before = self.state.landmarks.births();
        // The names of a whole round may have been doubted.
        info.sampling.sampled = !rounds.iter().all(|round| self.keeps_motion_pending(round));
        rounds.iter().try_for_each(|round| self.process(round, info))?;
        if self.settings.identities == Identities::All {
            self.see_identified(rounds, births_before);
        }
        if info.sampling.sampled {
            let particles = &self.state.particles;
            self.state.path.extend(stamp_s, &self.workers, |i| particles.pose(i));
            self.remember_step();
            if self.rejuvenation_is_due() {
                info.sampling.rejuvenated |= self.rejuvenate();
                info.changes.merged += self.closed();
            }
        }
        info.landmarks = self.state.particles.landmarks[self.state.particles.best()];
        self.judge_health(stamp_s, births_before, info);
        self.state.counters.steps += 1;
        Ok(())
    }

    /// After a scan to which a measurement model of one's own left no particle any weight: what the scan did to weights is
    /// undone by forgetting them all, and what it did to maps by forgetting the landmarks that it made unusable.
    fn start_anew_with_weights(&mut self) {
        self.state.particles.log_weight.fill(0.0);
        self.state.particles.score.fill(0.0);
        self.restart_weights();
        let mut row = vec![0.0; self.state.landmarks.columns()];
        for slot in self.state.landmarks.live_slots() {
            let holders: Vec<usize> =
                (0..self.state.particles.len()).filter(|i| self.state.landmarks.read_row(slot, *i, &mut row)).collect();
            if self.state.landmarks.read(slot).is_within(LARGEST_STATE) {
                continue;
            }
            holders.into_iter().for_each(|i| self.state.particles.landmarks[i] -= 1);
            self.state.landmarks.remove(slot);
        }
        self.estimate_beliefs();
    }

    /// Parts the usable sightings into scans that see each identity once at most; returns how many there are, one at
    /// least.
    ///
    /// **Why:** two sightings with one identity are not independent given the pose's prior: the second waits for the
    /// first.
    fn fill_rounds(
        &self,
        rounds: &mut Vec<Vec<scan::ScanSighting>>,
        sightings: &[Sighting],
        skipped: &mut Skipped,
    ) -> usize {
        rounds.iter_mut().for_each(Vec::clear);
        if rounds.is_empty() {
            rounds.push(Vec::new());
        }
        let mut used = 1;
        for sighting in
            usable(&self.settings.config.sensor, self.settings.identities, &self.models.measurement, sightings, skipped)
        {
            let free = |round: &Vec<scan::ScanSighting>| {
                sighting.identity.is_none() || round.iter().all(|s| s.identity != sighting.identity)
            };
            let round = rounds[..used].iter().position(free).unwrap_or(used);
            if round == rounds.len() {
                rounds.push(Vec::new());
            }
            rounds[round].push(sighting);
            used = used.max(round + 1);
        }
        used
    }

    /// One scan with at most one sighting per identity.
    fn process(&mut self, scan: &[scan::ScanSighting], info: &mut StepInfo) -> Result<()> {
        match (self.settings.config.algorithm, self.settings.identities) {
            _ if self.keeps_motion_pending(scan) => {
                let before = self.state.weights.log_mean;
                info.weighing.effective_sample_size = self.weights_now()?;
                info.weighing.log_likelihood += self.state.weights.log_mean - before;
                self.estimate_beliefs();
                Ok(())
            }
            (algorithm, Identities::All) => {
                self.examine_identified(scan);
                if algorithm == Algorithm::Fastslam1 {
                    self.step_identified_1(scan, info)
                } else {
                    self.step_identified_2(scan, info)
                }
            }
            _ => self.step_associating(scan, info),
        }
    }

    /// Whether a step without sightings leaves the poses unsampled: later sightings may still say where they were.
    fn keeps_motion_pending(&self, scan: &[scan::ScanSighting]) -> bool {
        self.settings.config.algorithm == Algorithm::Fastslam2
            && scan.is_empty()
            && self.state.motions.pending.covariance[2][2].sqrt() < LARGEST_LINEARISED_HEADING_STD_RAD
    }

    /// Normalises the weights and returns the effective sample size.
    fn weights_now(&mut self) -> Result<f64> {
        self.state.weights.normalize(&self.state.particles.log_weight, self.state.counters.steps)?;
        Ok(self.state.weights.effective_sample_size)
    }

    /// Resamples if the effective sample size says so; everything that belongs to a particle follows its ancestor.
    ///
    /// The weights must have been normalised. Returns whether it resampled.
    fn resample_if_needed(&mut self, info: &mut StepInfo) -> bool {
        let count = self.state.particles.len();
        info.weighing.effective_sample_size = self.state.weights.effective_sample_size;
        let settings = &self.settings.config.filter.resampling;
        // Without sightings the weights are what they were, but for rounding.
        let low = settings.threshold >= 1.0 || info.weighing.effective_sample_size < settings.threshold * count as f64;
        if info.sightings == 0 || !low {
            return false;
        }
        let stream = self.settings.random.stream(Purpose::Resampling, self.state.counters.samplings);
        let drawn = &mut self.work.ancestor_indices;
        self.work.resampler.draw(settings.scheme, &self.state.weights.values, count, stream, drawn);
        let most = self.settings.config.filter.particles as usize;
        let enough =
            self.settings.config.filter.adaptive.count(&self.state.particles, &self.work.ancestor_indices, most);
        if enough != count {
            let drawn = &mut self.work.ancestor_indices;
            self.work.resampler.draw(settings.scheme, &self.state.weights.values, enough, stream, drawn);
        }
        let State { particles, landmarks, path, .. } = &mut self.state;
        let ancestor_indices = &self.work.ancestor_indices;
        self.workers.both(
            count,
            || path.resample(ancestor_indices),
            || {
                particles.resample(ancestor_indices);
                landmarks.resample(ancestor_indices);
            },
        );
        self.work.log_likelihood.resize(enough, 0.0);
        self.resample_history();
        info.weighing.resampled = true;
        true
    }

    /// Gives the verdict on a step.
    fn judge_health(&mut self, stamp_s: f64, births_before: u64, info: &mut StepInfo) {
        info.sampling.particles = self.state.particles.len() as u32;
        info.matched = self.state.diagnosis.watch.matches() as u32;
        if self.state.diagnosis.watch.noise.is_report_due() {
            self.state.diagnosis.noise_report = self.state.diagnosis.watch.noise.of_window();
        }
        if info.sightings > 0 {
            self.state.motions.since_scan = MotionByNoise::default();
        }
        info.noise = NoiseInWindow::from(&self.state.diagnosis.noise_report);
        let vitals = Vitals {
            stamp_s,
            particles: self.state.particles.len(),
            effective_sample_size: info.weighing.effective_sample_size,
            T_world_robot: self.state.estimate.mean,
            pose_covariance: self.state.estimate.covariance,
            births_before,
            names_known: self.settings.identities == Identities::All,
            map_in_view: self.work.map_in_view.take(),
        };
        let model = &self.models.measurement;
        info.health = self.state.diagnosis.watch.judge(&vitals, |sensor, value| model.inverse(sensor, value));
    }

    /// What the innovations of the whole run say of the configured noise.
    pub fn noise_report(&self) -> NoiseReport {
        self.state.diagnosis.watch.noise.of_run()
    }

    /// Names that were seen at two places.
    pub fn two_places(&self) -> Vec<TwoPlaces> {
        self.state.diagnosis.watch.names.two_places()
    }

    /// Mean and covariance of the pose, motion since the last sampling included.
    pub fn pose(&self) -> PoseEstimate {
        self.state.estimate
    }

    /// The particles. In FastSLAM 2.0 their poses are those at the last sighting.
    pub fn particles(&self) -> &Particles {
        &self.state.particles
    }

    /// Normalised weights of the particles.
    pub fn weights(&self) -> &[f64] {
        &self.state.weights.values
    }

    /// Motion since the poses were last sampled (zero in FastSLAM 1.0).
    pub fn pending_motion(&self) -> MotionGaussian {
        self.state.motions.pending
    }

    /// The paths of the particles.
    pub fn path(&self) -> &PathForest {
        &self.state.path
    }

    /// What the maps occupy.
    pub fn store_usage(&self) -> StoreUsage {
        self.state.landmarks.usage()
    }
}
