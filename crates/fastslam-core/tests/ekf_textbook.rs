//! EKF-SLAM against a textbook version: dense matrices, one prediction per control, hand-written Jacobians, Joseph's
//! form with an explicit inverse. The two share no code but the random numbers.

use crate::dense::Matrix;
use fastslam_core::config::{AssociationMode, AssociationOrder, Config, Exclusion};
use fastslam_core::ekf_slam::EkfSlam;
use fastslam_core::filter::{Identities, Sighting};
use fastslam_core::motion::{Motion, Velocity};
use fastslam_core::random::{Purpose, RandomSource, Stream};
use std::f64::consts::TAU;

const SPEED_STD: f64 = 0.3;
const YAW_RATE_STD: f64 = 0.08;
const RANGE_STD: f64 = 0.15;
const BEARING_STD: f64 = 0.03;
/// Sensor on the robot: ahead, left, turned.
const MOUNTING: [f64; 3] = [0.8, -0.3, 0.2];

fn wrap(angle: f64) -> f64 {
    angle - TAU * (angle / TAU).round()
}

/// State (x, y, heading, landmarks) and covariance as in any textbook.
struct Textbook {
    x: Matrix,
    p: Matrix,
    /// Sequence number of each landmark by identity (known association).
    identity: Vec<u32>,
}

impl Textbook {
    fn new() -> Self {
        Self { x: Matrix::zeros(3, 1), p: Matrix::zeros(3, 3), identity: Vec::new() }
    }

    fn count(&self) -> usize {
        (self.x.len() - 3) / 2
    }

    fn predict(&mut self, v: f64, w: f64, dt: f64) {
        let n = self.x.len();
        let h = self.x[2];
        let (r, turned) = (v / w, h + w * dt);
        let (ds, dc) = (turned.sin() - h.sin(), turned.cos() - h.cos());
        self.x[0] += r * ds;
        self.x[1] -= r * dc;
        self.x[2] = wrap(turned);
        let mut f = Matrix::identity(n);
        f[(0, 2)] = r * dc;
        f[(1, 2)] = r * ds;
        self.p = f.transforms(&self.p);
        // White noise of both rates, whose means over the row have the deviations: Gauss's rule with three points over
        // the row, which is exact to rounding for turns this small.
        for (at, weight) in [(0.5 - 0.15_f64.sqrt(), 5.0 / 18.0), (0.5, 4.0 / 9.0), (0.5 + 0.15_f64.sqrt(), 5.0 / 18.0)]
        {
            let heading = h + at * w * dt;
            let mut g = Matrix::zeros(n, 2);
            g[(0, 0)] = heading.cos();
            g[(1, 0)] = heading.sin();
            // A turn on the way swings what is left of it.
            g[(0, 1)] = r * (turned.cos() - heading.cos());
            g[(1, 1)] = r * (turned.sin() - heading.sin());
            g[(2, 1)] = 1.0;
            let noise = Matrix::diagonal(&[SPEED_STD * SPEED_STD, YAW_RATE_STD * YAW_RATE_STD]);
            self.p = &self.p + g.transforms(&noise) * (weight * dt * dt);
        }
    }

    /// World position of the sensor, and its derivative by the heading.
    fn sensor(&self) -> ([f64; 2], [f64; 2]) {
        let (s, c) = self.x[2].sin_cos();
        let [a, b, _] = MOUNTING;
        ([self.x[0] + c * a - s * b, self.x[1] + s * a + c * b], [-s * a - c * b, c * a - s * b])
    }

    fn innovation(&self, landmark: usize, z: [f64; 2]) -> (Matrix, Matrix) {
        let (sensor, by_heading) = self.sensor();
        let at = 3 + 2 * landmark;
        let (dx, dy) = (self.x[at] - sensor[0], self.x[at + 1] - sensor[1]);
        let q = dx * dx + dy * dy;
        let r = q.sqrt();
        let mut h = Matrix::zeros(2, self.x.len());
        h[(0, at)] = dx / r;
        h[(0, at + 1)] = dy / r;
        h[(1, at)] = -dy / q;
        h[(1, at + 1)] = dx / q;
        for row in 0..2 {
            let by_sensor = [-h[(row, at)], -h[(row, at + 1)]];
            h[(row, 0)] = by_sensor[0];
            h[(row, 1)] = by_sensor[1];
            h[(row, 2)] =
                by_sensor[0] * by_heading[0] + by_sensor[1] * by_heading[1] - if row == 1 { 1.0 } else { 0.0 };
        }
        let expected = dy.atan2(dx) - self.x[2] - MOUNTING[2];
        (Matrix::column(&[z[0] - r, wrap(z[1] - expected)]), h)
    }

    fn noise() -> Matrix {
        Matrix::diagonal(&[RANGE_STD * RANGE_STD, BEARING_STD * BEARING_STD])
    }

    /// Squared Mahalanobis distance and log-likelihood.
    fn fit(&self, landmark: usize, z: [f64; 2]) -> (f64, f64) {
        let (nu, h) = self.innovation(landmark, z);
        let (inverse, determinant) = (h.transforms(&self.p) + Self::noise()).inverse();
        let distance = (nu.transpose() * inverse * nu)[0];
        (distance, -0.5 * (distance + ((TAU * TAU) * determinant).ln()))
    }

    fn correct(&mut self, landmark: usize, z: [f64; 2]) {
        let (nu, h) = self.innovation(landmark, z);
        let s = h.transforms(&self.p) + Self::noise();
        let k = (&h * &self.p).transpose() * s.inverse().0;
        self.x = &self.x + &k * nu;
        self.x[2] = wrap(self.x[2]);
        let rest = Matrix::identity(self.x.len()) - &k * &h;
        self.p = rest.transforms(&self.p) + k.transforms(&Self::noise());
    }

    fn add(&mut self, z: [f64; 2]) {
        let n = self.x.len();
        let (sensor, by_heading) = self.sensor();
        let (s, c) = (self.x[2] + MOUNTING[2] + z[1]).sin_cos();
        let mut grow = Matrix::from_fn(n + 2, n, |i, j| if i == j { 1.0 } else { 0.0 });
        grow[(n, 0)] = 1.0;
        grow[(n + 1, 1)] = 1.0;
        grow[(n, 2)] = by_heading[0] - z[0] * s;
        grow[(n + 1, 2)] = by_heading[1] + z[0] * c;
        let mut by_z = Matrix::zeros(n + 2, 2);
        [by_z[(n, 0)], by_z[(n, 1)]] = [c, -z[0] * s];
        [by_z[(n + 1, 0)], by_z[(n + 1, 1)]] = [s, z[0] * c];
        self.p = grow.transforms(&self.p) + by_z.transforms(&Self::noise());
        self.x = Matrix::column(&[self.x.values(), &[sensor[0] + z[0] * c, sensor[1] + z[0] * s]].concat());
    }
}

fn config() -> Config {
    let mut config = Config {
        motion: Motion::Velocity(Velocity {
            speed_std_m_per_s: SPEED_STD,
            yaw_rate_std_rad_per_s: YAW_RATE_STD,
            lateral_std_m_per_s: 0.0,
            noise_period_s: None,
            ..Velocity::default()
        }),
        ..Config::default()
    };
    config.sensor.change(|s| s.range_std_m = RANGE_STD);
    config.sensor.change(|s| s.bearing_std_rad = BEARING_STD);
    config.sensor.change(|s| s.mounting.x_m = MOUNTING[0]);
    config.sensor.change(|s| s.mounting.y_m = MOUNTING[1]);
    config.sensor.change(|s| s.mounting.yaw_rad = MOUNTING[2]);
    config
}

/// A true robot that drives a noisy circle among landmarks on a grid.
struct World {
    pose: Matrix,
    landmarks: Vec<[f64; 2]>,
}

const CONTROL: [f64; 2] = [2.0, 0.15];

impl World {
    fn new(spacing_m: f64) -> Self {
        let side = |i: i32| f64::from(i) * spacing_m;
        let landmarks = (-5..=5).flat_map(|i| (-2..9).map(move |j| [side(i), side(j)])).collect();
        Self { pose: Matrix::identity(3), landmarks }
    }

    fn heading(&self) -> f64 {
        self.pose[(1, 0)].atan2(self.pose[(0, 0)])
    }

    fn drive(&mut self, noise: [f64; 2], dt: f64) {
        let (v, w) = (CONTROL[0] + SPEED_STD * noise[0], CONTROL[1] + YAW_RATE_STD * noise[1]);
        let (s, c) = (w * dt).sin_cos();
        self.pose = &self.pose * Matrix::of_rows(3, &[c, -s, v / w * s, s, c, v / w * (1.0 - c), 0.0, 0.0, 1.0]);
    }

    fn sightings(&self, stream: Stream, reach_m: f64) -> Vec<(u32, [f64; 2])> {
        let sensor = &self.pose * Matrix::column(&[MOUNTING[0], MOUNTING[1], 1.0]);
        let mut seen = Vec::new();
        for (identity, landmark) in self.landmarks.iter().enumerate() {
            let (dx, dy) = (landmark[0] - sensor[0], landmark[1] - sensor[1]);
            // Nearer than a few standard deviations the range could turn out negative.
            if (1.0..reach_m).contains(&dx.hypot(dy)) {
                let [a, b] = stream.normal_pair(identity as u32, 0);
                let bearing = dy.atan2(dx) - self.heading() - MOUNTING[2];
                seen.push((identity as u32, [dx.hypot(dy) + RANGE_STD * a, wrap(bearing + BEARING_STD * b)]));
            }
        }
        seen
    }
}

/// Largest difference of means (headings wrapped) and of covariances.
fn difference(filter: &EkfSlam, book: &Textbook) -> f64 {
    let pose = filter.pose().mean;
    let map = filter.map();
    assert_eq!(map.landmarks.len(), book.count());
    let mut worst =
        (pose.x - book.x[0]).abs().max((pose.y - book.x[1]).abs()).max(wrap(pose.heading - book.x[2]).abs());
    for (k, landmark) in map.landmarks.iter().enumerate() {
        worst =
            worst.max((landmark.mean[0] - book.x[3 + 2 * k]).abs()).max((landmark.mean[1] - book.x[4 + 2 * k]).abs());
    }
    let joint = filter.joint_covariance();
    assert_eq!(joint.len(), book.p.len());
    book.p.values().iter().zip(&joint).fold(worst, |worst, (a, b)| worst.max((a - b).abs()))
}

/// Drives both filters and returns the landmarks that they share and their largest difference.
fn compare(known: bool, steps: u64, spacing_m: f64) -> (usize, f64) {
    let mut settings = config();
    if !known {
        settings.association.mode = AssociationMode::Unknown;
        settings.association.order = AssociationOrder::Given;
        settings.association.exclusion = Exclusion::None;
    }
    let gate = -2.0 * (1.0 - settings.association.gate_probability).ln();
    let outer = -2.0 * (1.0 - settings.association.new_landmark_gate_probability).ln();
    let log_new = -0.5 * (outer + (4.0 * RANGE_STD.powi(2) * BEARING_STD.powi(2)).ln()) - TAU.ln();
    let mut filter = EkfSlam::new(settings, Identities::All).unwrap();
    let (mut book, mut world) = (Textbook::new(), World::new(spacing_m));
    let random = RandomSource::new(5);
    let mut worst: f64 = 0.0;
    for step in 0..steps {
        for part in 0..3 {
            world.drive(random.stream(Purpose::Motion, step).normal_pair(part, 0), 0.1);
            filter.predict([CONTROL[0], CONTROL[1], 0.0], 0.1).unwrap();
            book.predict(CONTROL[0], CONTROL[1], 0.1);
        }
        let seen = world.sightings(random.stream(Purpose::Simulation, step), 6.0);
        let scan: Vec<Sighting> = seen.iter().map(|(id, z)| Sighting::range_bearing(z[0], z[1], Some(*id))).collect();
        filter.update(0.3 * step as f64, &scan).unwrap();
        let mut new = Vec::new();
        for &(identity, z) in &seen {
            if known {
                match book.identity.iter().position(|i| *i == identity) {
                    Some(landmark) => book.correct(landmark, z),
                    None => new.push((identity, z)),
                }
                continue;
            }
            let fits = (0..book.count()).map(|k| (k, book.fit(k, z)));
            match fits.max_by(|a, b| a.1 .1.total_cmp(&b.1 .1)) {
                Some((landmark, (distance, log_likelihood))) if log_likelihood >= log_new => {
                    if distance <= gate {
                        book.correct(landmark, z);
                    }
                }
                _ => new.push((identity, z)),
            }
        }
        for (identity, z) in new {
            book.identity.push(identity);
            book.add(z);
        }
        worst = worst.max(difference(&filter, &book));
    }
    (book.count(), worst)
}

#[test]
fn known_identities_agree_with_the_textbook_to_rounding() {
    // More than a full turn, so that landmarks are seen again. Entries are of order 10 m and 1 m²; each of some
    // 1,500 corrections may add a few units of 1e-15 relative error.
    const { assert!(170.0 * 0.3 * CONTROL[1] > TAU) };
    let (landmarks, worst) = compare(true, 170, 3.0);
    assert!(landmarks > 60, "{landmarks} landmarks");
    assert!(worst < 1e-9, "differs by {worst}");
}

#[test]
fn associated_sightings_agree_with_the_textbook_to_rounding() {
    let (landmarks, worst) = compare(false, 120, 4.0);
    assert!((40..121).contains(&landmarks), "{landmarks} landmarks");
    assert!(worst < 1e-9, "differs by {worst}");
}
