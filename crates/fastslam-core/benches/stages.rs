//! Time per stage of the filter: motion, known update, unknown association, resampling; per store, particles and
//! landmarks. One iteration is one call for all particles.
//!
//! `cargo bench -p fastslam-core --bench stages [-- PART OF A NAME]` in an otherwise idle machine. What is not measured:
//! reading logs, the first sighting of each landmark, memory.

#![allow(clippy::expect_used, missing_docs)] // A benchmark that cannot run says so by failing.

use fastslam_core::config::{Algorithm, Config};
use fastslam_core::filter::{FastSlam, Identities, Sighting};
use fastslam_core::geometry::{Pose, Symmetric2};
use fastslam_core::landmark::{correct, Gaussian, Measured, Tail};
use fastslam_core::math;
use fastslam_core::measurement::{Placing, RangeBearing};
use fastslam_core::motion::{Motion, PoseColumns, Velocity};
use fastslam_core::random::{Purpose, RandomSource};
use fastslam_core::resampling::{resample, ResamplingScheme};
use fastslam_core::store::StoreKind;
use fastslam_core::vector::{vectorized_at, Level};
use std::hint::black_box;
use std::time::{Duration, Instant};

const PARTICLES: [u32; 2] = [100, 1000];
const LANDMARKS: [u32; 2] = [100, 1000];
/// Landmarks in one scan.
const SCAN: u32 = 5;

/// Samples of a stage, and how long one lasts at least.
const SAMPLES: usize = 10;
const SAMPLE: Duration = Duration::from_millis(30);

fn main() {
    let wanted = Wanted(std::env::args().skip(1).find(|argument| !argument.starts_with('-')));
    println!("least and median time of a call, and of the least per element");
    kernels(&wanted);
    motion_sampling(&wanted);
    resampling(&wanted);
    steps(&wanted);
}

/// A part of the names of the stages that are measured; none: all are.
struct Wanted(Option<String>);

impl Wanted {
    /// Prints what a call of `prepare`'s result takes; `elements` are worked on in one call.
    fn time<F: FnMut()>(&self, name: &str, elements: u32, prepare: impl FnOnce() -> F) {
        if self.0.as_ref().is_some_and(|part| !name.contains(part)) {
            return;
        }
        let mut call = prepare();
        let mut calls_for = |calls: u32| {
            let start = Instant::now();
            (0..calls).for_each(|_| call());
            start.elapsed()
        };
        let mut calls = 1;
        while calls_for(calls) < SAMPLE {
            calls *= 2;
        }
        let mut samples_ns = [0.0; SAMPLES].map(|_| calls_for(calls).as_secs_f64() * 1e9 / f64::from(calls));
        samples_ns.sort_unstable_by(f64::total_cmp);
        let (least, median) = (samples_ns[0], samples_ns[SAMPLES / 2]);
        println!("{name:<60} {least:12.0} ns {median:12.0} ns {:9.2} ns", least / f64::from(elements));
    }
}

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
    config.sensor.change(|s| s.max_range_m = 1000.0);
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
fn steps(wanted: &Wanted) {
    for (name, algorithm, identities) in [
        ("known 1.0", Algorithm::Fastslam1, Identities::All),
        ("known 2.0", Algorithm::Fastslam2, Identities::All),
        ("unknown 1.0", Algorithm::Fastslam1, Identities::None),
        ("unknown 2.0", Algorithm::Fastslam2, Identities::None),
    ] {
        for ((store_name, store), m, k) in sizes() {
            wanted.time(&format!("step/{name}/{store_name}/M={m} K={k}"), m * SCAN, || {
                let mut filter = filter(algorithm, identities, store, [m, k], 0.5);
                let mut step = 0;
                move || {
                    step += 1;
                    filter.predict([0.0; 3], 0.01).expect("a valid control");
                    let scan = scan_at(step, k, identities);
                    black_box(filter.update(f64::from(step), &scan).expect("explained"));
                }
            });
        }
    }
}

/// Every store with every number of particles and of landmarks.
fn sizes() -> impl Iterator<Item = ((&'static str, StoreKind), u32, u32)> {
    let of_store = |store| PARTICLES.into_iter().flat_map(move |m| LANDMARKS.map(|k| (store, m, k)));
    stores().into_iter().flat_map(of_store)
}

fn motion_sampling(wanted: &Wanted) {
    for m in PARTICLES {
        wanted.time(&format!("motion sampling/M={m}"), m, || {
            let motion = Motion::default().row([1.0, 0.1, 0.0], 0.1).part(1.0);
            let zero = vec![0.0; m as usize];
            let (mut x, mut y, mut heading) = (zero.clone(), zero.clone(), zero);
            let mut step = 0;
            move || {
                step += 1;
                let stream = RandomSource::new(1).stream(Purpose::Motion, step);
                let poses = PoseColumns { first_particle: 0, x: &mut x, y: &mut y, heading: &mut heading };
                motion.sample(stream, poses);
            }
        });
    }
}

/// Ancestors of unequal weights.
fn draw_ancestors(m: u32, step: u64, ancestors: &mut Vec<u32>) {
    let weights: Vec<f64> = (0..m).map(|i| f64::from(1 + i % 7)).collect();
    let total: f64 = weights.iter().sum();
    let weights: Vec<f64> = weights.iter().map(|w| w / total).collect();
    let stream = RandomSource::new(1).stream(Purpose::Resampling, step);
    resample(ResamplingScheme::Systematic, &weights, m as usize, stream, ancestors);
}

/// Ancestors of unequal weights, and what a store does with them.
fn resampling(wanted: &Wanted) {
    for m in PARTICLES {
        wanted.time(&format!("resampling/ancestors/M={m}"), m, || {
            let (mut step, mut ancestors) = (0, Vec::new());
            move || {
                step += 1;
                draw_ancestors(m, step, &mut ancestors);
            }
        });
    }
    for ((name, kind), m, k) in sizes() {
        wanted.time(&format!("resampling/{name}/M={m} K={k}"), m, || {
            let mut store = kind.create(m as usize, 6);
            (0..k).for_each(|slot| store.insert(slot, &vec![1.0; 6 * m as usize]));
            let mut ancestors = Vec::new();
            draw_ancestors(m, 0, &mut ancestors);
            move || store.resample(&ancestors)
        });
    }
}

/// The correction of one landmark in all maps with each set of vector instructions, and the functions in it beside
/// those of the system's library.
fn kernels(wanted: &Wanted) {
    let model = RangeBearing { range_std_m: 0.1, bearing_std_rad: 0.02 };
    let measured = Measured { value: [5.0, 0.1], noise: model.noise_covariance(), tail: Tail::Gaussian };
    let x: Vec<f64> = (0..KERNEL_PARTICLES).map(|i| 1e-3 * i as f64).collect();
    for level in Level::available() {
        corrections(wanted, level, &model, measured, &x);
        time_kernel(wanted, &format!("atan2 + ln, polynomials/{level:?}"), || {
            let mut out = vec![0.0; x.len()];
            let x = &x;
            move || {
                let (x, out) = (&black_box(x)[..KERNEL_PARTICLES], &mut out[..KERNEL_PARTICLES]);
                vectorized_at(
                    level,
                    #[inline(always)]
                    || (0..KERNEL_PARTICLES).for_each(|i| out[i] = math::atan2(x[i], 2.0) + math::ln(1.0 + x[i])),
                );
            }
        });
    }
    time_kernel(wanted, "correction, one particle after the other", || {
        let mut rows = vec![ROW; x.len()];
        let (x, model) = (&x, &model);
        move || {
            for (x, row) in black_box(x).iter().zip(&mut rows) {
                // Nothing is known of the number, so that each particle is done alone.
                correct_row(model, black_box(*x), measured, row);
            }
        }
    });
    time_kernel(wanted, "atan2 + ln, system library", || {
        let mut out = vec![0.0; x.len()];
        let x = &x;
        move || {
            let (x, out) = (&black_box(x)[..KERNEL_PARTICLES], &mut out[..KERNEL_PARTICLES]);
            (0..KERNEL_PARTICLES).for_each(|i| out[i] = x[i].atan2(2.0) + (1.0 + x[i]).ln());
        }
    });
}

const KERNEL_PARTICLES: usize = 256;
/// A landmark: mean, covariance, and the fit of its last sighting.
const ROW: [f64; 6] = [5.0, 0.5, 0.1, 0.01, 0.1, 0.0];

fn time_kernel<F: FnMut()>(wanted: &Wanted, name: &str, prepare: impl FnOnce() -> F) {
    wanted.time(&format!("kernels/{name}"), KERNEL_PARTICLES as u32, prepare);
}

#[inline(always)]
fn correct_row(model: &RangeBearing, x: f64, measured: Measured, row: &mut [f64; 6]) {
    let before = Gaussian { mean: [row[0], row[1]], covariance: Symmetric2::new(row[2], row[3], row[4]) };
    let (after, how) = correct(model, Pose::new(x, x, x), measured, before);
    let s = after.covariance;
    *row = [after.mean[0], after.mean[1], s.xx, s.xy, s.yy, how.log_likelihood];
}

/// The correction with the numbers of all particles side by side, and with those of each particle side by side.
fn corrections(wanted: &Wanted, level: Level, model: &RangeBearing, measured: Measured, x: &[f64]) {
    time_kernel(wanted, &format!("correction/{level:?}"), || {
        let mut columns = ROW.map(|value| vec![value; x.len()]);
        move || {
            let [mean_x, mean_y, xx, xy, yy, fit] = columns.each_mut().map(|column| &mut column[..KERNEL_PARTICLES]);
            let x = &black_box(x)[..KERNEL_PARTICLES];
            vectorized_at(
                level,
                #[inline(always)]
                || {
                    for i in 0..KERNEL_PARTICLES {
                        let mut row = [mean_x[i], mean_y[i], xx[i], xy[i], yy[i], fit[i]];
                        correct_row(model, x[i], measured, &mut row);
                        [mean_x[i], mean_y[i], xx[i], xy[i], yy[i], fit[i]] = row;
                    }
                },
            );
        }
    });
    time_kernel(wanted, &format!("correction, an array of structures/{level:?}"), || {
        let mut rows = vec![ROW; x.len()];
        move || {
            let (x, rows) = (&black_box(x)[..KERNEL_PARTICLES], &mut rows[..KERNEL_PARTICLES]);
            vectorized_at(
                level,
                #[inline(always)]
                || x.iter().zip(rows).for_each(|(x, row)| correct_row(model, *x, measured, row)),
            );
        }
    });
}
