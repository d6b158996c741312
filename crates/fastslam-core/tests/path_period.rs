//! Runs over whole logs whose rows are cut in more or fewer parts: what comes out must be the same.

use crate::blind::Blind;
use fastslam_core::config::{Algorithm, Config};
use fastslam_core::motion::{Ackermann, Correction, Increments, Motion, Odometry, Proportional, Velocity};
use fastslam_core::run::{run, RunOutput};
use fastslam_sim::{simulate, SimulatedLog, SimulationConfig};

const CORRECTION: Correction = Correction { distance_gain: 1.05, turn_gain: 0.8, yaw_rate_bias_rad_per_s: 0.01 };
const PROPORTIONAL: Proportional = Proportional {
    distance_std_m_per_sqrt_m: 0.02,
    lateral_std_m_per_sqrt_m: 0.02,
    turn_std_rad_per_sqrt_m: 0.01,
    turn_std_rad_per_sqrt_rad: 0.05,
};

/// Every model with gains, bias and noise in proportion, and one without noise period.
fn motions() -> [Motion; 5] {
    let (correction, proportional) = (CORRECTION, PROPORTIONAL);
    [
        Motion::Velocity(Velocity::default()),
        Motion::Velocity(Velocity { noise_period_s: Some(0.1), correction, proportional, ..Velocity::default() }),
        Motion::Ackermann(Ackermann {
            speed_std_m_per_s: 0.2,
            steering_gain: 0.9,
            steering_bias_rad: 0.02,
            correction,
            proportional,
            ..Ackermann::default()
        }),
        Motion::Increments(Increments { correction, proportional, ..Increments::default() }),
        Motion::Odometry(Odometry { correction, proportional, ..Odometry::default() }),
    ]
}

/// A log with rows of one second and a scan every two.
fn log_of(motion: Motion) -> SimulatedLog {
    let mut simulation = SimulationConfig::preset("demo").unwrap();
    simulation.seed = 4;
    simulation.control_period_s = 1.0;
    simulation.vehicle.speed_m_per_s = 1.0;
    simulation.scan.period_s = 2.0;
    simulation.max_duration_s = Some(40.0);
    simulation.motion = motion;
    simulate(&simulation).unwrap()
}

fn config_for(log: &SimulatedLog, algorithm: Algorithm, path_period_s: f64, seed: u64) -> Config {
    let mut config =
        Config { seed, algorithm, motion: log.motion.clone(), sensor: log.sensor.clone(), ..Config::default() };
    config.filter.particles = 20;
    config.filter.path_period_s = path_period_s;
    config
}

fn run_with(log: &SimulatedLog, algorithm: Algorithm, path_period_s: f64, seed: u64) -> RunOutput {
    run(&config_for(log, algorithm, path_period_s, seed), &log.log_data(), &mut Blind).unwrap()
}

fn evidence(output: &RunOutput) -> f64 {
    output.steps.iter().map(|step| step.info.weighing.log_likelihood).sum()
}

#[test]
fn the_period_of_the_path_changes_no_figure_of_a_run() {
    let mut compared = 0;
    for (motion, algorithm) in
        motions().iter().flat_map(|m| [Algorithm::Fastslam2, Algorithm::Ekf].map(|a| (m.clone(), a)))
    {
        let log = log_of(motion);
        let whole = run_with(&log, algorithm, 5.0, 1);
        let scans: Vec<_> = whole.steps.iter().filter(|step| step.info.sightings > 0).collect();
        assert!(scans.len() > 15, "{} scans", scans.len());
        for period_s in [0.5, 0.05] {
            let cut = run_with(&log, algorithm, period_s, 1);
            assert!(cut.steps.len() > 3 * whole.steps.len(), "rows were not cut");
            let apart = (evidence(&cut) - evidence(&whole)).abs();
            assert!(apart < 1e-9, "{algorithm:?} {:?} at {period_s}: evidence off by {apart}", log.motion);
            let again: Vec<_> = cut.steps.iter().filter(|step| step.info.sightings > 0).collect();
            assert_eq!(again.len(), scans.len());
            for (a, b) in again.iter().zip(&scans) {
                let apart = (a.pose.mean.x - b.pose.mean.x).hypot(a.pose.mean.y - b.pose.mean.y);
                assert!(apart < 1e-9, "{algorithm:?} {:?} at {period_s}: pose off by {apart}", log.motion);
                let (wide, narrow) = (a.pose.covariance[2][2], b.pose.covariance[2][2]);
                assert!((wide - narrow).abs() < 1e-9, "{wide} against {narrow}");
                compared += 1;
            }
        }
    }
    assert!(compared > 5 * 2 * 2 * 15, "{compared}");
}

#[test]
fn the_period_of_the_path_changes_samples_only_by_chance() {
    // FastSLAM 1.0 draws at every part: other numbers, the same distribution. 40 seeds each; four standard errors of the
    // difference, which one comparison in 16,000 exceeds by chance.
    for motion in [motions()[0].clone(), motions()[3].clone()] {
        let log = log_of(motion);
        let moments = |period_s: f64| {
            let values: Vec<f64> =
                (0..40).map(|seed| evidence(&run_with(&log, Algorithm::Fastslam1, period_s, seed))).collect();
            let mean = values.iter().sum::<f64>() / 40.0;
            (mean, values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (39.0 * 40.0))
        };
        let (whole, cut) = (moments(5.0), moments(0.1));
        let bound = 4.0 * (whole.1 + cut.1).sqrt();
        assert!((whole.0 - cut.0).abs() < bound, "{:?}: {whole:?} against {cut:?}", log.motion);
    }
}

#[test]
fn a_covariance_that_rows_state_stands_in_place_of_the_configured_noise() {
    let told = Increments { x_std_m: 0.03, y_std_m: 0.04, heading_std_rad: 0.02, ..Increments::default() };
    let stated = [[0.03_f64 * 0.03, 0.0, 0.0], [0.0, 0.04 * 0.04, 0.0], [0.0, 0.0, 0.02 * 0.02]];
    let log = log_of(Motion::Increments(told));
    for algorithm in [Algorithm::Fastslam1, Algorithm::Fastslam2, Algorithm::Ekf] {
        let mut config = config_for(&log, algorithm, 0.3, 1);
        let mut data = log.log_data();
        let by_config = evidence(&run(&config, &data, &mut Blind).unwrap());
        config.motion = Motion::Increments(Increments {
            x_std_m: 0.5,
            heading_std_rad: 0.3,
            proportional: PROPORTIONAL,
            ..Increments::default()
        });
        let by_other = evidence(&run(&config, &data, &mut Blind).unwrap());
        data.control_covariances = vec![Some(stated); data.controls.len()];
        let output = run(&config, &data, &mut Blind).unwrap();
        assert!(
            (evidence(&output) - by_config).abs() < 1e-9,
            "{algorithm:?}: {} against {by_config}",
            evidence(&output)
        );
        assert!((by_other - by_config).abs() > 1.0, "{algorithm:?}: the noise does not matter here");
        // Every second row states it: the others have the noise of the configuration.
        (0..data.controls.len()).step_by(2).for_each(|i| data.control_covariances[i] = None);
        let mixed = evidence(&run(&config, &data, &mut Blind).unwrap());
        assert!((mixed - by_config).abs() > 1.0 && (mixed - by_other).abs() > 1.0, "{algorithm:?}: {mixed}");
    }
}

#[test]
fn rows_that_state_their_covariance_may_be_cut_and_may_be_certain() {
    let log = log_of(Motion::Increments(Increments::default()));
    let stated = [[0.01, 0.002, 0.001], [0.002, 0.02, 0.003], [0.001, 0.003, 0.004]];
    for algorithm in [Algorithm::Fastslam2, Algorithm::Ekf] {
        let run_cut = |covariance, path_period_s| {
            let mut data = log.log_data();
            data.control_covariances = vec![Some(covariance); data.controls.len()];
            evidence(&run(&config_for(&log, algorithm, path_period_s, 1), &data, &mut Blind).unwrap())
        };
        let (whole, cut) = (run_cut(stated, 5.0), run_cut(stated, 0.05));
        assert!((whole - cut).abs() < 1e-9, "{algorithm:?}: {whole} against {cut}");
        assert!(run_cut([[0.0; 3]; 3], 5.0).is_finite());
    }
}
