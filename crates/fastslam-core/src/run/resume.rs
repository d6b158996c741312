//! A run's snapshot, and going on from it.

use super::{identities_in, Done, Run};
use crate::config::Config;
use crate::error::{Error, Result};
use crate::snapshot::{content, open, seal, Head, Holds};
use crate::timeline::LogData;
use serde::Deserialize;

/// What follows the head: checksum of the log, what was done, the filter's own snapshot.
#[derive(Deserialize)]
struct Stored(u32, Done, Vec<u8>);

impl<'a> Run<'a> {
    pub(super) fn snapshot(&self) -> Result<Vec<u8>> {
        let head = Head::of_run(self.config, identities_in(self.log))?;
        seal(&head, &(self.log.checksum(), &self.done, self.filter.save("")?))
    }

    pub(super) fn from_snapshot(config: &'a Config, log: &'a LogData, snapshot: &[u8]) -> Result<Self> {
        let mut run = Self::new(config, log)?;
        let (head, stored) = open(snapshot, Holds::Run)?;
        head.check(config, identities_in(log))?;
        let Stored(checksum, done, filter) = content(stored)?;
        if checksum != log.checksum() {
            return Err(Error::Input("the snapshot is refused: it is of a run over another log".into()));
        }
        run.filter.restore(&filter)?;
        run.timeline.by_ref().take(done.events as usize).for_each(drop);
        run.done = done;
        Ok(run)
    }
}
