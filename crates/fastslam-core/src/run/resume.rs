//! A run's snapshot, and going on from it.

use super::{identities_in, Run};
use crate::error::{Error, Result};
use crate::sighting::Skipped;
use crate::snapshot::{content, open, seal, Head, Holds};
use crate::stream::{PathStep, StepRecord, Tally};
use serde::Deserialize;

/// What follows the head: checksum of the log, what was done, the filter's own snapshot.
#[derive(Deserialize)]
struct Stored(u32, Done, Vec<u8>);

/// What a run has done so far; with the filter all that a later step needs.
#[derive(Deserialize)]
struct Done {
    events: u64,
    steps: Vec<StepRecord>,
    path_steps: Vec<PathStep>,
    skipped: Skipped,
    repaired: u64,
}

impl<'a> Run<'a> {
    pub(super) fn snapshot(&self) -> Result<Vec<u8>> {
        let head = Head::of_run(self.config, identities_in(self.log))?;
        let Tally { events, path_steps, skipped, repaired } = self.stream.tally();
        let done = (events, &self.steps, path_steps, skipped, repaired);
        seal(&head, &(self.checksum()?, done, self.stream.save_filter()?))
    }

    /// Of the log, and of the map and the start where some are given.
    fn checksum(&self) -> Result<u32> {
        if self.beginning.is_empty() {
            return Ok(self.log.checksum());
        }
        let bytes = postcard::to_allocvec(self.beginning).map_err(|e| Error::Input(format!("the map: {e}")))?;
        Ok(self.log.checksum() ^ crc32fast::hash(&bytes))
    }

    /// Where the run was of which this is a snapshot.
    pub(super) fn resumed(mut self, snapshot: &[u8]) -> Result<Self> {
        let (head, stored) = open(snapshot, Holds::Run)?;
        head.check(self.config, identities_in(self.log))?;
        let Stored(checksum, done, filter) = content(&stored)?;
        if checksum != self.checksum()? {
            return Err(Error::Input("the snapshot is refused: it is of a run over another log, map or start".into()));
        }
        let Done { events, steps, path_steps, skipped, repaired } = done;
        self.stream.go_to(Tally { events, path_steps, skipped, repaired }, &filter, &mut self.rows)?;
        self.steps = steps;
        Ok(self)
    }
}
