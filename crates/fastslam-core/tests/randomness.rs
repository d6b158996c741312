//! Random numbers are used once.

use fastslam_core::config::{Algorithm, Config};
use fastslam_core::filter::{FastSlam, Identities, Sighting};
use fastslam_core::motion::{Increments, Motion};
use fastslam_core::resampling::ResamplingScheme;

/// Where the particles stand after each of three resamplings of equal weights, without motion between them.
fn positions(algorithm: Algorithm, identities: Identities) -> [Vec<f64>; 4] {
    let mut config = Config { algorithm, seed: 3, ..Config::default() };
    config.motion =
        Motion::Increments(Increments { x_std_m: 0.5, y_std_m: 0.0, heading_std_rad: 0.0, ..Increments::default() });
    config.filter.particles = 40;
    config.filter.resampling.threshold = 1.0;
    config.filter.resampling.scheme = ResamplingScheme::Multinomial;
    let mut filter = FastSlam::new(config, identities).unwrap();
    // The first sighting of a landmark weighs nothing; this one also samples the poses in FastSLAM 2.0.
    filter.predict([1.0, 0.0, 0.0], 1.0).unwrap();
    let mut see = |n: u32| {
        let identity = (identities == Identities::All).then_some(n);
        let info = filter.update(f64::from(n), &[Sighting::range_bearing(20.0 + 20.0 * f64::from(n), 0.0, identity)]);
        let info = info.unwrap();
        assert_eq!((info.changes.new_landmarks, info.weighing.resampled), (1, true));
        filter.particles().x.clone()
    };
    std::array::from_fn(|n| see(n as u32))
}

#[test]
fn every_resampling_draws_its_own_numbers() {
    let mut cases = 0;
    for algorithm in [Algorithm::Fastslam1, Algorithm::Fastslam2] {
        for identities in [Identities::All, Identities::None] {
            let [before, first, second, third] = positions(algorithm, identities);
            // Ancestors are sorted, so equal positions are neighbours; the first occurrence names the ancestor.
            let map = |from: &[f64], to: &[f64]| -> Vec<usize> {
                to.iter().map(|x| from.iter().position(|y| y == x).expect("an ancestor")).collect()
            };
            // With the same numbers every resampling of equal weights would be the same map, applied again.
            let f = map(&before, &first);
            let again = |x: &[f64]| -> Vec<f64> { f.iter().map(|&a| x[a]).collect() };
            let repeats = [(&first, &second), (&second, &third)].iter().filter(|(a, b)| again(a) == **b).count();
            assert_eq!(repeats, 0, "{algorithm:?} {identities:?}");
            assert!(first != before, "{algorithm:?} {identities:?}: nothing was resampled");
            cases += 1;
        }
    }
    assert_eq!(cases, 4);
}
