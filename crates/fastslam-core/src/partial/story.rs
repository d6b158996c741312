//! Draws anew without names: what the likeliest particle took the sightings for becomes what all take them for, once twins are
//! one and what should have been seen and was not is gone.

use super::anew::Draws;
use super::graph::{Mode, Solution};
use super::past::{Past, Reading};
use super::place::Place;
use super::sensing::Sensing;
use super::state::{Name, Unnamed, NOTHING};
use super::PartialSlam;
use crate::diagnosis::looks::is_another_look;
use crate::error::Result;
use crate::filter::PoseEstimate;
use crate::gaussian::Gaussian;
use crate::geometry::Symmetric2;
use crate::math;
use crate::normal::Cholesky;

/// Two landmarks are no twins beyond this squared distance: χ² of two numbers at 99.9 %.
const TWINS_GATE: f64 = 13.8;
/// Two landmarks that were seen in one scan more often than in this share of the rarer one's are no twins.
const SEEN_TOGETHER: f64 = 0.05;
/// Twins that turned out to be none, in one draw.
const MOST_REFUSED: usize = 10;
/// How often the sightings of a whole log are thought over in one draw.
const MOST_THOUGHTS: usize = 3;
/// A landmark at a place was seen from two at least.
const LEAST_TO_PLACE: usize = 2;
/// A look at a landmark that is none shows something else instead so often.
const CHANCE: f64 = 0.05;
/// The most that is believed of how often a landmark in view is sighted.
const MOST_SEEN: f64 = 0.98;
/// With less than this nothing follows from a look in vain.
const LEAST_SEEN: f64 = 0.3;
/// Log-odds at which a landmark does not exist: one to a hundred.
const GONE: f64 = -4.6;
/// A landmark that is nowhere yet and was seen fewer times than this, and not in so many last scans, is forgotten.
const FORGOTTEN: (u32, usize) = (3, 25);

/// A past with decisions that a draw may change.
#[derive(Clone)]
struct Story {
    past: Past,
    /// For every slot, the landmark's number among those that take part.
    number_of: Vec<Option<usize>>,
}

/// A story with the likeliest path and map, and the covariance of newest pose, landmarks and calibration.
struct Told {
    story: Story,
    mode: Mode,
    covariance: Vec<Vec<f64>>,
}

impl Story {
    /// Steps at which each slot was seen, in order.
    fn steps(&self) -> Vec<Vec<u32>> {
        let mut steps = vec![Vec::new(); self.number_of.len()];
        for kept in &self.past.sightings {
            if let Some(own) = steps.get_mut(kept.slot()) {
                own.push(kept.step);
            }
        }
        steps
    }

    /// Slots that take part, by number.
    fn slots(&self) -> Vec<usize> {
        (0..self.number_of.len()).filter(|slot| self.number_of[*slot].is_some()).collect()
    }

    /// Slots that take part and were seen in fewer steps than this.
    fn slots_seen_less_often(&self, least: usize) -> Vec<usize> {
        let steps = self.steps();
        self.slots().into_iter().filter(|slot| steps[*slot].len() < least).collect()
    }

    /// Without a landmark: its sightings are of another one, or of nothing.
    fn without(&self, slot: usize, instead: u32) -> Self {
        let mut story = self.clone();
        story.past.rename(|own| if own == slot as u32 { instead } else { own });
        let gone = story.number_of[slot].take();
        for number in story.number_of.iter_mut().flatten() {
            *number -= usize::from(gone.is_some_and(|gone| *number > gone));
        }
        story
    }
}

impl<S: Sensing<Z>, const Z: usize> PartialSlam<S, Z> {
    /// As [`PartialSlam::draw_anew`], by what the best particle took the sightings for.
    pub(super) fn draw_decided(&mut self) -> Result<bool> {
        let best = self.state.cloud.particles.best();
        let (number_of, solution) = self.guess(best);
        if solution.poses.len() != self.state.past.steps() {
            return Ok(false);
        }
        let Some(mut told) = self.told(Story { past: self.settled(best), number_of }, solution)? else {
            return Ok(false);
        };
        let (mut merged, mut refused) = (0, Vec::new());
        while let Some(pair) = self.twins(&told, &refused) {
            match self.united(&told, pair)? {
                Some(one) => {
                    told = one;
                    merged += 1;
                }
                None => refused.push(pair),
            }
        }
        for _ in 0..MOST_THOUGHTS {
            let Some(story) = self.thought_over(&told)? else { break };
            let unseen = story.slots_seen_less_often(LEAST_TO_PLACE);
            let Some(other) = self.told_without(&unseen, (story, &told.mode.solution))? else { break };
            told = other;
        }
        let faded = self.faded(&told);
        if !faded.is_empty() {
            let Some(less) = self.told_without(&faded, (told.story, &told.mode.solution))? else { return Ok(false) };
            told = less;
        }
        let Told { story, mode, covariance } = told;
        let Some(draws) = self.draws_about(&mode, covariance) else { return Ok(false) };
        let others = self.others(&story.past, &story.number_of, &mode.solution)?;
        self.adopt_decided(&mode.solution, draws, (story, others));
        if merged > 0 {
            self.state.watch.closed();
        }
        Ok(true)
    }

    /// The past as a particle explains it.
    fn settled(&self, particle: usize) -> Past {
        let mut past = self.state.past.clone();
        if let Some(unnamed) = &self.state.unnamed {
            past.settle(&unnamed.claims[particle]);
        }
        past
    }

    /// The likeliest path with the landmarks of a story that are placed; `None` where there are none, or no solution.
    fn told(&self, mut story: Story, mut solution: Solution) -> Result<Option<Told>> {
        // Of those that the particle has placed the solution may find some that are not: these wait.
        while !solution.landmarks.is_empty() {
            let Some(mode) = self.graph(&story.past, &story.number_of).solve(solution)? else { break };
            let Some((covariance, placed)) = self.covariance(&mode) else { break };
            if placed.iter().all(|placed| *placed) {
                return Ok(Some(Told { story, mode, covariance }));
            }
            (story.number_of, solution) = super::anew::only(&story.number_of, mode.solution, &placed);
        }
        Ok(None)
    }

    /// A story without some slots, told again from a solution.
    fn told_without(&self, gone: &[usize], (mut story, solution): (Story, &Solution)) -> Result<Option<Told>> {
        let mut solution = solution.clone();
        for slot in gone {
            if let Some(number) = story.number_of[*slot] {
                solution.landmarks.remove(number);
            }
            story = story.without(*slot, NOTHING);
        }
        self.told(story, solution)
    }

    /// The pair of landmarks that is likeliest to be one: slots, the older first.
    fn twins(&self, told: &Told, refused: &[(usize, usize)]) -> Option<(usize, usize)> {
        if refused.len() >= MOST_REFUSED {
            return None;
        }
        let (slots, steps) = (told.story.slots(), told.story.steps());
        let mut best: Option<(f64, (usize, usize))> = None;
        for (b, young) in slots.iter().enumerate() {
            for (a, old) in slots[..b].iter().enumerate() {
                let pair = (*old, *young);
                let Some(evidence) = self.evidence(told, (a, b)) else { continue };
                let likelier = best.is_none_or(|(most, _)| evidence > most);
                if likelier && !refused.contains(&pair) && never_together(&steps[*old], &steps[*young]) {
                    best = Some((evidence, pair));
                }
            }
        }
        best.map(|(_, pair)| pair)
    }

    /// By how much it is likelier, in nats, that two landmarks of these numbers are one than that another one stands there; `None`
    /// where it is not.
    fn evidence(&self, told: &Told, (a, b): (usize, usize)) -> Option<f64> {
        let landmarks = &told.mode.solution.landmarks;
        let off = [landmarks[a][0] - landmarks[b][0], landmarks[a][1] - landmarks[b][1]];
        let entry = |i: usize, j: usize| {
            let at = |k: usize, d: usize| 3 + 2 * k + d;
            let c = |p: usize, q: usize| told.covariance[p][q];
            c(at(a, i), at(a, j)) + c(at(b, i), at(b, j)) - c(at(a, i), at(b, j)) - c(at(b, i), at(a, j))
        };
        let fitted = crate::gaussian::fit(off, Symmetric2::new(entry(0, 0), entry(0, 1), entry(1, 1)));
        let far_m = self.config.sensor.common().max_range_m;
        let near = |at: &&[f64; 2]| (at[0] - landmarks[a][0]).hypot(at[1] - landmarks[a][1]) < far_m;
        let density = landmarks.iter().filter(near).count() as f64 / (std::f64::consts::PI * far_m * far_m);
        let evidence = fitted.log_likelihood - math::ln(density);
        (fitted.mahalanobis_squared < TWINS_GATE && evidence > 0.0).then_some(evidence)
    }

    /// The story in which two landmarks are one, where all sightings agree to that.
    fn united(&self, told: &Told, (old, young): (usize, usize)) -> Result<Option<Told>> {
        let story = told.story.without(young, old as u32);
        let mut solution = told.mode.solution.clone();
        if let Some(number) = told.story.number_of[young] {
            solution.landmarks.remove(number);
        }
        let one = self.told(story, solution)?;
        Ok(one.filter(|one| one.mode.cost - told.mode.cost < 0.5 * TWINS_GATE))
    }

    /// The story with every sighting taken for what it shows from the likeliest path; `None` where that is what it was taken for.
    ///
    /// **Why:** a particle decides at the pose that it believes in then; once the path is known better many decisions are plain.
    fn thought_over(&self, told: &Told) -> Result<Option<Story>> {
        let (mut story, solution) = (told.story.clone(), &told.mode.solution);
        let slots = story.slots();
        let gaussian = |k: usize| {
            let own = Cholesky::of(&told.mode.information[k])?.inverse();
            let covariance = Symmetric2::new(own[0][0], own[0][1], own[1][1]);
            Some((slots[k], Gaussian { mean: solution.landmarks[k], covariance }))
        };
        let places: Vec<(usize, Gaussian)> = (0..slots.len()).filter_map(gaussian).collect();
        let mut changes = 0;
        for scan in story.past.sightings.chunk_by_mut(|a, b| a.step == b.step) {
            let pose = solution.poses[scan[0].step as usize];
            let readings: Vec<Reading<Z>> = scan.iter().map(|kept| Reading::from(&kept.heard())).collect();
            let shown = self.shown(&places, (pose, &solution.calibration), &readings)?;
            for (kept, shown) in scan.iter_mut().zip(shown) {
                // What is not placed yet keeps what nothing else explains.
                let waits = story.number_of.get(kept.slot()).is_some_and(Option::is_none);
                let slot = match shown {
                    Some(slot) => slot as u32,
                    None if waits => continue,
                    None => NOTHING,
                };
                changes += usize::from(kept.slot() != slot as usize);
                kept.set_slot(slot);
            }
        }
        Ok((changes > 0).then_some(story))
    }

    /// Slots of the landmarks that do not exist, in order.
    fn faded(&self, told: &Told) -> Vec<usize> {
        let (story, solution) = (&told.story, &told.mode.solution);
        let (steps, view) = (story.steps(), self.state.watch.view());
        let slots = story.slots();
        let mut looks = vec![[0.0_f64; 2]; slots.len()];
        let mut scans: Vec<u32> = story.past.sightings.iter().map(|kept| kept.step).collect();
        scans.dedup();
        let mut last = None;
        for step in &scans {
            let pose = solution.poses[*step as usize];
            if last.is_some_and(|last| !is_another_look(last, pose, view.far_m)) {
                continue;
            }
            last = Some(pose);
            let outlook = view.from(pose);
            for (k, slot) in slots.iter().enumerate() {
                if outlook.contains(solution.landmarks[k]) {
                    looks[k][usize::from(steps[*slot].binary_search(step).is_ok())] += 1.0;
                }
            }
        }
        let [missed, seen] = looks.iter().fold([0.0; 2], |sum, [m, s]| [sum[0] + m, sum[1] + s]);
        let share = (seen / (seen + missed).max(1.0)).min(MOST_SEEN);
        let news = [math::ln((1.0 - share) / (1.0 - CHANCE)), math::ln(share / CHANCE)];
        let is_gone = |k: usize| share > LEAST_SEEN && looks[k][0] * news[0] + looks[k][1] * news[1] < GONE;
        let lately = scans[scans.len().saturating_sub(FORGOTTEN.1)..].first().copied().unwrap_or(0);
        let is_forgotten = |slot: usize| {
            let own = &steps[slot];
            (own.len() as u32) < FORGOTTEN.0 && own.last().is_some_and(|last| *last < lately)
        };
        let gone = |slot: &usize| match story.number_of[*slot] {
            Some(k) => is_gone(k),
            None => is_forgotten(*slot),
        };
        (0..story.number_of.len()).filter(gone).collect()
    }

    /// Makes the draws the particles and a story that of all.
    fn adopt_decided(&mut self, solution: &Solution, draws: Draws, (mut story, others): (Story, Vec<Option<Place>>)) {
        let last = solution.poses[solution.poses.len() - 1];
        let Some(unnamed) = &self.state.unnamed else { return };
        let births = &unnamed.births[self.state.cloud.particles.best()];
        let stays = |slot: &usize| story.number_of[*slot].is_some() || others[*slot].is_some();
        let kept: Vec<usize> = (0..story.number_of.len()).filter(stays).collect();
        let births: Vec<u64> = kept.iter().map(|slot| births[*slot]).collect();
        let counts: Vec<u32> = story.steps().iter().map(|steps| steps.len() as u32).collect();
        let next_birth = unnamed.next_birth;
        let slot_of = |slot: u32| kept.binary_search(&(slot as usize)).map_or(NOTHING, |new| new as u32);
        story.past.rename(slot_of);
        self.state.past = story.past;
        self.state.path.replace(&solution.poses, |_| last);
        let cloud = &mut self.state.cloud;
        cloud.restart_weights();
        cloud.particles.score.fill(0.0);
        cloud.gauge = draws.gauge;
        cloud.estimate = PoseEstimate { mean: last, covariance: draws.marginal };
        cloud.names = kept.iter().map(|slot| Name { identity: NOTHING, sightings: counts[*slot] }).collect();
        for (i, (pose, placed, calibration)) in draws.draws.into_iter().enumerate() {
            cloud.particles.set_pose(i, pose);
            cloud.calibrations[i] = calibration;
            let place = |slot: &usize| match story.number_of[*slot] {
                Some(k) => Some(Place::One(placed[k])),
                None => others[*slot].clone(),
            };
            cloud.maps[i] = kept.iter().filter_map(place).collect();
        }
        let particles = cloud.particles.len();
        let births = vec![births; particles];
        self.state.unnamed = Some(Unnamed { births, claims: vec![Vec::new(); particles], next_birth });
        self.state.counters.draws += 1;
    }
}

/// Whether two landmarks were hardly ever seen in one scan.
fn never_together(a: &[u32], b: &[u32]) -> bool {
    let together = a.iter().filter(|step| b.binary_search(step).is_ok()).count();
    together as f64 <= SEEN_TOGETHER * a.len().min(b.len()) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn landmarks_of_one_scan_are_no_twins_but_for_a_mistake() {
        assert!(never_together(&[1, 2, 3], &[4, 5]));
        assert!(!never_together(&[1, 2, 4], &[4, 5]));
        let many: Vec<u32> = (0..100).collect();
        assert!(never_together(&many[..60], &many[58..]) && !never_together(&many[..60], &many[55..]));
    }
}
