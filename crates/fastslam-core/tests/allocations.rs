//! A filter at work asks for no memory: only the path and its stamps grow, in steps.
//!
//! Not watched here, and asking for memory: the steps that look for duplicates to merge (one in eight, where merging is
//! switched on), appearance, associations other than maximum likelihood, adaptive numbers of particles, rejuvenation.

#![allow(clippy::unwrap_used)] // That is how a test fails.

use fastslam_core::config::{Algorithm, Config, Removal};
use fastslam_core::filter::{FastSlam, Identities, Sighting, StepInfo};
use fastslam_core::motion::{Increments, Motion};
use fastslam_core::resampling::ResamplingScheme;
use std::f64::consts::TAU;

const PARTICLES: u32 = 100;
/// Steps per lap of the circle.
const LAP: u32 = 60;
const LANDMARKS: u32 = 40;

/// What the robot sees at a step: it drives a circle of 10 m inside a ring of landmarks, with a sensor of 9 m.
fn scan(step: u32, identities: Identities) -> Vec<Sighting> {
    let angle = TAU * f64::from(step % LAP) / f64::from(LAP);
    let (x, y, heading) = (10.0 * angle.sin(), 10.0 - 10.0 * angle.cos(), angle);
    let see = |n: u32| {
        let around = TAU * f64::from(n) / f64::from(LANDMARKS);
        let radius = if n.is_multiple_of(2) { 15.0 } else { 6.0 };
        let (dx, dy) = (radius * around.cos() - x, 10.0 + radius * around.sin() - y);
        let identity = (identities == Identities::All).then_some(n);
        // Small errors, so that the weights differ.
        let error = f64::from((step * 7 + n * 13) % 11) / 11.0 - 0.5;
        let sighting = Sighting::range_bearing(dx.hypot(dy) + 0.1 * error, dy.atan2(dx) - heading, identity);
        (sighting.value[0] < 9.0).then_some(sighting)
    };
    (0..LANDMARKS).filter_map(see).collect()
}

/// One kind of run.
#[derive(Clone, Copy, Debug)]
struct Case {
    algorithm: Algorithm,
    identities: Identities,
    threshold: f64,
    scheme: ResamplingScheme,
    removal: Removal,
}

fn filter(case: Case) -> FastSlam {
    let Case { algorithm, identities, threshold, scheme, removal } = case;
    let mut config = Config { algorithm, seed: 2, ..Config::default() };
    config.filter.rejuvenation.every_steps = Some(0);
    config.filter.resampling.scheme = scheme;
    config.association.existence.removal = removal;
    config.sensor.change(|s| s.max_range_m = 9.0);
    config.filter.particles = PARTICLES;
    config.filter.resampling.threshold = threshold;
    config.sensor.change(|s| s.range_std_m = 0.1);
    config.sensor.change(|s| s.bearing_std_rad = 0.02);
    // Without resampling nothing holds the particles together.
    let std = if threshold == 0.0 { 1e-6 } else { 0.004 };
    config.motion = Motion::Increments(Increments {
        x_std_m: std,
        y_std_m: std,
        heading_std_rad: 0.1 * std,
        ..Increments::default()
    });
    FastSlam::new(config, identities).unwrap()
}

/// Requests for memory in each step of the last laps, with what these steps were.
fn run(case: Case) -> (Vec<u64>, u32) {
    let mut filter = filter(case);
    let turn = TAU / f64::from(LAP);
    let (mut requests, mut resampled) = (Vec::with_capacity(1000), 0);
    for step in 0..60 * LAP {
        let sightings = scan(step, case.identities);
        let mut info = StepInfo::default();
        let asked = allocation_counter::measure(|| {
            if step > 0 {
                let chord = 20.0 * (0.5 * turn).sin();
                filter.predict([chord * (0.5 * turn).cos(), chord * (0.5 * turn).sin(), turn], 0.1).unwrap();
            }
            info = filter.update(f64::from(step), &sightings).unwrap();
        });
        if step >= 30 * LAP {
            assert_eq!(info.changes.new_landmarks, 0, "{case:?}: a steady state finds nothing new");
            assert!(info.sightings >= 4);
            requests.push(asked.count_total);
            resampled += u32::from(info.weighing.resampled);
        }
    }
    (requests, resampled)
}

fn cases() -> Vec<Case> {
    let plain = Case {
        algorithm: Algorithm::Fastslam1,
        identities: Identities::All,
        threshold: 0.5,
        scheme: ResamplingScheme::Systematic,
        removal: Removal::Never,
    };
    let mut cases = Vec::new();
    for algorithm in [Algorithm::Fastslam1, Algorithm::Fastslam2] {
        for identities in [Identities::All, Identities::None] {
            let case = Case { algorithm, identities, ..plain };
            cases.extend([0.0, 0.5, 1.0].map(|threshold| Case { threshold, ..case }));
            let schemes = [ResamplingScheme::Stratified, ResamplingScheme::Residual, ResamplingScheme::Multinomial];
            cases.extend(schemes.map(|scheme| Case { scheme, ..case }));
        }
        cases.push(Case { algorithm, identities: Identities::None, removal: Removal::WhenMissed, ..plain });
    }
    cases
}

/// Requests are counted by thread, so that several tests may run at a time.
fn allocate_nothing(cases: impl Iterator<Item = Case>) {
    for case in cases {
        let (requests, resampled) = run(case);
        let steps = requests.len();
        assert_eq!(steps as u32, 30 * LAP);
        match case.threshold {
            0.0 => assert_eq!(resampled, 0, "{case:?}"),
            _ => assert!(resampled > 20, "{case:?}: {resampled} resamplings"),
        }
        // The watched steps double the length of the log, so the three vectors that grow with it by doubling
        // (stamps, nodes of the paths, list of free nodes) grow once or twice each: six requests. The store's
        // pages, a sample of sizes at random, still set a record now and then, at a rate that falls as one over
        // the steps: ln 2 expected for each of its classes of sizes, of which some twenty are in use, in one
        // or two requests each. Anything that a step asked for regularly would ask some hundred times.
        // Where nothing is ever resampled each pose of each particle stays, in pieces of 4096.
        let pieces = if case.threshold == 0.0 { steps * PARTICLES as usize / 4096 } else { 0 };
        let asking = requests.iter().filter(|asked| **asked > 0).count();
        println!("{case:?}: {asking} of {steps} steps asked for memory");
        assert!(asking <= 6 + 14 + pieces, "{case:?}: {asking} of {steps} steps asked for memory");
    }
}

/// One case in six: both algorithms, with identities and without.
fn in_six(case: usize) -> bool {
    case % 6 == 1
}

#[test]
fn a_step_in_the_steady_state_allocates_nothing() {
    let few: Vec<Case> = cases().into_iter().enumerate().filter(|(k, _)| in_six(*k)).map(|(_, case)| case).collect();
    assert_eq!(few.len(), 5);
    allocate_nothing(few.into_iter());
}

#[test]
#[ignore = "slow: make test-all runs it"]
fn a_step_in_the_steady_state_allocates_nothing_in_all_other_cases() {
    assert_eq!(cases().len(), 26);
    allocate_nothing(cases().into_iter().enumerate().filter(|(k, _)| !in_six(*k)).map(|(_, case)| case));
}

#[test]
fn a_drive_keeps_its_path_and_a_past_that_does_not_grow() {
    let (laps, keyframes) = (25, 200);
    let mut config = Config { seed: 2, ..Config::default() };
    config.filter.particles = 10;
    config.filter.rejuvenation.every_steps = Some(100);
    config.filter.rejuvenation.growth = 0.0;
    config.filter.rejuvenation.keyframes = keyframes;
    config.sensor.change(|s| (s.max_range_m, s.range_std_m, s.bearing_std_rad) = (9.0, 0.1, 0.02));
    let mut filter = FastSlam::new(config, Identities::All).unwrap();
    let turn = TAU / f64::from(LAP);
    let (mut drawn, mut step) = (0, 0);
    let mut bytes_of_laps = || {
        let mut asked = 0;
        for _ in 0..laps * LAP {
            let sightings = scan(step, Identities::All);
            asked += allocation_counter::measure(|| {
                if step > 0 {
                    let chord = 20.0 * (0.5 * turn).sin();
                    filter.predict([chord * (0.5 * turn).cos(), chord * (0.5 * turn).sin(), turn], 0.1).unwrap();
                }
                drawn += u32::from(filter.update(f64::from(step), &sightings).unwrap().sampling.rejuvenated);
            })
            .bytes_current;
            step += 1;
        }
        asked
    };
    let first = bytes_of_laps();
    let more: Vec<i64> = (0..3).map(|_| bytes_of_laps()).collect();
    println!("{first} bytes, then {more:?}, {drawn} draws");
    assert!(drawn > 40, "{drawn} draws");
    // A pose with its place in the path takes 48 bytes, and room for so many again; the past is as long as it was.
    let past = i64::from(keyframes) * 1500;
    assert!(more.iter().all(|bytes| *bytes < i64::from(laps * LAP) * 96 + past), "{more:?}");
    assert!(more.iter().sum::<i64>() < 3 * i64::from(laps * LAP) * 96 + past, "{more:?}");
}
