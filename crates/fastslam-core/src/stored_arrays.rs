//! Nested arrays of numbers whose length is a parameter, for snapshots: a field `with = "crate::stored_arrays"`.
//!
//! **Why:** serde knows arrays of written-out lengths only, and the library for the others knows no nested ones.

use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// A number, or an array of these.
pub trait Numbers: Sized {
    /// Appends the numbers in order.
    fn append_to(&self, numbers: &mut Vec<f64>);
    /// Takes them from the front again.
    fn take_from(numbers: &mut impl Iterator<Item = f64>) -> Option<Self>;
}

impl Numbers for f64 {
    fn append_to(&self, numbers: &mut Vec<f64>) {
        numbers.push(*self);
    }

    fn take_from(numbers: &mut impl Iterator<Item = f64>) -> Option<Self> {
        numbers.next()
    }
}

impl<T: Numbers, const K: usize> Numbers for [T; K] {
    fn append_to(&self, numbers: &mut Vec<f64>) {
        self.iter().for_each(|part| part.append_to(numbers));
    }

    fn take_from(numbers: &mut impl Iterator<Item = f64>) -> Option<Self> {
        let parts: Vec<T> = (0..K).map_while(|_| T::take_from(numbers)).collect();
        parts.try_into().ok()
    }
}

/// Writes the numbers as one sequence.
pub fn serialize<A: Numbers, S: Serializer>(array: &A, serializer: S) -> Result<S::Ok, S::Error> {
    let mut numbers = Vec::new();
    array.append_to(&mut numbers);
    numbers.serialize(serializer)
}

/// Reads them again.
pub fn deserialize<'de, A: Numbers, D: Deserializer<'de>>(deserializer: D) -> Result<A, D::Error> {
    let mut numbers = Vec::deserialize(deserializer)?.into_iter();
    let array = A::take_from(&mut numbers);
    array.filter(|_| numbers.next().is_none()).ok_or_else(|| D::Error::custom("an array of another length"))
}
