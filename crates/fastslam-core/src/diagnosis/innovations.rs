//! What the innovations of a scan say about the configured noise.
//!
//! The sightings of a scan are judged together, under the covariance S that the filter predicts for all of them: that
//! of the mixture over the particles, the motion since the last scan included. S depends on three noises, those of
//! range, of bearing and of the motion, and the scan says of each by the score of its variance whether it should have
//! been larger or smaller. [`NoiseCheck`](super::noise::NoiseCheck) gathers the scores.
//!
//! Whatever moves all sightings of a scan as if the robot stood elsewhere may come from the motion, from a map that is
//! off, or from particles that have died out. The sensor is therefore judged by what is left when the pose is free:
//! with so much uncertainty of the pose added to S that no common shift counts.

/// Sightings of a scan that are judged together.
pub(crate) const JOINT_MAX: usize = 4;
/// Numbers in as many sightings.
const SIZE: usize = 2 * JOINT_MAX;
/// Noises: range, bearing, motion.
pub(crate) const NOISES: usize = 3;
/// Of these, the sensor's.
pub(crate) const SENSOR_NOISES: usize = 2;
/// Variances of a pose that is free: far above those of any sighting, not so far that digits are lost.
const FREE_POSE_VARIANCE: [f64; 3] = [1e4, 1e4, 1e2];
/// A scan counts as at most this many times what is expected of it, so that no single one decides: in the mean NIS, and
/// in the scores, which say by how much.
const LARGEST_RATIO: f64 = 25.0;
const LARGEST_SCORED_RATIO: f64 = 6.0;

type Square = [[f64; SIZE]; SIZE];

/// The sightings of a scan as the filter predicted them.
#[derive(Clone, Debug)]
pub(crate) struct PredictedScan {
    /// Numbers in use: twice the sightings.
    pub size: usize,
    /// Measured minus predicted, sighting after sighting.
    pub innovation: [f64; SIZE],
    /// S: covariance of the innovation.
    pub covariance: Square,
    /// What the motion since the last scan adds to it.
    pub motion: Square,
    /// Variances of the sensor's noise, range and bearing in turn.
    pub noise: [f64; SIZE],
    /// Derivative of each number by the robot's pose.
    pub by_pose: [[f64; 3]; SIZE],
}

impl Default for PredictedScan {
    fn default() -> Self {
        Self {
            size: 0,
            innovation: [0.0; SIZE],
            covariance: [[0.0; SIZE]; SIZE],
            motion: [[0.0; SIZE]; SIZE],
            noise: [0.0; SIZE],
            by_pose: [[0.0; 3]; SIZE],
        }
    }
}

/// What one scan says.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct ScanScore {
    /// Sightings.
    pub sightings: f64,
    /// νᵀ S⁻¹ ν: the normalised innovation squared (NIS); two per sighting are expected.
    pub nis: f64,
    /// Σ ν² / S of the ranges and of the bearings alone; one per sighting is expected.
    pub of_component: [f64; 2],
    /// Derivative of the log-likelihood by the factor of each noise's variance.
    pub score: [f64; NOISES],
    /// Fisher's information about these factors.
    pub information: [[f64; NOISES]; NOISES],
    /// Score of the sensor's noises with the pose free.
    pub sensor_score: [f64; SENSOR_NOISES],
    /// Information about these with the pose free.
    pub sensor_information: [[f64; SENSOR_NOISES]; SENSOR_NOISES],
}

/// Score and information under one covariance.
struct Scored {
    nis: f64,
    score: [f64; NOISES],
    information: [[f64; NOISES]; NOISES],
}

impl PredictedScan {
    /// What the scan says; `None` where S is not positive definite.
    pub fn score(&self) -> Option<ScanScore> {
        let n = self.size;
        let Scored { nis, score, information } = self.scored(&self.covariance)?;
        let scale_squared = (LARGEST_RATIO * n as f64 / nis).min(1.0);
        let free = self.scored(&self.with_free_pose())?;
        let of_component = |component: usize| {
            let ratio = |i: usize| self.innovation[i] * self.innovation[i] / self.covariance[i][i];
            scale_squared * (component..n).step_by(2).map(ratio).sum::<f64>()
        };
        Some(ScanScore {
            sightings: 0.5 * n as f64,
            nis: scale_squared * nis,
            of_component: [of_component(0), of_component(1)],
            score,
            information,
            sensor_score: std::array::from_fn(|k| free.score[k]),
            sensor_information: std::array::from_fn(|k| std::array::from_fn(|l| free.information[k][l])),
        })
    }

    /// S with so uncertain a pose that only differences between the sightings count.
    fn with_free_pose(&self) -> Square {
        let mut covariance = self.covariance;
        for i in 0..self.size {
            for j in 0..self.size {
                let products = (0..3).map(|k| FREE_POSE_VARIANCE[k] * self.by_pose[i][k] * self.by_pose[j][k]);
                covariance[i][j] += products.sum::<f64>();
            }
        }
        covariance
    }

    /// The score of each noise under a covariance.
    ///
    /// **Source:** for ν ~ N(0, S(θ)) the score of θ_k is ½ (νᵀ S⁻¹ S_k S⁻¹ ν − tr S⁻¹ S_k) with S_k = ∂S/∂θ_k, and the
    /// information is ½ tr S⁻¹ S_k S⁻¹ S_l.
    fn scored(&self, covariance: &Square) -> Option<Scored> {
        let n = self.size;
        let inverse = inverted(covariance, n)?;
        let mut weighted: [f64; SIZE] =
            std::array::from_fn(|i| (0..n).map(|j| inverse[i][j] * self.innovation[j]).sum());
        let nis: f64 = (0..n).map(|i| weighted[i] * self.innovation[i]).sum();
        let scale = (LARGEST_SCORED_RATIO * n as f64 / nis).min(1.0).sqrt();
        weighted.iter_mut().for_each(|value| *value *= scale);
        let by_motion = multiplied(&inverse, &self.motion, n);
        let quadratic = |component: usize| -> f64 {
            (component..n).step_by(2).map(|i| weighted[i] * weighted[i] * self.noise[i]).sum()
        };
        let motion = (0..n).map(|i| (0..n).map(|j| weighted[i] * self.motion[i][j] * weighted[j]).sum::<f64>()).sum();
        let squares = [quadratic(0), quadratic(1), motion];
        // tr S⁻¹ S_k and tr S⁻¹ S_k S⁻¹ S_l; S_k of the sensor is diagonal.
        let mut traces = [0.0; NOISES];
        let mut products = [[0.0; NOISES]; NOISES];
        for i in 0..n {
            traces[i % 2] += inverse[i][i] * self.noise[i];
            traces[2] += by_motion[i][i];
            for j in 0..n {
                products[i % 2][j % 2] += inverse[i][j] * inverse[i][j] * self.noise[i] * self.noise[j];
                products[i % 2][2] += self.noise[i] * by_motion[i][j] * inverse[j][i];
                products[2][2] += by_motion[i][j] * by_motion[j][i];
            }
        }
        (products[2][0], products[2][1]) = (products[0][2], products[1][2]);
        Some(Scored {
            nis,
            score: std::array::from_fn(|k| 0.5 * (squares[k] - traces[k])),
            information: products.map(|row| row.map(|product| 0.5 * product)),
        })
    }
}

fn multiplied(a: &Square, b: &Square, n: usize) -> Square {
    let mut product = [[0.0; SIZE]; SIZE];
    for i in 0..n {
        for j in 0..n {
            product[i][j] = (0..n).map(|k| a[i][k] * b[k][j]).sum();
        }
    }
    product
}

/// The inverse of the leading n × n block, by Cholesky's factor; `None` where that does not exist.
fn inverted(a: &Square, n: usize) -> Option<Square> {
    let mut l = [[0.0; SIZE]; SIZE];
    for i in 0..n {
        for j in 0..=i {
            let rest = a[i][j] - (0..j).map(|k| l[i][k] * l[j][k]).sum::<f64>();
            if i == j {
                if !(rest > 0.0 && rest.is_finite()) {
                    return None;
                }
                l[i][i] = rest.sqrt();
            } else {
                l[i][j] = rest / l[j][j];
            }
        }
    }
    let mut inverse = [[0.0; SIZE]; SIZE];
    for column in 0..n {
        let mut x = [0.0; SIZE];
        for i in 0..n {
            let right = f64::from(u8::from(i == column));
            x[i] = (right - (0..i).map(|k| l[i][k] * x[k]).sum::<f64>()) / l[i][i];
        }
        for i in (0..n).rev() {
            x[i] = (x[i] - (i + 1..n).map(|k| l[k][i] * x[k]).sum::<f64>()) / l[i][i];
            inverse[i][column] = x[i];
        }
    }
    Some(inverse)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two sightings that share the uncertainty of the motion.
    fn scan(innovation: [f64; 4]) -> PredictedScan {
        let mut scan = PredictedScan { size: 4, ..PredictedScan::default() };
        let by_motion = [[0.3, 0.1], [-0.2, 0.05], [0.25, -0.1], [0.1, 0.2]];
        for i in 0..4 {
            for j in 0..4 {
                scan.motion[i][j] = (0..2).map(|k| by_motion[i][k] * by_motion[j][k]).sum();
                scan.covariance[i][j] = scan.motion[i][j];
            }
            scan.noise[i] = if i % 2 == 0 { 0.04 } else { 0.01 };
            scan.covariance[i][i] += scan.noise[i];
            scan.innovation[i] = innovation[i];
        }
        scan
    }

    /// ln N(ν; 0, S) with each noise's variance scaled.
    fn log_likelihood(scan: &PredictedScan, factors: [f64; NOISES]) -> f64 {
        let n = scan.size;
        let mut s = [[0.0; SIZE]; SIZE];
        for i in 0..n {
            for j in 0..n {
                s[i][j] = scan.covariance[i][j] + (factors[2] - 1.0) * scan.motion[i][j];
            }
            s[i][i] += (factors[i % 2] - 1.0) * scan.noise[i];
        }
        let inverse = inverted(&s, n).unwrap();
        let nis: f64 =
            (0..n).map(|i| (0..n).map(|j| scan.innovation[i] * inverse[i][j] * scan.innovation[j]).sum::<f64>()).sum();
        // The determinant of S is one over that of its inverse, by elimination without pivots.
        let mut rows = inverse;
        let mut log_determinant = 0.0;
        for i in 0..n {
            log_determinant -= rows[i][i].ln();
            for j in i + 1..n {
                let factor = rows[j][i] / rows[i][i];
                (i..n).for_each(|k| rows[j][k] -= factor * rows[i][k]);
            }
        }
        -0.5 * (nis + log_determinant)
    }

    #[test]
    fn the_score_is_the_slope_of_the_log_likelihood() {
        let scan = scan([0.5, -0.3, 0.1, 0.4]);
        let found = scan.score().unwrap();
        for k in 0..NOISES {
            let step = 1e-5;
            let at = |sign: f64| {
                let mut factors = [1.0; NOISES];
                factors[k] += sign * step;
                log_likelihood(&scan, factors)
            };
            let slope = (at(1.0) - at(-1.0)) / (2.0 * step);
            // Central differences err by about step² times the third derivative, which is below 10 here.
            assert!((found.score[k] - slope).abs() < 1e-8, "{k}: {} against {slope}", found.score[k]);
        }
    }

    #[test]
    fn the_information_is_the_mean_curvature() {
        // E[∂²/∂θ_k∂θ_l] of the log-likelihood is minus the information; averaged over ν with νν' = S exactly by taking
        // the columns of S's square root, scaled by √n.
        let base = scan([0.0; 4]);
        let n = base.size;
        let mut factor = [[0.0; SIZE]; SIZE];
        for i in 0..n {
            for j in 0..=i {
                let rest = base.covariance[i][j] - (0..j).map(|k| factor[i][k] * factor[j][k]).sum::<f64>();
                factor[i][j] = if i == j { rest.sqrt() } else { rest / factor[j][j] };
            }
        }
        let information = base.score().unwrap().information;
        let step = 1e-3;
        for k in 0..NOISES {
            let mut curvature = 0.0;
            for column in 0..n {
                let nu: [f64; 4] = std::array::from_fn(|i| factor[i][column] * (n as f64).sqrt());
                let scan = scan(nu);
                let at = |sign: f64| {
                    let mut factors = [1.0; NOISES];
                    factors[k] += sign * step;
                    log_likelihood(&scan, factors)
                };
                curvature += (at(1.0) - 2.0 * at(0.0) + at(-1.0)) / (step * step) / n as f64;
            }
            assert!((information[k][k] + curvature).abs() < 1e-4, "{k}: {} against {}", information[k][k], -curvature);
        }
    }

    #[test]
    fn what_moves_the_whole_scan_says_nothing_of_the_sensor() {
        let mut scan = scan([0.1, -0.05, 0.02, 0.04]);
        scan.by_pose = std::array::from_fn(|i| if i == 0 { [1.0, 0.0, 0.0] } else { [0.0, 0.2, -1.0] });
        let before = scan.score().unwrap();
        (0..4).for_each(|i| scan.innovation[i] += 0.2 * scan.by_pose[i][0] - 0.1 * scan.by_pose[i][2]);
        let after = scan.score().unwrap();
        assert!((after.nis - before.nis).abs() > 1.0);
        for k in 0..SENSOR_NOISES {
            // The free pose has a standard deviation of 100 m and 10 rad: what is left of the shift is below 1e-3 of it.
            assert!((after.sensor_score[k] - before.sensor_score[k]).abs() < 1e-3);
        }
    }

    #[test]
    fn one_wild_scan_counts_no_more_than_its_cap() {
        let found = scan([50.0, -3.0, 1.0, 40.0]).score().unwrap();
        assert!((found.nis - 4.0 * LARGEST_RATIO).abs() < 1e-9);
        assert!(found.of_component.iter().sum::<f64>().is_finite());
    }

    #[test]
    fn a_covariance_that_is_none_says_nothing() {
        let mut bad = scan([0.1; 4]);
        bad.covariance[2][2] = -1.0;
        assert_eq!(bad.score(), None);
    }
}
