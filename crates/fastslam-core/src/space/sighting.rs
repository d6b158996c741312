//! What a detector reports, and what of it can be used.

use super::map::Measured;
use super::sensor::Spatial;
use super::settings::SpaceSensor;
use crate::normal::{Cholesky, Matrix, Normal};
use crate::sighting::Skipped;

/// One detection of a landmark in space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpaceSighting {
    /// In the numbers of the sensor.
    pub value: [f64; 3],
    /// Which landmark it is.
    pub identity: Option<u32>,
    /// Its covariance, where the detector gives one.
    pub noise: Option<Matrix<3, 3>>,
}

impl SpaceSighting {
    /// Of a landmark with a name, with the sensor's noise.
    pub fn named(value: [f64; 3], identity: u32) -> Self {
        Self { value, identity: Some(identity), noise: None }
    }
}

/// The usable sightings with their names; the others are counted.
pub fn usable(
    sightings: &[SpaceSighting],
    model: &impl Spatial,
    sensor: &SpaceSensor,
) -> (Vec<(u32, Measured)>, Skipped) {
    let mut skipped = Skipped::default();
    let mut out = Vec::with_capacity(sightings.len());
    for sighting in sightings {
        let noise = sighting.noise.unwrap_or_else(|| model.noise());
        let finite = sighting.value.iter().all(|v| v.is_finite());
        let point = if finite { model.inverse(sighting.value) } else { None };
        let range_m = point.map(|[x, y, z]| (x * x + y * y + z * z).sqrt()).filter(|range_m| !range_m.is_nan());
        match (sighting.identity, range_m) {
            (_, None) => skipped.not_finite += 1,
            (_, Some(range_m)) if range_m < sensor.min_range_m => skipped.too_near += 1,
            (_, Some(range_m)) if range_m > sensor.max_range_m => skipped.too_far += 1,
            (None, _) => skipped.without_identity += 1,
            _ if Cholesky::of(&noise).is_none() => skipped.bad_covariance += 1,
            (Some(identity), _) => out.push((identity, Measured { value: sighting.value, noise })),
        }
    }
    (out, skipped)
}

/// Sightings of which no two have one name: those that do are one, as sure as they are together.
///
/// z = R (R₁⁻¹ z₁ + R₂⁻¹ z₂) with R = (R₁⁻¹ + R₂⁻¹)⁻¹: a landmark that was seen twice at once is not twice as well known
/// before as it was.
pub fn merged(model: &impl Spatial, sightings: Vec<(u32, Measured)>) -> Vec<(u32, Measured)> {
    let mut out: Vec<(u32, Measured)> = Vec::with_capacity(sightings.len());
    for (identity, measured) in sightings {
        match out.iter_mut().find(|(other, _)| *other == identity) {
            Some((_, first)) => *first = both(model, first, &measured).unwrap_or(*first),
            None => out.push((identity, measured)),
        }
    }
    out
}

/// The Kalman update of one measurement by another of the same.
fn both(model: &impl Spatial, first: &Measured, second: &Measured) -> Option<Measured> {
    let identity = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let innovation = model.innovation(second.value, first.value);
    let Normal { mean, covariance } = Normal::given(&first.noise, &identity, &innovation, &second.noise)?;
    Some(Measured { value: std::array::from_fn(|i| first.value[i] + mean[i]), noise: covariance })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::space::sensor::Point;

    #[test]
    fn what_cannot_be_used_is_counted() {
        let model = Point { position_std_m: [0.1; 3] };
        let sensor = SpaceSensor { min_range_m: 0.5, max_range_m: 10.0, ..SpaceSensor::default() };
        let flat = Some([[1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 1.0]]);
        let sightings = [
            SpaceSighting::named([1.0, 0.0, 0.0], 1),
            SpaceSighting::named([f64::NAN, 0.0, 0.0], 2),
            SpaceSighting::named([0.1, 0.0, 0.0], 3),
            SpaceSighting::named([11.0, 0.0, 0.0], 4),
            SpaceSighting { identity: None, ..SpaceSighting::named([1.0, 0.0, 0.0], 5) },
            SpaceSighting { noise: flat, ..SpaceSighting::named([1.0, 0.0, 0.0], 6) },
        ];
        let (used, skipped) = usable(&sightings, &model, &sensor);
        assert_eq!(used.len(), 1);
        assert_eq!(skipped.by_reason().map(|(_, count)| count), [1; 5]);
        assert_eq!(skipped.total(), 5);
    }

    #[test]
    fn two_sightings_of_one_name_are_one() {
        let model = Point { position_std_m: [0.1; 3] };
        let of = |x: f64, variance: f64| {
            let noise = [[variance, 0.0, 0.0], [0.0, variance, 0.0], [0.0, 0.0, variance]];
            Measured { value: [x, 0.0, 1.0], noise }
        };
        let made = merged(&model, vec![(1, of(0.0, 3.0)), (2, of(5.0, 1.0)), (1, of(4.0, 1.0))]);
        assert_eq!(made.iter().map(|(name, _)| *name).collect::<Vec<_>>(), vec![1, 2]);
        // Weights 1/3 and 1: the mean is 3, the variance 3/4.
        assert!((made[0].1.value[0] - 3.0).abs() < 1e-12 && (made[0].1.noise[0][0] - 0.75).abs() < 1e-12);
    }
}
