//! What unknown association costs over known association: whole steps on the same sightings, one filter after the
//! other within each step, so that other processes of the machine slow both.
//!
//! `cargo bench -p fastslam-core --bench unknown [-- LANDMARKS]` (50,000 if nothing is said). The world is swept
//! once at the density of the headline run; steps during the last tenth count.

#![allow(clippy::expect_used, missing_docs)] // A benchmark that cannot run says so by failing.

use fastslam_core::config::{Algorithm, AssociationMode, Config};
use fastslam_core::filter::{FastSlam, Identities};
use fastslam_core::timeline::{Event, LogData, SightingsRow, Timeline};
use fastslam_sim::{simulate, SimulationConfig};
use std::time::Instant;

const PARTICLES: u32 = 250;

fn main() {
    let landmarks = argument().unwrap_or(50_000);
    let simulation = SimulationConfig::preset("headline").expect("a preset").with_landmarks(landmarks);
    let simulated = simulate(&simulation.expect("a world of any size")).expect("a valid simulation");
    let log = simulated.log_data();
    let config = Config { motion: simulated.motion.clone(), sensor: simulated.sensor.clone(), ..Config::default() };
    println!("K = {landmarks}, M = {PARTICLES}; least and median of a step in ns per particle and sighting");
    for algorithm in [Algorithm::Fastslam1, Algorithm::Fastslam2] {
        compare(algorithm, &config, &log);
    }
}

/// The size that was asked for.
fn argument() -> Option<u32> {
    let quick = std::env::args().any(|argument| argument == "--quick");
    std::env::args().filter_map(|argument| argument.parse().ok()).next().or(quick.then_some(1000))
}

/// Runs both filters over the log and prints what their steps took.
fn compare(algorithm: Algorithm, config: &Config, log: &LogData) {
    let mut config = Config { algorithm, seed: 1, ..config.clone() };
    config.filter.particles = PARTICLES;
    // The plain filter: what draws cost is measured elsewhere.
    config.filter.rejuvenation.every_steps = Some(0);
    let mut filters = [AssociationMode::Known, AssociationMode::Unknown].map(|mode| {
        config.association.mode = mode;
        FastSlam::new(config.clone(), Identities::All).expect("a valid configuration")
    });
    let begin = log.control_stamps_s.last().copied().unwrap_or(0.0) * 0.9;
    let mut spent_ns = [0.0; 2];
    let mut steps: Vec<[f64; 2]> = Vec::new();
    for event in Timeline::of(log, config.motion.timing(), config.filter.path_period_s) {
        let took_ns = [0, 1].map(|which| {
            let start = Instant::now();
            step(&mut filters[which], &event);
            start.elapsed().as_secs_f64() * 1e9
        });
        (0..2).for_each(|which| spent_ns[which] += took_ns[which]);
        match event {
            Event::Control(..) => {}
            Event::Step(SightingsRow { stamp_s, sightings, .. }) => {
                if stamp_s >= begin && !sightings.is_empty() {
                    let sightings = f64::from(PARTICLES) * sightings.len() as f64;
                    steps.push(spent_ns.map(|ns| ns / sightings));
                }
                spent_ns = [0.0; 2];
            }
        }
    }
    let column = |which: usize| ordered(steps.iter().map(|step| step[which]));
    let (known, unknown) = (column(0), column(1));
    let ratios = ordered(steps.iter().map(|step| step[1] / step[0]));
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    println!(
        "{algorithm:?}: known {:.1} and {:.1}, unknown {:.1} and {:.1}; unknown over known {:.2} (least), {:.2} (median of the steps' ratios), {:.2} (mean); {} steps",
        known[0],
        known[known.len() / 2],
        unknown[0],
        unknown[unknown.len() / 2],
        unknown[0] / known[0],
        ratios[ratios.len() / 2],
        mean(&unknown) / mean(&known),
        steps.len(),
    );
}

fn step(filter: &mut FastSlam, event: &Event) {
    match event {
        Event::Control(part) => filter.advance(part).expect("a valid control"),
        Event::Step(SightingsRow { stamp_s, sightings, .. }) => {
            filter.update(*stamp_s, sightings).expect("explained sightings");
        }
    }
}

fn ordered(values: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut values: Vec<f64> = values.collect();
    values.sort_unstable_by(f64::total_cmp);
    values
}
