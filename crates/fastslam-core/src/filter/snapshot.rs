//! The filter's state as bytes.

use super::beside::{Beside, Course, Gains, Kept};
use super::engine::Engine;
use super::errors::Errors;
use super::eyes::{fresh_eyes, Eyes};
use super::fading::Fading;
use super::given::Given;
use super::need::Returns;
use super::setup::Setups;
use super::state::{Drawing, State};
use crate::diagnosis::kept_map::KeptMap;
use crate::diagnosis::misfits::Lately;
use crate::error::Result;
use crate::measurement::Placing;
use crate::random::Purpose;
use crate::smoothing::Keyframes;
use crate::snapshot::{content, open, seal, Head, Holds, Stored};
use crate::snapshot::{BESIDE, ERRORS, FADING, GIVEN_MAPS, KEPT_MAPS, KEYFRAMES, RETURNS, SENSORS};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// A state with what older formats did not have, behind it; the formats before the last ended here.
#[derive(Deserialize)]
struct Former(State, Given, Option<Fading>, (Option<Returns>, Lately));

/// The same with how wrong the pose may be.
#[derive(Deserialize)]
struct WithErrors(Former, Option<Errors>);

/// The same with what the format before the last added: what is known of each sensor, and those that made the steps.
#[derive(Deserialize)]
struct WithSensors(WithErrors, (Eyes, Vec<u8>));

/// The same with what was seen lately of a kept map.
#[derive(Deserialize)]
struct WithKeptMap(WithSensors, KeptMap);

/// The same with what the last format added: which poses of the path are steps of the past.
#[derive(Deserialize)]
struct Whole(WithKeptMap, Option<Keyframes>);

/// A former state, to be written.
type FormerRef<'a> = (&'a State, &'a Given, &'a Option<Fading>, (Option<&'a Returns>, &'a Lately));

/// The same with errors, to be written.
type WithErrorsRef<'a> = (FormerRef<'a>, Option<&'a Errors>);

/// The same with what is known of each sensor and those that made the steps, to be written.
type WithSensorsRef<'a> = (WithErrorsRef<'a>, (&'a Eyes, &'a [u8]));

/// The whole, to be written.
#[derive(Serialize)]
struct WholeRef<'a>((WithSensorsRef<'a>, &'a KeptMap), Option<&'a Keyframes>);

impl<'a> WholeRef<'a> {
    fn of(state: &'a State) -> Self {
        let returns = state.rejuvenation.as_ref().map(|rejuvenation| &rejuvenation.returns);
        let lately = &state.diagnosis.watch.names.lately;
        let errors = state.rejuvenation.as_ref().map(|rejuvenation| &rejuvenation.errors);
        let sensors = state.rejuvenation.as_ref().map_or(&[][..], |rejuvenation| &rejuvenation.history.sensors);
        let former = (state, &state.given, &state.landmarks.fading, (returns, lately));
        let keyframes = state.rejuvenation.as_ref().map(|rejuvenation| &rejuvenation.history.keyframes);
        let with_sensors = ((former, errors), (&state.diagnosis.eyes, sensors));
        Self((with_sensors, state.diagnosis.watch.kept_map()), keyframes)
    }
}

/// A draw under way: how far it has come, what it has gained, draws that it has begun, and the follower.
#[derive(Deserialize)]
struct Draw<W>(Course, Gains, u32, W);

impl<W: Into<State>> Draw<W> {
    fn kept<M>(self, setups: &Setups<M>) -> Kept {
        let Self(course, gains, begun, whole) = self;
        Kept { course, gains, begun, state: ready(setups, whole.into(), Drawing::InPlace) }
    }
}

/// The state as bytes, and that of what goes on beside it, with a note in their head.
pub(super) fn save<M>(engine: &Engine<M>, (gains, draw): (Gains, Option<Kept>), note: &str) -> Result<Vec<u8>> {
    let setups = &engine.setups;
    let head = Head::new(&setups.config, setups.first().settings.identities, note)?;
    let draw = draw.as_ref().map(|kept| (kept.course, kept.gains, kept.begun, WholeRef::of(&kept.state)));
    seal(&head, &(WholeRef::of(&engine.state), gains, draw))
}

/// A filter in a state that was saved by one of this configuration.
pub(super) fn restored<M: Placing>(setups: &Arc<Setups<M>>, snapshot: &[u8]) -> Result<(Engine<M>, Beside<M>)> {
    let (head, stored) = open(snapshot, Holds::Filter)?;
    let settings = &setups.first().settings;
    head.check(&setups.config, settings.identities)?;
    // What a state begins with that knows nothing of fading.
    let unfaded = || Fading::of(&settings.config, settings.identities);
    let mut beside = (Gains::default(), None);
    let state = match stored.format {
        0..GIVEN_MAPS => with_fading(content(&stored)?, unfaded()),
        GIVEN_MAPS..FADING => {
            let (state, given): (State, Given) = content(&stored)?;
            with_fading(State { given, ..state }, unfaded())
        }
        FADING..RETURNS => {
            let (state, given, fading): (State, Given, Option<Fading>) = content(&stored)?;
            with_fading(State { given, ..state }, fading)
        }
        RETURNS..BESIDE => content::<Former>(&stored)?.into(),
        BESIDE..ERRORS => with_draw::<Former, M>(&stored, setups, &mut beside)?,
        ERRORS..SENSORS => with_draw::<WithErrors, M>(&stored, setups, &mut beside)?,
        SENSORS..KEPT_MAPS => with_draw::<WithSensors, M>(&stored, setups, &mut beside)?,
        KEPT_MAPS..KEYFRAMES => with_draw::<WithKeptMap, M>(&stored, setups, &mut beside)?,
        _ => with_draw::<Whole, M>(&stored, setups, &mut beside)?,
    };
    let mut engine = Engine::new(setups, ready(setups, state, Drawing::of(&settings.config)));
    let beside = Beside::restored(&mut engine, beside.0, beside.1);
    Ok((engine, beside))
}

/// A state, and what goes on beside it.
fn with_draw<W: Into<State> + DeserializeOwned, M: Placing>(
    stored: &Stored<'_>,
    setups: &Setups<M>,
    beside: &mut (Gains, Option<Kept>),
) -> Result<State> {
    let (whole, gains, draw): (W, Gains, Option<Draw<W>>) = content(stored)?;
    *beside = (gains, draw.map(|draw| draw.kept(setups)));
    Ok(whole.into())
}

impl From<Former> for State {
    fn from(Former(mut state, given, fading, (returns, lately)): Former) -> Self {
        state.diagnosis.watch.names.lately = lately;
        if let Some((rejuvenation, returns)) = state.rejuvenation.as_mut().zip(returns) {
            rejuvenation.returns = returns;
        }
        with_fading(State { given, ..state }, fading)
    }
}

impl From<Whole> for State {
    fn from(Whole(former, keyframes): Whole) -> Self {
        let mut state = Self::from(former);
        if let Some((rejuvenation, keyframes)) = state.rejuvenation.as_mut().zip(keyframes) {
            rejuvenation.history.keyframes = keyframes;
        }
        state
    }
}

impl From<WithKeptMap> for State {
    fn from(WithKeptMap(former, kept_map): WithKeptMap) -> Self {
        let mut state = Self::from(former);
        *state.diagnosis.watch.kept_map_mut() = kept_map;
        state
    }
}

impl From<WithSensors> for State {
    fn from(WithSensors(former, (eyes, sensors)): WithSensors) -> Self {
        let mut state = Self::from(former);
        state.diagnosis.eyes = eyes;
        if let Some(rejuvenation) = &mut state.rejuvenation {
            rejuvenation.history.sensors = sensors;
        }
        state
    }
}

impl From<WithErrors> for State {
    fn from(WithErrors(former, errors): WithErrors) -> Self {
        let mut state = Self::from(former);
        if let Some((rejuvenation, errors)) = state.rejuvenation.as_mut().zip(errors) {
            rejuvenation.errors = errors;
        }
        state
    }
}

fn with_fading(mut state: State, fading: Option<Fading>) -> State {
    state.landmarks.fading = fading;
    state
}

/// A state with what a snapshot does not hold since it follows from the configuration, or an older format did not.
fn ready<M>(setups: &Setups<M>, mut state: State, drawing: Drawing) -> State {
    let setup = setups.first();
    state.landmarks.set_workers(&setup.workers);
    let (particles, stream) = (state.particles.len(), setup.settings.random.stream(Purpose::Errors, 0));
    if state.diagnosis.eyes.is_empty() {
        state.diagnosis.eyes = fresh_eyes(setups);
    }
    if let Some(rejuvenation) = &mut state.rejuvenation {
        rejuvenation.drawing = drawing;
        if rejuvenation.errors.are_unknown() {
            rejuvenation.errors = Errors::like(&state.estimate.covariance, particles, stream);
        }
    }
    state
}
