//! Paths through a field, as points to drive along.

use crate::config::{LawnMower, Line, Loop, RandomWalk, SimulationConfig, Trajectory};
use crate::draws::{Draws, Part};
use crate::path::{distance, Path};
use crate::world::Scene;
use fastslam_core::error::{Error, Result};
use fastslam_core::math::sin_cos;
use std::f64::consts::{FRAC_PI_2, TAU};

type Points = Vec<[f64; 2]>;

/// Cells or pieces beyond this number are a mistake in the settings.
const MOST_CELLS: f64 = 1e7;

/// The path of a simulation.
pub fn waypoints(config: &SimulationConfig, scene: &Scene, draws: Draws) -> Result<Path> {
    let range_m = config.max_range_m();
    let points = match (&config.trajectory, &scene.center_line) {
        (Trajectory::Loop(path), Some(line)) => laps(line, path.laps),
        (Trajectory::Loop(path), None) => laps(&rounded_rectangle(path, scene)?, path.laps),
        (Trajectory::Waypoints(path), _) => path.points_m.clone(),
        (Trajectory::LawnMower(path), _) => lawn_mower(path, scene, path.lane_spacing_m.unwrap_or(1.4 * range_m))?,
        (Trajectory::Line(path), _) => line(path, scene)?,
        (Trajectory::RandomWalk(RandomWalk { cell_m }), _) => random_walk(scene, cell_m.unwrap_or(range_m), draws)?,
    };
    Path::new(points)
}

/// A closed line driven several times; its last point is its first.
fn laps(closed: &[[f64; 2]], count: u32) -> Points {
    let mut points = vec![closed[0]];
    for _ in 0..count {
        points.extend_from_slice(&closed[1..]);
    }
    points
}

/// Starts in the middle of the lower side, to the right.
fn rounded_rectangle(path: &Loop, scene: &Scene) -> Result<Points> {
    let (min, max) = scene.bounds;
    let (x0, x1) = (min[0] + path.margin_m, max[0] - path.margin_m);
    let (y0, y1) = (min[1] + path.margin_m, max[1] - path.margin_m);
    if x0 >= x1 || y0 >= y1 {
        let expected = format!("less than half of the field's {:.3} m by {:.3} m", max[0] - min[0], max[1] - min[1]);
        return Err(Error::parameter("trajectory.margin_m", path.margin_m, expected));
    }
    let radius = path.corner_radius_m.min(0.5 * (x1 - x0)).min(0.5 * (y1 - y0));
    let centers = [
        [x1 - radius, y0 + radius],
        [x1 - radius, y1 - radius],
        [x0 + radius, y1 - radius],
        [x0 + radius, y0 + radius],
    ];
    let start = [0.5 * (x0 + x1), y0];
    let mut points = vec![start];
    for (corner, center) in centers.iter().enumerate() {
        for part in 0..=24 {
            let (sine, cosine) = sin_cos(FRAC_PI_2 * (corner as f64 - 1.0 + f64::from(part) / 24.0));
            points.push([center[0] + radius * cosine, center[1] + radius * sine]);
        }
    }
    points.push(start);
    Ok(points)
}

fn lawn_mower(path: &LawnMower, scene: &Scene, spacing_m: f64) -> Result<Points> {
    let (min, max) = scene.bounds;
    let mut points: Points = vec![];
    for sweep in 0..path.sweeps {
        let along = (sweep % 2) as usize;
        let lanes = sweep_lanes((min, max), along, spacing_m)?;
        // The four mirror images cover the field alike; take the one that begins where the last sweep ended.
        let nearest = (0..4_u32)
            .map(|mirror| lanes.iter().map(|p| mirrored(*p, mirror, min, max)).collect::<Points>())
            .min_by(|a, b| {
                let from = points.last().copied().unwrap_or(lanes[0]);
                distance(from, a[0]).total_cmp(&distance(from, b[0]))
            });
        points.extend(nearest.unwrap_or_default());
    }
    Ok(points)
}

/// Lanes along axis `along`, from the lower left corner, each driven against the last.
fn sweep_lanes((min, max): ([f64; 2], [f64; 2]), along: usize, spacing_m: f64) -> Result<Points> {
    let across = 1 - along;
    let width = max[across] - min[across];
    // A field that is a whole number of lanes wide must not get one more by rounding.
    let lanes = (width / spacing_m - 1e-9).ceil().max(1.0);
    if lanes > 1e5 {
        return Err(Error::parameter(
            "trajectory.lane_spacing_m",
            spacing_m,
            "a spacing that makes at most 100000 lanes",
        ));
    }
    let mut points = vec![];
    for lane in 0..lanes as usize {
        let offset = min[across] + (lane as f64 + 0.5) * width / lanes;
        let ends = if lane % 2 == 0 { [min[along], max[along]] } else { [max[along], min[along]] };
        for end in ends {
            let mut point = [0.0; 2];
            (point[along], point[across]) = (end, offset);
            points.push(point);
        }
    }
    Ok(points)
}

fn mirrored(point: [f64; 2], mirror: u32, min: [f64; 2], max: [f64; 2]) -> [f64; 2] {
    std::array::from_fn(|axis| if mirror >> axis & 1 == 1 { min[axis] + max[axis] - point[axis] } else { point[axis] })
}

fn line(path: &Line, scene: &Scene) -> Result<Points> {
    let (min, max) = scene.bounds;
    let (length, middle) = (max[0] - min[0], 0.5 * (min[1] + max[1]));
    let pieces = (24.0 * length / path.sway_period_m).ceil().max(1.0);
    if pieces > MOST_CELLS {
        return Err(Error::parameter("trajectory.sway_period_m", path.sway_period_m, "a longer period for this field"));
    }
    Ok((0..=pieces as usize)
        .map(|i| {
            let x = length * i as f64 / pieces;
            // The cosine: the path begins along the field, not across it.
            let phase = (x / path.sway_period_m).fract();
            [min[0] + x, middle + path.sway_m * sin_cos(TAU * phase).1]
        })
        .collect())
}

/// Walks over square cells to a random neighbour that was not visited yet, and back the way it came where there is
/// none, until all were visited: a depth-first search that is driven.
fn random_walk(scene: &Scene, cell_m: f64, draws: Draws) -> Result<Points> {
    let (min, max) = scene.bounds;
    let size = [max[0] - min[0], max[1] - min[1]];
    let cells = size.map(|s| (s / cell_m - 1e-9).ceil().max(2.0));
    if cells[0] * cells[1] > MOST_CELLS {
        return Err(Error::parameter("trajectory.cell_m", cell_m, format!("at most {MOST_CELLS} cells in the field")));
    }
    let [columns, rows] = cells.map(|c| c as usize);
    let stream = draws.stream(Part::Trajectory, 0);
    let mut visited = vec![false; columns * rows];
    let mut stack = vec![0_usize];
    let mut walk = vec![0_usize];
    visited[0] = true;
    let mut left = columns * rows - 1;
    while let (Some(&cell), true) = (stack.last(), left > 0) {
        let open = open_neighbours(cell, columns, rows, &visited);
        if open.is_empty() {
            stack.pop();
            walk.extend(stack.last());
            continue;
        }
        let next = open[(stream.uniform(walk.len() as u32, 0) * open.len() as f64) as usize];
        visited[next] = true;
        left -= 1;
        stack.push(next);
        walk.push(next);
    }
    let place = |index: usize, axis: usize| min[axis] + (index as f64 + 0.5) * size[axis] / cells[axis];
    Ok(walk.into_iter().map(|cell| [place(cell % columns, 0), place(cell / columns, 1)]).collect())
}

fn open_neighbours(cell: usize, columns: usize, rows: usize, visited: &[bool]) -> Vec<usize> {
    let (column, row) = (cell % columns, cell / columns);
    [
        (column > 0).then(|| cell - 1),
        (column + 1 < columns).then_some(cell + 1),
        (row > 0).then(|| cell - columns),
        (row + 1 < rows).then_some(cell + columns),
    ]
    .into_iter()
    .flatten()
    .filter(|&neighbour| !visited[neighbour])
    .collect()
}
