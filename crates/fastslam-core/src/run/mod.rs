//! A whole log through the filter, in one call.

mod resume;

use crate::config::Config;
use crate::diagnosis::{NoiseReport, Returns, TwoPlaces};
use crate::error::Result;
use crate::filter::{Identities, MapEstimate, Skipped};
use crate::geometry::Pose;
use crate::given::Beginning;
use crate::slam::{self, Maker};
use crate::store::StoreUsage;
pub use crate::stream::StepRecord;
use crate::stream::{Stream, Window};
use crate::timeline::{LogData, Row};

/// Whoever watches a run: it has the clock, and may stop the run.
pub trait Observer {
    /// Seconds since any fixed moment.
    fn now_s(&self) -> f64;
    /// Called after every step with the number of steps done; `false` ends the run early.
    fn step_done(&mut self, done: usize) -> bool;
    /// Shown the stream after every step, before [`Observer::step_done`].
    fn look(&mut self, _stream: &mut Stream, _record: &StepRecord) {}
    /// Shown the stream at its end, when all that the filter can learn is learned.
    fn look_back(&mut self, _stream: &mut Stream, _record: &StepRecord) {}
    /// Whether the run is to hand over a snapshot of itself now. Asked after every step, the last one included.
    fn wants_snapshot(&mut self) -> bool {
        false
    }
    /// Gets the snapshot that was wanted, from which [`resume`] goes on.
    fn keep(&mut self, _snapshot: Vec<u8>) {}
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
    /// How often a step has waited for a draw of paths beside the filter: it depends on the machine.
    pub waits: u64,
    /// Computing time of all steps, seconds.
    pub filter_seconds: f64,
    /// Whether the observer ended the run early.
    pub interrupted: bool,
}

/// Runs the configured filter over a log.
///
/// **Errors:** an invalid log or configuration before anything is computed; the step's error when the filter cannot go on.
pub fn run(config: &Config, log: &LogData, observer: &mut dyn Observer) -> Result<RunOutput> {
    run_from(config, log, &Beginning::default(), observer)
}

/// Runs the configured filter over a log, in a given map or from a given start.
///
/// **Errors:** as [`run`], and for a map or start that makes no sense.
pub fn run_from(
    config: &Config,
    log: &LogData,
    beginning: &Beginning,
    observer: &mut dyn Observer,
) -> Result<RunOutput> {
    run_with(&slam::create, Task { config, log, beginning }, None, observer)
}

/// What is run: how, over which log, and what it begins with.
#[derive(Clone, Copy, Debug)]
pub struct Task<'a> {
    /// The filter and its settings.
    pub config: &'a Config,
    /// The log.
    pub log: &'a LogData,
    /// A map, a start.
    pub beginning: &'a Beginning,
}

/// Runs a filter that `make` makes over a log, from its beginning or going on from a snapshot.
///
/// **Errors:** as [`run_from`] and [`resume`], and those of `make`.
pub fn run_with(
    make: Maker<'_>,
    task: Task<'_>,
    snapshot: Option<&[u8]>,
    observer: &mut dyn Observer,
) -> Result<RunOutput> {
    let run = Run::new(make, task.config, task.log, task.beginning)?;
    let run = match snapshot {
        Some(snapshot) => run.resumed(snapshot)?,
        None => run,
    };
    run.finish(observer)
}

/// Goes on with a run of which [`Observer::keep`] got a snapshot; what comes out is that of the run without the cut, but
/// for computing times.
///
/// **Errors:** as [`run`], and [`Error::Input`](crate::error::Error::Input) for a snapshot that is damaged, or of another
/// configuration, log or map.
pub fn resume(
    config: &Config,
    log: &LogData,
    beginning: &Beginning,
    snapshot: &[u8],
    observer: &mut dyn Observer,
) -> Result<RunOutput> {
    run_with(&slam::create, Task { config, log, beginning }, Some(snapshot), observer)
}

/// A run under way.
struct Run<'a> {
    config: &'a Config,
    log: &'a LogData,
    beginning: &'a Beginning,
    rows: Box<dyn Iterator<Item = Row> + 'a>,
    stream: Stream,
    steps: Vec<StepRecord>,
}

impl<'a> Run<'a> {
    fn new(make: Maker<'_>, config: &'a Config, log: &'a LogData, beginning: &'a Beginning) -> Result<Self> {
        log.validate()?;
        log.check_gaps(config.filter.path_period_s)?;
        config.check_sensor(log.last_sensor())?;
        config.association.check_classes(&log.sightings)?;
        let mut stream = Stream::of(config.clone(), identities_in(log), Window::OF_A_LOG, make)?;
        stream.filter().begin(beginning)?;
        Ok(Self { config, log, beginning, rows: Box::new(log.rows()), stream, steps: Vec::new() })
    }

    fn finish(mut self, observer: &mut dyn Observer) -> Result<RunOutput> {
        let (mut started_s, mut interrupted) = (observer.now_s(), false);
        while let Some(record) = self.next_step()? {
            let record = StepRecord { latency_s: observer.now_s() - started_s, ..record };
            self.steps.push(record);
            observer.look(&mut self.stream, &record);
            interrupted = !observer.step_done(self.steps.len());
            if observer.wants_snapshot() {
                observer.keep(self.snapshot()?);
            }
            if interrupted {
                break;
            }
            started_s = observer.now_s();
        }
        if !interrupted {
            self.stream.finish();
        }
        let finishing_s = if interrupted { 0.0 } else { observer.now_s() - started_s };
        if let Some(record) = self.steps.last() {
            observer.look_back(&mut self.stream, record);
        }
        Ok(RunOutput { interrupted, ..self.output(finishing_s) })
    }

    /// The next step of the log; none at its end.
    fn next_step(&mut self) -> Result<Option<StepRecord>> {
        loop {
            if let Some(record) = self.stream.step()? {
                return Ok(Some(record));
            }
            let Some(row) = self.rows.next() else { return Ok(None) };
            self.stream.push(row)?;
        }
    }

    fn output(mut self, finishing_s: f64) -> RunOutput {
        let filter_seconds = self.steps.iter().map(|s| s.latency_s).sum::<f64>() + finishing_s;
        RunOutput { filter_seconds, ..RunOutput::of(&mut self.stream, self.steps) }
    }
}

impl RunOutput {
    /// What a stream has come to in these steps.
    pub fn of(stream: &mut Stream, steps: Vec<StepRecord>) -> Self {
        let filter = stream.filter();
        let (map, usage) = (filter.map(), filter.usage());
        let (noise, two_places, returns) = (filter.noise_report(), filter.two_places(), filter.returns());
        let waits = filter.lateness().waits;
        Self {
            filter_seconds: steps.iter().map(|s| s.latency_s).sum::<f64>(),
            steps,
            smoothed: stream.smoothed(),
            map,
            skipped: stream.skipped(),
            repaired: stream.repaired(),
            noise,
            two_places,
            returns,
            usage,
            waits,
            interrupted: false,
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
