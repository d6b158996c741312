//! The life of landmarks: provisional and confirmed, by Bayes' rule, merged; and bad detections that must not matter.

use fastslam_core::association::Appearance;
use fastslam_core::config::{
    Classes, Config, ExistenceConfig, ExistenceForm, MergingRule, Method, Removal, Signatures,
};
use fastslam_core::filter::{FastSlam, Identities, MapLandmark, Sighting};
use fastslam_core::motion::{Increments, Motion};
use fastslam_core::random::{Purpose, RandomSource};
use std::f64::consts::FRAC_PI_6;

fn seen(range_m: f64, bearing_rad: f64) -> Sighting {
    Sighting::range_bearing(range_m, bearing_rad, None)
}

/// A robot that sees 10 m far to all sides, with everything by Bayes' rule.
fn bayes() -> Config {
    let mut config = Config { seed: 3, ..Config::default() };
    config.filter.particles = 20;
    config.motion = Motion::Increments(Increments {
        x_std_m: 0.02,
        y_std_m: 0.02,
        heading_std_rad: 0.005,
        ..Increments::default()
    });
    config.sensor.change(|s| s.max_range_m = 10.0);
    config.association.detection_probability = Some(0.8);
    config.association.clutter_density = Some(0.01);
    config.association.new_landmark_density = Some(0.001);
    config.association.existence.form = ExistenceForm::Bayes;
    config.association.existence.removal = Removal::WhenMissed;
    config
}

fn filter(config: Config) -> FastSlam {
    FastSlam::new(config, Identities::None).unwrap()
}

fn map(filter: &mut FastSlam) -> Vec<MapLandmark> {
    filter.map().landmarks
}

#[test]
fn a_landmark_is_provisional_until_it_was_sighted_often_enough() {
    for form in [ExistenceForm::Counted, ExistenceForm::Bayes] {
        let mut config = bayes();
        config.association.existence.form = form;
        config.association.existence.confirmed_sightings = 3;
        let mut filter = filter(config);
        let confirmed: Vec<bool> = (0..4)
            .map(|step| {
                filter.update(f64::from(step), &[seen(5.0, 0.3)]).unwrap();
                map(&mut filter)[0].confirmed
            })
            .collect();
        assert_eq!(confirmed, [false, false, true, true], "{form:?}");
    }
}

#[test]
fn existence_follows_bayes_rule() {
    // One particle at a known pose: from ln(0.001 / 0.01), a sighting adds ln(1 - 0.8 + 0.8 N / 0.01), N at Q = 2R;
    // a miss adds ln(1 - 0.8). The landmark is confirmed by odds alone.
    let n = 1.0 / (std::f64::consts::TAU * 2.0 * 0.1 * 0.02);
    let after_two = 0.1_f64.ln() + (0.2 + 0.8 * n / 0.01).ln();
    for (threshold, confirmed) in [(after_two - 1e-6, true), (after_two + 1e-6, false)] {
        let mut config = bayes();
        config.filter.particles = 1;
        config.association.existence.confirmed_sightings = 1;
        config.association.existence.confirmed_log_odds = threshold;
        let mut filter = filter(config);
        filter.update(0.0, &[seen(5.0, 0.3)]).unwrap();
        filter.update(1.0, &[seen(5.0, 0.3)]).unwrap();
        assert_eq!(map(&mut filter)[0].confirmed, confirmed);
    }
    // Misses: removed at 1.5 below the beginning, ln 0.2 = -1.6 each.
    let gone_after = ((after_two - 0.1_f64.ln() + 1.5) / -(0.2_f64.ln())).ceil() as usize;
    let mut config = bayes();
    config.filter.particles = 1;
    let mut filter = filter(config);
    filter.update(0.0, &[seen(5.0, 0.3), seen(4.0, -2.0)]).unwrap();
    filter.update(1.0, &[seen(5.0, 0.3), seen(4.0, -2.0)]).unwrap();
    let counts: Vec<usize> = (0..gone_after + 1)
        .map(|step| {
            filter.update(2.0 + step as f64, &[seen(4.0, -2.0)]).unwrap();
            map(&mut filter).len()
        })
        .collect();
    assert_eq!(counts.iter().position(|count| *count == 1), Some(gone_after - 1), "{counts:?}");
}

#[test]
fn a_particle_whose_map_holds_what_is_not_there_loses_weight() {
    // Poses spread by metres: some particles take the second sighting for the first landmark, others create a new one
    // and then miss the old one. With the odds of a detection the log-likelihood of a scan that shows one landmark is
    // lower by ln(1 - r 0.8) for every landmark more in view.
    let mut config = bayes();
    config.filter.particles = 1;
    config.association.existence.removal = Removal::Never;
    config.association.existence.confirmed_sightings = 1;
    let log_likelihood = |config: &Config, scans: &[Vec<Sighting>]| {
        let mut filter = filter(config.clone());
        let steps = scans.iter().enumerate();
        let increments = steps.map(|(t, scan)| filter.update(t as f64, scan).unwrap().weighing.log_likelihood);
        increments.sum::<f64>()
    };
    let (one, two) = (vec![seen(5.0, 0.3)], vec![seen(5.0, 0.3), seen(4.0, -2.0)]);
    // The last scan is empty of sightings of the second landmark, and its misses are counted in the one after it.
    let missed = vec![two.clone(), two, one.clone(), one.clone()];
    let mut without = config.clone();
    without.association.detection_probability = None;
    without.association.existence.form = ExistenceForm::Counted;
    let difference = log_likelihood(&config, &missed) - log_likelihood(&without, &missed);
    // Sighted three times after its birth: the first landmark pays r P_D each time, r near 1 but for the first.
    let r0 = 1.0 / 11.0;
    let odds = |r: f64| (0.8 * r / (1.0 - 0.8 * r)).ln();
    let miss = |r: f64| (1.0 - 0.8 * r).ln();
    // Scan 2: both gain their odds and pay their miss; scan 3: one does, the other pays; scan 4: one gains, the payment
    // of scan 4 itself comes later.
    let expected = 2.0 * (odds(r0) + miss(r0)) + odds(1.0) + 2.0 * miss(1.0) + odds(1.0);
    assert!((difference - expected).abs() < 0.01, "{difference} against {expected}");
}

#[test]
fn a_told_probability_of_detection_weighs_nothing_where_it_is_learned_from_where() {
    let mut config = bayes();
    config.association.existence = ExistenceConfig::default();
    let run = |detection_probability| {
        let mut config = config.clone();
        config.association.detection_probability = detection_probability;
        let mut filter = filter(config);
        // What is far off is never seen again, as behind a hedge.
        filter.update(0.0, &[seen(5.0, 0.3), seen(7.0, -2.0)]).unwrap();
        let steps = (1..40).map(|t| filter.update(f64::from(t), &[seen(5.0, 0.3)]).unwrap().weighing.log_likelihood);
        steps.map(f64::to_bits).collect::<Vec<u64>>()
    };
    assert_eq!(run(None), run(Some(0.9)));
}

/// Twelve landmarks in a ring of 4 m around the robot, which turns on the spot; every third scan holds sightings of
/// things that are not there, some of them close to landmarks and some absurd.
fn drive_with_wild_detections(config: Config, wild: bool) -> (Vec<MapLandmark>, [f64; 2]) {
    let landmarks: Vec<[f64; 2]> =
        (0..12).map(|k| (f64::from(k) * FRAC_PI_6, 3.0 + f64::from(k % 3))).map(|(b, r)| [r, b]).collect();
    let mut filter = filter(config);
    let mut heading = 0.0;
    for step in 0..120_u32 {
        let stream = RandomSource::new(11).stream(Purpose::Simulation, u64::from(step));
        let mut scan: Vec<Sighting> = Vec::new();
        for (k, [range, bearing]) in landmarks.iter().enumerate() {
            let [a, b] = stream.normal_pair(k as u32, 0);
            if stream.uniform(k as u32, 1) < 0.8 {
                scan.push(seen(range + 0.1 * a, bearing - heading + 0.02 * b));
            }
        }
        if wild && step % 3 == 0 {
            let [u, v] = stream.uniform_pair(100, 0);
            scan.push(seen(0.5 + 9.0 * u, std::f64::consts::TAU * v));
            scan.push(seen(landmarks[5][0] + 0.5, landmarks[5][1] - heading + 0.1));
            scan.push(seen(9.99, 3.0 * v));
            scan.push(seen(f64::NAN, 1.0));
        }
        filter.update(f64::from(step), &scan).unwrap();
        filter.predict([0.0, 0.0, 0.05], 1.0).unwrap();
        heading += 0.05;
    }
    let pose = filter.pose().mean;
    (map(&mut filter).into_iter().filter(|l| l.confirmed).collect(), [pose.x, pose.y])
}

#[test]
fn bad_detections_never_poison_the_map() {
    for method in [Method::MaximumLikelihood, Method::Sampled, Method::Assignment] {
        let mut config = bayes();
        config.association.method = method;
        let (clean, _) = drive_with_wild_detections(config.clone(), false);
        assert_eq!(clean.len(), 12, "{method:?}");
        let (map, pose) = drive_with_wild_detections(config, true);
        for k in 0..12 {
            let (bearing, range) = (f64::from(k) * FRAC_PI_6, 3.0 + f64::from(k % 3));
            let place = [range * bearing.cos(), range * bearing.sin()];
            let nearest =
                map.iter().map(|l| (l.mean[0] - place[0]).hypot(l.mean[1] - place[1])).fold(f64::MAX, f64::min);
            assert!(nearest < 0.3, "{method:?}: landmark {k} is {nearest} m off");
        }
        // The detection that repeats itself beside landmark 5 every third scan is the one that may be believed.
        assert!(map.len() <= 13, "{method:?}: {} landmarks are confirmed, 12 are there", map.len());
        assert!(pose[0].hypot(pose[1]) < 0.2, "{method:?}: {pose:?}");
    }
}

#[test]
fn two_landmarks_of_one_map_that_are_never_seen_together_become_one() {
    // A landmark is seen, then again 0.55 m farther for a while (a new one, far outside the gates).
    let run = |rule: MergingRule, together: bool| {
        let mut config = bayes();
        config.association.merging.rule = rule;
        config.association.merging.tolerance_std_m = 0.3;
        config.association.existence.removal = Removal::Never;
        let mut filter = filter(config);
        let mut merged = 0;
        for step in 0..40 {
            let (near, far) = (seen(5.0, 0.3), seen(5.55, 0.3));
            let scan = match (step < 10, together) {
                (true, true) => vec![near, far],
                (true, false) => vec![near],
                (false, _) => vec![far],
            };
            merged += filter.update(f64::from(step), &scan).unwrap().changes.merged;
        }
        (map(&mut filter), merged)
    };
    let (map, merged) = run(MergingRule::Never, false);
    assert_eq!((map.len(), merged), (2, 0));
    let (map, merged) = run(MergingRule::Nearby, true);
    assert_eq!((map.len(), merged), (2, 0), "seen together, they are two things");
    let (map, merged) = run(MergingRule::Nearby, false);
    assert_eq!((map.len(), merged), (1, 1));
    assert_eq!(map[0].sightings, 40);
    // Between the two places, nearer to the one seen more often.
    let range = map[0].mean[0].hypot(map[0].mean[1]);
    assert!(range > 5.2 && range < 5.55, "{range}");
}

#[test]
fn merging_what_different_particles_created_changes_no_particle() {
    let run = |rule: MergingRule| {
        let mut config = bayes();
        config.filter.particles = 40;
        config.filter.resampling.threshold = 0.0;
        config.association.existence.removal = Removal::Never;
        config.motion = Motion::Increments(Increments {
            x_std_m: 0.4,
            y_std_m: 0.4,
            heading_std_rad: 0.0,
            ..Increments::default()
        });
        config.algorithm = fastslam_core::config::Algorithm::Fastslam1;
        config.association.merging.rule = rule;
        let mut filter = filter(config);
        // Nothing can be fused here: the second landmark is a new one for some particles and the first for others.
        filter.update(0.0, &[seen(5.0, 0.3)]).unwrap();
        filter.predict([0.0; 3], 1.0).unwrap();
        let mut infos = Vec::new();
        for step in 1..9 {
            infos.push(filter.update(f64::from(step), &[seen(5.0, 0.3)]).unwrap().weighing.log_likelihood.to_bits());
        }
        let maps: Vec<Vec<_>> = (0..40)
            .map(|i| {
                let mut map: Vec<[u64; 2]> = filter.map_of(i).iter().map(|l| l.1.map(f64::to_bits)).collect();
                map.sort_unstable();
                map
            })
            .collect();
        (maps, infos, filter.store_usage().rows)
    };
    let (apart, once) = (run(MergingRule::Never), run(MergingRule::Nearby));
    assert_eq!((&apart.0, &apart.1), (&once.0, &once.1));
    assert!(apart.0.iter().any(|map| map.len() == 2) && apart.0.iter().any(|map| map.len() == 1));
}

#[test]
fn a_class_decides_between_two_landmarks_that_stand_too_close_for_the_sensor() {
    let look = |class: u32, signature: f64| Appearance { class: Some(class), signature: Some(signature) };
    let run = |classes: bool, signatures: bool| {
        let mut config = bayes();
        config.filter.particles = 1;
        config.association.classes = classes.then_some(Classes { number: 2, correct_probability: 0.95 });
        config.association.signatures = signatures.then_some(Signatures { std: 0.05, spread: 1.0 });
        let mut filter = filter(config);
        let left = |at: f64| Sighting { appearance: look(0, 0.3), ..seen(at, 0.3) };
        let right = |at: f64| Sighting { appearance: look(1, 0.6), ..seen(at, 0.3) };
        for step in 0..10 {
            filter.update(f64::from(step), &[left(5.0), right(5.3)]).unwrap();
        }
        // Now each alone, 0.2 m nearer to where the other stands.
        for step in 10..20 {
            let scan = if step % 2 == 0 { left(5.2) } else { right(5.1) };
            filter.update(f64::from(step), &[scan]).unwrap();
        }
        map(&mut filter)
    };
    let blind = run(false, false);
    let ranges: Vec<f64> = blind.iter().map(|l| l.mean[0].hypot(l.mean[1])).collect();
    assert!(ranges[0] < 5.07 && ranges[1] > 5.25, "by place alone they keep apart, wrongly: {ranges:?}");
    assert!(blind.iter().all(|l| l.appearance == Appearance::default()));
    for (classes, signatures) in [(true, false), (false, true), (true, true)] {
        let map = run(classes, signatures);
        assert_eq!(map.iter().map(|l| l.sightings).collect::<Vec<_>>(), [15, 15]);
        let ranges: Vec<f64> = map.iter().map(|l| l.mean[0].hypot(l.mean[1])).collect();
        // Means of ten sightings at 5.0 and five at 5.2, and of ten at 5.3 and five at 5.1.
        assert!((ranges[0] - 5.0667).abs() < 0.01 && (ranges[1] - 5.2333).abs() < 0.01, "{ranges:?}");
        assert_eq!(map[0].appearance.class, classes.then_some(0));
        assert_eq!(map[1].appearance.class, classes.then_some(1));
        let measured = map[1].appearance.signature;
        assert_eq!(measured.is_some(), signatures);
        assert!(measured.is_none_or(|value| (value - 0.6).abs() < 1e-9));
    }
}

#[test]
fn a_class_beyond_those_configured_is_an_error() {
    let mut config = bayes();
    config.association.classes = Some(Classes { number: 2, correct_probability: 0.95 });
    let strange = Sighting { appearance: Appearance { class: Some(2), signature: None }, ..seen(5.0, 0.3) };
    let message = filter(config).update(0.0, &[strange]).unwrap_err().to_string();
    assert!(message.contains("class 2 of a sighting: expected 0 to 1 (association.classes.number)"), "{message}");
}

#[test]
fn impossible_settings_are_refused_by_name() {
    let message = |change: fn(&mut Config)| {
        let mut config = bayes();
        change(&mut config);
        config.validate().unwrap_err().to_string()
    };
    assert!(message(|c| c.association.detection_probability = None).starts_with("association.detection_probability"));
    assert!(message(|c| c.association.clutter_density = Some(0.0)).starts_with("association.clutter_density"));
    assert!(message(|c| c.association.detection_probability = Some(1.0)).contains("got 1, expected above 0, below 1"));
    let ekf = message(|c| {
        *c = Config { algorithm: fastslam_core::config::Algorithm::Ekf, ..Config::default() };
        c.association.method = Method::Joint;
    });
    assert!(ekf.starts_with("association.method: got joint"), "{ekf}");
}
