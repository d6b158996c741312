//! The landmark filter: one small extended Kalman filter per landmark and particle, all particles in one pass.
//!
//! A row of the store holds the numbers of [`Columns`], whose layout follows from the dimension of the landmarks. The
//! passes here are loops over the columns of the plane without branches, so that they turn into vector code; landmarks of
//! any dimension and sensors of any size go through [`Seen`], one by one. The identities in the docs are those of
//! `montemerlo2002fastslam`.

mod columns;
mod seen;

pub use columns::Columns;
pub use seen::Seen;

pub use crate::density::{Fit, Tail};
pub use crate::gaussian::{fit, fit_with_tail, Gaussian};
use crate::gaussian::{innovation_covariance, inverted, Inverse};
use crate::geometry::{Pose, Symmetric2};
use crate::measurement::Placing;
pub use crate::sighting::Measured;
use crate::store::RowsMut;
use crate::vector::{any, vectorized};
use std::ops::Range;

/// Particles that are corrected together or left out together: whole vectors of any width.
const GROUP: usize = 16;

/// The columns of the plane by name, for its kernels.
pub mod column {
    use super::Planar;

    /// Number of sightings; 0 where the particle's map lacks the landmark.
    pub const SIGHTINGS: usize = Planar::SIGHTINGS;
    /// Mean position, metres.
    pub const MEAN_X: usize = Planar::mean(0);
    /// Mean position, metres.
    pub const MEAN_Y: usize = Planar::mean(1);
    /// Covariance, square metres.
    pub const COV_XX: usize = Planar::covariance(0, 0);
    /// Covariance, square metres.
    pub const COV_XY: usize = Planar::covariance(0, 1);
    /// Covariance, square metres.
    pub const COV_YY: usize = Planar::covariance(1, 1);
    /// How many columns every landmark has.
    pub const COUNT: usize = Planar::COUNT;
    /// One more than the identity that the landmark was seen with, 0 for none. Only in logs where some sightings have
    /// an identity and others have none.
    pub const IDENTITY: usize = Planar::IDENTITY;
}

/// The landmarks of the plane, whose passes over all maps are the kernels here.
pub type Planar = Columns<2>;

/// Poses of the sensor, one per particle, as columns.
#[derive(Clone, Debug, Default)]
pub struct SensorPoses {
    /// Metres.
    pub x: Vec<f64>,
    /// Metres.
    pub y: Vec<f64>,
    /// Radians.
    pub heading: Vec<f64>,
}

impl SensorPoses {
    /// `T_world_robot * T_robot_sensor` for every particle.
    pub fn set(&mut self, x: &[f64], y: &[f64], heading: &[f64], T_robot_sensor: Pose) {
        for column in [&mut self.x, &mut self.y, &mut self.heading] {
            column.resize(x.len(), 0.0);
        }
        let n = x.len();
        let (y, heading) = (&y[..n], &heading[..n]);
        let (out_x, out_y, out_heading) = (&mut self.x[..n], &mut self.y[..n], &mut self.heading[..n]);
        vectorized(
            #[inline(always)]
            || {
                for i in 0..n {
                    let sensor = Pose::new(x[i], y[i], heading[i]).compose(T_robot_sensor);
                    (out_x[i], out_y[i], out_heading[i]) = (sensor.x, sensor.y, sensor.heading);
                }
            },
        );
    }

    /// `T_world_sensor` of one particle.
    #[inline(always)]
    pub fn get(&self, particle: usize) -> Pose {
        Pose::new(self.x[particle], self.y[particle], self.heading[particle])
    }
}

/// The landmark after a sighting from a known pose, and how well the sighting fitted before it.
///
/// **Source:** `montemerlo2002fastslam`, section 3.2: ν = z − g(μ, s), Q = GΣGᵀ + R, K = ΣGᵀQ⁻¹; the covariance in
/// Joseph's form. **Why:** Joseph's form keeps Σ positive definite whatever the rounding.
#[inline(always)]
pub fn correct<M: Placing>(model: &M, T_world_sensor: Pose, measured: Measured, landmark: Gaussian) -> (Gaussian, Fit) {
    let linear = model.linearize(T_world_sensor, landmark.mean);
    let innovation = model.innovation(measured.value, linear.expected);
    let [[g00, g01], [g10, g11]] = linear.by_landmark;
    let s = landmark.covariance;
    let plain = fit(innovation, innovation_covariance(linear.by_landmark, s, measured.noise));
    let noise = measured.noise.scaled(measured.tail.noise_scale(plain.mahalanobis_squared));
    let q = innovation_covariance(linear.by_landmark, s, noise);
    let inverse = Inverse::of(q);
    // Σ Gᵀ, then times Q⁻¹.
    let (p00, p01) = (s.xx * g00 + s.xy * g01, s.xx * g10 + s.xy * g11);
    let (p10, p11) = (s.xy * g00 + s.yy * g01, s.xy * g10 + s.yy * g11);
    let ([k00, k01], [k10, k11]) = (inverse.times([p00, p01]), inverse.times([p10, p11]));
    let rest = [
        [1.0 - (k00 * g00 + k01 * g10), -(k00 * g01 + k01 * g11)],
        [-(k10 * g00 + k11 * g10), 1.0 - (k10 * g01 + k11 * g11)],
    ];
    let prior = s.transformed(rest);
    let added = noise.transformed([[k00, k01], [k10, k11]]);
    let corrected = Gaussian {
        mean: [
            landmark.mean[0] + k00 * innovation[0] + k01 * innovation[1],
            landmark.mean[1] + k10 * innovation[0] + k11 * innovation[1],
        ],
        covariance: Symmetric2::new(prior.xx + added.xx, prior.xy + added.xy, prior.yy + added.yy),
    };
    (corrected, measured.tail.log_likelihood(plain))
}

/// A landmark at its first sighting: μ = g⁻¹(z, s), Σ = G⁻¹ R G⁻ᵀ.
///
/// **Why:** within a particle the pose is known, so no uncertainty of the pose enters.
#[inline(always)]
pub fn first_sighting<M: Placing>(model: &M, T_world_sensor: Pose, measured: [f64; 2], noise: Symmetric2) -> Gaussian {
    let mean = model.inverse(T_world_sensor, measured);
    let covariance = noise.transformed(inverted(model.linearize(T_world_sensor, mean).by_landmark));
    Gaussian { mean, covariance }
}

/// Corrects a landmark in all maps (those in `mask`), adding one to its sightings, and adds the log-likelihood of the
/// sighting before the correction to `log_likelihood`. Returns how many landmarks were repaired: where rounding has made
/// the covariance indefinite, the landmark is as it was before the sighting.
pub fn correct_rows<M: Placing>(correction: &Correction<'_, M>, rows: RowsMut<'_>, log_likelihood: &mut [f64]) -> u32 {
    correction.apply(0, rows.columns(), log_likelihood)
}

/// A sighting that corrects a landmark.
#[derive(Clone, Copy, Debug)]
pub struct Correction<'a, M> {
    /// How the sensor measures.
    pub model: &'a M,
    /// Where the sensor is, of all particles.
    pub poses: &'a SensorPoses,
    /// What it measured.
    pub measured: Measured,
    /// The maps in which it corrects the landmark; all without one.
    pub mask: Option<&'a [bool]>,
}

impl<M: Placing> Correction<'_, M> {
    /// [`correct_rows`] for the particles from number `first` on, whose columns these are.
    pub fn apply(&self, first: usize, mut rows: [&mut [f64]; column::COUNT], log_likelihood: &mut [f64]) -> u32 {
        let Some(mask) = self.mask else { return self.correct_apart(first, rows, |_| true, log_likelihood) };
        let mask = &mask[first..][..log_likelihood.len()];
        let mut repaired = 0;
        for run in runs(mask) {
            let (mask, log_likelihood) = (&mask[run.clone()], &mut log_likelihood[run.clone()]);
            let rows = rows.each_mut().map(|column| &mut column[run.clone()]);
            repaired += self.correct_apart(first + run.start, rows, |i| mask[i], log_likelihood);
        }
        repaired
    }

    #[inline(always)]
    fn correct_apart(
        &self,
        first: usize,
        rows: [&mut [f64]; column::COUNT],
        chosen: impl Fn(usize) -> bool,
        log_likelihood: &mut [f64],
    ) -> u32 {
        self.measured.tail.vectorized(
            #[inline(always)]
            |tail| {
                let measured = Measured { tail, ..self.measured };
                Self { measured, ..*self }.correct_where(first, rows, chosen, log_likelihood)
            },
        )
    }

    #[inline(always)]
    fn correct_where(
        &self,
        first: usize,
        rows: [&mut [f64]; column::COUNT],
        chosen: impl Fn(usize) -> bool,
        log_likelihood: &mut [f64],
    ) -> u32 {
        // As wide as the numbers beside it, or the loop would not become vector code.
        let mut repaired = 0_u64;
        let Self { model, poses, measured, .. } = *self;
        let n = log_likelihood.len();
        let [count, mean_x, mean_y, xx, xy, yy] = rows.map(|c| &mut c[..n]);
        let [x, y, heading] = [&poses.x, &poses.y, &poses.heading].map(|c| &c[first..][..n]);
        for i in 0..n {
            let before = Gaussian { mean: [mean_x[i], mean_y[i]], covariance: Symmetric2::new(xx[i], xy[i], yy[i]) };
            let (after, fit) = correct(model, Pose::new(x[i], y[i], heading[i]), measured, before);
            // Selections in place of branches: the loop must stay a straight line to become vector code.
            let active = (count[i] != 0.0) & chosen(i);
            let pick = |new: f64, old: f64| if active { new } else { old };
            count[i] = pick(count[i] + 1.0, count[i]);
            let Symmetric2 { xx: a, xy: b, yy: c } = after.covariance;
            let definite = (a > 0.0) & (a * c - b * b > 0.0);
            repaired += u64::from(active & !definite);
            let sound = |new: f64, old: f64| if active & definite { new } else { old };
            mean_x[i] = sound(after.mean[0], before.mean[0]);
            mean_y[i] = sound(after.mean[1], before.mean[1]);
            xx[i] = sound(a, before.covariance.xx);
            xy[i] = sound(b, before.covariance.xy);
            yy[i] = sound(c, before.covariance.yy);
            log_likelihood[i] += pick(fit.log_likelihood, 0.0);
        }
        repaired as u32
    }
}

/// Runs of particles of which the mask marks some, with few others: whole groups of [`GROUP`].
fn runs(mask: &[bool]) -> impl Iterator<Item = Range<usize>> + '_ {
    let group = |begin: usize| begin..(begin + GROUP).min(mask.len());
    let mut next = 0;
    std::iter::from_fn(move || {
        while next < mask.len() && !any(&mask[group(next)]) {
            next += GROUP;
        }
        let first = next;
        while next < mask.len() && any(&mask[group(next)]) {
            next += GROUP;
        }
        (first < mask.len()).then(|| first..next.min(mask.len()))
    })
}

/// The rows of a new landmark in all maps (those in `mask`; absent in the others), columns one after the other.
pub fn first_rows<M: Placing>(first: &Correction<'_, M>, columns: usize, values: &mut Vec<f64>) {
    let Correction { model, poses, measured, mask } = *first;
    let n = poses.x.len();
    values.clear();
    values.resize(columns * n, 0.0);
    let rows = RowsMut::new(values, n);
    match mask {
        None => vectorized(
            #[inline(always)]
            || first_where(model, poses, measured, rows, |_| true),
        ),
        // Few are done sooner one by one.
        Some(mask) if mask.iter().filter(|new| **new).count() < n / 8 => {
            let [count, mean_x, mean_y, xx, xy, yy] = rows.columns::<{ column::COUNT }>();
            for i in (0..n).filter(|i| mask[*i]) {
                let landmark = first_sighting(model, poses.get(i), measured.value, measured.noise);
                (count[i], mean_x[i], mean_y[i]) = (1.0, landmark.mean[0], landmark.mean[1]);
                (xx[i], xy[i], yy[i]) = (landmark.covariance.xx, landmark.covariance.xy, landmark.covariance.yy);
            }
        }
        Some(mask) => {
            let mask = &mask[..n];
            vectorized(
                #[inline(always)]
                || first_where(model, poses, measured, rows, |i| mask[i]),
            );
        }
    }
}

#[inline(always)]
fn first_where<M: Placing>(
    model: &M,
    poses: &SensorPoses,
    measured: Measured,
    rows: RowsMut<'_>,
    chosen: impl Fn(usize) -> bool,
) {
    let n = poses.x.len();
    let [count, mean_x, mean_y, xx, xy, yy] = rows.columns::<{ column::COUNT }>().map(|c| &mut c[..n]);
    let (x, y, heading) = (&poses.x[..n], &poses.y[..n], &poses.heading[..n]);
    for i in 0..n {
        let pose = Pose::new(x[i], y[i], heading[i]);
        let landmark = first_sighting(model, pose, measured.value, measured.noise);
        // Selections in place of branches: the loop must stay a straight line to become vector code.
        let new = chosen(i);
        let pick = |value: f64| if new { value } else { 0.0 };
        (count[i], mean_x[i], mean_y[i]) = (pick(1.0), pick(landmark.mean[0]), pick(landmark.mean[1]));
        let covariance = landmark.covariance;
        (xx[i], xy[i], yy[i]) = (pick(covariance.xx), pick(covariance.xy), pick(covariance.yy));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measurement::{MeasurementModel, RangeBearing};

    const MODEL: RangeBearing = RangeBearing { range_std_m: 0.2, bearing_std_rad: 0.05 };

    #[test]
    fn runs_hold_all_that_is_marked_and_no_group_without() {
        for case in 0..500_usize {
            let n = case % 70;
            let mask: Vec<bool> = (0..n).map(|i| (i * 7 + case * 13) % 29 < case % 5).collect();
            let mut held = vec![false; n];
            for run in runs(&mask) {
                assert!(run.start % GROUP == 0 && (run.end % GROUP == 0 || run.end == n));
                assert!(mask[run.clone()].chunks(GROUP).all(any));
                held[run].iter_mut().for_each(|held| *held = !*held);
            }
            assert!((0..n).all(|i| held[i] || !mask[i]), "case {case}");
        }
    }

    #[test]
    fn a_covariance_that_loses_definiteness_is_repaired_and_counted() {
        let mut poses = SensorPoses::default();
        poses.set(&[0.0; 3], &[0.0; 3], &[0.3; 3], Pose::default());
        let noise = MODEL.noise_covariance();
        let measured = Measured { value: [4.0, 0.2], noise, tail: Tail::Gaussian };
        let mut rows = Vec::new();
        let mask = Some(&[true, true, false][..]);
        first_rows(&Correction { model: &MODEL, poses: &poses, measured, mask }, column::COUNT, &mut rows);
        let before = rows.clone();
        // A sighting without any noise leaves nothing of the covariance.
        let exact = Measured { value: [4.1, 0.21], noise: noise.scaled(0.0), tail: Tail::Gaussian };
        let mut log_likelihood = [0.0; 3];
        let correction = |measured| Correction { model: &MODEL, poses: &poses, measured, mask: None };
        let repaired = correct_rows(&correction(exact), RowsMut::new(&mut rows, 3), &mut log_likelihood);
        assert_eq!(repaired, 2);
        assert_eq!(rows[3..], before[3..]);
        assert_eq!(rows[..3], [2.0, 2.0, 0.0]);
        let again = correct_rows(&correction(measured), RowsMut::new(&mut rows, 3), &mut log_likelihood);
        assert_eq!(again, 0);
    }

    #[test]
    fn the_first_covariance_is_the_measurement_noise_seen_from_the_pose() {
        // Straight ahead at 4 m: 0.2 m along the view, 4 m · 0.05 rad across it; here the view is along y.
        let pose = Pose::new(1.0, 2.0, std::f64::consts::FRAC_PI_2);
        let landmark = first_sighting(&MODEL, pose, [4.0, 0.0], MODEL.noise_covariance());
        assert!((landmark.mean[0] - 1.0).abs() < 1e-12 && (landmark.mean[1] - 6.0).abs() < 1e-12);
        assert!((landmark.covariance.yy - 0.04).abs() < 1e-12);
        assert!((landmark.covariance.xx - 0.04).abs() < 1e-12);
        assert!(landmark.covariance.xy.abs() < 1e-12);
    }

    #[test]
    fn correcting_agrees_with_the_information_form() {
        let pose = Pose::new(0.3, -0.2, 0.4);
        let before = Gaussian { mean: [3.0, 1.5], covariance: Symmetric2::new(0.3, 0.1, 0.2) };
        let measured = [3.1, 0.1];
        let sighting = Measured { value: measured, noise: MODEL.noise_covariance(), tail: Tail::Gaussian };
        let (after, fit) = correct(&MODEL, pose, sighting, before);
        // Information form: Σ⁻¹ + Gᵀ R⁻¹ G, and the gain Σ' Gᵀ R⁻¹.
        let linear = MODEL.linearize(pose, before.mean);
        let innovation = MODEL.innovation(measured, linear.expected);
        let r = [0.04_f64.recip(), 0.0025_f64.recip()];
        let g = linear.by_landmark;
        let det = before.covariance.determinant();
        let information = Symmetric2::new(
            before.covariance.yy / det + g[0][0] * g[0][0] * r[0] + g[1][0] * g[1][0] * r[1],
            -before.covariance.xy / det + g[0][0] * g[0][1] * r[0] + g[1][0] * g[1][1] * r[1],
            before.covariance.xx / det + g[0][1] * g[0][1] * r[0] + g[1][1] * g[1][1] * r[1],
        );
        let d = information.determinant();
        let expected = Symmetric2::new(information.yy / d, -information.xy / d, information.xx / d);
        assert!((after.covariance.xx - expected.xx).abs() < 1e-14);
        assert!((after.covariance.xy - expected.xy).abs() < 1e-14);
        assert!((after.covariance.yy - expected.yy).abs() < 1e-14);
        let push = [
            g[0][0] * r[0] * innovation[0] + g[1][0] * r[1] * innovation[1],
            g[0][1] * r[0] * innovation[0] + g[1][1] * r[1] * innovation[1],
        ];
        assert!((after.mean[0] - (3.0 + expected.xx * push[0] + expected.xy * push[1])).abs() < 1e-13);
        assert!((after.mean[1] - (1.5 + expected.xy * push[0] + expected.yy * push[1])).abs() < 1e-13);
        assert!(fit.mahalanobis_squared > 0.0);
    }

    #[test]
    fn a_heavy_tail_believes_an_outlier_less_and_an_ordinary_sighting_as_much() {
        let before = Gaussian { mean: [4.0, 0.0], covariance: Symmetric2::new(0.01, 0.0, 0.01) };
        let sighting = |range: f64, tail| Measured { value: [range, 0.0], noise: MODEL.noise_covariance(), tail };
        let shift = |range, tail| correct(&MODEL, Pose::default(), sighting(range, tail), before).0.mean[0] - 4.0;
        let heavy = Tail::StudentT(4.0);
        assert_eq!(shift(4.1, heavy), shift(4.1, Tail::Gaussian));
        assert!(shift(8.0, heavy) < 0.05 * shift(8.0, Tail::Gaussian));
        // t density with 4 degrees of freedom and unit scale at d² = 4: (1 + 4/4)^-3 / 2π = 1 / 16π.
        let density = fit_with_tail([2.0, 0.0], Symmetric2::new(1.0, 0.0, 1.0), heavy).log_likelihood;
        assert!((density + (16.0 * std::f64::consts::PI).ln()).abs() < 1e-14);
    }
}
