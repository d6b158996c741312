//! The filter: particles over paths, and per particle a map of small Gaussians.

mod adaptive;
mod appearance;
mod beliefs;
mod estimate;
mod examine;
mod existence;
mod extent;
mod identified;
mod landmarks;
mod merging;
mod names;
mod particles;
mod rejuvenation;
mod scan;
mod scan_methods;
pub mod settings;
mod usable;

pub use crate::association::Identities;
pub use crate::sighting::{Sighting, Skipped};
pub use crate::step_info::StepInfo;
pub use estimate::{MapEstimate, MapLandmark};
pub use particles::{mixture, Particles, PoseEstimate};
pub(crate) use usable::usable;

use crate::association::{fast, CandidateTable, Decision, FitTable, Rules, Scratch};
use crate::config::{Algorithm, Config};
use crate::diagnosis::health::{MapInView, View, Vitals, Watch};
use crate::diagnosis::{NoiseReport, TwoPlaces};
use crate::error::{Error, Result, LARGEST_MAGNITUDE};
use crate::geometry::Pose;
use crate::landmark::SensorPoses;
use crate::measurement::{MeasurementModel, RangeBearing};
use crate::motion::{MotionByNoise, MotionGaussian, PoseColumns, RowPart};
use crate::path::PathForest;
use crate::random::{Purpose, RandomSource};
use crate::resampling::Resampler;
use crate::store::StoreUsage;
use crate::weights::Weights;
use crate::workers::{PerThread, Workers, PART};
use appearance::Appearances;
use beliefs::Beliefs;
use examine::Examination;
use existence::Judging;
use landmarks::Landmarks;
use merging::Merger;
use rejuvenation::Rejuvenation;

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
/// assert_eq!((info.new_landmarks, filter.map().landmarks.len()), (1, 1));
/// # Ok::<(), fastslam_core::error::Error>(())
/// ```
pub struct FastSlam<M = RangeBearing> {
    config: Config,
    identities: Identities,
    model: M,
    T_robot_sensor: Pose,
    lever_arm_m: f64,
    rules: Rules,
    /// Reach of the association in standard deviations.
    gate_radius: f64,
    random: RandomSource,
    particles: Particles,
    /// Motion since the last sampling of the poses, the same for all particles (FastSLAM 2.0).
    pending: MotionGaussian,
    /// Motion since the last scan, for the noise check.
    motion_since_scan: MotionByNoise,
    controls: u64,
    samplings: u64,
    steps: u64,
    landmarks: Landmarks,
    workers: Workers,
    path: PathForest,
    /// What is remembered to draw paths anew; only when that is configured.
    rejuvenation: Option<Rejuvenation>,
    weights: Weights,
    ancestor_indices: Vec<u32>,
    resampler: Resampler,
    sensor_poses: SensorPoses,
    beliefs: Beliefs,
    /// The sightings of the step, each identity once in each; kept for their memory.
    rounds: Vec<Vec<scan::ScanSighting>>,
    /// Landmarks that the last scan may have shown; kept for its memory.
    table: CandidateTable,
    /// How well the candidates of the scan fit.
    fits: FitTable,
    /// What deciding needs to remember.
    deciding: PerThread<(fast::Workspace, Scratch)>,
    /// What each particle decided about the scan, an equal share each; kept for its memory.
    decisions: Vec<Decision>,
    former_decisions: Vec<Decision>,
    /// For one sighting, the numbers of the decisions and whether they are the one at hand; kept for their memory.
    decided: Vec<u32>,
    /// Sightings of known landmarks with the births of these; kept for its memory.
    matches: Vec<([f64; 2], u64)>,
    /// Landmarks that there were before each sighting of the scan; kept for its memory.
    births: Vec<u64>,
    mask: Vec<bool>,
    /// Landmarks that the scan may show; kept for its memory.
    slots: Vec<u32>,
    /// Log-likelihood of the scan's sighting of every candidate in every map; only where existence follows Bayes' rule.
    sighting_densities: Vec<f64>,
    /// Sightings of the scan that founded a landmark in some map, with its slot.
    founded: Vec<(usize, u32)>,
    merger: Merger,
    judging: Judging,
    examination: Examination,
    /// Of the step's sightings, per particle.
    log_likelihood: Vec<f64>,
    estimate: PoseEstimate,
    scratch: Vec<f64>,
    /// Whether all this can be believed.
    watch: Watch,
    /// What the sliding window said of the noise when it was last looked at.
    noise_report: NoiseReport,
    /// Landmarks of the map that the scan should have shown, where that was looked at.
    map_in_view: Option<MapInView>,
}

impl FastSlam {
    /// A filter at the configured initial pose with empty maps.
    ///
    /// `identities` says which sightings will come with one; `Config::association.mode = unknown` overrules it.
    pub fn new(config: Config, identities: Identities) -> Result<Self> {
        let model = config.sensor.range_bearing();
        Self::with_model(config, identities, model)
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
        let start = config.initial_pose.T_world_robot();
        let particles = config.filter.particles as usize;
        let gate_radius = rules.gate_radius(&model, config.sensor.tail());
        let noise = model.noise_covariance();
        let workers = Workers::new(config.filter.threads)?;
        let cell_m = (4.0 * gate_radius * noise.xx.sqrt()).clamp(0.5, 20.0);
        let mut landmarks = Landmarks::new(config.filter.store, particles, identities, cell_m, gate_radius);
        landmarks.set_workers(&workers);
        landmarks.appearances = Appearances::new(config.filter.store, particles, &config.association);
        Ok(Self {
            landmarks,
            lever_arm_m: config.sensor.mounting.x_m.hypot(config.sensor.mounting.y_m),
            T_robot_sensor: config.sensor.mounting.T_robot_sensor(),
            gate_radius,
            random: RandomSource::new(config.seed),
            particles: Particles::at(start, particles),
            pending: MotionGaussian::default(),
            motion_since_scan: MotionByNoise::default(),
            controls: 0,
            samplings: 0,
            steps: 0,
            path: PathForest::new(particles),
            rejuvenation: (config.filter.rejuvenation.every_steps > 0).then(|| Rejuvenation::new(particles)),
            weights: Weights { values: vec![1.0 / particles as f64; particles], ..Weights::default() },
            ancestor_indices: Vec::with_capacity(particles),
            resampler: Resampler::default(),
            sensor_poses: SensorPoses::default(),
            beliefs: Beliefs::default(),
            rounds: Vec::new(),
            table: CandidateTable::default(),
            fits: FitTable::default(),
            deciding: PerThread::new(&workers),
            decisions: Vec::new(),
            former_decisions: Vec::new(),
            decided: Vec::new(),
            births: Vec::new(),
            matches: Vec::new(),
            mask: Vec::new(),
            slots: Vec::new(),
            sighting_densities: Vec::new(),
            founded: Vec::new(),
            merger: Merger::default(),
            judging: Judging::default(),
            examination: Examination::default(),
            log_likelihood: Vec::with_capacity(particles),
            estimate: PoseEstimate { mean: start, ..PoseEstimate::default() },
            scratch: Vec::new(),
            watch: Watch::new(config.health, View::of(&config)),
            noise_report: NoiseReport::default(),
            map_in_view: None,
            identities,
            model,
            rules,
            workers,
            config,
        })
    }

    /// The configuration in force.
    pub fn config(&self) -> &Config {
        &self.config
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
        let (motion, by_noise) = self.config.motion.with_noises(part)?;
        match self.config.algorithm {
            Algorithm::Fastslam1 => {
                let stream = self.random.stream(Purpose::Motion, self.controls);
                let Particles { x, y, heading, .. } = &mut self.particles;
                let whole = [x, y, heading].map(Vec::as_mut_slice);
                self.workers.share(whole, PART, &|first, [x, y, heading]| {
                    let first_particle = first as u32;
                    motion.sample(stream, PoseColumns { first_particle, x, y, heading });
                });
            }
            _ => self.pending = self.pending.then(&motion).checked(part)?,
        }
        self.motion_since_scan = self.motion_since_scan.then(&by_noise);
        self.remember_motion(&motion);
        self.controls += 1;
        Ok(())
    }

    /// Processes all sightings of one stamp (there may be none).
    ///
    /// **Errors:** [`Error::Input`] for a class beyond those configured; the filter is then as it was.
    /// [`Error::AllWeightsZero`] when no particle can explain the sightings: then all particles count the same from
    /// here, landmarks at no place that can be computed with are gone, the step does not count and is no part of the path, and the
    /// filter can go on.
    pub fn update(&mut self, stamp_s: f64, sightings: &[Sighting]) -> Result<StepInfo> {
        self.config.association.check_classes(sightings)?;
        let mut info = StepInfo { step: self.steps, ..StepInfo::default() };
        let mut rounds = std::mem::take(&mut self.rounds);
        let used = self.fill_rounds(&mut rounds, sightings, &mut info.skipped);
        if self.identities == Identities::All {
            rounds[..used].iter_mut().for_each(|round| self.doubt_names(round, &mut info));
        }
        info.sightings = rounds[..used].iter().map(|round| round.len() as u32).sum();
        self.watch.begin(stamp_s, info.sightings);
        let births_before = self.landmarks.births();
        info.sampled = !self.keeps_motion_pending(&rounds[0]);
        let done = rounds[..used].iter().try_for_each(|round| self.process(round, &mut info));
        self.rounds = rounds;
        if let Err(error) = done {
            self.start_anew_with_weights();
            return Err(error);
        }
        if info.sampled {
            let particles = &self.particles;
            self.path.extend(stamp_s, &self.workers, |i| particles.pose(i));
            self.remember_step();
            if self.rejuvenation_is_due() {
                info.rejuvenated = self.rejuvenate();
                info.merged += self.closed();
            }
        }
        info.landmarks = self.particles.landmarks[self.particles.best()];
        self.judge_health(stamp_s, births_before, &mut info);
        self.steps += 1;
        Ok(info)
    }

    /// After a scan that left no particle any weight: what the scan did to weights is undone by forgetting them all, and
    /// what it did to maps by forgetting the landmarks that it made unusable.
    fn start_anew_with_weights(&mut self) {
        self.particles.log_weight.fill(0.0);
        self.particles.score.fill(0.0);
        self.restart_weights();
        let mut row = vec![0.0; self.landmarks.columns()];
        for slot in self.landmarks.live_slots() {
            let holders: Vec<usize> =
                (0..self.particles.len()).filter(|i| self.landmarks.read_row(slot, *i, &mut row)).collect();
            if self.landmarks.read(slot).is_within(LARGEST_MAGNITUDE) {
                continue;
            }
            holders.into_iter().for_each(|i| self.particles.landmarks[i] -= 1);
            self.landmarks.remove(slot);
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
        for sighting in usable(&self.config.sensor, self.identities, &self.model, sightings, skipped) {
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
        match (self.config.algorithm, self.identities) {
            _ if self.keeps_motion_pending(scan) => {
                let before = self.weights.log_mean;
                info.effective_sample_size = self.weights_now()?;
                info.log_likelihood += self.weights.log_mean - before;
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
        self.config.algorithm == Algorithm::Fastslam2
            && scan.is_empty()
            && self.pending.covariance[2][2].sqrt() < LARGEST_LINEARISED_HEADING_STD_RAD
    }

    /// Normalises the weights and returns the effective sample size.
    fn weights_now(&mut self) -> Result<f64> {
        self.weights.normalize(&self.particles.log_weight, self.steps)?;
        Ok(self.weights.effective_sample_size)
    }

    /// Resamples if the effective sample size says so; everything that belongs to a particle follows its ancestor.
    ///
    /// The weights must have been normalised. Returns whether it resampled.
    fn resample_if_needed(&mut self, info: &mut StepInfo) -> bool {
        let count = self.particles.len();
        info.effective_sample_size = self.weights.effective_sample_size;
        let settings = &self.config.filter.resampling;
        // Without sightings the weights are what they were, but for rounding.
        let low = settings.threshold >= 1.0 || info.effective_sample_size < settings.threshold * count as f64;
        if info.sightings == 0 || !low {
            return false;
        }
        let stream = self.random.stream(Purpose::Resampling, self.samplings);
        let drawn = &mut self.ancestor_indices;
        self.resampler.draw(settings.scheme, &self.weights.values, count, stream, drawn);
        let most = self.config.filter.particles as usize;
        let enough = self.config.filter.adaptive.count(&self.particles, &self.ancestor_indices, most);
        if enough != count {
            let drawn = &mut self.ancestor_indices;
            self.resampler.draw(settings.scheme, &self.weights.values, enough, stream, drawn);
        }
        let Self { particles, landmarks, path, ancestor_indices, .. } = self;
        self.workers.both(
            count,
            || path.resample(ancestor_indices),
            || {
                particles.resample(ancestor_indices);
                landmarks.resample(ancestor_indices);
            },
        );
        self.log_likelihood.resize(enough, 0.0);
        self.resample_history();
        info.resampled = true;
        true
    }

    /// Gives the verdict on a step.
    fn judge_health(&mut self, stamp_s: f64, births_before: u64, info: &mut StepInfo) {
        info.particles = self.particles.len() as u32;
        info.matched = self.watch.matches() as u32;
        if self.watch.noise.is_report_due() {
            self.noise_report = self.watch.noise.of_window();
        }
        if info.sightings > 0 {
            self.motion_since_scan = MotionByNoise::default();
        }
        (info.nis, info.nis_band) = (self.noise_report.nis, self.noise_report.band);
        info.noise_warnings = self.noise_report.warnings;
        let vitals = Vitals {
            stamp_s,
            particles: self.particles.len(),
            effective_sample_size: info.effective_sample_size,
            T_world_robot: self.estimate.mean,
            pose_covariance: self.estimate.covariance,
            births_before,
            names_known: self.identities == Identities::All,
            map_in_view: self.map_in_view.take(),
        };
        let model = &self.model;
        info.health = self.watch.judge(&vitals, |sensor, value| model.inverse(sensor, value));
    }

    /// What the innovations of the whole run say of the configured noise.
    pub fn noise_report(&self) -> NoiseReport {
        self.watch.noise.of_run()
    }

    /// Names that were seen at two places.
    pub fn two_places(&self) -> Vec<TwoPlaces> {
        self.watch.names.two_places()
    }

    /// Mean and covariance of the pose, motion since the last sampling included.
    pub fn pose(&self) -> PoseEstimate {
        self.estimate
    }

    /// The particles. In FastSLAM 2.0 their poses are those at the last sighting.
    pub fn particles(&self) -> &Particles {
        &self.particles
    }

    /// Normalised weights of the particles.
    pub fn weights(&self) -> &[f64] {
        &self.weights.values
    }

    /// Motion since the poses were last sampled (zero in FastSLAM 1.0).
    pub fn pending_motion(&self) -> MotionGaussian {
        self.pending
    }

    /// The paths of the particles.
    pub fn path(&self) -> &PathForest {
        &self.path
    }

    /// What the maps occupy.
    pub fn store_usage(&self) -> StoreUsage {
        self.landmarks.usage()
    }
}
