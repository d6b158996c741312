//! The filter's state as bytes.

use super::given::Given;
use super::state::State;
use super::FastSlam;
use crate::error::Result;
use crate::measurement::MeasurementModel;
use crate::snapshot::{content, open, seal, Head, Holds};

impl<M: MeasurementModel> FastSlam<M> {
    /// The state as bytes, from which [`FastSlam::restore`] goes on to the same bits; `note` is kept in its head.
    pub fn save(&self, note: &str) -> Result<Vec<u8>> {
        seal(&Head::new(&self.settings.config, self.settings.identities, note)?, &(&self.state, &self.state.given))
    }

    /// Takes over a state that was saved by a filter of this configuration and measurement model.
    ///
    /// **Errors:** [`Error::Input`](crate::error::Error::Input) when the bytes are no snapshot, of another format,
    /// damaged, or of another configuration; the filter is then as it was.
    pub fn restore(&mut self, snapshot: &[u8]) -> Result<()> {
        let (head, stored) = open(snapshot, Holds::Filter)?;
        head.check(&self.settings.config, self.settings.identities)?;
        let mut state = if stored.knows_given_maps {
            let (state, given): (State, Given) = content(&stored)?;
            State { given, ..state }
        } else {
            content(&stored)?
        };
        state.landmarks.set_workers(&self.workers);
        self.state = state;
        Ok(())
    }
}
