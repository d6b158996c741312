//! The maps of all particles: a landmark is a Gaussian in each of them.

use super::look::{Eye, Look, Stand};
use super::matrix::{self, congruence3, full, multiply, multiply_transposed, Symmetric3, Triangle};
use super::pose::SpacePose;
use super::sensor::Spatial;
use super::wide::{Wide, LANES};
use crate::limits::LARGEST_STATE;
use crate::real::Real;
use crate::resampling::follow;
use serde::{Deserialize, Serialize};

/// A landmark's Gaussian in one map, or in several side by side.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Landmark<R> {
    /// Position in the world, metres.
    pub mean: [R; 3],
    /// Square metres.
    pub covariance: Symmetric3<R>,
}

/// A sighting as the passes over particles need it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Measured {
    /// In the numbers of the sensor.
    pub value: [f64; 3],
    /// R of this sighting.
    pub noise: [[f64; 3]; 3],
}

impl Measured {
    /// The numbers, the same in all particles.
    #[inline(always)]
    pub fn wide(&self) -> [Wide; 3] {
        [Wide::constant(self.value[0]), Wide::constant(self.value[1]), Wide::constant(self.value[2])]
    }
}

impl<R: Real> Landmark<R> {
    /// G_θ Σ, and Q = G_θ Σ G_θᵀ + R.
    #[inline(always)]
    pub fn uncertainty(&self, look: &Look<R>, noise: &[[f64; 3]; 3]) -> ([[R; 3]; 3], [[R; 3]; 3]) {
        let half = multiply(&look.by_landmark, &full(self.covariance));
        let mut q = multiply_transposed(&half, &look.by_landmark);
        for i in 0..3 {
            for j in 0..3 {
                q[i][j] = q[i][j] + R::constant(noise[i][j]);
            }
        }
        (half, q)
    }

    /// μ + K ν and Σ − K G Σ, with K = Σ Gᵀ Q⁻¹ and Q = C Cᵀ: the second is Σ − Wᵀ W with W = C⁻¹ G Σ.
    ///
    /// **Why not Joseph's form:** it is symmetric as it is, and a landmark is born with the covariance of one sighting, so
    /// that the difference loses no more digits than there have been sightings.
    #[inline(always)]
    pub fn corrected(&self, look: &Look<R>, noise: &[[f64; 3]; 3]) -> Self {
        let (half, q) = self.uncertainty(look, noise);
        let factor = Triangle::of(&q);
        let (gain, fit) = (factor.whitened_rows(&half), factor.whitened(&look.innovation));
        let (shift, mut out) = (matrix::apply_transposed(&gain, &fit), *self);
        for i in 0..3 {
            out.mean[i] = self.mean[i] + shift[i];
        }
        let mut place = 0;
        for i in 0..3 {
            for j in i..3 {
                let taken = gain[0][i] * gain[0][j] + gain[1][i] * gain[1][j] + gain[2][i] * gain[2][j];
                out.covariance[place] = self.covariance[place] - taken;
                place += 1;
            }
        }
        out
    }
}

/// A landmark as one sighting places it in the robot's frame.
#[derive(Clone, Copy, Debug)]
pub struct Birth(Landmark<f64>);

impl Birth {
    /// g⁻¹(z), with Σ = G⁻¹ R G⁻ᵀ. `None` for a measurement that no point makes.
    pub fn of(model: &impl Spatial, T_robot_sensor: SpacePose, measured: &Measured) -> Option<Self> {
        let point = model.inverse(measured.value)?;
        let (_, by_point) = model.linearize(point);
        let inverse = invert(&by_point)?;
        let noise = measured.noise;
        let upper = [noise[0][0], noise[0][1], noise[0][2], noise[1][1], noise[1][2], noise[2][2]];
        let in_sensor = congruence3(&inverse, upper);
        let turn = T_robot_sensor.rotation.matrix();
        let born = Landmark { mean: T_robot_sensor.transform(point), covariance: congruence3(&turn, in_sensor) };
        let mut numbers = born.mean.iter().chain(&born.covariance);
        numbers.all(|v| v.is_finite()).then_some(Self(born))
    }

    /// As a robot at this pose places it in the world.
    #[inline(always)]
    pub fn at<R: Real>(&self, T_world_robot: SpacePose<R>) -> Landmark<R> {
        let number = R::constant;
        let Landmark { mean: [x, y, z], covariance } = self.0;
        let mut in_robot = [number(0.0); 6];
        for i in 0..6 {
            in_robot[i] = number(covariance[i]);
        }
        Landmark {
            mean: T_world_robot.transform([number(x), number(y), number(z)]),
            covariance: congruence3(&T_world_robot.rotation.matrix(), in_robot),
        }
    }
}

/// A⁻¹ by cofactors; `None` where there is none.
fn invert(a: &[[f64; 3]; 3]) -> Option<[[f64; 3]; 3]> {
    let columns = [matrix::cross(a[1], a[2]), matrix::cross(a[2], a[0]), matrix::cross(a[0], a[1])];
    let determinant = matrix::dot(&a[0], &columns[0]);
    let inverse = std::array::from_fn(|i| std::array::from_fn(|j| columns[j][i] / determinant));
    (determinant != 0.0 && determinant.is_finite()).then_some(inverse)
}

/// One landmark in the maps of all particles, [`LANES`] of them side by side.
///
/// Resampling says only whose landmark a particle has; the numbers move when the landmark is next sighted.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Slot {
    /// Its name.
    pub identity: u32,
    /// How often it was seen.
    pub sightings: u32,
    blocks: Vec<Landmark<Wide>>,
    /// The row of each particle; none while all have their own.
    rows: Vec<u32>,
}

impl Slot {
    /// A landmark that was seen once.
    pub fn new(identity: u32, blocks: Vec<Landmark<Wide>>) -> Self {
        Self { identity, sightings: 1, blocks, rows: Vec::new() }
    }

    /// The landmark of the particles of a block.
    #[inline(always)]
    pub fn read(&self, block: usize) -> Landmark<Wide> {
        if self.rows.is_empty() {
            self.blocks[block]
        } else {
            self.gather(&self.rows, block)
        }
    }

    #[inline(always)]
    fn gather(&self, rows: &[u32], block: usize) -> Landmark<Wide> {
        let mut out = Landmark::<Wide>::default();
        for lane in 0..LANES {
            let row = rows[block * LANES + lane] as usize;
            let (from, at) = (&self.blocks[row / LANES], row % LANES);
            for i in 0..3 {
                out.mean[i].0[lane] = from.mean[i].0[at];
            }
            for i in 0..6 {
                out.covariance[i].0[lane] = from.covariance[i].0[at];
            }
        }
        out
    }

    /// The landmarks of all particles, where each has its own row.
    pub fn blocks(&self) -> &[Landmark<Wide>] {
        &self.blocks
    }

    /// The landmark of one particle.
    pub fn of(&self, particle: usize) -> Landmark<f64> {
        let row = if self.rows.is_empty() { particle } else { self.rows[particle] as usize };
        let (from, at) = (&self.blocks[row / LANES], row % LANES);
        Landmark { mean: from.mean.map(|v| v.0[at]), covariance: from.covariance.map(|v| v.0[at]) }
    }

    /// What all particles have from now on.
    pub fn replace(&mut self, blocks: Vec<Landmark<Wide>>) {
        self.blocks = blocks;
        self.rows.clear();
    }

    /// Row i of the particles becomes row `ancestor_indices[i]`.
    pub fn resample(&mut self, ancestor_indices: &[u32], spare: &mut Vec<u32>) {
        if self.rows.is_empty() {
            self.rows.extend_from_slice(ancestor_indices);
        } else {
            follow(&mut self.rows, ancestor_indices, spare);
        }
    }

    /// The rows of the particles after resampling; none while all have their own.
    pub fn rows_after(&self, ancestor_indices: Option<&[u32]>) -> Vec<u32> {
        match ancestor_indices {
            Some(ancestors) if self.rows.is_empty() => ancestors.to_vec(),
            Some(ancestors) => ancestors.iter().map(|a| self.rows[*a as usize]).collect(),
            None => self.rows.clone(),
        }
    }

    /// The landmark of a block with these rows after a sighting.
    #[inline(always)]
    pub fn seen(
        &self,
        (rows, block): (&[u32], usize),
        eye: &Eye<'_, impl Spatial>,
        stand: &Stand<Wide>,
        measured: &Measured,
    ) -> Landmark<Wide> {
        let landmark = if rows.is_empty() { self.blocks[block] } else { self.gather(rows, block) };
        let look = eye.look(stand, landmark.mean, measured.wide());
        landmark.corrected(&look, &measured.noise)
    }
}

impl Landmark<Wide> {
    /// Whether all numbers can be computed with.
    pub fn is_usable(&self) -> bool {
        let sound = |wide: &Wide| wide.0.iter().all(|v| v.abs() <= LARGEST_STATE);
        let [xx, _, _, yy, _, zz] = &self.covariance;
        let positive = [xx, yy, zz].iter().all(|wide| wide.0.iter().all(|v| *v > 0.0));
        positive && self.mean.iter().chain(&self.covariance).all(sound)
    }
}
