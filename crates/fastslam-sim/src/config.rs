//! The settings of a simulation.

use fastslam_core::geometry::Pose;
use fastslam_core::measurement::{SensorSettings, Sensors};
use fastslam_core::motion::Motion;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Everything that determines a simulated log.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct SimulationConfig {
    /// Determines every random number.
    pub seed: u64,
    /// Pose of the robot at the beginning, in the world frame of the log; the scene is moved rigidly to make it so.
    /// `null`: the world frame stays that of the layout, and the robot starts wherever its path begins.
    pub start: Option<Start>,
    /// Where the landmarks stand.
    pub world: World,
    /// Classes of the landmarks.
    pub classes: Classes,
    /// Where the robot goes.
    pub trajectory: Trajectory,
    /// How the robot is driven along its path.
    pub vehicle: VehicleConfig,
    /// Time between two rows of odometry.
    pub control_period_s: f64,
    /// The log ends here, or where the path ends if that is sooner. `null`: at the end of the path.
    pub max_duration_s: Option<f64>,
    /// Motion model: the kind of odometry that is recorded, and its noise.
    pub motion: Motion,
    /// Sensor: its noise, limits and mounting.
    pub sensor: SensorSettings,
    /// In place of `sensor`, where the robot has several: a section like `sensor` for each, under its name. All look at
    /// the same moments.
    #[serde(skip_serializing_if = "Sensors::is_empty")]
    pub sensors: Sensors,
    /// When the sensor looks, and what goes wrong then.
    pub scan: ScanConfig,
}

impl Default for SimulationConfig {
    fn default() -> Self {
        Self {
            seed: 1,
            start: Some(Start::default()),
            world: World::Random(RandomField::default()),
            classes: Classes::default(),
            trajectory: Trajectory::Loop(Loop::default()),
            vehicle: VehicleConfig::default(),
            control_period_s: 0.1,
            max_duration_s: None,
            motion: Motion::default(),
            sensor: SensorSettings { max_range_m: 10.0, ..SensorSettings::default() },
            sensors: Sensors::default(),
            scan: ScanConfig::default(),
        }
    }
}

/// A pose in the world.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Start {
    /// East.
    pub x_m: f64,
    /// North.
    pub y_m: f64,
    /// Counter-clockwise from east.
    pub heading_rad: f64,
}

impl Start {
    /// As a transform.
    pub fn T_world_robot(&self) -> Pose {
        Pose::new(self.x_m, self.y_m, self.heading_rad)
    }
}

/// Layout of the landmarks.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "layout", rename_all = "snake_case")]
pub enum World {
    /// Scattered over a rectangle.
    Random(RandomField),
    /// Rows of trees, or any grid.
    Orchard(Orchard),
    /// The cones of a closed track.
    Cones(Cones),
    /// Given one by one.
    Explicit(Explicit),
}

/// Landmarks scattered uniformly over a rectangle.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct RandomField {
    /// Number of landmarks.
    pub count: u32,
    /// Width and height of the rectangle.
    pub size_m: [f64; 2],
    /// No two landmarks are nearer to each other than this.
    pub min_spacing_m: f64,
}

impl Default for RandomField {
    fn default() -> Self {
        Self { count: 100, size_m: [50.0, 40.0], min_spacing_m: 1.0 }
    }
}

/// Rows of landmarks.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Orchard {
    /// Number of rows.
    pub rows: u32,
    /// Number of landmarks in each row.
    pub columns: u32,
    /// Distance between rows.
    pub row_spacing_m: f64,
    /// Distance between the landmarks of a row.
    pub column_spacing_m: f64,
    /// Standard deviation of the displacement of each landmark from its place, in x and in y.
    pub jitter_std_m: f64,
    /// Probability that a place is empty.
    pub missing_probability: f64,
}

impl Default for Orchard {
    fn default() -> Self {
        Self {
            rows: 8,
            columns: 25,
            row_spacing_m: 4.0,
            column_spacing_m: 2.5,
            jitter_std_m: 0.1,
            missing_probability: 0.03,
        }
    }
}

/// A closed track between blue cones on the left and yellow cones on the right, as in Formula Student.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Cones {
    /// Length of the centre line.
    pub track_length_m: f64,
    /// Distance between the two borders.
    pub track_width_m: f64,
    /// Distance between the cones of a border, along the centre line.
    pub spacing_m: f64,
    /// How far the track is from a circle: from 0, a circle, to 1.
    pub irregularity: f64,
}

impl Default for Cones {
    fn default() -> Self {
        Self { track_length_m: 300.0, track_width_m: 3.5, spacing_m: 4.0, irregularity: 0.8 }
    }
}

/// Landmarks given one by one.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Explicit {
    /// x and y of each landmark.
    pub points_m: Vec<[f64; 2]>,
}

/// Classes of landmarks.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Classes {
    /// Names of the classes; each landmark gets one at random. Empty: no classes. A track of cones brings its own.
    pub names: Vec<String>,
    /// Probability that a sighting reports one of the other classes.
    pub confusion_probability: f64,
}

/// Where the robot goes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Trajectory {
    /// Laps along a rounded rectangle, counter-clockwise; on a track of cones along its centre line.
    Loop(Loop),
    /// From point to point.
    Waypoints(Waypoints),
    /// Parallel lanes, there and back; with more sweeps again across.
    LawnMower(LawnMower),
    /// Once through the middle of the field from left to right, almost straight.
    Line(Line),
    /// A random walk from cell to cell that ends when it has been in every cell of the field.
    RandomWalk(RandomWalk),
}

/// Laps.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Loop {
    /// Number of laps.
    pub laps: u32,
    /// Distance of the path from the border of the field, inwards; below 0 the path runs outside.
    pub margin_m: f64,
    /// Radius of the corners; half the shorter side or more makes round ends.
    pub corner_radius_m: f64,
}

impl Default for Loop {
    fn default() -> Self {
        Self { laps: 2, margin_m: 8.0, corner_radius_m: 6.0 }
    }
}

/// A list of points.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Waypoints {
    /// x and y of each point, in the frame of the layout of the landmarks.
    pub points_m: Vec<[f64; 2]>,
}

/// Parallel lanes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct LawnMower {
    /// Distance between lanes, made smaller where a whole number of lanes needs it. `null`: 1.4 times the sensor's
    /// range, so that a sensor that looks all around sees every landmark.
    pub lane_spacing_m: Option<f64>,
    /// Number of times the field is swept: 1 along x, 2 then along y, and so on.
    pub sweeps: u32,
}

impl Default for LawnMower {
    fn default() -> Self {
        Self { lane_spacing_m: None, sweeps: 1 }
    }
}

/// An almost straight line.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Line {
    /// How far the path swings to either side.
    pub sway_m: f64,
    /// Length of a full swing.
    pub sway_period_m: f64,
}

impl Default for Line {
    fn default() -> Self {
        Self { sway_m: 0.5, sway_period_m: 20.0 }
    }
}

/// A random walk that covers the field.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct RandomWalk {
    /// Largest side of the cells. `null`: the sensor's range, so that a sensor that looks all around sees every
    /// landmark.
    pub cell_m: Option<f64>,
}

/// A vehicle that follows its path by pure pursuit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct VehicleConfig {
    /// Speed on straights; in turns it is reduced to keep the yaw rate below its limit.
    pub speed_m_per_s: f64,
    /// Greatest yaw rate.
    pub max_yaw_rate_rad_per_s: f64,
    /// How far ahead on the path the vehicle aims. No turn is tighter than half of this.
    pub lookahead_m: f64,
}

impl Default for VehicleConfig {
    fn default() -> Self {
        Self { speed_m_per_s: 2.0, max_yaw_rate_rad_per_s: 1.0, lookahead_m: 2.0 }
    }
}

/// When the sensor looks, and what goes wrong then.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ScanConfig {
    /// Time between scans: a whole multiple of the control period.
    pub period_s: f64,
    /// Probability that a landmark in view is reported.
    pub detection_probability: f64,
    /// Mean number of false sightings per scan (Poisson), uniform over the area in view.
    pub clutter_per_scan: f64,
    /// At most this many landmarks are reported per scan, the nearest ones. `null`: all.
    pub max_sightings_per_scan: Option<u32>,
    /// Which sightings say what landmark they are of; false sightings never do.
    pub identities: Identities,
    /// A scalar that is measured of each landmark, such as the diameter of a trunk. `null`: none.
    pub signature: Option<Signature>,
    /// The log holds raw scans of a laser instead of sightings; the landmarks are round rocks. `null`: sightings.
    pub laser: Option<LaserConfig>,
}

impl Default for ScanConfig {
    fn default() -> Self {
        Self {
            period_s: 0.2,
            detection_probability: 1.0,
            clutter_per_scan: 0.0,
            max_sightings_per_scan: None,
            identities: Identities::All,
            signature: None,
            laser: None,
        }
    }
}

/// A planar laser among rocks. Its field of view and its reach are those of the sensor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct LaserConfig {
    /// Angle from one beam to the next.
    pub angle_step_rad: f64,
    /// Standard deviation of the range of a beam.
    pub range_std_m: f64,
    /// Probability that a beam reports nothing though it hit something.
    pub dropout_probability: f64,
    /// Smallest and largest radius of the rocks.
    pub radius_m: [f64; 2],
    /// Rocks whose surface is nearer to the path than this are taken away.
    pub clearance_m: f64,
    /// Walls around the field, this far beyond it. `null`: none.
    pub wall_margin_m: Option<f64>,
}

impl Default for LaserConfig {
    fn default() -> Self {
        Self {
            angle_step_rad: 0.5_f64.to_radians(),
            range_std_m: 0.02,
            dropout_probability: 0.002,
            radius_m: [0.1, 0.4],
            clearance_m: 0.5,
            wall_margin_m: Some(1.0),
        }
    }
}

/// Which sightings carry the identity of their landmark.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Identities {
    /// Every sighting of a landmark.
    #[default]
    All,
    /// No sighting.
    None,
    /// This fraction of the sightings, chosen at random.
    Fraction(f64),
}

impl Identities {
    /// Probability that a sighting of a landmark carries its identity.
    pub fn fraction(self) -> f64 {
        match self {
            Self::All => 1.0,
            Self::None => 0.0,
            Self::Fraction(fraction) => fraction,
        }
    }
}

/// A diameter, or any other scalar that tells landmarks apart.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Signature {
    /// Mean over the landmarks.
    pub mean_m: f64,
    /// Standard deviation over the landmarks; what falls below a tenth of the mean is raised to it.
    pub spread_std_m: f64,
    /// Standard deviation of its measurement.
    pub measurement_std_m: f64,
}

impl Default for Signature {
    fn default() -> Self {
        Self { mean_m: 0.3, spread_std_m: 0.1, measurement_std_m: 0.03 }
    }
}

impl SimulationConfig {
    /// The settings of the sensors, in the order of their numbers.
    pub fn each_sensor(&self) -> Vec<SensorSettings> {
        match self.sensors.is_empty() {
            true => vec![self.sensor.clone()],
            false => self.sensors.0.values().map(SensorSettings::from).collect(),
        }
    }

    /// How far the robot sees.
    pub fn max_range_m(&self) -> f64 {
        self.each_sensor().iter().map(|sensor| sensor.max_range_m).fold(0.0, f64::max)
    }

    /// Number of control periods between scans.
    pub fn controls_per_scan(&self) -> usize {
        (self.scan.period_s / self.control_period_s).round() as usize
    }
}
