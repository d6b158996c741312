//! Filters that begin in a given map, at a start that is not known exactly.

use crate::linear_world::{self, exact, sighting, LANDMARKS, MODEL};
use fastslam_core::config::{Algorithm, AssociationMode, Classes, Config, MergingRule, Removal};
use fastslam_core::filter::{FastSlam, Identities, Sighting};
use fastslam_core::gaussian::Gaussian;
use fastslam_core::geometry::{Pose, Symmetric2};
use fastslam_core::given::{Beginning, GivenLandmark, Role, Start};
use fastslam_core::math::wrap_angle;
use fastslam_core::random::{Purpose, RandomSource};
use fastslam_core::sighting::Appearance;
use fastslam_core::slam;
use fastslam_core::store::StoreKind;

const DT_S: f64 = 0.2;
const STEPS: u64 = 200;
/// 144 landmarks in a grid around the robot's circle.
const GRID: u32 = 12;
const STORES: [StoreKind; 3] = [StoreKind::Dense, StoreKind::Tree, StoreKind::Lineage];

fn place(identity: u32) -> [f64; 2] {
    let uneven = 0.4 * f64::from((identity * 7) % 5);
    [f64::from(identity % GRID) * 2.5 - 13.0 + uneven, f64::from(identity / GRID) * 2.5 - 7.0]
}

fn landmark(identity: u32, role: Role, std_m: f64) -> GivenLandmark {
    let [a, b] = RandomSource::new(11).stream(Purpose::Simulation, 999).normal_pair(identity, 0);
    let [x, y] = place(identity);
    let covariance = Symmetric2::new(std_m * std_m, 0.0, std_m * std_m);
    GivenLandmark {
        place: Gaussian { mean: [x + std_m * a, y + std_m * b], covariance },
        identity: None,
        appearance: Appearance::default(),
        log_odds: None,
        sightings: 9,
        role,
    }
}

fn map(role: Role, std_m: f64) -> Beginning {
    let landmarks = (0..GRID * GRID).map(|identity| landmark(identity, role, std_m)).collect();
    let covariance = [[0.04, 0.0, 0.0], [0.0, 0.04, 0.0], [0.0, 0.0, 0.0025]];
    Beginning { landmarks, start: Start::Gaussian(Pose::new(0.1, -0.1, 0.03), covariance) }
}

fn config(algorithm: Algorithm, store: StoreKind) -> Config {
    let mut config = Config { seed: 5, algorithm, ..Config::default() };
    config.filter.store = store;
    config.filter.particles = 100;
    config.sensor.change(|s| s.max_range_m = 5.5);
    config.association.mode = AssociationMode::Unknown;
    config.association.merging.rule = MergingRule::Nearby;
    config.association.existence.removal = Removal::WhenMissed;
    config
}

fn scan(step: u64, T_world_robot: Pose, named: bool) -> Vec<Sighting> {
    let noise = RandomSource::new(3).stream(Purpose::Simulation, step);
    let mut seen = Vec::new();
    for identity in 0..GRID * GRID {
        let [x, y] = place(identity);
        let (dx, dy) = (x - T_world_robot.x, y - T_world_robot.y);
        if dx.hypot(dy) < 5.0 && !step.is_multiple_of(5) {
            let [range, bearing] = noise.normal_pair(identity, 0);
            let bearing = wrap_angle(dy.atan2(dx) - T_world_robot.heading) + 0.02 * bearing;
            seen.push(Sighting::range_bearing(dx.hypot(dy) + 0.1 * range, bearing, named.then_some(identity)));
        }
    }
    seen
}

/// Drives on from step `first`; returns the sum of squared position errors and the bits of all poses.
fn drive(filter: &mut FastSlam, first: u64) -> (f64, Vec<u64>) {
    let named = filter.config().association.mode == AssociationMode::Known;
    let (mut truth, mut squares, mut said) = (Pose::default(), 0.0, Vec::new());
    for step in 0..STEPS {
        truth = truth.compose(Pose::new(DT_S, 0.0, 0.15 * DT_S));
        if step < first {
            continue;
        }
        filter.predict([1.0, 0.15, 0.0], DT_S).unwrap();
        let info = filter.update(step as f64 * DT_S, &scan(step, truth, named)).unwrap();
        let pose = filter.predicted_pose().mean;
        squares += (pose.x - truth.x).powi(2) + (pose.y - truth.y).powi(2);
        said.extend([pose.x, pose.y, pose.heading, info.weighing.log_likelihood].map(f64::to_bits));
    }
    (squares, said)
}

fn rms_m(squares: f64) -> f64 {
    (squares / STEPS as f64).sqrt()
}

/// Names known in FastSLAM 1.0, unknown in 2.0.
fn begun(algorithm: Algorithm, store: StoreKind, given: &Beginning) -> FastSlam {
    let mut config = config(algorithm, store);
    let mut given = given.clone();
    let mut identities = Identities::None;
    if algorithm == Algorithm::Fastslam1 {
        (config.association.mode, identities) = (AssociationMode::Known, Identities::All);
        (0..).zip(&mut given.landmarks).for_each(|(identity, landmark)| landmark.identity = Some(identity));
    }
    let mut filter = FastSlam::new(config, identities).unwrap();
    filter.begin(&given).unwrap();
    filter
}

#[test]
fn what_a_given_map_occupies_does_not_grow_with_the_particles() {
    let given = map(Role::Prior, 0.05);
    let bytes = |store: StoreKind, particles: u32| {
        let mut config = config(Algorithm::Fastslam2, store);
        config.filter.particles = particles;
        config.association.classes = Some(Classes { number: 3, ..Classes::default() });
        let mut filter = FastSlam::new(config, Identities::None).unwrap();
        filter.begin(&given).unwrap();
        assert_eq!(filter.store_usage().rows, given.landmarks.len(), "{store:?}");
        filter.store_usage().bytes
    };
    for store in STORES {
        // Rows of its own would be 144 times six numbers of the Gaussian, two of existence and six of looks: 16 kB. What
        // finds its map, and rows to work on, are a tenth of that at most.
        let of_a_particle = bytes(store, 1100).saturating_sub(bytes(store, 100)) / 1000;
        assert!(of_a_particle <= 144 * 8 * (6 + 2 + 6) / 10, "{store:?}: {of_a_particle} bytes");
    }
}

#[test]
fn a_fixed_map_localises_and_stays_what_it_was_in_every_store() {
    for algorithm in [Algorithm::Fastslam1, Algorithm::Fastslam2] {
        let mut first: Option<Vec<u64>> = None;
        for store in STORES {
            let given = map(Role::Fixed, 0.01);
            let mut filter = begun(algorithm, store, &given);
            let rows = filter.store_usage().rows;
            let (squares, mut said) = drive(&mut filter, 0);
            // The range's standard deviation; poses drawn from the motion alone hardly hit so narrow a likelihood.
            let most_m = if algorithm == Algorithm::Fastslam1 { 0.2 } else { 0.1 };
            assert!(rms_m(squares) < most_m, "{algorithm:?} {store:?}: {}", rms_m(squares));
            filter.rejuvenate();
            let landmarks = filter.map().landmarks;
            // A landmark half a metre away may be seen past by more than three standard deviations, once.
            assert!(landmarks.len() <= given.landmarks.len() + 1, "{algorithm:?}: {}", landmarks.len());
            let mut sighted = 0;
            for (after, before) in landmarks.iter().zip(&given.landmarks) {
                let counts = after.given.unwrap();
                // Averaging over particles rounds.
                let moved = (0..2).map(|axis| (after.mean[axis] - before.place.mean[axis]).abs()).fold(0.0, f64::max);
                assert!(moved < 1e-12 && after.confirmed && counts.role == Role::Fixed);
                assert!((after.covariance.xx - 1e-4).abs() < 2e-8);
                assert!(2 * counts.missed <= counts.sighted + 5, "{counts:?}");
                sighted += counts.sighted;
            }
            assert!(sighted > 1000, "{sighted}");
            assert_eq!(rows, given.landmarks.len(), "{store:?}: one row each, for all particles");
            // What a lineage founded itself has at most a row per particle.
            assert!(filter.store_usage().rows <= rows + 100 * (landmarks.len() - rows), "{store:?}");
            let path = filter.best_path();
            said.extend(path.iter().flat_map(|(_, pose)| pose.to_array()).map(f64::to_bits));
            assert!(path.len() > 100);
            assert_eq!(*first.get_or_insert_with(|| said.clone()), said, "{store:?}");
        }
    }
}

#[test]
fn a_prior_map_improves_and_is_not_doubled() {
    for algorithm in [Algorithm::Fastslam1, Algorithm::Fastslam2] {
        let mut first = None;
        for store in STORES {
            let given = map(Role::Prior, 0.1);
            let mut filter = begun(algorithm, store, &given);
            let (squares, said) = drive(&mut filter, 0);
            filter.rejuvenate();
            assert!(rms_m(squares) < 0.2, "{algorithm:?}: {}", rms_m(squares));
            let landmarks = filter.map().landmarks;
            let all_there = landmarks.iter().take(given.landmarks.len()).all(|landmark| landmark.given.is_some());
            // A poor start founds one or another.
            assert!(all_there && landmarks.len() <= given.landmarks.len() + 3, "{}", landmarks.len());
            let (mut before, mut after, mut seen) = (0.0, 0.0, 0);
            for (identity, landmark) in (0..).zip(landmarks.iter().take(given.landmarks.len())) {
                let prior = &given.landmarks[identity as usize];
                let error =
                    |mean: [f64; 2]| (mean[0] - place(identity)[0]).powi(2) + (mean[1] - place(identity)[1]).powi(2);
                if landmark.given.unwrap().sighted == 0 {
                    assert_eq!(landmark.covariance.determinant().sqrt() as f32, 0.01);
                    continue;
                }
                seen += 1;
                before += error(prior.place.mean);
                after += error(landmark.mean);
                assert!(landmark.sightings > 9);
                assert!(landmark.covariance.determinant() < prior.place.covariance.determinant());
            }
            // The priors, of independent errors, say where the whole lies to 0.1 / sqrt(seen).
            // With names FastSLAM 1.0 takes in sightings from poses that are off by more than the priors.
            let most = if algorithm == Algorithm::Fastslam1 { 1.0 } else { 0.25 };
            assert!(seen > 40 && after < most * before, "{algorithm:?} {seen}: {before} {after}");
            assert_eq!(*first.get_or_insert(said.clone()), said, "{store:?}");
        }
    }
}

#[test]
fn a_draw_of_paths_holds_priors_as_the_exact_posterior_does() {
    let steps = linear_world::simulate(3);
    let exact = exact(&steps);
    for algorithm in [Algorithm::Fastslam1, Algorithm::Fastslam2] {
        // The first scan is taken from a known pose: what it says of two landmarks is given as a map instead.
        let particles = 20_000;
        let mut config = linear_world::config(algorithm, particles, 5);
        config.filter.rejuvenation.every_steps = Some(1_000_000);
        let variance = MODEL.position_std_m.powi(2);
        let prior = |(identity, mean): &(usize, [f64; 2])| GivenLandmark {
            place: Gaussian { mean: *mean, covariance: Symmetric2::new(variance, 0.0, variance) },
            identity: Some(*identity as u32),
            ..landmark(0, Role::Prior, 0.1)
        };
        let landmarks: Vec<_> = steps[0].sightings.iter().map(prior).collect();
        assert_eq!(landmarks.len(), 2);
        let mut filter = FastSlam::with_model(config, Identities::All, MODEL).unwrap();
        filter.begin(&Beginning { landmarks, start: Start::Configured }).unwrap();
        for (t, step) in steps.iter().enumerate().skip(1) {
            filter.predict(step.control, 1.0).unwrap();
            let sightings: Vec<Sighting> = step.sightings.iter().copied().map(sighting).collect();
            filter.update(t as f64, &sightings).unwrap();
        }
        assert!(filter.rejuvenate());
        let (pose, map) = (filter.pose(), filter.map().landmarks);
        assert_eq!(map.len(), LANDMARKS.len());
        let mut moments = vec![(pose.mean.x, pose.covariance[0][0]), (pose.mean.y, pose.covariance[1][1])];
        for landmark in &map {
            moments.push((landmark.mean[0], landmark.covariance.xx));
            moments.push((landmark.mean[1], landmark.covariance.yy));
        }
        assert_eq!(moments.len(), exact.mean.len());
        for (i, (mean, variance)) in moments.into_iter().enumerate() {
            // Standard errors of independent draws, as in `rejuvenation.rs`; 4 of them.
            let (truth, m) = (exact.covariance[(i, i)], f64::from(particles));
            assert!((mean - exact.mean[i]).abs() < 4.0 * (truth / m).sqrt(), "{algorithm:?} mean {i}");
            assert!((variance / truth - 1.0).abs() < 4.0 * (2.0 / m).sqrt(), "{algorithm:?} variance {i}");
        }
    }
}

#[test]
fn particles_are_drawn_from_the_start_and_samples_are_spread_over_all() {
    let mut config = config(Algorithm::Fastslam1, StoreKind::Lineage);
    config.filter.particles = 20_000;
    let mean = Pose::new(3.0, -4.0, 3.1);
    let covariance = [[0.5, 0.1, 0.02], [0.1, 0.3, -0.05], [0.02, -0.05, 0.04]];
    let mut filter = FastSlam::new(config.clone(), Identities::None).unwrap();
    filter.begin(&Beginning { landmarks: Vec::new(), start: Start::Gaussian(mean, covariance) }).unwrap();
    let found = filter.pose();
    for r in 0..3 {
        let off = [found.mean.x - mean.x, found.mean.y - mean.y, wrap_angle(found.mean.heading - mean.heading)][r];
        // 4 standard errors of a mean and of a covariance of 20,000; headings beyond ±π curve the mean a little.
        assert!(off.abs() < 4.0 * (covariance[r][r] / 20_000.0_f64).sqrt(), "{r}: {off}");
        for c in 0..3 {
            let spread = covariance[r][r] * covariance[c][c] + covariance[r][c] * covariance[r][c];
            let error = found.covariance[r][c] - covariance[r][c];
            assert!(error.abs() < 4.0 * (spread / 20_000.0_f64).sqrt(), "{r}, {c}: {error}");
        }
    }
    config.filter.particles = 9;
    let mut filter = FastSlam::new(config, Identities::None).unwrap();
    let samples = (0..3).map(|i| Pose::new(f64::from(i), 0.0, 4.0)).collect();
    filter.begin(&Beginning { landmarks: Vec::new(), start: Start::Samples(samples) }).unwrap();
    assert_eq!(filter.particles().x, [0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 2.0, 2.0, 2.0]);
    assert!(filter.particles().heading.iter().all(|h| (h - wrap_angle(4.0)).abs() < 1e-15));
}

#[test]
fn a_snapshot_holds_the_given_map() {
    for role in [Role::Fixed, Role::Prior] {
        let config = config(Algorithm::Fastslam2, StoreKind::Lineage);
        let mut filter = FastSlam::new(config.clone(), Identities::None).unwrap();
        filter.begin(&map(role, 0.1)).unwrap();
        let mut truth = Pose::default();
        for step in 0..50 {
            truth = truth.compose(Pose::new(DT_S, 0.0, 0.15 * DT_S));
            filter.predict([1.0, 0.15, 0.0], DT_S).unwrap();
            filter.update(step as f64 * DT_S, &scan(step, truth, false)).unwrap();
        }
        let mut other = FastSlam::new(config, Identities::None).unwrap();
        other.restore(&filter.save("").unwrap()).unwrap();
        assert_eq!(other.given(), filter.given());
        assert_eq!(drive(&mut other, 50), drive(&mut filter, 50));
        other.rejuvenate();
        filter.rejuvenate();
        assert_eq!(other.map(), filter.map());
    }
}

#[test]
fn a_map_or_a_start_that_makes_no_sense_is_refused_with_the_landmark() {
    let refused = |change: &dyn Fn(&mut Beginning)| {
        let mut filter = FastSlam::new(config(Algorithm::Fastslam2, StoreKind::Lineage), Identities::None).unwrap();
        let mut beginning = map(Role::Prior, 0.1);
        change(&mut beginning);
        let error = filter.begin(&beginning).unwrap_err().to_string();
        assert!(filter.given().is_empty() && filter.map().landmarks.is_empty());
        error
    };
    assert!(refused(&|b| b.landmarks[7].place.mean[0] = f64::NAN).starts_with("map.7.x_m: got NaN"));
    assert!(refused(&|b| b.landmarks[3].place.covariance.xx = 0.0).starts_with("map.3.covariance: got 0,"));
    assert!(refused(&|b| b.landmarks[2].log_odds = Some(f64::INFINITY)).starts_with("map.2.existence"));
    let twice = refused(&|b| (b.landmarks[4].identity, b.landmarks[9].identity) = (Some(1), Some(1)));
    assert!(twice.starts_with("map.9.identity: got 1, expected another identity than that of landmark 4"), "{twice}");
    assert!(refused(&|b| b.start = Start::Samples(Vec::new())).starts_with("start"));
    let indefinite = [[1.0, 2.0, 0.0], [2.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    assert!(refused(&|b| b.start = Start::Gaussian(Pose::default(), indefinite)).starts_with("start.covariance"));
    let mut begun = FastSlam::new(config(Algorithm::Fastslam2, StoreKind::Lineage), Identities::None).unwrap();
    begun.predict([1.0, 0.0, 0.0], 0.1).unwrap();
    assert!(begun.begin(&map(Role::Fixed, 0.1)).unwrap_err().to_string().contains("before the first control"));
    let ekf = Config { algorithm: Algorithm::Ekf, ..Config::default() };
    let mut ekf = slam::create(ekf, Identities::All).unwrap();
    assert!(ekf.begin(&map(Role::Fixed, 0.1)).unwrap_err().to_string().contains("EKF-SLAM cannot start"));
    assert_eq!(ekf.begin(&Beginning::default()), Ok(()));
}
