//! Time per stage of the filter: motion, known update, unknown association, resampling; per store, particles and
//! landmarks. One iteration is one call for all particles.
//!
//! `cargo bench -p fastslam-core --bench stages` in an otherwise idle machine. What is not measured: reading logs, the
//! first sighting of each landmark, memory.

#![allow(clippy::expect_used, missing_docs)] // A benchmark that cannot run says so by failing.

use criterion::{criterion_group, criterion_main, BatchSize, BenchmarkId, Criterion, Throughput};
use fastslam_core::config::{Algorithm, Config};
use fastslam_core::filter::{FastSlam, Identities, Sighting};
use fastslam_core::geometry::{Pose, Symmetric2};
use fastslam_core::landmark::{correct, Gaussian, Measured, Tail};
use fastslam_core::math;
use fastslam_core::measurement::{MeasurementModel, RangeBearing};
use fastslam_core::motion::{Motion, PoseColumns, Velocity};
use fastslam_core::random::{Purpose, RandomSource};
use fastslam_core::resampling::{resample, ResamplingScheme};
use fastslam_core::store::StoreKind;
use fastslam_core::vector::{vectorized_at, Level};
use std::hint::black_box;
use std::time::Duration;

const PARTICLES: [u32; 2] = [100, 1000];
const LANDMARKS: [u32; 2] = [100, 1000];
/// Landmarks in one scan.
const SCAN: u32 = 5;

/// Every store that this build knows, by its name in a configuration.
fn stores() -> Vec<(&'static str, StoreKind)> {
    let known = |name: &'static str| serde_json::from_str(&format!("\"{name}\"")).ok().map(|kind| (name, kind));
    ["dense", "tree", "lineage"].into_iter().filter_map(known).collect()
}

/// The landmarks stand in rings about the origin, 2 m apart or more, so that sightings from there are unambiguous.
fn sighting(n: u32, identities: Identities) -> Sighting {
    let (ring, place) = (n / 40, n % 40);
    let range_m = 15.0 + 2.5 * f64::from(ring);
    let bearing_rad = std::f64::consts::TAU * (f64::from(place) / 40.0 - 0.49);
    Sighting::range_bearing(range_m, bearing_rad, (identities == Identities::All).then_some(n))
}

fn filter(
    algorithm: Algorithm,
    identities: Identities,
    store: StoreKind,
    [m, k]: [u32; 2],
    threshold: f64,
) -> FastSlam {
    let mut config = Config { algorithm, seed: 1, ..Config::default() };
    config.filter.particles = m;
    // The plain filter: what draws cost is measured elsewhere.
    config.filter.rejuvenation.every_steps = Some(0);
    config.filter.store = store;
    config.filter.resampling.threshold = threshold;
    config.sensor.max_range_m = 1000.0;
    config.motion = Motion::Velocity(Velocity { lateral_std_m_per_s: 0.05, ..Velocity::default() });
    let mut filter = FastSlam::new(config, identities).expect("a valid configuration");
    let everything: Vec<Sighting> = (0..k).map(|n| sighting(n, identities)).collect();
    let info = filter.update(0.0, &everything).expect("new landmarks");
    assert_eq!(info.changes.new_landmarks, k);
    filter
}

fn scan_at(step: u32, k: u32, identities: Identities) -> Vec<Sighting> {
    (0..SCAN).map(|j| sighting((7 * step + 13 * j) % k, identities)).collect()
}

/// One step (control and scan of five) at rest, with resampling below half of the particles.
fn steps(c: &mut Criterion) {
    for (name, algorithm, identities) in [
        ("known 1.0", Algorithm::Fastslam1, Identities::All),
        ("known 2.0", Algorithm::Fastslam2, Identities::All),
        ("unknown 1.0", Algorithm::Fastslam1, Identities::None),
        ("unknown 2.0", Algorithm::Fastslam2, Identities::None),
    ] {
        let mut group = c.benchmark_group(format!("step/{name}"));
        for (store_name, store) in stores() {
            for m in PARTICLES {
                for k in LANDMARKS {
                    group.throughput(Throughput::Elements(u64::from(m * SCAN)));
                    let id = BenchmarkId::new(store_name, format!("M={m} K={k}"));
                    group.bench_function(id, |b| {
                        let mut filter = filter(algorithm, identities, store, [m, k], 0.5);
                        let mut step = 0;
                        b.iter(|| {
                            step += 1;
                            filter.predict([0.0; 3], 0.01).expect("a valid control");
                            let scan = scan_at(step, k, identities);
                            black_box(filter.update(f64::from(step), &scan).expect("explained"))
                        });
                    });
                }
            }
        }
    }
}

fn motion_sampling(c: &mut Criterion) {
    let mut group = c.benchmark_group("motion sampling");
    let motion = Motion::default().row([1.0, 0.1, 0.0], 0.1).part(1.0);
    for m in PARTICLES {
        let zero = vec![0.0; m as usize];
        let (mut x, mut y, mut heading) = (zero.clone(), zero.clone(), zero);
        let mut step = 0;
        group.throughput(Throughput::Elements(u64::from(m)));
        group.bench_function(BenchmarkId::from_parameter(format!("M={m}")), |b| {
            b.iter(|| {
                step += 1;
                let stream = RandomSource::new(1).stream(Purpose::Motion, step);
                let poses = PoseColumns { first_particle: 0, x: &mut x, y: &mut y, heading: &mut heading };
                motion.sample(stream, poses);
            });
        });
    }
}

/// Ancestors of unequal weights, and what a store does with them after one landmark was touched.
fn resampling(c: &mut Criterion) {
    let mut group = c.benchmark_group("resampling");
    for m in PARTICLES {
        let weights: Vec<f64> = (0..m).map(|i| f64::from(1 + i % 7)).collect();
        let total: f64 = weights.iter().sum();
        let weights: Vec<f64> = weights.iter().map(|w| w / total).collect();
        let draw = |step: u64, ancestors: &mut Vec<u32>| {
            let stream = RandomSource::new(1).stream(Purpose::Resampling, step);
            resample(ResamplingScheme::Systematic, &weights, m as usize, stream, ancestors);
        };
        group.throughput(Throughput::Elements(u64::from(m)));
        group.bench_function(BenchmarkId::new("ancestors", format!("M={m}")), |b| {
            let (mut step, mut ancestors) = (0, Vec::new());
            b.iter(|| {
                step += 1;
                draw(step, &mut ancestors);
            });
        });
        for (name, kind) in stores() {
            for k in LANDMARKS {
                group.bench_function(BenchmarkId::new(name, format!("M={m} K={k}")), |b| {
                    let mut store = kind.create(m as usize, 6);
                    (0..k).for_each(|slot| store.insert(slot, &vec![1.0; 6 * m as usize]));
                    let mut ancestors = Vec::new();
                    draw(0, &mut ancestors);
                    b.iter_batched(|| (), |()| store.resample(&ancestors), BatchSize::SmallInput);
                });
            }
        }
    }
}

/// The correction of one landmark in all maps with each set of vector instructions, and the functions in it beside
/// those of the system's library.
fn kernels(c: &mut Criterion) {
    const M: usize = 256;
    let mut group = c.benchmark_group("kernels");
    group.throughput(Throughput::Elements(M as u64));
    let model = RangeBearing { range_std_m: 0.1, bearing_std_rad: 0.02 };
    let measured = Measured { value: [5.0, 0.1], noise: model.noise_covariance(), tail: Tail::Gaussian };
    let x: Vec<f64> = (0..M).map(|i| 1e-3 * i as f64).collect();
    for level in Level::available() {
        group.bench_function(BenchmarkId::new("correction", format!("{level:?}")), |b| {
            let mut columns = [5.0, 0.5, 0.1, 0.01, 0.1, 0.0].map(|value| vec![value; M]);
            b.iter(|| {
                let [mean_x, mean_y, xx, xy, yy, fit] = columns.each_mut().map(|column| &mut column[..M]);
                let x = &black_box(&x)[..M];
                vectorized_at(
                    level,
                    #[inline(always)]
                    || {
                        for i in 0..M {
                            let covariance = Symmetric2::new(xx[i], xy[i], yy[i]);
                            let before = Gaussian { mean: [mean_x[i], mean_y[i]], covariance };
                            let (after, how) = correct(&model, Pose::new(x[i], x[i], x[i]), measured, before);
                            [mean_x[i], mean_y[i]] = after.mean;
                            (xx[i], xy[i], yy[i]) = (after.covariance.xx, after.covariance.xy, after.covariance.yy);
                            fit[i] = how.log_likelihood;
                        }
                    },
                );
            });
        });
        group.bench_function(BenchmarkId::new("correction, an array of structures", format!("{level:?}")), |b| {
            let mut rows = vec![[5.0, 0.5, 0.1, 0.01, 0.1, 0.0]; M];
            b.iter(|| {
                let (x, rows) = (&black_box(&x)[..M], &mut rows[..M]);
                vectorized_at(
                    level,
                    #[inline(always)]
                    || {
                        for (x, row) in x.iter().zip(rows) {
                            let covariance = Symmetric2::new(row[2], row[3], row[4]);
                            let before = Gaussian { mean: [row[0], row[1]], covariance };
                            let (after, how) = correct(&model, Pose::new(*x, *x, *x), measured, before);
                            let s = after.covariance;
                            *row = [after.mean[0], after.mean[1], s.xx, s.xy, s.yy, how.log_likelihood];
                        }
                    },
                );
            });
        });
        group.bench_function(BenchmarkId::new("atan2 + ln, polynomials", format!("{level:?}")), |b| {
            let mut out = vec![0.0; M];
            b.iter(|| {
                let (x, out) = (&black_box(&x)[..M], &mut out[..M]);
                vectorized_at(
                    level,
                    #[inline(always)]
                    || (0..M).for_each(|i| out[i] = math::atan2(x[i], 2.0) + math::ln(1.0 + x[i])),
                );
            });
        });
    }
    group.bench_function("correction, one particle after the other", |b| {
        let mut rows = vec![[5.0, 0.5, 0.1, 0.01, 0.1, 0.0]; M];
        b.iter(|| {
            for (x, row) in black_box(&x).iter().zip(&mut rows) {
                let before = Gaussian { mean: [row[0], row[1]], covariance: Symmetric2::new(row[2], row[3], row[4]) };
                // Nothing is known of the number, so that each particle is done alone.
                let x = black_box(*x);
                let (after, how) = correct(&model, Pose::new(x, x, x), measured, before);
                let s = after.covariance;
                *row = [after.mean[0], after.mean[1], s.xx, s.xy, s.yy, how.log_likelihood];
            }
        });
    });
    group.bench_function("atan2 + ln, system library", |b| {
        let mut out = vec![0.0; M];
        b.iter(|| {
            let (x, out) = (&black_box(&x)[..M], &mut out[..M]);
            (0..M).for_each(|i| out[i] = x[i].atan2(2.0) + (1.0 + x[i]).ln());
        });
    });
}

fn short() -> Criterion {
    Criterion::default()
        .sample_size(10)
        .warm_up_time(Duration::from_millis(100))
        .measurement_time(Duration::from_millis(300))
}

criterion_group! { name = stages; config = short(); targets = kernels, motion_sampling, resampling, steps }
criterion_main!(stages);
