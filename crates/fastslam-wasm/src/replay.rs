//! A native log as the page goes through it.

use crate::settings::Settings;
use crate::tables::{self, Files};
use fastslam_core::config::{AssociationMode, Config};
use fastslam_core::filter::{Identities, Sighting};
use fastslam_core::geometry::Pose;
use fastslam_core::motion::RowPart;
use fastslam_core::timeline::{Event, LogData, SightingsRow, Timeline};

/// One thing that happened.
pub enum Moment {
    /// The robot moved.
    Moved(RowPart),
    /// It looked.
    Scan {
        /// Seconds.
        stamp_s: f64,
        /// What it saw; may be nothing.
        sightings: Vec<Sighting>,
    },
}

/// A log under way.
pub struct Replay {
    /// What the log says of its noise, and the page of the rest.
    pub config: Config,
    /// Which sightings have one.
    pub identities: Identities,
    /// Where the robot is by its odometry alone.
    pub T_world_reported: Pose,
    /// Where it was at every step.
    pub reported_path: Vec<[f64; 2]>,
    /// What the page should tell of the files.
    pub notes: Vec<String>,
    timeline: Timeline,
    /// The event that comes next.
    waiting: Option<Event>,
    range_s: [f64; 2],
    now_s: f64,
}

impl Replay {
    /// The log in these files; its `log.yaml` overrules the noise of the page.
    pub fn new(files: &Files, settings: &Settings) -> Result<Self, String> {
        let (log, config, notes) = tables::read(files, settings)?;
        config.validate().map_err(|error| error.to_string())?;
        log.validate().map_err(|error| error.to_string())?;
        log.check_gaps(config.filter.path_period_s).map_err(|error| error.to_string())?;
        let stamps = || log.control_stamps_s.iter().chain(&log.sighting_stamps_s).copied();
        let range_s = [stamps().fold(f64::INFINITY, f64::min), stamps().fold(f64::NEG_INFINITY, f64::max)];
        let mut timeline = Timeline::of(&log, config.motion.timing(), config.filter.path_period_s);
        let waiting = timeline.next();
        let start = config.initial_pose.T_world_robot();
        let identities =
            if config.association.mode == AssociationMode::Unknown { Identities::None } else { named(&log) };
        let reported_path = vec![[start.x, start.y]];
        let (T_world_reported, now_s) = (start, range_s[0]);
        Ok(Self { config, identities, T_world_reported, reported_path, notes, timeline, waiting, range_s, now_s })
    }

    /// What comes next up to a time; none where that is later.
    pub fn next(&mut self, until_s: f64) -> Result<Option<Moment>, String> {
        if let Some(Event::Step(SightingsRow { stamp_s, .. })) = &self.waiting {
            if *stamp_s > until_s {
                self.now_s = until_s;
                return Ok(None);
            }
        }
        let Some(event) = self.waiting.take() else {
            self.now_s = self.range_s[1];
            return Ok(None);
        };
        self.waiting = self.timeline.next();
        match event {
            Event::Control(part) => {
                let motion = self.config.motion.of(&part).map_err(|error| error.to_string())?;
                self.T_world_reported = self.T_world_reported.compose(motion.mean);
                Ok(Some(Moment::Moved(part)))
            }
            Event::Step(SightingsRow { stamp_s, sightings, .. }) => {
                self.now_s = stamp_s;
                self.reported_path.push([self.T_world_reported.x, self.T_world_reported.y]);
                Ok(Some(Moment::Scan { stamp_s, sightings }))
            }
        }
    }

    /// Whether nothing is left.
    pub fn is_done(&self) -> bool {
        self.waiting.is_none()
    }

    /// Where the replay stands, seconds.
    pub fn now_s(&self) -> f64 {
        self.now_s
    }

    /// When the log begins, seconds.
    pub fn first_s(&self) -> f64 {
        self.range_s[0]
    }

    /// When it ends, seconds.
    pub fn last_s(&self) -> f64 {
        self.range_s[1]
    }
}

/// Which sightings have an identity.
fn named(log: &LogData) -> Identities {
    match log.sightings.iter().filter(|sighting| sighting.identity.is_some()).count() {
        count if count == log.sightings.len() => Identities::All,
        0 => Identities::None,
        _ => Identities::Some,
    }
}
