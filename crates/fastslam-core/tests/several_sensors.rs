//! Several sensors on one robot, each with its own mounting, limits and noise.

use crate::blind::Blind;
use crate::stores_agree_on_logs::bits;
use fastslam_core::config::{Algorithm, AssociationMode, Config, Removal};
use fastslam_core::filter::{FastSlam, Identities, Scan, Sighting};
use fastslam_core::measurement::{Mounting, Sensor};
use fastslam_core::run::{run, RunOutput};
use fastslam_core::slam::{self, Slam};
use fastslam_core::stream::{Stream, Window};
use fastslam_core::timeline::{ControlRow, LogData, Row, SightingsRow};
use fastslam_sim::{simulate, SimulatedLog, SimulationConfig};
use std::f64::consts::PI;

fn sensor(mounting: Mounting, field_of_view_rad: f64) -> Sensor {
    let mut sensor = Sensor::default();
    sensor.change(|s| {
        (s.range_std_m, s.bearing_std_rad, s.max_range_m) = (0.1, 0.02, 10.0);
        (s.mounting, s.field_of_view_rad) = (mounting, field_of_view_rad);
    });
    sensor
}

/// The first half of a loop among landmarks with one sensor all around, or one that looks ahead and one that looks back.
fn world(seed: u64, several: bool) -> (SimulatedLog, Config) {
    let mut simulation = SimulationConfig::preset("demo").unwrap();
    simulation.seed = seed;
    simulation.sensor = SimulationConfig::default().sensor;
    if several {
        let front = sensor(Mounting { x_m: 0.4, y_m: 0.1, yaw_rad: 0.0 }, PI);
        let mut rear = sensor(Mounting { x_m: -0.3, y_m: 0.0, yaw_rad: PI }, PI);
        rear.change(|s| (s.range_std_m, s.max_range_m) = (0.08, 9.0));
        simulation.sensors.0.extend([("front".into(), front), ("rear".into(), rear)]);
    }
    let log = simulate(&simulation).unwrap();
    let (motion, sensor, sensors) = (log.motion.clone(), log.sensor.clone(), simulation.sensors.clone());
    let mut config = Config { seed, motion, sensor, sensors, ..Config::default() };
    config.filter.particles = 40;
    (log, config)
}

/// A landmark and its true place.
type Pair = ([f64; 2], [f64; 2]);

/// Root mean square distance of the landmarks from the truth, after the best rigid alignment.
fn map_error_m(output: &RunOutput, truth: &SimulatedLog) -> f64 {
    let pairs: Vec<Pair> = output
        .map
        .landmarks
        .iter()
        .map(|landmark| (landmark.mean, truth.landmarks.position_m[landmark.identity.unwrap() as usize]))
        .collect();
    let n = pairs.len() as f64;
    let mean = |of: &dyn Fn(&Pair) -> f64| pairs.iter().map(of).sum::<f64>() / n;
    let (a, b) = ([mean(&|p| p.0[0]), mean(&|p| p.0[1])], [mean(&|p| p.1[0]), mean(&|p| p.1[1])]);
    let centred = |(p, q): &Pair| ([p[0] - a[0], p[1] - a[1]], [q[0] - b[0], q[1] - b[1]]);
    let (mut dot, mut cross) = (0.0, 0.0);
    for (p, q) in pairs.iter().map(centred) {
        dot += p[0] * q[0] + p[1] * q[1];
        cross += p[0] * q[1] - p[1] * q[0];
    }
    let (s, c) = f64::atan2(cross, dot).sin_cos();
    let squared = |(p, q): Pair| (c * p[0] - s * p[1] - q[0]).powi(2) + (s * p[0] + c * p[1] - q[1]).powi(2);
    (pairs.iter().map(centred).map(squared).sum::<f64>() / n).sqrt()
}

fn sensors_that_are_alike_give_the_bits_of_one(cases: &[(AssociationMode, Algorithm)]) {
    let (log, one) = world(3, false);
    let mut data = log.log_data();
    let single = sensor(Mounting { x_m: 0.2, y_m: -0.1, yaw_rad: 0.3 }, 2.0 * PI);
    for &(mode, algorithm) in cases {
        let mut one = Config { algorithm, sensor: single.clone(), ..one.clone() };
        one.association.mode = mode;
        // What speaks for a landmark is learned for each sensor by itself.
        one.association.existence.removal = Removal::Never;
        data.sighting_sensors.clear();
        let expected = run(&one, &data, &mut Blind).unwrap();
        let mut two = Config { sensor: Sensor::default(), ..one.clone() };
        two.sensors.0.extend(["left", "right"].map(|name| (name.to_owned(), single.clone())));
        data.sighting_sensors = data.sighting_stamps_s.iter().map(|s| ((s / 0.2).round() as u8) % 2).collect();
        assert!(data.sighting_sensors.contains(&0) && data.sighting_sensors.contains(&1));
        assert_eq!(bits(&run(&two, &data, &mut Blind).unwrap()), bits(&expected), "{algorithm:?}, {mode:?}");
    }
}

#[test]
fn sensors_that_are_alike_give_the_bits_of_one_with_names() {
    sensors_that_are_alike_give_the_bits_of_one(&[(AssociationMode::Known, Algorithm::Fastslam2)]);
}

#[test]
#[ignore = "slow: make test-all runs it"]
fn sensors_that_are_alike_give_the_bits_of_one_by_every_algorithm() {
    use Algorithm::{Ekf, Fastslam1, Fastslam2};
    let known = [Fastslam1, Ekf].map(|algorithm| (AssociationMode::Known, algorithm));
    let unknown = [Fastslam1, Fastslam2].map(|algorithm| (AssociationMode::Unknown, algorithm));
    sensors_that_are_alike_give_the_bits_of_one(&[known, unknown].concat());
}

#[test]
fn one_that_looks_ahead_and_one_that_looks_back_map_as_well_as_one_all_around() {
    for algorithm in [Algorithm::Fastslam1, Algorithm::Fastslam2, Algorithm::Ekf] {
        let (mut around_m, mut both_m, mut turned_m) = (0.0, 0.0, 0.0);
        for seed in [1, 2, 3] {
            let (log, mut config) = world(seed, false);
            config.algorithm = algorithm;
            around_m += map_error_m(&run(&config, &log.log_data(), &mut Blind).unwrap(), &log) / 3.0;
            let (log, mut config) = world(seed, true);
            config.algorithm = algorithm;
            let output = run(&config, &log.log_data(), &mut Blind).unwrap();
            let factor = |output: &RunOutput| output.noise.nis / output.noise.band[1];
            assert!(factor(&output) < 1.1, "{algorithm:?}: {:?}", output.noise);
            both_m += map_error_m(&output, &log) / 3.0;
            // Five degrees that nobody knows of.
            config.sensors.0.get_mut("rear").unwrap().change(|s| s.mounting.yaw_rad += 0.09);
            let output = run(&config, &log.log_data(), &mut Blind).unwrap();
            assert!(factor(&output) > 1.3, "{algorithm:?}: {:?}", output.noise);
            turned_m += map_error_m(&output, &log) / 3.0;
        }
        assert!(both_m < 1.3 * around_m, "{algorithm:?}: {both_m} m, {around_m} m");
        assert!(turned_m > 1.5 * both_m, "{algorithm:?}: {turned_m} m, {both_m} m");
    }
}

/// Goes on with a filter from a step of a stream, and gives the bits of what it says.
fn go_on(filter: &mut dyn Slam, scans: &[SightingsRow]) -> Vec<u64> {
    let mut said = Vec::new();
    for row in scans {
        if row.sensor == 0 {
            filter.predict([1.0, 0.15, 0.0], 0.3).unwrap();
        }
        let info = filter.take(row.scan()).unwrap();
        said.extend([info.weighing.log_likelihood, info.noise.nis].map(f64::to_bits));
        said.extend(filter.pose().mean.to_array().map(f64::to_bits));
        said.push(u64::from(info.health.reasons));
    }
    filter.finish();
    said.extend(filter.best_path().iter().flat_map(|(_, pose)| pose.to_array()).map(f64::to_bits));
    said.extend(filter.map().landmarks.iter().flat_map(|landmark| landmark.mean).map(f64::to_bits));
    said
}

/// Scans of two sensors along a bend, without names.
fn scans() -> Vec<SightingsRow> {
    let mut rows = Vec::new();
    for step in 0..60_u32 {
        let seen = |sensor: usize| {
            let towards = |k: u32| 0.4 * f64::from((step + 3 * k) % 5) - 0.9;
            (0..3).map(move |k| {
                Sighting::range_bearing(3.0 + f64::from((step + k) % 4) + sensor as f64, towards(k), None)
            })
        };
        for sensor in [0, 1] {
            let sightings = if step % 7 == 3 && sensor == 1 { Vec::new() } else { seen(sensor).collect() };
            rows.push(SightingsRow { stamp_s: 0.3 * f64::from(step + 1), sightings, sensor });
        }
    }
    rows
}

#[test]
fn a_filter_of_several_sensors_goes_on_from_a_snapshot_to_the_same_bits() {
    let (_, base) = world(1, true);
    let scans = scans();
    let mut compared = 0;
    for (algorithm, every_steps, delay_scans) in [
        (Algorithm::Ekf, None, 0),
        (Algorithm::Fastslam1, None, 0),
        (Algorithm::Fastslam2, None, 0),
        (Algorithm::Fastslam2, Some(9), 0),
        (Algorithm::Fastslam2, Some(9), 5),
    ] {
        let mut config = Config { algorithm, ..base.clone() };
        (config.filter.rejuvenation.every_steps, config.filter.rejuvenation.delay_scans) = (every_steps, delay_scans);
        let make = || slam::create(config.clone(), Identities::None).unwrap();
        let expected = go_on(make().as_mut(), &scans);
        for cut in [1, 2, 37, 38, 90] {
            let mut before = make();
            for row in &scans[..cut] {
                if row.sensor == 0 {
                    before.predict([1.0, 0.15, 0.0], 0.3).unwrap();
                }
                before.take(row.scan()).unwrap();
            }
            let mut after = make();
            after.restore(&before.save("").unwrap()).unwrap();
            let said = go_on(after.as_mut(), &scans[cut..]);
            let steps = scans.len() - cut;
            assert_eq!(said[..6 * steps], expected[6 * cut..6 * scans.len()], "{algorithm:?} cut at {cut}");
            assert_eq!(said[6 * steps..], expected[6 * scans.len()..], "{algorithm:?} cut at {cut}");
            compared += 1;
        }
    }
    assert_eq!(compared, 25);
}

#[test]
fn a_stream_keeps_apart_what_waits_of_one_stamp() {
    let (log, config) = world(2, true);
    let data = log.log_data();
    let expected = run(&config, &data, &mut Blind).unwrap();
    let window = Window { late_s: 1.0, wait_s: f64::INFINITY, gap_s: f64::INFINITY };
    let mut stream = Stream::new(config, Identities::All, window).unwrap();
    let mut steps = Vec::new();
    for (i, row) in data.rows().enumerate() {
        stream.push(row).unwrap();
        while let Some(record) = stream.step().unwrap() {
            steps.push((record.stamp_s, record.pose.mean));
        }
        if i % 40 == 7 {
            assert!(stream.waiting() > 0);
            stream = Stream::load(&stream.save("").unwrap(), &slam::create).unwrap().0;
        }
    }
    let whole: Vec<_> = expected.steps.iter().map(|step| (step.stamp_s, step.pose.mean)).collect();
    assert_eq!(steps, whole);
    let stamps: Vec<f64> = steps.iter().map(|step| step.0).collect();
    assert!(stamps.windows(2).filter(|pair| pair[0] == pair[1]).count() > 50, "both look at the same moments");
}

#[test]
fn sensors_that_there_are_not_and_other_mountings_are_refused() {
    let (log, config) = world(1, true);
    let mut filter = FastSlam::new(config.clone(), Identities::All).unwrap();
    let scan = Scan { stamp_s: 0.0, sensor: 2, sightings: &[] };
    let refused = "a scan of sensor 2, expected less than 2: `sensors` says how many there are";
    assert_eq!(filter.take(scan).unwrap_err().to_string(), refused);
    let snapshot = filter.save("").unwrap();
    let mut other = config.clone();
    other.sensors.0.get_mut("rear").unwrap().change(|s| s.mounting.x_m = 0.0);
    let message = FastSlam::new(other, Identities::All).unwrap().restore(&snapshot).unwrap_err().to_string();
    assert!(message.ends_with("it was made with sensors.rear.mounting.x_m = -0.3, not 0.0"), "{message}");
    let mut data: LogData = log.log_data();
    data.sighting_sensors[5] = 7;
    assert!(run(&config, &data, &mut Blind).unwrap_err().to_string().starts_with("a scan of sensor 7"));
    let window = Window { late_s: 1.0, wait_s: 1.0, gap_s: 1.0 };
    let mut stream = Stream::new(config, Identities::All, window).unwrap();
    let control = ControlRow { stamp_s: 0.0, control: [1.0, 0.0, 0.0], covariance: None };
    stream.push(Row::Control(control)).unwrap();
    let row = SightingsRow { stamp_s: 0.0, sightings: vec![], sensor: 3 };
    assert!(stream.push(Row::Sightings(row)).unwrap_err().to_string().starts_with("a scan of sensor 3"));
}
