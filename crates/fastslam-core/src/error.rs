//! Errors of the core, with the data that says what happened.

use std::fmt;

/// Settings and measurements are not larger, nor (where they must be positive) smaller than its inverse: their squares
/// and the products of these stay numbers.
pub(crate) const LARGEST_MAGNITUDE: f64 = 1e30;

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

    /// No control of a robot is larger (metres or radians, per second or for a whole increment): beyond this, angles lose
    /// their meaning.
    pub(crate) const LARGEST_CONTROL: f64 = 1e6;
    /// Thirty years: no control acts for longer.
    const LONGEST_CONTROL_S: f64 = 1e9;

    /// An error unless a control and its duration make sense.
    pub(crate) fn check_control(control: [f64; 3], dt_s: f64) -> Result<()> {
        let most = Self::LARGEST_CONTROL;
        if control.iter().all(|v| v.abs() <= most) && (0.0..=Self::LONGEST_CONTROL_S).contains(&dt_s) {
            return Ok(());
        }
        let longest = Self::LONGEST_CONTROL_S;
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

/// `value` if it is positive and of a size to compute with (1e-30 to 1e30), else an error that names `key`.
pub fn positive(key: &str, value: f64) -> Result<f64> {
    if (1.0 / LARGEST_MAGNITUDE..=LARGEST_MAGNITUDE).contains(&value) {
        Ok(value)
    } else {
        Err(Error::parameter(key, value, "a finite number above 0 (1e-30 to 1e30)"))
    }
}

/// `value` if it is not negative and of a size to compute with (0 or 1e-30 to 1e30), else an error that names `key`.
pub fn non_negative(key: &str, value: f64) -> Result<f64> {
    if value == 0.0 || (1.0 / LARGEST_MAGNITUDE..=LARGEST_MAGNITUDE).contains(&value) {
        Ok(value)
    } else {
        Err(Error::parameter(key, value, "a finite number, at least 0 (if not 0, 1e-30 to 1e30)"))
    }
}

/// `value` if it is of a size to compute with (at most 1e30), else an error that names `key`.
pub fn finite(key: &str, value: f64) -> Result<f64> {
    if value.abs() <= LARGEST_MAGNITUDE {
        Ok(value)
    } else {
        Err(Error::parameter(key, value, "a finite number (at most 1e30)"))
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
