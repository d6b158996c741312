//! Merges controls and sightings into the steps of a run.

mod log;
mod row;

use crate::motion::{ControlTiming, RowPart};
pub use log::LogData;
pub use row::{ControlRow, Row, SightingsRow};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// One thing that happens to the filter.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// The robot moves by a row of odometry or a part of it.
    Control(RowPart),
    /// All sightings of one sensor and stamp; none at all only records where the robot is.
    Step(SightingsRow),
}

/// The steps of a stream or a log with the controls between them, in time order.
///
/// Rows are put in, in any order of those that are not settled yet; the events that follow from what is settled are
/// taken out as from an iterator, which says `None` where more rows must come first.
///
/// A row is cut where a sighting falls into it. Stretches without sightings get empty steps `path_period_s` apart, so
/// that the path has no gaps; they cut rows too. A part knows the row that it is of, so that cutting changes nothing.
///
/// A held row lasts until the next one, the last until the end. An increment lasts from the row before; the first
/// from the first sighting, if that is earlier.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Timeline {
    timing: ControlTiming,
    path_period_s: f64,
    /// How long sightings wait for the control that says how the robot came to where it saw them.
    wait_s: f64,
    controls: VecDeque<ControlRow>,
    /// In the order of stamps, then of sensors.
    sightings: VecDeque<SightingsRow>,
    /// The control that holds.
    held: Option<ControlRow>,
    clock: Clock,
}

/// Moments of a timeline, in seconds.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
struct Clock {
    begun: bool,
    now_s: f64,
    last_step_s: f64,
    /// Where the present row of odometry begins.
    row_start_s: f64,
    /// All that is earlier has come.
    settled_s: f64,
    /// Infinite as long as more may come.
    end_s: f64,
    /// Whether there was a step with sightings, or after the first moment.
    recorded: bool,
    done: bool,
}

impl Timeline {
    /// Nothing yet. `wait_s` is how long sightings wait for odometry, in time of the stamps.
    pub fn new(timing: ControlTiming, path_period_s: f64, wait_s: f64) -> Self {
        let clock = Clock {
            begun: false,
            now_s: 0.0,
            last_step_s: 0.0,
            row_start_s: 0.0,
            settled_s: f64::NEG_INFINITY,
            end_s: f64::INFINITY,
            recorded: false,
            done: false,
        };
        let (controls, sightings, held) = Default::default();
        Self { timing, path_period_s, wait_s, controls, sightings, held, clock }
    }

    /// All of a valid log.
    pub fn of(log: &LogData, timing: ControlTiming, path_period_s: f64) -> Self {
        let mut timeline = Self::new(timing, path_period_s, f64::INFINITY);
        for row in log.rows() {
            timeline.put(row);
        }
        timeline
    }

    /// Takes a row, which must not be settled. `false` for one that is there already.
    pub fn put(&mut self, row: Row) -> bool {
        match row {
            Row::Control(row) => {
                let place = self.controls.partition_point(|known| known.stamp_s < row.stamp_s);
                let repeated = self.controls.get(place).is_some_and(|known| known.stamp_s == row.stamp_s);
                if !repeated {
                    self.controls.insert(place, row);
                }
                !repeated
            }
            Row::Sightings(mut row) => {
                let of = |row: &SightingsRow| (row.stamp_s, row.sensor);
                let place = self.sightings.partition_point(|known| of(known) < of(&row));
                match self.sightings.get_mut(place).filter(|known| of(known) == of(&row)) {
                    Some(known) if known.sightings == row.sightings => return false,
                    Some(known) => known.sightings.append(&mut row.sightings),
                    None => self.sightings.insert(place, row),
                }
                true
            }
            Row::End => {
                self.end();
                true
            }
        }
    }

    /// Says that all rows before this moment have come.
    pub fn settle(&mut self, settled_s: f64) {
        self.clock.settled_s = self.clock.settled_s.max(settled_s);
    }

    /// All that is earlier has come.
    pub fn settled_s(&self) -> f64 {
        self.clock.settled_s
    }

    /// Up to where events were taken; none before the first.
    pub fn now_s(&self) -> Option<f64> {
        self.clock.begun.then_some(self.clock.now_s)
    }

    /// Rows that wait.
    pub fn waiting(&self) -> usize {
        self.controls.len() + self.sightings.len()
    }

    /// The sensors of the sightings that wait, for a snapshot: none where all are of the first.
    pub(crate) fn sensors(&self) -> Vec<u8> {
        let sensors: Vec<u8> = self.sightings.iter().map(|row| row.sensor as u8).collect();
        if sensors.iter().all(|sensor| *sensor == 0) {
            Vec::new()
        } else {
            sensors
        }
    }

    /// The same from a snapshot.
    pub(crate) fn set_sensors(&mut self, sensors: &[u8]) {
        self.sightings.iter_mut().zip(sensors).for_each(|(row, sensor)| row.sensor = usize::from(*sensor));
    }

    /// Where the last row is: nothing more comes.
    fn end(&mut self) {
        let last = [self.controls.back().map(|row| row.stamp_s), self.sightings.back().map(|row| row.stamp_s)];
        let passed_s = if self.clock.begun { self.clock.now_s } else { f64::NEG_INFINITY };
        self.clock.end_s = last.into_iter().flatten().fold(passed_s, f64::max);
        self.clock.settled_s = f64::INFINITY;
    }

    /// Stamp of the first row of each kind that waits.
    fn next_stamps(&self) -> [f64; 2] {
        let control = self.controls.front().map(|row| row.stamp_s);
        let sighting = self.sightings.front().map(|row| row.stamp_s);
        [control, sighting].map(|stamp| stamp.unwrap_or(f64::INFINITY))
    }

    /// The next moment at which something happens, where it is settled; the first one starts the clock.
    fn target(&mut self) -> Option<f64> {
        let [next_control, next_sighting] = self.next_stamps();
        let clock = &mut self.clock;
        let next_row = next_sighting.min(next_control);
        if !clock.begun && next_row < clock.settled_s {
            let start_s = next_row;
            *clock = Clock { begun: true, now_s: start_s, last_step_s: start_s, row_start_s: start_s, ..*clock };
        }
        let filler = (clock.last_step_s + self.path_period_s).min(clock.end_s);
        let target = next_row.min(filler);
        (clock.begun && !clock.done && target < clock.settled_s).then_some(target)
    }

    /// Whether it is known how the robot moves until then.
    fn knows_motion(&self, until_s: f64) -> bool {
        if self.timing == ControlTiming::Held && self.held.is_none() {
            return true;
        }
        match self.controls.front() {
            Some(next) => next.stamp_s <= self.clock.settled_s,
            None => self.clock.settled_s - until_s > self.wait_s || self.clock.end_s.is_finite(),
        }
    }

    /// The motion from now to `until_s`, which no event interrupts.
    fn motion_until(&mut self, until_s: f64) -> Option<Event> {
        let clock = &mut self.clock;
        let from_s = std::mem::replace(&mut clock.now_s, until_s);
        let row_start_s = clock.row_start_s;
        let next = self.controls.front().copied();
        let (row, row_end_s) = match self.timing {
            // The last control at or before `from_s` holds.
            ControlTiming::Held => {
                let row_end_s = next.map(|row| row.stamp_s).or(clock.end_s.is_finite().then_some(clock.end_s));
                if row_end_s.is_none() {
                    // Nobody knows how long: the row ends here, and begins anew.
                    clock.row_start_s = until_s;
                }
                (self.held?, row_end_s.unwrap_or(until_s))
            }
            ControlTiming::Increment => {
                let Some(row) = next else {
                    // What was driven meanwhile is of the row that comes.
                    clock.row_start_s = until_s;
                    return None;
                };
                if until_s >= row.stamp_s {
                    clock.row_start_s = row.stamp_s;
                    self.controls.pop_front();
                }
                (row, row.stamp_s)
            }
        };
        let row_s = (row_end_s - row_start_s).max(0.0);
        let share = if row_s > 0.0 { (until_s - from_s) / row_s } else { 1.0 };
        let part = RowPart { control: row.control, row_s, share, covariance: row.covariance };
        (share > 0.0).then_some(Event::Control(part))
    }

    /// A control that takes effect now.
    fn begin_control(&mut self) -> Option<Event> {
        match self.timing {
            ControlTiming::Held => {
                self.held = self.controls.pop_front();
                self.clock.row_start_s = self.held.map_or(self.clock.row_start_s, |row| row.stamp_s);
                None
            }
            ControlTiming::Increment => self.motion_until(self.clock.now_s),
        }
    }

    /// A step without sightings, unless this moment has a step: at the end, or in a long gap.
    fn filler(&mut self) -> Option<Event> {
        let clock = &mut self.clock;
        let there = clock.last_step_s == clock.now_s && clock.recorded;
        clock.done = clock.now_s >= clock.end_s;
        clock.last_step_s = clock.now_s;
        (!there).then(|| Event::Step(SightingsRow::new(clock.now_s, Vec::new())))
    }
}

impl Iterator for Timeline {
    type Item = Event;

    fn next(&mut self) -> Option<Event> {
        loop {
            let target = self.target()?;
            let [next_control, next_sighting] = self.next_stamps();
            let now_s = self.clock.now_s;
            let event = if next_control <= now_s && next_control <= target {
                self.begin_control()
            } else if target > now_s {
                if !self.knows_motion(target) {
                    return None;
                }
                self.motion_until(target)
            } else if next_sighting <= now_s {
                (self.clock.last_step_s, self.clock.recorded) = (now_s, true);
                self.sightings.pop_front().map(Event::Step)
            } else {
                self.filler()
            };
            if event.is_some() {
                return event;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sighting::Sighting;

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
        for event in Timeline::of(log, timing, period) {
            match event {
                Event::Control(part) => {
                    distance +=
                        part.control[0] * part.share * if timing == ControlTiming::Held { part.row_s } else { 1.0 };
                    time += part.duration_s();
                }
                Event::Step(SightingsRow { stamp_s, sightings, .. }) => {
                    out.push((stamp_s, sightings.len(), distance, time))
                }
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
            assert!(wrong.step_bound(period) < 10_000_010);
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
        let parts: Vec<RowPart> = Timeline::of(&log, ControlTiming::Held, 0.75)
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
        let parts = Timeline::of(&log, ControlTiming::Increment, 5.0).filter_map(|event| match event {
            Event::Control(part) => Some(part.covariance),
            Event::Step(_) => None,
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
