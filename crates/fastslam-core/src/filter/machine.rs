//! The filter of one measurement model, behind calls that do not depend on it.
//!
//! What a step does is compiled where a measurement model is chosen: for the models of this library in this library, and
//! not again, perhaps without optimisation, in every crate that uses a filter.

use super::beside::Beside;
use super::engine::Engine;
use super::rounds::Progress;
use super::setup::Setups;
use super::state::State;
use super::work::Work;
use super::{beginning, estimate, imagine, propose, rejuvenation, snapshot, MapEstimate};
use crate::config::Config;
use crate::error::Result;
use crate::given::Beginning;
use crate::late::{Late, Lateness};
use crate::measurement::Placing;
use crate::motion::RowPart;
use crate::sighting::Scan;
use crate::step_info::StepInfo;
use std::sync::Arc;

/// What a filter does; [`FastSlam`](super::FastSlam) says of each call what it means.
pub(super) trait Machine: Send + Sync {
    fn config(&self) -> &Config;
    fn state(&self) -> &State;
    fn work(&self) -> &Work;
    fn lateness(&self) -> Lateness;
    fn when_late(&mut self, late: Late);
    fn begin(&mut self, beginning: &Beginning) -> Result<()>;
    fn advance(&mut self, part: &RowPart) -> Result<()>;
    fn take(&mut self, scan: Scan<'_>) -> Result<StepInfo>;
    fn rejuvenate(&mut self) -> bool;
    /// The estimate of the pose becomes that of now.
    fn predict(&mut self);
    fn map(&mut self) -> MapEstimate;
    fn save(&self, note: &str) -> Result<Vec<u8>>;
    fn restore(&mut self, snapshot: &[u8]) -> Result<()>;
    /// An independent one in the same state.
    fn copy(&self) -> Box<dyn Machine>;
}

/// A filter, and what goes on beside it.
pub(super) struct Running<M> {
    engine: Engine<M>,
    beside: Beside<M>,
}

impl<M: Placing> Running<M> {
    /// In this state.
    pub fn new(setups: Setups<M>, state: State) -> Self {
        Self { engine: Engine::new(&Arc::new(setups), state), beside: Beside::default() }
    }
}

impl<M: Placing> Machine for Running<M> {
    fn config(&self) -> &Config {
        &self.engine.setups.config
    }
    fn state(&self) -> &State {
        &self.engine.state
    }
    fn work(&self) -> &Work {
        &self.engine.work
    }
    fn lateness(&self) -> Lateness {
        self.beside.lateness()
    }
    fn when_late(&mut self, late: Late) {
        self.beside.when_late(late);
    }
    fn begin(&mut self, beginning: &Beginning) -> Result<()> {
        beginning::begin(self.engine.setups.first(), &mut self.engine.state, beginning)
    }
    fn advance(&mut self, part: &RowPart) -> Result<()> {
        self.engine.advance(part)?;
        self.beside.moved(part);
        Ok(())
    }
    fn take(&mut self, scan: Scan<'_>) -> Result<StepInfo> {
        let Self { engine, beside } = self;
        beside.take_over_when_due(engine);
        let mut info = engine.update(scan, Progress::New)?;
        beside.scanned(engine, scan, &mut info);
        Ok(info)
    }
    fn rejuvenate(&mut self) -> bool {
        let Self { engine, beside } = self;
        let has_changed = beside.take_over(engine);
        let has_drawn = rejuvenation::rejuvenate(engine.setups.first(), &mut engine.state, &mut engine.work);
        if has_drawn {
            imagine::report_errors(&mut engine.state);
        }
        has_drawn || has_changed
    }
    fn predict(&mut self) {
        let Engine { setups, state, work, .. } = &mut self.engine;
        propose::propose(setups.first(), state, &mut work.beliefs);
        estimate::estimate_beliefs(state, &work.beliefs);
        imagine::report_errors(state);
    }
    fn map(&mut self) -> MapEstimate {
        estimate::estimate_map(&self.engine.setups.first().settings, &mut self.engine.state)
    }
    fn save(&self, note: &str) -> Result<Vec<u8>> {
        snapshot::save(&self.engine, self.beside.kept(), note)
    }
    fn restore(&mut self, snapshot: &[u8]) -> Result<()> {
        let late = self.beside.late();
        (self.engine, self.beside) = snapshot::restored(&self.engine.setups, snapshot)?;
        self.beside.when_late(late);
        Ok(())
    }
    fn copy(&self) -> Box<dyn Machine> {
        let (mut engine, (gains, kept)) = (self.engine.clone(), self.beside.kept());
        let mut beside = Beside::restored(&mut engine, gains, kept);
        beside.when_late(self.beside.late());
        Box::new(Self { engine, beside })
    }
}
