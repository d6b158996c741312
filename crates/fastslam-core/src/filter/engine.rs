//! The filter by itself: what a call does to it.

use super::ordinary::take_in;
use super::propose;
use super::rejuvenation::take_back;
use super::rounds::{fill_rounds, Progress, Rounds};
use super::setup::Setups;
use super::state::State;
use super::work::{Asked, Work};
use super::StepInfo;
use crate::association::ScanSighting;
use crate::error::Result;
use crate::measurement::Placing;
use crate::motion::RowPart;
use crate::sighting::Scan;
use std::sync::Arc;

/// Particles over paths with their maps.
///
/// `state` is what a later step needs of the earlier ones, and nothing else; `work` and `rounds` are memory that is kept,
/// and what they hold counts for nothing once a step is done.
pub(super) struct Engine<M> {
    pub setups: Arc<Setups<M>>,
    pub state: State,
    pub work: Work,
    /// The sightings of a step, each identity once in each.
    rounds: Vec<Vec<ScanSighting>>,
}

impl<M> Clone for Engine<M> {
    /// In the same state, which goes on to the same bits.
    fn clone(&self) -> Self {
        Self::new(&self.setups, self.state.clone())
    }
}

impl<M> Engine<M> {
    /// In this state.
    pub fn new(setups: &Arc<Setups<M>>, state: State) -> Self {
        let work = Work::new(&setups.first().workers);
        Self { setups: Arc::clone(setups), state, work, rounds: Vec::new() }
    }
}

impl<M: Placing> Engine<M> {
    /// Moves the robot by a row of odometry, or a part of it.
    pub fn advance(&mut self, part: &RowPart) -> Result<()> {
        propose::advance(self.setups.first(), &mut self.state, part)
    }

    /// Processes all sightings of one sensor and stamp. Where that fails, the state is as it was before the scan.
    pub fn update(&mut self, scan: Scan<'_>, progress: Progress) -> Result<StepInfo> {
        let Self { setups, state, work, rounds } = self;
        setups.config.association.check_classes(scan.sightings)?;
        setups.config.check_sensor(scan.sensor)?;
        let setup = setups.of(scan.sensor);
        state.look_with(scan.sensor);
        let mut info = StepInfo { step: state.counters.steps, ..StepInfo::default() };
        let used = fill_rounds(setup, rounds, scan.sightings, &mut info.left_out.skipped);
        let scan = Rounds { stamp_s: scan.stamp_s, rounds: &mut rounds[..used], progress };
        let done = take_in(setup, state, work, scan, &mut info);
        if let Some(asked) = work.draws.asked.take_if(|_| done.is_err()) {
            take_back(state, *asked);
        }
        done.map(|()| info)
    }

    /// The draw that the last step has left to a filter beside this one.
    pub fn asked(&mut self) -> Option<Asked> {
        self.work.draws.asked.take().map(|asked| *asked)
    }
}
