//! What all particles believe about the robot's pose while they look at a scan, as columns.

use super::particles::{mixture, PoseEstimate};
use crate::association::{Belief, Box2};
use crate::geometry::Pose;
use crate::geometry::Symmetric2;
use crate::landmark::{column, Gaussian, Measured};
use crate::math;
use crate::measurement::Placing;
use crate::motion::MotionGaussian;
use crate::random::Stream;
use crate::resampling::follow;
use crate::store::Rows;
use crate::vector::vectorized;

/// Columns: mean (x, y, heading), then the covariance's xx, xy, xh, yy, yh, hh.
pub const COLUMNS: usize = 9;

/// The belief of one particle in columns of beliefs.
pub fn belief_in(columns: &[&mut [f64]; COLUMNS], i: usize) -> Belief {
    let [x, y, heading, xx, xy, xh, yy, yh, hh] = columns.each_ref().map(|column| column[i]);
    Belief { mean: Pose::new(x, y, heading), covariance: [[xx, xy, xh], [xy, yy, yh], [xh, yh, hh]] }
}

/// Changes the belief of one particle in columns of beliefs.
pub fn set_belief_in(columns: &mut [&mut [f64]; COLUMNS], i: usize, belief: &Belief) {
    let [[xx, xy, xh], [_, yy, yh], [_, _, hh]] = belief.covariance;
    let numbers = [belief.mean.x, belief.mean.y, belief.mean.heading, xx, xy, xh, yy, yh, hh];
    for (column, number) in columns.iter_mut().zip(numbers) {
        column[i] = number;
    }
}

/// A Gaussian over `T_world_robot` per particle.
#[derive(Clone, Debug, Default)]
pub struct Beliefs {
    columns: [Vec<f64>; COLUMNS],
    /// Kept for its memory.
    spare: Vec<f64>,
}

impl Beliefs {
    /// Number of particles.
    pub fn len(&self) -> usize {
        self.columns[0].len()
    }

    /// The belief of one particle.
    pub fn get(&self, i: usize) -> Belief {
        let [x, y, heading, xx, xy, xh, yy, yh, hh] = self.columns.each_ref().map(|column| column[i]);
        Belief { mean: Pose::new(x, y, heading), covariance: [[xx, xy, xh], [xy, yy, yh], [xh, yh, hh]] }
    }

    /// The columns, to be changed.
    pub fn columns_mut(&mut self) -> [&mut [f64]; COLUMNS] {
        self.columns.each_mut().map(Vec::as_mut_slice)
    }

    /// The columns that say how far the beliefs reach: mean (x, y, heading), then the covariance's xx, yy, hh.
    pub fn outline(&self) -> [&[f64]; 6] {
        let [x, y, heading, xx, _, _, yy, _, hh] = self.columns.each_ref().map(Vec::as_slice);
        [x, y, heading, xx, yy, hh]
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
        let (y, heading) = (&y[..n], &heading[..n]);
        let [ox, oy, oh, xx, xy, xh, yy, yh, hh] = self.columns.each_mut().map(Vec::as_mut_slice);
        let (ox, oy, oh) = (&mut ox[..n], &mut oy[..n], &mut oh[..n]);
        let (xx, xy, xh) = (&mut xx[..n], &mut xy[..n], &mut xh[..n]);
        let (yy, yh, hh) = (&mut yy[..n], &mut yh[..n], &mut hh[..n]);
        vectorized(
            #[inline(always)]
            || {
                for i in 0..n {
                    let mean = Pose::new(x[i], y[i], heading[i]).compose(motion.mean);
                    (ox[i], oy[i], oh[i]) = (mean.x, mean.y, mean.heading);
                    let [[a, b, c], [_, d, e], [_, _, f]] = motion.covariance_in_world(heading[i]);
                    (xx[i], xy[i], xh[i], yy[i], yh[i], hh[i]) = (a, b, c, d, e, f);
                }
            },
        );
    }

    /// How well a sighting of a landmark fits in every map, as columns of log-likelihoods and squared Mahalanobis
    /// distances. Where a map lacks the landmark, what is written does not count.
    pub fn fit<M: Placing>(
        &self,
        model: &M,
        T_robot_sensor: Pose,
        measured: &Measured,
        rows: &Rows<'_>,
        [log_likelihood, mahalanobis_squared]: [&mut [f64]; 2],
    ) {
        let n = log_likelihood.len();
        let row = |c: usize| &rows.column(c)[..n];
        let (x, y) = (row(column::MEAN_X), row(column::MEAN_Y));
        let (cov_xx, cov_xy, cov_yy) = (row(column::COV_XX), row(column::COV_XY), row(column::COV_YY));
        let mahalanobis_squared = &mut mahalanobis_squared[..n];
        let [px, py, ph, xx, xy, xh, yy, yh, hh] = self.columns.each_ref().map(Vec::as_slice);
        let (px, py, ph) = (&px[..n], &py[..n], &ph[..n]);
        let (xx, xy, xh, yy, yh, hh) = (&xx[..n], &xy[..n], &xh[..n], &yy[..n], &yh[..n], &hh[..n]);
        measured.tail.vectorized(
            #[inline(always)]
            |tail| {
                let measured = Measured { tail, ..*measured };
                for i in 0..n {
                    let belief = Belief {
                        mean: Pose::new(px[i], py[i], ph[i]),
                        covariance: [[xx[i], xy[i], xh[i]], [xy[i], yy[i], yh[i]], [xh[i], yh[i], hh[i]]],
                    };
                    let landmark =
                        Gaussian { mean: [x[i], y[i]], covariance: Symmetric2::new(cov_xx[i], cov_xy[i], cov_yy[i]) };
                    let fit = belief.fit(model, T_robot_sensor, &landmark, &measured);
                    log_likelihood[i] = fit.log_likelihood;
                    mahalanobis_squared[i] = fit.mahalanobis_squared;
                }
            },
        );
    }

    /// A box around the places where a sighted landmark can be in any map.
    ///
    /// `reach` is in standard deviations; `lever_arm_m` is how far the sensor stands from the robot's origin.
    pub fn region_of<M: Placing>(
        &self,
        model: &M,
        T_robot_sensor: Pose,
        measured: &Measured,
        [reach, lever_arm_m]: [f64; 2],
    ) -> Box2 {
        let range = model.range(measured.value);
        let noise = model.position_variance(measured.value, measured.noise);
        let lever = (range + lever_arm_m) * (range + lever_arm_m);
        let n = self.len();
        let [px, py, ph, xx, _, _, yy, _, hh] = self.columns.each_ref().map(Vec::as_slice);
        let (px, py, ph, xx, yy, hh) = (&px[..n], &py[..n], &ph[..n], &xx[..n], &yy[..n], &hh[..n]);
        vectorized(
            #[inline(always)]
            || {
                Box2::around(
                    n,
                    #[inline(always)]
                    |i| {
                        let sensor = Pose::new(px[i], py[i], ph[i]).compose(T_robot_sensor);
                        let [x, y] = model.inverse(sensor, measured.value);
                        // The trace bounds the largest eigenvalue of the sighting's covariance in the plane.
                        let margin = reach * (2.0 * (xx[i] + yy[i] + lever * hh[i] + noise)).sqrt();
                        ([x - margin, y - margin], [x + margin, y + margin])
                    },
                )
            },
        )
    }

    /// Draws poses from the beliefs of the particles from number `first` on; the covariance may be singular.
    pub fn sample(&self, stream: Stream, first: usize, [x, y, heading]: [&mut [f64]; 3]) {
        let n = x.len();
        let (y, heading) = (&mut y[..n], &mut heading[..n]);
        let columns = self.columns.each_ref().map(|column| &column[first..][..n]);
        let [px, py, ph, xx, xy, xh, yy, yh, hh] = columns;
        vectorized(
            #[inline(always)]
            || {
                for i in 0..n {
                    let particle = (first + i) as u32;
                    let [a, b] = stream.normal_pair(particle, 0);
                    let [c, _] = stream.normal_pair(particle, 1);
                    let belief = Belief {
                        mean: Pose::new(px[i], py[i], ph[i]),
                        covariance: [[xx[i], xy[i], xh[i]], [xy[i], yy[i], yh[i]], [xh[i], yh[i], hh[i]]],
                    };
                    let pose = draw(&belief, [a, b, c]);
                    (x[i], y[i], heading[i]) = (pose.x, pose.y, pose.heading);
                }
            },
        );
    }

    /// Mean and covariance of the mixture with these weights.
    pub fn mixture(&self, weights: &[f64]) -> PoseEstimate {
        let n = weights.len();
        let [px, py, ph, xx, xy, xh, yy, yh, hh] = self.columns.each_ref().map(Vec::as_slice);
        let (px, py, ph) = (&px[..n], &py[..n], &ph[..n]);
        let (xx, xy, xh, yy, yh, hh) = (&xx[..n], &xy[..n], &xh[..n], &yy[..n], &yh[..n], &hh[..n]);
        vectorized(
            #[inline(always)]
            || {
                mixture(
                    weights,
                    #[inline(always)]
                    |i| {
                        let covariance = [[xx[i], xy[i], xh[i]], [xy[i], yy[i], yh[i]], [xh[i], yh[i], hh[i]]];
                        (Pose::new(px[i], py[i], ph[i]), covariance)
                    },
                )
            },
        )
    }

    /// Particle i takes over the belief of the former particle `ancestor_indices[i]`.
    pub fn resample(&mut self, ancestor_indices: &[u32]) {
        for column in &mut self.columns {
            follow(column, ancestor_indices, &mut self.spare);
        }
    }
}

/// A sighting that refines beliefs.
#[derive(Clone, Copy, Debug)]
pub struct Refinement<'a, M> {
    /// How the sensor measures.
    pub model: &'a M,
    /// Where the sensor is on the robot.
    pub T_robot_sensor: Pose,
    /// What it measured.
    pub measured: &'a Measured,
    /// The landmark, in all maps.
    pub rows: Rows<'a>,
}

impl<M: Placing> Refinement<'_, M> {
    /// Refines the beliefs of the particles from number `first` on by the sighting of the landmark, adding its
    /// log-likelihoods to `log_likelihood`. Particles that lack the landmark keep their belief.
    pub fn apply(&self, first: usize, columns: [&mut [f64]; COLUMNS], log_likelihood: &mut [f64]) {
        let Self { model, T_robot_sensor, measured, rows } = *self;
        let n = log_likelihood.len();
        let row = |c: usize| &rows.column(c)[first..][..n];
        let (count, x, y) = (row(column::SIGHTINGS), row(column::MEAN_X), row(column::MEAN_Y));
        let (cov_xx, cov_xy, cov_yy) = (row(column::COV_XX), row(column::COV_XY), row(column::COV_YY));
        let [px, py, ph, xx, xy, xh, yy, yh, hh] = columns.map(|column| &mut column[..n]);
        measured.tail.vectorized(
            #[inline(always)]
            |tail| {
                let measured = Measured { tail, ..*measured };
                for i in 0..n {
                    let before = Belief {
                        mean: Pose::new(px[i], py[i], ph[i]),
                        covariance: [[xx[i], xy[i], xh[i]], [xy[i], yy[i], yh[i]], [xh[i], yh[i], hh[i]]],
                    };
                    let landmark =
                        Gaussian { mean: [x[i], y[i]], covariance: Symmetric2::new(cov_xx[i], cov_xy[i], cov_yy[i]) };
                    let mut after = before;
                    let fit = after.refine(model, T_robot_sensor, &landmark, &measured);
                    // Selections in place of branches: the loop must stay a straight line to become vector code.
                    let present = count[i] != 0.0;
                    let pick = |new: f64, old: f64| if present { new } else { old };
                    let [[a, b, c], [_, d, e], [_, _, f]] = after.covariance;
                    log_likelihood[i] += pick(fit.log_likelihood, 0.0);
                    px[i] = pick(after.mean.x, px[i]);
                    py[i] = pick(after.mean.y, py[i]);
                    ph[i] = pick(after.mean.heading, ph[i]);
                    xx[i] = pick(a, xx[i]);
                    xy[i] = pick(b, xy[i]);
                    xh[i] = pick(c, xh[i]);
                    yy[i] = pick(d, yy[i]);
                    yh[i] = pick(e, yh[i]);
                    hh[i] = pick(f, hh[i]);
                }
            },
        );
    }
}

/// A draw from N(mean, covariance) for three standard normal numbers, by Cholesky.
///
/// **Why:** a pivot that rounding left at or below zero spans no uncertainty; the motion's covariance may be singular.
#[inline(always)]
pub(crate) fn draw(belief: &Belief, [a, b, c]: [f64; 3]) -> Pose {
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
        let belief = Belief { mean: Pose::new(1.0, 2.0, 0.5), covariance };
        (0..n).for_each(|i| set_belief_in(&mut beliefs.columns_mut(), i, &belief));
        let (mut x, mut y, mut h) = (vec![0.0; n], vec![0.0; n], vec![0.0; n]);
        beliefs.sample(RandomSource::new(3).stream(Purpose::Proposal, 1), 0, [&mut x, &mut y, &mut h]);
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
