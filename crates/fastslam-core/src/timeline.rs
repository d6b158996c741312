//! Merges controls and sightings into the steps of a run.

use crate::error::{Error, Result};
use crate::filter::Sighting;
use crate::geometry::{is_covariance3, Matrix3};
use crate::limits::LARGEST_RATE;
use crate::motion::{ControlTiming, RowPart};

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
    /// Stamps of the sightings, ascending; equal stamps are one step.
    pub sighting_stamps_s: Vec<f64>,
    /// The sightings.
    pub sightings: Vec<Sighting>,
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

/// One thing that happens to the filter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Event {
    /// The robot moves by a row of odometry or a part of it.
    Control(RowPart),
    /// All sightings of one stamp, as a range of rows; an empty range only records where the robot is.
    Step {
        /// Seconds.
        stamp_s: f64,
        /// First row.
        first: usize,
        /// One past the last row.
        end: usize,
    },
}

/// The steps of a log with the controls between them, in time order.
///
/// A row is cut where a sighting falls into it. Stretches without sightings get empty steps `path_period_s` apart, so
/// that the path has no gaps; they cut rows too. A part knows the row that it is of, so that cutting changes nothing.
///
/// A held row lasts until the next one, the last until the log ends. An increment lasts from the row before; the first
/// from the first sighting, if that is earlier.
pub struct Timeline<'a> {
    log: &'a LogData,
    timing: ControlTiming,
    path_period_s: f64,
    start_s: f64,
    now_s: f64,
    last_step_s: f64,
    control: usize,
    sighting: usize,
    end_s: f64,
    done: bool,
}

impl<'a> Timeline<'a> {
    /// The timeline of a valid log.
    pub fn new(log: &'a LogData, timing: ControlTiming, path_period_s: f64) -> Self {
        let first = |stamps: &[f64]| stamps.first().copied().unwrap_or(f64::INFINITY);
        let last = |stamps: &[f64]| stamps.last().copied().unwrap_or(f64::NEG_INFINITY);
        let start_s = first(&log.control_stamps_s).min(first(&log.sighting_stamps_s));
        Self {
            log,
            timing,
            path_period_s,
            start_s,
            now_s: start_s,
            last_step_s: start_s,
            control: 0,
            sighting: 0,
            end_s: last(&log.control_stamps_s).max(last(&log.sighting_stamps_s)),
            done: false,
        }
    }

    /// Number of steps at most: one per sighting stamp and one per path period.
    pub fn step_bound(&self) -> usize {
        let stamps = &self.log.sighting_stamps_s;
        let distinct = usize::from(!stamps.is_empty()) + stamps.windows(2).filter(|w| w[0] != w[1]).count();
        let fillers = ((self.end_s - self.now_s) / self.path_period_s).ceil().clamp(0.0, MOST_FILLERS);
        distinct + fillers as usize + 2
    }

    /// The motion from now to `until_s`, which no event interrupts.
    fn motion_until(&mut self, until_s: f64) -> Option<Event> {
        let from_s = std::mem::replace(&mut self.now_s, until_s);
        let stamps = &self.log.control_stamps_s;
        let (index, row_start_s, row_end_s) = match self.timing {
            // The last control at or before `from_s` holds.
            ControlTiming::Held => {
                let index = self.control.checked_sub(1)?;
                (index, stamps[index], stamps.get(index + 1).copied().unwrap_or(self.end_s))
            }
            ControlTiming::Increment => {
                let index = self.control;
                let row_end_s = *stamps.get(index)?;
                self.control += usize::from(until_s >= row_end_s);
                (index, index.checked_sub(1).map_or(self.start_s, |before| stamps[before]), row_end_s)
            }
        };
        let row_s = (row_end_s - row_start_s).max(0.0);
        let share = if row_s > 0.0 { (until_s - from_s) / row_s } else { 1.0 };
        let covariance = self.log.control_covariances.get(index).copied().flatten();
        let control = self.log.controls[index];
        (share > 0.0).then_some(Event::Control(RowPart { control, row_s, share, covariance }))
    }

    /// Stamp at which the present control ends.
    fn next_control_stamp(&self) -> f64 {
        self.log.control_stamps_s.get(self.control).copied().unwrap_or(f64::INFINITY)
    }
}

impl Iterator for Timeline<'_> {
    type Item = Event;

    fn next(&mut self) -> Option<Event> {
        loop {
            let sightings = &self.log.sighting_stamps_s;
            let next_sighting = sightings.get(self.sighting).copied().unwrap_or(f64::INFINITY);
            let next_control = self.next_control_stamp();
            let filler = (self.last_step_s + self.path_period_s).min(self.end_s);
            let target = next_sighting.min(next_control).min(filler);
            if self.done || !target.is_finite() {
                return None;
            }
            // A control that takes effect now.
            if next_control <= self.now_s && next_control <= target {
                match self.timing {
                    ControlTiming::Held => self.control += 1,
                    ControlTiming::Increment => return self.motion_until(self.now_s),
                }
                continue;
            }
            if target > self.now_s {
                if let Some(event) = self.motion_until(target) {
                    return Some(event);
                }
                continue;
            }
            if next_sighting <= self.now_s {
                let first = self.sighting;
                let count = sightings[first..].iter().take_while(|s| **s == next_sighting).count();
                self.sighting += count;
                self.last_step_s = self.now_s;
                return Some(Event::Step { stamp_s: next_sighting, first, end: first + count });
            }
            // Nothing but the end or a long gap stops here.
            let at_end = self.now_s >= self.end_s;
            let recorded = self.last_step_s == self.now_s && self.sighting > 0;
            self.done = at_end;
            self.last_step_s = self.now_s;
            if !recorded {
                return Some(Event::Step { stamp_s: self.now_s, first: self.sighting, end: self.sighting });
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sighting() -> Sighting {
        Sighting::range_bearing(1.0, 0.0, None)
    }

    fn log(controls: &[(f64, [f64; 3])], sightings: &[f64]) -> LogData {
        LogData {
            control_stamps_s: controls.iter().map(|c| c.0).collect(),
            controls: controls.iter().map(|c| c.1).collect(),
            sighting_stamps_s: sightings.to_vec(),
            sightings: vec![sighting(); sightings.len()],
            ..LogData::default()
        }
    }

    /// Distance driven and duration before each step, with the step's stamp and its sightings.
    fn steps(log: &LogData, timing: ControlTiming, period: f64) -> Vec<(f64, usize, f64, f64)> {
        assert_eq!(log.validate(), Ok(()));
        let mut out = Vec::new();
        let (mut distance, mut time) = (0.0, 0.0);
        for event in Timeline::new(log, timing, period) {
            match event {
                Event::Control(part) => {
                    distance +=
                        part.control[0] * part.share * if timing == ControlTiming::Held { part.row_s } else { 1.0 };
                    time += part.duration_s();
                }
                Event::Step { stamp_s, first, end } => out.push((stamp_s, end - first, distance, time)),
            }
        }
        out
    }

    #[test]
    fn a_held_control_is_cut_at_the_sightings() {
        let log = log(&[(0.0, [1.0, 0.0, 0.0]), (1.0, [2.0, 0.0, 0.0])], &[0.25, 0.25, 1.5]);
        let expected = vec![(0.25, 2, 0.25, 0.25), (1.5, 1, 2.0, 1.5)];
        assert_eq!(steps(&log, ControlTiming::Held, 10.0), expected);
    }

    #[test]
    fn an_increment_is_cut_in_proportion() {
        let log = log(&[(1.0, [1.0, 0.0, 0.0]), (2.0, [4.0, 0.0, 0.0])], &[1.0, 1.25, 2.0]);
        let got: Vec<(f64, f64)> = steps(&log, ControlTiming::Increment, 10.0).iter().map(|s| (s.0, s.2)).collect();
        assert_eq!(got, vec![(1.0, 1.0), (1.25, 2.0), (2.0, 5.0)]);
    }

    #[test]
    fn gaps_are_filled_and_the_end_is_recorded() {
        let log = log(&[(0.0, [1.0, 0.0, 0.0]), (3.2, [0.0, 0.0, 0.0])], &[0.5]);
        let got: Vec<(f64, usize)> = steps(&log, ControlTiming::Held, 1.0).iter().map(|s| (s.0, s.1)).collect();
        assert_eq!(got, vec![(0.5, 1), (1.5, 0), (2.5, 0), (3.2, 0)]);
    }

    #[test]
    fn sightings_before_the_first_control_are_steps_at_rest() {
        let log = log(&[(1.0, [1.0, 0.0, 0.0])], &[0.0, 1.0, 2.0]);
        let got = steps(&log, ControlTiming::Held, 10.0);
        assert_eq!(got.iter().map(|s| s.2).collect::<Vec<_>>(), vec![0.0, 0.0, 1.0]);
    }

    #[test]
    fn every_control_acts_exactly_once() {
        let controls: Vec<(f64, [f64; 3])> = (0..50).map(|i| (0.1 * f64::from(i), [1.0, 0.0, 0.0])).collect();
        let sightings: Vec<f64> = (0..16).map(|i| 0.31 * f64::from(i)).collect();
        let held = steps(&log(&controls, &sightings), ControlTiming::Held, 0.4);
        assert!((held.last().unwrap().2 - 4.9).abs() < 1e-9);
        let increments = steps(&log(&controls, &sightings), ControlTiming::Increment, 0.4);
        assert!((increments.last().unwrap().2 - 50.0).abs() < 1e-9, "{increments:?}");
    }

    #[test]
    fn a_wrong_stamp_is_an_error_that_names_the_gap() {
        let mut controls: Vec<(f64, [f64; 3])> = (0..600).map(|i| (0.1 * f64::from(i), [1.0, 0.0, 0.0])).collect();
        let sound = log(&controls, &[0.0, 30.0]);
        assert_eq!(sound.check_gaps(0.5), Ok(()));
        // 59.9 s in steps of 6 µs are ten million.
        assert_eq!(sound.check_gaps(6e-6), Ok(()));
        assert!(sound.check_gaps(5.9e-6).is_err());
        for period in [1e-300, f64::MIN_POSITIVE, 1e-18] {
            assert!(sound.check_gaps(period).is_err(), "{period}");
        }
        for wrong in [1_764_313_200.5, 1.7e18, f64::MAX] {
            controls.push((wrong, [1.0, 0.0, 0.0]));
            let message = log(&controls, &[0.0, 30.0]).check_gaps(0.5).unwrap_err().to_string();
            assert!(message.starts_with("the gap from control 599, at 59.9"), "{message}");
            assert!(message.contains(&format!("to control 600, at {wrong:?} s")), "{message}");
            controls.pop();
        }
        let message = log(&controls, &[-1e9, 30.0]).check_gaps(0.5).unwrap_err().to_string();
        assert!(message.starts_with("the gap from sighting 0, at -1000000000.0 s to control 0, at 0.0 s"), "{message}");
    }

    #[test]
    fn stamps_too_coarse_for_the_period_are_an_error_and_no_endless_loop() {
        // Doubles near 1e10 lie 2 µs apart.
        let coarse = log(&[(1e10, [1.0, 0.0, 0.0]), (1e10 + 1e-5, [1.0, 0.0, 0.0])], &[]);
        assert!(coarse.check_gaps(1e-7).is_err());
        assert_eq!(coarse.check_gaps(1e-5), Ok(()));
    }

    #[test]
    fn nothing_is_sized_from_a_stamp() {
        let wrong = log(&[(0.0, [1.0, 0.0, 0.0]), (1.7e18, [1.0, 0.0, 0.0])], &[]);
        for period in [0.5, 1e-300] {
            assert!(Timeline::new(&wrong, ControlTiming::Held, period).step_bound() < 10_000_010);
        }
    }

    #[test]
    fn a_first_increment_that_begins_with_the_sightings_acts_once_however_it_is_cut() {
        let log = log(&[(1.0, [3.0, 0.0, 0.0]), (2.0, [1.0, 0.0, 0.0])], &[0.0, 0.5]);
        for period in [5.0, 0.5, 0.2] {
            let end = *steps(&log, ControlTiming::Increment, period).last().unwrap();
            assert!((end.2 - 4.0).abs() < 1e-12 && (end.3 - 2.0).abs() < 1e-12, "{period}: {end:?}");
        }
    }

    #[test]
    fn the_parts_of_a_row_name_the_row() {
        let log = log(&[(0.0, [1.0, 0.0, 0.0]), (2.0, [2.0, 0.0, 0.0])], &[0.5, 3.0]);
        let parts: Vec<RowPart> = Timeline::new(&log, ControlTiming::Held, 0.75)
            .filter_map(|event| if let Event::Control(part) = event { Some(part) } else { None })
            .collect();
        let rows: Vec<(f64, f64)> = parts.iter().map(|p| (p.control[0], p.row_s)).collect();
        assert_eq!(rows, [(1.0, 2.0), (1.0, 2.0), (1.0, 2.0), (2.0, 1.0), (2.0, 1.0)]);
        assert_eq!(parts.iter().map(|p| p.share).collect::<Vec<_>>(), [0.25, 0.375, 0.375, 0.75, 0.25]);
    }

    #[test]
    fn a_part_has_the_covariance_that_its_row_states() {
        let mut log = log(&[(0.0, [0.0; 3]), (1.0, [1.0, 0.0, 0.0]), (2.0, [1.0, 0.0, 0.0])], &[0.5, 1.5]);
        let stated = [[0.04, 0.0, 0.0], [0.0, 0.01, 0.002], [0.0, 0.002, 0.01]];
        log.control_covariances = vec![None, Some(stated), None];
        assert_eq!(log.validate(), Ok(()));
        let parts = Timeline::new(&log, ControlTiming::Increment, 5.0).filter_map(|event| match event {
            Event::Control(part) => Some(part.covariance),
            Event::Step { .. } => None,
        });
        assert_eq!(parts.collect::<Vec<_>>(), [None, Some(stated), Some(stated), None, None]);
    }

    #[test]
    fn a_covariance_that_is_none_is_an_error_that_names_the_row() {
        let mut log = log(&[(0.0, [0.0; 3]), (1.0, [0.0; 3])], &[]);
        let message = |log: &LogData| log.validate().unwrap_err().to_string();
        log.control_covariances = vec![None];
        assert_eq!(message(&log), "controls: 1 covariances for 2 rows");
        let diagonal = |x: f64, y: f64| [[x, 0.0, 0.0], [0.0, y, 0.0], [0.0, 0.0, 0.0]];
        let across = [[1.0, 2.0, 0.0], [2.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let skew = [[1.0, 0.5, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        for wrong in [diagonal(-1.0, 1.0), diagonal(f64::NAN, 1.0), diagonal(f64::INFINITY, 1.0), across, skew] {
            log.control_covariances = vec![Some(diagonal(0.0, 1.0)), Some(wrong)];
            assert!(message(&log).starts_with("covariance of control 1 is [["), "{}", message(&log));
        }
        log.control_covariances = vec![Some(diagonal(0.0, 0.0)), None];
        assert_eq!(log.validate(), Ok(()));
    }

    #[test]
    fn disorder_is_an_error_that_names_the_row() {
        let bad = log(&[(0.0, [0.0; 3]), (0.0, [0.0; 3])], &[]);
        assert!(bad.validate().unwrap_err().to_string().starts_with("stamp of control 1 is 0 s, after 0 s"));
        let bad = log(&[], &[1.0, f64::NAN]);
        assert!(bad.validate().unwrap_err().to_string().contains("sighting 1"));
        assert!(log(&[], &[]).validate().is_err());
    }
}
