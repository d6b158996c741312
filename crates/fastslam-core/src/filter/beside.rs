//! Draws of whole paths beside the filter, so that no step waits for one.
//!
//! A step that needs a draw hands its state to a *follower*: the same filter on a thread of its own, which draws in place
//! and then takes every call that the filter has had since. `filter.rejuvenation.delay_scans` scans later the filter
//! becomes what the follower is, which is what it would be if it had drawn in place; that is put off by as many where the
//! follower has begun another draw by then. When it is depends on the calls alone: where the follower is late the filter
//! waits, unless it was told to go on ([`Late::PutOff`]), and where there are no threads the follower works when it is
//! asked for.

use super::engine::Engine;
use super::rejuvenation::draw_in_place;
use super::rounds::Progress;
use super::state::{Drawing, State};
use super::work::{Asked, Heard, Moment};
use super::StepInfo;
use crate::late::{Late, Lateness};
use crate::measurement::Placing;
use crate::motion::RowPart;
use crate::sighting::Scan;
use crate::timeline::SightingsRow;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::panic::resume_unwind;
use std::sync::mpsc::{channel, Receiver, Sender, TryRecvError};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{Builder, JoinHandle};

/// A follower that is late by so many scans is waited for, whatever was said: what it has to catch up with is kept.
const MOST_PUT_OFF: u32 = 1000;

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
    /// To give back the memory of what is not needed any more.
    Forget(Box<Follower<M>>),
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
    }

    fn scan(&mut self, scan: Scan<'_>, progress: Progress) {
        let passed_over = Gains { ignored: scan.sightings.len() as u32, ..Gains::default() };
        let gains = self.engine.update(scan, progress).map_or(passed_over, |info| Gains::of(&info));
        self.gains.add(&gains);
    }
}

/// Where a follower is between two orders, so that nobody need wait for its thread to have it.
type Home<M> = Arc<Mutex<Option<Follower<M>>>>;

/// What the thread of a follower does until no more orders can come.
fn obey<M: Placing>(home: &Home<M>, orders: Receiver<Order<M>>, hear: &Sender<Heard>) {
    for order in orders {
        // Nobody else has a lock while there are orders, and none is taken after a panic.
        let mut home = home.lock().unwrap_or_else(PoisonError::into_inner);
        match (order, home.as_mut()) {
            (Order::Take(call), Some(follower)) => follower.take(call),
            // No call, so that none is reported as done. Whoever asked may be gone.
            (Order::Copy(answer), Some(follower)) => {
                drop(answer.send(follower.clone()));
                continue;
            }
            (Order::Forget(old), _) => {
                drop(old);
                continue;
            }
            _ => continue,
        }
        drop(home);
        hear.send(Heard::Done).unwrap_or_default();
    }
}

/// What is found where a follower is asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Found {
    /// It has done all calls.
    Done,
    /// It has begun another draw.
    Drawing,
    /// It is late.
    Busy,
}

/// A follower on a thread, which ends when no more orders can come.
struct Worker<M> {
    home: Home<M>,
    orders: Sender<Order<M>>,
    thread: JoinHandle<()>,
    heard: Mutex<Receiver<Heard>>,
    /// Calls that it was given and has done, and draws that it has begun, as far as was heard.
    told: u64,
    done: u64,
    begun: u32,
}

impl<M: Placing> Worker<M> {
    /// The follower is given back where there are no threads.
    fn new(mut follower: Follower<M>) -> Result<Self, Box<Follower<M>>> {
        let ((orders, told), (hear, heard)) = (channel(), channel());
        let home: Home<M> = Arc::default();
        let (its, its_voice) = (Arc::clone(&home), hear.clone());
        let spawned = Builder::new().name("fastslam-draw".into()).spawn(move || obey(&its, told, &its_voice));
        let Ok(thread) = spawned else { return Err(Box::new(follower)) };
        let begun = follower.engine.work.draws.count;
        follower.engine.work.draws.hear = Some(hear);
        *home.lock().unwrap_or_else(PoisonError::into_inner) = Some(follower);
        Ok(Self { home, orders, thread, heard: Mutex::new(heard), told: 0, done: 0, begun })
    }

    /// Looks whether all calls are done, or more draws begun than so many. Returns whether it was waited for, too.
    fn look(&mut self, draws: u32, late: Late) -> (Found, bool) {
        let heard = self.heard.get_mut().unwrap_or_else(PoisonError::into_inner);
        let mut has_waited = false;
        while self.begun <= draws && self.done < self.told {
            let next = match heard.try_recv() {
                Err(TryRecvError::Empty) if late == Late::PutOff => return (Found::Busy, false),
                Err(TryRecvError::Empty) => {
                    has_waited = true;
                    heard.recv().ok()
                }
                next => next.ok(),
            };
            match next {
                Some(Heard::Begun) => self.begun += 1,
                Some(Heard::Done) => self.done += 1,
                // It has panicked, which is found when it is fetched.
                None => break,
            }
        }
        (if self.begun <= draws { Found::Done } else { Found::Drawing }, has_waited)
    }

    /// The follower once it has taken all calls; its thread is not waited for. A panic of that goes on here.
    fn fetch(mut self) -> Option<(Follower<M>, Sender<Order<M>>)> {
        self.look(u32::MAX, Late::Awaited);
        let Self { home, orders, thread, .. } = self;
        let Ok(mut at_home) = home.lock() else {
            drop(orders);
            thread.join().unwrap_or_else(|panic| resume_unwind(panic));
            return None;
        };
        at_home.take().map(|follower| (follower, orders))
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

    /// As [`Worker::look`].
    fn look(&mut self, draws: u32, late: Late) -> (Found, bool) {
        match self {
            Self::Thread(worker) => worker.look(draws, late),
            Self::Here(follower, calls) => {
                let has_waited = !calls.is_empty();
                while follower.engine.work.draws.count <= draws {
                    let Some(call) = calls.pop_front() else { return (Found::Done, has_waited) };
                    follower.take(call);
                }
                (Found::Drawing, has_waited)
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

    /// Lets the follower take all calls, and `exchange` what it is; returns whether there was one. Its thread gives back the
    /// memory of what is left of it.
    fn end(self, exchange: impl FnOnce(&mut Follower<M>)) -> bool {
        match self {
            Self::Thread(worker) => {
                let Some((mut follower, orders)) = worker.fetch() else { return false };
                exchange(&mut follower);
                drop(orders.send(Order::Forget(Box::new(follower))));
            }
            Self::Here(mut follower, calls) => {
                calls.into_iter().for_each(|call| follower.take(call));
                exchange(&mut follower);
            }
        }
        true
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

    /// Whether it is time to take the follower over; puts it off where that has begun another draw, or is late and need not
    /// be waited for.
    fn is_due(&mut self, delay: u32, late: Late, lateness: &mut Lateness) -> bool {
        let Course { scans, due, draws, .. } = &mut self.course;
        if *scans < *due {
            return false;
        }
        let late = if *scans < *due + MOST_PUT_OFF { late } else { Late::Awaited };
        let (found, has_waited) = self.place.look(*draws, late);
        lateness.waits += u64::from(has_waited);
        lateness.put_off += u64::from(found == Found::Busy);
        if found == Found::Drawing {
            (*due, *draws) = (*due + delay, *draws + 1);
        }
        found == Found::Done
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
    /// What to do where a follower is late, and how often that was done.
    late: Late,
    lateness: Lateness,
}

impl<M> Default for Beside<M> {
    fn default() -> Self {
        Self { under_way: None, gains: Gains::default(), late: Late::default(), lateness: Lateness::default() }
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
        Self { under_way, gains, ..Self::default() }
    }

    /// What a snapshot holds of it: what no step has told of, and the draw under way, for which it waits.
    pub fn kept(&self) -> (Gains, Option<Kept>) {
        (self.gains, self.under_way.as_ref().and_then(UnderWay::kept))
    }

    /// How often the filter has waited for a draw, or gone on without one.
    pub fn lateness(&self) -> Lateness {
        self.lateness
    }

    /// What is done where a follower is late.
    pub fn late(&self) -> Late {
        self.late
    }

    /// From here on this is done where a follower is late.
    pub fn when_late(&mut self, late: Late) {
        self.late = late;
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
        let Self { under_way, late, lateness, .. } = self;
        if under_way.as_mut().is_some_and(|draw| draw.is_due(delay_of(engine), *late, lateness)) {
            self.take_over(engine);
        }
    }

    /// Makes the filter what its follower is, if there is one; returns whether there was.
    pub fn take_over(&mut self, engine: &mut Engine<M>) -> bool {
        let Some(UnderWay { course, place }) = self.under_way.take() else { return false };
        let has_taken = place.end(|Follower { engine: Engine { state, .. }, gains }| {
            self.gains.add(&Gains { log_likelihood: gains.log_likelihood - course.log_likelihood, ..*gains });
            std::mem::swap(&mut engine.state, state);
        });
        if has_taken {
            set_drawing(&mut engine.state, Drawing::Beside);
        }
        has_taken
    }
}

fn delay_of<M>(engine: &Engine<M>) -> u32 {
    engine.setups.config.filter.rejuvenation.delay_scans
}

fn set_drawing(state: &mut State, drawing: Drawing) {
    state.rejuvenation.iter_mut().for_each(|rejuvenation| rejuvenation.drawing = drawing);
}
