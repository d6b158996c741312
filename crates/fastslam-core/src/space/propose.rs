//! The proposal of FastSLAM 2.0 in space: where each particle is, given its motion and the sightings of a scan.

use super::look::{Eye, Stand};
use super::map::{Measured, Slot};
use super::matrix::{self, dot, Triangle};
use super::motion::SpaceMotion;
use super::pose::{SpacePose, Twist};
use super::sensor::Spatial;
use super::wide::Wide;
use crate::density::LN_TAU;
use crate::normal::Matrix;
use crate::real::Real;

/// A turn that a scan is linearised about once.
const SMALL_TURN_RAD: f64 = 0.02;
/// A turn of which nobody tells the size, and passes over a scan after it.
const WIDE_TURN_RAD: f64 = 0.1;
const WIDE_PASSES: usize = 5;

/// What all particles look at, and with what.
pub struct Scene<'a, M> {
    /// Their sensor.
    pub eye: Eye<'a, M>,
    /// Their motion since the last scan.
    pub motion: &'a Motion,
    /// The sightings of a scan whose landmarks are in the map, with their slots.
    pub known: &'a [(usize, Measured)],
    /// The map.
    pub slots: &'a [Slot],
}

/// How surely particles moved since the last scan, as the passes over them need it.
#[derive(Clone, Copy, Debug)]
pub struct Motion {
    /// L with L Lᵀ = P: the noise is ξ = L ε, ε ~ N(0, I), so that P may be flat.
    root: Matrix<6, 6>,
    passes: usize,
}

impl From<&SpaceMotion> for Motion {
    fn from(motion: &SpaceMotion) -> Self {
        let turn = (3..6).map(|i| motion.covariance[i][i]).fold(0.0, f64::max).sqrt();
        let passes = if turn > SMALL_TURN_RAD { 2 } else { 1 };
        Self { root: motion.root(), passes }
    }
}

impl Motion {
    /// Of a robot that may have turned so far that a scan is linearised about where it was expected only at first.
    pub fn unsure(motion: &SpaceMotion) -> Self {
        let turn = (3..6).map(|i| motion.covariance[i][i]).fold(0.0, f64::max).sqrt();
        let short = Self::from(motion);
        Self { passes: if turn > WIDE_TURN_RAD { WIDE_PASSES } else { short.passes }, ..short }
    }

    /// L v.
    #[inline(always)]
    fn spread<R: Real>(&self, v: &[R; 6]) -> Twist<R> {
        let mut out = [R::constant(0.0); 6];
        for i in 0..6 {
            for k in 0..=i {
                out[i] = out[i] + R::constant(self.root[i][k]) * v[k];
            }
        }
        out
    }

    /// G L.
    #[inline(always)]
    fn in_noise<R: Real>(&self, by_pose: &matrix::Rows<R, 3, 6>) -> matrix::Rows<R, 3, 6> {
        let mut out = [[R::constant(0.0); 6]; 3];
        for z in 0..3 {
            for k in 0..6 {
                let mut sum = by_pose[z][k] * R::constant(self.root[k][k]);
                for i in k + 1..6 {
                    sum = sum + by_pose[z][i] * R::constant(self.root[i][k]);
                }
                out[z][k] = sum;
            }
        }
        out
    }
}

/// N(μ_s, Σ_s) of the particles of a block, and how well they explain the scan.
#[derive(Clone, Copy, Debug)]
pub struct Proposal {
    /// μ_s.
    pub pose: SpacePose<Wide>,
    /// The factor of the information about ε.
    information: Triangle<Wide, 6>,
    /// ln p(z): the weight, up to what is the same for all.
    pub log_likelihood: Wide,
    /// νᵀ L⁻¹ ν of the whole scan; so many numbers are expected as it has.
    pub mahalanobis_squared: Wide,
}

/// The Gaussian over ε that sightings make of N(0, I).
struct Information {
    matrix: matrix::Rows<Wide, 6, 6>,
    vector: [Wide; 6],
    squared: Wide,
    density: Wide,
}

impl Information {
    #[inline(always)]
    fn none() -> Self {
        let (zero, one) = (Wide::constant(0.0), Wide::constant(1.0));
        let mut matrix = [[zero; 6]; 6];
        for i in 0..6 {
            matrix[i][i] = one;
        }
        Self { matrix, vector: [zero; 6], squared: zero, density: zero }
    }

    /// A sighting of innovation r = G ε + noise of N(0, Q), whitened: W = C⁻¹ G, w = C⁻¹ r. Lower triangle only.
    #[inline(always)]
    fn add(&mut self, by_noise: &matrix::Rows<Wide, 3, 6>, innovation: &[Wide; 3]) {
        for z in 0..3 {
            let row = &by_noise[z];
            for i in 0..6 {
                for j in 0..=i {
                    self.matrix[i][j] = self.matrix[i][j] + row[i] * row[j];
                }
                self.vector[i] = self.vector[i] + row[i] * innovation[z];
            }
        }
        self.squared = self.squared + dot(innovation, innovation);
    }
}

impl Proposal {
    /// That of a particle that knows no better.
    pub fn at(pose: SpacePose<Wide>) -> Self {
        let information = Triangle::of(&Information::none().matrix);
        let zero = Wide::default();
        Self { pose, information, log_likelihood: zero, mahalanobis_squared: zero }
    }

    /// Σ_s⁻¹ = P⁻¹ + Σ G_sᵀ Q⁻¹ G_s, in the coordinates ε; linearised where the last pass ended, the first at ŝ.
    ///
    /// **Source:** `montemerlo2003fastslam2`, equations 9 to 15, with all sightings of a scan at once: landmarks are
    /// independent given the pose. The evidence is that of the linear model, equation 19.
    #[inline(always)]
    pub fn of<M: Spatial>(scene: &Scene<'_, M>, predicted: SpacePose<Wide>, block: usize) -> Self {
        let Scene { eye, motion, known, slots } = scene;
        let (mut noise, mut pose) = ([Wide::constant(0.0); 6], predicted);
        let mut pass = 0;
        loop {
            let stand = Stand::from(pose);
            let mut sum = Information::none();
            for (slot, measured) in *known {
                let landmark = slots[*slot].read(block);
                let look = eye.look(&stand, landmark.mean, measured.wide());
                let factor = Triangle::of(&landmark.uncertainty(&look, &measured.noise).1);
                let by_noise = motion.in_noise(&look.by_pose);
                let mut innovation = look.innovation;
                for z in 0..3 {
                    innovation[z] = innovation[z] + dot(&by_noise[z], &noise);
                }
                sum.add(&factor.whitened_rows(&by_noise), &factor.whitened(&innovation));
                sum.density = sum.density + factor.density().ln();
            }
            let information = Triangle::of(&sum.matrix);
            let whitened = information.whitened(&sum.vector);
            noise = information.spread(&whitened);
            pose = predicted.compose(SpacePose::exp(motion.spread(&noise)));
            pass += 1;
            if pass == motion.passes || known.is_empty() {
                return Self::explaining(pose, information, &sum, (&whitened, known.len()));
            }
        }
    }

    /// One particle becomes what another one proposes; what it weighs counts no more.
    pub fn take(&mut self, lane: usize, other: &Self, from: usize) {
        self.pose.rotation.w.0[lane] = other.pose.rotation.w.0[from];
        for i in 0..3 {
            self.pose.rotation.v[i].0[lane] = other.pose.rotation.v[i].0[from];
            self.pose.position[i].0[lane] = other.pose.position[i].0[from];
        }
        for i in 0..6 {
            for j in 0..=i {
                self.information.0[i][j].0[lane] = other.information.0[i][j].0[from];
            }
        }
    }

    #[inline(always)]
    fn explaining(
        pose: SpacePose<Wide>,
        information: Triangle<Wide, 6>,
        sum: &Information,
        (whitened, count): (&[Wide; 6], usize),
    ) -> Self {
        let mahalanobis_squared = sum.squared - dot(whitened, whitened);
        let constant = Wide::constant(-1.5 * LN_TAU * count as f64);
        let log_likelihood =
            constant + sum.density + information.density().ln() - Wide::constant(0.5) * mahalanobis_squared;
        Self { pose, information, log_likelihood, mahalanobis_squared }
    }

    /// s_t ~ N(μ_s, Σ_s), from six standard normal numbers per particle.
    #[inline(always)]
    pub fn sample(&self, motion: &Motion, normal: &[Wide; 6]) -> SpacePose<Wide> {
        let noise = self.information.spread(normal);
        self.pose.compose(SpacePose::exp(motion.spread(&noise)))
    }

    /// The roots of Σ_s: rows L F⁻ᵀ, whose product with its transpose is Σ_s.
    #[inline(always)]
    pub fn root(&self, motion: &Motion) -> matrix::Rows<Wide, 6, 6> {
        let mut columns = [[Wide::constant(0.0); 6]; 6];
        for k in 0..6 {
            columns[k][k] = Wide::constant(1.0);
            columns[k] = motion.spread(&self.information.spread(&columns[k]));
        }
        matrix::transposed(&columns)
    }
}
