//! What threads bring: whole steps with many particles and known association, one filter per number of threads, all on
//! the same sightings and one after the other within each step, so that other processes of the machine slow all.
//!
//! `cargo bench -p fastslam-core --bench threads [-- PARTICLES]` (100,000 if nothing is said; about seven sightings a
//! step).

#![allow(clippy::expect_used, missing_docs)] // A benchmark that cannot run says so by failing.

use fastslam_core::config::{Algorithm, Config};
use fastslam_core::filter::{FastSlam, Identities, Sighting};
use fastslam_core::timeline::{Event, LogData, Timeline};
use fastslam_sim::{simulate, SimulationConfig};
use std::time::Instant;

const THREADS: [u32; 2] = [1, 2];
/// Steps at the beginning, in which the world is mapped.
const MAPPING: usize = 80;
const STEPS: usize = 160;

fn main() {
    let particles = argument().unwrap_or(100_000);
    let preset = SimulationConfig::preset("headline").expect("a preset");
    let mut simulation = preset.with_landmarks(100).expect("a world of any size");
    simulation.sensor.max_range_m = 8.5;
    let simulated = simulate(&simulation).expect("a valid simulation");
    let seen = &simulated.sightings;
    let sighting =
        |i: usize| Sighting::range_bearing(seen.range_m[i], seen.bearing_rad[i], u32::try_from(seen.identity[i]).ok());
    let log = LogData {
        control_stamps_s: simulated.control_stamp_s.clone(),
        controls: simulated.controls.clone(),
        sighting_stamps_s: seen.stamp_s.clone(),
        sightings: (0..seen.len()).map(sighting).collect(),
    };
    let mut config = Config { motion: simulated.motion.clone(), sensor: simulated.sensor.clone(), ..Config::default() };
    config.filter.particles = particles;
    println!("M = {particles}");
    for algorithm in [Algorithm::Fastslam1, Algorithm::Fastslam2] {
        config.algorithm = algorithm;
        compare(&config, &log);
    }
}

/// The size that was asked for.
fn argument() -> Option<u32> {
    let quick = std::env::args().any(|argument| argument == "--quick");
    std::env::args().filter_map(|argument| argument.parse().ok()).next().or(quick.then_some(10_000))
}

/// Runs the filters over the log and prints what their steps took.
fn compare(config: &Config, log: &LogData) {
    let mut filters = THREADS.map(|threads| {
        let mut config = config.clone();
        config.filter.threads = threads;
        FastSlam::new(config, Identities::All).expect("a valid configuration")
    });
    let mut spent_ms = [0.0; THREADS.len()];
    let (mut done, mut sightings) = (0, 0);
    let mut steps: Vec<[f64; THREADS.len()]> = Vec::new();
    for event in Timeline::new(log, config.motion.timing(), config.filter.path_period_s) {
        for (filter, spent_ms) in filters.iter_mut().zip(&mut spent_ms) {
            let start = Instant::now();
            step(filter, event, &log.sightings);
            *spent_ms += start.elapsed().as_secs_f64() * 1e3;
        }
        if let Event::Step { first, end, .. } = event {
            done += usize::from(end > first);
            if done > MAPPING && end > first {
                steps.push(spent_ms);
                sightings += end - first;
            }
            spent_ms = [0.0; THREADS.len()];
            if steps.len() == STEPS {
                break;
            }
        }
    }
    let name = config.algorithm;
    println!("{name:?}: {} steps, {:.1} sightings a step", steps.len(), sightings as f64 / steps.len() as f64);
    for (which, threads) in THREADS.iter().enumerate() {
        let mut times: Vec<f64> = steps.iter().map(|step| step[which]).collect();
        times.sort_unstable_by(f64::total_cmp);
        let (least, median) = (times[0], times[times.len() / 2]);
        let mut gains: Vec<f64> = steps.iter().map(|step| step[0] / step[which]).collect();
        gains.sort_unstable_by(f64::total_cmp);
        println!(
            "  {threads} threads: {least:.1} ms (least), {median:.1} ms (median): {:.0} steps per second; {:.2} times as fast as one",
            1e3 / median,
            gains[gains.len() / 2]
        );
    }
}

fn step(filter: &mut FastSlam, event: Event, sightings: &[Sighting]) {
    match event {
        Event::Control(control, dt_s) => filter.predict(control, dt_s).expect("a valid control"),
        Event::Step { stamp_s, first, end } => {
            filter.update(stamp_s, &sightings[first..end]).expect("explained sightings");
        }
    }
}
