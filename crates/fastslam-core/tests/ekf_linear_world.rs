//! EKF-SLAM in the linear-Gaussian world, where the exact posterior is that of least squares over all poses and
//! landmarks at once.

use crate::dense::Matrix;
use fastslam_core::association::Appearance;
use fastslam_core::config::Config;
use fastslam_core::ekf_slam::EkfSlam;
use fastslam_core::filter::{Identities, Sighting};
use fastslam_core::measurement::Cartesian;
use fastslam_core::motion::{Increments, Motion};
use fastslam_core::random::{Purpose, RandomSource};

const STEPS: usize = 40;
const LANDMARKS: usize = 9;
const MOTION_STD: [f64; 2] = [0.3, 0.2];
const SIGHTING_STD: f64 = 0.4;

/// Information matrix and vector over (pose 1, …, pose T, landmark 0, …), two numbers each; the pose at 0 is the origin.
struct LeastSquares {
    information: Matrix,
    vector: Matrix,
}

impl LeastSquares {
    /// The difference of two positions was measured; `from` is `None` for the origin.
    fn add(&mut self, from: Option<usize>, to: usize, measured: [f64; 2], std: [f64; 2]) {
        for axis in 0..2 {
            let weight = 1.0 / (std[axis] * std[axis]);
            let to = 2 * to + axis;
            self.information[(to, to)] += weight;
            self.vector[to] += weight * measured[axis];
            if let Some(from) = from.map(|f| 2 * f + axis) {
                self.information[(from, from)] += weight;
                self.information[(from, to)] -= weight;
                self.information[(to, from)] -= weight;
                self.vector[from] -= weight * measured[axis];
            }
        }
    }
}

#[test]
fn the_posterior_of_the_linear_world_is_exact() {
    let n = 2 * (STEPS + LANDMARKS);
    let mut exact = LeastSquares { information: Matrix::zeros(n, n), vector: Matrix::zeros(n, 1) };
    let motion =
        Increments { x_std_m: MOTION_STD[0], y_std_m: MOTION_STD[1], heading_std_rad: 0.0, ..Increments::default() };
    let mut config = Config { motion: Motion::Increments(motion), ..Config::default() };
    config.sensor.change(|s| s.min_range_m = 1e-6);
    let model = Cartesian { position_std_m: SIGHTING_STD };
    let mut filter = EkfSlam::with_model(config, Identities::All, model).unwrap();
    let random = RandomSource::new(3);
    let mut robot = [0.0, 0.0];
    for step in 0..STEPS {
        let odometry = [0.5, if step % 10 < 5 { 0.3 } else { -0.3 }];
        let noise = random.stream(Purpose::Motion, step as u64).normal_pair(0, 0);
        (0..2).for_each(|axis| robot[axis] += odometry[axis] + MOTION_STD[axis] * noise[axis]);
        filter.predict([odometry[0], odometry[1], 0.0], 1.0).unwrap();
        exact.add(step.checked_sub(1), step, odometry, MOTION_STD);
        let stream = random.stream(Purpose::Simulation, step as u64);
        let mut scan = Vec::new();
        for k in (0..LANDMARKS).filter(|k| (step + 2 * k) % 3 != 0) {
            let noise = stream.normal_pair(k as u32, 0);
            let place = [2.5 * k as f64, 3.0 - (k % 3) as f64 * 2.0];
            let value: [f64; 2] = std::array::from_fn(|axis| place[axis] - robot[axis] + SIGHTING_STD * noise[axis]);
            scan.push(Sighting { value, identity: Some(k as u32), noise: None, appearance: Appearance::default() });
            exact.add(Some(step), STEPS + k, value, [SIGHTING_STD; 2]);
        }
        filter.update(step as f64, &scan).unwrap();
    }
    let (covariance, _) = exact.information.inverse();
    let mean = &covariance * exact.vector;
    // Conditioning of the information matrix is below 1e5, so 1e-16 · 1e5 leaves 1e-10.
    let close = |a: f64, b: f64| assert!((a - b).abs() < 1e-10, "{a} against {b}");
    let pose = filter.pose();
    let last = 2 * (STEPS - 1);
    close(pose.mean.x, mean[last]);
    close(pose.mean.y, mean[last + 1]);
    close(pose.covariance[0][0], covariance[(last, last)]);
    close(pose.covariance[1][1], covariance[(last + 1, last + 1)]);
    let map = filter.map();
    assert_eq!(map.landmarks.len(), LANDMARKS);
    for landmark in map.landmarks {
        let at = 2 * (STEPS + landmark.identity.unwrap() as usize);
        close(landmark.mean[0], mean[at]);
        close(landmark.mean[1], mean[at + 1]);
        close(landmark.covariance.xx, covariance[(at, at)]);
        close(landmark.covariance.yy, covariance[(at + 1, at + 1)]);
        assert!(landmark.sightings > 20);
    }
}
