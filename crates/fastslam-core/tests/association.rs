//! Which landmark a sighting belongs to: cases with known answers, and the spatial index against looking at every
//! landmark.

use fastslam_core::association::Belief;
use fastslam_core::config::{Algorithm, AssociationOrder, Config, Exclusion, Removal};
use fastslam_core::filter::{FastSlam, Identities, MapLandmark, Sighting};
use fastslam_core::geometry::Symmetric2;
use fastslam_core::landmark::{Fit, Gaussian, Measured};
use fastslam_core::measurement::Placing;
use fastslam_core::motion::{Increments, Motion};
use fastslam_core::random::{Purpose, RandomSource};
use std::f64::consts::PI;

const ALGORITHMS: [Algorithm; 2] = [Algorithm::Fastslam1, Algorithm::Fastslam2];

fn config(algorithm: Algorithm, particles: u32) -> Config {
    let mut config = Config { algorithm, seed: 1, ..Config::default() };
    config.filter.particles = particles;
    config.sensor.change(|s| s.range_std_m = 0.1);
    config.sensor.change(|s| s.bearing_std_rad = 0.02);
    config
}

fn filter(algorithm: Algorithm, identities: Identities) -> FastSlam {
    FastSlam::new(config(algorithm, 1), identities).unwrap()
}

fn unlabelled(range_m: f64, bearing_rad: f64) -> Sighting {
    Sighting::range_bearing(range_m, bearing_rad, None)
}

fn labelled(range_m: f64, bearing_rad: f64, identity: u32) -> Sighting {
    Sighting::range_bearing(range_m, bearing_rad, Some(identity))
}

fn map(filter: &mut FastSlam) -> Vec<MapLandmark> {
    filter.map().landmarks
}

#[test]
fn two_close_landmarks_stay_two_in_either_order_of_sighting() {
    // 0.8 m apart across the view at 5 m: 0.16 rad, eight standard deviations of a bearing.
    let (left, right) = (unlabelled(5.0, 0.08), unlabelled(5.1, -0.08));
    for algorithm in ALGORITHMS {
        for order in [AssociationOrder::Given, AssociationOrder::LeastAmbiguousFirst] {
            let mut config = config(algorithm, 1);
            config.association.order = order;
            let mut filter = FastSlam::new(config, Identities::None).unwrap();
            assert_eq!(filter.update(0.0, &[left, right]).unwrap().changes.new_landmarks, 2);
            for step in 0..6 {
                let scan = if step % 2 == 0 { [right, left] } else { [left, right] };
                let info = filter.update(1.0 + f64::from(step), &scan).unwrap();
                assert_eq!(
                    (info.changes.new_landmarks, info.left_out.ignored),
                    (0, 0),
                    "{algorithm:?} {order:?} step {step}"
                );
            }
            let map = map(&mut filter);
            assert_eq!(map.iter().map(|l| l.sightings).collect::<Vec<_>>(), [7, 7]);
            // Every sighting of a landmark is the same, so the map holds exactly what was seen.
            for (landmark, seen) in map.iter().zip([left, right]) {
                let [range, bearing] = seen.value;
                let position = [range * bearing.cos(), range * bearing.sin()];
                assert!((0..2).all(|axis| (landmark.mean[axis] - position[axis]).abs() < 1e-9), "{landmark:?}");
            }
        }
    }
}

/// After one sighting from a known pose a landmark is as uncertain as the sighting, so Q = 2R and a second sighting
/// that is off by δ in range has δ² / 2σ².
fn offset_m(mahalanobis_squared: f64) -> f64 {
    (2.0 * mahalanobis_squared).sqrt() * 0.1
}

#[test]
fn between_the_gates_a_sighting_is_ignored_and_beyond_them_it_is_new() {
    // χ² with two degrees of freedom: 9.21 at 0.99, 23.03 at 0.99999; the density of a new landmark is that of Q = 2R
    // at the outer gate, which is the case here.
    let cases = [(9.1, (0, 0, 2)), (9.3, (0, 1, 1)), (22.9, (0, 1, 1)), (23.2, (1, 0, 1))];
    for algorithm in ALGORITHMS {
        for (mahalanobis_squared, expected) in cases {
            let mut filter = filter(algorithm, Identities::None);
            filter.update(0.0, &[unlabelled(5.0, 0.3)]).unwrap();
            let before = map(&mut filter);
            let info = filter.update(1.0, &[unlabelled(5.0 + offset_m(mahalanobis_squared), 0.3)]).unwrap();
            let after = map(&mut filter);
            let got = (info.changes.new_landmarks, info.left_out.ignored, after[0].sightings);
            assert_eq!(got, expected, "{algorithm:?} at {mahalanobis_squared}");
            if expected.2 == 1 {
                assert_eq!(before[0], after[0], "an ignored sighting changed the landmark");
            }
        }
    }
}

#[test]
fn the_gates_hold_the_same_sightings_with_a_heavy_tail() {
    // The gates are distances; a density with heavy tails is higher far off, and so is that of a new landmark.
    for (mahalanobis_squared, expected) in [(9.1, (0, 0)), (9.3, (0, 1)), (22.9, (0, 1)), (23.2, (1, 0))] {
        let mut config = config(Algorithm::Fastslam2, 1);
        config.sensor.change(|s| s.tail_degrees_of_freedom = Some(4.0));
        let mut filter = FastSlam::new(config, Identities::None).unwrap();
        filter.update(0.0, &[unlabelled(5.0, 0.3)]).unwrap();
        let info = filter.update(1.0, &[unlabelled(5.0 + offset_m(mahalanobis_squared), 0.3)]).unwrap();
        assert_eq!((info.changes.new_landmarks, info.left_out.ignored), expected, "at {mahalanobis_squared}");
    }
}

#[test]
fn the_paper_s_constant_decides_when_the_gates_are_open() {
    // Two dimensions, Q = 2R: the density at d² is exp(-d²/2) / (2π · 2 · 0.1 · 0.02).
    let density = |d2: f64| (-0.5 * d2).exp() / (2.0 * PI * 2.0 * 0.1 * 0.02);
    for algorithm in ALGORITHMS {
        for (factor, new) in [(0.99, 0), (1.01, 1)] {
            let mut config = config(algorithm, 1);
            config.association.gate_probability = 1.0;
            config.association.new_landmark_density = Some(factor * density(12.0));
            let mut filter = FastSlam::new(config, Identities::None).unwrap();
            filter.update(0.0, &[unlabelled(5.0, 0.3)]).unwrap();
            let info = filter.update(1.0, &[unlabelled(5.0 + offset_m(12.0), 0.3)]).unwrap();
            assert_eq!((info.changes.new_landmarks, info.left_out.ignored), (new, 0), "{algorithm:?} factor {factor}");
        }
    }
}

#[test]
fn a_landmark_explains_at_most_one_sighting_of_a_scan_unless_told_otherwise() {
    for algorithm in ALGORITHMS {
        for (exclusion, new, sightings) in [(Exclusion::OneSighting, 1, vec![2, 1]), (Exclusion::None, 0, vec![3])] {
            let mut config = config(algorithm, 1);
            config.association.exclusion = exclusion;
            let mut filter = FastSlam::new(config, Identities::None).unwrap();
            filter.update(0.0, &[unlabelled(5.0, 0.3)]).unwrap();
            let info = filter.update(1.0, &[unlabelled(5.02, 0.3), unlabelled(5.05, 0.31)]).unwrap();
            assert_eq!(info.changes.new_landmarks, new, "{algorithm:?} {exclusion:?}");
            assert_eq!(map(&mut filter).iter().map(|l| l.sightings).collect::<Vec<_>>(), sightings);
        }
    }
}

#[test]
fn labels_and_places_agree_on_one_landmark() {
    for algorithm in ALGORITHMS {
        let mut filter = filter(algorithm, Identities::Some);
        filter.update(0.0, &[unlabelled(5.0, 0.3)]).unwrap();
        assert_eq!(map(&mut filter)[0].identity, None);
        // A label binds to the landmark that stands there.
        filter.update(1.0, &[labelled(5.05, 0.3, 7)]).unwrap();
        let now = map(&mut filter);
        assert_eq!((now.len(), now[0].identity, now[0].sightings), (1, Some(7), 2), "{algorithm:?}");
        // A sighting without a label belongs to the labelled landmark that stands there.
        filter.update(2.0, &[unlabelled(4.95, 0.3)]).unwrap();
        let now = map(&mut filter);
        assert_eq!((now.len(), now[0].identity, now[0].sightings), (1, Some(7), 3), "{algorithm:?}");
        // Another label at the same place is another landmark.
        filter.update(3.0, &[labelled(5.0, 0.3, 8)]).unwrap();
        let now = map(&mut filter);
        let identities: Vec<_> = now.iter().map(|l| l.identity).collect();
        assert_eq!(identities, [Some(7), Some(8)], "{algorithm:?}");
        // A label is believed however far off the landmark is.
        filter.update(4.0, &[labelled(5.0 + offset_m(100.0), 0.3, 7)]).unwrap();
        assert_eq!(map(&mut filter).iter().map(|l| l.sightings).collect::<Vec<_>>(), [4, 1], "{algorithm:?}");
    }
}

#[test]
fn the_largest_identity_is_returned_as_it_was_given() {
    let mut filter = filter(Algorithm::Fastslam2, Identities::Some);
    filter.update(0.0, &[labelled(5.0, 0.3, u32::MAX), unlabelled(5.0, 1.3)]).unwrap();
    let identities: Vec<_> = map(&mut filter).iter().map(|l| l.identity).collect();
    assert_eq!(identities, [Some(u32::MAX), None]);
}

#[test]
fn every_particle_binds_a_label_for_itself() {
    // Poses spread by 2 m along x: particles that stand right bind the label to the landmark seen before, those that
    // stand wrong make a new one. Nothing is resampled, so particle i stays particle i.
    let mut config = config(Algorithm::Fastslam1, 60);
    config.motion =
        Motion::Increments(Increments { x_std_m: 2.0, y_std_m: 0.0, heading_std_rad: 0.0, ..Increments::default() });
    config.filter.resampling.threshold = 0.0;
    let mut filter = FastSlam::new(config, Identities::Some).unwrap();
    filter.update(0.0, &[unlabelled(5.0, 0.0)]).unwrap();
    filter.predict([0.0; 3], 1.0).unwrap();
    filter.update(1.0, &[labelled(5.0, 0.0, 7)]).unwrap();
    let before: Vec<_> = (0..60).map(|i| filter.map_of(i)).collect();
    let info = filter.update(2.0, &[labelled(5.0, 0.0, 7)]).unwrap();
    assert_eq!((info.changes.new_landmarks, info.weighing.resampled), (0, false));
    let (mut bound, mut created) = (0, 0);
    for (i, before) in before.iter().enumerate() {
        let after = filter.map_of(i);
        assert_eq!(before.len(), after.len(), "particle {i}");
        let narrowed: Vec<bool> = before.iter().zip(&after).map(|(b, a)| a.2.xx < b.2.xx).collect();
        match narrowed[..] {
            // One landmark: the one that bears the label in this particle was corrected again; or the label's sighting
            // fell between the gates before and binds now that somebody says so.
            [true] => bound += 1,
            // Two: only the labelled one was corrected.
            [false, true] => created += 1,
            _ => assert_eq!(narrowed, [false], "particle {i}: {before:?} then {after:?}"),
        }
    }
    assert!(bound > 5 && created > 20, "{bound} bound, {created} created");
}

#[test]
fn landmarks_behind_the_robot_are_not_duplicated() {
    // Bearings on both sides of ±π and beyond ±π/2, seen while the robot drives away.
    let landmarks = [[-4.0, 0.0], [-3.0, 2.0], [-3.0, -2.0], [-0.5, 3.0], [-0.5, -3.0]];
    for algorithm in ALGORITHMS {
        let mut config = config(algorithm, 10);
        config.motion = Motion::Increments(Increments {
            x_std_m: 0.02,
            y_std_m: 0.02,
            heading_std_rad: 0.005,
            ..Increments::default()
        });
        let mut filter = FastSlam::new(config, Identities::None).unwrap();
        let (mut x, mut behind, mut crossings) = (0.0, 0, [0, 0]);
        for step in 0..20_u32 {
            let stream = RandomSource::new(5).stream(Purpose::Simulation, u64::from(step));
            let scan = std::array::from_fn::<_, 5, _>(|n| {
                let [dx, dy] = [landmarks[n][0] - x, landmarks[n][1]];
                let [a, b] = stream.normal_pair(n as u32, 0);
                let bearing = f64::atan2(dy, dx) + 0.02 * b;
                // As a sensor reports it: in (-π, π].
                let bearing = f64::atan2(bearing.sin(), bearing.cos());
                behind += u32::from(bearing.abs() > PI / 2.0);
                crossings[usize::from(bearing > 0.0)] += u32::from(n == 0);
                unlabelled(f64::hypot(dx, dy) + 0.1 * a, bearing)
            });
            let info = filter.update(f64::from(step), &scan).unwrap();
            assert_eq!(info.changes.new_landmarks, if step == 0 { 5 } else { 0 }, "{algorithm:?} step {step}");
            filter.predict([0.2, 0.0, 0.0], 1.0).unwrap();
            x += 0.2;
        }
        assert!(behind == 100 && crossings.iter().all(|count| *count > 3), "{behind} behind, {crossings:?} at π");
        assert_eq!(map(&mut filter).len(), 5, "{algorithm:?}");
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Decided {
    /// The landmark born as this number.
    Landmark(u64),
    New,
    Ignored,
}

/// What one particle should decide about a single sighting, by looking at every landmark of its map.
fn by_looking_at_all(filter: &FastSlam, particle: usize, sighting: Sighting, log_new_density: f64) -> Decided {
    let config = filter.config();
    let gate = -2.0 * (1.0 - config.association.gate_probability).ln();
    let model = config.sensor.range_bearing().unwrap();
    let pending = filter.pending_motion();
    let pose = filter.particles().pose(particle);
    let belief = Belief { mean: pose.compose(pending.mean), covariance: pending.covariance_in_world(pose.heading) };
    let measured = Measured {
        value: sighting.value,
        noise: sighting.noise.unwrap_or(model.noise_covariance()),
        tail: config.sensor.tail(),
    };
    let fits = filter.map_of(particle).into_iter().map(|(birth, mean, covariance)| {
        let landmark = Gaussian { mean, covariance };
        (birth, belief.clone().refine(&model, config.sensor.T_robot_sensor(), &landmark, &measured))
    });
    let best: Option<(u64, Fit)> = fits.max_by(|a, b| a.1.log_likelihood.total_cmp(&b.1.log_likelihood));
    match best {
        Some((_, fit)) if fit.log_likelihood < log_new_density => Decided::New,
        Some((birth, fit)) if fit.mahalanobis_squared <= gate => Decided::Landmark(birth),
        Some(_) => Decided::Ignored,
        None => Decided::New,
    }
}

fn count_as(decided: Decided) -> usize {
    match decided {
        Decided::Landmark(_) => 0,
        Decided::New => 1,
        Decided::Ignored => 2,
    }
}

/// What the filter decided, from how its map changed.
fn decided(before: &[(u64, [f64; 2], Symmetric2)], after: &[(u64, [f64; 2], Symmetric2)]) -> Decided {
    if after.len() > before.len() {
        return Decided::New;
    }
    match before.iter().zip(after).find(|(b, a)| b != a) {
        Some((b, _)) => Decided::Landmark(b.0),
        None => Decided::Ignored,
    }
}

/// Random single sightings among landmarks of very different uncertainty; returns how often each decision was taken.
fn compare_with_brute_force(mut config: Config, own_noise: bool) -> [u32; 3] {
    let density = 1e-4;
    config.association.new_landmark_density = Some(density);
    config.association.existence.removal = Removal::Never;
    // Where paths are drawn anew, ambiguous landmarks are left to the draws.
    config.filter.rejuvenation.every_steps = Some(0);
    config.motion =
        Motion::Increments(Increments { x_std_m: 0.1, y_std_m: 0.05, heading_std_rad: 0.02, ..Increments::default() });
    config.sensor.change(|s| s.mounting.x_m = 0.6);
    let mut filter = FastSlam::new(config, Identities::None).unwrap();
    let mut seen = [0; 3];
    for step in 0..600_u32 {
        let stream = RandomSource::new(9).stream(Purpose::Simulation, u64::from(step));
        let [u, v] = stream.uniform_pair(0, 0);
        let [forward, turn] = stream.uniform_pair(0, 1);
        filter.predict([2.0 * forward - 1.0, 0.0, turn - 0.5], 1.0).unwrap();
        let mut sighting = unlabelled(0.3 + 12.0 * u, 2.0 * PI * (v - 0.5));
        if own_noise {
            let scale = 10.0_f64.powf(4.0 * stream.uniform(0, 2) - 2.0);
            sighting.noise = Some(Symmetric2::new(0.01 * scale, 0.0, 4e-4 * scale));
        }
        let expected = by_looking_at_all(&filter, 0, sighting, density.ln());
        let before = filter.map_of(0);
        filter.update(f64::from(step), &[sighting]).unwrap();
        let got = decided(&before, &filter.map_of(0));
        assert_eq!(got, expected, "step {step} with {} landmarks, {sighting:?}", before.len());
        seen[count_as(got)] += 1;
    }
    seen
}

#[test]
fn the_spatial_index_hides_no_landmark_that_would_have_been_chosen() {
    let mut cases = 0;
    for algorithm in ALGORITHMS {
        for tail in [None, Some(4.0)] {
            for own_noise in [false, true] {
                let mut config = config(algorithm, 1);
                config.sensor.change(|s| s.range_std_m = 0.3);
                config.sensor.change(|s| s.bearing_std_rad = 0.08);
                config.sensor.change(|s| s.tail_degrees_of_freedom = tail);
                let seen = compare_with_brute_force(config, own_noise);
                println!("{algorithm:?} {tail:?} own noise {own_noise}: {seen:?}");
                assert!(seen.iter().all(|count| *count >= 15), "{algorithm:?} {tail:?} {own_noise}: {seen:?}");
                cases += 1;
            }
        }
    }
    assert_eq!(cases, 8);
}

#[test]
fn decisions_follow_their_particles_through_resampling() {
    // Poses spread by 2 m, so that particles decide differently; then the step itself resamples. In FastSLAM 1.0 a
    // position names the ancestor.
    // A quarter of the density at the middle of the landmark, so that new ones survive beside it.
    let density = 2.0;
    let mut config = config(Algorithm::Fastslam1, 60);
    config.motion =
        Motion::Increments(Increments { x_std_m: 2.0, y_std_m: 0.0, heading_std_rad: 0.0, ..Increments::default() });
    config.filter.resampling.threshold = 1.0;
    config.sensor.change(|s| s.range_std_m = 0.5);
    config.association.new_landmark_density = Some(density);
    let mut filter = FastSlam::new(config, Identities::None).unwrap();
    filter.update(0.0, &[unlabelled(5.0, 0.0)]).unwrap();
    filter.predict([0.0; 3], 1.0).unwrap();
    let sighting = unlabelled(5.0, 0.0);
    let before: Vec<_> = (0..60)
        .map(|i| (filter.particles().x[i], filter.map_of(i), by_looking_at_all(&filter, i, sighting, density.ln())))
        .collect();
    assert!(filter.update(1.0, &[sighting]).unwrap().weighing.resampled);
    let mut seen = [0; 3];
    for i in 0..60 {
        let x = filter.particles().x[i];
        let (_, map, expected) = before.iter().find(|(before, ..)| *before == x).expect("an ancestor");
        let got = decided(map, &filter.map_of(i));
        assert_eq!(got, *expected, "particle {i}");
        seen[count_as(got)] += 1;
    }
    println!("{seen:?}");
    assert!(seen[0] >= 5 && seen[1] >= 5, "landmark, new, ignored: {seen:?}");
}
