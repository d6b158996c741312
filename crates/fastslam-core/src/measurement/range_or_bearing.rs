//! Distance and direction of a landmark, or one of the two: what the sensors of a robot have in common.

use super::{Component, Linearization, MeasurementModel, Placing, RangeBearing, Sensor, SensorModel, SystematicError};
use crate::density::{Tail, LN_TAU};
use crate::error::{Error, Result};
use crate::geometry::{Pose, Symmetric2};
use crate::math;
use crate::normal::Matrix;
use crate::real::Real;
use serde::Serialize;

/// Range and bearing, of which a sensor may measure one alone.
///
/// **Measurement:** as of [`RangeBearing`]; the number that is not measured is never off, depends on neither pose nor
/// landmark, and has a variance of its own.
/// **Why:** with a row of zeros in G and an innovation of 0, S is diagonal and that number changes no estimate and no
/// distance: the update is, bit by bit of its arithmetic, that by one number. Its variance is 1/2π, for which the density at
/// 0 is one: the likelihood is that of one number, whatever that is measured in. (With a heavy tail, of which the kernels
/// leave out the constant of one dimension, that constant is in it.) So all passes over particles stay as they are.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct RangeOrBearing {
    model: RangeBearing,
    /// 1 for what is measured, 0 for what is not.
    measures: [f64; 2],
    /// Variance of a number that is not measured.
    unmeasured: f64,
    /// No landmark is nearer, or farther.
    reach_m: [f64; 2],
    field_of_view_rad: f64,
}

impl RangeOrBearing {
    /// As this sensor measures.
    ///
    /// **Errors:** [`Error::Parameter`] for a sensor of one's own.
    pub fn of(sensor: &Sensor) -> Result<Self> {
        let (model, measures) = match sensor {
            Sensor::RangeBearing(sensor) => (sensor.model, [1.0, 1.0]),
            Sensor::Range(sensor) => {
                (RangeBearing { range_std_m: sensor.model.range_std_m, bearing_std_rad: 1.0 }, [1.0, 0.0])
            }
            Sensor::Bearing(sensor) => {
                (RangeBearing { range_std_m: 1.0, bearing_std_rad: sensor.bearing_std_rad }, [0.0, 1.0])
            }
            Sensor::Own(_) => {
                let expected = "range_bearing, range or bearing: a sensor of one's own is used alone";
                return Err(Error::parameter("sensor.model", SensorModel::Own.name(), expected));
            }
        };
        let common = sensor.common();
        // Density at 0: e^(constant of the tail).
        let unmeasured = math::exp(-LN_TAU - 2.0 * sensor.tail().log_constant_of_one());
        let reach_m = [common.min_range_m, common.max_range_m];
        Ok(Self { model, measures, unmeasured, reach_m, field_of_view_rad: common.field_of_view_rad })
    }

    /// Of two numbers, that which is measured, or `other`.
    fn measured_or(&self, own: [f64; 2], other: [f64; 2]) -> [f64; 2] {
        std::array::from_fn(|k| if self.measures[k] != 0.0 { own[k] } else { other[k] })
    }
}

impl MeasurementModel<2, 2> for RangeOrBearing {
    #[inline(always)]
    fn expected<R: Real>(&self, T_world_sensor: Pose<R>, landmark_in_world: [R; 2]) -> [R; 2] {
        self.model.expected(T_world_sensor, landmark_in_world)
    }

    #[inline(always)]
    fn innovation<R: Real>(&self, measured: [R; 2], expected: [R; 2]) -> [R; 2] {
        let [range, bearing] = self.model.innovation(measured, expected);
        let [r, b] = self.measures;
        [range * R::constant(r), bearing * R::constant(b)]
    }

    #[inline(always)]
    fn noise(&self) -> Matrix<2, 2> {
        let Symmetric2 { xx, xy, yy } = self.given_noise(self.model.noise_covariance());
        [[xx, xy], [xy, yy]]
    }

    fn components(&self) -> [Component; 2] {
        self.model.components()
    }

    #[inline(always)]
    fn linearize(&self, T_world_sensor: Pose, landmark_in_world: [f64; 2]) -> Linearization<2, 2> {
        let Linearization { expected, by_landmark, by_pose } = self.model.linearize(T_world_sensor, landmark_in_world);
        let ([[ux, uy], [vx, vy]], [[a, b, c], [d, e, f]], [r, s]) = (by_landmark, by_pose, self.measures);
        Linearization {
            expected,
            by_landmark: [[r * ux, r * uy], [s * vx, s * vy]],
            by_pose: [[r * a, r * b, r * c], [s * d, s * e, s * f]],
        }
    }
}

impl Placing for RangeOrBearing {
    #[inline(always)]
    fn inverse<R: Real>(&self, T_world_sensor: Pose<R>, measured: [R; 2]) -> [R; 2] {
        self.model.inverse(T_world_sensor, measured)
    }

    /// What is not measured is as far as the sensor sees, or straight ahead.
    fn corrected(&self, reported: [f64; 2], error: &SystematicError) -> [f64; 2] {
        self.measured_or(error.corrected(reported), [self.reach_m[1], 0.0])
    }

    fn is_usable(&self, measured: [f64; 2]) -> bool {
        self.model.is_usable(measured)
    }

    fn range(&self, measured: [f64; 2]) -> f64 {
        self.model.range(measured)
    }

    fn position_variance(&self, measured: [f64; 2], noise: Symmetric2) -> f64 {
        let [r, b] = self.measures;
        r * noise.xx + b * measured[0] * measured[0] * noise.yy
    }

    fn measures(&self) -> [bool; 2] {
        self.measures.map(|measured| measured != 0.0)
    }

    fn given_noise(&self, noise: Symmetric2) -> Symmetric2 {
        let [xx, yy] = self.measured_or([noise.xx, noise.yy], [self.unmeasured; 2]);
        let [r, b] = self.measures;
        Symmetric2::new(xx, r * b * noise.xy, yy)
    }

    fn completed(&self, measured: [f64; 2], expected: [f64; 2]) -> [f64; 2] {
        self.measured_or(measured, expected)
    }

    /// The ends of a ray; the corners of a square around a ring.
    fn extremes(&self, measured: [f64; 2]) -> [[f64; 2]; 4] {
        let [nearest_m, farthest_m] = self.reach_m;
        match self.measures() {
            [true, true] => [measured; 4],
            [false, _] => {
                let [near, far] = [nearest_m, farthest_m].map(|range_m| [range_m, measured[1]]);
                [near, far, near, far]
            }
            [true, false] => {
                let corner = std::f64::consts::FRAC_PI_4;
                [corner, 3.0 * corner, 5.0 * corner, 7.0 * corner]
                    .map(|bearing_rad| [measured[0] * std::f64::consts::SQRT_2, bearing_rad])
            }
        }
    }

    fn unmeasured_extent(&self) -> f64 {
        let [nearest_m, farthest_m] = self.reach_m;
        let [r, b] = self.measures();
        let range_m = if r { 1.0 } else { (farthest_m - nearest_m).max(f64::MIN_POSITIVE) };
        range_m * if b { 1.0 } else { self.field_of_view_rad.min(std::f64::consts::TAU) }
    }
}

impl Tail {
    /// The logarithm of the constant of the density of one number over that of the normal one.
    fn log_constant_of_one(self) -> f64 {
        // At no distance nothing else is left.
        self.log_excess_of(1, 0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gaussian::{fit_with_tail, innovation_covariance};
    use crate::landmark::{correct, Gaussian, Measured};

    const PLACE: Gaussian = Gaussian { mean: [4.0, 3.0], covariance: Symmetric2 { xx: 0.5, xy: 0.1, yy: 0.3 } };
    const POSE: Pose = Pose { x: 0.3, y: -0.4, heading: 0.2 };

    fn sensor(model: &str, tail: Option<f64>) -> Sensor {
        let tail = tail.map_or(String::new(), |k| format!(r#", "tail_degrees_of_freedom": {k}"#));
        serde_json::from_str(&format!(r#"{{"model": "{model}", "max_range_m": 30, "field_of_view_rad": 2{tail}}}"#))
            .unwrap()
    }

    fn sighting(model: &RangeOrBearing, sensor: &Sensor, value: [f64; 2]) -> Measured {
        let value = model.corrected(value, &sensor.systematic_error());
        Measured { value, noise: model.noise_covariance(), tail: model.tail(sensor.tail()) }
    }

    #[test]
    fn the_update_is_that_by_one_number() {
        for (name, k, std) in [("range", 0, 0.1), ("bearing", 1, 0.02)] {
            for tail in [None, Some(4.0)] {
                let sensor = sensor(name, tail);
                let model = RangeOrBearing::of(&sensor).unwrap();
                let linear = RangeBearing { range_std_m: 0.1, bearing_std_rad: 0.02 }.linearize(POSE, PLACE.mean);
                let off = 3.0 * std;
                let mut value = [f64::NAN; 2];
                value[k] = linear.expected[k] + off;
                let (after, fit) = correct(&model, POSE, sighting(&model, &sensor, value), PLACE);
                // By hand: one row of G.
                let ([gx, gy], c) = (linear.by_landmark[k], PLACE.covariance);
                let (px, py) = (c.xx * gx + c.xy * gy, c.xy * gx + c.yy * gy);
                let variance = gx * px + gy * py;
                let s = variance + std * std;
                let normal = -0.5 * (off * off / s + s.ln() + LN_TAU);
                let excess = sensor.tail().log_excess_of(1, off * off / s);
                assert!((fit.log_likelihood - normal - excess).abs() < 1e-12, "{name}: {fit:?}");
                assert!((fit.mahalanobis_squared - off * off / s).abs() < 1e-12);
                let s = variance + std * std * sensor.tail().noise_scale_of(1, off * off / s);
                let expected = [PLACE.mean[0] + px * off / s, PLACE.mean[1] + py * off / s];
                assert!((0..2).all(|i| (after.mean[i] - expected[i]).abs() < 1e-12), "{after:?} {expected:?}");
                let less = [c.xx - px * px / s, c.xy - px * py / s, c.yy - py * py / s];
                let Symmetric2 { xx, xy, yy } = after.covariance;
                assert!([xx, xy, yy].iter().zip(less).all(|(own, by_hand)| (own - by_hand).abs() < 1e-12));
            }
        }
    }

    #[test]
    fn a_sensor_that_measures_both_has_the_bits_of_range_and_bearing() {
        let sensor = sensor("range_bearing", None);
        let (model, plain) = (RangeOrBearing::of(&sensor).unwrap(), sensor.range_bearing().unwrap());
        assert!(model.places() && model.unmeasured_extent() == 1.0);
        let measured = sighting(&model, &sensor, [5.3, 0.5]);
        assert_eq!(correct(&model, POSE, measured, PLACE), correct(&plain, POSE, measured, PLACE));
        assert_eq!(
            (model.noise(), model.linearize(POSE, PLACE.mean)),
            (plain.noise(), plain.linearize(POSE, PLACE.mean))
        );
    }

    #[test]
    fn what_is_not_measured_counts_for_nothing_and_the_extremes_hold_the_landmark() {
        for (name, k) in [("range", 0), ("bearing", 1)] {
            let sensor = sensor(name, None);
            let model = RangeOrBearing::of(&sensor).unwrap();
            let [range, bearing] = model.expected(POSE, PLACE.mean);
            let mut value = [range, bearing];
            value[1 - k] = f64::NAN;
            let measured = sighting(&model, &sensor, value);
            assert!(model.is_usable(measured.value) && !model.places());
            assert_eq!(model.completed(measured.value, [range, bearing]), [range, bearing]);
            let at = model.extremes(measured.value).map(|one| model.inverse(POSE, one));
            for axis in 0..2 {
                let low = at.iter().map(|at| at[axis]).fold(f64::INFINITY, f64::min);
                let high = at.iter().map(|at| at[axis]).fold(f64::NEG_INFINITY, f64::max);
                assert!((low..=high).contains(&PLACE.mean[axis]), "{name}: {low} to {high}");
            }
            let s =
                innovation_covariance(model.linearize(POSE, PLACE.mean).by_landmark, PLACE.covariance, measured.noise);
            assert_eq!(s.xy, 0.0);
            let fit = fit_with_tail(model.innovation(measured.value, [range, bearing]), s, measured.tail);
            assert!(fit.mahalanobis_squared < 1e-20);
        }
        assert!((RangeOrBearing::of(&sensor("bearing", None)).unwrap().unmeasured_extent() - 29.95).abs() < 1e-12);
        assert_eq!(RangeOrBearing::of(&sensor("range", None)).unwrap().unmeasured_extent(), 2.0);
        assert!(RangeOrBearing::of(&sensor("own", None)).is_err());
    }
}
