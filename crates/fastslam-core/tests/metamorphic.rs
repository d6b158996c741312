//! Changes of the input whose effect on the output is known exactly.

use crate::linear_world::{self, simulate, LANDMARKS, MODEL};
use fastslam_core::config::{Algorithm, Config, InitialPose};
use fastslam_core::filter::{FastSlam, Identities, PoseEstimate, Sighting};
use fastslam_core::geometry::{multiply3, Pose};
use fastslam_core::motion::{Motion, Velocity};
use fastslam_core::random::{Purpose, RandomSource};

const ALGORITHMS: [Algorithm; 2] = [Algorithm::Fastslam1, Algorithm::Fastslam2];
const FIELD: [[f64; 2]; 4] = [[4.0, 1.0], [2.0, -3.0], [6.0, 2.5], [-2.0, 2.0]];

fn config(algorithm: Algorithm) -> Config {
    let mut config = Config { algorithm, seed: 6, ..Config::default() };
    config.filter.particles = 20;
    config.sensor.change(|s| s.mounting.x_m = 0.3);
    config.sensor.change(|s| s.mounting.yaw_rad = 0.2);
    config.motion = Motion::Velocity(Velocity {
        speed_std_m_per_s: 0.2,
        yaw_rate_std_rad_per_s: 0.1,
        lateral_std_m_per_s: 0.1,
        noise_period_s: Some(0.5),
        ..Velocity::default()
    });
    config
}

/// Noisy range-bearing sightings of the field while the robot drives a bend: (control, scan) per step.
fn bend(steps: u32) -> Vec<([f64; 3], Vec<Sighting>)> {
    let mut robot = Pose::default();
    let T_robot_sensor = Pose::new(0.3, 0.0, 0.2);
    (0..steps)
        .map(|t| {
            let control = [1.0, 0.3, 0.0];
            robot = robot.compose(Pose::from_twist(0.5, 0.0, 0.15));
            let sensor = robot.compose(T_robot_sensor).inverse();
            let stream = RandomSource::new(4).stream(Purpose::Simulation, u64::from(t));
            let scan = FIELD.iter().enumerate().map(|(n, landmark)| {
                let [x, y] = sensor.transform(*landmark);
                let [a, b] = stream.normal_pair(n as u32, 0);
                Sighting::range_bearing(x.hypot(y) + 0.1 * a, y.atan2(x) + 0.02 * b, Some(n as u32))
            });
            (control, scan.collect())
        })
        .collect()
}

/// Everything that a run says, step by step, and the map at its end.
#[derive(Debug, PartialEq)]
struct Outcome {
    poses: Vec<PoseEstimate>,
    log_likelihood: Vec<f64>,
    resampled: Vec<bool>,
    map: Vec<(Option<u32>, [f64; 2])>,
}

fn run(config: Config, log: &[([f64; 3], Vec<Sighting>)]) -> Outcome {
    let mut filter = FastSlam::new(config, Identities::All).unwrap();
    let mut outcome = Outcome { poses: vec![], log_likelihood: vec![], resampled: vec![], map: vec![] };
    for (t, (control, scan)) in log.iter().enumerate() {
        filter.predict(*control, 0.5).unwrap();
        let info = filter.update(t as f64, scan).unwrap();
        outcome.poses.push(filter.pose());
        outcome.log_likelihood.push(info.weighing.log_likelihood);
        outcome.resampled.push(info.weighing.resampled);
    }
    outcome.map = filter.map().landmarks.iter().map(|l| (l.identity, l.mean)).collect();
    assert_eq!(outcome.map.len(), FIELD.len());
    outcome
}

fn close(a: f64, b: f64, bound: f64, what: &str) {
    assert!((a - b).abs() < bound, "{what}: {a} against {b}");
}

/// `moved` is `still` seen from a world that `T` takes to the old one.
fn assert_moved(still: &Outcome, moved: &Outcome, T: Pose, bound: f64) {
    assert_eq!(still.poses.len(), moved.poses.len());
    assert_eq!(still.resampled, moved.resampled);
    let (s, c) = T.heading.sin_cos();
    let rotation = [[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]];
    let back = [[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]];
    for (a, b) in still.poses.iter().zip(&moved.poses) {
        let expected = T.compose(a.mean);
        close(b.mean.x, expected.x, bound, "x");
        close(b.mean.y, expected.y, bound, "y");
        close((b.mean.heading - expected.heading).sin(), 0.0, bound, "heading");
        let covariance = multiply3(&multiply3(&rotation, &a.covariance), &back);
        for i in 0..9 {
            close(b.covariance[i / 3][i % 3], covariance[i / 3][i % 3], bound, "covariance");
        }
    }
    for (a, b) in still.log_likelihood.iter().zip(&moved.log_likelihood) {
        // A log-likelihood is a square over the noise's: its rounding is larger by about 1 / (0.02 rad).
        close(*a, *b, 100.0 * bound, "log-likelihood");
    }
    for (a, b) in still.map.iter().zip(&moved.map) {
        let expected = T.transform(a.1);
        assert_eq!(a.0, b.0);
        (0..2).for_each(|axis| close(b.1[axis], expected[axis], bound, "landmark"));
    }
}

/// Coordinates up to 40 m carry a rounding of 40 · 2⁻⁵³ = 4e-15 m per operation; a bearing's gain 1/σ² and some hundred
/// operations per step amplify it by less than 1e4 over these few steps, as long as no particle changes its ancestor.
const ROUNDING: f64 = 1e-10;

#[test]
fn a_shifted_start_gives_the_shifted_estimate() {
    let log = bend(8);
    for algorithm in ALGORITHMS {
        let still = run(config(algorithm), &log);
        assert!(still.resampled.iter().any(|r| *r), "{algorithm:?}: nothing was resampled");
        let mut shifted = config(algorithm);
        shifted.initial_pose = InitialPose { x_m: 30.0, y_m: -25.0, heading_rad: 0.0 };
        assert_moved(&still, &run(shifted, &log), Pose::new(30.0, -25.0, 0.0), ROUNDING);
    }
}

#[test]
fn a_turned_start_gives_the_turned_estimate() {
    // FastSLAM 1.0 draws in the robot's frame, so that the whole run turns with the start. FastSLAM 2.0 draws in the
    // world's axes: until the first draw it must turn exactly, and after it only in distribution.
    let log = bend(8);
    for heading_rad in [0.7, 2.0, -3.0] {
        for (algorithm, steps) in [(Algorithm::Fastslam1, 8), (Algorithm::Fastslam2, 1)] {
            let still = run(config(algorithm), &log[..steps]);
            let mut turned = config(algorithm);
            turned.initial_pose = InitialPose { x_m: 3.0, y_m: 7.0, heading_rad };
            let moved = run(turned, &log[..steps]);
            let T = Pose::new(3.0, 7.0, heading_rad);
            if algorithm == Algorithm::Fastslam1 {
                assert_moved(&still, &moved, T, ROUNDING);
            } else {
                let expected = T.compose(still.poses[0].mean);
                close(moved.poses[0].mean.x, expected.x, ROUNDING, "x");
                close(moved.poses[0].mean.y, expected.y, ROUNDING, "y");
            }
        }
    }
}

#[test]
fn the_evidence_of_fastslam_2_does_not_depend_on_the_world_s_axes() {
    let log = bend(6);
    let evidence = |heading_rad: f64| -> (f64, f64) {
        let values: Vec<f64> = (0..200)
            .map(|seed| {
                let mut config = config(Algorithm::Fastslam2);
                config.seed = seed;
                config.initial_pose.heading_rad = heading_rad;
                run(config, &log).log_likelihood.iter().sum()
            })
            .collect();
        let mean = values.iter().sum::<f64>() / 200.0;
        (mean, (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (199.0 * 200.0)).sqrt())
    };
    let (still, turned) = (evidence(0.0), evidence(0.8));
    assert!(still.1 > 0.0 && still.1 < 0.2, "{still:?}");
    assert_ne!(still.0, turned.0);
    // Four standard errors of the difference.
    close(still.0, turned.0, 4.0 * still.1.hypot(turned.1), "log evidence");
}

#[test]
fn names_of_landmarks_do_not_matter() {
    let log = bend(10);
    // Order of the names differs from the order of appearance, and they are far apart.
    let names = [4_000_000_000, 17, 0, 5];
    let renamed: Vec<_> = log
        .iter()
        .map(|(control, scan)| {
            let rename = |s: &Sighting| Sighting { identity: s.identity.map(|n| names[n as usize]), ..*s };
            (*control, scan.iter().map(rename).collect::<Vec<_>>())
        })
        .collect();
    for algorithm in ALGORITHMS {
        let (before, mut after) = (run(config(algorithm), &log), run(config(algorithm), &renamed));
        for (landmark, (identity, _)) in after.map.iter_mut().enumerate() {
            assert_eq!(*identity, Some(names[landmark]));
            *identity = Some(landmark as u32);
        }
        assert_eq!(before, after, "{algorithm:?}");
    }
}

fn proposal(motion: Velocity, control: [f64; 3], parts: u32) -> PoseEstimate {
    let mut config = config(Algorithm::Fastslam2);
    config.motion = Motion::Velocity(motion);
    let mut filter = FastSlam::new(config, Identities::All).unwrap();
    for _ in 0..parts {
        filter.predict(control, 0.4 / f64::from(parts)).unwrap();
    }
    filter.predicted_pose()
}

#[test]
fn a_held_control_with_white_noise_may_be_split() {
    let white = Velocity {
        speed_std_m_per_s: 0.3,
        yaw_rate_std_rad_per_s: 0.0,
        lateral_std_m_per_s: 0.2,
        noise_period_s: Some(0.1),
        ..Velocity::default()
    };
    // Straight on with noise along and across: the same proposal, whatever the number of parts.
    let whole = proposal(white.clone(), [1.5, 0.0, 0.0], 1);
    for parts in [2, 3, 8] {
        let split = proposal(white.clone(), [1.5, 0.0, 0.0], parts);
        close(split.mean.x, 0.6, 1e-15, "x");
        for i in 0..9 {
            close(split.covariance[i / 3][i % 3], whole.covariance[i / 3][i % 3], 1e-15, "covariance");
        }
    }
    // 0.3² · 0.1 · 0.4 along, 0.2² · 0.1 · 0.4 across.
    close(whole.covariance[0][0], 0.0036, 1e-15, "along");
    close(whole.covariance[1][1], 0.0016, 1e-15, "across");
    // Noise of the yaw rate acts on the path within the control too: v² σ² T³ / 3 across, however it is parted.
    let turning = Velocity { lateral_std_m_per_s: 0.0, yaw_rate_std_rad_per_s: 0.5, ..white };
    let across = |parts| proposal(turning.clone(), [1.5, 0.0, 0.0], parts).covariance;
    let unit = 1.5_f64.powi(2) * (0.25 * 0.1) * 0.4_f64.powi(3);
    for parts in [1, 2, 4] {
        close(across(parts)[1][1], unit / 3.0, 1e-14, "across, from the heading");
        close(across(parts)[2][2], 0.25 * 0.1 * 0.4, 1e-15, "heading");
    }
}

#[test]
fn the_order_within_a_scan_does_not_matter_in_the_linear_world() {
    let steps = simulate(5);
    let estimate = |reversed: bool| {
        let mut filter =
            FastSlam::with_model(linear_world::config(Algorithm::Fastslam2, 30, 2), Identities::All, MODEL).unwrap();
        let mut poses = Vec::new();
        for (t, step) in steps.iter().enumerate() {
            if t > 0 {
                filter.predict(step.control, 1.0).unwrap();
            }
            let mut scan: Vec<Sighting> = step.sightings.iter().copied().map(linear_world::sighting).collect();
            assert!(!scan.is_empty());
            if reversed {
                scan.reverse();
            }
            let info = filter.update(t as f64, &scan).unwrap();
            poses.push((filter.pose(), info.weighing.log_likelihood));
        }
        (poses, filter.map().landmarks)
    };
    let (forward, backward) = (estimate(false), estimate(true));
    assert_eq!(forward.0.len(), steps.len());
    for (a, b) in forward.0.iter().zip(&backward.0) {
        close(a.0.mean.x, b.0.mean.x, ROUNDING, "x");
        close(a.0.mean.y, b.0.mean.y, ROUNDING, "y");
        close(a.0.covariance[0][0], b.0.covariance[0][0], ROUNDING, "variance");
        close(a.1, b.1, ROUNDING, "log-likelihood");
    }
    assert_eq!(backward.1.len(), LANDMARKS.len());
    for a in &forward.1 {
        let b = backward.1.iter().find(|b| b.identity == a.identity).expect("the same landmarks");
        (0..2).for_each(|axis| close(a.mean[axis], b.mean[axis], ROUNDING, "landmark"));
    }
}

/// Largest difference of the proposal's mean between two orders of one scan, with all noise and all innovations scaled.
fn order_matters_by(scale: f64) -> f64 {
    let mut config = config(Algorithm::Fastslam2);
    config.sensor.change(|s| s.range_std_m = 0.1 * scale);
    config.sensor.change(|s| s.bearing_std_rad = 0.05 * scale);
    config.motion = Motion::Velocity(Velocity {
        speed_std_m_per_s: 0.4 * scale,
        yaw_rate_std_rad_per_s: 0.4 * scale,
        lateral_std_m_per_s: 0.4 * scale,
        noise_period_s: None,
        ..Velocity::default()
    });
    let seen = |off: f64| -> Vec<Sighting> {
        let sighting = |(n, point): (usize, &[f64; 2])| {
            let [x, y] = [point[0] - 0.3, point[1]];
            let (range_m, bearing_rad) = (x.hypot(y), y.atan2(x) - 0.2);
            let sign = if n % 2 == 0 { 1.0 } else { -0.6 };
            Sighting::range_bearing(range_m + 0.3 * off * sign, bearing_rad + 0.15 * off, Some(n as u32))
        };
        FIELD.iter().enumerate().map(sighting).collect()
    };
    let [forward, backward] = [false, true].map(|reversed| {
        let mut filter = FastSlam::new(config.clone(), Identities::All).unwrap();
        filter.update(0.0, &seen(0.0)).unwrap();
        filter.predict([0.0; 3], 1.0).unwrap();
        let mut scan = seen(scale);
        if reversed {
            scan.reverse();
        }
        filter.update(1.0, &scan).unwrap();
        filter.pose().mean
    });
    (forward.x - backward.x).abs().max((forward.y - backward.y).abs()).max((forward.heading - backward.heading).abs())
}

#[test]
fn the_order_within_a_scan_matters_only_to_the_order_of_the_linearisation() {
    // The expansion that is cut off is of second order: a quarter of the scale leaves a sixteenth.
    let (large, small) = (order_matters_by(1.0), order_matters_by(0.25));
    assert!(large > 1e-4, "orders differ by {large}: nothing to see");
    let ratio = large / small;
    assert!((8.0..80.0).contains(&ratio), "{large} at full scale, {small} at a quarter");
}
