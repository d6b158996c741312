//! A landmark as a robot sees it from a pose, with all derivatives: the one place where poses enter measurements.

use super::matrix::{apply, cross, multiply, transposed, Rows};
use super::pose::SpacePose;
use super::sensor::Spatial;
use crate::real::Real;

/// Where the sensor sits on the robot.
#[derive(Clone, Copy, Debug)]
pub struct Seat {
    /// Coordinates in the robot to coordinates in the sensor.
    turn: Rows<f64, 3, 3>,
    /// Of the sensor in the robot.
    lever: [f64; 3],
    turned: bool,
}

impl Seat {
    /// Of a pose of the sensor in the robot's frame.
    pub fn new(T_robot_sensor: SpacePose) -> Self {
        let turn = T_robot_sensor.rotation.inverse();
        Self { turn: turn.matrix(), lever: T_robot_sensor.position, turned: turn.v != [0.0; 3] }
    }
}

/// A pose of the robot, as looking from it needs it.
#[derive(Clone, Copy, Debug)]
pub struct Stand<R> {
    /// Coordinates in the world to those in the robot, but for the shift.
    pub to_robot: Rows<R, 3, 3>,
    position: [R; 3],
}

impl<R: Real> From<SpacePose<R>> for Stand<R> {
    #[inline(always)]
    fn from(T_world_robot: SpacePose<R>) -> Self {
        Self { to_robot: transposed(&T_world_robot.rotation.matrix()), position: T_world_robot.position }
    }
}

/// What is seen of a landmark.
#[derive(Clone, Copy, Debug)]
pub struct Look<R> {
    /// Measured minus expected.
    pub innovation: [R; 3],
    /// G_θ: derivative by the landmark's position.
    pub by_landmark: Rows<R, 3, 3>,
    /// G_s: derivative by ξ in `T_world_robot Exp(ξ)`.
    pub by_pose: Rows<R, 3, 6>,
}

/// A sensor where it sits.
#[derive(Clone, Copy, Debug)]
pub struct Eye<'a, M> {
    /// What it measures.
    pub model: &'a M,
    /// Where it sits.
    pub seat: &'a Seat,
}

impl<M: Spatial> Eye<'_, M> {
    /// With p the landmark in the robot's frame, p moves by −ρ + `[p]×` φ under ξ = (ρ, φ).
    #[inline(always)]
    pub fn look<R: Real>(&self, stand: &Stand<R>, landmark_in_world: [R; 3], measured: [R; 3]) -> Look<R> {
        let off = [
            landmark_in_world[0] - stand.position[0],
            landmark_in_world[1] - stand.position[1],
            landmark_in_world[2] - stand.position[2],
        ];
        let in_robot = apply(&stand.to_robot, &off);
        let (expected, by_robot) = self.seat.linearize(self.model, in_robot);
        let mut by_pose = [[R::constant(0.0); 6]; 3];
        for z in 0..3 {
            let lever = cross(by_robot[z], in_robot);
            for i in 0..3 {
                by_pose[z][i] = -by_robot[z][i];
                by_pose[z][3 + i] = lever[i];
            }
        }
        Look {
            innovation: self.model.innovation(measured, expected),
            by_landmark: multiply(&by_robot, &stand.to_robot),
            by_pose,
        }
    }
}

impl<M: Spatial> Eye<'_, M> {
    /// Whether a landmark lies where the sensor can see at all.
    pub fn sees(&self, stand: &Stand<f64>, landmark_in_world: [f64; 3]) -> bool {
        let off = std::array::from_fn(|i| landmark_in_world[i] - stand.position[i]);
        let in_robot = apply(&stand.to_robot, &off);
        let at = std::array::from_fn(|i| in_robot[i] - self.seat.lever[i]);
        self.model.sees(apply(&self.seat.turn, &at))
    }
}

impl Seat {
    /// The measurement of a point in the robot's frame, and its derivative by that point.
    #[inline(always)]
    fn linearize<R: Real>(&self, model: &impl Spatial, in_robot: [R; 3]) -> ([R; 3], Rows<R, 3, 3>) {
        let mut at = in_robot;
        for i in 0..3 {
            at[i] = in_robot[i] - R::constant(self.lever[i]);
        }
        if !self.turned {
            return model.linearize(at);
        }
        let turn = super::matrix::constant(&self.turn);
        let (expected, by_sensor) = model.linearize(apply(&turn, &at));
        (expected, multiply(&by_sensor, &turn))
    }
}
