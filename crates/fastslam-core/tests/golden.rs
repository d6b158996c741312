//! A small run against its recorded outcome, so that no change of the numbers goes unnoticed.
//!
//! After a change that is meant to alter them: `FASTSLAM_REFRESH_GOLDEN=1 cargo test -p fastslam-core --test golden`,
//! and say in the review why the numbers moved.

use crate::blind::Blind;
use fastslam_core::config::{Algorithm, Config};
use fastslam_core::run::run;
use fastslam_sim::{simulate, Identities, SimulationConfig};
use serde_json::{json, Map, Value};
use std::path::PathBuf;

/// How far each field may lie off: counts not at all; the rest by what rounding in another order or another compiler
/// makes of numbers of this size over 30 steps (about 1e-12 relative), with room to spare.
const TOLERANCES: [(&str, f64); 8] = [
    ("steps", 0.0),
    ("resamplings", 0.0),
    ("sightings_of_landmarks", 0.0),
    ("log_evidence", 1e-6),
    ("mean_effective_sample_size", 1e-6),
    ("final_pose", 1e-8),
    ("final_pose_std", 1e-8),
    ("landmarks_m", 1e-8),
];

fn outcome(algorithm: Algorithm, identities: Identities) -> Value {
    let mut simulation = SimulationConfig::preset("demo").unwrap();
    simulation.seed = 11;
    simulation.max_duration_s = Some(12.0);
    simulation.scan.period_s = 0.4;
    simulation.scan.identities = identities;
    let simulated = simulate(&simulation).unwrap();
    let log = simulated.log_data();
    let mut config =
        Config { seed: 1, algorithm, motion: simulated.motion, sensor: simulated.sensor, ..Config::default() };
    config.filter.particles = 25;
    if identities == Identities::All {
        // The algorithms as the papers have them.
        config.filter.rejuvenation.every_steps = Some(0);
    }
    let output = run(&config, &log, &mut Blind).unwrap();
    let last = output.steps.last().unwrap().pose;
    let count = output.steps.len() as f64;
    let total = |f: &dyn Fn(&fastslam_core::run::StepRecord) -> f64| output.steps.iter().map(f).sum::<f64>();
    let pose_std = [0, 1, 2].map(|i: usize| last.covariance[i][i].sqrt());
    json!({
        "steps": output.steps.len(),
        "resamplings": output.steps.iter().filter(|s| s.info.weighing.resampled).count(),
        "sightings_of_landmarks": output.map.landmarks.iter().map(|l| l.sightings).collect::<Vec<_>>(),
        "log_evidence": total(&|s| s.info.weighing.log_likelihood),
        "mean_effective_sample_size": total(&|s| s.info.weighing.effective_sample_size) / count,
        "final_pose": last.mean.to_array(),
        "final_pose_std": pose_std,
        "landmarks_m": output.map.landmarks.iter().map(|l| l.mean).collect::<Vec<_>>(),
    })
}

/// All cases by name.
fn outcomes() -> Map<String, Value> {
    let mut cases = Map::new();
    for (algorithm, name) in [(Algorithm::Fastslam1, "fastslam1"), (Algorithm::Fastslam2, "fastslam2")] {
        for (identities, mode) in [(Identities::All, "known"), (Identities::None, "unknown")] {
            cases.insert(format!("{name}_{mode}"), outcome(algorithm, identities));
        }
    }
    cases
}

fn numbers(value: &Value) -> Vec<f64> {
    match value {
        Value::Array(items) => items.iter().flat_map(numbers).collect(),
        other => vec![other.as_f64().expect("a number")],
    }
}

#[test]
fn small_runs_are_as_recorded() {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/golden/small_runs.json");
    let outcomes = outcomes();
    if std::env::var_os("FASTSLAM_REFRESH_GOLDEN").is_some() {
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(&path, serde_json::to_string_pretty(&outcomes).unwrap() + "\n").unwrap();
        return;
    }
    let recorded: Map<String, Value> = serde_json::from_str(&std::fs::read_to_string(&path).unwrap()).unwrap();
    assert_eq!(recorded.keys().collect::<Vec<_>>(), outcomes.keys().collect::<Vec<_>>());
    assert_eq!(recorded.len(), 4);
    for (case, outcome) in &outcomes {
        assert_eq!(outcome.as_object().unwrap().len(), TOLERANCES.len());
        for (field, tolerance) in TOLERANCES {
            let (expected, got) = (numbers(&recorded[case][field]), numbers(&outcome[field]));
            assert_eq!(expected.len(), got.len(), "{case}.{field}");
            assert!(!got.is_empty(), "{case}.{field} is empty");
            for (i, (e, g)) in expected.iter().zip(&got).enumerate() {
                assert!((e - g).abs() <= tolerance, "{case}.{field}[{i}]: recorded {e}, got {g}");
            }
        }
    }
}
