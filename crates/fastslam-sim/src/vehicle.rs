//! Driving along a path, and what the odometry records of it.

use crate::config::SimulationConfig;
use crate::draws::{Draws, Part};
use crate::path::Path;
use fastslam_core::error::{Error, Result};
use fastslam_core::geometry::Pose;
use fastslam_core::math::atan2;
use fastslam_core::motion::MotionModel;
use fastslam_core::motion::{Ackermann, Increments, Motion, Odometry, PoseColumns, Proportional, Velocity};
use fastslam_core::random::Stream;

/// A log with more control periods does not fit into the memory of the machines that this is for.
const MOST_PERIODS: usize = 100_000_000;

/// What was truly driven.
#[derive(Clone, Debug)]
pub struct Drive {
    /// What odometry without noise reports of each period, in the columns of the motion model.
    pub controls: Vec<[f64; 3]>,
    /// True `T_world_robot` at the beginning and after each period: one more than controls.
    pub poses: Vec<Pose>,
}

/// Follows the path with the vehicle, exactly as the motion model moves it without noise.
pub fn drive(config: &SimulationConfig, path: Path) -> Result<Drive> {
    let T_axle_robot = T_axle_robot(&config.motion);
    let dt_s = config.control_period_s;
    let mut pursuit = Pursuit { progress_m: 0.0, config, path };
    let mut pose = pursuit.path.pose_at(0.0).compose(T_axle_robot);
    let mut drive = Drive { controls: vec![], poses: vec![pose] };
    let most = config.max_duration_s.map_or(usize::MAX, |d| (d / dt_s + 1e-6) as usize);
    let patience = pursuit.most_periods();
    if patience.min(most) > MOST_PERIODS {
        let expected = format!("a longer period: at most {MOST_PERIODS} of them fit into memory");
        return Err(Error::parameter("control_period_s", dt_s, expected));
    }
    while drive.controls.len() < most {
        let Some([speed, yaw_rate]) = pursuit.command(pose.compose(T_axle_robot.inverse())) else { break };
        if drive.controls.len() >= patience {
            let got = format!("a path that is not finished after {patience} control periods");
            return Err(Error::parameter("vehicle.lookahead_m", got, "a look-ahead shorter than the path's features"));
        }
        let control = control_of(&config.motion, [speed, yaw_rate], dt_s);
        pose = pose.compose(config.motion.mean_motion(control, dt_s));
        drive.controls.push(control);
        drive.poses.push(pose);
    }
    if drive.controls.is_empty() {
        return Err(Error::parameter("max_duration_s", format!("{:?}", config.max_duration_s), "at least one period"));
    }
    Ok(drive)
}

/// The point that a motion model moves, seen from the point that drives without sliding sideways.
fn T_axle_robot(motion: &Motion) -> Pose {
    match motion {
        Motion::Ackermann(car) => Pose::new(car.sensor_ahead_m, car.sensor_left_m, 0.0),
        Motion::Velocity(_) | Motion::Odometry(_) | Motion::Increments(_) => Pose::default(),
    }
}

/// Pure pursuit: aim at the point of the path that lies a fixed length ahead, along an arc.
struct Pursuit<'a> {
    config: &'a SimulationConfig,
    path: Path,
    progress_m: f64,
}

impl Pursuit<'_> {
    /// Speed and yaw rate for the next period, or none at the end of the path.
    fn command(&mut self, T_world_axle: Pose) -> Option<[f64; 2]> {
        let vehicle = &self.config.vehicle;
        let step_m = vehicle.speed_m_per_s * self.config.control_period_s;
        let window = (self.progress_m + vehicle.lookahead_m + step_m).min(self.path.length_m());
        let here = [T_world_axle.x, T_world_axle.y];
        self.progress_m = self.path.nearest_between(self.progress_m, window, here);
        if self.progress_m >= self.path.length_m() - 0.5 * step_m {
            return None;
        }
        let target = self.path.pose_at(self.progress_m + vehicle.lookahead_m);
        let [ahead, left] = T_world_axle.inverse().transform([target.x, target.y]);
        let limit = 2.0 / vehicle.lookahead_m;
        // The circle that is tangent to the heading and passes the target has curvature 2 left / distance².
        let curvature = if ahead > 0.0 {
            (2.0 * left / (ahead * ahead + left * left)).clamp(-limit, limit)
        } else {
            limit.copysign(left)
        };
        let speed = vehicle.speed_m_per_s.min(vehicle.max_yaw_rate_rad_per_s / curvature.abs());
        Some([speed, speed * curvature])
    }

    /// More periods than any path takes that the vehicle can follow.
    fn most_periods(&self) -> usize {
        let vehicle = &self.config.vehicle;
        let slowest = vehicle.speed_m_per_s.min(0.5 * vehicle.max_yaw_rate_rad_per_s * vehicle.lookahead_m);
        let length_m = self.path.length_m() + 10.0 * vehicle.lookahead_m;
        (4.0 * length_m / (slowest * self.config.control_period_s)) as usize + 100
    }
}

/// What odometry without noise reports of a period with this speed of the axle and yaw rate: gains and biases undone.
fn control_of(motion: &Motion, [speed, yaw_rate]: [f64; 2], dt_s: f64) -> [f64; 3] {
    let twist = [speed * dt_s, 0.0, yaw_rate * dt_s];
    match motion {
        Motion::Velocity(m) => rates(m.correction.report_of(twist, dt_s), dt_s),
        Motion::Ackermann(car) => steering_of(car, [speed, yaw_rate]),
        Motion::Odometry(m) => displacement(m.correction.report_of(twist, dt_s)),
        Motion::Increments(m) => displacement(m.correction.report_of(twist, dt_s)),
    }
}

fn rates([forward, _, turn]: [f64; 3], dt_s: f64) -> [f64; 3] {
    [forward / dt_s, turn / dt_s, 0.0]
}

fn displacement([forward, left, turn]: [f64; 3]) -> [f64; 3] {
    Pose::from_twist(forward, left, turn).to_array()
}

/// Speed and steering angle that the car reports. The encoder's wheel is nearer to the centre of a left turn.
fn steering_of(car: &Ackermann, [speed, yaw_rate]: [f64; 2]) -> [f64; 3] {
    let [_, _, steered] = car.correction.report_of([0.0, 0.0, yaw_rate], 1.0);
    let (encoder, angle) = (speed - steered * car.encoder_left_m, atan2(steered * car.wheelbase_m, speed));
    [encoder / car.correction.distance_gain, (angle - car.steering_bias_rad) / car.steering_gain, 0.0]
}

/// The odometry: what is reported without noise, with the noise of the model.
///
/// The truth given the record is distributed as a filter with the same model supposes, but for this: the noise is
/// scaled by the true motion here and by the recorded one there; speeds err by the same all over a row, so that the
/// heading's error swings the way by a half and not by a third in variance; and what a record cannot say, slip
/// sideways, is not simulated for `velocity` and `ackermann`.
pub fn record(config: &SimulationConfig, reports: &[[f64; 3]], draws: Draws) -> Vec<[f64; 3]> {
    let stream = draws.stream(Part::Odometry, 0);
    let dt_s = config.control_period_s;
    let noisy = |(i, report): (usize, &[f64; 3])| {
        let noise = RowNoise { stream, row: i as u32, dt_s };
        match &config.motion {
            Motion::Velocity(m) => noise.on_rates(m, *report),
            Motion::Ackermann(m) => noise.on_steering(m, *report),
            Motion::Increments(m) => noise.on_displacement(m, *report),
            Motion::Odometry(m) => noise.on_turns(m, *report),
        }
    };
    reports.iter().enumerate().map(noisy).collect()
}

/// The noise of one row.
struct RowNoise {
    stream: Stream,
    row: u32,
    dt_s: f64,
}

impl RowNoise {
    fn normals(&self) -> [f64; 3] {
        let [a, b] = self.stream.normal_pair(self.row, 0);
        [a, b, self.stream.normal_pair(self.row, 1)[0]]
    }

    /// A twist with the noise that is in proportion to the true one.
    fn in_proportion(&self, proportional: &Proportional, truth: [f64; 3], twist: [f64; 3]) -> [f64; 3] {
        let [a, b] = self.stream.normal_pair(self.row, 2);
        let [c, _] = self.stream.normal_pair(self.row, 3);
        let std = proportional.variances(truth).map(f64::sqrt);
        [twist[0] + std[0] * a, twist[1] + std[1] * b, twist[2] + std[2] * c]
    }

    fn on_rates(&self, model: &Velocity, report: [f64; 3]) -> [f64; 3] {
        let row = model.row(report, self.dt_s);
        let (twist, diffusion) = (row.twist, row.diffusion());
        let [a, b, _] = self.normals();
        let noisy = [twist[0] + diffusion[0][0].sqrt() * a, 0.0, twist[2] + diffusion[2][2].sqrt() * b];
        rates(model.correction.report_of(noisy, self.dt_s), self.dt_s)
    }

    fn on_steering(&self, car: &Ackermann, report: [f64; 3]) -> [f64; 3] {
        let [a, b, _] = self.normals();
        let of_mean = (car.noise_period_s.unwrap_or(self.dt_s) / self.dt_s).sqrt();
        let noisy = [
            report[0] + car.speed_std_m_per_s * of_mean * a / car.correction.distance_gain,
            report[1] + car.steering_std_rad * of_mean * b / car.steering_gain,
            0.0,
        ];
        if car.proportional == Proportional::default() {
            return noisy;
        }
        let [forward, _, turn] =
            self.in_proportion(&car.proportional, car.row(report, self.dt_s).twist, car.row(noisy, self.dt_s).twist);
        steering_of(car, [(forward + turn * car.sensor_left_m) / self.dt_s, turn / self.dt_s])
    }

    fn on_displacement(&self, model: &Increments, report: [f64; 3]) -> [f64; 3] {
        let truth = model.row(report, self.dt_s).twist;
        let [x, y, heading] = displacement(truth);
        let [a, b, c] = self.normals();
        let (x, y) = (x + model.x_std_m * a, y + model.y_std_m * b);
        let twist = Pose::new(x, y, heading + model.heading_std_rad * c).to_twist();
        let noisy = self.in_proportion(&model.proportional, truth, twist);
        displacement(model.correction.report_of(noisy, self.dt_s))
    }

    fn on_turns(&self, model: &Odometry, report: [f64; 3]) -> [f64; 3] {
        let (mut x, mut y, mut heading) = ([0.0], [0.0], [0.0]);
        let poses = PoseColumns { first_particle: self.row, x: &mut x, y: &mut y, heading: &mut heading };
        model.row(report, self.dt_s).part(1.0).sample(self.stream, poses);
        let twist = Pose::new(x[0], y[0], heading[0]).to_twist();
        displacement(model.correction.report_of(twist, self.dt_s))
    }
}
