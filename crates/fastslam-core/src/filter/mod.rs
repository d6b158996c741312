//! The filter: particles over paths, and per particle a map of small Gaussians.
//!
//! `step.rs` has the algorithms, a stage a line. Every stage is a file with a function on what it touches: what no step
//! changes (`setup.rs`), the state, and memory that counts for nothing between two steps (`work.rs`).

mod adaptive;
mod appearance;
mod associate;
mod beginning;
mod beliefs;
mod believed;
mod beside;
mod correct;
mod doubtful;
mod doubts;
mod engine;
mod errors;
mod estimate;
mod examine;
mod existence;
mod extent;
mod eyes;
mod fading;
mod given;
mod imagine;
mod judge;
mod landmarks;
mod looking;
mod machine;
mod merger;
mod merging;
mod names;
mod need;
mod ordinary;
mod particles;
mod propose;
mod rejuvenation;
mod remember;
mod resample;
mod returns;
mod rounds;
mod sample;
pub mod settings;
mod setup;
mod snapshot;
mod state;
mod step;
mod usable;
mod weigh;
mod work;

pub(crate) use beliefs::draw as draw_pose;

pub use crate::association::Identities;
pub use crate::sighting::{Scan, Seen, Sighting, Skipped, Taken};
pub use crate::step_info::{LeftOut, MapChanges, NoiseInWindow, Sampling, StepInfo, Weighing};
pub use estimate::{MapEstimate, MapLandmark};
pub use given::GivenUse;
pub use particles::{mixture, Particles, PoseEstimate};
pub(crate) use returns::shown;
pub(crate) use usable::usable;

use crate::config::Config;
use crate::diagnosis::{NoiseReport, Returns, TwoPlaces};
use crate::error::Result;
use crate::geometry::{Pose, Symmetric2};
use crate::given::{Beginning, GivenLandmark};
use crate::late::{Late, Lateness};
use crate::measurement::{Placing, RangeOrBearing, Sensor};
use crate::motion::{MotionGaussian, RowPart};
use crate::path::PathForest;
use crate::store::StoreUsage;
use eyes::fresh_eyes;
use landmarks::Landmarks;
use machine::{Machine, Running};
use setup::{Settings, Setup, Setups};
use state::State;

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
/// Where it is so configured (`filter.rejuvenation.delay_scans`), paths are drawn on a thread beside it.
///
/// What its steps do depends on the measurement model, its type does not.
pub struct FastSlam {
    machine: Box<dyn Machine>,
}

impl FastSlam {
    /// A filter at the configured initial pose with empty maps.
    ///
    /// `identities` says which sightings will come with one; `Config::association.mode = unknown` overrules it.
    pub fn new(config: Config, identities: Identities) -> Result<Self> {
        let models = config.each_sensor().into_iter().map(Sensor::range_bearing).collect::<Result<_>>()?;
        Self::with_models(config, identities, models)
    }

    /// A filter for several sensors (`Config::sensors`), some of which measure ranges or bearings alone.
    ///
    /// Only a sensor of both founds landmarks; what the others sight is one of these, or left out and counted
    /// ([`LeftOut::ignored`]). What a sighting says of a number that its sensor does not measure counts for nothing.
    pub fn mixed(config: Config, identities: Identities) -> Result<Self> {
        let models = config.each_sensor().into_iter().map(RangeOrBearing::of).collect::<Result<_>>()?;
        Self::with_models(config, identities, models)
    }

    /// A filter for any measurement model, which brings its own noise; of `Config::sensor` the limits, the tail and
    /// the mounting count.
    pub fn with_model<M: Placing>(config: Config, identities: Identities, model: M) -> Result<Self> {
        Self::with_models(config, identities, vec![model])
    }

    /// The same with a model for each sensor.
    fn with_models<M: Placing>(config: Config, identities: Identities, models: Vec<M>) -> Result<Self> {
        let setups = Setups::new(config, identities, models)?;
        let Setup { settings: Settings { config, identities, .. }, workers, .. } = setups.first();
        let mut landmarks = Landmarks::new(config, *identities, setups.cell_m(), setups.gate_radius());
        landmarks.set_workers(workers);
        let mut state = State::new(config, landmarks);
        state.diagnosis.eyes = fresh_eyes(&setups);
        Ok(Self { machine: Box::new(Running::new(setups, state)) })
    }

    /// The configuration in force.
    pub fn config(&self) -> &Config {
        self.machine.config()
    }

    /// Starts in a given map, at a given pose: before anything else.
    ///
    /// Given landmarks count as confirmed. They keep their places in the frame of the map, which is that of the path.
    ///
    /// **Errors:** [`Error::Parameter`](crate::error::Error::Parameter) for a landmark or a start that makes no sense,
    /// [`Error::Input`](crate::error::Error::Input) when the filter has begun.
    pub fn begin(&mut self, beginning: &Beginning) -> Result<()> {
        self.machine.begin(beginning)
    }

    /// Moves the robot by one control (columns of the motion model) that acts for `dt_s`: a whole row.
    pub fn predict(&mut self, control: [f64; 3], dt_s: f64) -> Result<()> {
        self.advance(&RowPart::whole(control, dt_s))
    }

    /// Moves the robot by a row of odometry, or a part of it.
    ///
    /// FastSLAM 1.0 samples every particle's pose now; 2.0 keeps the motion as a Gaussian until sightings come.
    ///
    /// **Errors:** [`Error::Input`](crate::error::Error::Input) for a control that no robot could follow; the filter is
    /// then as it was.
    pub fn advance(&mut self, part: &RowPart) -> Result<()> {
        self.machine.advance(part)
    }

    /// Processes all sightings of one stamp (there may be none) of the only sensor, or the first one.
    ///
    /// **Errors:** as [`FastSlam::take`].
    pub fn update(&mut self, stamp_s: f64, sightings: &[Sighting]) -> Result<StepInfo> {
        self.take(Scan::new(stamp_s, sightings))
    }

    /// Processes all that one sensor saw at one stamp (there may be nothing).
    ///
    /// **Errors:** [`Error::Input`](crate::error::Error::Input) for a class or sensor beyond those configured;
    /// [`Error::AllWeightsZero`](crate::error::Error::AllWeightsZero) when no particle can explain the sightings;
    /// [`Error::NotFinite`](crate::error::Error::NotFinite) when the step would leave a number that is none. The filter
    /// is then as it was before the scan, and can go on. Only after numbers that are none from a measurement model of
    /// one's own all particles count the same, and landmarks at no place that can be computed with are gone.
    pub fn take(&mut self, scan: Scan<'_>) -> Result<StepInfo> {
        self.machine.take(scan)
    }

    /// Draws all particles anew from the posterior over paths and maps, given the best particle's associations.
    ///
    /// Returns false, and leaves everything as it is, when the filter was not configured for it
    /// (`filter.rejuvenation`), when nothing happened since the last time, or when no finite solution was
    /// found. A draw under way is taken over first.
    pub fn rejuvenate(&mut self) -> bool {
        self.machine.rejuvenate()
    }

    /// How often a draw that is done beside the filter was late: it depends on the machine.
    pub fn lateness(&self) -> Lateness {
        self.machine.lateness()
    }

    /// From here on this is done where a draw beside the filter is late; at first it is awaited, and results depend on
    /// nothing but the log.
    pub fn when_late(&mut self, late: Late) {
        self.machine.when_late(late);
    }

    /// The state as bytes, from which [`FastSlam::restore`] goes on to the same bits; `note` is kept in its head. Waits for
    /// a draw under way.
    pub fn save(&self, note: &str) -> Result<Vec<u8>> {
        self.machine.save(note)
    }

    /// Takes over a state that was saved by a filter of this configuration and measurement model.
    ///
    /// **Errors:** [`Error::Input`](crate::error::Error::Input) when the bytes are no snapshot, of another format,
    /// damaged, or of another configuration; the filter is then as it was.
    pub fn restore(&mut self, snapshot: &[u8]) -> Result<()> {
        self.machine.restore(snapshot)
    }

    /// What the innovations of the whole run say of the configured noise.
    pub fn noise_report(&self) -> NoiseReport {
        self.machine.state().diagnosis.watch.noise.of_run()
    }

    /// Names that were seen at two places.
    pub fn two_places(&self) -> Vec<TwoPlaces> {
        self.machine.state().diagnosis.watch.names.two_places()
    }

    /// What came of the returns to the landmarks of the best particle's map that are no clutter.
    pub fn returns(&self) -> Returns {
        examine::returns(self.machine.state())
    }

    /// What the best particle took the usable sightings of the last scan for.
    pub fn seen(&self) -> &[Seen] {
        &self.machine.work().seen
    }

    /// Mean and covariance of the pose, motion since the last sampling included.
    pub fn pose(&self) -> PoseEstimate {
        self.machine.state().estimate
    }

    /// The pose now, with the motion since the last update.
    pub fn predicted_pose(&mut self) -> PoseEstimate {
        self.machine.predict();
        self.pose()
    }

    /// The particles. In FastSLAM 2.0 their poses are those at the last sighting.
    pub fn particles(&self) -> &Particles {
        &self.machine.state().particles
    }

    /// Normalised weights of the particles.
    pub fn weights(&self) -> &[f64] {
        &self.machine.state().weights.values
    }

    /// Motion since the poses were last sampled (zero in FastSLAM 1.0).
    pub fn pending_motion(&self) -> MotionGaussian {
        self.machine.state().motions.pending
    }

    /// Where the path begins.
    pub fn start(&self) -> Pose {
        self.machine.state().start(self.config())
    }

    /// The paths of the particles.
    pub fn path(&self) -> &PathForest {
        &self.machine.state().path
    }

    /// The smoothed path of the particle that explains the log best: stamps and `T_world_robot`.
    pub fn best_path(&self) -> Vec<(f64, Pose)> {
        self.machine.state().path.path(self.machine.state().particles.best())
    }

    /// The given landmarks, by birth.
    pub fn given(&self) -> &[GivenLandmark] {
        &self.machine.state().given.landmarks
    }

    /// The map: the landmarks that the best particle holds, each as the mixture over all particles that hold it.
    pub fn map(&mut self) -> MapEstimate {
        self.machine.map()
    }

    /// The landmarks of one particle's own map: slot birth, mean and covariance.
    pub fn map_of(&self, particle: usize) -> Vec<(u64, [f64; 2], Symmetric2)> {
        estimate::map_of(&self.machine.state().landmarks, particle)
    }

    /// What the maps occupy.
    pub fn store_usage(&self) -> StoreUsage {
        self.machine.state().landmarks.usage()
    }
}

impl Clone for FastSlam {
    /// An independent filter in the same state, which goes on to the same bits. Waits for a draw under way.
    fn clone(&self) -> Self {
        Self { machine: self.machine.copy() }
    }
}
