//! Instructions per particle and sighting of the inner loops, counted by valgrind: the same on a busy machine as on an
//! idle one.
//!
//! `cargo bench -p fastslam-sim --bench instructions [-- --bless]` compares with `benches/instructions.json` and fails
//! when a count has grown by more than the tolerance; `--bless` writes the file anew. It is skipped, with the reason,
//! where valgrind is missing or offers other vector units than those of the file. What is not measured: time, caches.

#![allow(clippy::expect_used, missing_docs)] // A benchmark that cannot run says so by failing.

use fastslam_core::association::{ExistenceForm, MergingRule, Method, Removal};
use fastslam_core::config::{Algorithm, Config};
use fastslam_core::filter::{FastSlam, Identities, Sighting};
use fastslam_core::geometry::Symmetric2;
use fastslam_core::landmark::{column, correct_rows, Correction, Measured, SensorPoses, Tail};
use fastslam_core::measurement::{Placing, RangeBearing};
use fastslam_core::motion::{Motion, Velocity};
use fastslam_core::store::RowsMut;
use fastslam_core::vector::Level;
use std::collections::BTreeMap;
use std::hint::black_box;
use std::path::{Path, PathBuf};
use std::process::{exit, Command};

const PARTICLES: usize = 256;
/// Landmarks in one scan.
const SCAN: u32 = 8;
const LANDMARKS: u32 = 64;
/// Time from scan to scan. The watch examines every fourth scan, and each one where they are more than 0.75 s apart.
const SCAN_PERIOD_S: f64 = 0.1;
/// Growth of a count that fails.
const TOLERANCE: f64 = 0.03;
const KERNELS: [&str; 8] =
    ["correction", "known 1.0", "known 2.0", "unknown 1.0", "unknown 2.0", "large scan", "small scan", "draw"];
/// Sightings of a large scan.
const LARGE_SCAN: u32 = 500;
/// Particles of the steps with one sighting or two, and landmarks around them.
const FEW_PARTICLES: u32 = 100;
const FEW_LANDMARKS: u32 = 16;
/// Steps before the first draw.
const DRAWN_STEPS: u32 = 50;

fn main() {
    let arguments: Vec<String> = std::env::args().collect();
    match arguments.iter().position(|argument| argument == "--kernel") {
        Some(at) => run(&arguments[at + 1], arguments[at + 2].parse().expect("a number of repetitions")),
        None => compare(arguments.iter().any(|argument| argument == "--bless")),
    }
}

/// Repeats a kernel; this is the process that valgrind watches.
fn run(kernel: &str, repetitions: u32) {
    match kernel {
        "level" => print!("{:?}", Level::available().last().expect("the baseline")),
        "correction" => correct(repetitions),
        "known 1.0" => step(Algorithm::Fastslam1, Identities::All, repetitions),
        "known 2.0" => step(Algorithm::Fastslam2, Identities::All, repetitions),
        "unknown 1.0" => step(Algorithm::Fastslam1, Identities::None, repetitions),
        "large scan" => scan_all(repetitions),
        "small scan" => scan_few(repetitions),
        "draw" => draw(repetitions),
        _ => step(Algorithm::Fastslam2, Identities::None, repetitions),
    }
}

/// As many corrections of one landmark in all maps as a scan has sightings.
fn correct(repetitions: u32) {
    let model = RangeBearing { range_std_m: 0.1, bearing_std_rad: 0.02 };
    let mut poses = SensorPoses::default();
    let along: Vec<f64> = (0..PARTICLES).map(|i| 1e-3 * i as f64).collect();
    poses.set(&along, &along, &along, Default::default());
    let measured = Measured { value: [5.0, 0.1], noise: model.noise_covariance(), tail: Tail::Gaussian };
    let mut values = vec![1.0; PARTICLES * column::COUNT];
    values[column::COV_XY * PARTICLES..][..PARTICLES].fill(0.1);
    values[column::MEAN_X * PARTICLES..][..PARTICLES].fill(5.0);
    let mut log_likelihood = vec![0.0; PARTICLES];
    for _ in 0..repetitions * SCAN {
        let rows = RowsMut::new(black_box(&mut values), PARTICLES);
        correct_rows(&Correction { model: &model, poses: &poses, measured, mask: None }, rows, &mut log_likelihood);
    }
    black_box(log_likelihood);
}

/// A robot at rest.
fn config(algorithm: Algorithm) -> Config {
    let mut config = Config { algorithm, seed: 1, ..Config::default() };
    config.filter.particles = PARTICLES as u32;
    // The plain filter: what draws cost is measured apart.
    config.filter.rejuvenation.every_steps = Some(0);
    config.sensor.change(|s| s.max_range_m = 100.0);
    config.motion = Motion::Velocity(Velocity { noise_period_s: Some(0.1), ..Velocity::default() });
    config
}

/// Landmark `n` of rings of so many landmarks, some metres apart.
fn sighting(n: u32, around: u32, apart_m: f64) -> Sighting {
    let (ring, place) = (n / around, n % around);
    let bearing_rad = std::f64::consts::TAU * (f64::from(place) / f64::from(around) - 0.49);
    let noise = Some(Symmetric2::new(0.01, 0.0, 4e-4));
    Sighting { noise, ..Sighting::range_bearing(10.0 + apart_m * f64::from(ring), bearing_rad, None) }
}

/// Scan `step` of eight of all landmarks.
fn some(step: u32, identities: Identities) -> Vec<Sighting> {
    let named = |n: u32| Sighting { identity: (identities == Identities::All).then_some(n), ..sighting(n, 16, 6.0) };
    (0..SCAN).map(|j| named((7 * step + 13 * j) % LANDMARKS)).collect()
}

/// A filter that has seen these landmarks once.
fn begun(config: Config, identities: Identities, everything: &[Sighting]) -> FastSlam {
    let mut filter = FastSlam::new(config, identities).expect("a valid configuration");
    filter.update(0.0, everything).expect("new landmarks");
    filter
}

/// Whole steps: motion, a scan, weights, resampling below half of the particles.
fn steps(filter: &mut FastSlam, repetitions: u32, scan: impl Fn(u32) -> Vec<Sighting>) {
    for step in 1..=repetitions {
        filter.predict([0.0; 3], 0.01).expect("a valid control");
        black_box(filter.update(SCAN_PERIOD_S * f64::from(step), &scan(step)).expect("explained"));
    }
}

fn step(algorithm: Algorithm, identities: Identities, repetitions: u32) {
    let named = |n| Sighting { identity: (identities == Identities::All).then_some(n), ..sighting(n, 16, 6.0) };
    let everything: Vec<Sighting> = (0..LANDMARKS).map(named).collect();
    let mut filter = begun(config(algorithm), identities, &everything);
    steps(&mut filter, repetitions, |step| some(step, identities));
}

/// Steps that see many landmarks at once.
fn scan_all(repetitions: u32) {
    let everything: Vec<Sighting> = (0..LARGE_SCAN).map(|n| sighting(n, 50, 3.0)).collect();
    let mut filter = begun(config(Algorithm::Fastslam2), Identities::None, &everything);
    steps(&mut filter, repetitions, |_| everything.clone());
}

/// Steps that see one landmark or two, as UTIAS has them: drawn associations, odds that landmarks exist, and those that
/// are one.
fn scan_few(repetitions: u32) {
    let mut settings = config(Algorithm::Fastslam2);
    settings.filter.particles = FEW_PARTICLES;
    settings.filter.likelihood_exponent = 0.3;
    settings.sensor.change(|s| s.tail_degrees_of_freedom = Some(4.0));
    let association = &mut settings.association;
    association.method = Method::Sampled;
    association.detection_probability = Some(0.3);
    association.clutter_density = Some(1e-3);
    association.new_landmark_density = Some(1e-3);
    association.existence.form = ExistenceForm::Bayes;
    association.existence.removal = Removal::WhenMissed;
    association.merging.rule = MergingRule::Nearby;
    let around = |n: u32| sighting(n % FEW_LANDMARKS, FEW_LANDMARKS, 6.0);
    let everything: Vec<Sighting> = (0..FEW_LANDMARKS).map(around).collect();
    let mut filter = begun(settings, Identities::None, &everything);
    steps(&mut filter, repetitions, |step| (0..1 + step % 2).map(|j| around(7 * step + 5 * j)).collect());
}

/// Draws of the whole path of fifty steps or some more, with landmarks given each.
fn draw(repetitions: u32) {
    let mut settings = config(Algorithm::Fastslam2);
    settings.filter.rejuvenation.every_steps = Some(u32::MAX);
    let mut filter = FastSlam::new(settings, Identities::All).expect("a valid configuration");
    steps(&mut filter, DRAWN_STEPS, |step| some(step, Identities::All));
    for step in DRAWN_STEPS + 1..=DRAWN_STEPS + repetitions {
        let stamp_s = SCAN_PERIOD_S * f64::from(step);
        filter.update(stamp_s, &some(step, Identities::All)).expect("explained");
        assert!(filter.rejuvenate(), "a draw");
    }
}

fn baseline_path() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("benches/instructions.json")
}

/// Counts all kernels and compares them with the file, or writes it.
fn compare(bless: bool) {
    let Some(level) = watched("level", 1).map(|(_, level)| level) else {
        println!("skipped: valgrind is not installed or cannot run this program");
        return;
    };
    let mut counts: BTreeMap<String, f64> = BTreeMap::new();
    for kernel in KERNELS {
        match count(kernel) {
            Some(instructions) => drop(counts.insert(format!("{level} {kernel}"), instructions)),
            None => println!("skipped: {kernel}: this valgrind does not know all of its instructions"),
        }
    }
    let path = baseline_path();
    if bless {
        let text = serde_json::to_string_pretty(&counts).expect("numbers");
        std::fs::write(&path, text + "\n").expect("a writable baseline");
    }
    let text = std::fs::read_to_string(&path).expect("a baseline");
    let baseline: BTreeMap<String, f64> = serde_json::from_str(&text).expect("numbers by kernel");
    let mut grown = false;
    println!("instructions per particle and sighting (baseline, change)");
    for (kernel, now) in &counts {
        match baseline.get(kernel) {
            Some(before) => {
                let change = now / before - 1.0;
                grown |= change > TOLERANCE;
                println!("{kernel:>22} {now:8.1} {before:8.1} {:+6.1} %", 100.0 * change);
            }
            None => println!("{kernel:>22} {now:8.1}  skipped: the baseline has no count for this vector unit"),
        }
    }
    let of = |kernel: &str| counts.get(&format!("{level} {kernel}"));
    if let (Some(large), Some(ordinary)) = (of("large scan"), of("unknown 2.0")) {
        println!("a sighting of {LARGE_SCAN} costs {:.2} times one of {SCAN}", large / ordinary);
    }
    if grown {
        eprintln!("a count has grown by more than {} %; if that is meant, run with --bless", 100.0 * TOLERANCE);
        exit(1);
    }
}

/// Instructions of one more repetition, per particle and sighting: start and preparation cancel out.
fn count(kernel: &str) -> Option<f64> {
    let ([few, many], sightings) = match kernel {
        "large scan" => ([1, 2], f64::from(LARGE_SCAN) * PARTICLES as f64),
        "small scan" => ([100, 300], 1.5 * f64::from(FEW_PARTICLES)),
        "draw" => ([1, 5], f64::from(SCAN * DRAWN_STEPS) * PARTICLES as f64),
        _ => ([20, 60], f64::from(SCAN) * PARTICLES as f64),
    };
    let total = |repetitions| watched(kernel, repetitions).map(|(instructions, _)| instructions);
    Some((total(many)? - total(few)?) / (f64::from(many - few) * sightings))
}

/// Instructions of this program with one kernel under valgrind, and what it printed.
fn watched(kernel: &str, repetitions: u32) -> Option<(f64, String)> {
    let this = std::env::current_exe().ok()?;
    let output = Command::new("valgrind")
        .args(["--tool=callgrind", "--callgrind-out-file=/dev/null"])
        .arg(this)
        .args(["--kernel", kernel, &repetitions.to_string()])
        .output()
        .ok()
        .filter(|output| output.status.success())?;
    let messages = String::from_utf8_lossy(&output.stderr);
    let collected = messages.lines().find_map(|line| line.split_once("Collected :"))?.1;
    Some((collected.trim().parse().ok()?, String::from_utf8_lossy(&output.stdout).into_owned()))
}
