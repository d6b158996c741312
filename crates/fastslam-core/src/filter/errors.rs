//! How wrong the estimate may be: the errors of imagined runs, carried along beside the particles.
//!
//! Resampling leaves particles with one past, and nothing in their spread shows how wrong that is. But the error of a
//! linear estimator does not depend on what was measured: so the errors of [`MEMBERS`] runs are simulated that move as
//! the robot moved and see what it saw, each with noise of its own, corrected by the gains of FastSLAM. Their second
//! moments are those of the error of the estimate. They start anew from every draw of whole paths, which is a sample of
//! the posterior. Nothing of the filter depends on them.
//!
//! **Source:** an ensemble with perturbed observations (`burgers1998enkf`), with the gains of `montemerlo2003fastslam`,
//! eqs. 12–17, in place of those of the ensemble. **Why signs:** only second moments are asked for, and those of a sign
//! are those of a normal number.

use crate::gaussian::{innovation_covariance, inverted, Inverse};
use crate::geometry::{moved_by, multiply3, transform3, Matrix3, Pose, Symmetric2};
use crate::given::lower_triangle;
use crate::math;
use crate::motion::MotionGaussian;
use crate::random::Stream;
use crate::resampling::follow;
use crate::sighting::Measured;
use crate::smoothing::Known;
use crate::vector::vectorized;
use serde::{Deserialize, Serialize};

/// Imagined runs: a covariance from so many makes 95 % ellipses hold 93 %.
pub(super) const MEMBERS: usize = 32;

/// What noise is of; each has random bits of its own.
#[derive(Clone, Copy)]
enum Of {
    Motion,
    /// By its place in the scan.
    Sighting(u32),
    /// A landmark of a given map, by its slot.
    Given(u32),
    /// A landmark that was drawn with the path, by its slot.
    Drawn(u32),
}

/// The same number of every member.
type Members = [f64; MEMBERS];
/// Noise of a sighting in every member.
pub(super) type Noise = [Members; 2];

/// Errors of imagined runs, in the axes of the world.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(super) struct Errors {
    /// Of the pose: x, y, heading.
    pose: [Members; 3],
    /// Covariance of the pose where the map is taken as it is: what the gains go by.
    given_map: Matrix3,
    /// Of the landmarks, by slot.
    places: Vec<Place>,
    /// From which draw each particle descends.
    draws: Vec<u32>,
    /// Kept for its memory.
    #[serde(skip)]
    spare: (Vec<u32>, Vec<f64>),
}

/// Errors of a landmark.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Place {
    /// Of the landmark that the slot held; `u64::MAX` where it held none.
    birth: u64,
    /// Covariance where the path is taken as it is.
    given_path: Symmetric2,
    errors: [Members; 2],
}

impl Place {
    const NONE: Self =
        Self { birth: u64::MAX, given_path: Symmetric2 { xx: 0.0, xy: 0.0, yy: 0.0 }, errors: [[0.0; MEMBERS]; 2] };
}

/// A sighting with the slot of the landmark that the best particle took it for.
pub(super) type Shown = (u32, Measured);

/// A sighting of a landmark, linearised where the best particle has robot and landmark.
#[derive(Clone, Copy, Debug)]
pub(super) struct Linear {
    pub slot: u32,
    pub birth: u64,
    /// What is known of the landmark beside all sightings.
    pub known: Known,
    /// G_s, by the pose of the robot.
    pub by_pose: [[f64; 3]; 2],
    /// G_θ.
    pub by_landmark: [[f64; 2]; 2],
    /// R.
    pub noise: Symmetric2,
}

impl Errors {
    /// Of particles at a known pose.
    pub fn new(particles: usize) -> Self {
        Self { draws: (0..particles as u32).collect(), ..Self::default() }
    }

    /// Of particles whose pose is as uncertain as this, with maps of which no more is known.
    pub fn like(covariance: &Matrix3, particles: usize, stream: Stream) -> Self {
        let mut errors = Self::new(particles);
        errors.spread(0.0, covariance, stream);
        errors
    }

    /// Whether they come from a snapshot that did not have them.
    pub fn are_unknown(&self) -> bool {
        self.draws.is_empty()
    }

    /// Particle i becomes a copy of the former particle `ancestor_indices[i]`.
    pub fn resample(&mut self, ancestor_indices: &[u32]) {
        follow(&mut self.draws, ancestor_indices, &mut self.spare.0);
    }

    /// The robot moved from a pose with this heading: e ← F e + ε.
    pub fn moved(&mut self, heading: f64, motion: &MotionGaussian, stream: Stream) {
        let (_, by_pose) = moved_by(Pose::new(0.0, 0.0, heading), motion.mean);
        let Self { pose: [x, y, turn], given_map, .. } = self;
        *given_map = transform3(&by_pose, given_map);
        for m in 0..MEMBERS {
            x[m] += by_pose[0][2] * turn[m];
            y[m] += by_pose[1][2] * turn[m];
        }
        self.spread(heading, &motion.covariance, stream);
    }

    /// Adds noise of this covariance, in the axes of a pose with this heading: runs that start turned are turned all along.
    fn spread(&mut self, heading: f64, covariance: &Matrix3, stream: Stream) {
        let (s, c) = math::sin_cos(heading);
        let turn = [[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]];
        let root = multiply3(&turn, &lower_triangle(covariance).unwrap_or_default());
        let signs = signs(stream, Of::Motion);
        let covariance = transform3(&turn, covariance);
        for row in 0..3 {
            for m in 0..MEMBERS {
                self.pose[row][m] += dot(root[row], [signs[0][m], signs[1][m], signs[2][m]]);
            }
            (0..3).for_each(|column| self.given_map[row][column] += covariance[row][column]);
        }
    }

    /// A scan was seen; `noise` is memory.
    pub fn sighted(&mut self, scan: &[Linear], stream: Stream, noise: &mut Vec<Noise>) {
        noise.clear();
        noise.extend(
            scan.iter().enumerate().map(|(j, linear)| noise_like(linear.noise, stream, Of::Sighting(j as u32))),
        );
        for (linear, noise) in scan.iter().zip(&*noise) {
            self.make_room(linear, stream);
            if self.is_held(linear) {
                self.correct_pose(linear, noise);
            }
        }
        for (linear, noise) in scan.iter().zip(&*noise) {
            self.correct_place(linear, noise);
        }
    }

    /// Of a landmark that is seen for the first time, knows what a map says.
    fn make_room(&mut self, linear: &Linear, stream: Stream) {
        self.make_slot(linear.slot as usize);
        let (Known::Prior(gaussian) | Known::Place(gaussian)) = linear.known else { return };
        if !self.is_held(linear) {
            let errors = noise_like(gaussian.covariance, stream, Of::Given(linear.slot));
            let (birth, given_path) = (linear.birth, gaussian.covariance);
            self.places[linear.slot as usize] = Place { birth, given_path, errors };
        }
    }

    fn make_slot(&mut self, slot: usize) {
        if self.places.len() <= slot {
            self.places.resize(slot + 1, Place::NONE);
        }
    }

    fn is_held(&self, linear: &Linear) -> bool {
        self.places[linear.slot as usize].birth == linear.birth
    }

    /// Corrects the pose by the gain of one whose map is taken as it is: e_s ← e_s + K ν, P ← P − K G_s P.
    fn correct_pose(&mut self, linear: &Linear, noise: &Noise) {
        let Self { pose, given_map, places, .. } = self;
        let place = &places[linear.slot as usize];
        let cross: [[f64; 2]; 3] = given_map.map(|row| linear.by_pose.map(|by_pose| dot(row, by_pose)));
        let of_pose = |z: usize, w: usize| (0..3).map(|k| linear.by_pose[z][k] * cross[k][w]).sum::<f64>();
        let q = innovation_covariance(linear.by_landmark, place.given_path, linear.noise);
        let innovation = Symmetric2::new(q.xx + of_pose(0, 0), q.xy + of_pose(0, 1), q.yy + of_pose(1, 1));
        let Some(gain) = divided(cross, innovation) else { return };
        vectorized(
            #[inline(always)]
            || {
                for m in 0..MEMBERS {
                    let innovation = linear.innovation(pose, &place.errors, noise, m);
                    for (row, gain) in pose.iter_mut().zip(&gain) {
                        row[m] += gain[0] * innovation[0] + gain[1] * innovation[1];
                    }
                }
            },
        );
        for (row, gain) in given_map.iter_mut().zip(&gain) {
            for (entry, cross) in row.iter_mut().zip(&cross) {
                *entry -= gain[0] * cross[0] + gain[1] * cross[1];
            }
        }
    }

    /// Corrects a landmark by the gain of one whose path is taken as it is; a new one lies where it is seen.
    fn correct_place(&mut self, linear: &Linear, noise: &Noise) {
        let Self { pose, places, .. } = self;
        let place = &mut places[linear.slot as usize];
        if matches!(linear.known, Known::Place(_)) {
            return;
        }
        let Some((gain, given_path)) = (if place.birth == linear.birth {
            linear.correction(place.given_path)
        } else {
            *place = Place { birth: linear.birth, ..Place::NONE };
            linear.birth()
        }) else {
            return;
        };
        vectorized(
            #[inline(always)]
            || {
                for m in 0..MEMBERS {
                    let innovation = linear.innovation(pose, &place.errors, noise, m);
                    for (row, gain) in place.errors.iter_mut().zip(&gain) {
                        row[m] += gain[0] * innovation[0] + gain[1] * innovation[1];
                    }
                }
            },
        );
        place.given_path = given_path;
    }

    /// So many particles were drawn anew: members have these errors of the pose.
    pub fn pose_drawn(&mut self, particles: usize, error: impl Fn(usize) -> [f64; 3]) {
        self.draws.clear();
        self.draws.extend(0..particles as u32);
        for m in 0..MEMBERS {
            let error = error(m);
            (0..3).for_each(|row| self.pose[row][m] = error[row]);
        }
    }

    /// Members have these errors of a landmark (slot and birth) where the path is taken as it is, with that covariance.
    pub fn place_drawn(
        &mut self,
        (slot, birth): (u32, u64),
        given_path: Symmetric2,
        stream: Stream,
        error: impl Fn(usize) -> [f64; 2],
    ) {
        let mut errors = noise_like(given_path, stream, Of::Drawn(slot));
        for m in 0..MEMBERS {
            let error = error(m);
            (0..2).for_each(|row| errors[row][m] += error[row]);
        }
        self.make_slot(slot as usize);
        self.places[slot as usize] = Place { birth, given_path, errors };
    }

    /// Covariance of the error of the estimate, the mean over particles of these weights; `None` where these descend from
    /// more draws than there are members, and are the better sample themselves.
    ///
    /// **Why:** what all particles inherit from one draw is not the mean of all draws, and lies as far from it as that
    /// from the truth: the variance counts once more by the chance that two particles descend from the same draw.
    pub fn covariance(&mut self, weights: &[f64]) -> Option<Matrix3> {
        let shares = &mut self.spare.1;
        shares.clear();
        shares.resize(self.draws.iter().max().map_or(0, |draw| *draw as usize + 1), 0.0);
        self.draws.iter().zip(weights).for_each(|(draw, weight)| shares[*draw as usize] += weight);
        let alike: f64 = shares.iter().map(|share| share * share).sum();
        let scale = (1.0 + alike) / MEMBERS as f64;
        let moment = |i: usize, k: usize| scale * (0..MEMBERS).map(|m| self.pose[i][m] * self.pose[k][m]).sum::<f64>();
        let are_few = alike * MEMBERS as f64 >= 1.0;
        are_few.then(|| std::array::from_fn(|i| std::array::from_fn(|k| moment(i.min(k), i.max(k)))))
    }
}

impl Linear {
    /// ν: measured minus expected, in one member.
    #[inline(always)]
    fn innovation(&self, pose: &[Members; 3], place: &[Members; 2], noise: &Noise, m: usize) -> [f64; 2] {
        let pose = [pose[0][m], pose[1][m], pose[2][m]];
        let place = [place[0][m], place[1][m]];
        std::array::from_fn(|z| {
            let [by_x, by_y] = self.by_landmark[z];
            noise[z][m] - dot(self.by_pose[z], pose) - by_x * place[0] - by_y * place[1]
        })
    }

    /// Gain and covariance of a landmark of this covariance; `None` where there is none.
    fn correction(&self, before: Symmetric2) -> Option<([[f64; 2]; 2], Symmetric2)> {
        let Symmetric2 { xx, xy, yy } = before;
        let cross = [[xx, xy], [xy, yy]].map(|[p, q]| self.by_landmark.map(|[by_x, by_y]| p * by_x + q * by_y));
        let gain = divided(cross, innovation_covariance(self.by_landmark, before, self.noise))?;
        let less = |i: usize, k: usize| gain[i][0] * cross[k][0] + gain[i][1] * cross[k][1];
        Some((gain, Symmetric2::new(xx - less(0, 0), xy - less(0, 1), yy - less(1, 1))))
    }

    /// The same of one that is new.
    fn birth(&self) -> Option<([[f64; 2]; 2], Symmetric2)> {
        let gain = inverted(self.by_landmark);
        gain.as_flattened().iter().all(|entry| entry.is_finite()).then(|| (gain, self.noise.transformed(gain)))
    }
}

#[inline(always)]
fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// C S⁻¹; `None` where S is singular.
fn divided<const N: usize>(rows: [[f64; 2]; N], s: Symmetric2) -> Option<[[f64; 2]; N]> {
    let inverse = Inverse::of(s);
    (inverse.reciprocal > 0.0 && inverse.reciprocal.is_finite()).then(|| rows.map(|row| inverse.times(row)))
}

/// Numbers of this covariance, a pair for every member.
fn noise_like(covariance: Symmetric2, stream: Stream, of: Of) -> Noise {
    let first = covariance.xx.max(0.0).sqrt();
    let shared = if first > 0.0 { covariance.xy / first } else { 0.0 };
    let second = (covariance.yy - shared * shared).max(0.0).sqrt();
    let [a, b, _] = signs(stream, of);
    [a.map(|sign| first * sign), std::array::from_fn(|m| shared * a[m] + second * b[m])]
}

/// Three independent signs for every member.
fn signs(stream: Stream, of: Of) -> [Members; 3] {
    let words = match of {
        Of::Motion => stream.words(0, 0),
        Of::Sighting(number) => stream.words(number, 1),
        Of::Given(slot) => stream.words(slot, 2),
        Of::Drawn(slot) => stream.words(slot, 3),
    };
    std::array::from_fn(|k| std::array::from_fn(|m| if (words[k] >> m) & 1 == 0 { 1.0 } else { -1.0 }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Purpose, RandomSource};

    fn stream(step: u64) -> Stream {
        RandomSource::new(1).stream(Purpose::Errors, step)
    }

    /// A sensor that measures where a landmark lies from the robot, in the world's axes, to 0.1 m.
    fn seen(slot: u32) -> Linear {
        Linear {
            slot,
            birth: u64::from(slot),
            known: Known::Nothing,
            by_pose: [[-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]],
            by_landmark: [[1.0, 0.0], [0.0, 1.0]],
            noise: Symmetric2::new(0.01, 0.0, 0.01),
        }
    }

    /// By so much each motion may be off.
    fn motion(variance: f64) -> MotionGaussian {
        let covariance = [[variance, 0.0, 0.0], [0.0, variance, 0.0], [0.0, 0.0, 0.0]];
        MotionGaussian { mean: Pose::default(), covariance }
    }

    /// Mean over many runs of the variance along x.
    fn mean_variance(run: impl Fn(u64) -> Errors) -> f64 {
        let runs = 400;
        (0..runs).map(|k| run(1000 * k).covariance(&[0.5, 0.5]).unwrap()[0][0]).sum::<f64>() / runs as f64 / 1.5
    }

    #[test]
    fn without_sightings_the_errors_are_those_of_odometry() {
        let variance = mean_variance(|first| {
            let mut errors = Errors::new(2);
            (0..25).for_each(|k| errors.moved(0.0, &motion(0.04), stream(first + k)));
            errors
        });
        // Of a variance from 400 × 32 sums of 25 signs.
        assert!((variance - 1.0).abs() < 4.0 * (2.0_f64 / 12_800.0).sqrt(), "{variance}");
    }

    #[test]
    fn a_landmark_that_was_founded_late_does_not_make_the_pose_sure() {
        let (mut noise, far) = (Vec::new(), 1.0);
        let mut errors = Errors::new(2);
        errors.moved(0.0, &motion(far), stream(0));
        let before = errors.covariance(&[0.5, 0.5]).unwrap()[0][0];
        (1..200).for_each(|k| errors.sighted(&[seen(0)], stream(k), &mut noise));
        let after = errors.covariance(&[0.5, 0.5]).unwrap()[0][0];
        assert!(after > 0.8 * before, "{before} to {after}");
        assert!(errors.given_map[0][0] < 0.03, "the map is taken as it is: {}", errors.given_map[0][0]);
    }

    #[test]
    fn a_landmark_from_before_the_drift_takes_it_back() {
        let mut noise = Vec::new();
        let mut errors = Errors::new(2);
        (0..50).for_each(|k| errors.sighted(&[seen(0)], stream(k), &mut noise));
        errors.moved(0.0, &motion(1.0), stream(50));
        assert!(errors.covariance(&[0.5, 0.5]).unwrap()[0][0] > 0.5);
        (51..60).for_each(|k| errors.sighted(&[seen(0)], stream(k), &mut noise));
        let after = errors.covariance(&[0.5, 0.5]).unwrap()[0][0];
        assert!(after < 0.01, "{after}");
    }

    #[test]
    fn the_errors_are_those_of_a_kalman_filter_where_the_map_is_known() {
        let known = Known::Place(crate::gaussian::Gaussian { mean: [1.0, 2.0], covariance: Symmetric2::default() });
        let variance = mean_variance(|first| {
            let (mut errors, mut noise) = (Errors::new(2), Vec::new());
            for k in 0..30 {
                errors.moved(0.0, &motion(0.04), stream(first + k));
                errors.sighted(&[Linear { known, ..seen(0) }], stream(first + k), &mut noise);
            }
            errors
        });
        // P solves P = (P + q) r / (P + q + r).
        let (q, r) = (0.04_f64, 0.01_f64);
        let expected = 0.5 * ((q * q + 4.0 * q * r).sqrt() - q);
        assert!((variance / expected - 1.0).abs() < 4.0 * (2.0_f64 / 12_800.0).sqrt(), "{variance} for {expected}");
    }

    #[test]
    fn particles_of_one_draw_count_its_error_too() {
        let mut errors = Errors::new(4);
        errors.pose_drawn(4, |m| [if m % 2 == 0 { 1.0 } else { -1.0 }, 0.0, 0.0]);
        let of_four = errors.covariance(&[0.25; 4]).unwrap()[0][0];
        errors.resample(&[2, 2, 2, 2]);
        let of_one = errors.covariance(&[0.25; 4]).unwrap()[0][0];
        assert_eq!((of_four, of_one), (1.25, 2.0));
        let many = 2 * MEMBERS;
        assert_eq!(Errors::new(many).covariance(&vec![1.0 / many as f64; many]), None);
    }
}
