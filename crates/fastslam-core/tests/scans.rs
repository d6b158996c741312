//! A stream of odometry and laser scans gives what a run over the detections gives, whatever order the window allows.

use crate::blind::Blind;
use fastslam_core::association::{Appearance, AssociationMode};
use fastslam_core::config::Config;
use fastslam_core::detect::{Detector, DetectorConfig, Scan};
use fastslam_core::filter::{Identities, Sighting};
use fastslam_core::motion::{Increments, Motion, Velocity};
use fastslam_core::random::{Purpose, RandomSource};
use fastslam_core::run::run;
use fastslam_core::stream::{at_sensor, velocity_at, ScanRow, Scanner, Stream, Taken, Window};
use fastslam_core::timeline::{ControlRow, LogData, Row};
use fastslam_sim::{simulate, SimulationConfig};

const LATE: Window = Window { late_s: 0.7, wait_s: 20.0, gap_s: 60.0 };

/// A rover among rocks: rows of odometry, scans, the scanner, and a configuration. Every seventh scan shows nothing.
fn drive(motion: Motion, beam_period_s: Option<f64>) -> (Vec<ControlRow>, Vec<ScanRow>, Scanner, Config) {
    let mut simulation = SimulationConfig::preset("rover").unwrap();
    (simulation.seed, simulation.motion, simulation.max_duration_s) = (9, motion, Some(20.0));
    let log = simulate(&simulation).unwrap();
    let scans = log.scans.as_ref().unwrap();
    let turn = |i: usize| {
        let shown = &scans.ranges_m[i * scans.beams..][..scans.beams];
        if i % 7 == 3 {
            vec![f64::INFINITY; scans.beams]
        } else {
            shown.to_vec()
        }
    };
    let row = |i: usize| ScanRow { stamp_s: scans.stamp_s[i], ranges_m: turn(i), intensities: None };
    let mut geometry = scans.geometry;
    geometry.beam_period_s = beam_period_s;
    let mut config = Config { seed: 3, motion: log.motion.clone(), sensor: log.sensor.clone(), ..Config::default() };
    (config.filter.particles, config.association.mode) = (15, AssociationMode::Unknown);
    config.sensor.change(|s| s.mounting.y_m = 0.2);
    let controls = log.control_stamp_s.iter().zip(&log.controls);
    let controls =
        controls.map(|(stamp_s, control)| ControlRow { stamp_s: *stamp_s, control: *control, covariance: None });
    (
        controls.collect(),
        (0..scans.stamp_s.len()).map(row).collect(),
        Scanner { geometry, detector: DetectorConfig::default() },
        config,
    )
}

/// What is seen in the scans, as a log.
fn detected(controls: &[ControlRow], scans: &[ScanRow], scanner: &Scanner, config: &Config) -> LogData {
    let mut detector = Detector::new(scanner.detector.clone()).unwrap();
    let mut log = LogData {
        control_stamps_s: controls.iter().map(|row| row.stamp_s).collect(),
        controls: controls.iter().map(|row| row.control).collect(),
        ..LogData::default()
    };
    for scan in scans {
        let velocity = velocity_at(&config.motion, controls, scan.stamp_s);
        let twist = Some(at_sensor(velocity, config.sensor.T_robot_sensor()));
        let mut found = Vec::new();
        let turn = Scan { ranges_m: &scan.ranges_m, intensities: None, geometry: scanner.geometry, twist };
        detector.detect(&turn, &mut found).unwrap();
        for one in found {
            let appearance = Appearance { class: None, signature: Some(one.signature) };
            let value = [one.range_m, one.bearing_rad];
            log.sighting_stamps_s.push(scan.stamp_s);
            log.sightings.push(Sighting { value, identity: None, noise: Some(one.covariance), appearance });
        }
    }
    log
}

enum Told {
    Row(Row),
    Scan(ScanRow),
}

/// Rows and scans in the order in which they come when each is delayed by up to the window.
fn shuffled(controls: &[ControlRow], scans: &[ScanRow]) -> Vec<Told> {
    let noise = RandomSource::new(4).stream(Purpose::Simulation, 0);
    let mut told: Vec<(f64, Told)> = controls.iter().map(|row| (row.stamp_s, Told::Row(Row::Control(*row)))).collect();
    told.extend(scans.iter().map(|scan| (scan.stamp_s, Told::Scan(scan.clone()))));
    for (i, (at_s, _)) in told.iter_mut().enumerate() {
        *at_s += LATE.late_s * noise.uniform(i as u32, 0);
    }
    told.sort_by(|a, b| a.0.total_cmp(&b.0));
    told.into_iter().map(|(_, told)| told).chain([Told::Row(Row::End)]).collect()
}

#[test]
fn scans_in_any_order_within_the_window_give_the_bits_of_a_run_also_across_a_snapshot() {
    let mut cases = 0;
    for motion in [Motion::Velocity(Velocity::default()), Motion::Increments(Increments::default())] {
        let mut seen = Vec::new();
        for beam_period_s in [None, Some(0.0005)] {
            let (controls, scans, scanner, config) = drive(motion.clone(), beam_period_s);
            let log = detected(&controls, &scans, &scanner, &config);
            let expected = run(&config, &log, &mut Blind).unwrap();
            assert!(expected.steps.len() > 40 && expected.map.landmarks.len() > 5, "{}", expected.steps.len());
            let mut stream = Stream::new(config, Identities::None, LATE).unwrap();
            assert!(stream.push_scan(scans[0].clone()).is_err(), "no scanner");
            stream.scan_with(scanner).unwrap();
            let (told, mut steps) = (shuffled(&controls, &scans), Vec::new());
            let cut = told.len() / 2;
            for (i, told) in told.into_iter().enumerate() {
                let taken = match told {
                    Told::Row(row) => stream.push(row),
                    Told::Scan(scan) => stream.push_scan(scan),
                };
                assert_eq!(taken, Ok(Taken::Yes));
                while let Some(record) = stream.step().unwrap() {
                    steps.push(record);
                }
                if i == cut {
                    assert!(stream.waiting() > 0);
                    let kept = stream.save("").unwrap();
                    stream = Stream::load(&kept, &fastslam_core::slam::create).unwrap().0;
                }
            }
            stream.finish();
            assert_eq!(steps, expected.steps);
            assert_eq!(stream.smoothed(), expected.smoothed);
            assert_eq!(stream.filter().map(), expected.map);
            assert_eq!(stream.waiting(), 0);
            assert_eq!(stream.push_scan(scans[0].clone()), Ok(Taken::Late));
            seen.push(log.sightings);
            cases += 1;
        }
        assert_ne!(seen[0], seen[1], "the motion within scans counts");
    }
    assert_eq!(cases, 4);
}

#[test]
fn scans_that_do_not_fit_are_errors_and_repeated_ones_are_refused() {
    let (controls, scans, scanner, config) = drive(Motion::default(), Some(0.0005));
    let mut stream = Stream::new(config, Identities::None, LATE).unwrap();
    let mut wrong = scanner.clone();
    wrong.geometry.max_range_m = -1.0;
    assert!(stream.scan_with(wrong).is_err());
    stream.scan_with(scanner).unwrap();
    stream.push(Row::Control(controls[0])).unwrap();
    let scan = &scans[1];
    for wrong in [
        ScanRow { intensities: Some(vec![1.0]), ..scan.clone() },
        ScanRow { stamp_s: f64::NAN, ..scan.clone() },
        ScanRow { ranges_m: vec![1.0; 5_000_000], ..scan.clone() },
    ] {
        assert!(stream.push_scan(wrong).is_err());
    }
    assert_eq!(stream.waiting(), 1);
    assert_eq!(stream.push_scan(scan.clone()), Ok(Taken::Yes));
    assert_eq!(stream.push_scan(scan.clone()), Ok(Taken::Repeated));
    assert_eq!(stream.refused().repeated, 1);
}

#[test]
fn the_velocity_at_a_moment_is_of_the_row_that_tells() {
    let row = |stamp_s: f64, control: [f64; 3]| ControlRow { stamp_s, control, covariance: None };
    let held = [row(1.0, [2.0, 0.1, 0.0]), row(2.0, [3.0, -0.4, 0.0])];
    let velocity = Motion::Velocity(Velocity::default());
    for (stamp_s, expected) in
        [(0.5, [0.0; 3]), (1.0, [2.0, 0.0, 0.1]), (1.9, [2.0, 0.0, 0.1]), (7.0, [3.0, 0.0, -0.4])]
    {
        assert_eq!(velocity_at(&velocity, &held, stamp_s), expected);
    }
    let moved = [row(1.0, [9.0, 9.0, 9.0]), row(1.5, [1.0, 0.0, 0.0]), row(3.5, [4.0, 0.0, 0.0])];
    let increments = Motion::Increments(Increments::default());
    for (stamp_s, ahead) in [(1.0, 0.0), (1.2, 2.0), (1.5, 2.0), (1.6, 2.0), (3.5, 2.0), (3.6, 0.0)] {
        assert_eq!(velocity_at(&increments, &moved, stamp_s)[0], ahead, "{stamp_s}");
    }
    // A sensor two metres left of a robot that turns left goes backwards; turned left by a right angle, to its left.
    let at = at_sensor([0.0, 0.0, 0.5], fastslam_core::geometry::Pose::new(0.0, 2.0, std::f64::consts::FRAC_PI_2));
    assert!((at[0]).abs() < 1e-12 && (at[1] - 1.0).abs() < 1e-12 && at[2] == 0.5, "{at:?}");
}
