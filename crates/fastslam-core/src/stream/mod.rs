//! The filter on a stream of rows: what a run over a log and a robot that drives have in common.

mod intake;
mod scanner;
mod unsampled;

use crate::config::Config;
use crate::error::{Error, Result};
use crate::filter::{Identities, PoseEstimate};
use crate::geometry::Pose;
use crate::given::Beginning;
use crate::motion::MotionGaussian;
use crate::sighting::{Scan, Skipped};
use crate::slam::{self, Maker, Slam};
use crate::snapshot::{content, open, seal, Head, Holds, SCANS, SENSORS};
use crate::step_info::StepInfo;
use crate::timeline::{Event, Row, SightingsRow, Timeline};
use intake::{stamp_of, Intake};
pub use intake::{Refused, Taken, Window};
use scanner::Scanning;
pub use scanner::{at_sensor, velocity_at, velocity_from, ScanRow, Scanner};
use serde::{Deserialize, Serialize};
use unsampled::with_unsampled;
pub(crate) use unsampled::PathStep;

/// What the filter knew after a step.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct StepRecord {
    /// Seconds.
    pub stamp_s: f64,
    /// Pose with its covariance.
    pub pose: PoseEstimate,
    /// What happened.
    pub info: StepInfo,
    /// Computing time of the step with the motion before it, seconds; whoever has a clock sets it.
    pub latency_s: f64,
}

/// What was done so far, beside what the filter knows.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct Tally {
    /// Events taken from the timeline.
    pub events: u64,
    /// The steps as the smoothed path needs them.
    pub path_steps: Vec<PathStep>,
    /// Sightings that could not be used, in total.
    pub skipped: Skipped,
    /// Landmark covariances that were repaired, in total.
    pub repaired: u64,
}

/// What follows the head of a snapshot; the last is the filter's own. Then come the scanner and its scans, if any.
#[derive(Deserialize)]
struct Stored(Timeline, Intake, Tally, MotionGaussian, Vec<u8>);

/// A filter that is told rows as they come and steps as far as they reach.
///
/// The rows of a log, pushed in any order in which none is later than the window allows, give the bits of a run over it.
pub struct Stream {
    config: Config,
    identities: Identities,
    filter: Box<dyn Slam>,
    timeline: Timeline,
    intake: Intake,
    tally: Tally,
    /// Motion since the last step.
    since: MotionGaussian,
    scanning: Option<Scanning>,
    /// That made the last scan.
    last_sensor: usize,
}

impl Stream {
    /// A robot at its initial pose with an empty map.
    ///
    /// **Errors:** an invalid configuration. The window is taken as it is: see [`Window::validate`].
    pub fn new(config: Config, identities: Identities, window: Window) -> Result<Self> {
        Self::of(config, identities, window, &slam::create)
    }

    /// The same with a filter that `make` makes.
    ///
    /// **Errors:** as [`Stream::new`].
    pub fn of(config: Config, identities: Identities, window: Window, make: Maker<'_>) -> Result<Self> {
        let filter = make(config.clone(), identities)?;
        let timeline = Timeline::new(config.motion.timing(), config.filter.path_period_s, window.wait_s);
        let (intake, tally, since) = (Intake::new(window), Tally::default(), MotionGaussian::default());
        Ok(Self { config, identities, filter, timeline, intake, tally, since, scanning: None, last_sensor: 0 })
    }

    /// Starts in a given map, at a given pose: before anything else.
    ///
    /// **Errors:** those of [`Slam::begin`].
    pub fn begin(&mut self, beginning: &Beginning) -> Result<()> {
        self.filter.begin(beginning)
    }

    /// Takes scans of this laser from here on ([`Stream::push_scan`]).
    ///
    /// **Errors:** settings or a geometry that make no sense, or several sensors, of which nobody says which the laser is.
    pub fn scan_with(&mut self, scanner: Scanner) -> Result<()> {
        if !self.config.sensors.is_empty() {
            return Err(Error::Input(
                "scans of a laser need `sensor`, the only one: `sensors` are told sightings".into(),
            ));
        }
        self.scanning = Some(Scanning::new(scanner)?);
        Ok(())
    }

    /// Takes a row; what follows from it is computed by [`Stream::step`].
    ///
    /// **Errors:** a row whose numbers are none, or a class that is not configured; nothing has changed then.
    pub fn push(&mut self, row: Row) -> Result<Taken> {
        if let Row::Sightings(SightingsRow { sightings, sensor, .. }) = &row {
            self.config.association.check_classes(sightings)?;
            self.config.check_sensor(*sensor)?;
        }
        if let Some(stamp_s) = stamp_of(&row)? {
            let taken = self.intake.judge(stamp_s, self.settled_s());
            if taken != Taken::Yes {
                return Ok(taken);
            }
        }
        if let (Some(scanning), Row::End) = (&mut self.scanning, &row) {
            // The timeline ends with the last of what the scans show.
            scanning.end();
            return Ok(Taken::Yes);
        }
        let control = if let Row::Control(control) = &row { Some(*control) } else { None };
        if !self.timeline.put(row) {
            return Ok(self.intake.refuse(Taken::Repeated));
        }
        match (&mut self.scanning, control) {
            (Some(scanning), Some(control)) => scanning.moves(control),
            (Some(_), None) => {}
            (None, _) => self.timeline.settle(self.intake.settled_s()),
        }
        Ok(Taken::Yes)
    }

    /// Takes a scan, as [`Stream::push`] does a row. What is seen in it counts as sightings of its stamp; where nothing
    /// is, it counts for nothing. Where the motion within scans is corrected, a scan waits for the odometry that tells it.
    ///
    /// **Errors:** a scan that does not fit the scanner, or a stream without one; nothing has changed then.
    pub fn push_scan(&mut self, scan: ScanRow) -> Result<Taken> {
        let settled_s = self.settled_s();
        let Some(scanning) = &mut self.scanning else {
            return Err(Error::Input("scans need a scanner, which the stream has none of".into()));
        };
        scanning.check(&scan)?;
        let taken = self.intake.judge(scan.stamp_s, settled_s);
        if taken == Taken::Yes && !scanning.put(scan) {
            return Ok(self.intake.refuse(Taken::Repeated));
        }
        Ok(taken)
    }

    /// Rows before this moment are late.
    fn settled_s(&self) -> f64 {
        let ended = self.scanning.as_ref().is_some_and(Scanning::has_ended);
        self.timeline.settled_s().max(if ended { f64::INFINITY } else { self.intake.settled_s() })
    }

    /// Sees what is in the scans that need not wait, and lets the timeline go up to the next one.
    ///
    /// **Errors:** those of [`Scanning::next`].
    fn scan(&mut self) -> Result<()> {
        let Some(scanning) = &mut self.scanning else { return Ok(()) };
        let settled_s = self.intake.settled_s();
        while let Some((stamp_s, seen)) = scanning.next(&self.config, settled_s, self.intake.window.wait_s)? {
            if !seen.is_empty() {
                self.timeline.put(Row::Sightings(SightingsRow::new(stamp_s, seen)));
            }
        }
        if !scanning.has_ended() {
            self.timeline.settle(settled_s.min(scanning.next_s()));
        } else if self.timeline.settled_s() < f64::INFINITY {
            self.timeline.put(Row::End);
        }
        Ok(())
    }

    /// The next step that the rows so far allow; none where more must come.
    ///
    /// **Errors:** the filter's; where a scan cannot be explained it is as it was before the scan, which is passed over, as
    /// is one of which nobody can say how the sensor moved meanwhile.
    pub fn step(&mut self) -> Result<Option<StepRecord>> {
        self.scan()?;
        while let Some(event) = self.timeline.next() {
            self.tally.events += 1;
            match event {
                Event::Control(part) => {
                    self.filter.advance(&part)?;
                    self.since = self.since.then(&self.config.motion.of(&part)?);
                }
                Event::Step(row) => return self.update(row.scan()).map(Some),
            }
        }
        Ok(None)
    }

    fn update(&mut self, scan: Scan<'_>) -> Result<StepRecord> {
        let (motion, stamp_s) = (self.filter.pending_motion().mean, scan.stamp_s);
        let info = self.filter.take(scan)?;
        self.last_sensor = scan.sensor;
        self.since = MotionGaussian::default();
        self.tally.path_steps.push(PathStep { stamp_s, motion, sampled: info.sampling.sampled });
        self.tally.skipped.add(&info.left_out.skipped);
        self.tally.repaired += u64::from(info.repaired);
        Ok(StepRecord { stamp_s, pose: self.filter.pose(), info, latency_s: 0.0 })
    }

    /// Ends the stream: what the filter can still learn from the whole of it. Returns whether anything changed.
    pub fn finish(&mut self) -> bool {
        self.filter.finish()
    }

    /// Path of the best hypothesis with a pose at every step: stamps in seconds and `T_world_robot`.
    pub fn smoothed(&self) -> Vec<(f64, Pose)> {
        let start = self.filter.start();
        with_unsampled(&self.filter.best_path(), &self.tally.path_steps, start)
    }

    /// The pose at the newest row, with its stamp in seconds: where the rows that still wait lead from what is
    /// computed. None before the first row.
    pub fn newest_pose(&self) -> Result<Option<(f64, PoseEstimate)>> {
        let pose = self.filter.pose();
        let (mut ahead, mut motion) = (self.timeline.clone(), self.since);
        ahead.put(Row::End);
        for event in ahead.by_ref() {
            if let Event::Control(part) = event {
                motion = motion.then(&self.config.motion.of(&part)?);
            }
        }
        Ok(ahead.now_s().map(|stamp_s| (stamp_s, pose.moved(&motion))))
    }

    /// The filter.
    pub fn filter(&mut self) -> &mut dyn Slam {
        self.filter.as_mut()
    }

    /// Number of the sensor that made the last scan.
    pub fn last_sensor(&self) -> usize {
        self.last_sensor
    }

    /// The configuration.
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// Rows that were refused so far.
    pub fn refused(&self) -> Refused {
        self.intake.refused
    }

    /// Sightings that could not be used so far.
    pub fn skipped(&self) -> Skipped {
        self.tally.skipped
    }

    /// Landmark covariances that were repaired so far.
    pub fn repaired(&self) -> u64 {
        self.tally.repaired
    }

    /// Rows that wait for others.
    pub fn waiting(&self) -> usize {
        self.timeline.waiting() + self.scanning.as_ref().map_or(0, Scanning::waiting)
    }

    /// The state as bytes, the rows that wait included, from which [`Stream::load`] goes on to the same bits; `note` is
    /// kept in their head.
    pub fn save(&self, note: &str) -> Result<Vec<u8>> {
        let head = Head::of_stream(&self.config, self.identities, note)?;
        let rows = (&self.timeline, &self.intake, &self.tally, &self.since, self.filter.save("")?);
        let scanning = self.scanning.as_ref().map(Scanning::stored).transpose()?;
        seal(&head, &(rows, scanning, self.timeline.sensors()))
    }

    /// The stream that a snapshot was taken of, with its note.
    ///
    /// **Errors:** [`Error::Input`] when the bytes are no snapshot, of something else, of another format or damaged; those
    /// of `make`.
    pub fn load(snapshot: &[u8], make: Maker<'_>) -> Result<(Self, String)> {
        let (head, stored) = open(snapshot, Holds::Stream)?;
        let (Stored(mut timeline, intake, tally, since, filter), scanning, sensors): (_, _, Vec<u8>) =
            match stored.format {
                0..SCANS => (content(&stored)?, None, Vec::new()),
                SCANS..SENSORS => {
                    let (rows, scanning) = content(&stored)?;
                    (rows, scanning, Vec::new())
                }
                _ => content(&stored)?,
            };
        timeline.set_sensors(&sensors);
        let fresh = Self::of(head.config()?, head.identities, intake.window, make)?;
        let scanning = scanning.map(Scanning::restored).transpose()?;
        let mut stream = Self { timeline, intake, tally, since, scanning, ..fresh };
        stream.filter.restore(&filter)?;
        Ok((stream, head.note))
    }

    /// What was done so far, for the snapshot of a run over a log.
    pub(crate) fn tally(&self) -> &Tally {
        &self.tally
    }

    /// The filter's own snapshot.
    pub(crate) fn save_filter(&self) -> Result<Vec<u8>> {
        self.filter.save("")
    }

    /// Goes to where a run over a log was cut: `rows` are those of the log.
    ///
    /// **Errors:** a filter that is refused, or rows that end before the cut.
    pub(crate) fn go_to(&mut self, tally: Tally, filter: &[u8], rows: &mut dyn Iterator<Item = Row>) -> Result<()> {
        self.filter.restore(filter)?;
        let mut passed = 0;
        while passed < tally.events {
            if self.timeline.next().is_some() {
                passed += 1;
            } else {
                let row = rows.next().ok_or_else(|| Error::Input("the snapshot is of a longer log".into()))?;
                self.push(row)?;
            }
        }
        self.tally = tally;
        Ok(())
    }
}
