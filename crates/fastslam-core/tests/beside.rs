//! Drawing paths beside the filter: what comes of it is what comes of drawing in place, some scans later.

use crate::blind::Blind;
use crate::rejuvenation::{two_laps, world};
use fastslam_core::config::{Algorithm, Config};
use fastslam_core::geometry::Pose;
use fastslam_core::run::{run, RunOutput};
use fastslam_core::timeline::LogData;

/// Numbers of the steps that told of a draw.
fn draws(output: &RunOutput) -> Vec<u64> {
    output.steps.iter().filter(|step| step.info.sampling.rejuvenated).map(|step| step.info.step).collect()
}

fn poses(output: &RunOutput) -> Vec<Pose> {
    output.steps.iter().map(|step| step.pose.mean).collect()
}

fn evidence(output: &RunOutput) -> f64 {
    output.steps.iter().map(|step| step.info.weighing.log_likelihood).sum()
}

/// Worlds in which paths are drawn by need and by a schedule, with and without names.
fn worlds() -> Vec<(&'static str, LogData, Config)> {
    let mut worlds = Vec::new();
    for (name, identities) in [("names", fastslam_sim::Identities::All), ("no names", fastslam_sim::Identities::None)] {
        for algorithm in [Algorithm::Fastslam1, Algorithm::Fastslam2] {
            let (log, mut config, _) = world("demo", 3, 28.0, identities);
            config.algorithm = algorithm;
            (config.filter.particles, config.filter.rejuvenation.every_steps) = (20, Some(30));
            worlds.push((name, log, config));
        }
    }
    let (log, config, _) = two_laps(2);
    let mut short = config.clone();
    short.filter.rejuvenation.keyframes = 300;
    worlds.extend([("by need", log.clone(), config), ("by need, of a short past", log, short)]);
    worlds
}

#[test]
#[ignore = "slow: make test-all runs it"]
fn map_and_smoothed_path_are_to_the_bit_those_of_drawing_in_place() {
    let (mut cases, mut held_back, mut told) = (0, 0, 0);
    for (name, log, mut config) in worlds() {
        let in_place = run(&config, &log, &mut Blind).unwrap();
        let at = draws(&in_place);
        assert!(at.len() >= 2, "{name}: draws at {at:?}");
        for delay_scans in [1, 7, 25] {
            config.filter.rejuvenation.delay_scans = delay_scans;
            let beside = run(&config, &log, &mut Blind).unwrap();
            let case = format!("{name} {:?} {delay_scans}", config.algorithm);
            assert_eq!(in_place.map, beside.map, "{case}");
            assert_eq!(in_place.smoothed, beside.smoothed, "{case}");
            // What the end of the log takes over no step tells of.
            let differs = (evidence(&in_place) - evidence(&beside)).abs();
            told += u32::from(differs < 1e-9 * evidence(&in_place).abs());
            // Until the first draw both are one filter; what it gives is late by the delay, or a multiple of that.
            let (first, taken_over, delay) = (at[0] as usize, draws(&beside)[0] as usize, delay_scans as usize);
            assert!(taken_over > first && (taken_over - first).is_multiple_of(delay), "{case}: {first} {taken_over}");
            assert_eq!(poses(&in_place)[..first], poses(&beside)[..first], "{case}");
            held_back += u32::from(poses(&in_place)[first..taken_over] != poses(&beside)[first..taken_over]);
            cases += 1;
        }
    }
    assert_eq!((cases, held_back), (18, 18));
    // All but those of the longest delay by a schedule, whose last draw the end of the log takes over.
    assert_eq!(told, 14);
}

#[test]
fn neither_threads_nor_their_haste_change_a_bit() {
    let (log, mut config, _) = two_laps(2);
    config.filter.rejuvenation.delay_scans = 5;
    let reference = run(&config, &log, &mut Blind).unwrap();
    assert!(draws(&reference).len() >= 2);
    for threads in [1, 3] {
        config.filter.threads = threads;
        let other = run(&config, &log, &mut Blind).unwrap();
        assert_eq!((&reference.steps, &reference.map), (&other.steps, &other.map), "{threads}");
    }
}
