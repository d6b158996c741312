//! What the innovations say of the configured noise, as data; Python makes sentences of it.

use fastslam_core::diagnosis::{Noise, NoiseReport, NoiseWarnings, TwoPlaces, NOISES};
use fastslam_core::motion::Motion;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};

/// What a noise is called, the keys that set it, and the power of a standard deviation that these are.
fn keys_of(noise: Noise, motion: &Motion) -> Option<(&'static str, Vec<String>, u8)> {
    match noise {
        Noise::Range => Some(("range", vec!["sensor.range_std_m".into()], 1)),
        Noise::Bearing => Some(("bearing", vec!["sensor.bearing_std_rad".into()], 1)),
        Noise::Motion(k) => motion.noises().get(k).map(|noise| {
            let keys = noise.keys.iter().map(|key| format!("motion.{key}")).collect();
            (noise.what, keys, noise.power)
        }),
        Noise::All => None,
    }
}

/// A list of dictionaries: `what` and `keys` (None and empty where the log does not tell which), `power`, `std_factor`,
/// `nis`, `nis_band`.
pub fn warnings<'py>(py: Python<'py>, warnings: &NoiseWarnings, motion: &Motion) -> PyResult<Bound<'py, PyList>> {
    let list = PyList::empty(py);
    for warning in warnings.iter() {
        let dict = PyDict::new(py);
        let (what, keys, power) = match keys_of(warning.noise, motion) {
            Some((what, keys, power)) => (Some(what), keys, power),
            None => (None, Vec::new(), 1),
        };
        dict.set_item("what", what)?;
        dict.set_item("keys", keys)?;
        dict.set_item("power", power)?;
        dict.set_item("std_factor", warning.std_factor)?;
        dict.set_item("nis", warning.nis)?;
        dict.set_item("nis_band", (warning.band[0], warning.band[1]))?;
        list.append(dict)?;
    }
    Ok(list)
}

/// The figures behind the warnings of a run. `std_factors`: first key of each noise to (factor, low, high), only of
/// those that the log tells of.
pub fn report<'py>(py: Python<'py>, noise: &NoiseReport, motion: &Motion) -> PyResult<Bound<'py, PyDict>> {
    let dict = PyDict::new(py);
    dict.set_item("scans", noise.scans)?;
    dict.set_item("sightings", noise.sightings)?;
    dict.set_item("nis", noise.nis)?;
    dict.set_item("nis_band", (noise.band[0], noise.band[1]))?;
    dict.set_item("range_nis", noise.of_component[0])?;
    dict.set_item("bearing_nis", noise.of_component[1])?;
    dict.set_item("correlated_scans", noise.correlated_scans)?;
    let factors = PyDict::new(py);
    for (k, found) in noise.std_factors.iter().enumerate().take(NOISES) {
        let (Some(factor), Some((_, keys, _))) = (found, keys_of(Noise::EACH[k], motion)) else { continue };
        factors.set_item(&keys[0], (factor[0], factor[1], factor[2]))?;
    }
    dict.set_item("std_factors", factors)?;
    Ok(dict)
}

/// Names that were seen at two places: (identity, x, y, sightings, x, y, sightings) with the place that the map has first.
pub fn two_places(found: &[TwoPlaces]) -> Vec<(u32, f64, f64, u32, f64, f64, u32)> {
    let row = |two: &TwoPlaces| {
        let ([x, y], [u, v]) = (two.held.position_m, two.other.position_m);
        (two.identity, x, y, two.held.sightings, u, v, two.other.sightings)
    };
    found.iter().map(row).collect()
}
