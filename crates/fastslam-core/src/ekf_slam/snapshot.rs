//! The filter's state as bytes.

use super::{gazes, EkfSlam, State};
use crate::diagnosis::by_sensor::BySensor;
use crate::diagnosis::health::Gaze;
use crate::diagnosis::misfits::Lately;
use crate::error::Result;
use crate::measurement::Placing;
use crate::snapshot::{content, open, seal, Head, Holds, RETURNS, SENSORS};

impl<M: Placing> EkfSlam<M> {
    /// The state as bytes, from which [`EkfSlam::restore`] goes on to the same bits; `note` is kept in its head.
    pub fn save(&self, note: &str) -> Result<Vec<u8>> {
        let head = Head::new(&self.config, self.identities, note)?;
        seal(&head, &(&self.state, &self.state.watch.names.lately, &self.state.gazes))
    }

    /// Takes over a state that was saved by a filter of this configuration and measurement model.
    ///
    /// **Errors:** [`Error::Input`](crate::error::Error::Input) when the bytes are no snapshot, of another format,
    /// damaged, or of another configuration; the filter is then as it was.
    pub fn restore(&mut self, snapshot: &[u8]) -> Result<()> {
        let (head, stored) = open(snapshot, Holds::Filter)?;
        head.check(&self.config, self.identities)?;
        let (mut state, lately, kept): (State, Lately, BySensor<Gaze>) = match stored.format {
            0..RETURNS => (content(&stored)?, Lately::default(), gazes(&self.config)),
            RETURNS..SENSORS => {
                let (state, lately) = content(&stored)?;
                (state, lately, gazes(&self.config))
            }
            _ => content(&stored)?,
        };
        (state.watch.names.lately, state.gazes) = (lately, kept);
        self.state = state;
        Ok(())
    }
}
