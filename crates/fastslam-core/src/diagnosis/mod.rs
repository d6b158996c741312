//! What a filter's own sightings say about it: innovations, noise, health. Numbers only; sentences are made in Python.
//!
//! Serves the particle filter and EKF-SLAM alike and knows neither: they hand over what they predicted and what came.

pub(crate) mod by_sensor;
pub(crate) mod detectability;
pub(crate) mod health;
pub(crate) mod innovations;
pub(crate) mod kept_map;
pub(crate) mod looks;
pub(crate) mod misfits;
pub(crate) mod names;
pub(crate) mod noise;
mod revisits;
mod totals;

pub use health::{Health, HealthReason, HealthStatus};
pub use names::{NamedPlace, TwoPlaces};
pub use noise::{Noise, NoiseReport, NoiseWarning, NoiseWarnings, NOISES};
pub use revisits::Returns;
