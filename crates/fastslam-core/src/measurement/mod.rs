//! Measurement models: what a sensor should see of a landmark, and how uncertain that is.
//!
//! A new model is one file with [`MeasurementModel`] implemented, and [`Placing`] or [`Births`], and one variant of [`Sensor`];
//! [`crate::testing`] has their conformance suites.

mod bearing_only;
mod cartesian;
mod model;
mod range_bearing;
mod range_only;
mod range_or_bearing;
mod sensor;
mod sensors;
mod settings;

pub use bearing_only::BearingOnly;
pub use cartesian::Cartesian;
pub use model::{birth_at, Births, Component, Linearization, MeasurementModel, Placing};
pub use range_bearing::RangeBearing;
pub use range_only::RangeOnly;
pub use range_or_bearing::RangeOrBearing;
pub(crate) use sensor::EXPECTED_OF_OWN;
pub use sensor::{BearingSensor, Common, OwnSensor, RangeBearingSensor, RangeErrors, RangeSensor, Sensor};
pub use sensors::Sensors;
pub use settings::{Mounting, SensorModel, SensorSettings, SystematicError};
