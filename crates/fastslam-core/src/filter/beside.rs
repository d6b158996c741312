//! Draws of whole paths beside the filter, so that no step waits for one.
//!
//! A step that needs a draw hands its state to a *follower*: the same filter on a thread of its own, which draws in place
//! and then takes every call that the filter has had since. `filter.rejuvenation.delay_scans` scans later the filter
//! becomes what the follower is, which is what it would be if it had drawn in place; that is put off by as many where the
//! follower has begun another draw by then. When it is depends on the calls alone: where the follower is late the filter
//! waits, and where there are no threads the follower works when it is asked for.

use super::engine::Engine;
use super::rejuvenation::draw_in_place;
use super::rounds::Progress;
use super::state::{Drawing, State};
use super::work::{Asked, Heard, Moment};
use super::StepInfo;
use crate::measurement::Placing;
use crate::motion::RowPart;
use crate::sighting::Scan;
use crate::timeline::SightingsRow;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::panic::resume_unwind;
use std::sync::mpsc::{channel, Receiver, SendError, Sender, TryRecvError};
use std::sync::{Mutex, PoisonError};
use std::thread::{Builder, JoinHandle};

/// What a follower has done that no step has told of yet.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub(super) struct Gains {
    rejuvenated: bool,
    /// Landmarks that went over into others in draws.
    merged: u32,
    /// Log evidence that it has found.
    log_likelihood: f64,
    /// Sightings of scans that it could not explain, and passed over.
    ignored: u32,
}

impl Gains {
    fn of(info: &StepInfo) -> Self {
        let (rejuvenated, log_likelihood) = (info.sampling.rejuvenated, info.weighing.log_likelihood);
        Self { rejuvenated, log_likelihood, ..Self::default() }
    }

    fn add(&mut self, more: &Self) {
        self.rejuvenated |= more.rejuvenated;
        self.merged += more.merged;
        self.log_likelihood += more.log_likelihood;
        self.ignored += more.ignored;
    }

    fn tell(self, info: &mut StepInfo) {
        info.sampling.rejuvenated |= self.rejuvenated;
        info.changes.merged += self.merged;
        info.weighing.log_likelihood += self.log_likelihood;
        info.left_out.ignored += self.ignored;
    }
}

/// A call of the filter.
#[derive(Clone)]
enum Call {
    Moved(RowPart),
    Scanned(SightingsRow, Progress),
    /// After a scan of this sensor.
    Drawn(usize),
}

/// What a thread is told.
enum Order<M> {
    Take(Call),
    /// To send a copy of what the follower is by then.
    Copy(Sender<Follower<M>>),
}

/// A filter that draws in place, with what it has done.
struct Follower<M> {
    engine: Engine<M>,
    gains: Gains,
}

impl<M> Clone for Follower<M> {
    fn clone(&self) -> Self {
        let mut engine = self.engine.clone();
        engine.work.draws.count = self.engine.work.draws.count;
        Self { engine, gains: self.gains }
    }
}

impl<M: Placing> Follower<M> {
    fn take(&mut self, call: Call) {
        match call {
            // The filter could follow it from the same motion.
            Call::Moved(part) => drop(self.engine.advance(&part)),
            Call::Scanned(row, progress) => self.scan(row.scan(), progress),
            Call::Drawn(sensor) => {
                let (Engine { setups, state, work, .. }, mut info) = (&mut self.engine, StepInfo::default());
                draw_in_place(setups.of(sensor), state, work, &mut info);
                self.gains.add(&Gains::of(&info));
            }
        }
        // What was merged between draws the filter has told of.
        self.gains.merged += std::mem::take(&mut self.engine.work.draws.merged);
        self.engine.work.draws.tell(Heard::Done);
    }

    fn scan(&mut self, scan: Scan<'_>, progress: Progress) {
        let passed_over = Gains { ignored: scan.sightings.len() as u32, ..Gains::default() };
        let gains = self.engine.update(scan, progress).map_or(passed_over, |info| Gains::of(&info));
        self.gains.add(&gains);
    }

    fn obey(mut self, orders: Receiver<Order<M>>) -> Self {
        for order in orders {
            match order {
                Order::Take(call) => self.take(call),
                // Whoever asked may be gone.
                Order::Copy(answer) => drop(answer.send(self.clone())),
            }
        }
        self
    }
}

/// A follower on a thread, which ends when no more orders can come.
struct Worker<M> {
    orders: Sender<Order<M>>,
    thread: JoinHandle<Option<Follower<M>>>,
    heard: Mutex<Receiver<Heard>>,
    /// Calls that it was told of and has done, and draws that it has begun, as far as was heard.
    told: u64,
    done: u64,
    begun: u32,
}

impl<M: Placing> Worker<M> {
    /// The follower is given back where there are no threads.
    fn new(mut follower: Follower<M>) -> Result<Self, Box<Follower<M>>> {
        let ((hand, handed), (orders, told)) = (channel::<Follower<M>>(), channel());
        let work = move || handed.recv().ok().map(|follower| follower.obey(told));
        let Ok(thread) = Builder::new().name("fastslam-draw".into()).spawn(work) else {
            return Err(Box::new(follower));
        };
        let (hear, heard) = channel();
        let begun = follower.engine.work.draws.count;
        follower.engine.work.draws.hear = Some(hear);
        match hand.send(follower) {
            Ok(()) => Ok(Self { orders, thread, heard: Mutex::new(heard), told: 0, done: 0, begun }),
            Err(SendError(follower)) => Err(Box::new(follower)),
        }
    }

    /// Waits until all calls are done, or more draws begun than so many. Returns whether all calls are done, and whether
    /// there was anything to wait for.
    fn wait(&mut self, draws: u32) -> (bool, bool) {
        let heard = self.heard.get_mut().unwrap_or_else(PoisonError::into_inner);
        let mut has_waited = false;
        while self.begun <= draws && self.done < self.told {
            let next = heard.try_recv().or_else(|none| {
                has_waited |= none == TryRecvError::Empty;
                heard.recv()
            });
            match next {
                Ok(Heard::Begun) => self.begun += 1,
                Ok(Heard::Done) => self.done += 1,
                // It has panicked, which is found when it is joined.
                Err(_) => break,
            }
        }
        (self.begun <= draws, has_waited)
    }
}

/// Where a follower works.
enum Place<M> {
    Thread(Worker<M>),
    /// Where there are no threads: here, once it is asked for.
    Here(Box<Follower<M>>, VecDeque<Call>),
}

impl<M: Placing> Place<M> {
    fn new(follower: Follower<M>) -> Self {
        Worker::new(follower).map_or_else(|follower| Self::Here(follower, VecDeque::new()), Self::Thread)
    }

    fn tell(&mut self, call: Call) {
        match self {
            Self::Thread(worker) => {
                worker.told += 1;
                // A thread that is gone is found when it is joined.
                drop(worker.orders.send(Order::Take(call)));
            }
            Self::Here(_, calls) => calls.push_back(call),
        }
    }

    /// As [`Worker::wait`].
    fn wait(&mut self, draws: u32) -> (bool, bool) {
        match self {
            Self::Thread(worker) => worker.wait(draws),
            Self::Here(follower, calls) => {
                let has_waited = !calls.is_empty();
                while follower.engine.work.draws.count <= draws {
                    let Some(call) = calls.pop_front() else { return (true, has_waited) };
                    follower.take(call);
                }
                (false, has_waited)
            }
        }
    }

    /// A copy of the follower once it has taken all calls; `None` when its thread is gone.
    fn copy(&self) -> Option<Follower<M>> {
        match self {
            Self::Thread(worker) => {
                let (answer, answered) = channel();
                worker.orders.send(Order::Copy(answer)).ok()?;
                answered.recv().ok()
            }
            Self::Here(follower, calls) => {
                let mut follower = Follower::clone(follower);
                calls.iter().for_each(|call| follower.take(call.clone()));
                Some(follower)
            }
        }
    }

    /// The follower once it has taken all calls. A panic of its thread goes on here.
    fn end(self) -> Option<Follower<M>> {
        match self {
            Self::Thread(Worker { orders, thread, .. }) => {
                drop(orders);
                thread.join().unwrap_or_else(|panic| resume_unwind(panic))
            }
            Self::Here(mut follower, calls) => {
                calls.into_iter().for_each(|call| follower.take(call));
                Some(*follower)
            }
        }
    }
}

/// How far a draw under way has come.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Course {
    /// Scans of the filter since the draw was asked for, that one included.
    scans: u32,
    /// Scans after which it is taken over.
    due: u32,
    /// Draws of the follower for which that was put off, the first one included.
    draws: u32,
    /// What the filter took for log evidence in scans that the follower takes too.
    log_likelihood: f64,
}

/// A draw under way.
struct UnderWay<M> {
    course: Course,
    place: Place<M>,
}

impl<M: Placing> UnderWay<M> {
    /// As a snapshot holds it; waits for the follower.
    fn kept(&self) -> Option<Kept> {
        let Follower { engine: Engine { state, work, .. }, gains } = self.place.copy()?;
        Some(Kept { course: self.course, gains, begun: work.draws.count, state })
    }

    /// Whether it is time to take the follower over; puts it off where that has begun another draw.
    fn is_due(&mut self, delay: u32, waits: &mut u64) -> bool {
        let Course { scans, due, draws, .. } = &mut self.course;
        if scans < due {
            return false;
        }
        let (is_done, has_waited) = self.place.wait(*draws);
        *waits += u64::from(has_waited);
        if !is_done {
            (*due, *draws) = (*due + delay, *draws + 1);
        }
        is_done
    }
}

/// A draw under way, without its thread.
pub(super) struct Kept {
    pub course: Course,
    pub gains: Gains,
    /// Draws that the follower has begun.
    pub begun: u32,
    /// Of the follower.
    pub state: State,
}

/// What goes on beside a filter.
pub(super) struct Beside<M> {
    under_way: Option<UnderWay<M>>,
    /// Of followers that were taken over, which no step has told of yet.
    gains: Gains,
    /// How often the filter has waited.
    waits: u64,
}

impl<M> Default for Beside<M> {
    fn default() -> Self {
        Self { under_way: None, gains: Gains::default(), waits: 0 }
    }
}

impl<M: Placing> Beside<M> {
    /// As it was when this was kept.
    pub fn restored(engine: &mut Engine<M>, gains: Gains, kept: Option<Kept>) -> Self {
        let under_way = kept.map(|Kept { course, gains, begun, state }| {
            set_drawing(&mut engine.state, Drawing::UnderWay);
            let mut follower = Follower { engine: Engine::new(&engine.setups, state), gains };
            follower.engine.work.draws.count = begun;
            UnderWay { course, place: Place::new(follower) }
        });
        Self { under_way, gains, waits: 0 }
    }

    /// What a snapshot holds of it: what no step has told of, and the draw under way, for which it waits.
    pub fn kept(&self) -> (Gains, Option<Kept>) {
        (self.gains, self.under_way.as_ref().and_then(UnderWay::kept))
    }

    /// How often the filter has waited for a draw.
    pub fn waits(&self) -> u64 {
        self.waits
    }

    /// The filter was moved.
    pub fn moved(&mut self, part: &RowPart) {
        self.under_way.iter_mut().for_each(|draw| draw.place.tell(Call::Moved(*part)));
    }

    /// The filter has taken a scan; what it left to a follower begins.
    pub fn scanned(&mut self, engine: &mut Engine<M>, scan: Scan<'_>, info: &mut StepInfo) {
        let log_likelihood = info.weighing.log_likelihood;
        let scanned = |progress: Progress| Call::Scanned(SightingsRow::from(scan), progress);
        if let Some(UnderWay { course, place }) = &mut self.under_way {
            course.scans += 1;
            course.log_likelihood += log_likelihood;
            place.tell(scanned(Progress::New));
        }
        if let Some(Asked { state, moment }) = engine.asked() {
            let (log_likelihood, first) = match moment {
                Moment::BeforeScan => (log_likelihood, scanned(Progress::Begun)),
                Moment::AfterScan => (0.0, Call::Drawn(scan.sensor)),
            };
            let course = Course { scans: 1, due: delay_of(engine), draws: 1, log_likelihood };
            let follower = Follower { engine: Engine::new(&engine.setups, state), gains: Gains::default() };
            let mut place = Place::new(follower);
            place.tell(first);
            self.under_way = Some(UnderWay { course, place });
        }
        std::mem::take(&mut self.gains).tell(info);
    }

    /// Makes the filter what its follower is, if it is time.
    pub fn take_over_when_due(&mut self, engine: &mut Engine<M>) {
        let Self { under_way, waits, .. } = self;
        if under_way.as_mut().is_some_and(|draw| draw.is_due(delay_of(engine), waits)) {
            self.take_over(engine);
        }
    }

    /// Makes the filter what its follower is, if there is one; returns whether there was.
    pub fn take_over(&mut self, engine: &mut Engine<M>) -> bool {
        let Some(UnderWay { course, place }) = self.under_way.take() else { return false };
        let Some(Follower { engine: Engine { state, .. }, gains }) = place.end() else { return false };
        self.gains.add(&Gains { log_likelihood: gains.log_likelihood - course.log_likelihood, ..gains });
        engine.state = state;
        set_drawing(&mut engine.state, Drawing::Beside);
        true
    }
}

fn delay_of<M>(engine: &Engine<M>) -> u32 {
    engine.setups.config.filter.rejuvenation.delay_scans
}

fn set_drawing(state: &mut State, drawing: Drawing) {
    state.rejuvenation.iter_mut().for_each(|rejuvenation| rejuvenation.drawing = drawing);
}
