//! Reflectors and corners against arenas whose truth is known.
use fastslam_core::detect::{BeamGeometry, Detection, Detector, DetectorConfig, DetectorKind, Scan};
use fastslam_core::geometry::Pose;
use fastslam_core::random::{Purpose, RandomSource};
use fastslam_sim::arena::{Arena, ArenaScan, Laser, Rock, Wall};

const RANGE_STD_M: f64 = 0.02;

fn laser(beams_per_degree: f64) -> Laser {
    let step = (1.0 / beams_per_degree).to_radians();
    let geometry = BeamGeometry {
        first_angle_rad: -0.75 * std::f64::consts::PI,
        angle_step_rad: step,
        min_range_m: 0.1,
        max_range_m: 40.0,
        beam_period_s: None,
    };
    let beams = (270.0 * beams_per_degree) as usize + 1;
    Laser { beams, geometry, range_std_m: RANGE_STD_M, dropout_probability: 0.002 }
}

fn poses(seed: u64, count: u32, half_m: [f64; 2]) -> Vec<Pose> {
    let stream = RandomSource::new(seed).stream(Purpose::Simulation, 3);
    let pose = |k| {
        let [u, v] = stream.uniform_pair(k, 0);
        let turn = std::f64::consts::TAU * stream.uniform(k, 1) - 3.0;
        Pose::new(half_m[0] * (2.0 * u - 1.0), half_m[1] * (2.0 * v - 1.0), turn)
    };
    (0..count).map(pose).collect()
}

fn detector(kind: DetectorKind) -> Detector {
    let mut config = DetectorConfig { kind, ..Default::default() };
    config.reflectors.range_std_m = RANGE_STD_M;
    config.reflectors.bearing_std_rad = 0.0;
    Detector::new(config).unwrap()
}

fn place(d: &Detection) -> [f64; 2] {
    [d.range_m * d.bearing_rad.cos(), d.range_m * d.bearing_rad.sin()]
}

fn distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

#[derive(Default)]
struct Score {
    detections: usize,
    correct: usize,
    in_view: usize,
    found: usize,
    /// Radial and tangential.
    errors: [Vec<f64>; 2],
    normalized: [Vec<f64>; 2],
}

impl Score {
    fn add_error(&mut self, d: &Detection, truth_in_sensor: [f64; 2]) {
        let [x, y] = truth_in_sensor;
        let off = d.bearing_rad - y.atan2(x);
        let off = off.sin().atan2(off.cos());
        self.errors[0].push(d.range_m - x.hypot(y));
        self.errors[1].push(off * d.range_m);
        self.normalized[0].push((d.range_m - x.hypot(y)) / d.covariance.xx.sqrt());
        self.normalized[1].push(off / d.covariance.yy.sqrt());
    }

    /// Precision and recall of 0.98, mean errors within two standard errors of 0, covariances that are neither much too
    /// large nor too small.
    fn check(&self, least: usize) {
        let precision = self.correct as f64 / self.detections as f64;
        let recall = self.found as f64 / self.in_view as f64;
        println!("precision {precision:.4} of {}, recall {recall:.4} of {}", self.detections, self.in_view);
        assert!(self.in_view >= least && self.detections >= least, "the arenas show something");
        assert!(precision >= 0.98 && recall >= 0.98, "precision {precision}, recall {recall}");
        for k in 0..2 {
            let (mean, error, _) = moments(&self.errors[k]);
            let std = moments(&self.normalized[k]).2;
            println!("{k}: {:.2} ± {:.2} mm, normalised std {std:.2}", 1e3 * mean, 1e3 * error);
            assert!(mean.abs() <= 2.0 * error, "mean error {k}: {mean} ± {error}");
            assert!((0.4..=1.1).contains(&std), "normalised standard deviation {k}: {std}");
        }
    }
}

/// Mean, its standard error, and the standard deviation.
fn moments(values: &[f64]) -> (f64, f64, f64) {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let std = (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0)).sqrt();
    (mean, std / n.sqrt(), std)
}

/// Every third rock is a thin post with reflective tape.
fn posts(seed: u64) -> Arena {
    let rocks = Arena::random(seed, 45, 30.0, [0.1, 0.5], 0.8).rocks().to_vec();
    let shine = |(k, rock): (usize, Rock)| match k % 3 {
        0 => Rock { radius_m: 0.03, intensity: 2.0, ..rock },
        _ => rock,
    };
    Arena::new(rocks.into_iter().enumerate().map(shine).collect(), vec![], 1.5)
}

#[test]
fn reflectors_are_found_where_they_are() {
    let (laser, mut detector, mut score) = (laser(4.0), detector(DetectorKind::Reflectors), Score::default());
    for seed in 0..30 {
        let arena = posts(seed);
        for (number, pose) in poses(seed, 20, [14.0, 14.0]).into_iter().enumerate() {
            if arena.rocks().iter().any(|rock| distance(rock.center_m, [pose.x, pose.y]) < rock.radius_m + 0.5) {
                continue;
            }
            let scan = arena.scan(pose, [0.0; 3], &laser, RandomSource::new(seed), number as u64);
            score_posts(&mut score, &mut detector, (&arena, &scan, pose), &laser);
        }
    }
    score.check(2000);
}

fn score_posts(score: &mut Score, detector: &mut Detector, view: (&Arena, &ArenaScan, Pose), laser: &Laser) {
    let (arena, scan, pose) = view;
    let mut found = Vec::new();
    let (ranges_m, intensities) = (&scan.ranges_m[..], Some(&scan.intensities[..]));
    let input = Scan { ranges_m, intensities, geometry: laser.geometry, twist: None };
    detector.detect(&input, &mut found).unwrap();
    score.detections += found.len();
    for (index, rock) in arena.rocks().iter().enumerate().filter(|(_, rock)| rock.intensity > 0.0) {
        let beams = scan.rocks.iter().filter(|&&hit| hit == Some(index)).count();
        let truth = pose.inverse().transform(rock.center_m);
        let near = found.iter().find(|d| distance(place(d), truth) < 0.3);
        score.correct += usize::from(beams > 0 && near.is_some());
        // The first and last beam of the view cut posts in two.
        let (first, last) = (scan.rocks.first().copied(), scan.rocks.last().copied());
        if beams == 0 || [first, last].contains(&Some(Some(index))) {
            continue;
        }
        score.in_view += 1;
        score.found += usize::from(near.is_some());
        if let Some(d) = near {
            score.add_error(d, truth);
        }
    }
}

/// A hall with an alcove and a box in it: corners that point away from the sensor and towards it.
fn hall() -> Vec<Vec<[f64; 2]>> {
    let outline =
        vec![[-8.0, -6.0], [8.0, -6.0], [8.0, 2.0], [10.0, 2.0], [10.0, 5.0], [8.0, 5.0], [8.0, 6.0], [-8.0, 6.0]];
    let crate_ = vec![[-5.5, 3.0], [-4.0, 2.0], [-3.0, 3.5], [-4.5, 4.5]];
    vec![outline, crate_]
}

#[test]
fn corners_are_found_where_they_are() {
    let polygons = hall();
    let walls: Vec<Wall> =
        polygons.iter().flat_map(|p| (0..p.len()).map(|k| Wall { from_m: p[k], to_m: p[(k + 1) % p.len()] })).collect();
    let corners: Vec<[f64; 2]> = polygons.concat();
    let arena = Arena::new(vec![], walls.clone(), 1.0);
    let (laser, mut detector, mut score) = (laser(2.0), detector(DetectorKind::Corners), Score::default());
    for (number, pose) in poses(7, 600, [7.5, 5.5]).into_iter().enumerate() {
        if distance([pose.x, pose.y], [-4.25, 3.25]) < 2.0 {
            continue;
        }
        let scan = arena.scan(pose, [0.0; 3], &laser, RandomSource::new(7), number as u64);
        let input = Scan { ranges_m: &scan.ranges_m, intensities: None, geometry: laser.geometry, twist: None };
        let mut found = Vec::new();
        detector.detect(&input, &mut found).unwrap();
        let truth: Vec<[f64; 2]> = corners.iter().map(|&corner| pose.inverse().transform(corner)).collect();
        score.detections += found.len();
        score.correct += found.iter().filter(|d| truth.iter().any(|&t| distance(place(d), t) < 0.3)).count();
        for corner in corners_in_view(&arena, &walls, pose, &laser) {
            let t = pose.inverse().transform(corner);
            let near = found.iter().find(|d| distance(place(d), t) < 0.3);
            score.in_view += 1;
            score.found += usize::from(near.is_some());
            if let Some(d) = near {
                score.add_error(d, t);
            }
        }
    }
    score.check(1000);
}

/// Corners with at least ten beams and 0.8 m in view on both of their walls, where neighbouring echoes are no farther apart
/// than the detector bridges: at grazing incidence a corner lies far from the last echo before it.
fn corners_in_view(arena: &Arena, walls: &[Wall], pose: Pose, laser: &Laser) -> Vec<[f64; 2]> {
    let hits: Vec<(usize, [f64; 2])> = (0..laser.beams)
        .map(|k| {
            let angle = pose.heading + laser.geometry.first_angle_rad + k as f64 * laser.geometry.angle_step_rad;
            let direction = [angle.cos(), angle.sin()];
            let range = arena.range([pose.x, pose.y], direction, laser.geometry.max_range_m).unwrap();
            let point = [pose.x + range * direction[0], pose.y + range * direction[1]];
            (wall_at(walls, point), point)
        })
        .collect();
    let mut runs: Vec<(usize, usize)> = vec![(0, 0)];
    for k in 1..hits.len() {
        match hits[k].0 == hits[k - 1].0 {
            true => runs.last_mut().unwrap().1 = k,
            false => runs.push((k, k)),
        }
    }
    let long = |&(a, b): &(usize, usize)| b - a >= 9 && distance(hits[a].1, hits[b].1) >= 0.8;
    let dense = |pair: &&[(usize, usize)]| {
        let (a, b) = (pair[0].1, pair[1].0);
        [(a - 1, a), (a, b), (b, b + 1)].into_iter().all(|(i, j)| distance(hits[i].1, hits[j].1) < 0.3)
    };
    let pairs = runs.windows(2).filter(|pair| pair.iter().all(long)).filter(dense);
    let shared = |pair: &[(usize, usize)]| {
        let (a, b) = (&walls[hits[pair[0].0].0], &walls[hits[pair[1].0].0]);
        [a.from_m, a.to_m].into_iter().find(|end| [b.from_m, b.to_m].contains(end))
    };
    pairs.filter_map(shared).collect()
}

fn wall_at(walls: &[Wall], point: [f64; 2]) -> usize {
    let beyond =
        |wall: &Wall| distance(wall.from_m, point) + distance(point, wall.to_m) - distance(wall.from_m, wall.to_m);
    (0..walls.len()).min_by(|&a, &b| beyond(&walls[a]).total_cmp(&beyond(&walls[b]))).unwrap()
}
