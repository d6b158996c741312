//! The detectors against arenas whose truth is known.

use fastslam_core::detect::{BeamGeometry, Detection, Detector, DetectorConfig, Scan};
use fastslam_core::error::Result;
use fastslam_core::geometry::Pose;
use fastslam_core::random::{Purpose, RandomSource};
use fastslam_sim::arena::{Arena, ArenaScan, Laser, Rock, Wall};

const RANGE_STD_M: f64 = 0.02;

fn laser() -> Laser {
    let half_degree = 0.5_f64.to_radians();
    let geometry = BeamGeometry {
        first_angle_rad: -std::f64::consts::FRAC_PI_2,
        angle_step_rad: half_degree,
        min_range_m: 0.1,
        max_range_m: 80.0,
        beam_period_s: None,
    };
    Laser { beams: 361, geometry, range_std_m: RANGE_STD_M, dropout_probability: 0.002 }
}

/// What is true of one rock in one scan.
struct View {
    center_in_sensor: [f64; 2],
    radius_m: f64,
    /// Beams that end on it.
    visible: usize,
    /// Beams that would end on it if it stood alone and the field of view were full.
    width: usize,
}

fn views(arena: &Arena, scan: &ArenaScan, T_world_sensor: Pose, laser: &Laser) -> Vec<View> {
    let T_sensor_world = T_world_sensor.inverse();
    let rocks = arena.rocks().iter().enumerate();
    rocks
        .map(|(index, rock)| {
            let center = T_sensor_world.transform(rock.center_m);
            let (range, bearing) = (center[0].hypot(center[1]), center[1].atan2(center[0]));
            let half_width = (rock.radius_m / range).min(1.0).asin();
            let turn = (std::f64::consts::TAU / laser.geometry.angle_step_rad).round() as i64;
            let width = (0..turn)
                .filter(|&k| {
                    let angle = laser.geometry.first_angle_rad + k as f64 * laser.geometry.angle_step_rad;
                    let off = (angle - bearing).sin().atan2((angle - bearing).cos());
                    off.abs() < half_width
                })
                .count();
            let visible = scan.rocks.iter().filter(|&&hit| hit == Some(index)).count();
            View { center_in_sensor: center, radius_m: rock.radius_m, visible, width }
        })
        .collect()
}

/// Poses of the sensor at which it touches no rock.
fn free_poses(arena: &Arena, seed: u64, count: u32) -> Vec<Pose> {
    let stream = RandomSource::new(seed).stream(Purpose::Simulation, 0);
    let poses = (0..20 * count).map(|k| {
        let [u, v] = stream.uniform_pair(k, 7);
        Pose::new(34.0 * (u - 0.5), 34.0 * (v - 0.5), std::f64::consts::TAU * stream.uniform(k, 8) - 3.0)
    });
    let free = |pose: &Pose| {
        arena.rocks().iter().all(|r| (r.center_m[0] - pose.x).hypot(r.center_m[1] - pose.y) > r.radius_m + 0.5)
    };
    poses.filter(free).take(count as usize).collect()
}

#[derive(Default)]
struct Score {
    detections: usize,
    correct: usize,
    wide: usize,
    found: usize,
    partial: usize,
    partial_found: usize,
    /// Radial and tangential errors and the diameter's, of whole objects that are at least five beams wide.
    errors: [Vec<f64>; 3],
    /// The same in standard deviations (radial, tangential).
    normalized: [Vec<f64>; 2],
}

impl Score {
    fn add(&mut self, views: &[View], detections: &[Detection]) {
        let place = |d: &Detection| [d.range_m * d.bearing_rad.cos(), d.range_m * d.bearing_rad.sin()];
        let near = |d: &Detection, v: &View| {
            let p = place(d);
            (p[0] - v.center_in_sensor[0]).hypot(p[1] - v.center_in_sensor[1]) < v.radius_m.max(0.3)
        };
        self.detections += detections.len();
        self.correct += detections.iter().filter(|d| views.iter().any(|v| v.visible > 0 && near(d, v))).count();
        for view in views.iter().filter(|v| v.visible >= 5) {
            let found = detections.iter().find(|d| near(d, view));
            if view.visible < view.width {
                self.partial += 1;
                self.partial_found += usize::from(found.is_some());
                continue;
            }
            self.wide += 1;
            self.found += usize::from(found.is_some());
            if let Some(d) = found.filter(|d| !d.signature.is_nan()) {
                let center = view.center_in_sensor;
                let radial = d.range_m - center[0].hypot(center[1]);
                let off = d.bearing_rad - center[1].atan2(center[0]);
                self.errors[0].push(radial);
                self.errors[1].push(off * d.range_m);
                self.errors[2].push(d.signature - 2.0 * view.radius_m);
                self.normalized[0].push(radial / d.covariance.xx.sqrt());
                self.normalized[1].push(off / d.covariance.yy.sqrt());
            }
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

fn open_arena(seed: u64) -> Arena {
    Arena::random(seed, 45, 40.0, [0.15, 0.8], 1.0)
}

/// A wall's distance from a point.
fn clearance(wall: &Wall, point: [f64; 2]) -> f64 {
    let along = [wall.to_m[0] - wall.from_m[0], wall.to_m[1] - wall.from_m[1]];
    let to = [point[0] - wall.from_m[0], point[1] - wall.from_m[1]];
    let fraction = (to[0] * along[0] + to[1] * along[1]) / (along[0] * along[0] + along[1] * along[1]);
    let fraction = fraction.clamp(0.0, 1.0);
    (to[0] - fraction * along[0]).hypot(to[1] - fraction * along[1])
}

/// Long walls through the arena, which the sensor looks along; no rock is nearer than a metre to one.
fn long_walls(seed: u64) -> Vec<Wall> {
    let stream = RandomSource::new(seed).stream(Purpose::Simulation, 99);
    let long = (0..4).map(|k| {
        let [u, v] = stream.uniform_pair(k, 0);
        let (sine, cosine) = (std::f64::consts::TAU * stream.uniform(k, 1)).sin_cos();
        let middle = [30.0 * (u - 0.5), 30.0 * (v - 0.5)];
        let half = 5.0 + 7.0 * stream.uniform(k, 2);
        let end = |side: f64| [middle[0] + side * half * cosine, middle[1] + side * half * sine];
        Wall { from_m: end(-1.0), to_m: end(1.0) }
    });
    long.collect()
}

fn walled_arena(seed: u64) -> Arena {
    let mut walls = long_walls(seed);
    let apart = |rock: &&Rock| walls.iter().all(|wall| clearance(wall, rock.center_m) > rock.radius_m + 1.0);
    let rocks: Vec<Rock> = open_arena(seed).rocks().iter().filter(apart).copied().collect();
    let corners = [[-20.0, -20.0], [20.0, -20.0], [20.0, 20.0], [-20.0, 20.0]];
    walls.extend((0..4).map(|k| Wall { from_m: corners[k], to_m: corners[(k + 1) % 4] }));
    Arena::new(rocks, walls, 2.0)
}

fn survey(arenas: u64, poses: u32, build: impl Fn(u64) -> Arena) -> Result<Score> {
    let laser = laser();
    let mut detector = Detector::new(DetectorConfig::default())?;
    let (mut score, mut found) = (Score::default(), Vec::new());
    for seed in 0..arenas {
        let arena = build(seed);
        for (number, pose) in free_poses(&arena, seed, poses).into_iter().enumerate() {
            let scan = arena.scan(pose, [0.0; 3], &laser, RandomSource::new(seed), number as u64);
            found.clear();
            let input = Scan { ranges_m: &scan.ranges_m, intensities: None, geometry: laser.geometry, twist: None };
            detector.detect(&input, &mut found)?;
            score.add(&views(&arena, &scan, pose, &laser), &found);
        }
    }
    Ok(score)
}

/// Asserts precision and recall, and that there were at least so many to find.
fn assert_nearly_all_right(score: &Score, least: usize) {
    let precision = score.correct as f64 / score.detections as f64;
    let recall = score.found as f64 / score.wide as f64;
    println!("precision {precision:.4} of {}, recall {recall:.4} of {}", score.detections, score.wide);
    assert!(score.wide > least && score.detections > least, "the arenas show something");
    assert!(precision >= 0.98, "precision {precision}");
    assert!(recall >= 0.98, "recall {recall}");
}

#[test]
fn rocks_are_found_where_they_are() {
    let score = survey(8, 40, open_arena).unwrap();
    assert_nearly_all_right(&score, 1000);
    // An object that a nearer one hides in part, with five beams or more left on it.
    assert!(score.partial > 100 && score.partial_found as f64 >= 0.85 * score.partial as f64);
}

#[test]
fn walls_at_grazing_incidence_are_no_rocks() {
    let score = survey(24, 20, walled_arena).unwrap();
    assert_nearly_all_right(&score, 500);
}

#[test]
fn positions_are_unbiased_and_their_covariance_is_not_too_small() {
    let score = survey(24, 60, open_arena).unwrap();
    for (name, values) in ["radial", "tangential"].iter().zip(&score.errors) {
        let (mean, error, std) = moments(values);
        println!("{name}: {:.2} ± {:.2} mm, std {:.1} mm, n {}", 1e3 * mean, 1e3 * error, 1e3 * std, values.len());
        assert!(values.len() > 10_000 && mean.abs() <= 2.0 * error, "{name}: {mean} ± {error} m");
    }
    for values in &score.normalized {
        // Roughness and pointing errors are in the covariance and not in the arena.
        let std = moments(values).2;
        assert!((0.4..=1.1).contains(&std), "normalised standard deviation {std}");
    }
    let diameter = moments(&score.errors[2]);
    assert!(diameter.0.abs() < 0.005, "mean error of the diameter {} m", diameter.0);
}
