//! What is kept for each of several sensors, while one of them looks.

use serde::{Deserialize, Serialize};

/// Something for each sensor, in the order of their numbers. That of the sensor that looks is in use elsewhere.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct BySensor<T> {
    looking: u32,
    kept: Vec<T>,
}

impl<T> Default for BySensor<T> {
    fn default() -> Self {
        Self { looking: 0, kept: Vec::new() }
    }
}

impl<T> BySensor<T> {
    /// The first sensor looks.
    pub fn new(kept: impl Iterator<Item = T>) -> Self {
        Self { looking: 0, kept: kept.collect() }
    }

    /// Whether there is nothing for any sensor.
    pub fn is_empty(&self) -> bool {
        self.kept.is_empty()
    }

    /// Lets this sensor look: `swap` exchanges what is in use with what is kept.
    pub fn turn_to(&mut self, sensor: usize, mut swap: impl FnMut(&mut T)) {
        let looking = self.looking as usize;
        if sensor == looking {
            return;
        }
        for place in [looking, sensor] {
            self.kept.get_mut(place).into_iter().for_each(&mut swap);
        }
        self.looking = sensor as u32;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_in_use_is_that_of_the_sensor_that_looks() {
        let mut in_use = "a";
        // What is kept for the first one is not its own as long as that is in use.
        let mut kept = BySensor::new(["", "b", "c"].into_iter());
        for (sensor, own) in [(0, "a"), (2, "c"), (2, "c"), (1, "b"), (0, "a"), (2, "c"), (1, "b"), (0, "a")] {
            kept.turn_to(sensor, |other| std::mem::swap(&mut in_use, other));
            assert_eq!(in_use, own, "sensor {sensor}");
        }
    }
}
