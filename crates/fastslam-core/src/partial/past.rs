//! What was driven and heard so far, from which the whole path follows by least squares.

use crate::density::Tail;
use crate::geometry::Symmetric2;
use crate::motion::MotionGaussian;
use crate::normal::Matrix;
use serde::{Deserialize, Serialize};

/// The noise of a sighting.
#[derive(Clone, Copy, Debug)]
pub(super) struct Noise<const Z: usize> {
    pub covariance: Matrix<Z, Z>,
    pub tail: Tail,
}

/// A sighting without a name.
#[derive(Clone, Copy, Debug)]
pub(super) struct Reading<const Z: usize> {
    pub measured: [f64; Z],
    pub noise: Noise<Z>,
}

impl<const Z: usize> From<&Heard<Z>> for Reading<Z> {
    fn from(heard: &Heard<Z>) -> Self {
        Self { measured: heard.measured, noise: heard.noise }
    }
}

/// A sighting of a landmark that has a slot.
#[derive(Clone, Copy, Debug)]
pub(super) struct Heard<const Z: usize> {
    pub slot: usize,
    /// As reported.
    pub measured: [f64; Z],
    pub noise: Noise<Z>,
}

/// A sighting as it is kept, of one number or two.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(super) struct Kept {
    pub step: u32,
    slot: u32,
    value: [f64; 2],
    noise: Symmetric2,
    tail: Tail,
}

impl Kept {
    fn of<const Z: usize>(heard: &Heard<Z>, step: u32) -> Self {
        let (value, covariance) = (&heard.measured, &heard.noise.covariance);
        let (last, cross) = if Z > 1 { (1, covariance[0][Z - 1]) } else { (0, 0.0) };
        Self {
            step,
            slot: heard.slot as u32,
            value: [value[0], value[last]],
            noise: Symmetric2::new(covariance[0][0], cross, covariance[last][last]),
            tail: heard.noise.tail,
        }
    }

    /// The slot of its landmark.
    pub fn slot(&self) -> usize {
        self.slot as usize
    }

    /// Gives it another landmark.
    pub fn set_slot(&mut self, slot: u32) {
        self.slot = slot;
    }

    /// As it was heard.
    pub fn heard<const Z: usize>(&self) -> Heard<Z> {
        Heard {
            slot: self.slot as usize,
            measured: std::array::from_fn(|i| self.value[i]),
            noise: Noise { covariance: numbers(self.noise, std::array::from_fn(|i| i)), tail: self.tail },
        }
    }
}

/// These rows and columns, one or two.
pub(super) fn numbers<const Z: usize>(Symmetric2 { xx, xy, yy }: Symmetric2, columns: [usize; Z]) -> Matrix<Z, Z> {
    let full = [[xx, xy], [xy, yy]];
    columns.map(|a| columns.map(|b| full[a][b]))
}

/// Motions and sightings by step; a step is a pose of the path.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(super) struct Past {
    /// The motion that led to each step.
    pub motions: Vec<MotionGaussian>,
    /// In the order of time.
    pub sightings: Vec<Kept>,
}

impl Past {
    /// The sightings of the step that is about to end.
    pub fn heard<const Z: usize>(&mut self, heard: &Heard<Z>) {
        self.sightings.push(Kept::of(heard, self.motions.len() as u32));
    }

    /// Ends a step.
    pub fn step_done(&mut self, motion: MotionGaussian) {
        self.motions.push(motion);
    }

    /// Gives the last sightings the landmarks that they were taken for.
    pub fn settle(&mut self, claims: &[u32]) {
        let first = self.sightings.len() - claims.len();
        self.sightings[first..].iter_mut().zip(claims).for_each(|(kept, slot)| kept.slot = *slot);
    }

    /// Gives all sightings other landmarks.
    pub fn rename(&mut self, slot_of: impl Fn(u32) -> u32) {
        self.sightings.iter_mut().for_each(|kept| kept.slot = slot_of(kept.slot));
    }

    /// Forgets all but so many motions and sightings.
    pub fn cut(&mut self, (motions, sightings): (usize, usize)) {
        self.motions.truncate(motions);
        self.sightings.truncate(sightings);
    }

    /// Steps so far.
    pub fn steps(&self) -> usize {
        self.motions.len()
    }
}
