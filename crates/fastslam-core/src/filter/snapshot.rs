//! The filter's state as bytes.

use super::beside::{Beside, Course, Gains, Kept};
use super::engine::Engine;
use super::errors::Errors;
use super::fading::Fading;
use super::given::Given;
use super::need::Returns;
use super::setup::Setup;
use super::state::{Drawing, State};
use crate::diagnosis::misfits::Lately;
use crate::error::Result;
use crate::measurement::Placing;
use crate::random::Purpose;
use crate::snapshot::{content, open, seal, Head, Holds, BESIDE, ERRORS, FADING, GIVEN_MAPS, RETURNS};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// A state with what older formats did not have, behind it; the formats before the last ended here.
#[derive(Deserialize)]
struct Former(State, Given, Option<Fading>, (Option<Returns>, Lately));

/// The same with what the last format added.
#[derive(Deserialize)]
struct Whole(Former, Option<Errors>);

/// The same, to be written.
#[derive(Serialize)]
struct WholeRef<'a>((&'a State, &'a Given, &'a Option<Fading>, (Option<&'a Returns>, &'a Lately)), Option<&'a Errors>);

impl<'a> WholeRef<'a> {
    fn of(state: &'a State) -> Self {
        let returns = state.rejuvenation.as_ref().map(|rejuvenation| &rejuvenation.returns);
        let lately = &state.diagnosis.watch.names.lately;
        let errors = state.rejuvenation.as_ref().map(|rejuvenation| &rejuvenation.errors);
        Self((state, &state.given, &state.landmarks.fading, (returns, lately)), errors)
    }
}

/// A draw under way: how far it has come, what it has gained, draws that it has begun, and the follower.
#[derive(Deserialize)]
struct Draw<W>(Course, Gains, u32, W);

impl<W: Into<State>> Draw<W> {
    fn kept<M>(self, setup: &Setup<M>) -> Kept {
        let Self(course, gains, begun, whole) = self;
        Kept { course, gains, begun, state: ready(setup, whole.into(), Drawing::InPlace) }
    }
}

/// The state as bytes, and that of what goes on beside it, with a note in their head.
pub(super) fn save<M>(engine: &Engine<M>, (gains, draw): (Gains, Option<Kept>), note: &str) -> Result<Vec<u8>> {
    let settings = &engine.setup.settings;
    let head = Head::new(&settings.config, settings.identities, note)?;
    let draw = draw.as_ref().map(|kept| (kept.course, kept.gains, kept.begun, WholeRef::of(&kept.state)));
    seal(&head, &(WholeRef::of(&engine.state), gains, draw))
}

/// A filter in a state that was saved by one of this configuration.
pub(super) fn restored<M: Placing>(setup: &Arc<Setup<M>>, snapshot: &[u8]) -> Result<(Engine<M>, Beside<M>)> {
    let (head, stored) = open(snapshot, Holds::Filter)?;
    let settings = &setup.settings;
    head.check(&settings.config, settings.identities)?;
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
        BESIDE..ERRORS => {
            let (former, gains, draw): (Former, Gains, Option<Draw<Former>>) = content(&stored)?;
            beside = (gains, draw.map(|draw| draw.kept(setup)));
            former.into()
        }
        _ => {
            let (whole, gains, draw): (Whole, Gains, Option<Draw<Whole>>) = content(&stored)?;
            beside = (gains, draw.map(|draw| draw.kept(setup)));
            whole.into()
        }
    };
    let mut engine = Engine::new(setup, ready(setup, state, Drawing::of(&settings.config)));
    let beside = Beside::restored(&mut engine, beside.0, beside.1);
    Ok((engine, beside))
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
    fn from(Whole(former, errors): Whole) -> Self {
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
fn ready<M>(setup: &Setup<M>, mut state: State, drawing: Drawing) -> State {
    state.landmarks.set_workers(&setup.workers);
    let (particles, stream) = (state.particles.len(), setup.settings.random.stream(Purpose::Errors, 0));
    if let Some(rejuvenation) = &mut state.rejuvenation {
        rejuvenation.drawing = drawing;
        if rejuvenation.errors.are_unknown() {
            rejuvenation.errors = Errors::like(&state.estimate.covariance, particles, stream);
        }
    }
    state
}
