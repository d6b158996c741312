//! The simulated world: where landmarks stand, how the robot moves, what it reports and sees.

use crate::settings::Settings;
use fastslam_core::geometry::Pose;
use fastslam_core::math;
use fastslam_core::motion::Proportional;
use fastslam_core::random::{Purpose, RandomSource, Stream};
use fastslam_core::sighting::Sighting;
use fastslam_sim::arena::Arena;

/// Duration of one row of odometry.
pub const TICK_S: f64 = 0.05;
/// Rows between two scans.
pub const TICKS_PER_SCAN: u64 = 5;
/// What the robot can do.
const FASTEST_M_PER_S: f64 = 4.0;
const FASTEST_RAD_PER_S: f64 = 2.0;

/// A landmark in view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Seen {
    /// Which it is.
    pub landmark: u32,
    /// What the sensor reports.
    pub range_m: f64,
    /// Counter-clockwise from straight ahead.
    pub bearing_rad: f64,
}

impl Seen {
    /// As filters are told of it.
    pub fn sighting(&self, with_name: bool) -> Sighting {
        Sighting::range_bearing(self.range_m, self.bearing_rad, with_name.then_some(self.landmark))
    }
}

/// A robot among landmarks.
#[derive(Clone, Debug)]
pub struct World {
    /// Where the landmarks stand, metres.
    pub landmarks: Vec<[f64; 2]>,
    /// Where the robot truly is.
    pub T_world_robot: Pose,
    /// Where it would be by its odometry alone.
    pub T_world_reported: Pose,
    /// Where it truly was at every scan.
    pub path: Vec<[f64; 2]>,
    /// Where it was by its odometry.
    pub reported_path: Vec<[f64; 2]>,
    /// What it saw at the last scan.
    pub seen: Vec<Seen>,
    /// Rows of odometry so far.
    pub ticks: u64,
    random: RandomSource,
    odometry: Proportional,
    sensor_std: [f64; 2],
    reach_m: f64,
    side_m: f64,
}

/// Parts of the random numbers; those of the landmarks come before.
#[derive(Clone, Copy)]
enum Part {
    Odometry = 1,
    Sensor = 2,
}

impl World {
    /// The world of these settings, with the robot in its middle.
    pub fn new(settings: &Settings) -> Self {
        let side_m = settings.side_m;
        let arena = Arena::random(settings.seed, settings.landmarks, side_m, [0.05, 0.05], 0.02 * side_m / 2.0);
        Self {
            landmarks: arena.rocks().iter().map(|rock| rock.center_m).collect(),
            T_world_robot: Pose::default(),
            T_world_reported: Pose::default(),
            path: vec![[0.0; 2]],
            reported_path: vec![[0.0; 2]],
            seen: Vec::new(),
            ticks: 0,
            random: RandomSource::new(settings.seed),
            odometry: settings.odometry(),
            sensor_std: [settings.range_std_m, settings.bearing_std_rad],
            reach_m: settings.reach_m,
            side_m,
        }
    }

    /// Moves the robot for one tick, and returns the speed and yaw rate that its odometry reports.
    pub fn drive(&mut self, speed_m_per_s: f64, yaw_rate_rad_per_s: f64) -> [f64; 2] {
        let forward = speed_m_per_s.clamp(-FASTEST_M_PER_S, FASTEST_M_PER_S) * TICK_S;
        let turn = yaw_rate_rad_per_s.clamp(-FASTEST_RAD_PER_S, FASTEST_RAD_PER_S) * TICK_S;
        self.T_world_robot = self.T_world_robot.compose(Pose::from_twist(forward, 0.0, turn));
        let [ahead, _, about] = self.odometry.variances([forward, 0.0, turn]);
        let [a, b] = self.stream(Part::Odometry, self.ticks).normal_pair(0, 0);
        let [forward, turn] = [forward + a * ahead.sqrt(), turn + b * about.sqrt()];
        self.T_world_reported = self.T_world_reported.compose(Pose::from_twist(forward, 0.0, turn));
        self.ticks += 1;
        [forward / TICK_S, turn / TICK_S]
    }

    /// What the sensor sees now; kept in `seen`.
    pub fn look(&mut self) {
        let T_robot_world = self.T_world_robot.inverse();
        let stream = self.stream(Part::Sensor, self.ticks);
        self.seen.clear();
        for (index, landmark) in (0..).zip(&self.landmarks) {
            let [x, y] = T_robot_world.transform(*landmark);
            let range_m = (x * x + y * y).sqrt();
            if range_m > self.reach_m {
                continue;
            }
            let [a, b] = stream.normal_pair(index, 0);
            let bearing_rad = math::wrap_angle(math::atan2(y, x) + b * self.sensor_std[1]);
            let range_m = range_m + a * self.sensor_std[0];
            if range_m > 0.0 {
                self.seen.push(Seen { landmark: index, range_m, bearing_rad });
            }
        }
        let (truth, reported) = (self.T_world_robot, self.T_world_reported);
        self.path.push([truth.x, truth.y]);
        self.reported_path.push([reported.x, reported.y]);
    }

    /// Speed and yaw rate of a robot that drives round and round by itself: laps that shrink and grow.
    pub fn autopilot(&self) -> [f64; 2] {
        let pose = self.T_world_robot;
        let lap = math::atan2(pose.y, pose.x) + 0.5;
        let slow = 0.02 * self.ticks as f64 * TICK_S;
        let radius = self.side_m * (0.3 + 0.08 * math::sin_cos(slow).0);
        let (s, c) = math::sin_cos(lap);
        let [x, y] = pose.inverse().transform([radius * c, radius * s]);
        let error = math::atan2(y, x);
        [2.0, (2.0 * error).clamp(-1.0, 1.0)]
    }

    /// Speed and yaw rate that lead to a place.
    pub fn towards(&self, place_m: [f64; 2]) -> [f64; 2] {
        let [x, y] = self.T_world_robot.inverse().transform(place_m);
        let distance = (x * x + y * y).sqrt();
        if distance < 0.3 {
            return [0.0; 2];
        }
        let error = math::atan2(y, x);
        let speed = (1.5 * distance).min(3.0) * (1.0 - error.abs() / 1.6).max(0.1);
        [speed, (2.5 * error).clamp(-FASTEST_RAD_PER_S, FASTEST_RAD_PER_S)]
    }

    fn stream(&self, part: Part, index: u64) -> Stream {
        self.random.stream(Purpose::Simulation, ((part as u64) << 48) | index)
    }
}
