//! The filter's state as bytes.

use super::{EkfSlam, State};
use crate::diagnosis::misfits::Lately;
use crate::error::Result;
use crate::measurement::Placing;
use crate::snapshot::{content, open, seal, Head, Holds, RETURNS};

impl<M: Placing> EkfSlam<M> {
    /// The state as bytes, from which [`EkfSlam::restore`] goes on to the same bits; `note` is kept in its head.
    pub fn save(&self, note: &str) -> Result<Vec<u8>> {
        seal(&Head::new(&self.config, self.identities, note)?, &(&self.state, &self.state.watch.names.lately))
    }

    /// Takes over a state that was saved by a filter of this configuration and measurement model.
    ///
    /// **Errors:** [`Error::Input`](crate::error::Error::Input) when the bytes are no snapshot, of another format,
    /// damaged, or of another configuration; the filter is then as it was.
    pub fn restore(&mut self, snapshot: &[u8]) -> Result<()> {
        let (head, stored) = open(snapshot, Holds::Filter)?;
        head.check(&self.config, self.identities)?;
        let (mut state, lately): (State, Lately) = match stored.format {
            0..RETURNS => (content(&stored)?, Lately::default()),
            _ => content(&stored)?,
        };
        state.watch.names.lately = lately;
        self.state = state;
        Ok(())
    }
}
