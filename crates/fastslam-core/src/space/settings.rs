//! The configuration of a run in space.

use super::pose::{Rotation, SpacePose};
use crate::error::{coordinate, finite, fraction, non_negative, positive, Error, Result};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Everything that determines a run in space, given its log.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct SpaceConfig {
    /// Seed of all random numbers: the same seed gives the same bits.
    pub seed: u64,
    /// Particles, resampling, draws.
    pub filter: SpaceFilter,
    /// What is measured of the robot's motion, and how surely.
    pub motion: SpaceMotionNoise,
    /// What the robot sees with.
    pub sensor: SpaceSensor,
    /// Where the robot starts; it defines the world frame.
    pub initial_pose: Placement,
}

/// Particles, resampling, draws.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct SpaceFilter {
    /// Number of particles.
    pub particles: u32,
    /// Threads; results do not depend on it.
    pub threads: u32,
    /// Resampled when the effective sample size falls below this fraction of the particles.
    pub resampling_threshold: f64,
    /// Scans between the first draws of all particles from the posterior over the whole path; later ones are a fixed
    /// fraction of the path apart. 0: none.
    pub draw_every_scans: u32,
    /// Later draws are this fraction of the path so far apart.
    pub draw_fraction: f64,
    /// Poses on the path are no further apart than this where nothing is seen.
    pub path_period_s: f64,
}

impl Default for SpaceFilter {
    fn default() -> Self {
        Self {
            particles: 200,
            threads: 1,
            resampling_threshold: 0.5,
            draw_every_scans: 10,
            draw_fraction: 0.02,
            path_period_s: 0.05,
        }
    }
}

/// What is measured of the robot's motion.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum SpaceMotionKind {
    /// Velocities along and about all axes.
    #[default]
    Odometry,
    /// Velocities about the axes; those along them wander.
    Gyro,
    /// Nothing: all velocities wander.
    Wandering,
}

/// Motion in the robot's own axes: noise of the velocities that are measured, as it grows with the root of time, and how
/// those wander that are not.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct SpaceMotionNoise {
    /// What is measured.
    pub kind: SpaceMotionKind,
    /// `odometry`: of the way along x, y, z after one second. A velocity that errs by s in rows of d seconds makes s √d.
    pub position_std_m_per_sqrt_s: [f64; 3],
    /// `odometry`, `gyro`: of the turn about x, y, z after one second.
    pub turn_std_rad_per_sqrt_s: [f64; 3],
    /// `gyro`, `wandering`: how fast the robot is along x, y, z, as a standard deviation over its way.
    pub velocity_std_m_per_s: [f64; 3],
    /// `wandering`: how fast it turns about x, y, z.
    pub rate_std_rad_per_s: [f64; 3],
    /// `gyro`, `wandering`: the time after which a velocity has kept a third of what it was.
    pub velocity_time_s: f64,
}

impl Default for SpaceMotionNoise {
    fn default() -> Self {
        Self {
            kind: SpaceMotionKind::default(),
            position_std_m_per_sqrt_s: [0.02; 3],
            turn_std_rad_per_sqrt_s: [0.02; 3],
            velocity_std_m_per_s: [0.5; 3],
            rate_std_rad_per_s: [0.5; 3],
            velocity_time_s: 2.0,
        }
    }
}

impl SpaceMotionNoise {
    fn validate(&self) -> Result<()> {
        for (key, values) in [
            ("position_std_m_per_sqrt_s", self.position_std_m_per_sqrt_s),
            ("turn_std_rad_per_sqrt_s", self.turn_std_rad_per_sqrt_s),
        ] {
            values.into_iter().try_for_each(|value| non_negative(key, value).map(drop))?;
        }
        for (key, values) in
            [("velocity_std_m_per_s", self.velocity_std_m_per_s), ("rate_std_rad_per_s", self.rate_std_rad_per_s)]
        {
            values.into_iter().try_for_each(|value| positive(key, value).map(drop))?;
        }
        positive("velocity_time_s", self.velocity_time_s).map(drop)
    }
}

/// Which three numbers of a landmark a sensor reports.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum SpaceSensorModel {
    /// Coordinates in the sensor's frame, metres.
    #[default]
    Point,
    /// Range in metres, bearing and elevation in radians.
    RangeBearingElevation,
    /// Column and row in the left image and disparity, pixels.
    Stereo,
}

/// What the robot sees with.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct SpaceSensor {
    /// Which three numbers.
    pub model: SpaceSensorModel,
    /// `point`: standard deviation of each coordinate.
    pub position_std_m: [f64; 3],
    /// `range_bearing_elevation`: of the range.
    pub range_std_m: f64,
    /// `range_bearing_elevation`: of the bearing.
    pub bearing_std_rad: f64,
    /// `range_bearing_elevation`: of the elevation.
    pub elevation_std_rad: f64,
    /// `stereo`: of a column in either image.
    pub column_std_px: f64,
    /// `stereo`: of a row in either image.
    pub row_std_px: f64,
    /// `stereo`: the optics.
    pub camera: Camera,
    /// The sensor on the robot.
    pub mounting: Placement,
    /// Nearer sightings are left out.
    pub min_range_m: f64,
    /// Farther sightings are left out.
    pub max_range_m: f64,
}

impl Default for SpaceSensor {
    fn default() -> Self {
        Self {
            model: SpaceSensorModel::default(),
            position_std_m: [0.1; 3],
            range_std_m: 0.1,
            bearing_std_rad: 0.02,
            elevation_std_rad: 0.02,
            column_std_px: 2.0,
            row_std_px: 2.0,
            camera: Camera::default(),
            mounting: Placement::default(),
            min_range_m: 0.01,
            max_range_m: 100.0,
        }
    }
}

/// The optics of a pair of rectified cameras.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Camera {
    /// Focal length across, pixels.
    pub fu_px: f64,
    /// Focal length down, pixels.
    pub fv_px: f64,
    /// Column of the optical axis.
    pub cu_px: f64,
    /// Row of the optical axis.
    pub cv_px: f64,
    /// From the left camera to the right one.
    pub baseline_m: f64,
}

impl Default for Camera {
    fn default() -> Self {
        Self { fu_px: 500.0, fv_px: 500.0, cu_px: 320.0, cv_px: 240.0, baseline_m: 0.2 }
    }
}

/// A pose of one frame in another.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Placement {
    /// Along the first axis.
    pub x_m: f64,
    /// Along the second axis.
    pub y_m: f64,
    /// Along the third axis.
    pub z_m: f64,
    /// The turn as a quaternion: cosine of half the angle.
    pub qw: f64,
    /// First coordinate of the axis, times the sine of half the angle.
    pub qx: f64,
    /// Second coordinate.
    pub qy: f64,
    /// Third coordinate.
    pub qz: f64,
}

impl Default for Placement {
    fn default() -> Self {
        Self { x_m: 0.0, y_m: 0.0, z_m: 0.0, qw: 1.0, qx: 0.0, qy: 0.0, qz: 0.0 }
    }
}

impl Placement {
    /// As a transform.
    pub fn pose(&self) -> SpacePose {
        let rotation = Rotation { w: self.qw, v: [self.qx, self.qy, self.qz] }.normalized();
        SpacePose { rotation, position: [self.x_m, self.y_m, self.z_m] }
    }

    fn validate(&self) -> Result<()> {
        coordinate("x_m", self.x_m)?;
        coordinate("y_m", self.y_m)?;
        coordinate("z_m", self.z_m)?;
        let length = [self.qw, self.qx, self.qy, self.qz].iter().map(|q| q * q).sum::<f64>().sqrt();
        if (0.99..=1.01).contains(&length) {
            return Ok(());
        }
        Err(Error::parameter("qw", self.qw, "a quaternion of length 1 with qx, qy and qz"))
    }
}

impl SpaceConfig {
    /// Errors that name the first key out of range.
    pub fn validate(&self) -> Result<()> {
        self.filter.validate().map_err(|e| e.within("filter"))?;
        self.motion.validate().map_err(|e| e.within("motion"))?;
        self.sensor.validate().map_err(|e| e.within("sensor"))?;
        self.initial_pose.validate().map_err(|e| e.within("initial_pose"))
    }
}

impl SpaceFilter {
    fn validate(&self) -> Result<()> {
        if !(1..=1_000_000).contains(&self.particles) {
            return Err(Error::parameter("particles", self.particles, "1 to 1000000"));
        }
        if !(1..=256).contains(&self.threads) {
            return Err(Error::parameter("threads", self.threads, "1 to 256"));
        }
        fraction("resampling_threshold", self.resampling_threshold)?;
        fraction("draw_fraction", self.draw_fraction)?;
        positive("path_period_s", self.path_period_s).map(drop)
    }
}

impl SpaceSensor {
    fn validate(&self) -> Result<()> {
        self.position_std_m.into_iter().try_for_each(|value| positive("position_std_m", value).map(drop))?;
        positive("range_std_m", self.range_std_m)?;
        positive("bearing_std_rad", self.bearing_std_rad)?;
        positive("elevation_std_rad", self.elevation_std_rad)?;
        positive("column_std_px", self.column_std_px)?;
        positive("row_std_px", self.row_std_px)?;
        let Camera { fu_px, fv_px, cu_px, cv_px, baseline_m } = self.camera;
        positive("camera.fu_px", fu_px)?;
        positive("camera.fv_px", fv_px)?;
        finite("camera.cu_px", cu_px)?;
        finite("camera.cv_px", cv_px)?;
        positive("camera.baseline_m", baseline_m)?;
        self.mounting.validate().map_err(|e| e.within("mounting"))?;
        positive("min_range_m", self.min_range_m)?;
        positive("max_range_m", self.max_range_m)?;
        if self.min_range_m > self.max_range_m {
            let expected = format!("at most sensor.max_range_m = {}", self.max_range_m);
            return Err(Error::parameter("min_range_m", self.min_range_m, expected));
        }
        Ok(())
    }
}
