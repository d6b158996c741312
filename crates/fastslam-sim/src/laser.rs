//! Raw scans of the landmarks as rocks, along the path.

use crate::arena::{Arena, Laser, Rock, Wall};
use crate::config::{LaserConfig, SimulationConfig};
use crate::draws::{Draws, Part};
use crate::grid::PointGrid;
use crate::log::SimulatedScans;
use crate::world::Scene;
use fastslam_core::detect::BeamGeometry;
use fastslam_core::geometry::Pose;
use fastslam_core::random::RandomSource;

/// About so many cells of the arena's index at most, whatever the size of the field.
const MOST_CELLS: f64 = 1e6;

/// Gives the rocks their size, kept as diameters in the signatures, and takes away those that stand in the way.
pub fn place_rocks(laser: &LaserConfig, scene: &mut Scene, path: &[Pose], draws: Draws) {
    let [least, most] = laser.radius_m;
    let stream = draws.stream(Part::Attributes, 1);
    for (k, signature) in scene.signature.iter_mut().enumerate() {
        *signature = 2.0 * (least + (most - least) * stream.uniform(k as u32, 0));
    }
    let points: Vec<[f64; 2]> = path.iter().map(|pose| [pose.x, pose.y]).collect();
    let grid = PointGrid::from_points(&points, laser.clearance_m + most);
    let blocks = |k: usize| grid.any_within(scene.position_m[k], laser.clearance_m + 0.5 * scene.signature[k]);
    let kept: Vec<usize> = (0..scene.position_m.len()).filter(|&k| !blocks(k)).collect();
    scene.position_m = kept.iter().map(|&k| scene.position_m[k]).collect();
    scene.class_index = kept.iter().map(|&k| scene.class_index[k]).collect();
    scene.signature = kept.iter().map(|&k| scene.signature[k]).collect();
}

/// A scan per scan period, from the first pose on. `T_world_layout` leads to the world from the frame of the layout, in
/// which the walls stand.
pub fn scans(
    config: &SimulationConfig,
    settings: &LaserConfig,
    scene: &Scene,
    poses: &[Pose],
    T_world_layout: Pose,
) -> SimulatedScans {
    let laser = Laser {
        beams: beams(config.sensor.field_of_view_rad, settings.angle_step_rad),
        geometry: BeamGeometry {
            first_angle_rad: -0.5 * config.sensor.field_of_view_rad,
            angle_step_rad: settings.angle_step_rad,
            min_range_m: config.sensor.min_range_m,
            max_range_m: config.sensor.max_range_m,
            beam_period_s: None,
        },
        range_std_m: settings.range_std_m,
        dropout_probability: settings.dropout_probability,
    };
    let rock =
        |(center, diameter): (&[f64; 2], &f64)| Rock { center_m: *center, radius_m: 0.5 * diameter, intensity: 0.0 };
    let rocks = scene.position_m.iter().zip(&scene.signature).map(rock).collect();
    let walls = settings.wall_margin_m.map_or(vec![], |margin| walls(scene.bounds, margin, T_world_layout));
    let ([a, b], [c, d]) = scene.bounds;
    let cell_m = ((c - a) * (d - b) / MOST_CELLS).sqrt().max(2.0 * settings.radius_m[1]).max(1.0);
    let arena = Arena::new(rocks, walls, cell_m);
    let T_robot_sensor = config.sensor.mounting.T_robot_sensor();
    let random = RandomSource::new(config.seed);
    let mut scans = SimulatedScans { beams: laser.beams, geometry: laser.geometry, stamp_s: vec![], ranges_m: vec![] };
    for (step, T_world_robot) in poses.iter().enumerate().step_by(config.controls_per_scan()) {
        let scan = arena.scan(T_world_robot.compose(T_robot_sensor), [0.0; 3], &laser, random, step as u64);
        scans.stamp_s.push(step as f64 * config.control_period_s);
        scans.ranges_m.extend(scan.ranges_m);
    }
    scans
}

/// Beams from one border of the field of view to the other; of a full turn the last, which would be the first, is left out.
fn beams(field_of_view_rad: f64, step_rad: f64) -> usize {
    let steps = (field_of_view_rad / step_rad + 1e-9).floor() as usize;
    steps + usize::from((steps as f64 + 0.5) * step_rad < std::f64::consts::TAU)
}

fn walls((low, high): ([f64; 2], [f64; 2]), margin_m: f64, T_world_layout: Pose) -> Vec<Wall> {
    let ([a, b], [c, d]) = ([low[0] - margin_m, low[1] - margin_m], [high[0] + margin_m, high[1] + margin_m]);
    let corners = [[a, b], [c, b], [c, d], [a, d]].map(|corner| T_world_layout.transform(corner));
    (0..4).map(|k| Wall { from_m: corners[k], to_m: corners[(k + 1) % 4] }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_full_turn_has_no_beam_twice() {
        let step = 0.5_f64.to_radians();
        assert_eq!(beams(std::f64::consts::TAU, step), 720);
        assert_eq!(beams(std::f64::consts::PI, step), 361);
        assert_eq!(beams(1.0, 0.3), 4);
    }
}
