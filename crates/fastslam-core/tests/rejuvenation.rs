//! Drawing all particles anew from the posterior over paths.

use crate::blind::Blind;
use crate::linear_world::{self, exact, sighting, LANDMARKS, MODEL};
use fastslam_core::config::{Algorithm, Config};
use fastslam_core::filter::{FastSlam, Identities, Sighting};
use fastslam_core::geometry::Pose;
use fastslam_core::motion::Motion;
use fastslam_core::run::{run, RunOutput};
use fastslam_core::store::StoreKind;
use fastslam_core::timeline::LogData;
use fastslam_sim::{simulate, SimulatedLog, SimulationConfig};

#[test]
fn in_a_linear_world_the_draws_are_those_of_the_exact_posterior() {
    let steps = linear_world::simulate(3);
    let exact = exact(&steps);
    for algorithm in [Algorithm::Fastslam1, Algorithm::Fastslam2] {
        // The filter before it may be as poor as it likes.
        let particles = 20_000;
        let mut config = linear_world::config(algorithm, particles, 5);
        config.filter.rejuvenation.every_steps = Some(1_000_000);
        let mut filter = FastSlam::with_model(config, Identities::All, MODEL).unwrap();
        for (t, step) in steps.iter().enumerate() {
            if t > 0 {
                filter.predict(step.control, 1.0).unwrap();
            }
            let sightings: Vec<Sighting> = step.sightings.iter().copied().map(sighting).collect();
            filter.update(t as f64, &sightings).unwrap();
        }
        assert!(filter.rejuvenate(), "{algorithm:?}");
        assert!(!filter.rejuvenate(), "nothing has happened since");
        let (pose, map) = (filter.pose(), filter.map().landmarks);
        assert_eq!(map.len(), LANDMARKS.len());
        let mut moments = vec![(pose.mean.x, pose.covariance[0][0]), (pose.mean.y, pose.covariance[1][1])];
        for landmark in &map {
            moments.push((landmark.mean[0], landmark.covariance.xx));
            moments.push((landmark.mean[1], landmark.covariance.yy));
        }
        assert_eq!(moments.len(), exact.mean.len());
        for (i, (mean, variance)) in moments.into_iter().enumerate() {
            // Independent draws: standard errors sqrt(v / M) of a mean and v sqrt(2 / M) of a variance; 4 of them. The
            // 10⁻⁸ m² that are added to the motion's variance per step are far below.
            let (truth, m) = (exact.covariance[(i, i)], f64::from(particles));
            let error = (mean - exact.mean[i]).abs();
            assert!(error < 4.0 * (truth / m).sqrt(), "{algorithm:?} mean {i}: off by {error}");
            let ratio = variance / truth;
            assert!((ratio - 1.0).abs() < 4.0 * (2.0 / m).sqrt(), "{algorithm:?} variance {i}: ratio {ratio}");
        }
    }
}

pub fn world(
    preset: &str,
    seed: u64,
    duration_s: f64,
    identities: fastslam_sim::Identities,
) -> (LogData, Config, SimulatedLog) {
    let mut simulation = SimulationConfig::preset(preset).unwrap();
    simulation.seed = seed;
    simulation.max_duration_s = Some(duration_s);
    simulation.scan.identities = identities;
    let simulated = simulate(&simulation).unwrap();
    let log = simulated.log_data();
    let mut config = Config { seed, ..Config::default() };
    (config.motion, config.sensor) = (simulated.motion.clone(), simulated.sensor.clone());
    let [x_m, y_m, heading_rad] = simulated.T_world_robot[0];
    config.initial_pose = fastslam_core::config::InitialPose { x_m, y_m, heading_rad };
    (log, config, simulated)
}

/// eᵀ C⁻¹ e of the position after every step.
fn position_nees(output: &RunOutput, truth: &SimulatedLog) -> Vec<f64> {
    let true_pose = |stamp_s: f64| {
        let next = truth.truth_stamp_s.partition_point(|t| *t < stamp_s).clamp(1, truth.truth_stamp_s.len() - 1);
        let (a, b) = (truth.truth_stamp_s[next - 1], truth.truth_stamp_s[next]);
        let [from, to] = [next - 1, next].map(|i| Pose::from(truth.T_world_robot[i]));
        from.compose(from.inverse().compose(to).fraction((stamp_s - a) / (b - a)))
    };
    let nees = |step: &fastslam_core::run::StepRecord| {
        let at = true_pose(step.stamp_s);
        let (dx, dy) = (step.pose.mean.x - at.x, step.pose.mean.y - at.y);
        // Half a millimetre, so that the start, which is known, does not divide by zero.
        let [[xx, xy, _], [_, yy, _], _] = step.pose.covariance;
        let (xx, yy) = (xx + 2.5e-7, yy + 2.5e-7);
        (yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy) / (xx * yy - xy * xy)
    };
    output.steps.iter().map(nees).collect()
}

fn median(values: &mut [f64]) -> f64 {
    assert!(!values.is_empty());
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

#[test]
#[ignore = "slow: make test-all runs it"]
fn a_long_loop_stays_consistent_where_the_plain_filter_does_not() {
    let quarters = |every_steps: u32| -> Vec<f64> {
        let mut by_quarter = vec![Vec::new(); 4];
        for seed in 0..7 {
            let (log, mut config, truth) = world("loop", seed, 120.0, fastslam_sim::Identities::All);
            (config.filter.rejuvenation.every_steps, config.filter.rejuvenation.growth) = (Some(every_steps), 0.02);
            let nees = position_nees(&run(&config, &log, &mut Blind).unwrap(), &truth);
            for (quarter, values) in nees.chunks(nees.len().div_ceil(4)).enumerate() {
                by_quarter[quarter].push(median(&mut values.to_vec()));
            }
        }
        by_quarter.iter_mut().map(|medians| median(medians)).collect()
    };
    let (plain, rejuvenated) = (quarters(0), quarters(20));
    println!("median NEES of the position by quarter: {plain:.1?} plain, {rejuvenated:.1?} rejuvenated");
    // The median of chi-squared with two degrees of freedom is 1.39; the issue that asked for this allows 6 with three.
    assert!(rejuvenated.iter().all(|nees| *nees < 6.0), "{rejuvenated:?}");
    assert!(plain[3] > 20.0, "the plain filter gives {plain:?}: nothing to cure");
}

fn map_rmse(output: &RunOutput, truth: &SimulatedLog) -> f64 {
    let errors = output.map.landmarks.iter().map(|landmark| {
        let distance = |at: &[f64; 2]| (landmark.mean[0] - at[0]).hypot(landmark.mean[1] - at[1]);
        truth.landmarks.position_m.iter().map(distance).fold(f64::INFINITY, f64::min).powi(2)
    });
    let errors: Vec<f64> = errors.collect();
    assert!(errors.len() > 20, "{} landmarks", errors.len());
    (errors.iter().sum::<f64>() / errors.len() as f64).sqrt()
}

#[test]
fn the_map_gets_better_also_without_identities() {
    for identities in [fastslam_sim::Identities::All, fastslam_sim::Identities::None] {
        let (mut plain, mut rejuvenated) = (Vec::new(), Vec::new());
        for seed in 0..5 {
            let (log, mut config, truth) = world("demo", seed, 60.0, identities);
            (config.filter.particles, config.filter.rejuvenation.every_steps) = (20, Some(0));
            plain.push(map_rmse(&run(&config, &log, &mut Blind).unwrap(), &truth));
            config.filter.rejuvenation.every_steps = Some(50);
            rejuvenated.push(map_rmse(&run(&config, &log, &mut Blind).unwrap(), &truth));
        }
        let (plain, rejuvenated) = (median(&mut plain), median(&mut rejuvenated));
        println!("{identities:?}: map RMSE {plain:.3} m plain, {rejuvenated:.3} m rejuvenated");
        assert!(rejuvenated < plain, "{identities:?}: {rejuvenated} m against {plain} m");
    }
}

#[test]
#[ignore = "slow: make test-all runs it"]
fn a_loop_that_the_associations_missed_is_closed() {
    // Swept in lanes, then across: the way back to the first lanes is long. Told twice the variance of the motion, the
    // plain filter maps all a second time.
    let (log, mut config, truth) = world("lawn-mower", 1, 10_000.0, fastslam_sim::Identities::None);
    let Motion::Increments(motion) = &mut config.motion else { panic!("another model: {:?}", config.motion) };
    for std in [&mut motion.x_std_m, &mut motion.y_std_m, &mut motion.heading_std_rad] {
        *std *= std::f64::consts::SQRT_2;
    }
    (config.filter.particles, config.filter.rejuvenation.every_steps) = (30, None);
    let landmarks = truth.landmarks.position_m.len();
    let merged = |output: &RunOutput| output.steps.iter().map(|step| step.info.changes.merged).sum::<u32>();
    config.filter.rejuvenation.closing_odds = 0.0;
    let open = run(&config, &log, &mut Blind).unwrap();
    assert_eq!(merged(&open), 0);
    assert!(open.map.landmarks.len() > 3 * landmarks / 2, "{} landmarks: no loop to close", open.map.landmarks.len());
    config.filter.rejuvenation.closing_odds = 1000.0;
    let closed = run(&config, &log, &mut Blind).unwrap();
    let held = closed.map.landmarks.len();
    println!("{held} landmarks of {landmarks}, {} merged", merged(&closed));
    assert!(merged(&closed) > 0 && (landmarks..landmarks + 10).contains(&held), "{held} landmarks");
    // Metres off at the far end, as the first lanes leave it; a multiple of that where the second sweep has its own map.
    let (off, off_open) = (map_rmse(&closed, &truth), map_rmse(&open, &truth));
    assert!(3.0 * off < off_open, "map RMSE {off:.2} m, {off_open:.2} m with the loop open");
    for store in [StoreKind::Dense, StoreKind::Tree] {
        config.filter.store = store;
        assert_eq!(run(&config, &log, &mut Blind).unwrap().map, closed.map, "{store:?}");
    }
}

#[test]
fn neither_the_store_nor_the_number_of_threads_changes_a_bit() {
    for identities in
        [fastslam_sim::Identities::All, fastslam_sim::Identities::None, fastslam_sim::Identities::Fraction(0.5)]
    {
        for algorithm in [Algorithm::Fastslam1, Algorithm::Fastslam2] {
            let (log, mut config, _) = world("demo", 3, 15.0, identities);
            config.algorithm = algorithm;
            (config.filter.particles, config.filter.rejuvenation.every_steps) = (20, Some(10));
            config.filter.store = StoreKind::Dense;
            let reference = run(&config, &log, &mut Blind).unwrap();
            assert!(reference.steps.iter().filter(|step| step.info.sampling.rejuvenated).count() >= 3);
            for (store, threads) in [(StoreKind::Tree, 1), (StoreKind::Lineage, 1), (StoreKind::Lineage, 3)] {
                (config.filter.store, config.filter.threads) = (store, threads);
                let other = run(&config, &log, &mut Blind).unwrap();
                assert_eq!(reference.map, other.map, "{identities:?} {algorithm:?} {store:?} {threads}");
                assert_eq!(reference.smoothed, other.smoothed, "{identities:?} {algorithm:?} {store:?} {threads}");
                let poses = |output: &RunOutput| output.steps.iter().map(|s| s.pose).collect::<Vec<_>>();
                assert_eq!(poses(&reference), poses(&other), "{identities:?} {algorithm:?} {store:?} {threads}");
            }
        }
    }
}

#[test]
fn poses_before_the_window_stand_still() {
    let (log, mut config, _) = world("demo", 1, 30.0, fastslam_sim::Identities::All);
    (config.filter.particles, config.filter.rejuvenation.every_steps) = (20, Some(1_000_000));
    let window = 40;
    config.filter.rejuvenation.window_steps = Some(window);
    let mut filter = FastSlam::new(config.clone(), Identities::All).unwrap();
    for event in fastslam_core::timeline::Timeline::of(&log, config.motion.timing(), 0.5) {
        match event {
            fastslam_core::timeline::Event::Control(part) => filter.advance(&part).unwrap(),
            fastslam_core::timeline::Event::Step(fastslam_core::timeline::SightingsRow {
                stamp_s, sightings, ..
            }) => {
                filter.update(stamp_s, &sightings).map(|_| ()).unwrap();
            }
        }
    }
    let before = filter.best_path();
    assert!(filter.rejuvenate());
    let after = filter.best_path();
    assert_eq!(before.len(), after.len());
    let held = before.len() - window as usize;
    assert!(held > 20);
    assert_eq!(before[..held], after[..held]);
    assert!(before[held..].iter().zip(&after[held..]).all(|(a, b)| a.1 != b.1));
}

#[test]
fn a_filter_that_was_not_asked_to_does_not_remember() {
    let mut config = Config::default();
    config.filter.rejuvenation.every_steps = Some(0);
    let mut filter = FastSlam::new(config, Identities::All).unwrap();
    filter.update(0.0, &[Sighting::range_bearing(3.0, 0.0, Some(1))]).unwrap();
    assert!(!filter.rejuvenate());
}

/// A field driven around twice with a sensor that looks ahead: the pose is off by more than the landmarks' spacing when
/// the first ones come back.
pub fn two_laps(seed: u64) -> (LogData, Config, SimulatedLog) {
    simulated(&two_laps_simulation(seed))
}

fn two_laps_simulation(seed: u64) -> SimulationConfig {
    let mut simulation = SimulationConfig::preset("loop").unwrap();
    simulation.seed = seed;
    if let fastslam_sim::Trajectory::Loop(round) = &mut simulation.trajectory {
        round.laps = 2;
    }
    simulation.sensor.field_of_view_rad = 162_f64.to_radians();
    simulation.scan.identities = fastslam_sim::Identities::None;
    simulation
}

fn simulated(simulation: &SimulationConfig) -> (LogData, Config, SimulatedLog) {
    let (simulated, seed) = (simulate(simulation).unwrap(), simulation.seed);
    let mut config =
        Config { seed, motion: simulated.motion.clone(), sensor: simulated.sensor.clone(), ..Config::default() };
    let [x_m, y_m, heading_rad] = simulated.T_world_robot[0];
    config.initial_pose = fastslam_core::config::InitialPose { x_m, y_m, heading_rad };
    (simulated.log_data(), config, simulated)
}

#[test]
fn with_plain_defaults_a_field_is_mapped_once() {
    let (mut plain, mut drawn) = (Vec::new(), Vec::new());
    for seed in 1..4 {
        let (log, mut config, truth) = two_laps(seed);
        let output = run(&config, &log, &mut Blind).unwrap();
        let draws = output.steps.iter().filter(|step| step.info.sampling.rejuvenated).count();
        let scans = output.steps.iter().filter(|step| step.info.sightings > 0).count();
        assert!((2..scans / 20).contains(&draws), "{draws} draws in {scans} scans");
        drawn.push((output.map.landmarks.len(), map_rmse(&output, &truth)));
        config.filter.rejuvenation.every_steps = Some(0);
        let output = run(&config, &log, &mut Blind).unwrap();
        assert!(output.steps.iter().all(|step| !step.info.sampling.rejuvenated));
        plain.push((output.map.landmarks.len(), map_rmse(&output, &truth)));
    }
    println!("landmarks and map RMSE: {drawn:.3?}, plain {plain:.3?}");
    // In view are 139, 142 and 139.
    assert!(drawn.iter().all(|(landmarks, _)| *landmarks <= 145), "{drawn:?}");
    assert!(drawn.iter().zip(&plain).all(|(drawn, plain)| drawn.1 < 0.6 * plain.1), "{drawn:?} {plain:?}");
    assert!(plain.iter().any(|(landmarks, _)| *landmarks > 180), "{plain:?}: nothing to cure");
}

#[test]
fn a_past_of_few_keyframes_closes_the_loop_too() {
    let (mut plain, mut short) = (Vec::new(), Vec::new());
    for seed in 1..4 {
        let (log, mut config, truth) = two_laps(seed);
        config.filter.rejuvenation.keyframes = 300;
        let output = run(&config, &log, &mut Blind).unwrap();
        let draws = output.steps.iter().filter(|step| step.info.sampling.rejuvenated).count();
        assert!(draws >= 2 && output.steps.len() > 3 * 300, "{draws} draws in {} steps", output.steps.len());
        assert!(output.map.landmarks.len() <= 145, "{}", output.map.landmarks.len());
        short.push(map_rmse(&output, &truth));
        config.filter.rejuvenation.every_steps = Some(0);
        let without = run(&config, &log, &mut Blind).unwrap();
        assert_eq!(output.smoothed.len(), without.smoothed.len());
        plain.push(map_rmse(&without, &truth));
    }
    println!("map RMSE: {short:.3?}, plain {plain:.3?}");
    // In the frame that the robot began in, of which both know no more than the first sightings say.
    assert!(short.iter().sum::<f64>() < 0.6 * plain.iter().sum::<f64>(), "{short:?} {plain:?}");
}

#[test]
fn loops_close_where_the_odometry_errs_ten_times_as_much_as_it_is_told() {
    loops_close_where_the_odometry_errs_more_than_told(&[702]);
}

#[test]
#[ignore = "slow: make test-all runs it"]
fn loops_of_more_worlds_close_where_the_odometry_errs_ten_times_as_much_as_it_is_told() {
    loops_close_where_the_odometry_errs_more_than_told(&[701, 703, 704]);
}

fn loops_close_where_the_odometry_errs_more_than_told(seeds: &[u64]) {
    let confirmed = |output: &RunOutput| output.map.landmarks.iter().filter(|landmark| landmark.confirmed).count();
    for &seed in seeds {
        let mut simulation = SimulationConfig::preset("orchard").unwrap();
        (simulation.seed, simulation.scan.identities) = (seed, fastslam_sim::Identities::None);
        let (log, mut config, _) = simulated(&simulation);
        let right = confirmed(&run(&config, &log, &mut Blind).unwrap());
        let Motion::Velocity(velocity) = &mut config.motion else { panic!("{:?}", config.motion) };
        velocity.speed_std_m_per_s /= 10.0;
        velocity.yaw_rate_std_rad_per_s /= 10.0;
        let found = confirmed(&run(&config, &log, &mut Blind).unwrap());
        // By what the odometry is told to err they are two fields, side by side: more than 300 landmarks.
        assert!(right > 150 && (right..right + 4).contains(&found), "seed {seed}: {found} of {right}");
    }
}

#[test]
fn names_that_come_back_after_a_long_way_correct_the_whole_way() {
    let (mut plain, mut drawn) = (Vec::new(), Vec::new());
    for seed in 1..4 {
        let mut simulation = two_laps_simulation(seed);
        simulation.scan.identities = fastslam_sim::Identities::All;
        let (log, mut config, truth) = simulated(&simulation);
        let output = run(&config, &log, &mut Blind).unwrap();
        let draws = output.steps.iter().filter(|step| step.info.sampling.rejuvenated).count();
        let scans = output.steps.iter().filter(|step| step.info.sightings > 0).count();
        assert!((1..scans / 20).contains(&draws), "{draws} draws in {scans} scans");
        drawn.push(map_rmse(&output, &truth));
        config.filter.rejuvenation.every_steps = Some(0);
        plain.push(map_rmse(&run(&config, &log, &mut Blind).unwrap(), &truth));
    }
    println!("map RMSE: {drawn:.3?}, plain {plain:.3?}");
    // In the frame that the robot began in, of which both know no more than the first sightings say.
    assert!(drawn.iter().zip(&plain).all(|(drawn, plain)| drawn < plain), "{drawn:?} {plain:?}");
    assert!(drawn.iter().sum::<f64>() < 0.6 * plain.iter().sum::<f64>(), "{drawn:?} {plain:?}");
}
