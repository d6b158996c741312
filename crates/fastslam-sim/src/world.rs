//! Layouts of landmarks.

use crate::config::{Cones, Orchard, RandomField, SimulationConfig, World};
use crate::draws::{Draws, Part};
use crate::grid::{bounding_box, PointGrid};
use crate::path::{distance, Path};
use fastslam_core::error::{Error, Result};
use fastslam_core::geometry::Pose;
use fastslam_core::math::sin_cos;
use std::f64::consts::TAU;

/// Landmarks, and what a path among them needs to know.
#[derive(Clone, Debug)]
pub struct Scene {
    /// Positions in the world.
    pub position_m: Vec<[f64; 2]>,
    /// Index of the class of each landmark, −1 for none.
    pub class_index: Vec<i64>,
    /// True signature of each landmark, NaN for none.
    pub signature: Vec<f64>,
    /// Names of the classes.
    pub class_names: Vec<String>,
    /// Corners of the field in the frame of the layout.
    pub bounds: ([f64; 2], [f64; 2]),
    /// The closed centre line of a track.
    pub center_line: Option<Vec<[f64; 2]>>,
}

impl Scene {
    /// Moves the landmarks rigidly. The field and the centre line have served their purpose by then, and stay.
    pub fn move_by(&mut self, T_new_old: Pose) {
        for position in &mut self.position_m {
            *position = T_new_old.transform(*position);
        }
    }
}

/// The landmarks of a simulation.
pub fn build(config: &SimulationConfig, draws: Draws) -> Result<Scene> {
    let mut scene = match &config.world {
        World::Random(field) => {
            let bounds = ([0.0; 2], field.size_m);
            plain(random_field(field, draws).map_err(|e| e.within("world"))?, bounds)
        }
        World::Orchard(orchard) => {
            let width = f64::from(orchard.columns - 1) * orchard.column_spacing_m;
            let height = f64::from(orchard.rows - 1) * orchard.row_spacing_m;
            plain(orchard_rows(orchard, draws), ([0.0; 2], [width, height]))
        }
        World::Cones(cones) => cone_track(cones, draws)?,
        World::Explicit(explicit) => plain(explicit.points_m.clone(), bounding_box(&explicit.points_m)),
    };
    if scene.position_m.is_empty() {
        return Err(Error::parameter("world.missing_probability", "no landmark left", "a smaller probability"));
    }
    add_attributes(config, &mut scene, draws);
    Ok(scene)
}

fn plain(position_m: Vec<[f64; 2]>, bounds: ([f64; 2], [f64; 2])) -> Scene {
    let class_index = vec![-1; position_m.len()];
    let signature = vec![f64::NAN; position_m.len()];
    Scene { position_m, class_index, signature, class_names: vec![], bounds, center_line: None }
}

/// Throws points at random and keeps those that are far enough from all before them.
fn random_field(field: &RandomField, draws: Draws) -> Result<Vec<[f64; 2]>> {
    let count = field.count as usize;
    let mut grid = PointGrid::new([0.0; 2], field.size_m, field.min_spacing_m, count);
    let stream = draws.stream(Part::World, 0);
    // Random packing jams when discs of half the spacing cover about 55 % of the area; near that, tries explode.
    let tries = 40 * count as u64 + 10_000;
    for attempt in 0..tries {
        if grid.points().len() == count {
            break;
        }
        let [u, v] = stream.uniform_pair(attempt as u32, (attempt >> 32) as u32);
        let point = [u * field.size_m[0], v * field.size_m[1]];
        if !grid.any_within(point, field.min_spacing_m) {
            grid.insert(point);
        }
    }
    let placed = grid.points().len();
    if placed < count {
        return Err(Error::parameter(
            "count",
            count,
            format!(
                "at most about {placed} landmarks with {} m between them in {} m by {} m",
                field.min_spacing_m, field.size_m[0], field.size_m[1]
            ),
        ));
    }
    Ok(grid.points().to_vec())
}

fn orchard_rows(orchard: &Orchard, draws: Draws) -> Vec<[f64; 2]> {
    let stream = draws.stream(Part::World, 0);
    let mut points = vec![];
    for row in 0..orchard.rows {
        for column in 0..orchard.columns {
            if stream.uniform(row, 2 * column) < orchard.missing_probability {
                continue;
            }
            let [dx, dy] = stream.normal_pair(row, 2 * column + 1);
            points.push([
                f64::from(column) * orchard.column_spacing_m + orchard.jitter_std_m * dx,
                f64::from(row) * orchard.row_spacing_m + orchard.jitter_std_m * dy,
            ]);
        }
    }
    points
}

/// Cones to both sides of a random closed curve that is driven counter-clockwise.
fn cone_track(cones: &Cones, draws: Draws) -> Result<Scene> {
    let line = track_center_line(cones, draws);
    let path = Path::new(line.clone())?;
    let pairs = (path.length_m() / cones.spacing_m).round().max(3.0) as usize;
    let (mut points, mut classes) = (vec![], vec![]);
    for pair in 0..pairs {
        let along = path.length_m() * pair as f64 / pairs as f64;
        let here = path.pose_at(along);
        for (class, side) in [(0, 0.5), (1, -0.5)] {
            points.push(here.transform([0.0, side * cones.track_width_m]));
            classes.push(class);
        }
    }
    let bounds = bounding_box(&points);
    let scene = plain(points, bounds);
    Ok(Scene {
        class_index: classes,
        class_names: vec!["blue".into(), "yellow".into()],
        center_line: Some(line),
        ..scene
    })
}

/// r(θ) = R (1 + Σ aₖ cos(kθ + φₖ)), flattened until no bend is tighter than twice the width, first point repeated.
fn track_center_line(cones: &Cones, draws: Draws) -> Vec<[f64; 2]> {
    let stream = draws.stream(Part::World, 0);
    let harmonics: [(f64, f64, f64); 4] = std::array::from_fn(|i| {
        let [size, phase] = stream.uniform_pair(i as u32, 0);
        let k = i as f64 + 2.0;
        (k, (0.4 + 0.6 * size) / k, TAU * phase)
    });
    let samples = (4.0 * cones.track_length_m / cones.spacing_m).ceil().max(720.0) as usize;
    let mut amplitude = 0.5 * cones.irregularity;
    loop {
        let mut line: Vec<[f64; 2]> = (0..samples)
            .map(|i| {
                let angle = TAU * i as f64 / samples as f64;
                let wave: f64 = harmonics.iter().map(|(k, a, phase)| a * sin_cos(k * angle + phase).1).sum();
                let radius = 1.0 + amplitude * wave;
                let (sine, cosine) = sin_cos(angle);
                [radius * cosine, radius * sine]
            })
            .collect();
        line.push(line[0]);
        let scale = cones.track_length_m / length(&line);
        for point in &mut line {
            *point = point.map(|v| v * scale);
        }
        if amplitude < 1e-3 || tightest_bend(&line) >= 2.0 * cones.track_width_m {
            return line;
        }
        amplitude *= 0.9;
    }
}

fn length(line: &[[f64; 2]]) -> f64 {
    line.windows(2).map(|p| distance(p[0], p[1])).sum()
}

/// Least radius of the circles through neighbouring points of a closed line.
fn tightest_bend(line: &[[f64; 2]]) -> f64 {
    let n = line.len() - 1;
    (0..n)
        .map(|i| {
            let [a, b, c] = [line[i], line[(i + 1) % n], line[(i + 2) % n]];
            let cross = ((b[0] - a[0]) * (c[1] - b[1]) - (b[1] - a[1]) * (c[0] - b[0])).abs();
            // The circle through three points: product of the sides over four times the area.
            distance(a, b) * distance(b, c) * distance(a, c) / (2.0 * cross).max(f64::MIN_POSITIVE)
        })
        .fold(f64::INFINITY, f64::min)
}

fn add_attributes(config: &SimulationConfig, scene: &mut Scene, draws: Draws) {
    let stream = draws.stream(Part::Attributes, 0);
    let names = &config.classes.names;
    if !names.is_empty() {
        scene.class_names.clone_from(names);
        for (landmark, class) in scene.class_index.iter_mut().enumerate() {
            *class = (stream.uniform(landmark as u32, 0) * names.len() as f64) as i64;
        }
    }
    if let Some(signature) = &config.scan.signature {
        for (landmark, value) in scene.signature.iter_mut().enumerate() {
            *value = signature.of_population(stream.normal_pair(landmark as u32, 1)[0]);
        }
    }
}

impl crate::config::Signature {
    /// The signature of a landmark for a standard normal number.
    pub fn of_population(&self, normal: f64) -> f64 {
        (self.mean_m + self.spread_std_m * normal).max(0.1 * self.mean_m)
    }
}
