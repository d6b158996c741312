//! How far the particles' beliefs about the robot's pose reach together: where a sighting can lie, without looking at
//! every particle again for every sighting.

use super::beliefs::Beliefs;
use crate::association::Box2;
use crate::geometry::Pose;
use crate::math;
use crate::measurement::Placing;
use crate::sighting::Measured;
use crate::vector::{range, vectorized};

/// The region of a sighting may be wider than needed by this fraction of its margin on each side.
const SLACK: f64 = 0.25;

/// The smallest box of sensor poses around those of all particles, and their largest uncertainties.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Extent {
    /// In the middle.
    T_world_sensor: Pose,
    /// Half the size of the box, metres.
    half_size_m: [f64; 2],
    /// Half the range of the headings.
    half_turn_rad: f64,
    /// Largest trace of the position's covariance, and largest variance of the heading.
    position_variance: f64,
    heading_variance: f64,
}

impl Extent {
    /// Of these beliefs.
    pub fn of(beliefs: &Beliefs, T_robot_sensor: Pose) -> Self {
        let [_, _, ph, ..] = beliefs.outline();
        let any = ph.first().copied().unwrap_or(0.0);
        let (place, turn, [position_variance, heading_variance]) = spans(beliefs, T_robot_sensor, any);
        let middle = |(low, high): (f64, f64)| 0.5 * (low + high);
        let half = |(low, high): (f64, f64)| 0.5 * (high - low);
        let [x, y] = [0, 1].map(|axis| (place.low[axis], place.high[axis]));
        let heading = math::wrap_angle(any + middle(turn) + T_robot_sensor.heading);
        Self {
            T_world_sensor: Pose::new(middle(x), middle(y), heading),
            half_size_m: [half(x), half(y)],
            half_turn_rad: half(turn),
            position_variance,
            heading_variance,
        }
    }

    /// A box that holds [`Beliefs::region_of`] and is little larger; none when the particles lie too far apart for
    /// that.
    pub fn region_of<M: Placing>(
        &self,
        model: &M,
        measured: &Measured,
        [reach, lever_arm_m]: [f64; 2],
    ) -> Option<Box2> {
        let range = model.range(measured.value);
        let noise = model.position_variance(measured.value, measured.noise);
        let lever = (range + lever_arm_m) * (range + lever_arm_m);
        let [x, y] = model.inverse(self.T_world_sensor, measured.value);
        let distance = (x - self.T_world_sensor.x).hypot(y - self.T_world_sensor.y);
        let margin = reach * (2.0 * (self.position_variance + lever * self.heading_variance + noise)).sqrt();
        let apart = self.half_size_m.map(|half| half + distance * self.half_turn_rad);
        // Rounding at large coordinates must not let a particle's own region stick out.
        let margin = margin + 1e-12 * (x.abs() + y.abs() + distance);
        let near = apart.iter().all(|apart| *apart <= SLACK * margin);
        near.then(|| Box2 {
            low: [x - apart[0] - margin, y - apart[1] - margin],
            high: [x + apart[0] + margin, y + apart[1] + margin],
        })
    }
}

/// The sensor's places, the range of the headings from `any` one, and the largest variances of position and heading.
fn spans(beliefs: &Beliefs, T_robot_sensor: Pose, any: f64) -> (Box2, (f64, f64), [f64; 2]) {
    let [px, py, ph, xx, yy, hh] = beliefs.outline();
    let n = px.len();
    let (py, ph, xx, yy, hh) = (&py[..n], &ph[..n], &xx[..n], &yy[..n], &hh[..n]);
    vectorized(
        #[inline(always)]
        || {
            let (_, position_variance) = range(
                n,
                #[inline(always)]
                |i| xx[i] + yy[i],
            );
            let (_, heading_variance) = range(
                n,
                #[inline(always)]
                |i| hh[i],
            );
            let turn = range(
                n,
                #[inline(always)]
                |i| math::wrap_angle(ph[i] - any),
            );
            let place = Box2::around(
                n,
                #[inline(always)]
                |i| {
                    let sensor = Pose::new(px[i], py[i], ph[i]).compose(T_robot_sensor);
                    ([sensor.x, sensor.y], [sensor.x, sensor.y])
                },
            );
            (place, turn, [position_variance, heading_variance])
        },
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::association::Belief;
    use crate::density::Tail;
    use crate::filter::beliefs::set_belief_in;
    use crate::measurement::RangeBearing;
    use crate::random::{Purpose, RandomSource};

    #[test]
    fn the_region_holds_that_of_every_particle_and_is_little_larger() {
        let model = RangeBearing { range_std_m: 0.2, bearing_std_rad: 0.03 };
        let T_robot_sensor = Pose::new(0.7, -0.2, 0.4);
        let (mut near, mut far) = (0, 0);
        for case in 0..2_000_u64 {
            let stream = RandomSource::new(3).stream(Purpose::Simulation, case);
            let number = |draw: u32| stream.uniform(1000, draw);
            let n = 1 + (number(0) * 30.0) as usize;
            let (wide_m, turned_rad) = (4.0 * number(1) * number(1), 0.3 * number(2) * number(2));
            let mut beliefs = Beliefs::default();
            beliefs.certain(&vec![0.0; n], &vec![0.0; n], &vec![0.0; n]);
            for i in 0..n {
                let [a, b] = stream.uniform_pair(i as u32, 0);
                let [c, d] = stream.uniform_pair(i as u32, 1);
                let mean = Pose::new(900.0 + wide_m * a, -40.0 + wide_m * b, math::wrap_angle(3.1 + turned_rad * c));
                let covariance = [[1e-3 * d, 0.0, 0.0], [0.0, 2e-3 * b, 0.0], [0.0, 0.0, 1e-4 * a]];
                set_belief_in(&mut beliefs.columns_mut(), i, &Belief { mean, covariance });
            }
            let value = [0.5 + 20.0 * number(3), 6.0 * number(4) - 3.0];
            let measured = Measured { value, noise: model.noise_covariance(), tail: Tail::Gaussian };
            let reach = [5.0, T_robot_sensor.x.hypot(T_robot_sensor.y)];
            let exact = beliefs.region_of(&model, T_robot_sensor, &measured, reach);
            match Extent::of(&beliefs, T_robot_sensor).region_of(&model, &measured, reach) {
                None => far += 1,
                Some(region) => {
                    near += 1;
                    for axis in 0..2 {
                        assert!(region.low[axis] <= exact.low[axis] && exact.high[axis] <= region.high[axis]);
                        let size = |area: &Box2| area.high[axis] - area.low[axis];
                        // At most the slack on each side, and what the largest variances add to those of one particle.
                        assert!(size(&region) <= (1.0 + SLACK) * 1.4 * size(&exact), "case {case}");
                    }
                }
            }
        }
        assert!(near > 500 && far > 100, "{near} {far}");
    }
}
