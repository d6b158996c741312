//! The filter's state as bytes.

use super::fading::Fading;
use super::given::Given;
use super::state::State;
use super::FastSlam;
use crate::error::Result;
use crate::measurement::MeasurementModel;
use crate::snapshot::{content, open, seal, Head, Holds, FADING, GIVEN_MAPS};

impl<M: MeasurementModel> FastSlam<M> {
    /// The state as bytes, from which [`FastSlam::restore`] goes on to the same bits; `note` is kept in its head.
    pub fn save(&self, note: &str) -> Result<Vec<u8>> {
        seal(
            &Head::new(&self.settings.config, self.settings.identities, note)?,
            &(&self.state, &self.state.given, &self.state.landmarks.fading),
        )
    }

    /// Takes over a state that was saved by a filter of this configuration and measurement model.
    ///
    /// **Errors:** [`Error::Input`](crate::error::Error::Input) when the bytes are no snapshot, of another format,
    /// damaged, or of another configuration; the filter is then as it was.
    pub fn restore(&mut self, snapshot: &[u8]) -> Result<()> {
        let (head, stored) = open(snapshot, Holds::Filter)?;
        head.check(&self.settings.config, self.settings.identities)?;
        let (mut state, fading) = match stored.format {
            0..GIVEN_MAPS => (content(&stored)?, self.unfaded()),
            GIVEN_MAPS..FADING => {
                let (state, given): (State, Given) = content(&stored)?;
                (State { given, ..state }, self.unfaded())
            }
            _ => {
                let (state, given, fading): (State, Given, Option<Fading>) = content(&stored)?;
                (State { given, ..state }, fading)
            }
        };
        state.landmarks.fading = fading;
        state.landmarks.set_workers(&self.workers);
        self.state = state;
        Ok(())
    }

    /// What a state begins with that knows nothing of fading.
    fn unfaded(&self) -> Option<Fading> {
        Fading::of(&self.settings.config, self.settings.identities)
    }
}
