//! A log in space, in one call.

use super::sensor::{Model, Spatial};
use super::{
    Smoothed, SpaceConfig, SpaceEstimate, SpaceLandmark, SpaceMotionKind, SpacePose, SpaceSighting, SpaceSlam,
    SpaceStep, Twist,
};
use crate::error::{Error, Result};
use crate::limits::LONGEST_S;

/// Where velocities wander and turns are measured, a pose of the least squares stands where the robot has turned so far since
/// the last one: what is believed of its way is an arc.
const FARTHEST_TURN_RAD: f64 = 1.0;

/// What a robot noted.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SpaceLog {
    /// When each velocity begins; growing.
    pub row_stamp_s: Vec<f64>,
    /// In the robot's axes, (m/s, rad/s); each holds until the next one.
    pub velocity: Vec<Twist>,
    /// Never falling; equal stamps are one scan.
    pub sighting_stamp_s: Vec<f64>,
    /// What was seen.
    pub sightings: Vec<SpaceSighting>,
}

/// A run.
#[derive(Clone, Debug)]
pub struct SpaceRun {
    /// Stamps of scans, and of poses where nothing was seen.
    pub stamp_s: Vec<f64>,
    /// The pose as it was known then.
    pub live: Vec<SpaceEstimate>,
    /// The steps, one per stamp.
    pub steps: Columns,
    /// Given the whole log.
    pub smoothed: Smoothed,
    /// The map of the particles at the end.
    pub landmarks: Vec<SpaceLandmark>,
    /// Whether it was stopped before the end of the log.
    pub interrupted: bool,
}

/// The steps of a run.
pub type Columns = Vec<SpaceStep>;

impl SpaceLog {
    /// Errors unless the columns fit each other and time does not fall.
    pub fn validate(&self) -> Result<()> {
        let rows = (self.row_stamp_s.len(), self.velocity.len());
        let seen = (self.sighting_stamp_s.len(), self.sightings.len());
        if rows.0 != rows.1 || seen.0 != seen.1 {
            return Err(Error::Input(format!(
                "got {} stamps of {} velocities and {} of {} sightings",
                rows.0, rows.1, seen.0, seen.1
            )));
        }
        let sound = |stamps: &[f64]| stamps.iter().all(|v| v.abs() <= LONGEST_S);
        if !sound(&self.row_stamp_s) || !sound(&self.sighting_stamp_s) {
            return Err(Error::Input(format!("stamps: expected finite numbers, at most {LONGEST_S:e} s")));
        }
        if self.row_stamp_s.windows(2).any(|w| w[0] >= w[1]) {
            return Err(Error::Input("stamps of velocities: expected growing ones".into()));
        }
        if self.sighting_stamp_s.windows(2).any(|w| w[0] > w[1]) {
            return Err(Error::Input("stamps of sightings: expected an order by time".into()));
        }
        Ok(())
    }
}

/// Runs the filter over a log; `goes_on` is asked after every scan, with how many there were and will be.
///
/// **Errors:** those of the configuration and the log, and those of [`SpaceSlam::update`].
pub fn run(config: &SpaceConfig, log: &SpaceLog, goes_on: &mut dyn FnMut(usize, usize) -> bool) -> Result<SpaceRun> {
    log.validate()?;
    match Model::from(&config.sensor) {
        Model::Point(model) => Runner::new(config, model)?.run(log, goes_on),
        Model::RangeBearingElevation(model) => Runner::new(config, model)?.run(log, goes_on),
        Model::Stereo(model) => Runner::new(config, model)?.run(log, goes_on),
    }
}

struct Runner<M> {
    filter: SpaceSlam<M>,
    /// Now.
    time_s: f64,
    /// Of the row that holds.
    row: usize,
    period_s: f64,
    kind: SpaceMotionKind,
    stamp_s: Vec<f64>,
    live: Vec<SpaceEstimate>,
    steps: Columns,
}

impl<M: Spatial> Runner<M> {
    fn new(config: &SpaceConfig, model: M) -> Result<Self> {
        Ok(Self {
            filter: SpaceSlam::new(config.clone(), model)?,
            time_s: f64::NEG_INFINITY,
            row: 0,
            period_s: config.filter.path_period_s,
            kind: config.motion.kind,
            stamp_s: Vec::new(),
            live: Vec::new(),
            steps: Vec::new(),
        })
    }

    fn run(mut self, log: &SpaceLog, goes_on: &mut dyn FnMut(usize, usize) -> bool) -> Result<SpaceRun> {
        let scans = scans(&log.sighting_stamp_s);
        let mut interrupted = false;
        for (number, range) in scans.iter().enumerate() {
            let stamp_s = log.sighting_stamp_s[range.start];
            self.advance(log, stamp_s)?;
            let step = self.filter.update(stamp_s, &log.sightings[range.clone()])?;
            let estimate = self.filter.predicted_pose();
            self.note(stamp_s, estimate, step);
            interrupted = !goes_on(number + 1, scans.len());
            if interrupted {
                break;
            }
        }
        let rows_count = self.kind != SpaceMotionKind::Wandering;
        if let (false, true, Some(last_s)) = (interrupted, rows_count, log.row_stamp_s.last()) {
            self.advance(log, *last_s)?;
        }
        let (smoothed, landmarks) = (self.filter.smoothed(), self.filter.landmarks());
        let Self { stamp_s, live, steps, .. } = self;
        Ok(SpaceRun { stamp_s, live, steps, smoothed, landmarks, interrupted })
    }

    /// Moves the robot to a time, with poses on the way where the last one is long past.
    fn advance(&mut self, log: &SpaceLog, until_s: f64) -> Result<()> {
        // Where velocities wander, the first scan is where the robot starts.
        if self.kind != SpaceMotionKind::Odometry && self.steps.is_empty() {
            self.time_s = until_s;
        }
        match self.kind {
            SpaceMotionKind::Wandering => self.drift(until_s),
            SpaceMotionKind::Odometry | SpaceMotionKind::Gyro => self.follow(log, until_s),
        }
    }

    /// With nothing measured.
    fn drift(&mut self, until_s: f64) -> Result<()> {
        while self.time_s < until_s {
            let next_s =
                if until_s - self.time_s > 1.5 * self.period_s { self.time_s + self.period_s } else { until_s };
            self.filter.advance([0.0; 6], next_s - self.time_s)?;
            self.time_s = next_s;
            if next_s < until_s {
                let estimate = self.filter.glance(next_s);
                self.note(next_s, estimate, SpaceStep::default());
            }
        }
        Ok(())
    }

    /// By the rows of a log.
    fn follow(&mut self, log: &SpaceLog, until_s: f64) -> Result<()> {
        let Some(first_s) = log.row_stamp_s.first() else { return Ok(()) };
        self.time_s = self.time_s.max(first_s.min(until_s));
        while self.time_s < until_s {
            while log.row_stamp_s.get(self.row + 1).is_some_and(|next_s| *next_s <= self.time_s) {
                self.row += 1;
            }
            let next_s = log.row_stamp_s.get(self.row + 1).map_or(until_s, |next_s| next_s.min(until_s));
            self.filter.advance(log.velocity[self.row], next_s - self.time_s)?;
            self.time_s = next_s;
            if self.kind == SpaceMotionKind::Gyro && next_s < until_s && self.filter.turned_rad() > FARTHEST_TURN_RAD {
                let step = self.filter.pass(next_s)?;
                self.note(next_s, self.filter.pose(), step);
                continue;
            }
            let last_s = self.stamp_s.last().copied().unwrap_or(f64::NEG_INFINITY);
            let ends = self.row + 1 == log.row_stamp_s.len() || next_s == log.row_stamp_s[self.row + 1];
            if next_s < until_s && ends && next_s - last_s >= self.period_s {
                let estimate = self.filter.glance(next_s);
                self.note(next_s, estimate, SpaceStep::default());
            }
        }
        Ok(())
    }

    fn note(&mut self, stamp_s: f64, estimate: SpaceEstimate, step: SpaceStep) {
        self.stamp_s.push(stamp_s);
        self.live.push(estimate);
        self.steps.push(step);
    }
}

/// Where each scan stands among the sightings.
fn scans(stamp_s: &[f64]) -> Vec<std::ops::Range<usize>> {
    let mut out = Vec::new();
    let mut start = 0;
    for i in 1..=stamp_s.len() {
        if i == stamp_s.len() || stamp_s[i] != stamp_s[start] {
            out.push(start..i);
            start = i;
        }
    }
    out
}

impl SpaceRun {
    /// Poses of the smoothed path.
    pub fn smoothed_poses(&self) -> impl Iterator<Item = SpacePose> + '_ {
        self.smoothed.path.iter().map(|(_, pose)| *pose)
    }
}
