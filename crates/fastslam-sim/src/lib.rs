//! Simulated worlds with ground truth: landmarks, a path among them, noisy odometry and noisy sightings.
//!
//! Every random number comes from the counter-based source of the core, addressed by what it is for (which part of the
//! simulation, which scan, which landmark): one seed is one log, and changing the sensor leaves the world, the path and
//! the noise of the odometry as they were.

pub mod arena;
mod config;
mod draws;
mod grid;
mod laser;
mod log;
mod path;
mod presets;
mod scan;
mod trajectory;
mod validate;
mod vehicle;
mod world;

pub use config::{
    Classes, Cones, Explicit, Identities, LaserConfig, LawnMower, Line, Loop, Orchard, RandomField, RandomWalk,
    ScanConfig, Signature, SimulationConfig, Start, Trajectory, VehicleConfig, Waypoints, World,
};
pub use grid::PointGrid;
pub use log::{SimulatedLandmarks, SimulatedLog, SimulatedScans, SimulatedSightings};
pub use presets::PRESETS;

use draws::Draws;
use fastslam_core::error::Result;
use fastslam_core::geometry::Pose;

/// Simulates one log.
///
/// # Errors
/// A parameter error with its dotted key where a setting is out of range, or where settings contradict each other (a
/// field too small for its landmarks, a path too sharp for the vehicle).
pub fn simulate(config: &SimulationConfig) -> Result<SimulatedLog> {
    config.validate()?;
    let draws = Draws::new(config.seed);
    let mut world = world::build(config, draws)?;
    let path = trajectory::waypoints(config, &world, draws)?;
    let mut drive = vehicle::drive(config, path)?;
    if let Some(laser) = &config.scan.laser {
        laser::place_rocks(laser, &mut world, &drive.poses, draws);
    }
    let mut T_world_layout = Pose::new(0.0, 0.0, 0.0);
    if let Some(start) = config.start {
        // The frame of the world is ours to choose: the whole scene moves rigidly, nothing in it changes.
        T_world_layout = start.T_world_robot().compose(drive.poses[0].inverse());
        world.move_by(T_world_layout);
        for pose in &mut drive.poses {
            *pose = T_world_layout.compose(*pose);
        }
    }
    let controls = vehicle::record(config, &drive.controls, draws);
    let (mut scans, mut sightings, mut seen) = (None, SimulatedSightings::default(), vec![]);
    match &config.scan.laser {
        Some(laser) => scans = Some(laser::scans(config, laser, &world, &drive.poses, T_world_layout)),
        None => (sightings, seen) = scan::scan(config, &world, &drive.poses, draws),
    }
    Ok(log::assemble(config, log::Parts { world, drive, controls, sightings, scans, seen }))
}
