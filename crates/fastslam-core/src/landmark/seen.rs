//! Landmarks of any dimension and sightings of any size, map by map: what the kernels of the plane do side by side.

use super::{Columns, SensorPoses};
use crate::density::Tail;
use crate::gaussian::GaussianOf;
use crate::measurement::{Births, MeasurementModel};
use crate::normal::{Matrix, Normal};
use crate::store::RowsMut;

/// A sighting of `Z` numbers, and from where.
#[derive(Clone, Copy, Debug)]
pub struct Seen<'a, M, const Z: usize> {
    /// How the sensor measures.
    pub model: &'a M,
    /// Where the sensor is, of all particles.
    pub poses: &'a SensorPoses,
    /// What it measured.
    pub measured: [f64; Z],
    /// With which noise.
    pub noise: Matrix<Z, Z>,
    /// How that falls off.
    pub tail: Tail,
}

impl<M, const Z: usize> Seen<'_, M, Z> {
    /// Corrects a landmark in all maps that hold it, as [`super::correct_rows`] does in the plane: adds one to its
    /// sightings, and the log-likelihood of the sighting before the correction to `log_likelihood`. Returns in how many
    /// maps nothing usable came of it, and the landmark is as it was.
    pub fn correct<const D: usize>(&self, rows: &mut RowsMut<'_>, log_likelihood: &mut [f64]) -> u32
    where
        M: MeasurementModel<Z, D>,
    {
        let mut repaired = 0;
        for (i, sum) in log_likelihood.iter_mut().enumerate() {
            let Some(before) = Columns::<D>::gaussian_in::<Normal<D>>(&rows.as_rows(), i) else { continue };
            let linear = self.model.linearize(self.poses.get(i), before.mean);
            let innovation = self.model.innovation(self.measured, linear.expected);
            rows.column(Columns::<D>::SIGHTINGS)[i] += 1.0;
            match before.corrected((&innovation, &linear.by_landmark), &self.noise, self.tail) {
                Some((after, fit)) => {
                    *sum += fit.log_likelihood;
                    let usable = after.is_usable();
                    repaired += u32::from(!usable);
                    Columns::<D>::put(if usable { &after } else { &before }, rows, i);
                }
                None => repaired += 1,
            }
        }
        repaired
    }

    /// The rows of a new landmark in all maps, columns one after the other, as [`super::first_rows`] makes them in the
    /// plane. A landmark is absent where its sighting does not place it: one of several births is no row.
    pub fn first<const D: usize>(&self, columns: usize, values: &mut Vec<f64>)
    where
        M: Births<Z, D>,
    {
        let n = self.poses.x.len();
        values.clear();
        values.resize(columns * n, 0.0);
        let mut rows = RowsMut::new(values, n);
        for i in 0..n {
            if let [(_, birth)] = self.model.births(self.poses.get(i), self.measured, &self.noise)[..] {
                rows.column(Columns::<D>::SIGHTINGS)[i] = 1.0;
                Columns::<D>::put(&birth, &mut rows, i);
            }
        }
    }
}
