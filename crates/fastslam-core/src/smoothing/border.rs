//! Path and landmarks together with the errors of sensor and odometry, which stand at the border of the precision.
//!
//! Everything else integrated out, their rows and columns of the inverse are the covariance of the parameters. Who asks says
//! how rows are weighed, and with it what becomes of outliers and of the noise.

use super::equations::{Block, Equations};
use super::factor::Factor;
use super::rows::{Row, Rows};
use crate::error::{Error, Result};

/// Information that keeps every unknown somewhere.
const LEAST_INFORMATION: f64 = 1e-9;
/// Standard deviation of a parameter that is held where it is.
const HELD: f64 = 1e-9;

/// What is known of the unknowns but for the rows: how surely, as information, and how far they are off.
#[derive(Clone, Debug)]
pub struct Anchors {
    /// One over the variance, of each unknown; 0 where nothing is known.
    pub information: Vec<f64>,
    /// What is known minus the present solution.
    pub missing: Vec<f64>,
}

/// What is known of the parameters.
#[derive(Clone, Debug)]
pub struct Priors {
    /// Standard deviation of each; 0 for one that is held where it is.
    pub std: Vec<f64>,
    /// What is known minus the present value.
    pub missing: Vec<f64>,
}

/// The factorised normal equations of weighed rows.
pub struct Bordered {
    rows: Rows,
    /// Of unknowns and parameters: information beforehand, and what is known minus the present solution.
    information: Vec<f64>,
    missing: Vec<f64>,
    factor: Factor,
    covariance: Vec<Vec<f64>>,
}

impl Bordered {
    /// Factorises rows whose noise is one ([`Rows::whitened`]).
    ///
    /// **Errors:** [`Error::Input`] for anchors or priors of other sizes, and where the rows do not hold path and
    /// landmarks in place, or a number is not finite.
    pub fn new(rows: Rows, anchors: Anchors, priors: Priors) -> Result<Self> {
        let (size, parameters) = rows.size();
        let lengths = [&anchors.information, &anchors.missing, &priors.std, &priors.missing].map(Vec::len);
        if lengths != [size, size, parameters, parameters] {
            return Err(Error::Input(format!(
                "least squares: got anchors and priors of {lengths:?} numbers, expected {size} and {parameters}"
            )));
        }
        let loose = || Error::Input("least squares: sightings and odometry do not hold path and landmarks".to_owned());
        if !rows.rows.iter().all(|row| row.residual.is_finite()) {
            return Err(loose());
        }
        let held = |std: &f64| if *std > 0.0 { *std } else { HELD };
        let information: Vec<f64> =
            anchors.information.into_iter().chain(priors.std.iter().map(|std| held(std).powi(-2))).collect();
        let missing = [anchors.missing, priors.missing].concat();
        let mut equations = structure(&rows);
        (0..rows.len()).for_each(|row| add_row(&rows, row, &mut equations));
        for (column, known) in information.iter().enumerate() {
            let least = if column < size { LEAST_INFORMATION } else { 0.0 };
            equations.add_known(column, known + least, known * missing[column]);
        }
        let mut factor = Factor::of_structure(&equations.upper).ok_or_else(loose)?;
        if !factor.factorize(&equations.upper) {
            return Err(loose());
        }
        let covariance = factor.covariance(&(size..size + parameters).collect::<Vec<usize>>());
        if !covariance.iter().flatten().all(|value| value.is_finite()) {
            return Err(loose());
        }
        Ok(Self { rows, information, missing, factor, covariance })
    }

    /// The rows.
    pub fn rows(&self) -> &Rows {
        &self.rows
    }

    /// Covariance of the parameters.
    pub fn covariance(&self) -> &[Vec<f64>] {
        &self.covariance
    }

    /// The step of unknowns and parameters that explains the rows.
    pub fn step(&self) -> (Vec<f64>, Vec<f64>) {
        let mut right = self.rows.transposed(&self.rows.residuals());
        let known = self.information.iter().zip(&self.missing);
        right.iter_mut().zip(known).for_each(|(to, (information, missing))| *to = information * missing - *to);
        let mut unknowns = self.factor.solve(&right);
        let parameters = unknowns.split_off(self.rows.size().0);
        (unknowns, parameters)
    }

    /// How the rows would move if they, the anchors and the priors erred by so many standard deviations.
    ///
    /// **Shapes:** `noise` holds rows, unknowns and parameters, in this order. **Why:** with standard normal numbers
    /// these are the rows of a draw from the posterior, less its mode: their variance is the share of the noise that the
    /// solution follows.
    ///
    /// **Errors:** [`Error::Input`] for another number of them.
    pub fn response(&self, noise: &[f64]) -> Result<Vec<f64>> {
        let expected = self.rows.len() + self.information.len();
        if noise.len() != expected {
            return Err(Error::Input(format!("least squares: got {} numbers, expected {expected}", noise.len())));
        }
        let (of_rows, of_known) = noise.split_at(self.rows.len());
        let mut right = self.rows.transposed(of_rows);
        let known = self.information.iter().zip(of_known);
        right.iter_mut().zip(known).for_each(|(to, (information, noise))| *to = information.sqrt() * noise - *to);
        Ok(self.rows.times(&self.factor.solve(&right)))
    }

    /// What each row's residual does to the parameters: rows by parameters.
    pub fn influence(&self) -> Vec<f64> {
        let (size, parameters) = self.rows.size();
        let mut influence = vec![0.0; self.rows.len() * parameters];
        for column in 0..parameters {
            let unit: Vec<f64> = (0..size + parameters).map(|k| f64::from(u8::from(k == size + column))).collect();
            let rows = self.rows.times(&self.factor.solve(&unit));
            rows.iter().enumerate().for_each(|(row, value)| influence[row * parameters + column] = *value);
        }
        influence
    }
}

/// With places for all poses, landmarks and parameters.
fn structure(rows: &Rows) -> Equations {
    let mut seen_from = vec![Vec::new(); rows.landmarks];
    for row in rows.rows[..rows.of_sightings()].iter().step_by(2) {
        seen_from[(row.at[1] - 3 * rows.poses) / 2].push(row.at[0] / 3);
    }
    for poses in &mut seen_from {
        poses.sort_unstable();
        poses.dedup();
    }
    let all: Vec<usize> = (0..rows.poses).collect();
    Equations::new(rows.poses, seen_from.iter().map(|poses| poses.iter().copied()), (rows.parameters, &all))
}

/// Adds a row to the left side.
fn add_row(rows: &Rows, number: usize, equations: &mut Equations) {
    const ONE: [[f64; 1]; 1] = [[1.0]];
    let Row { at, width, first, second, .. } = rows.rows[number];
    let first = Block::new(at[0], [first], &ONE);
    equations.add(&first, &[0.0]);
    let border = rows.border[number * rows.parameters..][..rows.parameters].iter().enumerate();
    let border: Vec<Block<1, 1>> =
        border.map(|(parameter, by)| Block::new(rows.size().0 + parameter, [[*by]], &ONE)).collect();
    match width {
        2 => add_second(&Block::new(at[1], [[second[0], second[1]]], &ONE), (&first, &border), equations),
        _ => add_second(&Block::new(at[1], [second], &ONE), (&first, &border), equations),
    }
    for (place, parameter) in border.iter().enumerate() {
        equations.add(parameter, &[0.0]);
        equations.add_between(&first, parameter);
        border[..place].iter().for_each(|before| equations.add_between(before, parameter));
    }
}

fn add_second<const N: usize>(
    second: &Block<1, N>,
    (first, border): (&Block<1, 3>, &[Block<1, 1>]),
    equations: &mut Equations,
) {
    equations.add(second, &[0.0]);
    equations.add_between(first, second);
    border.iter().for_each(|parameter| equations.add_between(second, parameter));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pose;
    use crate::smoothing::rows::{dot, Problem, Sight, OF_SENSOR};

    const LINKS: usize = 4;
    const OF_MOTION: usize = 2;
    /// Unknowns and parameters.
    const SIZES: [usize; 2] = [3 * (LINKS + 1) + 2 * 3, OF_MOTION + OF_SENSOR];

    /// Five poses, three landmarks of which the last is not surveyed, one of them seen twice from one pose.
    fn problem() -> Problem {
        let at = |k: usize| k as f64;
        let pose = |k| Pose::new(1.1 * at(k), 0.3 * at(k) * at(k), 0.2 + 0.4 * at(k));
        let sight = |pose: usize, landmark: usize| Sight {
            pose,
            landmark,
            range_m: 3.0 + 0.4 * at(pose) - 0.7 * at(landmark),
            bearing_rad: 1.1 - 0.35 * at(pose) + 0.6 * at(landmark),
        };
        Problem {
            poses: (0..=LINKS).map(pose).collect(),
            landmarks: vec![[2.0, 4.0], [5.0, -1.0], [-1.5, 2.5]],
            sensor: [1.05, -0.1, 0.3, -0.2, 0.15],
            motion: (0..LINKS).map(|k| Pose::new(1.0 + 0.1 * at(k), 0.05, 0.38)).collect(),
            by_motion: (0..3 * LINKS * OF_MOTION).map(|k| 0.3 * (1.7 * at(k)).sin()).collect(),
            sights: [(0, 0), (1, 2), (1, 0), (2, 1), (2, 1), (3, 2), (4, 1), (4, 0), (0, 2)]
                .map(|(p, l)| sight(p, l))
                .into(),
        }
    }

    /// Standard deviations that differ from row to row, and roots that mix the axes.
    fn white(problem: &Problem, free: &[bool; SIZES[1]]) -> Rows {
        let seen: Vec<f64> = (0..2 * problem.sights.len()).map(|k| 3.0 + 0.5 * k as f64).collect();
        let root = |k: usize| [[9.0 - k as f64, 0.0, 1.5], [0.4, 11.0, -2.0], [0.0, 0.3, 20.0]];
        let roots: Vec<_> = (0..LINKS).map(root).collect();
        Rows::of(problem).unwrap().whitened(&seen, &roots, free).unwrap()
    }

    fn anchors() -> Anchors {
        let mut information = vec![0.0; SIZES[0]];
        information[..3].fill(1e4);
        information[15..19].fill(40.0);
        Anchors { information, missing: (0..SIZES[0]).map(|k| 0.01 * k as f64).collect() }
    }

    fn priors() -> Priors {
        Priors { std: vec![0.1, 0.3, 0.0, 0.2, 0.3, 0.3, 0.2], missing: vec![0.02, -0.1, 0.3, 0.1, 0.0, -0.05, 0.04] }
    }

    const FREE: [bool; SIZES[1]] = [true, true, false, true, true, true, true];

    /// Rows by unknowns and parameters, in one.
    fn jacobian(rows: &Rows) -> Vec<Vec<f64>> {
        let unit = |k: usize, size: usize| (0..size).map(|i| f64::from(u8::from(i == k))).collect::<Vec<_>>();
        let columns: Vec<Vec<f64>> =
            (0..SIZES[0] + SIZES[1]).map(|k| rows.times(&unit(k, SIZES[0] + SIZES[1]))).collect();
        (0..rows.len()).map(|r| columns.iter().map(|column| column[r]).collect()).collect()
    }

    /// JᵀJ with what is known beside it, and that alone.
    fn normal_matrix(jacobian: &[Vec<f64>]) -> (Vec<Vec<f64>>, Vec<f64>) {
        let all = SIZES[0] + SIZES[1];
        let mut known: Vec<f64> = anchors().information.iter().map(|value| value + LEAST_INFORMATION).collect();
        known.extend(priors().std.iter().map(|std| if *std > 0.0 { std.powi(-2) } else { HELD.powi(-2) }));
        let product = |r: usize, c: usize| jacobian.iter().map(|row| row[r] * row[c]).sum::<f64>();
        let row = |r: usize| (0..all).map(|c| product(r, c) + if r == c { known[r] } else { 0.0 }).collect();
        ((0..all).map(row).collect(), known)
    }

    /// Whether `matrix` times `found` is `expected`, to rounding.
    fn check(matrix: &[Vec<f64>], found: &[f64], expected: &[f64]) {
        for (row, expected) in matrix.iter().zip(expected) {
            let size: f64 = row.iter().zip(found).map(|(a, x)| (a * x).abs()).sum();
            assert!((dot(row, found) - expected).abs() < 1e-9 * (1.0 + size), "{} {expected}", dot(row, found));
        }
    }

    #[test]
    fn derivatives_are_those_of_the_residuals() {
        let (problem, h) = (problem(), 1e-6);
        let jacobian = jacobian(&Rows::of(&problem).unwrap());
        for k in 0..SIZES[0] + SIZES[1] {
            let residuals = |sign: f64| {
                let mut near = problem.clone();
                let poses = 3 * (LINKS + 1);
                match k {
                    k if k < poses => {
                        let mut pose = near.poses[k / 3].to_array();
                        pose[k % 3] += sign * h;
                        near.poses[k / 3] = pose.into();
                    }
                    k if k < SIZES[0] => near.landmarks[(k - poses) / 2][(k - poses) % 2] += sign * h,
                    k if k < SIZES[0] + OF_MOTION => {
                        for link in 0..LINKS {
                            let by = |axis: usize| {
                                sign * h * problem.by_motion[(3 * link + axis) * OF_MOTION + k - SIZES[0]]
                            };
                            let m = near.motion[link];
                            near.motion[link] = Pose::new(m.x + by(0), m.y + by(1), m.heading + by(2));
                        }
                    }
                    k => near.sensor[k - SIZES[0] - OF_MOTION] += sign * h,
                }
                Rows::of(&near).unwrap().residuals()
            };
            for ((row, up), down) in jacobian.iter().zip(residuals(1.0)).zip(residuals(-1.0)) {
                assert!((row[k] - (up - down) / (2.0 * h)).abs() < 1e-7, "{k}: {} {}", row[k], (up - down) / (2.0 * h));
            }
        }
    }

    #[test]
    fn a_step_solves_the_equations_of_all_unknowns_and_parameters_together() {
        let rows = white(&problem(), &FREE);
        let jacobian = jacobian(&rows);
        let (matrix, known) = normal_matrix(&jacobian);
        let bordered = Bordered::new(rows.clone(), anchors(), priors()).unwrap();
        let (unknowns, parameters) = bordered.step();
        assert_eq!([unknowns.len(), parameters.len()], SIZES);
        let residuals = rows.residuals();
        let missing = [anchors().missing, priors().missing].concat();
        let mut right: Vec<f64> = (0..missing.len())
            .map(|k| -jacobian.iter().zip(&residuals).map(|(row, r)| row[k] * r).sum::<f64>())
            .collect();
        for k in 0..missing.len() {
            right[k] += (known[k] - if k < SIZES[0] { LEAST_INFORMATION } else { 0.0 }) * missing[k];
        }
        check(&matrix, &[unknowns, parameters.clone()].concat(), &right);
        assert!((parameters[2] - 0.3).abs() < 1e-9, "a held parameter goes to where it is known to be");
    }

    #[test]
    fn covariance_influence_and_response_are_those_of_the_dense_inverse() {
        let rows = white(&problem(), &FREE);
        let jacobian = jacobian(&rows);
        let (matrix, known) = normal_matrix(&jacobian);
        let bordered = Bordered::new(rows.clone(), anchors(), priors()).unwrap();
        let influence = bordered.influence();
        for parameter in 0..SIZES[1] {
            // The column of the inverse that belongs to the parameter.
            let mut unit = vec![0.0; SIZES[0] + SIZES[1]];
            unit[SIZES[0] + parameter] = 1.0;
            let column = bordered.factor.solve(&unit);
            check(
                &column[SIZES[0]..].iter().map(|value| vec![*value]).collect::<Vec<_>>(),
                &[1.0],
                &bordered.covariance()[parameter],
            );
            check(&matrix, &column, &unit);
            for (r, row) in jacobian.iter().enumerate() {
                assert!((influence[r * SIZES[1] + parameter] - dot(row, &column)).abs() < 1e-9);
            }
        }
        let noise: Vec<f64> = (0..rows.len() + known.len()).map(|k| (0.9 * k as f64).cos()).collect();
        let (of_rows, of_known) = noise.split_at(rows.len());
        let right: Vec<f64> = (0..known.len())
            .map(|k| {
                let information = if k < SIZES[0] { known[k] - LEAST_INFORMATION } else { known[k] };
                information.sqrt() * of_known[k] - jacobian.iter().zip(of_rows).map(|(row, r)| row[k] * r).sum::<f64>()
            })
            .collect();
        let solution = bordered.factor.solve(&right);
        check(&matrix, &solution, &right);
        let response = bordered.response(&noise).unwrap();
        for (row, moved) in jacobian.iter().zip(response) {
            assert!((dot(row, &solution) - moved).abs() < 1e-9);
        }
    }

    #[test]
    fn what_does_not_fit_or_is_not_held_is_refused() {
        let rows = white(&problem(), &FREE);
        let few = Anchors { information: vec![0.0; 3], missing: vec![0.0; 3] };
        assert!(Bordered::new(rows.clone(), few, priors()).is_err());
        assert!(Bordered::new(rows.clone(), anchors(), priors()).unwrap().response(&[0.0; 4]).is_err());
        assert!(Rows::of(&problem()).unwrap().whitened(&[1.0], &[], &FREE).is_err());
        let mut wrong = problem();
        wrong.sights[0].landmark = 3;
        assert!(Rows::of(&wrong).is_err());
        let mut lost = problem();
        lost.poses[1].x = f64::NAN;
        assert!(Bordered::new(white(&lost, &FREE), anchors(), priors()).is_err());
    }
}
