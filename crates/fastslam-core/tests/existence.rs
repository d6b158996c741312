//! Landmarks that should be seen and are not disappear, and only those.

use fastslam_core::config::{Algorithm, AssociationMode, Config, Removal};
use fastslam_core::filter::{FastSlam, Identities, Sighting};
use fastslam_core::store::StoreKind;

/// A robot at rest that looks 10 m far in a half circle ahead.
fn filter(algorithm: Algorithm, removal: Removal, store: StoreKind) -> FastSlam {
    let mut config = Config { algorithm, seed: 4, ..Config::default() };
    config.association.mode = AssociationMode::Unknown;
    config.association.existence.removal = removal;
    config.filter.particles = 8;
    config.filter.store = store;
    config.sensor.change(|s| s.max_range_m = 10.0);
    config.sensor.change(|s| s.field_of_view_rad = std::f64::consts::PI);
    FastSlam::new(config, Identities::None).unwrap()
}

fn sighting(range_m: f64, bearing_rad: f64) -> Sighting {
    Sighting::range_bearing(range_m, bearing_rad, None)
}

/// Number of landmarks in the map after each scan.
fn landmarks(filter: &mut FastSlam, scans: &[Vec<Sighting>]) -> Vec<usize> {
    let mut counts = Vec::new();
    for (i, scan) in scans.iter().enumerate() {
        filter.update(i as f64, scan).unwrap();
        counts.push(filter.map().landmarks.len());
    }
    counts
}

#[test]
fn what_is_in_view_and_missed_disappears_after_five_scans() {
    // Log-odds 1 at birth, 0.3 less a scan, removed below -0.5: gone with the sixth miss, since 1 - 5 * 0.3 = -0.5.
    let mut scans = vec![vec![sighting(5.0, 0.5), sighting(4.0, -0.5)]];
    scans.extend(vec![vec![sighting(5.0, 0.5)]; 7]);
    for algorithm in [Algorithm::Fastslam1, Algorithm::Fastslam2] {
        let counts = landmarks(&mut filter(algorithm, Removal::WhenMissed, StoreKind::default()), &scans);
        assert_eq!(counts[0], 2, "{algorithm:?}");
        let gone = counts.iter().position(|count| *count == 1);
        // The sum of 0.3 is rounded: the fifth or the sixth.
        assert!(gone == Some(5) || gone == Some(6), "{algorithm:?}: {counts:?}");
        let counts = landmarks(&mut filter(algorithm, Removal::Never, StoreKind::default()), &scans);
        assert_eq!(counts, vec![2; 8], "{algorithm:?}");
    }
}

#[test]
fn what_lies_outside_the_view_stays() {
    // 9 m is beyond 80 % of the range; 1.5 rad is outside 90 % of the half field of view.
    let mut scans = vec![vec![sighting(5.0, 0.5), sighting(9.0, 0.0), sighting(4.0, 1.5)]];
    scans.extend(vec![vec![sighting(5.0, 0.5)]; 12]);
    let counts = landmarks(&mut filter(Algorithm::Fastslam2, Removal::WhenMissed, StoreKind::default()), &scans);
    assert_eq!(counts, vec![3; 13]);
}

#[test]
fn a_landmark_that_comes_back_is_a_new_one_and_a_famous_one_dies_too() {
    let (both, one) = (vec![sighting(5.0, 0.5), sighting(4.0, -0.5)], vec![sighting(5.0, 0.5)]);
    let mut scans = vec![both.clone(); 40];
    // At most 20 are counted: (20 + 0.5) / 0.3 = 68.3 misses.
    scans.extend(vec![one; 70]);
    scans.push(both);
    let mut filter = filter(Algorithm::Fastslam2, Removal::WhenMissed, StoreKind::default());
    let counts = landmarks(&mut filter, &scans);
    assert_eq!((counts[39], counts[105], counts[109], counts[110]), (2, 2, 1, 2));
    let births: Vec<u64> = filter.map().landmarks.iter().map(|landmark| landmark.birth).collect();
    assert_eq!(births, vec![0, 2]);
}

#[test]
fn every_store_forgets_alike() {
    let stores = [StoreKind::Dense, StoreKind::Tree, StoreKind::Lineage];
    let mut maps = Vec::new();
    for store in stores {
        let mut filter = filter(Algorithm::Fastslam2, Removal::WhenMissed, store);
        let (mut removed, mut resampled) = (0, 0);
        for step in 0..200_u32 {
            filter.predict([0.3, 0.35, 0.0], 0.1).unwrap();
            let wobble = 0.05 * f64::from(step * 7 % 13) / 13.0;
            let mut scan =
                vec![sighting(4.0 + wobble, 0.3 - 0.035 * f64::from(step % 20)), sighting(3.0, -0.4 + wobble)];
            scan.truncate(1 + (step % 3 != 0) as usize);
            let info = filter.update(0.1 * f64::from(step), &scan).unwrap();
            removed += info.changes.removed;
            resampled += u32::from(info.weighing.resampled);
        }
        assert!(removed > 3 && resampled > 3, "{store:?}: {removed} removed, {resampled} resamplings");
        maps.push(filter.map());
    }
    assert!(maps.iter().all(|map| *map == maps[0]));
}
