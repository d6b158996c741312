//! What FastSLAM 2.0 costs beside 1.0, and what threads bring: whole steps with known association, one filter for each
//! algorithm and number of threads, all on the same sightings and one after the other within each step, so that other
//! processes of the machine slow all.
//!
//! `cargo bench -p fastslam-core --bench threads [-- PARTICLES…]` (250, 1,000 and 100,000 if nothing is said; seven to
//! eight sightings a step). The log is run several times with the same seed, so that every pass repeats the same steps;
//! of each step the least time counts.

#![allow(clippy::expect_used, missing_docs)] // A benchmark that cannot run says so by failing.

use fastslam_core::config::{Algorithm, Config};
use fastslam_core::filter::{FastSlam, Identities};
use fastslam_core::timeline::{Event, LogData, SightingsRow, Timeline};
use fastslam_sim::{simulate, SimulationConfig};
use std::time::Instant;

const FILTERS: [(Algorithm, u32); 4] =
    [(Algorithm::Fastslam1, 1), (Algorithm::Fastslam1, 2), (Algorithm::Fastslam2, 1), (Algorithm::Fastslam2, 2)];
/// Steps at the beginning, in which the world is mapped.
const MAPPING: usize = 80;
const STEPS: usize = 160;

fn main() {
    let mut counts: Vec<u32> = std::env::args().filter_map(|argument| argument.parse().ok()).collect();
    if counts.is_empty() && std::env::args().any(|argument| argument == "--bench") {
        counts = vec![250, 1_000, 100_000];
    } else if counts.is_empty() {
        // Under `cargo test`: only that it runs.
        counts = vec![10];
    }
    let preset = SimulationConfig::preset("headline").expect("a preset");
    let mut simulation = preset.with_landmarks(100).expect("a world of any size");
    simulation.sensor.max_range_m = 8.5;
    let simulated = simulate(&simulation).expect("a valid simulation");
    let log = simulated.log_data();
    let mut config = Config { motion: simulated.motion.clone(), sensor: simulated.sensor.clone(), ..Config::default() };
    for particles in counts {
        config.filter.particles = particles;
        compare(&config, &log);
    }
}

/// Milliseconds of each filter in one step, and how many sightings it had.
type Step = ([f64; FILTERS.len()], usize);

/// Runs the filters over the log some times and prints what their steps took.
fn compare(config: &Config, log: &LogData) {
    // About as long for every number of particles.
    let passes = (300_000 / config.filter.particles as usize).clamp(3, 40);
    let mut steps = pass(config, log);
    for _ in 1..passes {
        for ((least, _), (again, _)) in steps.iter_mut().zip(pass(config, log)) {
            least.iter_mut().zip(again).for_each(|(least, again)| *least = least.min(again));
        }
    }
    let (particles, sightings) = (f64::from(config.filter.particles), |step: &Step| step.1 as f64);
    let mean_sightings = steps.iter().map(sightings).sum::<f64>() / steps.len() as f64;
    println!("\nM = {particles}, {} steps of {mean_sightings:.1} sightings, least of {passes} passes", steps.len());
    println!("                 ns/particle-sighting    steps/s  over 1.0, one thread");
    println!("                   least      median      median  least step   median of the steps' ratios");
    for (which, (algorithm, threads)) in FILTERS.iter().enumerate() {
        let each = sorted(steps.iter().map(|step| 1e6 * step.0[which] / (particles * sightings(step))));
        let whole = sorted(steps.iter().map(|step| step.0[which]));
        let ratios = sorted(steps.iter().map(|step| step.0[which] / step.0[0]));
        let first = sorted(steps.iter().map(|step| 1e6 * step.0[0] / (particles * sightings(step))));
        let middle = steps.len() / 2;
        println!(
            "{algorithm:?} x{threads} {:>10.2} {:>11.2} {:>11.0} {:>11.2} {:>11.2}",
            each[0],
            each[middle],
            1e3 / whole[middle],
            each[0] / first[0],
            ratios[middle]
        );
    }
}

fn sorted(values: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut values: Vec<f64> = values.collect();
    values.sort_unstable_by(f64::total_cmp);
    values
}

/// Runs new filters over the log side by side.
fn pass(config: &Config, log: &LogData) -> Vec<Step> {
    let mut filters = FILTERS.map(|(algorithm, threads)| {
        let mut config = Config { algorithm, ..config.clone() };
        config.filter.threads = threads;
        FastSlam::new(config, Identities::All).expect("a valid configuration")
    });
    let mut spent_ms = [0.0; FILTERS.len()];
    let (mut done, mut steps) = (0, Vec::new());
    for event in Timeline::of(log, config.motion.timing(), config.filter.path_period_s) {
        for (filter, spent_ms) in filters.iter_mut().zip(&mut spent_ms) {
            let start = Instant::now();
            step(filter, &event);
            *spent_ms += start.elapsed().as_secs_f64() * 1e3;
        }
        if let Event::Step(SightingsRow { sightings, .. }) = event {
            done += usize::from(!sightings.is_empty());
            if done > MAPPING && !sightings.is_empty() {
                steps.push((spent_ms, sightings.len()));
            }
            spent_ms = [0.0; FILTERS.len()];
            if steps.len() == STEPS {
                break;
            }
        }
    }
    steps
}

fn step(filter: &mut FastSlam, event: &Event) {
    match event {
        Event::Control(part) => filter.advance(part).expect("a valid control"),
        Event::Step(SightingsRow { stamp_s, sightings, .. }) => {
            filter.update(*stamp_s, sightings).expect("explained sightings");
        }
    }
}
