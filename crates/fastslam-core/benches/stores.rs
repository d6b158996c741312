//! What a touch of a landmark costs in each store, whatever the size of the map, and what the maps occupy.
//!
//! `cargo bench -p fastslam-core --bench stores -- [touch] [revisit] [memory] [without-dense] [without-tree]` prints
//! tables; all of them when none is named. The touch is a trivial change of all columns, so that the tables show the stores and not the filter.

use fastslam_core::random::{Purpose, RandomSource};
use fastslam_core::resampling::{resample, ResamplingScheme};
use fastslam_core::store::{LandmarkStore, StoreKind};
use std::time::Instant;

/// Numbers per landmark: count of sightings, mean and covariance.
const COLUMNS: usize = 6;
const SIGHTINGS_PER_STEP: usize = 8;
const STEPS_PER_RESAMPLING: usize = 3;
/// Standard deviation of the log weights at resampling: halves the effective sample size.
const LOG_WEIGHT_STD: f64 = 0.83;
/// Maps above this size are not tried.
const BYTES_MAX: usize = 5_000_000_000;

/// Ancestor indices of successive resamplings, drawn beforehand.
struct Ancestors(Vec<Vec<u32>>);

impl Ancestors {
    fn draw(particles: usize, count: usize) -> Self {
        let source = RandomSource::new(7);
        let one = |step: usize| {
            let stream = source.stream(Purpose::Simulation, step as u64);
            let weight = |i| (LOG_WEIGHT_STD * stream.normal_pair(i as u32, 0)[0]).exp();
            let weights: Vec<f64> = (0..particles).map(weight).collect();
            let total: f64 = weights.iter().sum();
            let weights: Vec<f64> = weights.iter().map(|weight| weight / total).collect();
            let mut out = Vec::new();
            let stream = source.stream(Purpose::Resampling, step as u64);
            resample(ResamplingScheme::Systematic, &weights, particles, stream, &mut out);
            out
        };
        Self((0..count).map(one).collect())
    }

    fn of(&self, generation: usize) -> &[u32] {
        &self.0[generation % self.0.len()]
    }
}

/// A store whose particles share one map of `landmarks`, as after a long time.
fn coalesced(kind: StoreKind, particles: usize, landmarks: usize) -> Box<dyn LandmarkStore> {
    let mut store = kind.create(1, COLUMNS);
    for slot in 0..landmarks as u32 {
        store.insert(slot, &[1.0, f64::from(slot), 2.0, 0.1, 0.0, 0.1]);
    }
    store.resample(&vec![0; particles]);
    store
}

fn touch(store: &mut dyn LandmarkStore, slot: u32) {
    store.update(slot, None, &mut |rows| {
        let [count, x, y, xx, xy, yy] = rows.columns::<COLUMNS>();
        for i in 0..count.len() {
            count[i] += 1.0;
            x[i] += 1e-3 * i as f64;
            y[i] -= 1e-3;
            xx[i] *= 0.99;
            xy[i] *= 0.99;
            yy[i] *= 0.99;
        }
    });
}

/// Seconds of each step, and of the resampling in it.
struct Times(Vec<f64>);

impl Times {
    /// Runs steps; in each, `sighted(step, j)` names the landmark of the j-th sighting.
    fn measure(
        store: &mut dyn LandmarkStore,
        ancestors: &Ancestors,
        steps: std::ops::Range<usize>,
        sighted: impl Fn(usize, usize) -> u32,
    ) -> Self {
        let mut seconds = Vec::with_capacity(steps.len());
        for step in steps {
            let start = Instant::now();
            (0..SIGHTINGS_PER_STEP).for_each(|j| touch(store, sighted(step, j)));
            if step % STEPS_PER_RESAMPLING == 0 {
                store.resample(ancestors.of(step / STEPS_PER_RESAMPLING));
            }
            seconds.push(start.elapsed().as_secs_f64());
        }
        Self(seconds)
    }

    /// Mean nanoseconds per particle and sighting; median and 99th percentile of a step in microseconds.
    ///
    /// **Why:** the slowest hundredth is left out of the mean: on a shared machine it holds the steps in which other
    /// processes ran. The 99th percentile beside it bounds what could hide there.
    fn summary(mut self, particles: usize) -> [f64; 3] {
        self.0.sort_unstable_by(f64::total_cmp);
        let kept = &self.0[..self.0.len() - self.0.len() / 100];
        let mean = kept.iter().sum::<f64>() / kept.len() as f64;
        let quantile = |q: f64| 1e6 * self.0[((self.0.len() - 1) as f64 * q) as usize];
        [1e9 * mean / (particles * SIGHTINGS_PER_STEP) as f64, quantile(0.5), quantile(0.99)]
    }
}

fn print_row(kind: StoreKind, particles: usize, landmarks: usize, times: Times, store: &dyn LandmarkStore) {
    let [mean, median, p99] = times.summary(particles);
    let usage = store.usage();
    println!(
        "{:>8} {particles:>6} {landmarks:>8} {mean:>10.2} {median:>10.1} {p99:>10.1} {:>9} {:>9.2}",
        format!("{kind:?}").to_lowercase(),
        usage.rows,
        usage.bytes as f64 / 1e6
    );
}

fn print_head(title: &str) {
    println!("\n{title}");
    println!("   store      M        K  ns/p-sight  median us     p99 us      rows        MB");
}

/// The window of sixteen landmarks in view moves on by one every other step; each step sights every other of them.
fn in_window(step: usize, j: usize, landmarks: usize) -> u32 {
    ((step / 2 + 2 * j + step % 2) % landmarks) as u32
}

fn bench_touch(kinds: &[StoreKind], particles: &[usize], landmarks: &[usize], steps: usize) {
    print_head("touch: a window slides over a map known before (resampling every 3rd step included)");
    for &m in particles {
        let ancestors = Ancestors::draw(m, 400);
        for &k in landmarks {
            for &kind in kinds {
                let bytes = m * k * COLUMNS * size_of::<f64>();
                // A dense step copies the map; a few of them tell.
                let steps = if kind == StoreKind::Dense { steps.min(2_000_000_000 / bytes).max(9) } else { steps };
                if kind == StoreKind::Dense && 2 * bytes > BYTES_MAX {
                    println!("   dense {m:>6} {k:>8}  left out: {:.1} GB", bytes as f64 / 1e9);
                    continue;
                }
                let mut store = coalesced(kind, m, k);
                let sighted = |step, j| in_window(step, j, k);
                Times::measure(&mut *store, &ancestors, 0..steps / 4, sighted);
                let times = Times::measure(&mut *store, &ancestors, steps / 4..steps + steps / 4, sighted);
                print_row(kind, m, k, times, &*store);
            }
        }
    }
}

/// Lanes of 50 landmarks there and back: every landmark comes into view again at some middle age.
fn bench_revisit(particles: &[usize], landmarks: usize, steps: usize) {
    print_head("revisit: neighbouring lanes in turn, so that most sightings are of landmarks of a middle age");
    let sighted = move |step: usize, j: usize| {
        let (lane, along) = (step / 50, step % 50);
        let along = if lane % 2 == 0 { along } else { 49 - along };
        let lane = (lane + j % 3) * 50;
        ((lane + (along + j / 3) % 50) % landmarks) as u32
    };
    for &m in particles {
        let ancestors = Ancestors::draw(m, 400);
        for kind in [StoreKind::Tree, StoreKind::Lineage] {
            let mut store = coalesced(kind, m, landmarks);
            Times::measure(&mut *store, &ancestors, 0..steps / 4, sighted);
            let times = Times::measure(&mut *store, &ancestors, steps / 4..steps + steps / 4, sighted);
            print_row(kind, m, landmarks, times, &*store);
        }
    }
}

/// Maps a whole world, with the largest ratio of rows to leaves in each tenth of it: every step meets one new landmark and sees seven that it knows.
fn bench_memory(particles: usize, landmarks: usize) {
    println!("\nmemory: rows while a world of {landmarks} is mapped with M = {particles}, against the tree's leaves");
    println!("landmarks  lineage rows  tree leaves  largest ratio  lineage MB  tree MB  lineage p99/median");
    let ancestors = Ancestors::draw(particles, 400);
    let mut lineage = StoreKind::Lineage.create(particles, COLUMNS);
    let mut tree = StoreKind::Tree.create(particles, COLUMNS);
    let mut worst: f64 = 0.0;
    let mut times = Times(Vec::new());
    let values = [1.0, 5.0, 2.0, 0.1, 0.01, 0.1].map(|value| vec![value; particles]).concat();
    for step in 0..landmarks {
        let mut seconds = 0.0;
        for store in [&mut tree, &mut lineage] {
            let start = Instant::now();
            store.insert(step as u32, &values);
            (1..SIGHTINGS_PER_STEP).for_each(|j| touch(&mut **store, step.saturating_sub(2 * j) as u32));
            if step % STEPS_PER_RESAMPLING == 0 {
                store.resample(ancestors.of(step / STEPS_PER_RESAMPLING));
            }
            seconds = start.elapsed().as_secs_f64();
        }
        times.0.push(seconds);
        let (rows, leaves) = (lineage.usage(), tree.usage());
        let ratio = rows.rows as f64 / leaves.rows as f64;
        worst = worst.max(ratio);
        if (step + 1) % (landmarks / 10) == 0 {
            let [_, median, p99] = std::mem::replace(&mut times, Times(Vec::new())).summary(particles);
            println!(
                "{:>9} {:>13} {:>12} {worst:>14.3} {:>11.2} {:>8.2} {:>12.2}",
                step + 1,
                rows.rows,
                leaves.rows,
                rows.bytes as f64 / 1e6,
                leaves.bytes as f64 / 1e6,
                p99 / median
            );
            worst = 0.0;
        }
    }
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let named = |name: &str| arguments.iter().any(|a| a == name);
    let wanted = |name: &str| named(name) || !["touch", "revisit", "memory"].into_iter().any(named);
    let without = [(StoreKind::Dense, "without-dense"), (StoreKind::Tree, "without-tree")];
    let mut kinds = vec![StoreKind::Dense, StoreKind::Tree, StoreKind::Lineage];
    kinds.retain(|kind| !without.iter().any(|(other, name)| other == kind && named(name)));
    if !named("--bench") {
        // Under `cargo test`: only that it runs.
        bench_touch(&kinds, &[10], &[100], 40);
        bench_revisit(&[10], 200, 40);
        bench_memory(10, 100);
        return;
    }
    if wanted("touch") {
        bench_touch(&kinds, &[250, 1000], &[1_000, 10_000, 100_000, 1_000_000], 3_000);
    }
    if wanted("revisit") {
        bench_revisit(&[250, 1000], 2_000, 6_000);
    }
    if wanted("memory") {
        bench_memory(250, 1_000);
        bench_memory(250, 50_000);
    }
}
