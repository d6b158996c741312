//! Velocities beside the particles: given a particle's path, a velocity that wanders is a Gaussian, whose mean the particle
//! carries and whose variance all have in common (Rao and Blackwell).

use super::graph::Guess;
use super::motion::SpaceMotion;
use super::past::Scan;
use super::pose::{series, SpacePose, Twist};
use super::settings::SpaceMotionNoise;
use super::wander::{variances, Ahead, Leg};
use crate::normal::congruence;
use serde::{Deserialize, Serialize};

/// Scans after which a velocity has forgotten where it began: a step forgets three quarters.
pub const REMEMBERED: usize = 24;

/// Velocities of all particles.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Track {
    /// Means in the robot's axes, m/s and rad/s.
    pub velocity: Vec<Twist>,
    /// Variances by axis, the same for all: a way that is known says how fast it was, whichever it was.
    pub variance: [f64; 6],
    /// Since the last scan.
    pub dt_s: f64,
    /// What the last least squares found, with the poses that were reported since.
    pub mode: Guess,
}

impl Track {
    /// At the start.
    pub fn new(noise: &SpaceMotionNoise, particles: usize) -> Self {
        Self { velocity: vec![[0.0; 6]; particles], variance: variances(noise), dt_s: 0.0, mode: Guess::default() }
    }

    /// What lies before the next scan, after the turns that were measured since the last one.
    pub fn ahead(&self, noise: &SpaceMotionNoise, measured: &SpaceMotion, is_first: bool) -> Ahead {
        Ahead::of(noise, &self.variance, (self.dt_s, measured), is_first)
    }

    /// The mean velocity, and its variance over the particles.
    pub fn moments(&self, weights: &[f64]) -> [Twist; 2] {
        let (mut mean, mut spread) = ([0.0; 6], [0.0; 6]);
        let parts = || weights.iter().zip(&self.velocity);
        parts().for_each(|(weight, own)| (0..6).for_each(|i| mean[i] += weight * own[i]));
        parts().for_each(|(weight, own)| (0..6).for_each(|i| spread[i] += weight * (own[i] - mean[i]).powi(2)));
        [mean, spread]
    }

    /// After a scan: the velocities of robots that went these ways.
    pub fn go(
        &mut self,
        ahead: &Ahead,
        ancestors: Option<&[u32]>,
        ways: impl Fn(usize, usize) -> (SpacePose, SpacePose),
    ) {
        let from = |i: usize| ancestors.map_or(i, |ancestors| ancestors[i] as usize);
        let own = |i: usize| ahead.leg.followed(&self.velocity[from(i)], ways(from(i), i));
        self.velocity = (0..self.velocity.len()).map(own).collect();
        (self.variance, self.dt_s) = (ahead.after, 0.0);
    }
}

/// The motion that a velocity makes of a leg: the variance of the way is one of ξ, and of the robot's axes after it is J_r.
pub fn motion(leg: &Leg, velocity: &Twist, way: &[f64; 6]) -> SpaceMotion {
    let mean = leg.way(velocity);
    let mut spread = [[0.0; 6]; 6];
    (0..6).for_each(|i| spread[i][i] = way[i]);
    SpaceMotion { mean: SpacePose::exp(mean), covariance: congruence(&series(&mean, -0.5, 1.0 / 6.0), &spread) }
}

/// The velocities at the scans of a path, the first of which was reached from `start`.
pub fn along(scans: &[Scan], mut before: SpacePose, poses: &[SpacePose]) -> Vec<Twist> {
    let mut velocity = [0.0; 6];
    let followed = |(scan, pose): (&Scan, &SpacePose)| {
        let Some(leg) = &scan.leg else { return velocity };
        velocity = leg.followed(&velocity, (before, *pose));
        before = *pose;
        velocity
    };
    scans.iter().zip(poses).map(followed).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::normal::{congruence, sum, Matrix, Normal};
    use crate::space::settings::SpaceMotionKind;

    /// Position and velocity along one axis after a time, integrated in small steps.
    fn integrated(dt_s: f64, noise: &SpaceMotionNoise, axis: usize) -> (Matrix<2, 2>, Matrix<2, 2>) {
        let steps = 20_000;
        let (h, decay) = (dt_s / f64::from(steps), 1.0 / noise.velocity_time_s);
        let per_s = 2.0 * noise.velocity_std_m_per_s[axis].powi(2) * decay;
        let step = [[1.0, h - 0.5 * decay * h * h], [0.0, 1.0 - decay * h + 0.5 * (decay * h).powi(2)]];
        let (mut f, mut q) = ([[1.0, 0.0], [0.0, 1.0]], [[0.0; 2]; 2]);
        for _ in 0..steps {
            f = crate::normal::product(&step, &f);
            q = sum(&congruence(&step, &q), &[[0.0, 0.0], [0.0, per_s * h]]);
        }
        (f, q)
    }

    #[test]
    fn a_velocity_given_the_path_is_that_of_a_kalman_filter_that_sees_positions() {
        let noise = SpaceMotionNoise {
            kind: SpaceMotionKind::Wandering,
            velocity_std_m_per_s: [0.7, 0.4, 0.2],
            ..SpaceMotionNoise::default()
        };
        let mut track = Track::new(&noise, 1);
        let legs = [(0.0, [0.0; 3]), (0.1, [0.05, 0.0, -0.01]), (0.7, [0.3, -0.2, 0.1]), (0.25, [0.1, 0.3, 0.0])];
        let mut filters: [Normal<2>; 3] = std::array::from_fn(|axis| Normal {
            mean: [0.0; 2],
            covariance: [[0.0, 0.0], [0.0, noise.velocity_std_m_per_s[axis].powi(2)]],
        });
        let mut pose = SpacePose::default();
        for (number, (dt_s, shift)) in legs.into_iter().enumerate() {
            track.dt_s = dt_s;
            let ahead = track.ahead(&noise, &SpaceMotion::default(), number == 0);
            let next = pose.compose(SpacePose::exp([shift[0], shift[1], shift[2], 0.0, 0.0, 0.0]));
            track.go(&ahead, None, |_, _| (pose, next));
            pose = next;
            for axis in 0..3 {
                let (f, q) = integrated(dt_s, &noise, axis);
                let Normal { mean: [x, v], covariance } = filters[axis];
                let (mean, covariance) = ([x + f[0][1] * v, f[1][1] * v], sum(&congruence(&f, &covariance), &q));
                let seen = [pose.position[axis] - mean[0]];
                let change = Normal::given(&covariance, &[[1.0, 0.0]], &seen, &[[1e-12]]).unwrap();
                let mean = [mean[0] + change.mean[0], mean[1] + change.mean[1]];
                filters[axis] = Normal { mean, covariance: change.covariance };
                // Steps of a 20,000th of the time integrate to as much of it.
                let (own, variance) = (track.velocity[0][axis], track.variance[axis]);
                assert!((own - mean[1]).abs() < 3e-4, "leg {number}, axis {axis}: {own} {}", mean[1]);
                assert!((variance / change.covariance[1][1] - 1.0).abs() < 3e-4, "leg {number}, axis {axis}");
            }
        }
        assert!(track.velocity[0][3..].iter().all(|rate| *rate == 0.0));
    }

    #[test]
    fn a_particle_follows_its_own_ancestor() {
        let noise = SpaceMotionNoise { kind: SpaceMotionKind::Gyro, ..SpaceMotionNoise::default() };
        let mut track = Track::new(&noise, 3);
        track.velocity = (0..3).map(|i| [f64::from(i), 0.0, 0.0, 0.0, 0.0, 0.0]).collect();
        track.dt_s = 0.1;
        let ahead = track.ahead(&noise, &SpaceMotion::default(), false);
        let before = track.velocity.clone();
        // Each goes as far as its ancestor's velocity says: it keeps that, but for what is forgotten.
        let end = |i: usize| SpacePose::exp(ahead.leg.way(&before[i]));
        track.go(&ahead, Some(&[2, 2, 0]), |from, _| (SpacePose::default(), end(from)));
        let kept = ahead.leg.kept[0];
        let along: Vec<f64> = track.velocity.iter().map(|velocity| velocity[0]).collect();
        assert!(along.iter().zip([2.0, 2.0, 0.0]).all(|(got, from)| (got - kept * from).abs() < 1e-12), "{along:?}");
        let [mean, spread] = track.moments(&[0.5, 0.25, 0.25]);
        assert!((mean[0] - 1.5 * kept).abs() < 1e-12 && (spread[0] - 0.75 * kept * kept).abs() < 1e-12);
    }
}
