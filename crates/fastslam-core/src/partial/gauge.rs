//! Where a map with the robot in it lies in the world, as far as only the start of the path says.
//!
//! Whoever hears landmarks knows where he is among them; how the whole is turned and shifted is known by the way from the
//! start alone, and no later sighting improves it. Particles that differ in it would only be resampled at random. So they
//! share the likeliest, and its covariance is kept beside them and added to what is reported.

use crate::geometry::{transform3, Matrix3, Pose, Symmetric2};
use serde::{Deserialize, Serialize};

/// A shift and a turn about a center, with their covariance.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Gauge {
    /// Metres.
    center: [f64; 2],
    /// Of (x, y, turn), metres and radians.
    covariance: Matrix3,
}

impl Gauge {
    /// Of the deviations of (pose, landmarks, …) that have this covariance.
    pub fn of(pose: Pose, landmarks: &[[f64; 2]], covariance: &[Vec<f64>]) -> Self {
        let center = center_of(pose, landmarks);
        let rows = fit(pose, landmarks, center);
        let size = rows[0].len();
        let moved = rows.each_ref().map(|row| {
            (0..size).map(|j| (0..size).map(|i| row[i] * covariance[i][j]).sum::<f64>()).collect::<Vec<f64>>()
        });
        let entry = |a: usize, b: usize| (0..size).map(|j| moved[a][j] * rows[b][j]).sum::<f64>();
        let covariance = std::array::from_fn(|a| std::array::from_fn(|b| 0.5 * (entry(a, b) + entry(b, a))));
        Self { center, covariance }
    }

    /// Takes from a deviation what moves all together.
    pub fn take_out(&self, pose: Pose, landmarks: &[[f64; 2]], off: &mut [f64]) {
        let rows = fit(pose, landmarks, self.center);
        let [x, y, turn] = rows.map(|row| row.iter().zip(off.iter()).map(|(a, b)| a * b).sum::<f64>());
        let at = |[px, py]: [f64; 2]| [x - turn * (py - self.center[1]), y + turn * (px - self.center[0])];
        let own = at([pose.x, pose.y]);
        (off[0], off[1], off[2]) = (off[0] - own[0], off[1] - own[1], off[2] - turn);
        for (k, landmark) in landmarks.iter().enumerate() {
            let own = at(*landmark);
            off[3 + 2 * k] -= own[0];
            off[4 + 2 * k] -= own[1];
        }
    }

    /// What it adds to the covariance of a pose there.
    pub fn of_pose(&self, [x, y]: [f64; 2]) -> Matrix3 {
        let (dx, dy) = (x - self.center[0], y - self.center[1]);
        transform3(&[[1.0, 0.0, -dy], [0.0, 1.0, dx], [0.0, 0.0, 1.0]], &self.covariance)
    }

    /// What it adds to the covariance of a landmark there.
    pub fn of_landmark(&self, at: [f64; 2]) -> Symmetric2 {
        let [[xx, xy, _], [_, yy, _], _] = self.of_pose(at);
        Symmetric2::new(xx, xy, yy)
    }
}

/// The points of which all together are moved: the robot and the landmarks.
fn points(pose: Pose, landmarks: &[[f64; 2]]) -> impl Iterator<Item = [f64; 2]> + '_ {
    std::iter::once([pose.x, pose.y]).chain(landmarks.iter().copied())
}

fn center_of(pose: Pose, landmarks: &[[f64; 2]]) -> [f64; 2] {
    let count = (1 + landmarks.len()) as f64;
    points(pose, landmarks).fold([0.0; 2], |sum, p| [sum[0] + p[0] / count, sum[1] + p[1] / count])
}

/// Shift and turn that fit a deviation of all points best, as linear functions of it (least squares).
fn fit(pose: Pose, landmarks: &[[f64; 2]], center: [f64; 2]) -> [Vec<f64>; 3] {
    let count = (1 + landmarks.len()) as f64;
    let spread: f64 = points(pose, landmarks).map(|p| (p[0] - center[0]).powi(2) + (p[1] - center[1]).powi(2)).sum();
    let mut rows = [(); 3].map(|()| vec![0.0; 3 + 2 * landmarks.len()]);
    for (k, p) in points(pose, landmarks).enumerate() {
        let column = if k == 0 { 0 } else { 1 + 2 * k };
        rows[0][column] = 1.0 / count;
        rows[1][column + 1] = 1.0 / count;
        if spread > 0.0 {
            rows[2][column] = -(p[1] - center[1]) / spread;
            rows[2][column + 1] = (p[0] - center[0]) / spread;
        }
    }
    rows
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_moves_all_together_is_taken_out_and_kept_as_covariance() {
        let (pose, landmarks) = (Pose::new(3.0, 1.0, 0.4), [[10.0, -4.0], [2.0, 8.0]]);
        let (turn, shift) = (0.01, [0.2, -0.3]);
        let moved = |[x, y]: [f64; 2]| [shift[0] - turn * y, shift[1] + turn * x];
        let mut off = vec![0.0; 8];
        off[..2].copy_from_slice(&moved([3.0, 1.0]));
        (off[2], off[7]) = (turn, 0.05);
        off[3..5].copy_from_slice(&moved(landmarks[0]));
        off[5..7].copy_from_slice(&moved(landmarks[1]));
        let covariance: Vec<Vec<f64>> = off.iter().map(|a| off.iter().map(|b| a * b).collect()).collect();
        let gauge = Gauge::of(pose, &landmarks, &covariance);
        let of_pose = gauge.of_pose([3.0, 1.0]);
        for (a, row) in of_pose.iter().enumerate() {
            for (b, value) in row.iter().enumerate() {
                assert!((value - off[a] * off[b]).abs() < 1e-12, "{of_pose:?}");
            }
        }
        assert!((gauge.of_landmark(landmarks[1]).xy - off[5] * off[6]).abs() < 1e-12);
        gauge.take_out(pose, &landmarks, &mut off);
        assert!(off[..7].iter().all(|v| v.abs() < 1e-12) && off[7] == 0.05, "{off:?}");
    }
}
