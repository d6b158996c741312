//! Ranges alone: beacons at unknown places are found, whatever the sensor reports too much, and nothing breaks it.

use fastslam_core::config::{Algorithm, AssociationMode, Config};
use fastslam_core::error::Error;
use fastslam_core::filter::Identities;
use fastslam_core::geometry::Pose;
use fastslam_core::measurement::SensorModel;
use fastslam_core::motion::{Motion, Velocity};
use fastslam_core::partial::PartialSlam;
use fastslam_core::random::{Purpose, RandomSource};
use fastslam_core::sighting::Sighting;
use fastslam_core::slam::{self, Slam};

const BEACONS: [[f64; 2]; 5] = [[12.0, 9.0], [-8.0, 14.0], [3.0, -11.0], [22.0, 18.0], [-15.0, -6.0]];
const NOISE_M: f64 = 0.2;

fn config(seed: u64) -> Config {
    let mut config = Config { seed, ..Config::default() };
    config.sensor.change(|s| s.model = SensorModel::Range);
    config.sensor.change(|s| s.range_std_m = NOISE_M);
    config.filter.particles = 30;
    let noise = Velocity {
        speed_std_m_per_s: 0.05,
        yaw_rate_std_rad_per_s: 0.02,
        noise_period_s: Some(1.0),
        ..Velocity::default()
    };
    config.motion = Motion::Velocity(noise);
    config
}

/// A drive in bends of which every row is noisy: what it reports, what it hears, and where it was.
fn drive(world: u64, steps: u32, [scale, bias_m]: [f64; 2]) -> Vec<([f64; 3], Vec<Sighting>, Pose)> {
    let stream = RandomSource::new(world).stream(Purpose::Simulation, 1);
    let mut pose = Pose::default();
    let step = |k: u32| {
        let yaw_rate = 0.35 * (f64::from(k) / 25.0).sin() + 0.12;
        let ([a, b], mut seen) = (stream.normal_pair(k, 0), Vec::new());
        pose = pose.compose(Pose::from_twist(1.0 + 0.03 * a, 0.0, yaw_rate + 0.01 * b));
        for (name, beacon) in BEACONS.into_iter().enumerate().filter(|(name, _)| !(*name as u32 + k).is_multiple_of(3))
        {
            let [noise, _] = stream.normal_pair(k, 1 + name as u32);
            let range_m = (beacon[0] - pose.x).hypot(beacon[1] - pose.y);
            seen.push(Sighting::range(scale * range_m + bias_m + NOISE_M * noise, Some(name as u32)));
        }
        ([1.0, yaw_rate, 0.0], seen, pose)
    };
    (0..steps).map(step).collect()
}

/// Feeds a drive and gives the largest distance of a beacon from its place and the pose's distance at the end.
fn errors_after(filter: &mut dyn Slam, drive: &[([f64; 3], Vec<Sighting>, Pose)]) -> (f64, f64) {
    for (k, (control, seen, _)) in drive.iter().enumerate() {
        filter.predict(*control, 1.0).unwrap();
        filter.update(k as f64 + 1.0, seen).unwrap();
    }
    let (pose, last) = (filter.pose().mean, drive[drive.len() - 1].2);
    let map = filter.map();
    assert_eq!(map.landmarks.len(), BEACONS.len());
    let off = |landmark: &fastslam_core::filter::MapLandmark| {
        assert!(landmark.confirmed, "{landmark:?}");
        let place = BEACONS[landmark.identity.unwrap() as usize];
        (landmark.mean[0] - place[0]).hypot(landmark.mean[1] - place[1])
    };
    let worst = map.landmarks.iter().map(off).fold(0.0, f64::max);
    (worst, (pose.x - last.x).hypot(pose.y - last.y))
}

#[test]
fn beacons_at_unknown_places_are_found_by_both_algorithms() {
    for (seed, algorithm) in [(1, Algorithm::Fastslam2), (2, Algorithm::Fastslam2), (3, Algorithm::Fastslam1)] {
        let mut config = config(seed);
        config.algorithm = algorithm;
        config.sensor.change(|s| s.range_scale_std = Some(0.0));
        config.sensor.change(|s| s.range_bias_std_m = Some(0.0));
        let mut filter = PartialSlam::range_only(config).unwrap();
        let (map_m, pose_m) = errors_after(&mut filter, &drive(seed, 200, [1.0, 0.0]));
        assert!(map_m < 1.0 && pose_m < 1.5, "{algorithm:?} of world {seed}: map {map_m}, pose {pose_m}");
        assert_eq!(filter.hypotheses(0).len(), 1);
    }
}

#[test]
fn scale_and_bias_are_learned() {
    for seed in [5, 6] {
        let mut filter = PartialSlam::range_only(config(seed)).unwrap();
        let (map_m, pose_m) = errors_after(&mut filter, &drive(seed, 250, [1.07, 0.3]));
        let (found, std) = filter.calibration();
        assert!((found.scale - 1.07).abs() < 0.02 && (found.bias - 0.3).abs() < 0.3, "{found:?} ± {std:?}");
        assert!(map_m < 1.0 && pose_m < 1.5, "world {seed}: map {map_m}, pose {pose_m}");
        let told = PartialSlam::range_only({
            let mut config = config(seed);
            config.sensor.change(|s| (s.range_scale_std, s.range_bias_std_m) = (Some(0.0), Some(0.0)));
            config
        });
        let (misled_m, _) = errors_after(&mut told.unwrap(), &drive(seed, 250, [1.07, 0.3]));
        assert!(misled_m > map_m, "told that the sensor is right: {misled_m}, not told: {map_m}");
    }
}

#[test]
fn wild_ranges_are_outlived_with_a_heavy_tail() {
    let mut config = config(8);
    config.sensor.change(|s| s.tail_degrees_of_freedom = Some(4.0));
    let mut drive = drive(8, 200, [1.0, 0.0]);
    for (k, (_, seen, _)) in drive.iter_mut().enumerate().filter(|(k, _)| k % 7 == 3) {
        if let Some(sighting) = seen.first_mut() {
            sighting.value[0] += 8.0 + (k % 5) as f64;
        }
    }
    let (map_m, pose_m) = errors_after(&mut PartialSlam::range_only(config).unwrap(), &drive);
    assert!(map_m < 1.0 && pose_m < 1.5, "map {map_m}, pose {pose_m}");
}

#[test]
fn the_same_seed_gives_the_same_bits_also_after_a_cut() {
    let drive = drive(9, 120, [1.05, 0.1]);
    let mut whole = PartialSlam::range_only(config(9)).unwrap();
    let of_whole = errors_after(&mut whole, &drive);
    for cut in [3, 40, 90] {
        let mut first = PartialSlam::range_only(config(9)).unwrap();
        for (k, (control, seen, _)) in drive[..cut].iter().enumerate() {
            Slam::predict(&mut first, *control, 1.0).unwrap();
            first.update(k as f64 + 1.0, seen).unwrap();
        }
        let (mut second, ..) = slam::load(&first.save("").unwrap(), &slam::create).unwrap();
        for (k, (control, seen, _)) in drive.iter().enumerate().skip(cut) {
            second.predict(*control, 1.0).unwrap();
            second.update(k as f64 + 1.0, seen).unwrap();
        }
        assert_eq!(second.pose(), whole.pose(), "{of_whole:?}");
        assert_eq!(second.map(), PartialSlam::map(&whole));
        assert_eq!(second.best_path(), whole.best_path());
    }
}

#[test]
fn ranges_that_are_none_are_counted_and_change_nothing() {
    let mut filter = slam::create(config(1), Identities::All).unwrap();
    for (k, (control, seen, _)) in drive(1, 60, [1.0, 0.0]).into_iter().enumerate() {
        filter.predict(control, 1.0).unwrap();
        filter.update(k as f64, &seen).unwrap();
    }
    let before = filter.map();
    let wrong = [0.0, -3.0, f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e300, 1e5];
    let sightings: Vec<Sighting> = wrong.iter().map(|r| Sighting::range(*r, Some(1))).collect();
    let info = filter.update(100.0, &sightings).unwrap();
    assert_eq!((info.sightings, info.left_out.skipped.total()), (0, wrong.len() as u32));
    let unnamed = filter.update(101.0, &[Sighting::range(5.0, None)]).unwrap();
    assert_eq!(unnamed.left_out.skipped.without_identity, 1);
    assert_eq!(filter.map(), before);
    // Within the limits, but nothing that the map explains: the filter goes on, and stays a filter.
    for (k, range_m) in [99.9, 0.06, 50.0].into_iter().enumerate() {
        filter
            .update(110.0 + k as f64, &[Sighting::range(range_m, Some(0)), Sighting::range(range_m, Some(0))])
            .unwrap();
    }
    assert!(filter.pose().mean.is_finite());
}

#[test]
fn what_cannot_be_is_refused_in_one_line() {
    let refused = |change: &dyn Fn(&mut Config), identities| {
        let mut config = config(1);
        change(&mut config);
        match slam::create(config, identities) {
            Err(error @ Error::Parameter { .. }) => error.to_string(),
            _ => panic!("not refused"),
        }
    };
    let all = Identities::All;
    assert!(refused(&|c| c.algorithm = Algorithm::Ekf, all).starts_with("algorithm: got ekf"));
    assert!(
        refused(&|c| c.association.mode = AssociationMode::Unknown, all).starts_with("association.mode: got unknown")
    );
    assert!(refused(&|_| {}, Identities::None).contains("known identities"));
    assert!(refused(&|c| c.sensor.change(|s| s.range_scale_std = Some(-0.1)), all)
        .starts_with("sensor.range_scale_std: got -0.1"));
    let error = fastslam_core::filter::FastSlam::new(config(1), all).err().unwrap().to_string();
    assert!(error.starts_with("sensor.model: got range"), "{error}");
}
