//! Whole runs give the same bits whichever store holds the maps.

use fastslam_core::config::{Algorithm, AssociationMode, Config, ParticleNumber, Removal};
use fastslam_core::error::Result;
use fastslam_core::filter::{FastSlam, Identities, Sighting};
use fastslam_core::geometry::Pose;
use fastslam_core::math::wrap_angle;
use fastslam_core::random::{Purpose, RandomSource};
use fastslam_core::store::StoreKind;
use std::collections::BTreeSet;

const STEPS: u64 = 240;
const DT_S: f64 = 0.2;
/// Forward and sideways speed, turning rate: a little more than a circle of 6.7 m radius.
const CONTROL: [f64; 3] = [1.0, 0.0, 0.15];

/// The sightings of all landmarks of a grid that a robot on the circle has within 5 m.
fn sightings(step: u64, T_world_robot: Pose) -> Vec<Sighting> {
    let noise = RandomSource::new(3).stream(Purpose::Simulation, step);
    let mut seen = Vec::new();
    for identity in 0..144_u32 {
        let at = [f64::from(identity % 12) * 2.5 - 13.0, f64::from(identity / 12) * 2.5 - 7.0];
        let (dx, dy) = (at[0] - T_world_robot.x, at[1] - T_world_robot.y);
        if dx.hypot(dy) < 5.0 && !step.is_multiple_of(5) {
            let [range, bearing] = noise.normal_pair(identity, 0);
            let bearing = wrap_angle(dy.atan2(dx) - T_world_robot.heading) + 0.02 * bearing;
            seen.push(Sighting::range_bearing(dx.hypot(dy) + 0.1 * range, bearing, Some(identity)));
        }
    }
    seen
}

/// All that a run says, as bits; how often it resampled; and the numbers of particles that it had.
fn run(config: &Config) -> Result<(Vec<u64>, usize, BTreeSet<u32>)> {
    let identities = if config.association.mode == AssociationMode::Known { Identities::All } else { Identities::None };
    let mut filter = FastSlam::new(config.clone(), identities)?;
    let (mut said, mut resampled, mut particles) = (Vec::new(), 0, BTreeSet::new());
    let mut truth = Pose::new(0.0, 0.0, 0.0);
    for step in 0..STEPS {
        truth = truth.compose(Pose::new(CONTROL[0] * DT_S, 0.0, CONTROL[2] * DT_S));
        filter.predict([1.0, 0.15, 0.0], DT_S)?;
        let info = filter.update(step as f64 * DT_S, &sightings(step, truth))?;
        resampled += usize::from(info.weighing.resampled);
        assert_eq!(info.sampling.particles as usize, filter.particles().len());
        particles.insert(info.sampling.particles);
        let pose = filter.pose().mean;
        said.extend([pose.x, pose.y, pose.heading, info.weighing.log_likelihood, info.noise.nis].map(f64::to_bits));
        said.push(info.health.status as u64 + (u64::from(info.health.reasons) << 8));
    }
    for landmark in filter.map().landmarks {
        let c = landmark.covariance;
        said.push(landmark.birth);
        said.extend([landmark.mean[0], landmark.mean[1], c.xx, c.xy, c.yy].map(f64::to_bits));
    }
    for (birth, mean, c) in filter.map_of(0) {
        said.push(birth);
        said.extend([mean[0], mean[1], c.xx, c.xy, c.yy].map(f64::to_bits));
    }
    Ok((said, resampled, particles))
}

#[test]
fn dense_tree_and_lineage_give_the_same_bits_over_whole_runs() {
    let mut compared = 0;
    for algorithm in [Algorithm::Fastslam1, Algorithm::Fastslam2] {
        for mode in [AssociationMode::Known, AssociationMode::Unknown] {
            for threshold in [0.0, 0.5, 1.0] {
                let mut config = Config { seed: 9, algorithm, ..Config::default() };
                config.filter.particles = 30;
                config.filter.resampling.threshold = threshold;
                config.association.mode = mode;
                config.filter.store = StoreKind::Dense;
                let (expected, resampled, _) = run(&config).unwrap();
                assert_eq!(resampled > 10, threshold > 0.0, "{algorithm:?} {mode:?} {threshold}: {resampled}");
                assert!(expected.len() > 4 * STEPS as usize + 2 * 6 * 30, "a map worth comparing");
                for store in [StoreKind::Tree, StoreKind::Lineage] {
                    config.filter.store = store;
                    assert!(run(&config).unwrap().0 == expected, "{store:?} {algorithm:?} {mode:?} {threshold}");
                    compared += 1;
                }
            }
        }
    }
    assert_eq!(compared, 24);
}

#[test]
fn a_number_of_particles_that_adapts_gives_the_same_bits_in_every_store() {
    let mut compared = 0;
    for algorithm in [Algorithm::Fastslam1, Algorithm::Fastslam2] {
        for (mode, removal) in [
            (AssociationMode::Known, Removal::Never),
            (AssociationMode::Unknown, Removal::Never),
            (AssociationMode::Unknown, Removal::WhenMissed),
        ] {
            let mut config = Config { seed: 9, algorithm, ..Config::default() };
            config.filter.particles = 60;
            config.filter.adaptive.number = ParticleNumber::Kld;
            config.filter.adaptive.minimum = 5;
            config.filter.adaptive.epsilon = 0.3;
            config.association.mode = mode;
            config.association.existence.removal = removal;
            config.filter.store = StoreKind::Dense;
            let (expected, _, particles) = run(&config).unwrap();
            assert!(particles.len() > 3, "{algorithm:?} {mode:?}: the number changes, {particles:?}");
            assert!(particles.iter().all(|count| (5..=60).contains(count)), "{particles:?}");
            for store in [StoreKind::Tree, StoreKind::Lineage] {
                config.filter.store = store;
                assert!(run(&config).unwrap().0 == expected, "{store:?} {algorithm:?} {mode:?} {removal:?}");
                compared += 1;
            }
        }
    }
    assert_eq!(compared, 12);
}
