//! What the innovations of a scan say about the configured noise.
//!
//! The sightings of a scan are judged together, under the covariance S that the filter predicts for all of them: that
//! of the mixture over the particles, the motion since the last scan included. S has a part S_k from each noise: range,
//! bearing, and the coordinates in which the noise of the motion is independent. A scan says of each part what is
//! there, q_k = νᵀ S⁻¹ S_k S⁻¹ ν, and what is expected when all noise is right, tr S⁻¹ S_k. [`NoiseCheck`] gathers both.
//!
//! Whatever moves all sightings of a scan as if the robot stood elsewhere may come from the motion, from a map that is
//! off, or from particles that have died out. The sensor is therefore judged by what is left when the pose is free:
//! nothing at all of a single sighting.
//!
//! [`NoiseCheck`]: super::noise::NoiseCheck

use crate::geometry::{multiply3, Matrix3, Symmetric2};
use crate::normal::Cholesky;
use serde::{Deserialize, Serialize};

/// Sightings of a scan that are judged together.
pub(crate) const JOINT_MAX: usize = 4;
/// Numbers in as many sightings.
const SIZE: usize = 2 * JOINT_MAX;
/// Noises of the sensor: range, bearing.
pub(crate) const SENSOR_NOISES: usize = 2;
/// Noises of the motion: one per coordinate of a control.
pub(crate) const MOTION_NOISES: usize = 3;
/// One over the variances of a pose that is as good as free, metres and radians.
const FREE_POSE_INFORMATION: [f64; 3] = [1e-4, 1e-4, 1e-2];
/// A scan counts as at most this many times what is expected of it in the mean NIS, so that no single one decides.
const LARGEST_RATIO: f64 = 25.0;
/// The same in the scores, as a multiple of what scans of this run usually have.
const LARGEST_SCORED_RATIO: f64 = 6.0;

type Square = [[f64; SIZE]; SIZE];

/// The sightings of a scan as the filter predicted them.
#[derive(Clone, Debug)]
pub(crate) struct PredictedScan {
    /// Numbers in use: twice the sightings, or as many where each has one.
    pub size: usize,
    /// Of which noise of the sensor each of them is: range and bearing in turn, or all of the one.
    pub component: [usize; SIZE],
    /// Measured minus predicted, sighting after sighting.
    pub innovation: [f64; SIZE],
    /// S: covariance of the innovation.
    pub covariance: Square,
    /// Variances of the sensor's noise.
    pub noise: [f64; SIZE],
    /// Derivative of each number by the robot's pose.
    pub by_pose: [[f64; 3]; SIZE],
    /// What each noise of the motion since the last scan adds to the pose's covariance, in the world's axes.
    pub motion: [Matrix3; MOTION_NOISES],
}

impl Default for PredictedScan {
    fn default() -> Self {
        Self {
            size: 0,
            component: std::array::from_fn(|i| i % 2),
            innovation: [0.0; SIZE],
            covariance: [[0.0; SIZE]; SIZE],
            noise: [0.0; SIZE],
            by_pose: [[0.0; 3]; SIZE],
            motion: [[[0.0; 3]; 3]; MOTION_NOISES],
        }
    }
}

/// What some noises have in a scan, and what is expected of them.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Found<const K: usize> {
    /// νᵀ S⁻¹ S_k S⁻¹ ν.
    #[serde(with = "crate::stored_arrays")]
    pub squares: [f64; K],
    /// Its expectation when all noise is right: tr S⁻¹ S_k. At most the numbers in the scan.
    #[serde(with = "crate::stored_arrays")]
    pub expected: [f64; K],
    /// What the noises themselves contribute to that: tr S⁻¹ S_k S⁻¹ S_l; twice Fisher's information.
    #[serde(with = "crate::stored_arrays")]
    pub shares: [[f64; K]; K],
}

impl<const K: usize> Default for Found<K> {
    fn default() -> Self {
        Self { squares: [0.0; K], expected: [0.0; K], shares: [[0.0; K]; K] }
    }
}

/// What one scan says.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct ScanScore {
    /// Sightings; those of one number count half.
    pub sightings: f64,
    /// νᵀ S⁻¹ ν: the normalised innovation squared (NIS); two per sighting are expected.
    pub nis: f64,
    /// Σ ν² / S of the ranges and of the bearings alone; one per sighting is expected. As expected where there are none.
    pub of_component: [f64; 2],
    /// NIS over its expectation, nothing cut off: of the whole, and with the pose free (NaN where nothing is left then).
    pub ratios: [f64; 2],
    /// The sensor's noises, with the pose free.
    pub sensor: Found<SENSOR_NOISES>,
    /// The motion's noises.
    pub motion: Found<MOTION_NOISES>,
    /// tr S⁻¹ S_k S⁻¹ S_l with k of the motion, l of the sensor.
    pub motion_by_sensor: [[f64; SENSOR_NOISES]; MOTION_NOISES],
}

impl PredictedScan {
    /// Of so many sightings by a sensor that measures range, bearing or both, without a number yet.
    pub fn of_sightings(count: usize, [range, bearing]: [bool; 2]) -> Self {
        let each = usize::from(range) + usize::from(bearing);
        let component = std::array::from_fn(|i| if range { i % each } else { 1 });
        Self { size: each * count, component, ..Self::default() }
    }

    /// Enters what is predicted of a sighting: innovation and covariance, the noise, and how both numbers depend on the pose.
    pub fn predict(
        &mut self,
        sighting: usize,
        (innovation, covariance): ([f64; 2], Symmetric2),
        noise: Symmetric2,
        by_pose: &[[f64; 3]; 2],
    ) {
        let (each, Symmetric2 { xx, xy, yy }) =
            (if self.component[0] == self.component[1] { 1 } else { 2 }, covariance);
        let (first, block) = (each * sighting, [[xx, xy], [xy, yy]]);
        for row in first..first + each {
            let own = self.component[row];
            self.by_pose[row] = by_pose[own];
            self.innovation[row] = innovation[own];
            self.noise[row] = [noise.xx, noise.yy][own];
            for column in first..first + each {
                self.covariance[row][column] = block[own][self.component[column]];
            }
        }
    }

    /// Adds to the covariance what an uncertain pose does: G P Gᵀ.
    pub fn add_uncertain_pose(&mut self, covariance: &Matrix3) {
        for i in 0..self.size {
            let row: [f64; 3] = std::array::from_fn(|k| (0..3).map(|l| self.by_pose[i][l] * covariance[l][k]).sum());
            for j in 0..self.size {
                self.covariance[i][j] += (0..3).map(|k| row[k] * self.by_pose[j][k]).sum::<f64>();
            }
        }
    }

    /// What the scan says; `None` where S is not positive definite. `usual` are the ratios that scans of this run
    /// usually have: one that has many times more counts as having so many.
    pub fn score(&self, usual: [f64; 2]) -> Option<ScanScore> {
        let n = self.size;
        let inverse = inverted(&self.covariance, n)?;
        let weighted = times(&inverse, &self.innovation, n);
        let nis: f64 = (0..n).map(|i| weighted[i] * self.innovation[i]).sum();
        let kept = (LARGEST_RATIO * n as f64 / nis).min(1.0);
        let sightings = 0.5 * n as f64;
        let of_component = |component: usize| {
            let ratio = |i: usize| self.innovation[i] * self.innovation[i] / self.covariance[i][i];
            match self.of(component).count() {
                0 => sightings,
                count => kept * self.of(component).map(ratio).sum::<f64>() * (sightings / count as f64),
            }
        };
        let mut score = ScanScore {
            sightings,
            nis: kept * nis,
            of_component: [of_component(0), of_component(1)],
            ratios: [nis / n as f64, f64::NAN],
            ..ScanScore::default()
        };
        self.score_motion(&inverse, &weighted, most(nis, n, usual[0]), &mut score);
        self.score_sensor(&inverse, usual[1], &mut score)?;
        Some(score)
    }

    /// The numbers of one noise of the sensor.
    fn of(&self, component: usize) -> impl Iterator<Item = usize> + '_ {
        (0..self.size).filter(move |i| self.component[*i] == component)
    }

    /// The motion's noises: with G = ∂z/∂pose and P_k what noise k adds to the pose, S_k = G P_k Gᵀ, all of it follows
    /// from Gᵀ S⁻¹ ν, Gᵀ S⁻¹ G and Gᵀ S⁻¹ R_l S⁻¹ G.
    fn score_motion(&self, inverse: &Square, weighted: &[f64; SIZE], kept: f64, score: &mut ScanScore) {
        let n = self.size;
        let by_pose = self.weighted_by_pose(inverse);
        let pull: [f64; 3] = std::array::from_fn(|a| (0..n).map(|i| self.by_pose[i][a] * weighted[i]).sum());
        let grip = self.information_of_pose(&by_pose);
        let of_sensor: [Matrix3; SENSOR_NOISES] = std::array::from_fn(|l| {
            std::array::from_fn(|a| {
                std::array::from_fn(|b| self.of(l).map(|i| by_pose[i][a] * self.noise[i] * by_pose[i][b]).sum())
            })
        });
        let gripped = self.motion.map(|part| multiply3(&part, &grip));
        let trace = |m: &Matrix3| m[0][0] + m[1][1] + m[2][2];
        for (k, part) in self.motion.iter().enumerate() {
            let moved: [f64; 3] = std::array::from_fn(|a| (0..3).map(|b| part[a][b] * pull[b]).sum());
            score.motion.squares[k] = kept * (0..3).map(|a| pull[a] * moved[a]).sum::<f64>();
            score.motion.expected[k] = trace(&gripped[k]);
            for (share, other) in score.motion.shares[k].iter_mut().zip(&gripped) {
                *share = trace(&multiply3(&gripped[k], other));
            }
            for (share, of_sensor) in score.motion_by_sensor[k].iter_mut().zip(&of_sensor) {
                *share = trace(&multiply3(part, of_sensor));
            }
        }
    }

    /// The sensor's noises with the pose free: S⁻¹ − S⁻¹ G (Gᵀ S⁻¹ G)⁻¹ Gᵀ S⁻¹ in place of S⁻¹. `None` as in `score`.
    fn score_sensor(&self, inverse: &Square, usual: f64, score: &mut ScanScore) -> Option<()> {
        let n = self.size;
        if n < 4 {
            return Some(());
        }
        let by_pose = self.weighted_by_pose(inverse);
        let mut information = [[0.0; SIZE]; SIZE];
        for (a, row) in self.information_of_pose(&by_pose).iter().enumerate() {
            information[a][..3].copy_from_slice(row);
            information[a][a] += FREE_POSE_INFORMATION[a];
        }
        let covariance = inverted(&information, 3)?;
        let mut free = *inverse;
        for i in 0..n {
            let spread: [f64; 3] = std::array::from_fn(|b| (0..3).map(|a| by_pose[i][a] * covariance[a][b]).sum());
            for j in 0..n {
                free[i][j] -= (0..3).map(|a| spread[a] * by_pose[j][a]).sum::<f64>();
            }
        }
        let weighted = times(&free, &self.innovation, n);
        let nis: f64 = (0..n).map(|i| weighted[i] * self.innovation[i]).sum();
        let kept = most(nis, n, usual);
        score.ratios[1] = nis / (n - 3) as f64;
        for i in 0..n {
            let of = self.component[i];
            score.sensor.squares[of] += kept * weighted[i] * weighted[i] * self.noise[i];
            score.sensor.expected[of] += free[i][i] * self.noise[i];
            for j in 0..n {
                score.sensor.shares[of][self.component[j]] += free[i][j] * free[i][j] * self.noise[i] * self.noise[j];
            }
        }
        Some(())
    }

    /// S⁻¹ G.
    fn weighted_by_pose(&self, inverse: &Square) -> [[f64; 3]; SIZE] {
        let n = self.size;
        std::array::from_fn(|i| std::array::from_fn(|a| (0..n).map(|j| inverse[i][j] * self.by_pose[j][a]).sum()))
    }

    /// Gᵀ S⁻¹ G, given S⁻¹ G.
    fn information_of_pose(&self, weighted: &[[f64; 3]; SIZE]) -> Matrix3 {
        let entry = |a: usize, b: usize| (0..self.size).map(|i| self.by_pose[i][a] * weighted[i][b]).sum();
        std::array::from_fn(|a| std::array::from_fn(|b| entry(a, b)))
    }
}

/// How much of a scan's squares counts, when scans usually have `usual` times what is expected.
fn most(nis: f64, n: usize, usual: f64) -> f64 {
    if nis > 0.0 {
        (LARGEST_SCORED_RATIO * usual * n as f64 / nis).min(1.0)
    } else {
        1.0
    }
}

fn times(a: &Square, b: &[f64; SIZE], n: usize) -> [f64; SIZE] {
    std::array::from_fn(|i| (0..n).map(|j| a[i][j] * b[j]).sum())
}

/// The inverse of the leading n × n block, by Cholesky's factor; `None` where that does not exist.
fn inverted(a: &Square, n: usize) -> Option<Square> {
    let factor = Cholesky::of_leading(a, n)?;
    let mut inverse = [[0.0; SIZE]; SIZE];
    for column in 0..n {
        let unit = std::array::from_fn(|i| f64::from(u8::from(i == column)));
        let solved = factor.solve(&unit);
        (0..n).for_each(|i| inverse[i][column] = solved[i]);
    }
    Some(inverse)
}

#[cfg(test)]
mod tests {
    use super::*;

    const BY_POSE: [[f64; 3]; 6] = [
        [-1.0, 0.1, 0.0],
        [0.02, -0.2, -1.0],
        [-0.3, -0.9, 0.0],
        [0.2, 0.1, -1.0],
        [0.7, -0.6, 0.0],
        [-0.1, 0.15, -1.0],
    ];

    /// Three sightings that share the uncertainty of the motion.
    fn scan(innovation: [f64; 6]) -> PredictedScan {
        let mut scan = PredictedScan { size: 6, ..PredictedScan::default() };
        scan.motion[0] = [[0.05, 0.01, 0.0], [0.01, 0.02, 0.0], [0.0; 3]];
        scan.motion[1] = [[0.01, 0.0, 0.01], [0.0; 3], [0.01, 0.0, 0.03]];
        for i in 0..6 {
            scan.by_pose[i] = BY_POSE[i];
            scan.noise[i] = if i % 2 == 0 { 0.04 } else { 0.01 };
            scan.covariance[i][i] = scan.noise[i];
            scan.innovation[i] = innovation[i];
        }
        let motion = scan.motion;
        motion.iter().for_each(|part| scan.add_uncertain_pose(part));
        scan
    }

    const USUAL: [f64; 2] = [1.0; 2];
    const SOME: [f64; 6] = [0.5, -0.3, 0.1, 0.4, -0.2, 0.1];

    /// S_k of the noises: range, bearing, and the first two of the motion.
    fn part(scan: &PredictedScan, k: usize) -> Square {
        let mut bare = PredictedScan { covariance: [[0.0; SIZE]; SIZE], ..scan.clone() };
        match k {
            0 | 1 => (k..6).step_by(2).for_each(|i| bare.covariance[i][i] = scan.noise[i]),
            _ => bare.add_uncertain_pose(&scan.motion[k - 2]),
        }
        bare.covariance
    }

    fn product(a: &Square, b: &Square) -> Square {
        std::array::from_fn(|i| std::array::from_fn(|j| (0..6).map(|k| a[i][k] * b[k][j]).sum()))
    }

    fn trace(a: &Square) -> f64 {
        (0..6).map(|i| a[i][i]).sum()
    }

    #[test]
    fn what_is_found_of_each_noise_is_what_the_formulas_say() {
        let scan = scan(SOME);
        let found = scan.score(USUAL).unwrap();
        let inverse = inverted(&scan.covariance, 6).unwrap();
        let weighted = times(&inverse, &scan.innovation, 6);
        for k in 0..2 {
            let of = part(&scan, 2 + k);
            let square: f64 = (0..6).map(|i| weighted[i] * (0..6).map(|j| of[i][j] * weighted[j]).sum::<f64>()).sum();
            assert!((found.motion.squares[k] - square).abs() < 1e-12);
            let gripped = product(&inverse, &of);
            assert!((found.motion.expected[k] - trace(&gripped)).abs() < 1e-12);
            for l in 0..2 {
                let other = product(&inverse, &part(&scan, 2 + l));
                assert!((found.motion.shares[k][l] - trace(&product(&gripped, &other))).abs() < 1e-12);
                let sensor = product(&inverse, &part(&scan, l));
                assert!((found.motion_by_sensor[k][l] - trace(&product(&gripped, &sensor))).abs() < 1e-12);
            }
            // S is the sum of all four.
            let sum = found.motion.shares[k].iter().chain(&found.motion_by_sensor[k]).sum::<f64>();
            assert!((sum - found.motion.expected[k]).abs() < 1e-12);
        }
        let nis: f64 = (0..6).map(|i| weighted[i] * scan.innovation[i]).sum();
        assert!((found.nis - nis).abs() < 1e-12 && (found.ratios[0] - nis / 6.0).abs() < 1e-12);
    }

    #[test]
    fn with_the_pose_free_three_numbers_are_left_of_six() {
        let found = scan(SOME).score(USUAL).unwrap();
        let left: f64 = found.sensor.expected.iter().sum();
        assert!((left - 3.0).abs() < 1e-3, "{left}");
        let shares: f64 = found.sensor.shares.iter().flatten().sum();
        assert!((shares - 3.0).abs() < 1e-3, "{shares}");
    }

    #[test]
    fn what_moves_the_whole_scan_says_nothing_of_the_sensor() {
        let mut scan = scan(SOME);
        let before = scan.score(USUAL).unwrap();
        (0..6).for_each(|i| scan.innovation[i] += 0.2 * scan.by_pose[i][0] - 0.1 * scan.by_pose[i][2]);
        let after = scan.score(USUAL).unwrap();
        assert!((after.nis - before.nis).abs() > 0.1);
        for k in 0..SENSOR_NOISES {
            // The free pose has a standard deviation of 100 m and 10 rad: what is left of the shift is below 1e-3 of it.
            assert!((after.sensor.squares[k] - before.sensor.squares[k]).abs() < 1e-3);
        }
    }

    #[test]
    fn one_sighting_says_nothing_of_the_sensor() {
        let mut one = scan(SOME);
        one.size = 2;
        let found = one.score(USUAL).unwrap();
        assert_eq!(found.sensor, Found::default());
        assert!(found.ratios[1].is_nan() && found.ratios[0].is_finite());
    }

    #[test]
    fn one_wild_scan_counts_no_more_than_its_cap() {
        let wild = scan([50.0, -3.0, 1.0, 40.0, 7.0, -20.0]).score(USUAL).unwrap();
        assert!((wild.nis - 6.0 * LARGEST_RATIO).abs() < 1e-9);
        assert!(wild.of_component.iter().sum::<f64>().is_finite());
        let usual_there = scan([50.0, -3.0, 1.0, 40.0, 7.0, -20.0]).score([1e9; 2]).unwrap();
        assert!(usual_there.sensor.squares[0] > 100.0 * wild.sensor.squares[0]);
    }

    #[test]
    fn a_covariance_that_is_none_says_nothing() {
        let mut bad = scan([0.1; 6]);
        bad.covariance[2][2] = -1.0;
        assert_eq!(bad.score(USUAL), None);
    }
}
