//! EKF-SLAM: one Gaussian over the pose and all landmarks.
//!
//! The baseline that FastSLAM is measured against, on the same models, association and outputs. A sighting costs
//! O(K²) with a small constant: see [`covariance`].

mod associate;
pub mod covariance;
mod look;
mod snapshot;
mod undo;

use crate::association::{by_robot_pose, Appearance, Rules, ScanSighting};
use crate::config::Config;
use crate::diagnosis::by_sensor::BySensor;
use crate::diagnosis::health::{Gaze, View as FieldOfView, Vitals, Watch};
use crate::diagnosis::innovations::PredictedScan;
use crate::diagnosis::misfits::Misplaced;
use crate::diagnosis::names::{Doubt, Misfit, NamedPlace, IMPLAUSIBLE};
use crate::diagnosis::{NoiseReport, TwoPlaces};
use crate::error::{Error, Result};
use crate::filter::{
    shown, usable, Identities, MapEstimate, MapLandmark, PoseEstimate, Scan, Seen, Sighting, StepInfo, Taken,
};
use crate::geometry::{moved_by, Pose, Symmetric2};
use crate::landmark::{fit_with_tail, Fit, Measured};
use crate::limits::LARGEST_STATE;
use crate::math::wrap_angle;
use crate::measurement::{Placing, RangeBearing, RangeOrBearing, Sensor};
use crate::motion::{MotionGaussian, RowPart};
use crate::real::Dual;
use crate::step_info::NoiseInWindow;
use crate::store::StoreUsage;
use covariance::{Covariance, SparseRows, VectorPair, TILE};
use rustc_hash::FxHashMap;
use serde::{Deserialize, Serialize};

/// Row of the first landmark in the state; the pose has three rows and one that is always zero.
const FIRST_LANDMARK: usize = 4;
/// So much below zero may rounding leave the variance of a pose that is certain (square metres or radians).
const LARGEST_ROUNDING: f64 = 1e-12;

/// What is known of a landmark besides its Gaussian.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
struct Landmark {
    /// One more than the identity that it was seen with, 0 for none.
    identity_mark: f64,
    identity: Option<u32>,
    sightings: u32,
    /// Its name was found to stand for another one; the state still holds it, the map does not.
    is_given_up: bool,
}

/// EKF-SLAM with known identities or maximum-likelihood association.
///
/// ```
/// use fastslam_core::{config::Config, ekf_slam::EkfSlam, filter::{Identities, Sighting}};
/// let mut filter = EkfSlam::new(Config::default(), Identities::All)?;
/// filter.predict([1.0, 0.1, 0.0], 0.1)?;
/// let tree = Sighting::range_bearing(4.0, 0.3, Some(7));
/// let info = filter.update(0.1, &[tree])?;
/// assert_eq!((info.changes.new_landmarks, filter.map().landmarks.len()), (1, 1));
/// # Ok::<(), fastslam_core::error::Error>(())
/// ```
pub struct EkfSlam<M = RangeBearing> {
    config: Config,
    identities: Identities,
    /// The sensors, by number.
    eyes: Vec<Eye<M>>,
    /// Which of them made the scan.
    looking: usize,
    state: State,
    gain: VectorPair,
    /// Sightings of known landmarks in this scan.
    seen_again: Vec<SeenAgain>,
    /// What the sightings of the last scan were taken for.
    seen: Vec<Seen>,
    before: undo::Before,
}

/// How one sensor sees, and what follows from it.
struct Eye<M> {
    sensor: Sensor,
    model: M,
    T_robot_sensor: Pose,
    rules: Rules,
}

impl<M: Placing> Eye<M> {
    fn new(config: &Config, sensor: &Sensor, model: M) -> Self {
        let rules = Rules::new(&config.seeing_with(sensor), &model);
        Self { sensor: sensor.clone(), model, T_robot_sensor: sensor.T_robot_sensor(), rules }
    }
}

/// What a step needs of those before it: all that a snapshot holds.
#[derive(Serialize, Deserialize)]
struct State {
    pose: Pose,
    /// Motion since the last update.
    pending: MotionGaussian,
    landmarks: Vec<Landmark>,
    of_identity: FxHashMap<u32, u32>,
    /// Positions of the landmarks, x and y in turn, from row [`FIRST_LANDMARK`] on.
    mean: Vec<f64>,
    covariance: Covariance,
    trail: Vec<(f64, Pose)>,
    steps: u64,
    /// Whether all this can be believed.
    watch: Watch,
    /// What the sliding window said of the noise when it was last looked at.
    noise_report: NoiseReport,
    /// What the watch knows of each of several sensors; behind the others in a snapshot, which older formats did not have.
    #[serde(skip)]
    gazes: BySensor<Gaze>,
}

impl State {
    /// At the configured initial pose with an empty map.
    fn new(config: &Config) -> Self {
        Self {
            pose: config.initial_pose.T_world_robot(),
            pending: MotionGaussian::default(),
            landmarks: Vec::new(),
            of_identity: FxHashMap::default(),
            mean: vec![0.0; TILE],
            covariance: Covariance::new(),
            trail: Vec::new(),
            steps: 0,
            watch: Watch::new(config.health, FieldOfView::of(&config.seeing_with(config.each_sensor()[0]))),
            noise_report: NoiseReport::default(),
            gazes: gazes(config),
        }
    }
}

/// Of sensors that have not looked yet; of the only one nothing stands here.
fn gazes(config: &Config) -> BySensor<Gaze> {
    let gaze = |sensor: &Sensor| Gaze::new(FieldOfView::of(&config.seeing_with(sensor)));
    match config.each_sensor().as_slice() {
        [_] => BySensor::default(),
        several => BySensor::new(several.iter().map(|sensor| gaze(sensor))),
    }
}

/// A sighting of a known landmark: as measured, and how it fitted.
struct SeenAgain {
    value: [f64; 2],
    /// The same with what is not measured as the state had it.
    completed: [f64; 2],
    index: u32,
    innovation: [f64; 2],
    s: Symmetric2,
}

/// A landmark as the state sees it: innovation, its derivative by the state, and its covariance.
struct View {
    innovation: [f64; 2],
    h: SparseRows,
    s: Symmetric2,
}

impl EkfSlam {
    /// A filter at the configured initial pose with an empty map.
    ///
    /// `identities` says which sightings will come with one; `Config::association.mode = unknown` overrules it.
    pub fn new(config: Config, identities: Identities) -> Result<Self> {
        let models = config.each_sensor().into_iter().map(Sensor::range_bearing).collect::<Result<_>>()?;
        Self::with_models(config, identities, models)
    }
}

impl EkfSlam<RangeOrBearing> {
    /// A filter for several sensors (`Config::sensors`), some of which measure ranges or bearings alone: see
    /// [`crate::filter::FastSlam::mixed`].
    pub fn mixed(config: Config, identities: Identities) -> Result<Self> {
        let models = config.each_sensor().into_iter().map(RangeOrBearing::of).collect::<Result<_>>()?;
        Self::with_models(config, identities, models)
    }
}

impl<M: Placing> EkfSlam<M> {
    /// A filter for any measurement model, which brings its own noise; of `Config::sensor` the limits, the tail and
    /// the mounting count.
    pub fn with_model(config: Config, identities: Identities, model: M) -> Result<Self> {
        Self::with_models(config, identities, vec![model])
    }

    /// The same with a model for each sensor.
    fn with_models(config: Config, identities: Identities, models: Vec<M>) -> Result<Self> {
        config.validate()?;
        let sensors = config.each_sensor();
        if sensors.len() != models.len() {
            let expected = format!("as many as measurement models ({})", models.len());
            return Err(Error::parameter("sensors", sensors.len(), expected));
        }
        Ok(Self {
            identities: identities.heeding(config.association.mode),
            eyes: sensors.into_iter().zip(models).map(|(sensor, model)| Eye::new(&config, sensor, model)).collect(),
            looking: 0,
            state: State::new(&config),
            gain: VectorPair::new(),
            seen_again: Vec::new(),
            seen: Vec::new(),
            before: undo::Before::default(),
            config,
        })
    }

    /// How the sensor sees that made the scan.
    fn eye(&self) -> &Eye<M> {
        &self.eyes[self.looking]
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
    /// **Why:** only the pose moves, so controls are gathered at O(1) and enter the joint covariance at the next update.
    pub fn advance(&mut self, part: &RowPart) -> Result<()> {
        let motion = self.config.motion.of(part)?;
        self.state.pending = self.state.pending.then(&motion).checked(part)?;
        Ok(())
    }

    /// Processes all sightings of one stamp (there may be none) of the only sensor, or the first one.
    ///
    /// **Errors:** as [`EkfSlam::take`].
    pub fn update(&mut self, stamp_s: f64, sightings: &[Sighting]) -> Result<StepInfo> {
        self.take(Scan::new(stamp_s, sightings))
    }

    /// Processes all that one sensor saw at one stamp (there may be nothing).
    ///
    /// **Errors:** [`Error::Input`] for a sensor beyond those configured; [`Error::NotPositiveDefinite`] and
    /// [`Error::NotFinite`] when rounding would spoil the state, which then is as it was before the scan, to the last bit.
    pub fn take(&mut self, scan: Scan<'_>) -> Result<StepInfo> {
        self.config.check_sensor(scan.sensor)?;
        self.looking = scan.sensor;
        let State { gazes, watch, .. } = &mut self.state;
        gazes.turn_to(scan.sensor, |gaze| watch.swap(gaze));
        self.remember();
        self.take_in(scan).inspect_err(|_| self.go_back())
    }

    fn take_in(&mut self, Scan { stamp_s, sightings, .. }: Scan<'_>) -> Result<StepInfo> {
        let mut info = StepInfo { step: self.state.steps, ..StepInfo::default() };
        (info.weighing.effective_sample_size, info.sampling.sampled) = (1.0, true);
        let (eye, skipped) = (self.eye(), &mut info.left_out.skipped);
        let mut scan: Vec<_> = usable(&eye.sensor, self.identities, &eye.model, sightings, skipped).collect();
        info.sightings = scan.len() as u32;
        self.seen.clear();
        self.move_pose();
        if self.identities == Identities::All {
            self.doubt_names(&mut scan, &mut info);
        }
        let new = match self.identities {
            Identities::All => self.correct_identified(&scan, &mut info)?,
            _ => self.correct_associated(&scan, &mut info)?,
        };
        let (founds, left_out) = if self.eye().model.places() { (new, 0) } else { (Vec::new(), new.len()) };
        info.left_out.ignored += left_out as u32;
        for sighting in founds {
            match sighting.identity.and_then(|identity| self.state.of_identity.get(&identity).copied()) {
                // A second sighting of a landmark that this scan created.
                Some(index) if self.identities == Identities::All => {
                    info.weighing.log_likelihood +=
                        self.eye().rules.likelihood_exponent * self.correct(index, sighting)?.log_likelihood;
                }
                _ => {
                    let taken = Taken::New(self.state.landmarks.len() as u64);
                    self.seen.push(Seen { value: sighting.measured.value, taken });
                    self.add(sighting);
                    info.changes.new_landmarks += 1;
                }
            }
        }
        self.check_state(&info)?;
        self.state.watch.begin(stamp_s, info.sightings);
        self.note_fits();
        self.note_left_out(&scan);
        info.landmarks = self.state.landmarks.len() as u32;
        self.judge_health(stamp_s, &mut info);
        self.state.trail.push((stamp_s, self.state.pose));
        self.state.steps += 1;
        Ok(info)
    }

    /// Errors unless the pose and the evidence are numbers and every landmark is one and has a variance.
    fn check_state(&self, info: &StepInfo) -> Result<()> {
        let is_number = |value: &f64| value.abs() <= LARGEST_STATE;
        for (what, sound) in [
            ("the pose", self.state.pose.to_array().iter().all(is_number)),
            ("a landmark", self.state.mean.iter().all(is_number)),
            ("the likelihood", info.weighing.log_likelihood.is_finite()),
        ] {
            if !sound {
                return Err(Error::NotFinite { step: self.state.steps, what });
            }
        }
        let variance = |row: usize| self.state.covariance.get(row, row);
        let sound = (0..3).all(|row| (-LARGEST_ROUNDING..=LARGEST_STATE).contains(&variance(row)))
            && (FIRST_LANDMARK..FIRST_LANDMARK + 2 * self.state.landmarks.len())
                .all(|row| variance(row) > 0.0 && variance(row) <= LARGEST_STATE);
        match sound {
            true => Ok(()),
            false => Err(Error::NotPositiveDefinite { step: self.state.steps, what: "the joint covariance" }),
        }
    }

    /// Gives the watch the sightings of known landmarks. Of the noises together, as the joint state does not keep them
    /// apart.
    fn note_fits(&mut self) {
        for SeenAgain { value, completed, index, innovation, s } in self.seen_again.drain(..) {
            self.state.watch.matched(std::iter::once((completed, u64::from(index))), 0);
            self.seen.push(Seen { value, taken: Taken::Landmark(u64::from(index)) });
            let mut scan = PredictedScan::of_sightings(1, self.eyes[self.looking].model.measures());
            scan.predict(0, (innovation, s), Symmetric2::default(), &[[0.0; 3]; 2]);
            self.state.watch.noise.add(&scan);
        }
    }

    /// Takes note of the sightings that were taken for nothing.
    fn note_left_out(&mut self, scan: &[ScanSighting]) {
        for value in scan.iter().map(|sighting| sighting.measured.value) {
            if self.seen.iter().all(|seen| seen.value != value) {
                self.seen.push(Seen { value, taken: Taken::Nothing });
            }
        }
    }

    /// What the usable sightings of the last scan were taken for.
    pub fn seen(&self) -> &[Seen] {
        &self.seen
    }

    /// Gives the verdict on a step.
    fn judge_health(&mut self, stamp_s: f64, info: &mut StepInfo) {
        (info.sampling.particles, info.matched) = (1, self.state.watch.matches() as u32);
        self.state.watch.matched(std::iter::empty(), info.sightings as usize);
        if self.state.watch.noise.is_report_due() {
            self.state.noise_report = self.state.watch.noise.of_window();
        }
        info.noise = NoiseInWindow::from(&self.state.noise_report);
        let births_before = self.state.landmarks.len() as u64 - u64::from(info.changes.new_landmarks);
        let PoseEstimate { mean: T_world_robot, covariance: pose_covariance } = self.pose();
        let (particles, effective_sample_size) = (1, 1.0);
        let map_in_view = self.look_at_map();
        let vitals = Vitals {
            stamp_s,
            particles,
            effective_sample_size,
            T_world_robot,
            pose_covariance,
            births_before,
            names_known: self.identities == Identities::All,
            places: self.eye().model.places(),
            map_in_view,
        };
        let Self { eyes, looking, state, .. } = self;
        let model = &eyes[*looking].model;
        info.health = state.watch.judge(&vitals, |sensor, value| model.inverse(sensor, value));
    }

    /// Leaves out the sightings of a scan that name a landmark which cannot be seen there, while the others fit; gives up
    /// landmarks that were founded by such a sighting.
    fn doubt_names(&mut self, scan: &mut Vec<ScanSighting>, info: &mut StepInfo) {
        let slot = |filter: &Self, sighting: &ScanSighting| {
            sighting.identity.and_then(|identity| Some((identity, *filter.state.of_identity.get(&identity)?)))
        };
        let known: Vec<(usize, u32, u32)> =
            scan.iter().enumerate().filter_map(|(j, s)| slot(self, s).map(|(name, index)| (j, name, index))).collect();
        let excess = self.state.watch.noise.usual_excess();
        let implausible = |&(j, _, index): &(usize, u32, u32)| {
            let view = self.view(index, &scan[j].measured);
            fit_with_tail(view.innovation, view.s, scan[j].measured.tail).mahalanobis_squared > IMPLAUSIBLE * excess
        };
        let misfits: Vec<(usize, u32, u32)> = known.iter().copied().filter(implausible).collect();
        let all: Vec<Misplaced> =
            misfits.iter().map(|(j, name, index)| self.misplaced(&scan[*j].measured, *name, *index)).collect();
        let believed = self.state.watch.names.believe(known.len(), &all, excess);
        for (&(j, identity, index), _) in misfits.iter().zip(believed).rev().filter(|(_, believed)| !believed) {
            let misfit = self.misfit(&scan[j], identity, index);
            // What does not say where a landmark is has none to move.
            let places = self.eye().model.places();
            if places && self.state.watch.names.doubt(&misfit) == Doubt::Move {
                self.state.landmarks[index as usize].is_given_up = true;
                self.state.of_identity.remove(&identity);
            } else {
                let value = scan.remove(j).measured.value;
                self.seen.push(Seen { value, taken: Taken::Nothing });
                info.left_out.ignored += 1;
            }
        }
    }

    /// Where the map has a landmark, and where a sighting shows it.
    ///
    /// **Why:** beside the pose's error, which all landmarks share, one is known as well as by a sighting.
    fn misplaced(&self, measured: &Measured, identity: u32, index: u32) -> Misplaced {
        let sensor = self.state.pose.compose(self.eye().T_robot_sensor);
        let shown = shown(&self.eye().model, sensor, measured, self.landmark_mean(index));
        Misplaced::new(identity, (self.landmark_mean(index), shown.covariance), (shown.mean, shown.covariance))
    }

    fn misfit(&self, sighting: &ScanSighting, identity: u32, index: u32) -> Misfit {
        let (measured, sensor) = (&sighting.measured, self.state.pose.compose(self.eye().T_robot_sensor));
        let agrees = self.state.watch.names.other_place(identity).is_some_and(|place| {
            let linear = self.eye().model.linearize(sensor, place);
            let innovation = self.eye().model.innovation(measured.value, linear.expected);
            // As uncertain as one more sighting, and as the view of the landmark that the name has.
            let s = self.view(index, measured).s;
            let s = Symmetric2::new(s.xx + measured.noise.xx, s.xy + measured.noise.xy, s.yy + measured.noise.yy);
            fit_with_tail(innovation, s, measured.tail).mahalanobis_squared <= IMPLAUSIBLE
        });
        let held = NamedPlace {
            position_m: self.landmark_mean(index),
            sightings: self.state.landmarks[index as usize].sightings,
        };
        let position_m = self.eye().model.inverse(sensor, measured.value);
        Misfit { identity, position_m, agrees, held, may_be_drift: false }
    }

    /// Names that were seen at two places.
    pub fn two_places(&self) -> Vec<TwoPlaces> {
        self.state.watch.names.two_places()
    }

    /// What the innovations so far say of the configured noise.
    pub fn noise_report(&self) -> NoiseReport {
        self.state.watch.noise.of_run()
    }

    /// Corrects the landmarks that are known and returns the sightings of others.
    fn correct_identified<'a>(
        &mut self,
        scan: &'a [ScanSighting],
        info: &mut StepInfo,
    ) -> Result<Vec<&'a ScanSighting>> {
        let mut new = Vec::new();
        for sighting in scan {
            match sighting.identity.and_then(|identity| self.state.of_identity.get(&identity).copied()) {
                Some(index) => {
                    info.weighing.log_likelihood +=
                        self.eye().rules.likelihood_exponent * self.correct(index, sighting)?.log_likelihood;
                }
                None => new.push(sighting),
            }
        }
        Ok(new)
    }

    /// Brings the motion since the last update into pose and covariance.
    fn move_pose(&mut self) {
        let motion = std::mem::take(&mut self.state.pending);
        let (moved, by_pose) = moved_by(self.state.pose, motion.mean);
        self.state.covariance.move_pose(&by_pose, &motion.covariance_in_world(self.state.pose.heading));
        self.state.pose = moved;
    }

    fn row(index: u32) -> usize {
        FIRST_LANDMARK + 2 * index as usize
    }

    fn landmark_mean(&self, index: u32) -> [f64; 2] {
        let row = Self::row(index);
        [self.state.mean[row], self.state.mean[row + 1]]
    }

    fn landmark_covariance(&self, index: u32) -> Symmetric2 {
        let (row, p) = (Self::row(index), &self.state.covariance);
        Symmetric2::new(p.get(row, row), p.get(row + 1, row), p.get(row + 1, row + 1))
    }

    fn view(&self, index: u32, measured: &Measured) -> View {
        let sensor = self.state.pose.compose(self.eye().T_robot_sensor);
        let linear = self.eye().model.linearize(sensor, self.landmark_mean(index));
        let by_pose = by_robot_pose(linear.by_pose, self.state.pose, sensor);
        let row = Self::row(index);
        let h = SparseRows {
            columns: [0, 1, 2, row, row + 1],
            values: std::array::from_fn(|r| {
                let ([x, y, heading], [u, v]) = (by_pose[r], linear.by_landmark[r]);
                [x, y, heading, u, v]
            }),
        };
        let [[xx, xy], [_, yy]] = self.state.covariance.projected(&h);
        View {
            innovation: self.eye().model.innovation(measured.value, linear.expected),
            h,
            s: Symmetric2::new(xx + measured.noise.xx, xy + measured.noise.xy, yy + measured.noise.yy),
        }
    }

    /// A sighting of a landmark, with what is not measured as the state has it.
    fn completed(&self, index: u32, measured: &Measured) -> [f64; 2] {
        let Eye { model, T_robot_sensor, .. } = self.eye();
        let expected = || model.expected(self.state.pose.compose(*T_robot_sensor), self.landmark_mean(index));
        if model.places() {
            measured.value
        } else {
            model.completed(measured.value, expected())
        }
    }

    /// Conditions the whole state on a sighting of a landmark and returns how well it fitted before.
    ///
    /// **Why:** with S = L Lᵀ and W = P Hᵀ L⁻ᵀ the update P ← P − W Wᵀ, x ← x + W L⁻¹ ν needs no inverse and is
    /// symmetric by construction; it equals Joseph's form for the optimal gain.
    fn correct(&mut self, index: u32, sighting: &ScanSighting) -> Result<Fit> {
        let measured = &sighting.measured;
        let view = self.view(index, measured);
        let fit = fit_with_tail(view.innovation, view.s, measured.tail);
        let (value, completed) = (measured.value, self.completed(index, measured));
        self.seen_again.push(SeenAgain { value, completed, index, innovation: view.innovation, s: view.s });
        let more = measured.noise.scaled(measured.tail.noise_scale(fit.mahalanobis_squared) - 1.0);
        let s = Symmetric2::new(view.s.xx + more.xx, view.s.xy + more.xy, view.s.yy + more.yy);
        if !s.is_positive_definite() {
            let what = "the innovation covariance of a sighting";
            return Err(Error::NotPositiveDefinite { step: self.state.steps, what });
        }
        let l00 = s.xx.sqrt();
        let l10 = s.xy / l00;
        let l11 = (s.yy - l10 * l10).sqrt();
        let y0 = view.innovation[0] / l00;
        let y1 = (view.innovation[1] - l10 * y0) / l11;
        self.state.covariance.times_transposed(&view.h, &mut self.gain);
        for (pair, mean) in self.gain.chunks_exact_mut(2 * TILE).zip(self.state.mean.chunks_exact_mut(TILE)) {
            for a in 0..TILE {
                let w0 = pair[a] / l00;
                let w1 = (pair[TILE + a] - l10 * w0) / l11;
                (pair[a], pair[TILE + a]) = (w0, w1);
                mean[a] += w0 * y0 + w1 * y1;
            }
        }
        let step: [f64; 3] = std::array::from_fn(|i| self.gain[i] * y0 + self.gain[TILE + i] * y1);
        self.state.pose = Pose::new(
            self.state.pose.x + step[0],
            self.state.pose.y + step[1],
            wrap_angle(self.state.pose.heading + step[2]),
        );
        self.state.covariance.subtract_outer(&self.gain);
        self.state.landmarks[index as usize].sightings += 1;
        self.mark_identity(index, sighting.identity);
        Ok(fit)
    }

    fn mark_identity(&mut self, index: u32, identity: Option<u32>) {
        let Some(identity) = identity else { return };
        let landmark = &mut self.state.landmarks[index as usize];
        (landmark.identity, landmark.identity_mark) = (Some(identity), f64::from(identity) + 1.0);
        self.state.of_identity.entry(identity).or_insert(index);
    }

    /// Adds a landmark g⁻¹(z, s), uncertain by the noise and, as the others, by the pose.
    fn add(&mut self, sighting: &ScanSighting) {
        let index = self.state.landmarks.len() as u32;
        let row = Self::row(index);
        let values = self.state.pose.to_array();
        let variable = |i: usize, value: f64| Dual::<5>::variable(value, i);
        let robot = Pose::new(variable(0, values[0]), variable(1, values[1]), variable(2, values[2]));
        let [x, y, yaw] = self.eye().T_robot_sensor.to_array().map(<Dual<5> as crate::real::Real>::constant);
        let z = sighting.measured.value;
        let place =
            self.eye().model.inverse(robot.compose(Pose::new(x, y, yaw)), [variable(3, z[0]), variable(4, z[1])]);
        let by_pose = place.map(|v| [v.gradient[0], v.gradient[1], v.gradient[2]]);
        let own = sighting.measured.noise.transformed(place.map(|v| [v.gradient[3], v.gradient[4]]));
        self.state.covariance.add_landmark(row, &by_pose, [[own.xx, own.xy], [own.xy, own.yy]]);
        self.state.mean.resize((row + 2).next_multiple_of(TILE), 0.0);
        (self.state.mean[row], self.state.mean[row + 1]) = (place[0].value, place[1].value);
        self.state.landmarks.push(Landmark { identity_mark: 0.0, identity: None, sightings: 1, is_given_up: false });
        self.mark_identity(index, sighting.identity);
    }

    /// Mean and covariance of the pose after the last update.
    pub fn pose(&self) -> PoseEstimate {
        PoseEstimate { mean: self.state.pose, covariance: self.state.covariance.of_pose() }
    }

    /// Mean and covariance of the pose with the motion since the last update.
    pub fn predicted_pose(&self) -> PoseEstimate {
        let here = PoseEstimate { mean: self.state.pose, covariance: self.state.covariance.of_pose() };
        here.moved(&self.state.pending)
    }

    /// Motion since the last update.
    pub fn pending_motion(&self) -> MotionGaussian {
        self.state.pending
    }

    /// The pose after each update. The filter forgets past poses, so this is no smoothed path.
    pub fn trail(&self) -> &[(f64, Pose)] {
        &self.state.trail
    }

    /// The map, in the order of creation.
    pub fn map(&self) -> MapEstimate {
        let landmarks = self
            .state
            .landmarks
            .iter()
            .zip(0..)
            .filter(|(landmark, _)| !landmark.is_given_up)
            .map(|(landmark, index)| MapLandmark {
                given: None,
                birth: u64::from(index),
                identity: landmark.identity,
                mean: self.landmark_mean(index),
                covariance: self.landmark_covariance(index),
                sightings: landmark.sightings,
                confirmed: landmark.identity.is_some()
                    || self.identities == Identities::All
                    || landmark.sightings >= self.config.association.existence.confirmed_sightings,
                appearance: Appearance::default(),
            })
            .collect();
        MapEstimate { landmarks, range_errors: None }
    }

    /// Covariance of (x, y, heading, x₀, y₀, x₁, …), in row order.
    pub fn joint_covariance(&self) -> Vec<f64> {
        let rows: Vec<usize> = (0..3).chain(FIRST_LANDMARK..FIRST_LANDMARK + 2 * self.state.landmarks.len()).collect();
        rows.iter().flat_map(|&i| rows.iter().map(move |&j| self.state.covariance.get(i.max(j), i.min(j)))).collect()
    }

    /// What the joint covariance occupies.
    pub fn usage(&self) -> StoreUsage {
        StoreUsage {
            rows: self.state.landmarks.len(),
            bytes: self.state.covariance.bytes() + 8 * self.state.mean.len(),
        }
    }
}
