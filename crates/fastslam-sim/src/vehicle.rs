//! Driving along a path, and what the odometry records of it.

use crate::config::SimulationConfig;
use crate::draws::{Draws, Part};
use crate::path::Path;
use fastslam_core::error::{Error, Result};
use fastslam_core::geometry::Pose;
use fastslam_core::math::atan2;
use fastslam_core::motion::{ConditionedControl, ControlTiming, Motion, MotionModel};

/// A log with more control periods does not fit into the memory of the machines that this is for.
const MOST_PERIODS: usize = 100_000_000;

/// What was truly driven.
#[derive(Clone, Debug)]
pub struct Drive {
    /// True control of each period, in the columns of the motion model.
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

/// The control that drives with a speed and a yaw rate for one period.
fn control_of(motion: &Motion, [speed, yaw_rate]: [f64; 2], dt_s: f64) -> [f64; 3] {
    match motion {
        Motion::Velocity(_) => [speed, yaw_rate, 0.0],
        // The speed is that of the axle's centre; the encoder's wheel is nearer to the centre of a left turn.
        Motion::Ackermann(car) => {
            [speed - yaw_rate * car.encoder_left_m, atan2(yaw_rate * car.wheelbase_m, speed), 0.0]
        }
        Motion::Odometry(_) | Motion::Increments(_) => Pose::from_twist(speed * dt_s, 0.0, yaw_rate * dt_s).to_array(),
    }
}

/// The odometry: the true controls with the noise of the model, in the model's coordinates of noise.
///
/// For noise that does not depend on the control (all models but `odometry`) the truth given the record is then
/// distributed exactly as a filter with the same model supposes; for `odometry` to first order, because its noise is
/// scaled by the true motion here and by the recorded one there.
pub fn record(config: &SimulationConfig, true_controls: &[[f64; 3]], draws: Draws) -> Vec<[f64; 3]> {
    let stream = draws.stream(Part::Odometry, 0);
    let dt_s = config.control_period_s;
    let noisy = |(i, control): (usize, &[f64; 3])| {
        let ConditionedControl { mean, std, .. } = condition(&config.motion, *control, dt_s);
        let [a, b] = stream.normal_pair(i as u32, 0);
        let [c, _] = stream.normal_pair(i as u32, 1);
        let coordinates = [mean[0] + std[0] * a, mean[1] + std[1] * b, mean[2] + std[2] * c];
        match config.motion.timing() {
            ControlTiming::Held => coordinates,
            ControlTiming::Increment => displacement(&config.motion, coordinates, dt_s),
        }
    };
    true_controls.iter().enumerate().map(noisy).collect()
}

fn condition(motion: &Motion, control: [f64; 3], dt_s: f64) -> ConditionedControl {
    match motion {
        Motion::Velocity(m) => m.condition(control, dt_s),
        Motion::Odometry(m) => m.condition(control, dt_s),
        Motion::Increments(m) => m.condition(control, dt_s),
        Motion::Ackermann(m) => m.condition(control, dt_s),
    }
}

fn displacement(motion: &Motion, coordinates: [f64; 3], dt_s: f64) -> [f64; 3] {
    let moved = match motion {
        Motion::Velocity(m) => m.relative_motion(coordinates, dt_s),
        Motion::Odometry(m) => m.relative_motion(coordinates, dt_s),
        Motion::Increments(m) => m.relative_motion(coordinates, dt_s),
        Motion::Ackermann(m) => m.relative_motion(coordinates, dt_s),
    };
    moved.to_array()
}
