//! What the particles say together: the pose and the map, with the uncertainty of the whole mixture.

use super::beliefs::Beliefs;
use super::existence::is_confirmed;
use super::given::GivenUse;
use super::landmarks::Landmarks;
use super::particles::{mixture, Particles};
use super::setup::Settings;
use super::state::State;
use crate::association::Appearance;
use crate::gaussian::Gaussian;
use crate::geometry::{Pose, Symmetric2};
use crate::given::Role;
use crate::landmark::{column, Planar};
use crate::measurement::RangeErrors;
use crate::vector::vectorized;

/// A landmark of the estimated map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MapLandmark {
    /// Running number of its creation.
    pub birth: u64,
    /// Identity, where somebody said one.
    pub identity: Option<u32>,
    /// Position in the world, metres.
    pub mean: [f64; 2],
    /// Covariance of the mixture over the particles that hold the landmark (within plus between), square metres.
    pub covariance: Symmetric2,
    /// Sightings in the best particle.
    pub sightings: u32,
    /// Whether it was seen often enough to be believed; always where identities are known.
    pub confirmed: bool,
    /// What it looks like, where that is known: the likeliest class, and the mean signature.
    pub appearance: Appearance,
    /// What became of it, where it is of the given map.
    pub given: Option<GivenUse>,
}

/// The map of the best particle, each landmark averaged over all particles that share it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MapEstimate {
    /// In the order of creation.
    pub landmarks: Vec<MapLandmark>,
    /// Scale and bias of the sensor as learned with it, each with its standard deviation where it was to be learned;
    /// nothing where neither was.
    pub range_errors: Option<RangeErrors>,
}

/// The pose as the particles stand.
pub(super) fn estimate_particles(state: &mut State) {
    let weights = &state.weights.values;
    let n = weights.len();
    let Particles { x, y, heading, .. } = &state.particles;
    let (x, y, heading) = (&x[..n], &y[..n], &heading[..n]);
    state.estimate = vectorized(
        #[inline(always)]
        || {
            mixture(
                weights,
                #[inline(always)]
                |i| (Pose::new(x[i], y[i], heading[i]), [[0.0; 3]; 3]),
            )
        },
    );
}

/// The pose as the beliefs have it.
pub(super) fn estimate_beliefs(state: &mut State, beliefs: &Beliefs) {
    state.estimate = beliefs.mixture(&state.weights.values);
}

/// The map: the landmarks that the best particle holds, each as the mixture over all particles that hold it.
pub(super) fn estimate_map(settings: &Settings, state: &mut State) -> MapEstimate {
    let best = state.particles.best();
    let slots = state.landmarks.live_slots();
    let landmarks = slots.into_iter().filter_map(|slot| map_landmark(settings, state, slot, best)).collect();
    MapEstimate { landmarks, range_errors: None }
}

/// A landmark of the map, where the best particle holds it.
fn map_landmark(settings: &Settings, state: &mut State, slot: u32, best: usize) -> Option<MapLandmark> {
    let known = state.landmarks.slot(slot)?;
    let has_names = state.landmarks.columns() > column::IDENTITY;
    let rows = state.landmarks.read(slot);
    let sightings = rows.column(column::SIGHTINGS)[best];
    if sightings == 0.0 {
        return None;
    }
    let Gaussian { mean, covariance } = Planar::mixture(&rows, &state.weights.values)?;
    let identity = if has_names {
        let mark = rows.column(column::IDENTITY)[best];
        (mark > 0.0).then_some((mark - 1.0) as u32)
    } else {
        known.identity
    };
    let confirmed = identity.is_some() || is_confirmed(settings, state.maps(), slot, sightings);
    let appearance = appearance_of(state, slot);
    let (birth, given) = (known.birth, state.given.used(known.birth));
    // Rows of fixed landmarks count no sightings.
    let fixed = given.filter(|given| given.role == Role::Fixed).map_or(0, |given| given.sighted);
    let sightings = sightings as u32 + fixed;
    Some(MapLandmark { birth, identity, mean, covariance, sightings, confirmed, appearance, given })
}

/// What a landmark looks like, over the particles that hold it.
fn appearance_of(state: &mut State, slot: u32) -> Appearance {
    let rows = state.landmarks.read(slot);
    let held = state.weights.values.iter().zip(rows.column(column::SIGHTINGS));
    let weights: Vec<f64> = held.map(|(weight, count)| if *count == 0.0 { 0.0 } else { *weight }).collect();
    let appearances = state.landmarks.appearances.as_mut();
    appearances.map_or(Appearance::default(), |appearances| appearances.estimate(slot, &weights))
}

/// The landmarks of one particle's own map: slot birth, mean and covariance.
pub(super) fn map_of(landmarks: &Landmarks, particle: usize) -> Vec<(u64, [f64; 2], Symmetric2)> {
    let mut row = vec![0.0; landmarks.columns()];
    let mut map = Vec::new();
    for slot in landmarks.live_slots() {
        if landmarks.read_row(slot, particle, &mut row) {
            let Gaussian { mean, covariance } = Planar::gaussian_of(&row);
            map.push((landmarks.birth(slot), mean, covariance));
        }
    }
    map
}
