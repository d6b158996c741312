//! Ready-made simulations.

use crate::config::{
    Cones, Identities, LaserConfig, LawnMower, Loop, Orchard, RandomField, RandomWalk, ScanConfig, Signature,
    SimulationConfig, Trajectory, VehicleConfig, World,
};
use fastslam_core::error::{Error, Result};
use fastslam_core::measurement::SensorSettings;
use fastslam_core::motion::{Ackermann, Increments, Motion, Velocity};
use std::f64::consts::PI;

/// Names that [`SimulationConfig::preset`] knows.
pub const PRESETS: [&str; 8] = ["demo", "loop", "lawn-mower", "cones", "orchard", "headline", "victoria-like", "rover"];

impl SimulationConfig {
    /// One of [`PRESETS`].
    pub fn preset(name: &str) -> Result<Self> {
        match name {
            "demo" => Ok(demo()),
            "loop" => Ok(long_loop()),
            "lawn-mower" => Ok(lawn_mower()),
            "cones" => Ok(cones()),
            "orchard" => Ok(orchard()),
            "headline" => Ok(headline()),
            "victoria-like" => Ok(victoria_like()),
            "rover" => Ok(rover()),
            _ => Err(Error::parameter("preset", name, format!("one of {}", PRESETS.join(", ")))),
        }
    }

    /// The same simulation with about this many landmarks, at the same density.
    ///
    /// # Errors
    /// For landmarks that are listed one by one.
    pub fn with_landmarks(mut self, count: u32) -> Result<Self> {
        match &mut self.world {
            World::Random(field) => {
                let scale = (f64::from(count) / f64::from(field.count)).sqrt();
                field.count = count;
                field.size_m = field.size_m.map(|side| side * scale);
            }
            World::Orchard(orchard) => {
                let scale = (f64::from(count) / (f64::from(orchard.rows) * f64::from(orchard.columns))).sqrt();
                orchard.rows = (f64::from(orchard.rows) * scale).round().max(1.0) as u32;
                orchard.columns = count.div_ceil(orchard.rows);
            }
            World::Cones(cones) => cones.track_length_m = 0.5 * f64::from(count) * cones.spacing_m,
            World::Explicit(explicit) => {
                let got = format!("{count} landmarks");
                return Err(Error::parameter("world.points_m", got, format!("its own {}", explicit.points_m.len())));
            }
        }
        Ok(self)
    }
}

fn random(count: u32, size_m: [f64; 2], min_spacing_m: f64) -> World {
    World::Random(RandomField { count, size_m, min_spacing_m })
}

fn sensor(range_std_m: f64, bearing_std_deg: f64, max_range_m: f64) -> SensorSettings {
    SensorSettings {
        range_std_m,
        bearing_std_rad: bearing_std_deg.to_radians(),
        max_range_m,
        ..SensorSettings::default()
    }
}

/// Two laps among 60 landmarks in about a minute.
fn demo() -> SimulationConfig {
    SimulationConfig {
        world: random(60, [40.0, 30.0], 2.0),
        trajectory: Trajectory::Loop(Loop { laps: 2, margin_m: 7.0, corner_radius_m: 5.0 }),
        vehicle: VehicleConfig { speed_m_per_s: 2.5, ..VehicleConfig::default() },
        sensor: sensor(0.1, 1.5, 10.0),
        ..SimulationConfig::default()
    }
}

/// Five large laps in two minutes each: drift before the first closure, and long re-observation.
fn long_loop() -> SimulationConfig {
    SimulationConfig {
        world: random(200, [90.0, 70.0], 2.0),
        trajectory: Trajectory::Loop(Loop { laps: 5, margin_m: 10.0, corner_radius_m: 10.0 }),
        sensor: sensor(0.1, 1.0, 10.0),
        ..SimulationConfig::default()
    }
}

/// 1,000 landmarks swept in 14 m lanes with 10 m range, then again across, in 6,760 steps of about one metre.
fn lawn_mower() -> SimulationConfig {
    SimulationConfig {
        world: random(1000, [210.0, 210.0], 2.0),
        trajectory: Trajectory::LawnMower(LawnMower { lane_spacing_m: Some(14.0), sweeps: 2 }),
        vehicle: VehicleConfig { speed_m_per_s: 0.985, max_yaw_rate_rad_per_s: 0.5, lookahead_m: 3.0 },
        control_period_s: 1.0,
        max_duration_s: Some(6760.0),
        motion: Motion::Increments(Increments {
            x_std_m: 0.02,
            y_std_m: 0.02,
            heading_std_rad: 0.1_f64.to_radians(),
            ..Increments::default()
        }),
        sensor: sensor(0.1, 1.0, 10.0),
        scan: ScanConfig { period_s: 1.0, ..ScanConfig::default() },
        ..SimulationConfig::default()
    }
}

/// Three laps of a cone track with a forward-looking sensor and nobody to name the cones.
fn cones() -> SimulationConfig {
    let mut config = SimulationConfig {
        world: World::Cones(Cones::default()),
        trajectory: Trajectory::Loop(Loop { laps: 3, ..Loop::default() }),
        vehicle: VehicleConfig { speed_m_per_s: 6.0, max_yaw_rate_rad_per_s: 1.5, lookahead_m: 3.0 },
        control_period_s: 0.02,
        motion: Motion::Velocity(Velocity {
            speed_std_m_per_s: 0.3,
            yaw_rate_std_rad_per_s: 0.05,
            lateral_std_m_per_s: 0.0,
            noise_period_s: Some(0.02),
            ..Velocity::default()
        }),
        sensor: SensorSettings { field_of_view_rad: 2.0 * PI / 3.0, min_range_m: 0.5, ..sensor(0.1, 1.0, 15.0) },
        scan: ScanConfig {
            period_s: 0.1,
            detection_probability: 0.9,
            clutter_per_scan: 0.2,
            identities: Identities::None,
            ..ScanConfig::default()
        },
        ..SimulationConfig::default()
    };
    config.sensor.mounting.x_m = 0.8;
    config.classes.confusion_probability = 0.05;
    config
}

/// Up and down between rows of trees whose trunks are measured.
fn orchard() -> SimulationConfig {
    SimulationConfig {
        world: World::Orchard(Orchard::default()),
        trajectory: Trajectory::LawnMower(LawnMower { lane_spacing_m: Some(4.0), sweeps: 1 }),
        vehicle: VehicleConfig { speed_m_per_s: 1.5, max_yaw_rate_rad_per_s: 0.8, lookahead_m: 2.0 },
        sensor: SensorSettings { field_of_view_rad: 1.5 * PI, ..sensor(0.05, 0.7, 10.0) },
        scan: ScanConfig {
            detection_probability: 0.9,
            clutter_per_scan: 0.1,
            identities: Identities::None,
            signature: Some(Signature { mean_m: 0.15, spread_std_m: 0.03, measurement_std_m: 0.02 }),
            ..ScanConfig::default()
        },
        ..SimulationConfig::default()
    }
}

/// 50,000 landmarks, every one of them visited, identities given, no clutter.
fn headline() -> SimulationConfig {
    SimulationConfig {
        world: random(50_000, [1000.0, 1000.0], 1.0),
        trajectory: Trajectory::LawnMower(LawnMower { lane_spacing_m: None, sweeps: 1 }),
        vehicle: VehicleConfig { speed_m_per_s: 2.0, max_yaw_rate_rad_per_s: 1.0, lookahead_m: 3.0 },
        control_period_s: 0.5,
        motion: Motion::Increments(Increments {
            x_std_m: 0.01,
            y_std_m: 0.01,
            heading_std_rad: 0.05_f64.to_radians(),
            ..Increments::default()
        }),
        sensor: sensor(0.1, 1.0, 10.0),
        scan: ScanConfig { period_s: 1.0, ..ScanConfig::default() },
        ..SimulationConfig::default()
    }
}

/// A car among trees in a park: 26 minutes, a laser that looks ahead, misses, clutter and no identities.
fn victoria_like() -> SimulationConfig {
    SimulationConfig {
        world: random(200, [280.0, 200.0], 3.0),
        trajectory: Trajectory::RandomWalk(RandomWalk { cell_m: Some(25.0) }),
        vehicle: VehicleConfig { speed_m_per_s: 2.6, max_yaw_rate_rad_per_s: 0.5, lookahead_m: 12.0 },
        control_period_s: 0.025,
        max_duration_s: Some(1550.0),
        motion: Motion::Ackermann(Ackermann { noise_period_s: Some(0.025), ..Ackermann::default() }),
        sensor: SensorSettings { field_of_view_rad: PI, min_range_m: 1.0, ..sensor(0.5, 1.5, 50.0) },
        scan: ScanConfig {
            period_s: 0.2,
            detection_probability: 0.6,
            clutter_per_scan: 0.5,
            identities: Identities::None,
            signature: Some(Signature { mean_m: 0.8, spread_std_m: 0.4, measurement_std_m: 0.3 }),
            ..ScanConfig::default()
        },
        ..SimulationConfig::default()
    }
}

/// A rover with a laser among rocks between walls: raw scans, from which the rocks are found.
fn rover() -> SimulationConfig {
    SimulationConfig {
        world: random(40, [30.0, 16.0], 1.6),
        trajectory: Trajectory::Loop(Loop { laps: 2, margin_m: 4.0, corner_radius_m: 3.0 }),
        vehicle: VehicleConfig { speed_m_per_s: 0.4, max_yaw_rate_rad_per_s: 0.3, lookahead_m: 1.0 },
        motion: Motion::Velocity(Velocity {
            speed_std_m_per_s: 0.04,
            yaw_rate_std_rad_per_s: 0.03,
            lateral_std_m_per_s: 0.0,
            noise_period_s: Some(0.1),
            ..Velocity::default()
        }),
        sensor: SensorSettings { field_of_view_rad: PI, min_range_m: 0.1, ..sensor(0.05, 0.6, 20.0) },
        scan: ScanConfig {
            period_s: 0.5,
            identities: Identities::None,
            laser: Some(LaserConfig::default()),
            ..ScanConfig::default()
        },
        ..SimulationConfig::default()
    }
}
