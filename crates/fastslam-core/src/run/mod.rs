//! A whole log through the filter, in one call.

mod resume;
mod unsampled;

use crate::config::Config;
use crate::diagnosis::{NoiseReport, Returns, TwoPlaces};
use crate::error::Result;
use crate::filter::{Identities, MapEstimate, PoseEstimate, Sighting, Skipped, StepInfo};
use crate::geometry::Pose;
use crate::slam::{self, Slam};
use crate::store::StoreUsage;
use crate::timeline::{Event, LogData, Timeline};
use serde::{Deserialize, Serialize};
use unsampled::{with_unsampled, PathStep};

/// Whoever watches a run: it has the clock, and may stop the run.
pub trait Observer {
    /// Seconds since any fixed moment.
    fn now_s(&self) -> f64;
    /// Called after every step with the number of steps done; `false` ends the run early.
    fn step_done(&mut self, done: usize) -> bool;
    /// Whether the run is to hand over a snapshot of itself now. Asked after every step, the last one included.
    fn wants_snapshot(&mut self) -> bool {
        false
    }
    /// Gets the snapshot that was wanted, from which [`resume`] goes on.
    fn keep(&mut self, _snapshot: Vec<u8>) {}
}

/// What the filter knew after a step.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct StepRecord {
    /// Seconds.
    pub stamp_s: f64,
    /// Pose with its covariance.
    pub pose: PoseEstimate,
    /// What happened.
    pub info: StepInfo,
    /// Computing time of the step with the motion before it, seconds.
    pub latency_s: f64,
}

/// The outcome of a run.
#[derive(Clone, Debug, Default)]
pub struct RunOutput {
    /// One per step.
    pub steps: Vec<StepRecord>,
    /// Path of the best particle with a pose at every step: stamps in seconds, `T_world_robot`.
    pub smoothed: Vec<(f64, Pose)>,
    /// Landmarks.
    pub map: MapEstimate,
    /// Sightings that could not be used, in total.
    pub skipped: Skipped,
    /// Landmark covariances that lost definiteness and were repaired, in total.
    pub repaired: u64,
    /// What the innovations of the run say of the configured noise.
    pub noise: NoiseReport,
    /// Names that were seen at two places.
    pub two_places: Vec<TwoPlaces>,
    /// What came of the returns to landmarks.
    pub returns: Returns,
    /// What the maps occupy at the end.
    pub usage: StoreUsage,
    /// Computing time of all steps, seconds.
    pub filter_seconds: f64,
    /// Whether the observer ended the run early.
    pub interrupted: bool,
}

/// Runs the configured filter over a log.
///
/// **Errors:** an invalid log or configuration before anything is computed; the step's error when the filter cannot go on.
pub fn run(config: &Config, log: &LogData, observer: &mut dyn Observer) -> Result<RunOutput> {
    Run::new(config, log)?.finish(observer)
}

/// Goes on with a run of which [`Observer::keep`] got a snapshot; what comes out is that of the run without the cut, but
/// for computing times.
///
/// **Errors:** as [`run`], and [`Error::Input`](crate::error::Error::Input) for a snapshot that is damaged, or of another
/// configuration or log.
pub fn resume(config: &Config, log: &LogData, snapshot: &[u8], observer: &mut dyn Observer) -> Result<RunOutput> {
    Run::from_snapshot(config, log, snapshot)?.finish(observer)
}

/// A run under way.
struct Run<'a> {
    config: &'a Config,
    log: &'a LogData,
    timeline: Timeline<'a>,
    filter: Box<dyn Slam>,
    done: Done,
}

/// What a run has done so far; with the filter all that a later step needs.
#[derive(Debug, Default, Serialize, Deserialize)]
struct Done {
    /// Events taken from the timeline.
    events: u64,
    steps: Vec<StepRecord>,
    path_steps: Vec<PathStep>,
    skipped: Skipped,
    repaired: u64,
}

impl<'a> Run<'a> {
    fn new(config: &'a Config, log: &'a LogData) -> Result<Self> {
        log.validate()?;
        log.check_gaps(config.filter.path_period_s)?;
        config.association.check_classes(&log.sightings)?;
        let timeline = Timeline::new(log, config.motion.timing(), config.filter.path_period_s);
        let filter = slam::create(config.clone(), identities_in(log))?;
        Ok(Self { config, log, timeline, filter, done: Done::default() })
    }

    fn finish(mut self, observer: &mut dyn Observer) -> Result<RunOutput> {
        let (mut started_s, mut interrupted) = (observer.now_s(), false);
        while let Some(event) = self.timeline.next() {
            self.done.events += 1;
            match event {
                Event::Control(part) => self.filter.advance(&part)?,
                Event::Step { stamp_s, first, end } => {
                    self.step(stamp_s, &self.log.sightings[first..end])?;
                    self.done.clock(observer.now_s() - started_s);
                    interrupted = !observer.step_done(self.done.steps.len());
                    if observer.wants_snapshot() {
                        observer.keep(self.snapshot()?);
                    }
                    started_s = observer.now_s();
                }
            }
            if interrupted {
                break;
            }
        }
        if !interrupted {
            self.filter.finish();
        }
        let finishing_s = observer.now_s() - started_s;
        Ok(RunOutput { interrupted, ..self.output(finishing_s) })
    }

    /// A step of the filter, taken down. Its computing time is not known yet.
    fn step(&mut self, stamp_s: f64, sightings: &[Sighting]) -> Result<()> {
        let motion = self.filter.pending_motion().mean;
        let info = self.filter.update(stamp_s, sightings)?;
        let done = &mut self.done;
        done.path_steps.push(PathStep { stamp_s, motion, sampled: info.sampled });
        done.steps.push(StepRecord { stamp_s, pose: self.filter.pose(), info, latency_s: 0.0 });
        add(&mut done.skipped, &info.skipped);
        done.repaired += u64::from(info.repaired);
        Ok(())
    }

    fn output(mut self, finishing_s: f64) -> RunOutput {
        let Done { steps, path_steps, skipped, repaired, .. } = self.done;
        let start = self.config.initial_pose.T_world_robot();
        RunOutput {
            filter_seconds: steps.iter().map(|s| s.latency_s).sum::<f64>() + finishing_s,
            steps,
            smoothed: with_unsampled(&self.filter.best_path(), &path_steps, start),
            map: self.filter.map(),
            skipped,
            repaired,
            noise: self.filter.noise_report(),
            two_places: self.filter.two_places(),
            returns: self.filter.returns(),
            usage: self.filter.usage(),
            interrupted: false,
        }
    }
}

impl Done {
    /// The computing time of the last step, the motion before it included.
    fn clock(&mut self, seconds: f64) {
        if let Some(last) = self.steps.last_mut() {
            last.latency_s = seconds;
        }
    }
}

fn identities_in(log: &LogData) -> Identities {
    let named = log.sightings.iter().filter(|s| s.identity.is_some()).count();
    if named == log.sightings.len() {
        Identities::All
    } else if named == 0 {
        Identities::None
    } else {
        Identities::Some
    }
}

fn add(total: &mut Skipped, step: &Skipped) {
    total.not_finite += step.not_finite;
    total.too_near += step.too_near;
    total.too_far += step.too_far;
    total.without_identity += step.without_identity;
    total.bad_covariance += step.bad_covariance;
}
