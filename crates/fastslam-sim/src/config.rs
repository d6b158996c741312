//! The settings of a simulation.

use fastslam_core::error::{finite, non_negative, positive, Error, Result};
use fastslam_core::geometry::Pose;
use fastslam_core::measurement::Sensor;
use fastslam_core::motion::Motion;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// More than this does not fit into the memory of the machines that this is for.
const MOST_LANDMARKS: u32 = 50_000_000;

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
    pub sensor: Sensor,
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
            sensor: Sensor { max_range_m: 10.0, ..Sensor::default() },
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
    /// Number of control periods between scans.
    pub fn controls_per_scan(&self) -> usize {
        (self.scan.period_s / self.control_period_s).round() as usize
    }

    /// Errors that name the first setting out of range.
    pub fn validate(&self) -> Result<()> {
        if let Some(start) = self.start {
            finite("start.x_m", start.x_m)?;
            finite("start.y_m", start.y_m)?;
            finite("start.heading_rad", start.heading_rad)?;
        }
        self.world.validate().map_err(|e| e.within("world"))?;
        self.trajectory.validate().map_err(|e| e.within("trajectory"))?;
        self.motion.validate()?;
        self.validate_sensor()?;
        self.validate_classes().map_err(|e| e.within("classes"))?;
        positive("control_period_s", self.control_period_s)?;
        if let Some(duration_s) = self.max_duration_s {
            positive("max_duration_s", duration_s)?;
        }
        self.vehicle.validate(self.control_period_s).map_err(|e| e.within("vehicle"))?;
        self.scan.validate(self.control_period_s).map_err(|e| e.within("scan"))
    }

    fn validate_sensor(&self) -> Result<()> {
        let sensor = &self.sensor;
        sensor.validate()?;
        if sensor.max_range_m <= sensor.min_range_m {
            let expected = format!("more than sensor.min_range_m ({})", sensor.min_range_m);
            return Err(Error::parameter("sensor.max_range_m", sensor.max_range_m, expected));
        }
        if sensor.field_of_view_rad > std::f64::consts::TAU {
            return Err(Error::parameter("sensor.field_of_view_rad", sensor.field_of_view_rad, "at most 2π"));
        }
        Ok(())
    }

    fn validate_classes(&self) -> Result<()> {
        let names = &self.classes.names;
        probability("confusion_probability", self.classes.confusion_probability)?;
        if !names.is_empty() && matches!(self.world, World::Cones(_)) {
            return Err(Error::parameter("names", format!("{names:?}"), "none: a track of cones brings its own"));
        }
        if let Some(name) = names.iter().enumerate().find_map(|(i, name)| names[..i].contains(name).then_some(name)) {
            return Err(Error::parameter("names", format!("{name:?} twice"), "distinct names"));
        }
        Ok(())
    }
}

impl World {
    fn validate(&self) -> Result<()> {
        match self {
            Self::Random(field) => {
                count("count", field.count, MOST_LANDMARKS)?;
                positive("size_m", field.size_m[0])?;
                positive("size_m", field.size_m[1])?;
                non_negative("min_spacing_m", field.min_spacing_m).map(drop)
            }
            Self::Orchard(orchard) => orchard.validate(),
            Self::Cones(cones) => cones.validate(),
            Self::Explicit(explicit) => points("points_m", &explicit.points_m, 1),
        }
    }
}

impl Orchard {
    fn validate(&self) -> Result<()> {
        count("rows", self.rows, MOST_LANDMARKS)?;
        count("columns", self.columns, MOST_LANDMARKS / self.rows)?;
        positive("row_spacing_m", self.row_spacing_m)?;
        positive("column_spacing_m", self.column_spacing_m)?;
        non_negative("jitter_std_m", self.jitter_std_m)?;
        probability("missing_probability", self.missing_probability)
    }
}

impl Cones {
    fn validate(&self) -> Result<()> {
        positive("track_length_m", self.track_length_m)?;
        positive("track_width_m", self.track_width_m)?;
        positive("spacing_m", self.spacing_m)?;
        probability("irregularity", self.irregularity)?;
        // A circle whose radius is twice the width: anything shorter cannot bend without its borders touching.
        let shortest = 2.0 * self.track_width_m * std::f64::consts::TAU;
        if self.track_length_m < shortest.max(3.0 * self.spacing_m) {
            return Err(Error::parameter(
                "track_length_m",
                self.track_length_m,
                format!("at least 4π widths ({shortest:.1} m) and three cones on each side"),
            ));
        }
        if self.track_length_m / self.spacing_m > 0.5 * f64::from(MOST_LANDMARKS) {
            let expected = format!("at most {} cones on each side", MOST_LANDMARKS / 2);
            return Err(Error::parameter("track_length_m", self.track_length_m, expected));
        }
        Ok(())
    }
}

impl Trajectory {
    fn validate(&self) -> Result<()> {
        match self {
            Self::Loop(path) => {
                count("laps", path.laps, 10_000)?;
                finite("margin_m", path.margin_m)?;
                non_negative("corner_radius_m", path.corner_radius_m).map(drop)
            }
            Self::Waypoints(path) => points("points_m", &path.points_m, 2),
            Self::LawnMower(path) => {
                optional_positive("lane_spacing_m", path.lane_spacing_m)?;
                count("sweeps", path.sweeps, 1000)
            }
            Self::Line(path) => {
                non_negative("sway_m", path.sway_m)?;
                positive("sway_period_m", path.sway_period_m).map(drop)
            }
            Self::RandomWalk(path) => optional_positive("cell_m", path.cell_m),
        }
    }
}

impl VehicleConfig {
    fn validate(&self, control_period_s: f64) -> Result<()> {
        positive("speed_m_per_s", self.speed_m_per_s)?;
        positive("max_yaw_rate_rad_per_s", self.max_yaw_rate_rad_per_s)?;
        positive("lookahead_m", self.lookahead_m)?;
        let step_m = self.speed_m_per_s * control_period_s;
        if self.lookahead_m < step_m {
            let expected = format!("at least the {step_m} m of one control period");
            return Err(Error::parameter("lookahead_m", self.lookahead_m, expected));
        }
        Ok(())
    }
}

impl ScanConfig {
    fn validate(&self, control_period_s: f64) -> Result<()> {
        positive("period_s", self.period_s)?;
        let ratio = self.period_s / control_period_s;
        if ratio.round() < 1.0 || (ratio - ratio.round()).abs() > 1e-6 {
            let expected = format!("a whole multiple of control_period_s ({control_period_s})");
            return Err(Error::parameter("period_s", self.period_s, expected));
        }
        probability("detection_probability", self.detection_probability)?;
        non_negative("clutter_per_scan", self.clutter_per_scan)?;
        if self.clutter_per_scan > 1e5 {
            return Err(Error::parameter("clutter_per_scan", self.clutter_per_scan, "at most 100000"));
        }
        probability("identities.fraction", self.identities.fraction())?;
        if let Some(signature) = &self.signature {
            positive("signature.mean_m", signature.mean_m)?;
            non_negative("signature.spread_std_m", signature.spread_std_m)?;
            non_negative("signature.measurement_std_m", signature.measurement_std_m)?;
        }
        Ok(())
    }
}

fn probability(key: &str, value: f64) -> Result<()> {
    if (0.0..=1.0).contains(&value) {
        Ok(())
    } else {
        Err(Error::parameter(key, value, "a number from 0 to 1"))
    }
}

fn optional_positive(key: &str, value: Option<f64>) -> Result<()> {
    value.map_or(Ok(()), |value| positive(key, value).map(drop))
}

fn count(key: &str, value: u32, most: u32) -> Result<()> {
    if (1..=most).contains(&value) {
        Ok(())
    } else {
        Err(Error::parameter(key, value, format!("from 1 to {most}")))
    }
}

fn points(key: &str, points: &[[f64; 2]], at_least: usize) -> Result<()> {
    if points.len() < at_least {
        return Err(Error::parameter(key, format!("{} points", points.len()), format!("at least {at_least}")));
    }
    match points.iter().position(|p| !(p[0].is_finite() && p[1].is_finite())) {
        Some(index) => {
            Err(Error::parameter(format!("{key}.{index}"), format!("{:?}", points[index]), "finite numbers"))
        }
        None => Ok(()),
    }
}
