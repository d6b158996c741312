//! Landmarks given paths: the exact factorisation, for many sampled paths side by side.

use super::factor::{Lanes, LANES};
use super::graph::Graph;
use crate::gaussian::Inverse;
use crate::geometry::{Pose, Symmetric2};
use crate::landmark::{Gaussian, Measured};
use crate::measurement::Placing;
use crate::vector::vectorized;

/// Draws of paths with their landmarks, side by side.
pub struct Draws {
    /// Step of the first pose that was drawn.
    pub first_free: usize,
    /// (x, y, heading) of `T_world_robot`, one row per free step; in the end of `T_world_sensor`.
    pub poses: Vec<[Lanes; 3]>,
    /// `T_world_sensor` before the first free step, the same in all lanes.
    pub held: Vec<Pose>,
    /// (x, y) of every landmark of the graph.
    pub landmarks: Vec<[Lanes; 2]>,
}

impl Draws {
    /// Makes the drawn poses those of the sensors that made the steps.
    pub fn move_to_sensor(&mut self, T_robot_sensor: impl Fn(usize) -> Pose) {
        let (poses, first_free) = (&mut self.poses, self.first_free);
        vectorized(
            #[inline(always)]
            || {
                for (row, [x, y, heading]) in poses.iter_mut().enumerate() {
                    let mounting = T_robot_sensor(first_free + row);
                    for i in 0..LANES {
                        let sensor = Pose::new(x[i], y[i], heading[i]).compose(mounting);
                        (x[i], y[i], heading[i]) = (sensor.x, sensor.y, sensor.heading);
                    }
                }
            },
        );
    }

    /// Calls `see` with the pose of the sensor at a step, as all draws have it.
    #[inline(always)]
    fn with_sensor(&self, step: usize, see: impl FnOnce(&[Lanes; 3])) {
        match step.checked_sub(self.first_free) {
            Some(row) => see(&self.poses[row]),
            None => see(&self.held[step].to_array().map(|v| [v; LANES])),
        }
    }

    /// A landmark given each path: one Gauss–Newton step in information form from the landmark drawn with the path,
    /// which lies as near as the landmark is uncertain.
    ///
    /// **Source:** Σ⁻¹ = Σ_t G_θᵀ R⁻¹ G_θ, which the sequential updates of `montemerlo2002fastslam` compute too, but
    /// each of those linearises where the landmark was thought to be at its time.
    pub fn landmark_given_paths<M: Placing>(&self, graph: &Graph<'_, M>, landmark: usize) -> [Gaussian; LANES] {
        let sights = &graph.landmarks[landmark];
        let [x, y] = self.landmarks[landmark];
        let mut sums = [[0.0; LANES]; 5];
        for i in 0..LANES {
            let known = sights.known.information([x[i], y[i]]);
            sums.iter_mut().zip(known).for_each(|(sum, value)| sum[i] = value);
        }
        vectorized(
            #[inline(always)]
            || {
                for seen in &sights.seen {
                    let measured = *graph.history.sighting(seen.sighting);
                    let model = graph.model(seen.step as usize);
                    self.with_sensor(
                        seen.step as usize,
                        #[inline(always)]
                        |sensor| add_sighting(model, measured, sensor, [&x, &y], &mut sums),
                    );
                }
            },
        );
        std::array::from_fn(|i| {
            let [xx, xy, yy, pull_x, pull_y] = sums.each_ref().map(|sum| sum[i]);
            let covariance = Inverse::of(Symmetric2::new(xx, xy, yy)).matrix();
            let mean = [
                x[i] + covariance.xx * pull_x + covariance.xy * pull_y,
                y[i] + covariance.xy * pull_x + covariance.yy * pull_y,
            ];
            Gaussian { mean, covariance }
        })
    }
}

/// Adds what a sighting says about a landmark: the precision (xx, xy, yy) and the gradient (x, y).
#[inline(always)]
fn add_sighting<M: Placing>(
    model: &M,
    measured: Measured,
    [sensor_x, sensor_y, heading]: &[Lanes; 3],
    [x, y]: [&Lanes; 2],
    [xx, xy, yy, pull_x, pull_y]: &mut [Lanes; 5],
) {
    let inverse = Inverse::of(measured.noise);
    measured.tail.apart(
        #[inline(always)]
        |tail| {
            for i in 0..LANES {
                let linear = model.linearize(Pose::new(sensor_x[i], sensor_y[i], heading[i]), [x[i], y[i]]);
                let [a, b] = model.innovation(measured.value, linear.expected);
                let scale = inverse.reciprocal / tail.noise_scale(inverse.form([a, b]));
                let Symmetric2 { xx: w00, xy: w01, yy: w11 } = inverse.adjugate().scaled(scale);
                let [[g00, g01], [g10, g11]] = linear.by_landmark;
                let (p00, p01) = (w00 * g00 + w01 * g10, w01 * g00 + w11 * g10);
                let (p10, p11) = (w00 * g01 + w01 * g11, w01 * g01 + w11 * g11);
                xx[i] += p00 * g00 + p01 * g10;
                xy[i] += p00 * g01 + p01 * g11;
                yy[i] += p10 * g01 + p11 * g11;
                pull_x[i] += p00 * a + p01 * b;
                pull_y[i] += p10 * a + p11 * b;
            }
        },
    );
}
