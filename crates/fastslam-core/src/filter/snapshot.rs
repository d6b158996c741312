//! The filter's state as bytes.

use super::fading::Fading;
use super::given::Given;
use super::need::Returns;
use super::setup::{Settings, Setup};
use super::state::State;
use crate::diagnosis::misfits::Lately;
use crate::error::Result;
use crate::snapshot::{content, open, seal, Head, Holds, FADING, GIVEN_MAPS, RETURNS};

/// What a snapshot of the present format holds.
type Content = (State, Given, Option<Fading>, (Option<Returns>, Lately));

/// The state as bytes, with a note in their head.
pub(super) fn save(settings: &Settings, state: &State, note: &str) -> Result<Vec<u8>> {
    let head = Head::new(&settings.config, settings.identities, note)?;
    let lately = &state.diagnosis.watch.names.lately;
    let returns = state.rejuvenation.as_ref().map(|rejuvenation| &rejuvenation.returns);
    seal(&head, &(state, &state.given, &state.landmarks.fading, (returns, lately)))
}

/// A state that was saved by a filter of this configuration.
pub(super) fn restored<M>(setup: &Setup<M>, snapshot: &[u8]) -> Result<State> {
    let (head, stored) = open(snapshot, Holds::Filter)?;
    head.check(&setup.settings.config, setup.settings.identities)?;
    // What a state begins with that knows nothing of fading.
    let unfaded = || Fading::of(&setup.settings.config, setup.settings.identities);
    let (mut state, fading) = match stored.format {
        0..GIVEN_MAPS => (content(&stored)?, unfaded()),
        GIVEN_MAPS..FADING => {
            let (state, given): (State, Given) = content(&stored)?;
            (State { given, ..state }, unfaded())
        }
        FADING..RETURNS => {
            let (state, given, fading): (State, Given, Option<Fading>) = content(&stored)?;
            (State { given, ..state }, fading)
        }
        _ => {
            let (mut state, given, fading, (returns, lately)): Content = content(&stored)?;
            state.diagnosis.watch.names.lately = lately;
            if let Some((rejuvenation, returns)) = state.rejuvenation.as_mut().zip(returns) {
                rejuvenation.returns = returns;
            }
            (State { given, ..state }, fading)
        }
    };
    state.landmarks.fading = fading;
    state.landmarks.set_workers(&setup.workers);
    Ok(state)
}
