//! A log as rows, and its rows in the order of time.

use super::row::{ControlRow, Row, SightingsRow};
use crate::error::{Error, Result};
use crate::filter::Sighting;
use crate::geometry::{is_covariance3, Matrix3};
use crate::limits::LARGEST_RATE;

/// A log as the filter reads it. All stamps in seconds.
#[derive(Clone, Debug, Default)]
pub struct LogData {
    /// Stamps of the controls, strictly increasing.
    pub control_stamps_s: Vec<f64>,
    /// Controls, in the columns of the motion model.
    pub controls: Vec<[f64; 3]>,
    /// Covariance of (x, y, heading) that the log states for each row, in the frame of its start, in place of the noise
    /// that the motion model is configured with. Empty where no row has one.
    pub control_covariances: Vec<Option<Matrix3>>,
    /// Stamps of the sightings, ascending; equal stamps of one sensor are one step.
    pub sighting_stamps_s: Vec<f64>,
    /// The sightings.
    pub sightings: Vec<Sighting>,
    /// Numbers of the sensors that made them. Empty where there is one sensor.
    pub sighting_sensors: Vec<u8>,
}

impl LogData {
    /// Errors that say which row is out of order or not finite.
    pub fn validate(&self) -> Result<()> {
        let rows = |a: usize, b: usize, what: &str| {
            if a == b {
                Ok(())
            } else {
                Err(Error::Input(format!("{what}: {a} stamps for {b} rows")))
            }
        };
        rows(self.control_stamps_s.len(), self.controls.len(), "controls")?;
        rows(self.sighting_stamps_s.len(), self.sightings.len(), "sightings")?;
        if !self.sighting_sensors.is_empty() {
            rows(self.sighting_sensors.len(), self.sightings.len(), "sightings (sensors)")?;
        }
        if self.controls.is_empty() && self.sightings.is_empty() {
            return Err(Error::Input("the log is empty: neither controls nor sightings".into()));
        }
        if let Some(i) = self.controls.iter().position(|c| Error::check_control(*c, 0.0).is_err()) {
            let (control, most) = (self.controls[i], LARGEST_RATE);
            return Err(Error::Input(format!("control {i} is {control:?}: expected finite numbers, at most {most:e}")));
        }
        self.check_covariances()?;
        ascending(&self.control_stamps_s, "control", |a, b| a < b)?;
        ascending(&self.sighting_stamps_s, "sighting", |a, b| a <= b)
    }

    /// Tells logs apart: of all numbers in it.
    pub(crate) fn checksum(&self) -> u32 {
        let mut hasher = crc32fast::Hasher::new();
        let mut add = |numbers: &[f64]| numbers.iter().for_each(|v| hasher.update(&v.to_le_bytes()));
        add(&self.control_stamps_s);
        self.controls.iter().for_each(|control| add(control));
        self.control_covariances.iter().flatten().for_each(|stated| add(stated.as_flattened()));
        add(&self.sighting_stamps_s);
        for Sighting { value, identity, noise, appearance } in &self.sightings {
            let [class, identity] = [appearance.class, *identity].map(|v| v.map_or(-1.0, f64::from));
            add(&[value[0], value[1], identity, class, appearance.signature.unwrap_or(f64::NAN)]);
            noise.iter().for_each(|noise| add(&[noise.xx, noise.xy, noise.yy]));
        }
        self.sighting_sensors.iter().for_each(|sensor| add(&[f64::from(*sensor)]));
        hasher.finalize()
    }

    fn check_covariances(&self) -> Result<()> {
        let (rows, controls) = (self.control_covariances.len(), self.controls.len());
        if rows > 0 && rows != controls {
            return Err(Error::Input(format!("controls: {rows} covariances for {controls} rows")));
        }
        let wrong = |stated: &Option<Matrix3>| stated.is_some_and(|c| !is_covariance3(&c));
        match self.control_covariances.iter().position(wrong) {
            Some(i) => {
                let stated = self.control_covariances[i].unwrap_or_default();
                Err(Error::Input(format!(
                    "covariance of control {i} is {stated:?}: expected one without negative directions"
                )))
            }
            None => Ok(()),
        }
    }
}

/// More steps than this in stretches without sightings come from a wrong stamp, not from a robot.
const MOST_FILLERS: f64 = 1e7;

impl LogData {
    /// Errors when the stretches without sightings would take too many steps `path_period_s` apart: a wrong stamp, or one
    /// of another unit. The message names the widest gap. The log must be valid.
    pub fn check_gaps(&self, path_period_s: f64) -> Result<()> {
        let mut rows = self.rows_in_time();
        let Some((mut stamp_s, mut row)) = rows.next() else { return Ok(()) };
        let (mut fillers, mut widest) = (0.0, (0.0, String::new()));
        for (next_s, next) in rows {
            let gap_s = next_s - stamp_s;
            fillers += (gap_s / path_period_s).floor();
            if gap_s > widest.0 {
                widest = (gap_s, format!("from {} to {}", named(row, stamp_s), named(next, next_s)));
            }
            (stamp_s, row) = (next_s, next);
        }
        if fillers <= MOST_FILLERS && stamp_s + path_period_s > stamp_s {
            return Ok(());
        }
        Err(Error::Input(format!(
            "the gap {}, is too wide for steps of filter.path_period_s = {path_period_s} s (10 million at most): is a stamp \
             wrong, or not in seconds?",
            widest.1
        )))
    }

    /// The largest number of a sensor.
    pub fn last_sensor(&self) -> usize {
        self.sighting_sensors.iter().copied().max().unwrap_or(0).into()
    }

    /// Number of the sensor that made a sighting.
    fn sensor(&self, sighting: usize) -> u8 {
        self.sighting_sensors.get(sighting).copied().unwrap_or(0)
    }

    /// Number of steps at most: one per sighting stamp and sensor and one per path period.
    pub fn step_bound(&self, path_period_s: f64) -> usize {
        let stamps = &self.sighting_stamps_s;
        let differ = |i: &usize| stamps[*i - 1] != stamps[*i] || self.sensor(*i - 1) != self.sensor(*i);
        let distinct = usize::from(!stamps.is_empty()) + (1..stamps.len()).filter(differ).count();
        let all = || self.control_stamps_s.iter().chain(stamps);
        let first_s = all().copied().fold(f64::INFINITY, f64::min);
        let last_s = all().copied().fold(f64::NEG_INFINITY, f64::max);
        let fillers = ((last_s - first_s) / path_period_s).ceil().clamp(0.0, MOST_FILLERS);
        distinct + fillers as usize + 2
    }

    /// All rows in time order, as a robot would send them; neighbouring sightings of one stamp and sensor are one row.
    pub fn rows(&self) -> impl Iterator<Item = Row> + '_ {
        let mut sighting = 0;
        let rows = self.rows_in_time().filter_map(move |(stamp_s, (what, i))| {
            if what == "control" {
                let covariance = self.control_covariances.get(i).copied().flatten();
                return Some(Row::Control(ControlRow { stamp_s, control: self.controls[i], covariance }));
            }
            (i >= sighting).then(|| {
                let sensor = self.sensor(i);
                let alike = |k: &usize| self.sighting_stamps_s[*k] == stamp_s && self.sensor(*k) == sensor;
                sighting = i + (i..self.sightings.len()).take_while(alike).count();
                let sightings = self.sightings[i..sighting].to_vec();
                Row::Sightings(SightingsRow { stamp_s, sightings, sensor: sensor.into() })
            })
        });
        rows.chain([Row::End])
    }

    /// Stamps of all rows in time order, each with what its row is and the row's number.
    fn rows_in_time(&self) -> impl Iterator<Item = (f64, (&'static str, usize))> + '_ {
        let (mut control, mut sighting) = (0, 0);
        std::iter::from_fn(move || {
            let next_control = self.control_stamps_s.get(control).copied();
            let next_sighting = self.sighting_stamps_s.get(sighting).copied();
            if next_control.unwrap_or(f64::INFINITY) <= next_sighting.unwrap_or(f64::INFINITY) {
                control += 1;
                next_control.map(|stamp_s| (stamp_s, ("control", control - 1)))
            } else {
                sighting += 1;
                next_sighting.map(|stamp_s| (stamp_s, ("sighting", sighting - 1)))
            }
        })
    }
}

fn named((what, number): (&str, usize), stamp_s: f64) -> String {
    format!("{what} {number}, at {stamp_s:?} s")
}

fn ascending(stamps: &[f64], what: &str, ordered: impl Fn(f64, f64) -> bool) -> Result<()> {
    if let Some(i) = stamps.iter().position(|s| !s.is_finite()) {
        return Err(Error::Input(format!("stamp of {what} {i} is not finite: {}", stamps[i])));
    }
    match stamps.windows(2).position(|pair| !ordered(pair[0], pair[1])) {
        Some(i) => Err(Error::Input(format!(
            "stamp of {what} {} is {} s, after {} s: expected stamps in ascending order",
            i + 1,
            stamps[i + 1],
            stamps[i]
        ))),
        None => Ok(()),
    }
}
