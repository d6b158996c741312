//! False sightings found landmarks that fade; what is there stays. With defaults.

use crate::blind::Blind;
use fastslam_core::config::{Config, Removal};
use fastslam_core::run::{run, RunOutput};
use fastslam_core::store::StoreKind;
use fastslam_sim::{simulate, Identities, SimulatedLog, SimulationConfig};

/// The demo without identities, with so many false sightings a scan; a fifth of the true ones are missing.
fn world(seed: u64, clutter_per_scan: f64) -> (SimulatedLog, Config) {
    let mut simulation = SimulationConfig::preset("demo").unwrap();
    (simulation.seed, simulation.scan.identities) = (seed, Identities::None);
    (simulation.scan.clutter_per_scan, simulation.scan.detection_probability) = (clutter_per_scan, 0.8);
    let log = simulate(&simulation).unwrap();
    let mut config = Config { seed, ..Config::default() };
    (config.motion, config.sensor) = (log.motion.clone(), log.sensor.clone());
    let [x_m, y_m, heading_rad] = log.T_world_robot[0];
    config.initial_pose = fastslam_core::config::InitialPose { x_m, y_m, heading_rad };
    config.filter.particles = 30;
    (log, config)
}

/// True landmarks that have a confirmed one within 0.5 m, confirmed ones beyond that, and all that the map holds.
fn count(output: &RunOutput, log: &SimulatedLog) -> [usize; 3] {
    let confirmed: Vec<[f64; 2]> = output.map.landmarks.iter().filter(|l| l.confirmed).map(|l| l.mean).collect();
    let near = |at: &&[f64; 2]| confirmed.iter().any(|mean| (mean[0] - at[0]).hypot(mean[1] - at[1]) < 0.5);
    let found = log.landmarks.position_m.iter().filter(near).count();
    [found, confirmed.len() - found, output.map.landmarks.len()]
}

#[test]
fn what_clutter_founds_fades_and_what_is_there_stays() {
    for seed in 1..=3 {
        let (log, config) = world(seed, 3.0);
        let faded = count(&run(&config, &log.log_data(), &mut Blind).unwrap(), &log);
        let mut keeping = config.clone();
        keeping.association.existence.removal = Removal::Never;
        let kept = count(&run(&keeping, &log.log_data(), &mut Blind).unwrap(), &log);
        println!("seed {seed}: real, false and all: {faded:?} where landmarks fade, {kept:?} where all stay");
        assert!(kept[1] >= 5, "seed {seed}: too little clutter to tell anything");
        assert!(faded[1] <= 1 && faded[0] + 2 >= kept[0] && 3 * faded[2] < kept[2], "seed {seed}: {faded:?}, {kept:?}");
    }
}

#[test]
fn neither_the_store_nor_the_number_of_threads_changes_a_bit() {
    let (log, mut config) = world(1, 2.0);
    let expected = run(&config, &log.log_data(), &mut Blind).unwrap();
    for (store, threads) in [(StoreKind::Dense, 1), (StoreKind::Tree, 1), (StoreKind::Lineage, 2)] {
        (config.filter.store, config.filter.threads) = (store, threads);
        let found = run(&config, &log.log_data(), &mut Blind).unwrap();
        assert_eq!((&found.map, &found.smoothed), (&expected.map, &expected.smoothed), "{store:?}, {threads}");
    }
}
