//! What a simulated log promises, checked against its own truth.
use fastslam_core::error::Error;
use fastslam_core::geometry::Pose;
use fastslam_core::measurement::{MeasurementModel, Mounting, Placing, Sensor, SensorSettings};
use fastslam_core::motion::{
    Ackermann, ControlTiming, Correction, Increments, Motion, Odometry, Proportional, Velocity,
};
use fastslam_sim::*;

/// A seeded world with many sightings: three laps, 0.1 s controls.
fn base() -> SimulationConfig {
    SimulationConfig {
        world: World::Random(RandomField { count: 150, size_m: [50.0, 40.0], min_spacing_m: 1.5 }),
        trajectory: Trajectory::Loop(Loop { laps: 3, margin_m: 10.0, corner_radius_m: 5.0 }),
        ..SimulationConfig::default()
    }
}

fn all_motions() -> [Motion; 4] {
    [
        Motion::Velocity(Velocity::default()),
        Motion::Ackermann(Ackermann { wheelbase_m: 1.0, encoder_left_m: 0.3, ..Ackermann::default() }),
        Motion::Odometry(Odometry::default()),
        Motion::Increments(Increments::default()),
    ]
}

fn sensor_poses(config: &SimulationConfig, log: &SimulatedLog) -> Vec<Pose> {
    let T_robot_sensor = config.sensor.mounting.T_robot_sensor();
    let at = |stamp: &f64| {
        let index = log.truth_stamp_s.iter().position(|t| t == stamp).expect("a true pose at every scan");
        Pose::from(log.T_world_robot[index]).compose(T_robot_sensor)
    };
    log.sightings.stamp_s.iter().map(at).collect()
}

/// Mean and variance of standardised errors against 0 and 1: standard errors 1/√n and √(2/n), five of them, so that
/// a seed in about 10⁶ fails.
fn assert_standard_normal(errors: &[f64], what: &str) {
    let n = errors.len() as f64;
    assert!(n > 500.0, "{what}: only {n} samples");
    let mean = errors.iter().sum::<f64>() / n;
    let variance = errors.iter().map(|e| e * e).sum::<f64>() / n;
    assert!(mean.abs() < 5.0 / n.sqrt(), "{what}: mean {mean} of {n}");
    assert!((variance - 1.0).abs() < 5.0 * (2.0 / n).sqrt(), "{what}: variance {variance} of {n}");
}

/// The models with gains, biases and noise in proportion to the motion.
fn erring_motions() -> Vec<Motion> {
    let correction = Correction { distance_gain: 1.07, turn_gain: 0.64, yaw_rate_bias_rad_per_s: 0.02 };
    let proportional = Proportional {
        distance_std_m_per_sqrt_m: 0.05,
        lateral_std_m_per_sqrt_m: 0.03,
        turn_std_rad_per_sqrt_m: 0.02,
        turn_std_rad_per_sqrt_rad: 0.1,
    };
    vec![
        Motion::Velocity(Velocity { correction, proportional, ..Velocity::default() }),
        Motion::Odometry(Odometry { correction, proportional, ..Odometry::default() }),
        Motion::Increments(Increments { correction, proportional, ..Increments::default() }),
        Motion::Ackermann(Ackermann {
            wheelbase_m: 1.0,
            encoder_left_m: 0.3,
            steering_gain: 1.1,
            steering_bias_rad: 0.04,
            correction,
            proportional,
            ..Ackermann::default()
        }),
    ]
}

/// By what a recorded row errs from the truth, in standard deviations: what the record can say.
fn standardised_errors(motion: &Motion, recorded: [f64; 3], report: [f64; 3], dt_s: f64) -> Vec<f64> {
    let (got, truth) = (motion.row(recorded, dt_s), motion.row(report, dt_s));
    match motion.timing() {
        ControlTiming::Held => {
            [0, 2].map(|i| (got.twist[i] - truth.twist[i]) / truth.diffusion()[i][i].sqrt()).to_vec()
        }
        ControlTiming::Increment => {
            let part = truth.part(1.0);
            let error = part.mean.inverse().compose(got.part(1.0).mean).to_array();
            let covariance = part.covariance_in_world(-part.mean.heading);
            (0..3).map(|i| error[i] / covariance[i][i].sqrt()).collect()
        }
    }
}

#[test]
fn odometry_noise_has_the_moments_of_the_model() {
    for motion in all_motions().into_iter().chain(erring_motions()) {
        let config = SimulationConfig { motion, ..base() };
        let log = simulate(&config).unwrap();
        assert_eq!(log.controls.len(), log.control_stamp_s.len());
        let rows = log.controls.iter().zip(&log.true_controls);
        let errors: Vec<Vec<f64>> = rows
            .map(|(recorded, report)| standardised_errors(&config.motion, *recorded, *report, config.control_period_s))
            .collect();
        assert_eq!(errors[0].len(), log.control_columns.len(), "one noise for each column");
        for i in 0..errors[0].len() {
            let column: Vec<f64> = errors.iter().map(|row| row[i]).collect();
            assert_standard_normal(&column, &format!("{:?} column {i}", config.motion));
        }
    }
}

#[test]
fn odometry_that_errs_reports_what_the_gains_undo() {
    let motion = erring_motions().remove(0);
    let log = simulate(&SimulationConfig { motion, ..base() }).unwrap();
    let driven = log.T_world_robot.windows(2).map(|p| (p[1][0] - p[0][0]).hypot(p[1][1] - p[0][1])).sum::<f64>();
    let reported = log.controls.iter().map(|c| 0.1 * c[0]).sum::<f64>();
    assert!(log.controls.len() > 500);
    assert!((driven / reported / 1.07 - 1.0).abs() < 0.01, "{driven} m driven, {reported} m reported");
}

#[test]
fn replaying_the_true_controls_gives_the_true_path() {
    for motion in all_motions().into_iter().chain(erring_motions()) {
        let config = SimulationConfig { motion, ..base() };
        let log = simulate(&config).unwrap();
        let mut pose = Pose::from(log.T_world_robot[0]);
        assert!(log.T_world_robot.len() == log.true_controls.len() + 1 && log.true_controls.len() > 500);
        for (i, control) in log.true_controls.iter().enumerate() {
            pose = pose.compose(config.motion.mean_motion(*control, config.control_period_s));
            let truth = log.T_world_robot[i + 1];
            // The scene was moved after the drive: rounding of one rigid motion, and of those before.
            assert!((pose.x - truth[0]).abs() < 1e-8 && (pose.y - truth[1]).abs() < 1e-8, "{:?} {i}", config.motion);
        }
        let held = matches!(config.motion, Motion::Velocity(_) | Motion::Ackermann(_));
        assert_eq!(log.control_stamp_s[0], if held { 0.0 } else { config.control_period_s });
    }
}

#[test]
fn sighting_noise_has_the_configured_moments() {
    // Landmarks far from every limit, so that no sighting is lost at a border and the noise stays whole.
    let mut config = base();
    config.sensor.max_range_m = 200.0;
    config.sensor.min_range_m = 1e-3;
    config.sensor.mounting = Mounting { x_m: 0.7, y_m: -0.4, yaw_rad: 0.5 };
    config.scan.signature = Some(Signature::default());
    config.scan.period_s = 2.0;
    let log = simulate(&config).unwrap();
    let model = Sensor::from(config.sensor.clone()).range_bearing().unwrap();
    let mut errors = [vec![], vec![], vec![]];
    for (i, T_world_sensor) in sensor_poses(&config, &log).into_iter().enumerate() {
        let landmark = log.sightings.true_identity[i] as usize;
        let expected = model.expected(T_world_sensor, log.landmarks.position_m[landmark]);
        let measured = [log.sightings.range_m[i], log.sightings.bearing_rad[i]];
        let innovation = model.innovation(measured, expected);
        errors[0].push(innovation[0] / config.sensor.range_std_m);
        errors[1].push(innovation[1] / config.sensor.bearing_std_rad);
        errors[2].push((log.sightings.signature[i] - log.landmarks.signature[landmark]) / 0.03);
    }
    for (errors, what) in errors.iter().zip(["range", "bearing", "signature"]) {
        assert_standard_normal(errors, what);
    }
}

#[test]
fn sightings_through_a_lever_arm_hit_their_landmarks() {
    let mut config = base();
    config.sensor = SensorSettings {
        range_std_m: 1e-9,
        bearing_std_rad: 1e-9,
        max_range_m: 15.0,
        mounting: Mounting { x_m: 1.5, y_m: -0.6, yaw_rad: 0.8 },
        ..SensorSettings::default()
    };
    config.start = Some(Start { x_m: 30.0, y_m: -20.0, heading_rad: 2.0 });
    let log = simulate(&config).unwrap();
    let model = Sensor::from(config.sensor.clone()).range_bearing().unwrap();
    assert!(log.sightings.len() > 1000);
    for (i, T_world_sensor) in sensor_poses(&config, &log).into_iter().enumerate() {
        let hit = model.inverse(T_world_sensor, [log.sightings.range_m[i], log.sightings.bearing_rad[i]]);
        let landmark = log.landmarks.position_m[log.sightings.identity[i] as usize];
        // Noise of at most 7 standard deviations of 15 nm at 15 m, and rounding.
        assert!((hit[0] - landmark[0]).abs() < 2e-7 && (hit[1] - landmark[1]).abs() < 2e-7);
    }
}

#[test]
fn visibility_equals_brute_force() {
    let mut config = base();
    config.sensor = SensorSettings {
        range_std_m: 1e-9,
        bearing_std_rad: 1e-9,
        min_range_m: 2.0,
        max_range_m: 9.0,
        field_of_view_rad: 2.0,
        mounting: Mounting { x_m: 0.5, y_m: 0.2, yaw_rad: -0.7 },
        ..SensorSettings::default()
    };
    let log = simulate(&config).unwrap();
    let T_robot_sensor = config.sensor.mounting.T_robot_sensor();
    let model = Sensor::from(config.sensor.clone()).range_bearing().unwrap();
    let (mut row, mut expected_total) = (0, 0);
    for step in (0..log.T_world_robot.len()).step_by(config.controls_per_scan()) {
        let T_world_sensor = Pose::from(log.T_world_robot[step]).compose(T_robot_sensor);
        let mut found = vec![];
        while row < log.sightings.len() && log.sightings.stamp_s[row] == log.truth_stamp_s[step] {
            let (range, bearing) = (log.sightings.range_m[row], log.sightings.bearing_rad[row]);
            assert!((2.0..=9.0).contains(&range) && bearing.abs() <= 1.0);
            found.push(log.sightings.identity[row] as usize);
            row += 1;
        }
        found.sort_unstable();
        let expected: Vec<usize> = (0..log.landmarks.position_m.len())
            .filter(|&i| {
                let [range, bearing] = model.expected(T_world_sensor, log.landmarks.position_m[i]);
                (2.0..=9.0).contains(&range) && bearing.abs() <= 1.0
            })
            .collect();
        assert_eq!(found, expected, "step {step}");
        expected_total += expected.len();
    }
    assert_eq!(row, log.sightings.len());
    assert!(expected_total > 500, "{expected_total}");
    let seen = log.landmarks.seen.iter().filter(|s| **s).count();
    let identities: std::collections::HashSet<_> = log.sightings.identity.iter().collect();
    assert_eq!(seen, identities.len());
    assert!(seen > 20 && seen < 150, "{seen}");
}

#[test]
fn misses_clutter_withheld_names_and_confused_classes_come_at_their_rates() {
    let mut config = base();
    config.classes = Classes { names: vec!["oak".into(), "elm".into(), "fir".into()], confusion_probability: 0.2 };
    config.sensor = SensorSettings { range_std_m: 1e-9, bearing_std_rad: 1e-9, ..config.sensor };
    let all = simulate(&config).unwrap().sightings.len() as f64;
    config.scan.detection_probability = 0.7;
    config.scan.clutter_per_scan = 2.5;
    config.scan.identities = Identities::Fraction(0.4);
    let log = simulate(&config).unwrap();
    let rows = 0..log.sightings.len();
    let count = |keep: &dyn Fn(usize) -> bool| rows.clone().filter(|&i| keep(i)).count() as f64;
    let real = count(&|i| log.sightings.true_identity[i] >= 0);
    let clutter = count(&|i| log.sightings.true_identity[i] < 0);
    let named = count(&|i| log.sightings.identity[i] >= 0);
    let confused = count(&|i| {
        usize::try_from(log.sightings.true_identity[i])
            .is_ok_and(|landmark| log.landmarks.class_index[landmark] != log.sightings.class_index[i])
    });
    // Binomial: five standard errors √(n p (1 − p)).
    let binomial = |hits: f64, n: f64, p: f64, what: &str| {
        assert!(n > 1000.0, "{what}: {n}");
        assert!((hits - n * p).abs() < 5.0 * (n * p * (1.0 - p)).sqrt(), "{what}: {hits} of {n}, expected {p}");
    };
    binomial(real, all, 0.7, "detected");
    binomial(named, real, 0.4, "named");
    binomial(confused, real, 0.2, "confused");
    let scans = log.T_world_robot.len().div_ceil(config.controls_per_scan()) as f64;
    assert!((clutter - 2.5 * scans).abs() < 5.0 * (2.5 * scans).sqrt(), "{clutter} in {scans} scans");
    assert!(count(&|i| log.sightings.identity[i] >= 0 && log.sightings.true_identity[i] < 0) == 0.0);
    // Uniform over the area: r² is uniform, with mean half of the largest and variance 1/12.
    let squares: Vec<f64> = rows
        .clone()
        .filter(|&i| log.sightings.true_identity[i] < 0)
        .map(|i| log.sightings.range_m[i].powi(2) / 100.0)
        .collect();
    let mean = squares.iter().sum::<f64>() / clutter;
    assert!((mean - 0.5).abs() < 5.0 * (1.0 / (12.0 * clutter)).sqrt(), "{mean}");
    assert!(log.sightings.class_index.iter().all(|c| (0..3).contains(c)));
}

#[test]
fn the_nearest_are_kept_when_sightings_are_limited() {
    let mut config = base();
    config.sensor = SensorSettings { range_std_m: 1e-9, bearing_std_rad: 1e-9, ..config.sensor };
    let all = simulate(&config).unwrap();
    config.scan.max_sightings_per_scan = Some(3);
    let limited = simulate(&config).unwrap();
    let by_scan = |log: &SimulatedLog| {
        let mut scans = std::collections::BTreeMap::<u64, Vec<f64>>::new();
        for (stamp, range) in log.sightings.stamp_s.iter().zip(&log.sightings.range_m) {
            scans.entry((stamp * 1000.0).round() as u64).or_default().push(*range);
        }
        scans.values_mut().for_each(|ranges| ranges.sort_by(f64::total_cmp));
        scans
    };
    let (all, limited) = (by_scan(&all), by_scan(&limited));
    assert!(all.values().any(|ranges| ranges.len() > 3));
    assert_eq!(all.len(), limited.len());
    for (stamp, ranges) in all {
        assert_eq!(limited[&stamp], ranges[..ranges.len().min(3)]);
    }
}

#[test]
fn landmarks_keep_their_distance_and_their_field() {
    let config = SimulationConfig {
        world: World::Random(RandomField { count: 2000, size_m: [90.0, 60.0], min_spacing_m: 1.0 }),
        start: None,
        ..base()
    };
    let points = simulate(&config).unwrap().landmarks.position_m;
    assert_eq!(points.len(), 2000);
    for (i, a) in points.iter().enumerate() {
        assert!((0.0..=90.0).contains(&a[0]) && (0.0..=60.0).contains(&a[1]));
        for b in &points[..i] {
            assert!((a[0] - b[0]).hypot(a[1] - b[1]) >= 1.0);
        }
    }
    // Uniform to both sides of the middle: binomial with p = ½; min spacing only makes it more even.
    let left = points.iter().filter(|p| p[0] < 45.0).count() as f64;
    assert!((left - 1000.0).abs() < 5.0 * 500.0_f64.sqrt());
}

#[test]
fn the_same_seed_gives_the_same_log_and_another_seed_another() {
    let config = SimulationConfig::preset("cones").unwrap();
    let show = |config: &SimulationConfig| format!("{:?}", simulate(config).unwrap());
    let first = show(&config);
    assert_eq!(first, show(&config));
    assert_ne!(first, show(&SimulationConfig { seed: 2, ..config.clone() }));
    // A change of the sensor leaves the path and the odometry as they were.
    let mut other = config.clone();
    other.scan.detection_probability = 0.5;
    let (a, b) = (simulate(&config).unwrap(), simulate(&other).unwrap());
    assert_eq!((a.controls, a.T_world_robot), (b.controls, b.T_world_robot));
    assert_ne!(a.sightings.len(), b.sightings.len());
}

#[test]
fn cones_line_the_track_with_blue_on_the_left() {
    for seed in 1..=20 {
        let config = SimulationConfig { seed, ..SimulationConfig::preset("cones").unwrap() };
        let log = simulate(&config).unwrap();
        assert_eq!(log.class_names, ["blue", "yellow"]);
        assert_eq!(log.landmarks.position_m.len(), 150);
        assert!(log.landmarks.seen.iter().all(|s| *s), "seed {seed}");
        for (cone, class) in log.landmarks.position_m.iter().zip(&log.landmarks.class_index) {
            let side = |truth: &[f64; 3]| Pose::from(*truth).inverse().transform(*cone);
            let nearest = log
                .T_world_robot
                .iter()
                .map(side)
                .min_by(|a, b| a[0].hypot(a[1]).total_cmp(&b[0].hypot(b[1])))
                .unwrap();
            assert_eq!(nearest[1] > 0.0, *class == 0, "seed {seed}: a cone at {nearest:?} of class {class}");
            // Half the width of 1.75 m, less what pure pursuit cuts off the corners.
            assert!(nearest[0].hypot(nearest[1]) > 1.0, "seed {seed}: a cone at {nearest:?} from the path");
        }
    }
}

#[test]
fn presets_run_and_visit_what_they_promise() {
    for name in PRESETS {
        let config = SimulationConfig::preset(name).unwrap();
        if name == "headline" {
            continue; // By itself below.
        }
        let log = simulate(&config).unwrap();
        let seen = log.landmarks.seen.iter().filter(|s| **s).count();
        println!(
            "{name}: {} landmarks, {seen} seen, {} controls, {} sightings, {:.1} s",
            log.landmarks.seen.len(),
            log.controls.len(),
            log.sightings.len(),
            log.truth_stamp_s.last().unwrap()
        );
        assert_eq!(log.T_world_robot[0], [0.0; 3], "{name} starts at the origin");
        match &log.scans {
            Some(scans) => assert!(scans.ranges_m.iter().filter(|range| range.is_finite()).count() > 10_000, "{name}"),
            None => assert!(seen > 0 && seen * 10 >= log.landmarks.seen.len() * 7, "{name}: {seen} seen"),
        }
    }
    assert!(SimulationConfig::preset("nothing").is_err());
}

#[test]
fn the_lawn_mower_takes_6760_steps() {
    let log = simulate(&SimulationConfig::preset("lawn-mower").unwrap()).unwrap();
    assert_eq!(log.controls.len(), 6760);
    assert_eq!(log.landmarks.seen.len(), 1000);
    assert!(log.landmarks.seen.iter().all(|s| *s));
}

#[test]
fn the_headline_world_is_visited_everywhere() {
    let log = simulate(&SimulationConfig::preset("headline").unwrap()).unwrap();
    println!("headline: {} controls, {} sightings", log.controls.len(), log.sightings.len());
    assert_eq!(log.landmarks.seen.len(), 50_000);
    assert!(log.landmarks.seen.iter().all(|s| *s));
    assert!(log.sightings.identity.iter().all(|i| *i >= 0));
}

#[test]
fn a_random_walk_visits_every_landmark() {
    for seed in 1..=5 {
        let config = SimulationConfig { seed, trajectory: Trajectory::RandomWalk(RandomWalk::default()), ..base() };
        let log = simulate(&config).unwrap();
        assert!(log.landmarks.seen.iter().all(|s| *s), "seed {seed}");
    }
}

#[test]
fn a_line_is_almost_straight_and_waypoints_are_reached() {
    let line = SimulationConfig { trajectory: Trajectory::Line(Line::default()), start: None, ..base() };
    let poses = simulate(&line).unwrap().T_world_robot;
    assert!(poses.iter().all(|p| (p[1] - 20.0).abs() < 0.6));
    assert!(poses[poses.len() - 1][0] > 49.0);
    let points = vec![[0.0, 0.0], [20.0, 3.0], [5.0, 25.0], [40.0, 30.0]];
    let trajectory = Trajectory::Waypoints(Waypoints { points_m: points.clone() });
    let poses = simulate(&SimulationConfig { trajectory, ..line }).unwrap().T_world_robot;
    for point in points {
        let nearest = poses.iter().map(|p| (p[0] - point[0]).hypot(p[1] - point[1])).fold(f64::INFINITY, f64::min);
        // A corner is cut by less than the look-ahead of 2 m.
        assert!(nearest < 1.5, "{point:?}: {nearest}");
    }
}

#[test]
fn the_vehicle_keeps_its_limits() {
    let config = SimulationConfig::preset("lawn-mower").unwrap();
    let log = simulate(&config).unwrap();
    for control in &log.true_controls {
        let [forward, left, turn] = Pose::from(*control).to_twist();
        assert!(forward <= 0.985 + 1e-9 && left.abs() < 1e-9 && turn.abs() <= 0.5 + 1e-9, "{control:?}");
    }
}

#[test]
fn two_hundred_thousand_landmarks_are_no_matter() {
    let config = SimulationConfig::preset("headline").unwrap().with_landmarks(200_000).unwrap();
    let log = simulate(&config).unwrap();
    assert_eq!(log.landmarks.position_m.len(), 200_000);
    assert!(log.landmarks.seen.iter().all(|s| *s));
}

#[test]
#[ignore = "a million landmarks, for the clock: run it in release mode"]
fn a_million_landmarks() {
    let config = SimulationConfig::preset("headline").unwrap().with_landmarks(1_000_000).unwrap();
    let log = simulate(&config).unwrap();
    println!("{} controls, {} sightings", log.controls.len(), log.sightings.len());
    assert!(log.landmarks.seen.iter().all(|s| *s));
}

fn key_of(error: Error) -> String {
    match error {
        Error::Parameter { key, .. } => key,
        other => panic!("{other}"),
    }
}

#[test]
fn settings_out_of_range_are_named() {
    type Change = fn(&mut SimulationConfig);
    let cases: [(&str, Change); 20] = [
        ("world.count", |c| c.world = World::Random(RandomField { count: 0, ..RandomField::default() })),
        ("world.count", |c| c.world = World::Random(RandomField { min_spacing_m: 20.0, ..RandomField::default() })),
        ("world.size_m", |c| c.world = World::Random(RandomField { size_m: [5.0, -1.0], ..RandomField::default() })),
        ("world.columns", |c| c.world = World::Orchard(Orchard { columns: 0, ..Orchard::default() })),
        ("world.missing_probability", |c| {
            c.world = World::Orchard(Orchard { missing_probability: 1.0, ..Orchard::default() });
        }),
        ("world.track_length_m", |c| c.world = World::Cones(Cones { track_length_m: 20.0, ..Cones::default() })),
        ("world.points_m", |c| c.world = World::Explicit(Explicit::default())),
        ("world.points_m.1", |c| {
            c.world = World::Explicit(Explicit { points_m: vec![[0.0, 0.0], [f64::NAN, 0.0]] });
        }),
        ("trajectory.margin_m", |c| c.trajectory = Trajectory::Loop(Loop { margin_m: 30.0, ..Loop::default() })),
        ("trajectory.points_m", |c| c.trajectory = Trajectory::Waypoints(Waypoints::default())),
        ("trajectory.sweeps", |c| {
            c.trajectory = Trajectory::LawnMower(LawnMower { sweeps: 0, ..LawnMower::default() });
        }),
        ("trajectory.cell_m", |c| c.trajectory = Trajectory::RandomWalk(RandomWalk { cell_m: Some(1e-4) })),
        ("vehicle.lookahead_m", |c| c.vehicle.lookahead_m = 0.1),
        ("control_period_s", |c| c.control_period_s = f64::NAN),
        ("scan.period_s", |c| c.scan.period_s = 0.15),
        ("scan.detection_probability", |c| c.scan.detection_probability = 1.1),
        ("scan.identities.fraction", |c| c.scan.identities = Identities::Fraction(-0.1)),
        ("sensor.max_range_m", |c| c.sensor.max_range_m = 0.01),
        ("sensor.range_std_m", |c| c.sensor.range_std_m = 0.0),
        ("max_duration_s", |c| c.max_duration_s = Some(0.01)),
    ];
    for (key, change) in cases {
        let mut config = base();
        change(&mut config);
        assert_eq!(key_of(simulate(&config).unwrap_err()), key);
    }
}

#[test]
fn settings_survive_json_and_strangers_are_refused() {
    for name in PRESETS {
        let config = SimulationConfig::preset(name).unwrap();
        let text = serde_json::to_string(&config).unwrap();
        assert_eq!(serde_json::from_str::<SimulationConfig>(&text).unwrap(), config, "{name}");
    }
    let parse = |text: &str| serde_json::from_str::<SimulationConfig>(text);
    assert!(parse(r#"{"sed": 3}"#).unwrap_err().to_string().contains("sed"));
    assert!(parse(r#"{"world": {"layout": "random", "cuont": 3}}"#).unwrap_err().to_string().contains("cuont"));
    let some = parse(r#"{"scan": {"identities": {"fraction": 0.5}}, "start": null}"#).unwrap();
    assert_eq!((some.scan.identities, some.start), (Identities::Fraction(0.5), None));
    let schema = serde_json::to_string(&schemars::schema_for!(SimulationConfig)).unwrap();
    assert!(schema.contains("detection_probability") && schema.contains("lawn_mower"));
}
