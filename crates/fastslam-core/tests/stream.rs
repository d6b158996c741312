//! A stream of rows gives what a run over the log gives, in whatever order the window lets them come.

use crate::blind::Blind;
use fastslam_core::config::{Algorithm, Config};
use fastslam_core::filter::{Identities, Sighting};
use fastslam_core::motion::{Increments, Motion, Velocity};
use fastslam_core::random::{Purpose, RandomSource};
use fastslam_core::run::{run, StepRecord};
use fastslam_core::stream::{Refused, Stream, Taken, Window};
use fastslam_core::timeline::{ControlRow, LogData, Row, SightingsRow};
use fastslam_sim::{simulate, SimulationConfig};

const LATE: Window = Window { late_s: 0.7, wait_s: 20.0, gap_s: 60.0 };

fn log_of(motion: Motion, seed: u64) -> (LogData, Config) {
    let mut simulation = SimulationConfig::preset("demo").unwrap();
    (simulation.seed, simulation.motion, simulation.max_duration_s) = (seed, motion, Some(25.0));
    let log = simulate(&simulation).unwrap();
    let mut config = Config { seed, motion: log.motion.clone(), sensor: log.sensor.clone(), ..Config::default() };
    (config.filter.particles, config.filter.path_period_s) = (15, 0.3);
    (log.log_data(), config)
}

fn motions() -> [Motion; 2] {
    [Motion::Velocity(Velocity::default()), Motion::Increments(Increments::default())]
}

/// The rows in the order in which they come when each is delayed by up to the window.
fn shuffled(log: &LogData, seed: u64) -> Vec<Row> {
    let noise = RandomSource::new(seed).stream(Purpose::Simulation, 0);
    let mut rows: Vec<(f64, Row)> = Vec::new();
    for (i, row) in log.rows().enumerate() {
        let stamp_s = match &row {
            Row::Control(row) => row.stamp_s,
            Row::Sightings(row) => row.stamp_s,
            Row::End => f64::INFINITY,
        };
        let delay_s = LATE.late_s * noise.uniform(i as u32, 0);
        rows.push((stamp_s + delay_s, row));
    }
    rows.sort_by(|a, b| a.0.total_cmp(&b.0));
    rows.into_iter().map(|(_, row)| row).collect()
}

fn drain(stream: &mut Stream, steps: &mut Vec<StepRecord>) {
    while let Some(record) = stream.step().unwrap() {
        steps.push(record);
    }
}

fn without_clock(steps: &[StepRecord]) -> Vec<StepRecord> {
    steps.iter().map(|step| StepRecord { latency_s: 0.0, ..*step }).collect()
}

#[test]
fn rows_in_any_order_within_the_window_give_the_bits_of_a_run_also_across_a_snapshot() {
    let mut cases = 0;
    for (seed, motion) in motions().into_iter().enumerate() {
        for algorithm in [Algorithm::Fastslam1, Algorithm::Fastslam2, Algorithm::Ekf] {
            let (log, config) = log_of(motion.clone(), seed as u64 + 11);
            let config = Config { algorithm, ..config };
            let expected = run(&config, &log, &mut Blind).unwrap();
            assert!(expected.steps.len() > 60 && expected.map.landmarks.len() > 5);
            let mut stream = Stream::new(config, Identities::All, LATE).unwrap();
            let (rows, mut steps) = (shuffled(&log, seed as u64), Vec::new());
            let in_order: Vec<Row> = log.rows().collect();
            assert_ne!(rows, in_order);
            let cut = rows.len() / 2;
            for (i, row) in rows.into_iter().enumerate() {
                assert_eq!(stream.push(row), Ok(Taken::Yes));
                drain(&mut stream, &mut steps);
                if i == cut {
                    assert!(stream.waiting() > 0);
                    stream = Stream::load(&stream.save("kept").unwrap(), &fastslam_core::slam::create)
                        .map(|(s, note)| (s, note == "kept").0)
                        .unwrap();
                }
            }
            stream.finish();
            assert_eq!(steps, without_clock(&expected.steps));
            assert_eq!(stream.smoothed(), expected.smoothed);
            assert_eq!(stream.filter().map(), expected.map);
            assert_eq!((stream.refused(), stream.waiting()), (Refused::default(), 0));
            cases += 1;
        }
    }
    assert_eq!(cases, 6);
}

#[test]
fn the_newest_pose_is_where_the_waiting_rows_lead() {
    for motion in motions() {
        let (log, config) = log_of(motion, 5);
        let mut stream = Stream::new(config, Identities::All, LATE).unwrap();
        assert_eq!(stream.newest_pose(), Ok(None));
        let mut compared = 0;
        let (mut steps, mut newest) = (Vec::new(), Vec::new());
        for row in log.rows() {
            let is_control = matches!(row, Row::Control(_));
            stream.push(row).unwrap();
            drain(&mut stream, &mut steps);
            if is_control {
                newest.extend(stream.newest_pose().unwrap());
            }
        }
        for step in &steps {
            if let Some((_, pose)) = newest.iter().find(|(stamp_s, _)| *stamp_s == step.stamp_s) {
                let off = (pose.mean.x - step.pose.mean.x).hypot(pose.mean.y - step.pose.mean.y);
                // Said 0.7 s before, at about 1 m/s, without what was seen meanwhile.
                assert!(off < 0.3, "{off} m");
                compared += 1;
            }
        }
        assert!(compared > 20, "{compared}");
    }
}

fn control(stamp_s: f64) -> Row {
    Row::Control(ControlRow { stamp_s, control: [1.0, 0.0, 0.0], covariance: None })
}

fn seen(stamp_s: f64) -> Row {
    Row::Sightings(SightingsRow::new(stamp_s, vec![Sighting::range_bearing(5.0, 0.1, Some((10.0 * stamp_s) as u32))]))
}

fn small(motion: Motion) -> Stream {
    let window = Window { late_s: 0.5, wait_s: 1.0, gap_s: 10.0 };
    let mut config = Config { motion, ..Config::default() };
    config.filter.particles = 5;
    Stream::new(config, Identities::All, window).unwrap()
}

#[test]
fn what_comes_too_late_again_or_from_another_clock_is_refused_and_counted() {
    let mut stream = small(Motion::default());
    for stamp in [0.0, 0.1, 1.0] {
        assert_eq!(stream.push(control(stamp)), Ok(Taken::Yes));
    }
    assert_eq!(stream.push(control(0.4)), Ok(Taken::Late));
    assert_eq!(stream.push(seen(0.5)), Ok(Taken::Yes));
    assert_eq!(stream.push(seen(0.5)), Ok(Taken::Repeated));
    assert_eq!(stream.push(control(1.0)), Ok(Taken::Repeated));
    // A wrong stamp alone; then a clock that was set.
    assert_eq!(stream.push(control(1.7e9)), Ok(Taken::Ahead));
    assert_eq!(stream.push(control(1.1)), Ok(Taken::Yes));
    assert_eq!(stream.push(control(50.0)), Ok(Taken::Ahead));
    assert_eq!(stream.push(control(50.1)), Ok(Taken::Yes));
    assert_eq!(stream.push(control(1.2)), Ok(Taken::Late));
    assert_eq!(stream.refused(), Refused { late: 2, repeated: 2, ahead: 2 });
}

#[test]
fn numbers_that_are_none_leave_the_state_as_it_was() {
    let mut stream = small(Motion::default());
    stream.push(control(0.0)).unwrap();
    let before = stream.save("").unwrap();
    let bad = |control: [f64; 3]| Row::Control(ControlRow { stamp_s: 0.1, control, covariance: None });
    for row in [control(f64::NAN), seen(f64::INFINITY), bad([f64::NAN, 0.0, 0.0]), bad([1e300, 0.0, 0.0])] {
        assert!(stream.push(row).is_err());
    }
    assert_eq!(stream.save("").unwrap(), before);
}

#[test]
fn sightings_wait_for_odometry_that_stops_and_no_longer() {
    // A speed of 1 m/s holds on for 3 s; of three displacements of 1 m the last is driven after what was seen meanwhile.
    for (motion, at_1_s) in motions().into_iter().zip([1.0, 2.0]) {
        let mut stream = small(motion);
        for row in [control(0.0), control(0.5), seen(0.5), seen(1.0)] {
            assert_eq!(stream.push(row), Ok(Taken::Yes));
        }
        let mut steps = Vec::new();
        drain(&mut stream, &mut steps);
        assert_eq!(stream.push(seen(1.9)), Ok(Taken::Yes));
        drain(&mut stream, &mut steps);
        // The odometry of 0.5 s is there; that after it is still waited for.
        assert_eq!(steps.iter().map(|step| step.stamp_s).next_back(), Some(0.5));
        assert_eq!(stream.push(seen(3.0)), Ok(Taken::Yes));
        drain(&mut stream, &mut steps);
        let waited = steps.iter().find(|step| step.stamp_s == 1.0).unwrap();
        assert!((waited.pose.mean.x - at_1_s).abs() < 0.3, "{waited:?}");
        for row in [control(3.0), Row::End] {
            stream.push(row).unwrap();
        }
        drain(&mut stream, &mut steps);
        assert_eq!(stream.waiting(), 0);
        let moved = steps.last().unwrap();
        assert_eq!(moved.stamp_s, 3.0);
        let x = stream.smoothed().last().unwrap().1.x;
        assert!((x - 3.0).abs() < 0.6, "{x}");
    }
}
