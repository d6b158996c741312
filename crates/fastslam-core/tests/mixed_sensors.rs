//! Several sensors of different kinds: range and bearing, bearings alone, ranges alone.

use crate::blind::Blind;
use crate::dense::Matrix;
use crate::stores_agree_on_logs::bits;
use fastslam_core::config::{Algorithm, AssociationMode, Config, Method, Removal};
use fastslam_core::ekf_slam::EkfSlam;
use fastslam_core::filter::{FastSlam, Identities, LeftOut, Scan, Sighting, Taken};
use fastslam_core::geometry::Pose;
use fastslam_core::measurement::Sensor;
use fastslam_core::run::{run, RunOutput};
use fastslam_core::slam::{self, Slam};
use fastslam_core::store::StoreKind;
use fastslam_core::timeline::{LogData, Row};
use fastslam_sim::{simulate, SimulatedLog, SimulationConfig};
use std::f64::consts::TAU;

/// Numbers of the sensors of [`exact`], in the order of their names.
const CAMERA: usize = 0;
const LASER: usize = 1;
const RADIO: usize = 2;

fn sensor(text: &str) -> Sensor {
    serde_json::from_str(text).unwrap()
}

/// A laser, a camera and a radio, each somewhere else on the robot.
fn exact(algorithm: Algorithm, tail: &str) -> Config {
    let mut config = Config { algorithm, ..Config::default() };
    let camera =
        format!(r#"{{"model": "bearing", "bearing_std_rad": 0.03, "mounting": {{"x_m": 0.3, "yaw_rad": 0.2}}{tail}}}"#);
    let radio =
        format!(r#"{{"model": "range", "range_std_m": 0.2, "range_bias_m": 0.5, "mounting": {{"y_m": -0.4}}{tail}}}"#);
    config.sensors.0.extend([
        ("camera".into(), sensor(&camera)),
        ("laser".into(), sensor(r#"{"range_std_m": 0.1, "bearing_std_rad": 0.02}"#)),
        ("radio".into(), sensor(&radio)),
    ]);
    config.filter.particles = 1;
    config.filter.rejuvenation.every_steps = Some(0);
    config.motion =
        serde_json::from_str(r#"{"model": "velocity", "speed_std_m_per_s": 0.2, "yaw_rate_std_rad_per_s": 0.1}"#)
            .unwrap();
    config
}

fn wrap(angle: f64) -> f64 {
    angle - TAU * (angle / TAU).round()
}

/// The one number that a sensor measures of a landmark, as a function of (x, y, heading, landmark's x and y).
fn number(of: usize, state: &[f64]) -> f64 {
    let (s, c) = state[2].sin_cos();
    let mounting: [f64; 2] = if of == CAMERA { [0.3, 0.0] } else { [0.0, -0.4] };
    let at = [state[0] + c * mounting[0] - s * mounting[1], state[1] + s * mounting[0] + c * mounting[1]];
    let (dx, dy) = (state[3] - at[0], state[4] - at[1]);
    if of == CAMERA {
        wrap(dy.atan2(dx) - state[2] - 0.2)
    } else {
        dx.hypot(dy)
    }
}

/// The derivative of that by differences.
fn derivative(of: usize, state: &[f64]) -> [f64; 5] {
    std::array::from_fn(|k| {
        let moved = |by: f64| {
            let mut state = state.to_vec();
            state[k] += by;
            number(of, &state)
        };
        wrap(moved(1e-6) - moved(-1e-6)) / 2e-6
    })
}

/// A textbook update of a mean and a covariance by one number; returns how likely it was.
fn update(x: &mut Matrix, p: &mut Matrix, h: &Matrix, off: f64, variance: f64) -> f64 {
    let s = h.transforms(p)[0] + variance;
    let k = &*p * h.transpose() / s;
    *x = &*x + k.clone() * off;
    let rest = Matrix::identity(x.len()) - &k * h;
    *p = rest.transforms(p) + &k * k.transpose() * variance;
    -0.5 * (off * off / s + (TAU * s).ln())
}

/// Reported by camera and radio of the landmark, in turn: off by something.
fn sightings(of: usize, state: &[f64]) -> Sighting {
    match of {
        CAMERA => Sighting::range_bearing(f64::NAN, number(of, state) + 0.05, Some(7)),
        _ => Sighting::range_bearing(number(of, state) - 0.3 + 0.5, f64::NAN, Some(7)),
    }
}

const VARIANCE: [f64; 3] = [0.03 * 0.03, 0.0, 0.2 * 0.2];
const OFF: [f64; 3] = [0.05, 0.0, -0.3];

#[test]
fn the_joint_filter_is_that_of_a_textbook_by_one_number() {
    let mut filter = EkfSlam::mixed(exact(Algorithm::Ekf, ""), Identities::All).unwrap();
    filter
        .take(Scan { stamp_s: 0.0, sensor: LASER, sightings: &[Sighting::range_bearing(5.0, 0.4, Some(7))] })
        .unwrap();
    let mut compared = 0;
    for step in 0..8_u32 {
        let stamp_s = 0.5 * f64::from(step + 1);
        filter.predict([1.0, 0.2, 0.0], 0.5).unwrap();
        filter.take(Scan { stamp_s, sensor: LASER, sightings: &[] }).unwrap();
        let pose = filter.pose().mean;
        let mean = filter.map().landmarks[0].mean;
        let mut x = Matrix::column(&[pose.x, pose.y, pose.heading, mean[0], mean[1]]);
        let mut p = Matrix::of_rows(5, &filter.joint_covariance());
        let of = if step % 2 == 0 { CAMERA } else { RADIO };
        let h = Matrix::of_rows(1, &derivative(of, x.values()));
        let sighting = sightings(of, x.values());
        let likelihood = update(&mut x, &mut p, &h, OFF[of], VARIANCE[of]);
        let info = filter.take(Scan { stamp_s, sensor: of, sightings: &[sighting] }).unwrap();
        let pose = filter.pose().mean;
        let mean = filter.map().landmarks[0].mean;
        let own = [pose.x, pose.y, pose.heading, mean[0], mean[1]];
        assert!(own.iter().zip(x.values()).all(|(own, by_hand)| (own - by_hand).abs() < 1e-8), "{own:?} {x:?}");
        assert!(filter.joint_covariance().iter().zip(p.values()).all(|(own, by_hand)| (own - by_hand).abs() < 1e-9));
        let exponent = filter.config().filter.likelihood_exponent;
        assert!((info.weighing.log_likelihood - exponent * likelihood).abs() < 1e-6, "{info:?}");
        compared += 1;
    }
    assert_eq!(compared, 8);
}

/// The proposal and the landmark of one particle, against updates by one number.
fn one_particle_is_exact(algorithm: Algorithm) {
    let mut filter = FastSlam::mixed(exact(algorithm, ""), Identities::All).unwrap();
    filter
        .take(Scan { stamp_s: 0.0, sensor: LASER, sightings: &[Sighting::range_bearing(5.0, 0.4, Some(7))] })
        .unwrap();
    for step in 0..8_u32 {
        let stamp_s = 0.5 * f64::from(step + 1);
        filter.predict([1.0, 0.2, 0.0], 0.5).unwrap();
        let believed = filter.predicted_pose();
        let (_, mean, covariance) = filter.map_of(0)[0];
        let Pose { x, y, heading } = believed.mean;
        let state = [x, y, heading, mean[0], mean[1]];
        let of = if step % 2 == 0 { CAMERA } else { RADIO };
        let h = derivative(of, &state);
        // Given the particle's pose the landmark is a Gaussian of its own: its covariance is part of the noise.
        let of_landmark = h[3] * h[3] * covariance.xx + 2.0 * h[3] * h[4] * covariance.xy + h[4] * h[4] * covariance.yy;
        let (mut pose, mut p) = (Matrix::column(&state[..3]), Matrix::zeros(3, 3));
        if algorithm == Algorithm::Fastslam2 {
            p = Matrix::of_rows(3, believed.covariance.as_flattened());
        }
        let row = Matrix::of_rows(1, &h[..3]);
        let likelihood = update(&mut pose, &mut p, &row, OFF[of], VARIANCE[of] + of_landmark);
        let info = filter.take(Scan { stamp_s, sensor: of, sightings: &[sightings(of, &state)] }).unwrap();
        let exponent = filter.config().filter.likelihood_exponent;
        assert!((info.weighing.log_likelihood - exponent * likelihood).abs() < 1e-6, "{algorithm:?}: {info:?}");
        if algorithm == Algorithm::Fastslam2 {
            let own = filter.pose();
            assert!(own.mean.to_array().iter().zip(pose.values()).all(|(a, b)| (a - b).abs() < 1e-8));
            assert!(own.covariance.as_flattened().iter().zip(p.values()).all(|(a, b)| (a - b).abs() < 1e-9));
        }
        // The landmark is corrected where the pose was drawn.
        let Pose { x, y, heading } = filter.particles().pose(0);
        let drawn = [x, y, heading, mean[0], mean[1]];
        let mut landmark = Matrix::column(&mean);
        let mut c = Matrix::of_rows(2, &[covariance.xx, covariance.xy, covariance.xy, covariance.yy]);
        let row = Matrix::of_rows(1, &derivative(of, &drawn)[3..]);
        let off = wrap(OFF[of] + number(of, &state) - number(of, &drawn));
        update(&mut landmark, &mut c, &row, off, VARIANCE[of]);
        let (_, mean, covariance) = filter.map_of(0)[0];
        assert!((0..2).all(|k| (mean[k] - landmark[k]).abs() < 1e-8), "{mean:?} {landmark:?}");
        let own = [covariance.xx, covariance.xy, covariance.yy];
        assert!(own.iter().zip([c[(0, 0)], c[(0, 1)], c[(1, 1)]]).all(|(a, b)| (a - b).abs() < 1e-9));
    }
}

#[test]
fn one_particle_is_exact_by_one_number() {
    one_particle_is_exact(Algorithm::Fastslam1);
    one_particle_is_exact(Algorithm::Fastslam2);
}

#[test]
fn what_the_map_lacks_is_left_out_and_counted() {
    for algorithm in [Algorithm::Fastslam1, Algorithm::Fastslam2, Algorithm::Ekf] {
        for (identities, name) in [(Identities::All, Some(7)), (Identities::None, None), (Identities::Some, Some(7))] {
            let mut filter = slam::create(exact(algorithm, ""), identities).unwrap();
            let seen = [Sighting::range_bearing(f64::NAN, 0.4, name)];
            let info = filter.take(Scan { stamp_s: 0.0, sensor: CAMERA, sightings: &seen }).unwrap();
            assert_eq!((info.sightings > 0 || identities == Identities::All, info.changes.new_landmarks), (true, 0));
            assert_eq!(info.left_out, LeftOut { ignored: 1, ..LeftOut::default() }, "{algorithm:?} {identities:?}");
            assert!(filter.map().landmarks.is_empty() && filter.seen()[0].taken == Taken::Nothing);
            let founds = [Sighting::range_bearing(5.0, 0.4, name)];
            let info = filter.take(Scan { stamp_s: 0.1, sensor: LASER, sightings: &founds }).unwrap();
            assert_eq!((info.changes.new_landmarks, info.left_out.ignored), (1, 0));
            let towards = (5.0 * 0.4_f64.sin()).atan2(5.0 * 0.4_f64.cos() - 0.3) - 0.2;
            let seen = [Sighting::range_bearing(f64::NAN, towards, name)];
            let info = filter.take(Scan { stamp_s: 0.2, sensor: CAMERA, sightings: &seen }).unwrap();
            assert_eq!((info.matched, info.left_out.ignored), (1, 0), "{algorithm:?} {identities:?}");
            // What is not measured is told as the map has it.
            let shown = filter.seen()[0];
            assert!(matches!(shown.taken, Taken::Landmark(_)), "{shown:?}");
            // A number that is none is skipped as it always is.
            let broken = [Sighting::range_bearing(3.0, f64::NAN, name)];
            let info = filter.take(Scan { stamp_s: 0.3, sensor: CAMERA, sightings: &broken }).unwrap();
            assert_eq!((info.left_out.skipped.not_finite, info.left_out.skipped.total()), (1, 1));
        }
    }
}

#[test]
fn a_tail_of_one_number_bears_a_wild_sighting() {
    let heavy = r#", "tail_degrees_of_freedom": 4"#;
    let moved = |tail: &str| {
        let mut filter = FastSlam::mixed(exact(Algorithm::Fastslam2, tail), Identities::All).unwrap();
        let laser = [Sighting::range_bearing(5.0, 0.4, Some(7))];
        for k in 0..5 {
            filter.take(Scan { stamp_s: f64::from(k), sensor: LASER, sightings: &laser }).unwrap();
        }
        filter.predict([1.0, 0.0, 0.0], 1.0).unwrap();
        let before = filter.predicted_pose().mean;
        let (_, mean, _) = filter.map_of(0)[0];
        let state = [before.x, before.y, before.heading, mean[0], mean[1]];
        let wild = [Sighting::range_bearing(number(RADIO, &state) + 0.5 + 1.3, f64::NAN, Some(7))];
        filter.take(Scan { stamp_s: 6.0, sensor: RADIO, sightings: &wild }).unwrap();
        let after = filter.pose().mean;
        (after.x - before.x).hypot(after.y - before.y)
    };
    let (gaussian, student) = (moved(""), moved(heavy));
    assert!(student < 0.6 * gaussian && student > 0.0, "{gaussian} {student}");
}

/// A loop among landmarks for a laser that sees little of it, alone or with a camera that sees far and a radio.
fn world(seed: u64, others: bool) -> (SimulatedLog, Config) {
    let mut simulation = SimulationConfig::preset("demo").unwrap();
    simulation.seed = seed;
    simulation.sensor = SimulationConfig::default().sensor;
    let laser = r#"{"range_std_m": 0.1, "bearing_std_rad": 0.02, "max_range_m": 5.0}"#;
    let camera = r#"{"model": "bearing", "bearing_std_rad": 0.01, "max_range_m": 15.0, "mounting": {"x_m": 0.3}}"#;
    simulation.sensors.0.insert("laser".into(), sensor(laser));
    if others {
        simulation.sensors.0.insert("camera".into(), sensor(camera));
    }
    let log = simulate(&simulation).unwrap();
    let mut config =
        Config { seed, motion: log.motion.clone(), sensors: simulation.sensors.clone(), ..Config::default() };
    config.filter.particles = 40;
    (log, config)
}

/// Root mean square distance of the smoothed path from the truth, where it begins as the truth does.
fn path_error_m(output: &RunOutput, truth: &SimulatedLog) -> f64 {
    let pose_of = |[x, y, heading]: [f64; 3]| Pose::new(x, y, heading);
    let start = pose_of(truth.T_world_robot[0]).inverse();
    let last = truth.truth_stamp_s.len() - 1;
    let at = |stamp_s: f64| truth.truth_stamp_s.partition_point(|s| *s < stamp_s - 1e-9).min(last);
    let squared = output.smoothed.iter().map(|(stamp_s, pose)| {
        let true_pose = start.compose(pose_of(truth.T_world_robot[at(*stamp_s)]));
        (pose.x - true_pose.x).powi(2) + (pose.y - true_pose.y).powi(2)
    });
    (squared.sum::<f64>() / output.smoothed.len() as f64).sqrt()
}

#[test]
fn a_far_camera_beside_a_short_laser_gives_a_better_path() {
    for (mode, algorithm) in [
        (AssociationMode::Known, Algorithm::Fastslam2),
        (AssociationMode::Unknown, Algorithm::Fastslam2),
        (AssociationMode::Known, Algorithm::Fastslam1),
        (AssociationMode::Known, Algorithm::Ekf),
    ] {
        let (mut alone_m, mut both_m) = (0.0, 0.0);
        for seed in [1, 2, 3, 4] {
            for (others, sum) in [(false, &mut alone_m), (true, &mut both_m)] {
                let (log, mut config) = world(seed, others);
                (config.algorithm, config.association.mode) = (algorithm, mode);
                let output = run(&config, &log.log_data(), &mut Blind).unwrap();
                let error_m = path_error_m(&output, &log);
                let (nis, [low, high]) = (output.noise.nis, output.noise.band);
                println!(
                    "{algorithm:?} {mode:?} {seed} {others}: {error_m:.3} m, NIS {nis:.2} in {low:.2} to {high:.2}"
                );
                assert!(!others || (0.9 * low..1.1 * high).contains(&nis), "{algorithm:?} {mode:?} {seed}: {nis}");
                *sum += error_m / 4.0;
            }
        }
        assert!(both_m < 0.7 * alone_m, "{algorithm:?} {mode:?}: {both_m} m, {alone_m} m alone");
    }
}

#[test]
fn stores_and_threads_give_the_same_bits() {
    let mut compared = 0;
    for (mode, algorithm, method) in [
        (AssociationMode::Known, Algorithm::Fastslam2, Method::MaximumLikelihood),
        (AssociationMode::Unknown, Algorithm::Fastslam2, Method::MaximumLikelihood),
        (AssociationMode::Unknown, Algorithm::Fastslam1, Method::Sampled),
        (AssociationMode::Unknown, Algorithm::Fastslam2, Method::Joint),
        (AssociationMode::Unknown, Algorithm::Fastslam2, Method::Assignment),
    ] {
        let (log, config) = world(2, true);
        let mut data: LogData = log.log_data();
        let half = data.sightings.len() / 3;
        data.sightings.truncate(half);
        data.sighting_stamps_s.truncate(half);
        data.sighting_sensors.truncate(half);
        let output = |store: StoreKind, threads: u32| {
            let mut config = Config { algorithm, ..config.clone() };
            (config.association.mode, config.association.method) = (mode, method);
            (config.filter.store, config.filter.threads) = (store, threads);
            bits(&run(&config, &data, &mut Blind).unwrap())
        };
        let expected = output(StoreKind::default(), 1);
        for (store, threads) in [(StoreKind::Dense, 1), (StoreKind::Tree, 1), (StoreKind::default(), 2)] {
            assert!(output(store, threads) == expected, "{algorithm:?} {mode:?} {method:?} {store:?} {threads}");
            compared += 1;
        }
    }
    assert_eq!(compared, 15);
}

/// Goes on with a filter, and gives the bits of what it says.
fn go_on(filter: &mut dyn Slam, data: &LogData, from: usize) -> Vec<u64> {
    let mut said = Vec::new();
    for (i, row) in data.rows().enumerate().skip(from).take(400) {
        feed(filter, &row);
        if i % 10 == 0 {
            said.extend(filter.predicted_pose().mean.to_array().map(f64::to_bits));
        }
    }
    filter.finish();
    said.extend(filter.best_path().iter().flat_map(|(_, pose)| pose.to_array()).map(f64::to_bits));
    said.extend(filter.map().landmarks.iter().flat_map(|landmark| landmark.mean).map(f64::to_bits));
    said
}

fn feed(filter: &mut dyn Slam, row: &Row) {
    match row {
        Row::Control(row) => filter.predict(row.control, 0.1).unwrap(),
        Row::Sightings(row) => {
            filter.take(row.scan()).unwrap();
        }
        Row::End => {}
    }
}

#[test]
fn a_filter_of_mixed_sensors_goes_on_from_a_snapshot_to_the_same_bits() {
    let (log, base) = world(1, true);
    let data = log.log_data();
    for (algorithm, mode, every_steps) in [
        (Algorithm::Ekf, AssociationMode::Known, None),
        (Algorithm::Fastslam1, AssociationMode::Unknown, None),
        (Algorithm::Fastslam2, AssociationMode::Unknown, Some(25)),
    ] {
        let mut config = Config { algorithm, ..base.clone() };
        (config.association.mode, config.filter.rejuvenation.every_steps) = (mode, every_steps);
        config.association.existence.removal = Removal::Unconfirmed;
        let make = || slam::create(config.clone(), Identities::All).unwrap();
        let cut = 211;
        let mut filter = make();
        data.rows().take(cut).for_each(|row| feed(filter.as_mut(), &row));
        let snapshot = filter.save("").unwrap();
        let expected = go_on(filter.as_mut(), &data, cut);
        let mut after = make();
        after.restore(&snapshot).unwrap();
        assert!(go_on(after.as_mut(), &data, cut) == expected, "{algorithm:?}");
    }
}

#[test]
fn what_two_landmarks_explain_as_well_is_left_out() {
    for method in [Method::MaximumLikelihood, Method::Joint, Method::Assignment] {
        for algorithm in [Algorithm::Fastslam1, Algorithm::Fastslam2] {
            let mut config = exact(algorithm, "");
            config.association.method = method;
            let mut filter = slam::create(config, Identities::None).unwrap();
            let founds = [(5.0, 0.0), (8.0, 0.01), (6.0, 1.0)].map(|(r, b)| Sighting::range_bearing(r, b, None));
            filter.take(Scan { stamp_s: 0.0, sensor: LASER, sightings: &founds }).unwrap();
            let mut take = |bearings: &[f64]| {
                let seen: Vec<Sighting> = bearings.iter().map(|b| Sighting::range_bearing(0.0, *b, None)).collect();
                let info = filter.take(Scan { stamp_s: 0.1, sensor: CAMERA, sightings: &seen }).unwrap();
                (info.matched, info.left_out.ignored)
            };
            // The camera looks 0.2 rad to the left, from 0.3 m ahead.
            let alone = 6.0_f64.mul_add(1.0_f64.sin(), 0.0).atan2(6.0 * 1.0_f64.cos() - 0.3) - 0.2;
            assert_eq!(take(&[-0.2]), (0, 1), "{algorithm:?} {method:?}: two stand there");
            assert_eq!(take(&[alone, -0.2]), (1, 1), "{algorithm:?} {method:?}");
            assert_eq!(take(&[alone + 0.5]), (0, 1), "{algorithm:?} {method:?}: none stands there");
        }
    }
}
