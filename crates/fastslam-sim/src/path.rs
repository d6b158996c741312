//! A line through points, measured along its length.

use fastslam_core::error::{Error, Result};
use fastslam_core::geometry::Pose;
use fastslam_core::math::atan2;

/// A line through at least two distinct points.
#[derive(Clone, Debug)]
pub struct Path {
    points: Vec<[f64; 2]>,
    /// Length of the path up to each point.
    along_m: Vec<f64>,
}

impl Path {
    /// Points that repeat their predecessor are dropped.
    pub fn new(mut points: Vec<[f64; 2]>) -> Result<Self> {
        points.dedup();
        if points.len() < 2 {
            return Err(Error::parameter("trajectory", "a path that stays where it is", "two distinct points"));
        }
        let mut along_m = vec![0.0];
        let mut total = 0.0;
        for pair in points.windows(2) {
            total += distance(pair[0], pair[1]);
            along_m.push(total);
        }
        Ok(Self { points, along_m })
    }

    /// Length of the whole path.
    pub fn length_m(&self) -> f64 {
        self.along_m[self.along_m.len() - 1]
    }

    /// The pose on the path, heading along it. Before the start and past the end the path goes on straight.
    pub fn pose_at(&self, along_m: f64) -> Pose {
        let after = self.along_m.partition_point(|&a| a <= along_m);
        let segment = after.clamp(1, self.points.len() - 1) - 1;
        let (a, b) = (self.points[segment], self.points[segment + 1]);
        let length = self.along_m[segment + 1] - self.along_m[segment];
        let t = (along_m - self.along_m[segment]) / length;
        let heading = atan2(b[1] - a[1], b[0] - a[0]);
        Pose::new(a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1]), heading)
    }

    /// Where on the path, between two lengths, it comes nearest to a point; the first place if there are several.
    pub fn nearest_between(&self, from_m: f64, to_m: f64, point: [f64; 2]) -> f64 {
        let first = self.along_m.partition_point(|&a| a <= from_m).clamp(1, self.points.len() - 1) - 1;
        let mut best = (f64::INFINITY, from_m);
        for segment in first..self.points.len() - 1 {
            let start = self.along_m[segment];
            if start > to_m {
                break;
            }
            let (a, b) = (self.points[segment], self.points[segment + 1]);
            let length = self.along_m[segment + 1] - start;
            let direction = [(b[0] - a[0]) / length, (b[1] - a[1]) / length];
            let ahead = (point[0] - a[0]) * direction[0] + (point[1] - a[1]) * direction[1];
            // Not `clamp`: rounding can put the bounds in the wrong order by an ulp at the end of the path.
            let ahead = ahead.max(from_m - start).max(0.0).min(to_m - start).min(length);
            let (x, y) = (a[0] + ahead * direction[0], a[1] + ahead * direction[1]);
            let off = distance(point, [x, y]);
            if off < best.0 {
                best = (off, start + ahead);
            }
        }
        best.1
    }
}

/// Distance between two points.
pub fn distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
    (dx * dx + dy * dy).sqrt()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn an_angle_is_measured_along_its_length() {
        let path = Path::new(vec![[0.0, 0.0], [3.0, 0.0], [3.0, 0.0], [3.0, 4.0]]).unwrap();
        assert_eq!(path.length_m(), 7.0);
        assert_eq!(path.pose_at(1.0), Pose::new(1.0, 0.0, 0.0));
        assert_eq!(path.pose_at(5.0), Pose::new(3.0, 2.0, std::f64::consts::FRAC_PI_2));
        assert_eq!(path.pose_at(8.0), Pose::new(3.0, 5.0, std::f64::consts::FRAC_PI_2));
        assert_eq!(path.nearest_between(0.0, 7.0, [2.0, -1.0]), 2.0);
        assert_eq!(path.nearest_between(0.0, 7.0, [9.0, 3.0]), 6.0);
        assert_eq!(path.nearest_between(0.0, 4.0, [9.0, 3.0]), 4.0);
        assert_eq!(path.nearest_between(3.5, 7.0, [0.0, 0.0]), 3.5);
    }

    #[test]
    fn a_path_that_stays_is_an_error() {
        assert!(Path::new(vec![[1.0, 2.0], [1.0, 2.0]]).is_err());
    }
}
