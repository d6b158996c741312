//! The filter: particles over paths, and per particle a map of small Gaussians.
//!
//! `step.rs` has the algorithms, a stage a line. Every stage is a file with a function on what it touches: what no step
//! changes (`setup.rs`), the state, and memory that counts for nothing between two steps (`work.rs`).

mod adaptive;
mod appearance;
mod associate;
mod beginning;
mod beliefs;
mod correct;
mod doubtful;
mod doubts;
mod estimate;
mod examine;
mod existence;
mod extent;
mod fading;
mod given;
mod judge;
mod landmarks;
mod looking;
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
pub use crate::sighting::{Seen, Sighting, Skipped, Taken};
pub use crate::step_info::{LeftOut, MapChanges, NoiseInWindow, Sampling, StepInfo, Weighing};
pub use estimate::{MapEstimate, MapLandmark};
pub use given::GivenUse;
pub use particles::{mixture, Particles, PoseEstimate};
pub(crate) use usable::usable;

use crate::association::ScanSighting;
use crate::config::Config;
use crate::diagnosis::{NoiseReport, Returns, TwoPlaces};
use crate::error::Result;
use crate::geometry::{Pose, Symmetric2};
use crate::given::{Beginning, GivenLandmark};
use crate::measurement::{Placing, RangeBearing};
use crate::motion::{MotionGaussian, RowPart};
use crate::path::PathForest;
use crate::store::StoreUsage;
use landmarks::Landmarks;
use rounds::Rounds;
use setup::{Settings, Setup};
use state::State;
use work::Work;

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
/// `state` is what a later step needs of the earlier ones, and nothing else; `work` and `rounds` are memory that is kept,
/// and what they hold counts for nothing once a step is done.
pub struct FastSlam<M = RangeBearing> {
    setup: Setup<M>,
    state: State,
    work: Work,
    /// The sightings of a step, each identity once in each.
    rounds: Vec<Vec<ScanSighting>>,
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
        let work = Work::new(&self.setup.workers);
        Self { setup: self.setup.clone(), state: self.state.clone(), work, rounds: Vec::new() }
    }
}

impl<M: Placing> FastSlam<M> {
    /// A filter for any measurement model, which brings its own noise; of `Config::sensor` the limits, the tail and
    /// the mounting count.
    pub fn with_model(config: Config, identities: Identities, model: M) -> Result<Self> {
        let setup = Setup::new(config, identities, model)?;
        let Settings { config, identities, gate_radius, .. } = &setup.settings;
        let mut landmarks = Landmarks::new(config, *identities, setup.cell_m(), *gate_radius);
        landmarks.set_workers(&setup.workers);
        let (state, work) = (State::new(config, landmarks), Work::new(&setup.workers));
        Ok(Self { setup, state, work, rounds: Vec::new() })
    }

    /// The configuration in force.
    pub fn config(&self) -> &Config {
        &self.setup.settings.config
    }

    /// Starts in a given map, at a given pose: before anything else.
    ///
    /// Given landmarks count as confirmed. They keep their places in the frame of the map, which is that of the path.
    ///
    /// **Errors:** [`Error::Parameter`](crate::error::Error::Parameter) for a landmark or a start that makes no sense,
    /// [`Error::Input`](crate::error::Error::Input) when the filter has begun.
    pub fn begin(&mut self, beginning: &Beginning) -> Result<()> {
        beginning::begin(&self.setup, &mut self.state, beginning)
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
        propose::advance(&self.setup, &mut self.state, part)
    }

    /// Processes all sightings of one stamp (there may be none).
    ///
    /// **Errors:** [`Error::Input`](crate::error::Error::Input) for a class beyond those configured;
    /// [`Error::AllWeightsZero`](crate::error::Error::AllWeightsZero) when no particle can explain the sightings;
    /// [`Error::NotFinite`](crate::error::Error::NotFinite) when the step would leave a number that is none. The filter
    /// is then as it was before the scan, and can go on. Only after numbers that are none from a measurement model of
    /// one's own all particles count the same, and landmarks at no place that can be computed with are gone.
    pub fn update(&mut self, stamp_s: f64, sightings: &[Sighting]) -> Result<StepInfo> {
        let Self { setup, state, work, rounds } = self;
        setup.settings.config.association.check_classes(sightings)?;
        let mut info = StepInfo { step: state.counters.steps, ..StepInfo::default() };
        let used = rounds::fill_rounds(setup, rounds, sightings, &mut info.left_out.skipped);
        let scan = Rounds { stamp_s, rounds: &mut rounds[..used] };
        ordinary::take_in(setup, state, work, scan, &mut info)?;
        Ok(info)
    }

    /// Draws all particles anew from the posterior over paths and maps, given the best particle's associations.
    ///
    /// Returns false, and leaves everything as it is, when the filter was not configured for it
    /// (`filter.rejuvenation`), when nothing happened since the last time, or when no finite solution was
    /// found.
    pub fn rejuvenate(&mut self) -> bool {
        rejuvenation::rejuvenate(&self.setup, &mut self.state, &mut self.work)
    }

    /// The state as bytes, from which [`FastSlam::restore`] goes on to the same bits; `note` is kept in its head.
    pub fn save(&self, note: &str) -> Result<Vec<u8>> {
        snapshot::save(&self.setup.settings, &self.state, note)
    }

    /// Takes over a state that was saved by a filter of this configuration and measurement model.
    ///
    /// **Errors:** [`Error::Input`](crate::error::Error::Input) when the bytes are no snapshot, of another format,
    /// damaged, or of another configuration; the filter is then as it was.
    pub fn restore(&mut self, snapshot: &[u8]) -> Result<()> {
        self.state = snapshot::restored(&self.setup, snapshot)?;
        Ok(())
    }

    /// What the innovations of the whole run say of the configured noise.
    pub fn noise_report(&self) -> NoiseReport {
        self.state.diagnosis.watch.noise.of_run()
    }

    /// Names that were seen at two places.
    pub fn two_places(&self) -> Vec<TwoPlaces> {
        self.state.diagnosis.watch.names.two_places()
    }

    /// What came of the returns to the landmarks of the best particle's map that are no clutter.
    pub fn returns(&self) -> Returns {
        examine::returns(&self.state)
    }

    /// What the best particle took the usable sightings of the last scan for.
    pub fn seen(&self) -> &[Seen] {
        &self.work.seen
    }

    /// Mean and covariance of the pose, motion since the last sampling included.
    pub fn pose(&self) -> PoseEstimate {
        self.state.estimate
    }

    /// The pose now, with the motion since the last update.
    pub fn predicted_pose(&mut self) -> PoseEstimate {
        propose::propose(&self.setup, &self.state, &mut self.work.beliefs);
        estimate::estimate_beliefs(&mut self.state, &self.work.beliefs);
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

    /// Where the path begins.
    pub fn start(&self) -> Pose {
        self.state.start(self.config())
    }

    /// The paths of the particles.
    pub fn path(&self) -> &PathForest {
        &self.state.path
    }

    /// The smoothed path of the particle that explains the log best: stamps and `T_world_robot`.
    pub fn best_path(&self) -> Vec<(f64, Pose)> {
        self.state.path.path(self.state.particles.best())
    }

    /// The given landmarks, by birth.
    pub fn given(&self) -> &[GivenLandmark] {
        &self.state.given.landmarks
    }

    /// The map: the landmarks that the best particle holds, each as the mixture over all particles that hold it.
    pub fn map(&mut self) -> MapEstimate {
        estimate::estimate_map(&self.setup.settings, &mut self.state)
    }

    /// The landmarks of one particle's own map: slot birth, mean and covariance.
    pub fn map_of(&self, particle: usize) -> Vec<(u64, [f64; 2], Symmetric2)> {
        estimate::map_of(&self.state.landmarks, particle)
    }

    /// What the maps occupy.
    pub fn store_usage(&self) -> StoreUsage {
        self.state.landmarks.usage()
    }
}
