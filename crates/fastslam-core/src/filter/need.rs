//! What the decision when to draw paths needs to remember: how far odometry may be off, what was seen when, suspects, and
//! work. `doubts.rs` decides.

use crate::geometry::{Pose, Symmetric2};
use crate::motion::MotionGaussian;
use crate::smoothing::{Drift, History, Trajectory};
use serde::{Deserialize, Serialize};

/// Work that all draws may take together, in terms of that of the filter.
const BUDGET: f64 = 2.0;
/// Fewer particles than this are taken for so many: a filter of ten needs the past as much as one of a hundred, and
/// would pay for hardly a draw.
const FEWEST_PARTICLES: usize = 100;
/// Suspects that make a draw worth while: three pairs that fit are sure, one says nothing.
const SUSPECTS: u32 = 3;
/// So many say that a part of the map is being made a second time, and a draw may cost more.
const MANY_SUSPECTS: u32 = 15;
/// Work that all draws may take together then, and where names close a loop, in terms of that of the filter.
const OVERDRAFT: f64 = 6.0;
/// Work that the draw at the end may take, in terms of that of the filter.
const AT_END: f64 = 60.0;

/// Draws that take no more than so many times this, in sightings of a particle, are done in any case: a tenth of a second.
const LEAST_WORK: f64 = 1e6;

/// What the decision when to draw needs to remember.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Need {
    pub drift: Drift,
    /// Step at which the best particle last sighted a landmark, by birth.
    pub last_seen: Vec<u32>,
    /// Since the last draw.
    pub suspects: u32,
    /// Suspects that ask for a draw.
    enough: u32,
    /// Work of the filter and of all draws, in sightings of a particle.
    work_of_filter: f64,
    work_of_draws: f64,
    /// Of the last draw, by steps.
    work_per_step: f64,
}

impl Need {
    /// Of a filter that starts here.
    pub fn new(start: Pose) -> Self {
        Self {
            drift: Drift::new(start),
            last_seen: Vec::new(),
            suspects: 0,
            enough: SUSPECTS,
            work_of_filter: 0.0,
            work_of_draws: 0.0,
            work_per_step: 0.0,
        }
    }

    /// Adds a step with a motion that led here.
    pub fn step_done(&mut self, motion: &MotionGaussian, after: Pose) {
        self.drift.extend(motion, after);
    }

    /// A landmark was sighted in the step at hand.
    pub fn sighted(&mut self, birth: u32) {
        let place = birth as usize;
        if self.last_seen.len() <= place {
            self.last_seen.resize(place + 1, 0);
        }
        self.last_seen[place] = self.drift.steps() as u32;
    }

    /// A scan of so many sightings was looked at by so many particles.
    pub fn scanned(&mut self, sightings: usize, particles: usize) {
        self.work_of_filter += ((sightings + 1) * particles.max(FEWEST_PARTICLES)) as f64;
    }

    /// A draw was done: after so much work it merged so many landmarks; the path is this.
    pub fn drawn(&mut self, work: f64, merges: &[[u32; 2]], (history, path): (&History, &Trajectory)) {
        self.drift = drift_along(history, path);
        for [younger, older] in merges.iter().map(|pair| pair.map(|birth| birth as usize)) {
            if younger.max(older) < self.last_seen.len() {
                self.last_seen[older] = self.last_seen[older].max(self.last_seen[younger]);
            }
        }
        // What does not close asks for more evidence the next time.
        self.enough = if merges.is_empty() { self.enough.saturating_add(self.enough.div_ceil(2)) } else { SUSPECTS };
        self.suspects = 0;
        self.work_of_draws += work;
        self.work_per_step = work / path.poses.len().max(1) as f64;
    }

    /// Old steps were forgotten: `step_now` says how many are left before one; this is the path over those.
    pub fn thinned(&mut self, step_now: impl Fn(usize) -> usize, (history, path): (&History, &Trajectory)) {
        self.drift = drift_along(history, path);
        let last = self.drift.steps().saturating_sub(1);
        self.last_seen.iter_mut().for_each(|step| *step = step_now(*step as usize).min(last) as u32);
    }

    /// A draw was not done, since it would have taken so much work.
    pub fn refused(&mut self, work: f64) {
        self.work_per_step = self.work_per_step.max(work / self.drift.steps().max(1) as f64);
    }

    /// Work that a single draw may take: as much as all together where a loop is sure, of a filter of some work at least.
    pub fn most_work(&self) -> f64 {
        OVERDRAFT * self.work_of_filter.max(LEAST_WORK)
    }

    /// Work that the draw at the end may take.
    pub fn most_work_at_end(&self) -> f64 {
        AT_END * self.work_of_filter.max(LEAST_WORK)
    }

    /// Whether a draw now is within the budget.
    pub fn is_affordable(&self) -> bool {
        self.costs_within(BUDGET)
    }

    fn costs_within(&self, budget: f64) -> bool {
        self.work_of_draws + self.work_per_step * self.drift.steps() as f64 <= budget * self.work_of_filter
    }

    /// The covariance of where an old landmark lies relative to the robot, if nothing but odometry related the two since
    /// it was last sighted; and how many steps ago that was.
    pub fn relation(&self, birth: u64, place: [f64; 2]) -> (Symmetric2, usize) {
        let since = self.last_seen.get(birth as usize).map_or(0, |step| *step as usize);
        (self.drift.of_place(place, since), self.drift.steps().saturating_sub(since + 1))
    }

    /// Whether a draw now is within what all may take where a loop is sure.
    pub fn is_affordable_for_sure(&self) -> bool {
        self.costs_within(OVERDRAFT)
    }

    /// Whether enough suspects ask for a draw that can be paid.
    pub fn asks(&self) -> bool {
        let many = self.suspects >= MANY_SUSPECTS && self.is_affordable_for_sure();
        self.suspects >= self.enough && (self.is_affordable() || many)
    }
}

fn drift_along(history: &History, path: &Trajectory) -> Drift {
    let mut drift = Drift::new(path.start);
    path.poses.iter().enumerate().for_each(|(step, pose)| drift.extend(history.motion(step), *pose));
    drift
}

/// What names say of drift since the last draw.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(super) struct Returns {
    /// Whether sightings were believed that show how far the robot has drifted.
    pub are_sure: bool,
    /// Whether the scan at hand shows a landmark since whose last sighting the particles have forgotten the way.
    pub are_forgotten: bool,
}

impl Returns {
    /// Whether paths must be drawn anew after the scan, and that can be paid.
    pub fn ask(&self, need: &Need) -> bool {
        (self.are_sure && need.is_affordable_for_sure()) || (self.are_forgotten && need.is_affordable())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// After a draw that cost so many times what the filter had done.
    fn after_a_draw(cost: f64) -> Need {
        let mut need = Need::new(Pose::default());
        need.scanned(9, 100);
        let path = Trajectory { start: Pose::default(), poses: Vec::new() };
        need.drawn(cost * need.work_of_filter, &[[1, 0]], (&History::new(100), &path));
        need
    }

    #[test]
    fn after_a_draw_that_would_have_cost_too_much_none_is_asked_for_until_it_can_be_paid() {
        let mut need = Need { suspects: MANY_SUSPECTS, ..after_a_draw(0.0) };
        need.step_done(&MotionGaussian::default(), Pose::default());
        assert!(need.asks() && need.is_affordable_for_sure());
        need.refused(100.0 * need.work_of_filter);
        assert!(!need.asks() && !need.is_affordable_for_sure());
        (0..20).for_each(|_| need.scanned(9, 100));
        assert!(need.asks(), "the filter has done enough since");
    }

    #[test]
    fn many_draws_that_close_nothing_ask_for_no_less_evidence() {
        let (mut need, mut before) = (after_a_draw(0.0), 0);
        for _ in 0..100 {
            assert!(need.enough >= before);
            before = need.enough;
            need.drawn(0.0, &[], (&History::new(100), &Trajectory { start: Pose::default(), poses: Vec::new() }));
        }
        assert_eq!(before, u32::MAX);
    }

    #[test]
    fn a_few_suspects_ask_within_the_budget_and_many_beyond_it() {
        let asks = |cost: f64, suspects: u32| Need { suspects, ..after_a_draw(cost) }.asks();
        assert!(asks(0.5 * BUDGET, SUSPECTS) && !asks(0.5 * BUDGET, SUSPECTS - 1));
        assert!(!asks(1.5 * BUDGET, SUSPECTS) && asks(1.5 * BUDGET, MANY_SUSPECTS));
        assert!(!asks(1.5 * OVERDRAFT, MANY_SUSPECTS));
    }
}
