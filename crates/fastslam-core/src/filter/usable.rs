//! Which sightings a filter can use.

use super::{Identities, Sighting, Skipped};
use crate::association::ScanSighting;
use crate::geometry::Symmetric2;
use crate::limits::{LEAST, LONGEST_M};
use crate::measurement::{Placing, Sensor};
use crate::sighting::Measured;

/// Whether a covariance is one, of a size that the sensor's own noise may have.
fn can_be_computed_with(noise: Symmetric2) -> bool {
    let sized = |variance: f64| (LEAST * LEAST..=LONGEST_M * LONGEST_M).contains(&variance);
    sized(noise.xx) && sized(noise.yy) && noise.is_positive_definite()
}

/// The sightings that can be used, as measurements; the others are counted by reason.
pub(crate) fn usable<'a, M: Placing>(
    sensor: &'a Sensor,
    identities: Identities,
    model: &'a M,
    sightings: &'a [Sighting],
    skipped: &'a mut Skipped,
) -> impl Iterator<Item = ScanSighting> + 'a {
    let (tail, error, limits) = (model.tail(sensor.tail()), sensor.systematic_error(), sensor.common());
    sightings.iter().filter_map(move |s| {
        let identity = if identities == Identities::None { None } else { s.identity };
        let value = model.corrected(s.value, &error);
        let (range, noise) = (model.range(value), s.noise.map(|noise| model.given_noise(noise)));
        if !model.is_usable(value) {
            skipped.not_finite += 1;
        } else if range < limits.min_range_m {
            skipped.too_near += 1;
        } else if range > limits.max_range_m {
            skipped.too_far += 1;
        } else if identity.is_none() && identities == Identities::All {
            skipped.without_identity += 1;
        } else if noise.is_some_and(|noise| !can_be_computed_with(noise)) {
            skipped.bad_covariance += 1;
        } else {
            let noise = noise.unwrap_or(model.noise_covariance());
            return Some(ScanSighting {
                measured: Measured { value, noise, tail },
                identity,
                appearance: s.appearance,
            });
        }
        None
    })
}
