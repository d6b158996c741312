//! Whole runs give the same bits whichever store holds the maps.

use crate::blind::Blind;
use fastslam_core::config::{
    Algorithm, AssociationMode, Classes, Config, ExistenceForm, MergingRule, Method, Removal, Signatures,
};
use fastslam_core::resampling::ResamplingScheme;
use fastslam_core::run::{run, RunOutput};
use fastslam_core::store::StoreKind;
use fastslam_core::timeline::LogData;
use fastslam_sim::{simulate, Identities, Signature, SimulationConfig};

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
    simulation.scan.signature = Some(Signature { mean_m: 0.5, spread_std_m: 0.2, measurement_std_m: 0.1 });
    simulation.classes.names = ["red", "green", "blue"].map(String::from).to_vec();
    simulation.classes.confusion_probability = 0.1;
    let simulated = simulate(&simulation).unwrap();
    let log = simulated.log_data();
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
pub fn bits(output: &RunOutput) -> Vec<u64> {
    let mut numbers = Vec::new();
    for step in &output.steps {
        let (info, pose) = (&step.info, &step.pose);
        numbers.extend([step.stamp_s, info.weighing.effective_sample_size, info.weighing.log_likelihood]);
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
                    resamplings += output.steps.iter().filter(|s| s.info.weighing.resampled).count();
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
    assert!(output.steps.iter().filter(|s| s.info.weighing.resampled).count() > 20);
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

/// Everything that association can do, switched on.
fn with_everything(config: &mut Config, method: Method) {
    let association = &mut config.association;
    association.method = method;
    association.detection_probability = Some(0.8);
    association.clutter_density = Some(0.005);
    association.classes = Some(Classes { number: 3, correct_probability: 0.9 });
    association.signatures = Some(Signatures { std: 0.1, spread: 1.0 });
    association.existence.form = ExistenceForm::Bayes;
    association.existence.removal = Removal::WhenMissed;
    association.merging.rule = MergingRule::Nearby;
    association.merging.tolerance_std_m = 0.5;
}

const METHODS: [Method; 4] = [Method::MaximumLikelihood, Method::Sampled, Method::Assignment, Method::Joint];

#[test]
fn every_store_gives_the_same_bits_by_every_method_with_everything_that_association_can_do() {
    let (mut merged, mut removed, mut resampled, mut looks) = (0, 0, 0, 0);
    for method in METHODS {
        for identities in [Identities::None, Identities::Fraction(0.3)] {
            for algorithm in [Algorithm::Fastslam1, Algorithm::Fastslam2] {
                let (log, mut config) = world(6, identities);
                config.algorithm = algorithm;
                with_everything(&mut config, method);
                // A sensor that is worse than the filter believes makes duplicates.
                config.sensor.change(|s| s.range_std_m *= 0.3);
                config.sensor.change(|s| s.bearing_std_rad *= 0.3);
                let output = agreed(&config, &log);
                let infos = || output.steps.iter().map(|s| s.info);
                merged += infos().map(|i| i.changes.merged).sum::<u32>();
                removed += infos().map(|i| i.changes.removed).sum::<u32>();
                resampled += infos().filter(|i| i.weighing.resampled).count();
                looks += output.map.landmarks.iter().filter(|l| l.appearance.class.is_some()).count();
            }
        }
    }
    assert!(merged > 0 && removed > 50 && resampled > 50, "{merged} merged, {removed} removed, {resampled}");
    assert!(looks > 100, "{looks} landmarks with a class");
}

#[test]
fn the_number_of_threads_changes_no_bit_of_any_method() {
    for method in METHODS {
        let (log, mut config) = world(7, Identities::None);
        with_everything(&mut config, method);
        let mut runs = Vec::new();
        for threads in [1, 2, 8] {
            config.filter.threads = threads;
            runs.push(bits(&output(&config, StoreKind::default(), &log)));
        }
        assert!(runs[0].len() > 500 && runs.iter().all(|run| *run == runs[0]), "{method:?}");
    }
}

#[test]
fn the_methods_decide_differently() {
    let (log, mut config) = world(8, Identities::None);
    let mut runs = Vec::new();
    for method in METHODS {
        with_everything(&mut config, method);
        runs.push(bits(&output(&config, StoreKind::default(), &log)));
    }
    for (i, a) in runs.iter().enumerate() {
        assert!(runs[..i].iter().all(|b| a != b), "{:?} is the same as another one", METHODS[i]);
    }
}
