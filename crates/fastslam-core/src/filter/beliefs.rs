//! What all particles believe about the robot's pose while they look at a scan, as columns.

use crate::association::Belief;
use crate::geometry::Pose;
use crate::geometry::Symmetric2;
use crate::landmark::{column, Gaussian, Measured};
use crate::math;
use crate::measurement::MeasurementModel;
use crate::motion::MotionGaussian;
use crate::random::Stream;
use crate::store::Rows;
use crate::vector::vectorized;

/// Columns: mean (x, y, heading), then the covariance's xx, xy, xh, yy, yh, hh.
const COLUMNS: usize = 9;

/// A Gaussian over `T_world_robot` per particle.
#[derive(Clone, Debug, Default)]
pub struct Beliefs {
    columns: [Vec<f64>; COLUMNS],
}

impl Beliefs {
    /// Number of particles.
    pub fn len(&self) -> usize {
        self.columns[0].len()
    }

    /// The belief of one particle.
    #[inline(always)]
    pub fn get(&self, i: usize) -> Belief {
        belief(&self.columns.each_ref().map(Vec::as_slice), i)
    }

    /// Changes the belief of one particle.
    pub fn set(&mut self, i: usize, belief: &Belief) {
        put(&mut self.columns.each_mut().map(Vec::as_mut_slice), i, belief);
    }

    /// Poses that are known: samples, as in FastSLAM 1.0.
    pub fn certain(&mut self, x: &[f64], y: &[f64], heading: &[f64]) {
        for (column, values) in self.columns.iter_mut().zip([x, y, heading]) {
            column.clear();
            column.extend_from_slice(values);
        }
        for column in &mut self.columns[3..] {
            column.clear();
            column.resize(x.len(), 0.0);
        }
    }

    /// Poses moved by an uncertain motion, to first order.
    pub fn predict(&mut self, x: &[f64], y: &[f64], heading: &[f64], motion: &MotionGaussian) {
        let n = x.len();
        for column in &mut self.columns {
            column.resize(n, 0.0);
        }
        let mut out = self.columns.each_mut().map(Vec::as_mut_slice);
        let (y, heading) = (&y[..n], &heading[..n]);
        vectorized(
            #[inline(always)]
            || {
                for i in 0..n {
                    let mean = Pose::new(x[i], y[i], heading[i]).compose(motion.mean);
                    put(&mut out, i, &Belief { mean, covariance: motion.covariance_in_world(heading[i]) });
                }
            },
        );
    }

    /// Refines every particle's belief by a sighting of a landmark, adding the sighting's log-likelihoods to
    /// `log_likelihood`. Particles that lack the landmark keep their belief.
    pub fn refine<M: MeasurementModel>(
        &mut self,
        model: &M,
        T_robot_sensor: Pose,
        measured: &Measured,
        rows: &Rows<'_>,
        log_likelihood: &mut [f64],
    ) {
        let n = log_likelihood.len();
        let mut mine = self.columns.each_mut().map(|c| &mut c[..n]);
        let row = |c: usize| &rows.column(c)[..n];
        let (count, x, y) = (row(column::SIGHTINGS), row(column::MEAN_X), row(column::MEAN_Y));
        let (xx, xy, yy) = (row(column::COV_XX), row(column::COV_XY), row(column::COV_YY));
        vectorized(
            #[inline(always)]
            || {
                for i in 0..n {
                    let before = belief(&mine.each_ref().map(|c| &**c), i);
                    let landmark = Gaussian { mean: [x[i], y[i]], covariance: Symmetric2::new(xx[i], xy[i], yy[i]) };
                    let mut after = before;
                    let fit = after.refine(model, T_robot_sensor, &landmark, measured);
                    let present = count[i] != 0.0;
                    log_likelihood[i] += if present { fit.log_likelihood } else { 0.0 };
                    put_if(present, &mut mine, i, &after, &before);
                }
            },
        );
    }

    /// Draws a pose from every particle's belief; the covariance may be singular.
    pub fn sample(&self, stream: Stream, x: &mut [f64], y: &mut [f64], heading: &mut [f64]) {
        let n = x.len();
        let mine = self.columns.each_ref().map(|c| &c[..n]);
        let (y, heading) = (&mut y[..n], &mut heading[..n]);
        vectorized(
            #[inline(always)]
            || {
                for i in 0..n {
                    let [a, b] = stream.normal_pair(i as u32, 0);
                    let [c, _] = stream.normal_pair(i as u32, 1);
                    let pose = draw(&belief(&mine, i), [a, b, c]);
                    (x[i], y[i], heading[i]) = (pose.x, pose.y, pose.heading);
                }
            },
        );
    }

    /// Particle i takes over the belief of the former particle `ancestor_indices[i]`.
    pub fn resample(&mut self, ancestor_indices: &[u32]) {
        for column in &mut self.columns {
            *column = ancestor_indices.iter().map(|&a| column[a as usize]).collect();
        }
    }
}

#[inline(always)]
fn belief(columns: &[&[f64]; COLUMNS], i: usize) -> Belief {
    let [x, y, heading, xx, xy, xh, yy, yh, hh] = columns.map(|c| c[i]);
    Belief { mean: Pose::new(x, y, heading), covariance: [[xx, xy, xh], [xy, yy, yh], [xh, yh, hh]] }
}

#[inline(always)]
fn numbers(b: &Belief) -> [f64; COLUMNS] {
    let [[xx, xy, xh], [_, yy, yh], [_, _, hh]] = b.covariance;
    [b.mean.x, b.mean.y, b.mean.heading, xx, xy, xh, yy, yh, hh]
}

#[inline(always)]
fn put(columns: &mut [&mut [f64]; COLUMNS], i: usize, b: &Belief) {
    for (column, value) in columns.iter_mut().zip(numbers(b)) {
        column[i] = value;
    }
}

#[inline(always)]
fn put_if(choice: bool, columns: &mut [&mut [f64]; COLUMNS], i: usize, b: &Belief, otherwise: &Belief) {
    let (yes, no) = (numbers(b), numbers(otherwise));
    for (c, column) in columns.iter_mut().enumerate() {
        column[i] = if choice { yes[c] } else { no[c] };
    }
}

/// A draw from N(mean, covariance) for three standard normal numbers, by Cholesky.
///
/// **Why:** a pivot that rounding left at or below zero spans no uncertainty; the motion's covariance may be singular.
#[inline(always)]
fn draw(belief: &Belief, [a, b, c]: [f64; 3]) -> Pose {
    let p = &belief.covariance;
    let pivot = |value: f64| if value > 0.0 { value.sqrt() } else { 0.0 };
    let over = |value: f64, pivot: f64| if pivot > 0.0 { value / pivot } else { 0.0 };
    let l00 = pivot(p[0][0]);
    let (l10, l20) = (over(p[1][0], l00), over(p[2][0], l00));
    let l11 = pivot(p[1][1] - l10 * l10);
    let l21 = over(p[2][1] - l20 * l10, l11);
    let l22 = pivot(p[2][2] - l20 * l20 - l21 * l21);
    Pose::new(
        belief.mean.x + l00 * a,
        belief.mean.y + l10 * a + l11 * b,
        math::wrap_angle(belief.mean.heading + l20 * a + l21 * b + l22 * c),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Purpose, RandomSource};

    #[test]
    fn draws_have_the_moments_of_the_belief_also_when_it_is_singular() {
        // Rank 2: the third row is the sum of the other two.
        let covariance = [[0.04, 0.01, 0.05], [0.01, 0.02, 0.03], [0.05, 0.03, 0.08]];
        let n = 40_000;
        let mut beliefs = Beliefs::default();
        beliefs.certain(&vec![0.0; n], &vec![0.0; n], &vec![0.0; n]);
        (0..n).for_each(|i| beliefs.set(i, &Belief { mean: Pose::new(1.0, 2.0, 0.5), covariance }));
        let (mut x, mut y, mut h) = (vec![0.0; n], vec![0.0; n], vec![0.0; n]);
        beliefs.sample(RandomSource::new(3).stream(Purpose::Proposal, 1), &mut x, &mut y, &mut h);
        let columns = [x, y, h];
        let mean = columns.each_ref().map(|c| c.iter().sum::<f64>() / n as f64);
        for row in 0..3 {
            for col in 0..3 {
                let products = columns[row].iter().zip(&columns[col]).map(|(a, b)| (a - mean[row]) * (b - mean[col]));
                let sample = products.sum::<f64>() / n as f64;
                // Standard error of a sample covariance: sqrt((c_ii c_jj + c_ij²) / n); 4 of them.
                let spread = covariance[row][row] * covariance[col][col] + covariance[row][col].powi(2);
                let bound = 4.0 * (spread / n as f64).sqrt();
                assert!((sample - covariance[row][col]).abs() < bound, "({row},{col}): {sample}");
            }
        }
    }
}
