//! Whole runs give the same bits whichever store holds the maps.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)] // That is how a test fails.

use fastslam_core::config::{Algorithm, AssociationMode, Config};
use fastslam_core::filter::Sighting;
use fastslam_core::resampling::ResamplingScheme;
use fastslam_core::run::{run, Observer, RunOutput};
use fastslam_core::store::StoreKind;
use fastslam_core::timeline::LogData;
use fastslam_sim::{simulate, Identities, SimulationConfig};

/// Watches nothing; time stands still.
struct Blind;

impl Observer for Blind {
    fn now_s(&self) -> f64 {
        0.0
    }

    fn step_done(&mut self, _done: usize) -> bool {
        true
    }
}

/// Every store that this build knows, by its name in a configuration.
fn stores() -> Vec<StoreKind> {
    let known = |name: &&str| serde_json::from_str(&format!("\"{name}\"")).ok();
    let stores: Vec<StoreKind> = ["dense", "tree", "lineage"].iter().filter_map(known).collect();
    assert!(stores.len() >= 2 && stores.contains(&StoreKind::default()), "{stores:?}");
    stores
}

/// A drive around a small field with missed and false sightings.
fn world(seed: u64, identities: Identities) -> (LogData, Config) {
    let mut simulation = SimulationConfig::preset("demo").unwrap();
    simulation.seed = seed;
    simulation.max_duration_s = Some(12.0);
    simulation.scan.period_s = 0.4;
    simulation.scan.detection_probability = 0.8;
    simulation.scan.clutter_per_scan = if identities == Identities::All { 0.0 } else { 0.3 };
    simulation.scan.identities = identities;
    let simulated = simulate(&simulation).unwrap();
    let seen = &simulated.sightings;
    let sighting =
        |i: usize| Sighting::range_bearing(seen.range_m[i], seen.bearing_rad[i], u32::try_from(seen.identity[i]).ok());
    let log = LogData {
        control_stamps_s: simulated.control_stamp_s.clone(),
        controls: simulated.controls.clone(),
        sighting_stamps_s: seen.stamp_s.clone(),
        sightings: (0..seen.len()).map(sighting).collect(),
    };
    let mut config = Config { seed, motion: simulated.motion, sensor: simulated.sensor, ..Config::default() };
    config.filter.particles = 30;
    (log, config)
}

fn output(config: &Config, store: StoreKind, log: &LogData) -> RunOutput {
    let mut config = config.clone();
    config.filter.store = store;
    run(&config, log, &mut Blind).unwrap()
}

/// All numbers of a run, as their bits.
fn bits(output: &RunOutput) -> Vec<u64> {
    let mut numbers = Vec::new();
    for step in &output.steps {
        let (info, pose) = (&step.info, &step.pose);
        numbers.extend([step.stamp_s, info.effective_sample_size, info.log_likelihood]);
        numbers.extend(pose.mean.to_array());
        numbers.extend(pose.covariance.as_flattened());
    }
    for (stamp_s, pose) in &output.smoothed {
        numbers.push(*stamp_s);
        numbers.extend(pose.to_array());
    }
    for landmark in &output.map.landmarks {
        numbers.extend(landmark.mean);
        numbers.extend([landmark.covariance.xx, landmark.covariance.xy, landmark.covariance.yy]);
    }
    numbers.into_iter().map(f64::to_bits).collect()
}

/// Runs every store over one world and returns what the first one gave.
fn agreed(config: &Config, log: &LogData) -> RunOutput {
    let stores = stores();
    let reference = output(config, stores[0], log);
    for store in &stores[1..] {
        let other = output(config, *store, log);
        assert_eq!(bits(&reference), bits(&other), "{store:?}");
        let infos = |o: &RunOutput| o.steps.iter().map(|s| s.info).collect::<Vec<_>>();
        assert_eq!(infos(&reference), infos(&other), "{store:?}");
        assert_eq!(reference.map, other.map, "{store:?}");
        assert_eq!(reference.skipped, other.skipped, "{store:?}");
    }
    reference
}

#[test]
fn every_store_gives_the_same_bits() {
    let schemes = [
        ResamplingScheme::Systematic,
        ResamplingScheme::Stratified,
        ResamplingScheme::Residual,
        ResamplingScheme::Multinomial,
    ];
    let (mut runs, mut resamplings, mut landmarks) = (0, 0, 0);
    for identities in [Identities::All, Identities::None, Identities::Fraction(0.5)] {
        for seed in [1, 2] {
            let (log, mut config) = world(seed, identities);
            assert!(log.sightings.len() > 100, "{} sightings", log.sightings.len());
            for algorithm in [Algorithm::Fastslam1, Algorithm::Fastslam2] {
                for scheme in schemes {
                    config.algorithm = algorithm;
                    config.filter.resampling.scheme = scheme;
                    let output = agreed(&config, &log);
                    runs += 1;
                    resamplings += output.steps.iter().filter(|s| s.info.resampled).count();
                    landmarks += output.map.landmarks.len();
                }
            }
        }
    }
    assert_eq!(runs, 48);
    assert!(resamplings > 5 * runs, "{resamplings} resamplings in {runs} runs");
    assert!(landmarks > 10 * runs, "{landmarks} landmarks in {runs} runs");
}

#[test]
fn every_store_gives_the_same_bits_when_identities_are_ignored() {
    let (log, mut config) = world(3, Identities::All);
    config.association.mode = AssociationMode::Unknown;
    config.filter.resampling.threshold = 1.0;
    let output = agreed(&config, &log);
    assert!(output.map.landmarks.iter().all(|landmark| landmark.identity.is_none()));
    assert!(output.steps.iter().filter(|s| s.info.resampled).count() > 20);
}

#[test]
fn a_run_repeats_bit_by_bit_and_another_seed_changes_it() {
    let (log, mut config) = world(4, Identities::None);
    let store = StoreKind::default();
    let first = bits(&output(&config, store, &log));
    assert_eq!(first, bits(&output(&config, store, &log)));
    config.seed += 1;
    assert_ne!(first, bits(&output(&config, store, &log)));
}

#[test]
fn the_number_of_threads_changes_no_bit() {
    let (log, mut config) = world(5, Identities::None);
    let mut runs = Vec::new();
    for threads in [1, 2, 8] {
        config.filter.threads = threads;
        runs.push(bits(&output(&config, StoreKind::default(), &log)));
    }
    assert!(runs[0].len() > 500, "{} numbers", runs[0].len());
    assert!(runs.iter().all(|run| *run == runs[0]));
}
