//! Errors of the core, with the data that says what happened.

use crate::limits;
use std::fmt;

/// What can go wrong in the filter.
#[derive(Clone, Debug, PartialEq)]
pub enum Error {
    /// A parameter is out of range: dotted key, what was got, what is expected.
    Parameter {
        /// Dotted key of the configuration.
        key: String,
        /// What was given.
        got: String,
        /// What would be right.
        expected: String,
    },
    /// An input array is malformed.
    Input(String),
    /// All particles have zero weight.
    AllWeightsZero {
        /// Number of the step, from 0.
        step: u64,
    },
    /// A number that must be finite is not.
    NotFinite {
        /// Number of the step, from 0.
        step: u64,
        /// What it was.
        what: &'static str,
    },
    /// A covariance that must be positive definite is not: rounding, or noise settings that contradict each other.
    NotPositiveDefinite {
        /// Number of the step, from 0.
        step: u64,
        /// What it was.
        what: &'static str,
    },
}

impl Error {
    /// A parameter error.
    pub fn parameter(key: impl Into<String>, got: impl fmt::Display, expected: impl Into<String>) -> Self {
        Self::Parameter { key: key.into(), got: got.to_string(), expected: expected.into() }
    }

    /// An error unless a control and its duration make sense.
    pub(crate) fn check_control(control: [f64; 3], dt_s: f64) -> Result<()> {
        let (most, longest) = (limits::LARGEST_RATE, limits::LONGEST_S);
        if control.iter().all(|v| v.abs() <= most) && (0.0..=longest).contains(&dt_s) {
            return Ok(());
        }
        let expected = format!("expected finite numbers, at most {most:e}, and dt_s from 0 to {longest:e}");
        Err(Self::Input(format!("control {control:?} for {dt_s} s: {expected}")))
    }

    /// The same error with `prefix.` in front of the key of a parameter.
    pub fn within(self, prefix: &str) -> Self {
        match self {
            Self::Parameter { key, got, expected } => Self::Parameter { key: format!("{prefix}.{key}"), got, expected },
            other => other,
        }
    }
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Parameter { key, got, expected } => write!(f, "{key}: got {got}, expected {expected}"),
            Self::Input(message) => f.write_str(message),
            Self::AllWeightsZero { step } => {
                write!(f, "step {step}: every particle has zero weight; the noise settings contradict the log")
            }
            Self::NotFinite { step, what } => write!(f, "step {step}: {what} is not finite"),
            Self::NotPositiveDefinite { step, what } => write!(f, "step {step}: {what} is not positive definite"),
        }
    }
}

impl std::error::Error for Error {}

/// Result of the core.
pub type Result<T> = std::result::Result<T, Error>;

/// `value` if it is positive and of a size that `key` can have ([`limits`]), else an error that names the key.
pub fn positive(key: &str, value: f64) -> Result<f64> {
    let (least, most) = (limits::LEAST, limits::largest(key));
    if (least..=most).contains(&value) {
        Ok(value)
    } else {
        Err(Error::parameter(key, value, format!("a finite number above 0 ({least:e} to {most:e})")))
    }
}

/// `value` if it is not negative and 0 or of a size that `key` can have, else an error that names the key.
pub fn non_negative(key: &str, value: f64) -> Result<f64> {
    let (least, most) = (limits::LEAST, limits::largest(key));
    if value == 0.0 || (least..=most).contains(&value) {
        Ok(value)
    } else {
        Err(Error::parameter(key, value, format!("a finite number, at least 0 (if not 0, {least:e} to {most:e})")))
    }
}

/// `value` if it is other than 0 and of a size that `key` can have, with either sign, else an error that names the key.
pub fn non_zero(key: &str, value: f64) -> Result<f64> {
    let (least, most) = (limits::LEAST, limits::largest(key));
    if (least..=most).contains(&value.abs()) {
        Ok(value)
    } else {
        Err(Error::parameter(key, value, format!("a finite number other than 0 ({least:e} to {most:e} in size)")))
    }
}

/// `value` if it is of a size that `key` can have, with either sign, else an error that names the key.
pub fn finite(key: &str, value: f64) -> Result<f64> {
    at_most(key, value, limits::largest(key))
}

/// `value` if it is a coordinate in the world, metres, that can be computed with, else an error that names `key`.
pub fn coordinate(key: &str, value: f64) -> Result<f64> {
    at_most(key, value, limits::FARTHEST_M)
}

fn at_most(key: &str, value: f64, most: f64) -> Result<f64> {
    if value.abs() <= most {
        Ok(value)
    } else {
        Err(Error::parameter(key, value, format!("a finite number (at most {most:e} in size)")))
    }
}

/// `value` if it lies between 0 and 1, else an error that names `key`.
pub fn fraction(key: &str, value: f64) -> Result<f64> {
    if (0.0..=1.0).contains(&value) {
        Ok(value)
    } else {
        Err(Error::parameter(key, value, "0 to 1"))
    }
}
