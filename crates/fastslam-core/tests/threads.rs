//! Neither what is decided nor what is computed depends on the number of threads.

use fastslam_core::config::{Algorithm, Config};
use fastslam_core::filter::{FastSlam, Identities, Sighting};
use fastslam_core::motion::{Increments, Motion};
use fastslam_core::workers::PART;

/// More than two parts, and not a multiple of one.
const PARTICLES: usize = 2 * PART + 1001;
const STEPS: u32 = 6;

/// A straight drive past landmarks on both sides; every number that the filter ends with, as bits.
fn run(algorithm: Algorithm, identities: Identities, threads: u32) -> (Vec<u64>, u32) {
    let mut config = Config { algorithm, seed: 4, ..Config::default() };
    config.filter.particles = PARTICLES as u32;
    config.filter.threads = threads;
    config.filter.resampling.threshold = 1.0;
    config.motion =
        Motion::Increments(Increments { x_std_m: 0.05, y_std_m: 0.05, heading_std_rad: 0.01, ..Increments::default() });
    let mut filter = FastSlam::new(config, identities).unwrap();
    let mut resampled = 0;
    for step in 0..STEPS {
        if step > 0 {
            filter.predict([1.0, 0.0, 0.0], 1.0).unwrap();
        }
        let see = |n: u32| {
            let (dx, dy) = (3.0 * f64::from(n) - f64::from(step), if n.is_multiple_of(2) { 4.0 } else { -5.0 });
            let identity = (identities == Identities::All).then_some(n);
            Sighting::range_bearing(dx.hypot(dy) + 0.02 * f64::from(n), dy.atan2(dx), identity)
        };
        let sightings: Vec<Sighting> = (0..4).map(see).collect();
        resampled += u32::from(filter.update(f64::from(step), &sightings).unwrap().weighing.resampled);
    }
    let particles = filter.particles();
    let mut numbers = [&particles.x, &particles.y, &particles.heading, &particles.score].map(Vec::clone).concat();
    numbers.extend(filter.weights());
    numbers.extend(filter.pose().covariance.as_flattened());
    for landmark in filter.map().landmarks {
        numbers.extend(landmark.mean);
        numbers.extend([landmark.covariance.xx, landmark.covariance.xy, landmark.covariance.yy]);
    }
    (numbers.into_iter().map(f64::to_bits).collect(), resampled)
}

#[test]
fn the_number_of_threads_changes_no_bit_of_many_particles() {
    let mut cases = 0;
    for algorithm in [Algorithm::Fastslam1, Algorithm::Fastslam2] {
        for identities in [Identities::All, Identities::None] {
            let (one, resampled) = run(algorithm, identities, 1);
            assert!(one.len() > 5 * PARTICLES + 4 * 5 && resampled > 0, "{algorithm:?} {identities:?}");
            for threads in [2, 8] {
                assert!(one == run(algorithm, identities, threads).0, "{algorithm:?} {identities:?} {threads}");
                cases += 1;
            }
        }
    }
    assert_eq!(cases, 8);
}
