//! The outcome of a simulation.

use crate::config::SimulationConfig;
use crate::vehicle::Drive;
use crate::world::Scene;
use fastslam_core::association::Appearance;
use fastslam_core::detect::BeamGeometry;
use fastslam_core::filter::Sighting;
use fastslam_core::measurement::Sensor;
use fastslam_core::motion::{ControlTiming, Motion};
use fastslam_core::timeline::LogData;

/// A log with its truth, column by column.
#[derive(Clone, Debug)]
pub struct SimulatedLog {
    /// Names of the columns of `controls`.
    pub control_columns: &'static [&'static str],
    /// Stamp of each row of odometry. Held controls: when the row begins to act; increments: when its motion ends.
    pub control_stamp_s: Vec<f64>,
    /// Recorded odometry, with noise; only the first `control_columns.len()` numbers of a row count.
    pub controls: Vec<[f64; 3]>,
    /// The same rows without noise: replayed from the first true pose they give the true path.
    pub true_controls: Vec<[f64; 3]>,
    /// What the sensor reported; nothing where there are scans.
    pub sightings: SimulatedSightings,
    /// Raw scans, where the sensor is a laser.
    pub scans: Option<SimulatedScans>,
    /// Stamp of each true pose: the beginning and the end of each control period.
    pub truth_stamp_s: Vec<f64>,
    /// True (x, y, heading) at each stamp.
    pub T_world_robot: Vec<[f64; 3]>,
    /// The landmarks.
    pub landmarks: SimulatedLandmarks,
    /// Names of the classes.
    pub class_names: Vec<String>,
    /// The motion model that a filter should be told.
    pub motion: Motion,
    /// The sensor that a filter should be told.
    pub sensor: Sensor,
}

impl SimulatedLog {
    /// What a filter is given of it: controls and sightings, without the truth.
    pub fn log_data(&self) -> LogData {
        LogData {
            control_stamps_s: self.control_stamp_s.clone(),
            controls: self.controls.clone(),
            sighting_stamps_s: self.sightings.stamp_s.clone(),
            sighting_sensors: self.sightings.sensor.clone(),
            sightings: (0..self.sightings.len()).map(|i| self.sightings.sighting(i)).collect(),
            ..LogData::default()
        }
    }
}

/// Sightings in order of time and sensor and, within a scan, of bearing.
#[derive(Clone, Debug, Default)]
pub struct SimulatedSightings {
    /// When.
    pub stamp_s: Vec<f64>,
    /// Number of the sensor that made it: its place in the order of the names.
    pub sensor: Vec<u8>,
    /// Distance from the sensor.
    pub range_m: Vec<f64>,
    /// Direction in the frame of the sensor.
    pub bearing_rad: Vec<f64>,
    /// Index of the landmark, −1 where it is withheld and for false sightings.
    pub identity: Vec<i64>,
    /// Index of the landmark, −1 for false sightings: for scoring, not for the filter.
    pub true_identity: Vec<i64>,
    /// Reported class, −1 for none.
    pub class_index: Vec<i64>,
    /// Measured signature in metres, NaN for none.
    pub signature: Vec<f64>,
}

impl SimulatedSightings {
    /// Number of sightings.
    pub fn len(&self) -> usize {
        self.stamp_s.len()
    }

    /// Whether nothing was sighted.
    pub fn is_empty(&self) -> bool {
        self.stamp_s.is_empty()
    }

    /// One of them as a filter is given it.
    fn sighting(&self, i: usize) -> Sighting {
        let appearance = Appearance {
            class: u32::try_from(self.class_index[i]).ok(),
            signature: Some(self.signature[i]).filter(|value| value.is_finite()),
        };
        let identity = u32::try_from(self.identity[i]).ok();
        Sighting { appearance, ..Sighting::range_bearing(self.range_m[i], self.bearing_rad[i], identity) }
    }
}

/// Raw scans in order of time.
#[derive(Clone, Debug)]
pub struct SimulatedScans {
    /// When.
    pub stamp_s: Vec<f64>,
    /// Beams of a scan.
    pub beams: usize,
    /// Where they point and how far they reach.
    pub geometry: BeamGeometry,
    /// Scan by scan; infinity where nothing was hit, NaN where a beam dropped out.
    pub ranges_m: Vec<f64>,
}

/// True landmarks, by index.
#[derive(Clone, Debug, Default)]
pub struct SimulatedLandmarks {
    /// Positions in the world.
    pub position_m: Vec<[f64; 2]>,
    /// True class, −1 for none.
    pub class_index: Vec<i64>,
    /// True signature in metres, NaN for none.
    pub signature: Vec<f64>,
    /// Whether any sighting of it is in the log; empty where there are scans.
    pub seen: Vec<bool>,
}

/// What the stages of a simulation made.
pub struct Parts {
    /// The landmarks.
    pub world: Scene,
    /// The true path.
    pub drive: Drive,
    /// The recorded odometry.
    pub controls: Vec<[f64; 3]>,
    /// The sightings.
    pub sightings: SimulatedSightings,
    /// The scans.
    pub scans: Option<SimulatedScans>,
    /// Whether each landmark was ever sighted.
    pub seen: Vec<bool>,
}

/// The log of all parts, with stamps.
pub fn assemble(config: &SimulationConfig, parts: Parts) -> SimulatedLog {
    let Parts { world, drive, controls, sightings, scans, seen } = parts;
    let stamp_s = |index: usize| index as f64 * config.control_period_s;
    let first = match config.motion.timing() {
        ControlTiming::Held => 0,
        ControlTiming::Increment => 1,
    };
    SimulatedLog {
        control_columns: config.motion.control_columns(),
        control_stamp_s: (first..first + controls.len()).map(stamp_s).collect(),
        controls,
        true_controls: drive.controls,
        sightings,
        scans,
        truth_stamp_s: (0..drive.poses.len()).map(stamp_s).collect(),
        T_world_robot: drive.poses.iter().map(|pose| pose.to_array()).collect(),
        landmarks: SimulatedLandmarks {
            position_m: world.position_m,
            class_index: world.class_index,
            signature: world.signature,
            seen,
        },
        class_names: world.class_names,
        motion: config.motion.clone(),
        // Where there are several, the configuration has them.
        sensor: if config.sensors.is_empty() { config.sensor.clone().into() } else { Sensor::default() },
    }
}
