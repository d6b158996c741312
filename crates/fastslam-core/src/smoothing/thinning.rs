//! A past of bounded length: of old steps some stay, as keyframes, and the others are forgotten with their sightings.
//!
//! The motions between two keyframes become one, and what was sighted in between is not known any more. So the posterior
//! gets wider and nothing in it counts twice; the path goes on having all its poses, and those between two keyframes
//! follow them.
//!
//! **Why not sums of sightings**: what a scan says, moved to a keyframe near by, carries the error of the way between,
//! and all of it the same one.

use super::history::History;
use rustc_hash::FxHashMap;
use std::ops::Range;

/// So many steps in which a landmark was sighted stay, if there were as many.
const LEAST_SIGHTINGS: u32 = 10;

impl History {
    /// Where the past has `most` steps or more, forgets some of the older ones: that leaves half as many of the latest, an
    /// eighth of the first, a quarter spread evenly over the time between, and those that landmarks need. Returns the
    /// numbers that the steps had which are left, or `None` where nothing was done.
    ///
    /// **Why the first**: the frame of the map is that of the start, and nothing but the first steps says where that was.
    pub fn thin(&mut self, most: usize) -> Option<Vec<u32>> {
        let steps = self.steps();
        if steps < most.max(self.keyframes.enough) {
            return None;
        }
        let stays = self.worth_keeping(most);
        let left: Vec<u32> = (0..steps as u32).filter(|step| stays[*step as usize]).collect();
        self.keep_places(&left);
        self.keep_steps(&stays);
        // Where landmarks need many steps they are not gone through at each step anew.
        self.keyframes.enough = left.len() + left.len() / 4;
        Some(left)
    }

    /// Which steps stay.
    fn worth_keeping(&self, most: usize) -> Vec<bool> {
        let steps = self.steps();
        let old = steps - most / 2;
        let sighted = self.births_by_step();
        let births = |step: usize| {
            let first = sighted.partition_point(|(of, _)| (*of as usize) < step);
            sighted[first..].iter().take_while(move |(of, _)| *of as usize == step).map(|(_, birth)| *birth)
        };
        let first = most / 8;
        let mut stays: Vec<bool> = (0..steps).map(|step| step < first || step >= old).collect();
        for step in self.spread_evenly(first..old, most / 4, |step| births(step).count()) {
            stays[step] = true;
        }
        let mut looks: FxHashMap<u32, u32> = FxHashMap::default();
        (0..steps).filter(|step| stays[*step]).flat_map(births).for_each(|birth| *looks.entry(birth).or_default() += 1);
        for step in (0..old).rev() {
            let needed = |birth: u32| looks.get(&birth).is_none_or(|looks| *looks < LEAST_SIGHTINGS);
            if !stays[step] && births(step).any(needed) {
                stays[step] = true;
                births(step).for_each(|birth| *looks.entry(birth).or_default() += 1);
            }
        }
        stays
    }

    /// At most so many of these steps, one in each of as many equal parts of the path: that in which most was
    /// sighted. The parts are twice, four times ... as long as they were, so that what stays now could have stayed before.
    fn spread_evenly(&self, of: Range<usize>, most: usize, sightings: impl Fn(usize) -> usize) -> Vec<usize> {
        let part = |step: usize, width: usize| self.keyframes.place(step) / width;
        let mut width = 1;
        let begins = |step: &usize, width: usize| part(*step, width) != part(*step - 1, width);
        while of.clone().skip(1).filter(|step| begins(step, width)).count() >= most.max(1) {
            width *= 2;
        }
        let mut best: Vec<usize> = Vec::new();
        for step in of {
            match best.last_mut().filter(|last| part(**last, width) == part(step, width)) {
                Some(last) if sightings(step) > sightings(*last) => *last = step,
                Some(_) => {}
                None => best.push(step),
            }
        }
        best
    }

    /// Remembers where in the path the steps are that are left.
    fn keep_places(&mut self, left: &[u32]) {
        let mut places: Vec<u32> = left.iter().map(|step| self.keyframes.place(*step as usize) as u32).collect();
        self.keyframes.forgotten += self.steps() - left.len();
        let forgotten = self.keyframes.forgotten;
        let is_plain = |(step, place): (usize, &u32)| *place as usize == step + forgotten;
        let first = places.iter().enumerate().rposition(|at| !is_plain(at)).map_or(0, |last| last + 1);
        places.truncate(first);
        self.keyframes.places = places;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pose;
    use crate::landmark::{Measured, Tail};
    use crate::measurement::{MeasurementModel, Placing, RangeBearing};
    use crate::motion::MotionGaussian;
    use crate::smoothing::{by_landmark, Effort, Graph, Trajectory};

    const MODEL: RangeBearing = RangeBearing { range_std_m: 0.1, bearing_std_rad: 0.02 };
    const MOST: usize = 100;

    /// A winding way on which each `every`-th step sights one of two landmarks, and the 13th a third one.
    fn winding(steps: usize, every: usize) -> (History, Vec<Pose>) {
        let mut history = History::new(2);
        let covariance = [[1e-4, 0.0, 0.0], [0.0, 1e-5, 0.0], [0.0, 0.0, 1e-6]];
        let (mut pose, mut path) = (Pose::default(), Vec::new());
        for step in 0..steps {
            let mean = Pose::new(0.1, 0.0, if step % 80 < 40 { 0.03 } else { -0.03 });
            history.moved(&MotionGaussian { mean, covariance });
            pose = pose.compose(mean);
            path.push(pose);
            let birth = if step == 13 { 2 } else { (step / every % 2) as u32 };
            if step % every == 0 || step == 13 {
                let place = [[3.0, 4.0], [5.0, -3.0], [1.0, 1.0]][birth as usize];
                let mut value = MODEL.expected(pose, place);
                value[0] += 0.05 * ((step % 7) as f64 - 3.0) / 3.0;
                let measured = Measured { value, noise: MODEL.noise_covariance(), tail: Tail::Gaussian };
                history.explained_alike([measured].into_iter(), &[birth]);
            }
            history.step_done(usize::from(step % 2 == 1));
        }
        (history, path)
    }

    #[test]
    fn the_latest_steps_stay_and_some_of_the_others_all_over_the_time() {
        let (mut history, _) = winding(MOST - 1, 1);
        assert_eq!(history.thin(MOST), None);
        let (mut thinned, mut longest) = (0, 0);
        for step in MOST - 1..20 * MOST {
            history.moved(&MotionGaussian { mean: Pose::new(0.1, 0.0, 0.0), ..MotionGaussian::default() });
            history.explained_alike(std::iter::empty(), &[]);
            history.step_done(0);
            longest = longest.max(history.steps());
            let Some(left) = history.thin(MOST) else { continue };
            thinned += 1;
            assert_eq!(left.len(), history.steps());
            assert!(history.steps() <= 7 * MOST / 8 + 3 * LEAST_SIGHTINGS as usize, "{}", history.steps());
            let places: Vec<usize> = (0..history.steps()).map(|step| history.keyframes.place(step)).collect();
            assert!(places.is_sorted_by(|a, b| a < b) && places.last() == Some(&step));
            let latest = places.len() - MOST / 2;
            assert_eq!(places[latest] + MOST / 2, step + 1, "the latest stay");
        }
        assert!(thinned > 10 && longest < 3 * MOST / 2, "{thinned} times, {longest} steps at most");
        // Of each eighth of the way there is something.
        let held =
            |part: usize| (0..history.steps()).any(|step| 8 * history.keyframes.place(step) / (20 * MOST) == part);
        assert!((0..8).all(held));
    }

    #[test]
    fn landmarks_that_were_seldom_sighted_are_not_forgotten() {
        let (mut history, _) = winding(4 * MOST, 1);
        let all = history.seen_by(1);
        assert!(history.thin(MOST).is_some());
        let seen = history.seen_by(1);
        assert!(seen.len() < all.len() / 4 && seen == history.seen_by(0));
        let count = |birth: u32| seen.iter().filter(|seen| seen.birth == birth).count();
        assert_eq!(count(2), 1);
        assert!(count(0) >= LEAST_SIGHTINGS as usize && count(1) >= LEAST_SIGHTINGS as usize);
        for one in &seen {
            assert_eq!(history.sensor(one.step as usize), history.keyframes.place(one.step as usize) % 2);
        }
    }

    #[test]
    fn steps_in_which_nothing_was_sighted_can_be_forgotten_at_no_loss() {
        let (whole, path) = winding(160, 8);
        let (mut thin, _) = winding(160, 8);
        let left = thin.thin(MOST).unwrap();
        assert_eq!(thin.seen_by(0).len(), whole.seen_by(0).len(), "{left:?}");
        assert!(thin.steps() < 140);
        let mode = |history: &History, poses: Vec<Pose>| {
            let effort = Effort::any();
            let mut graph = Graph::over(history, &MODEL, by_landmark(&history.seen_by(0), |_| true), &effort);
            graph.mountings = &[Pose { x: 0.0, y: 0.0, heading: 0.0 }; 2];
            graph.models = &[MODEL; 2];
            let guess = graph.guess(Trajectory { start: Pose::default(), poses }, |_| [0.0, 0.0]);
            graph.solve(guess).unwrap()
        };
        let exact = mode(&whole, path.clone());
        let other = mode(&thin, thin.keyframes.of(&path, thin.steps()).unwrap());
        for (a, b) in exact.solution.landmarks.iter().zip(&other.solution.landmarks) {
            assert!((a[0] - b[0]).hypot(a[1] - b[1]) < 1e-4, "{a:?} {b:?}");
        }
        // Sums of motions are linearised where odometry is: what is left is of the second order.
        let filled = thin.keyframes.fill(Pose::default(), &path, &other.solution.trajectory.poses);
        for (place, (a, b)) in exact.solution.trajectory.poses.iter().zip(&filled).enumerate() {
            assert!((a.x - b.x).hypot(a.y - b.y) < 3e-3, "{place}: {a:?} {b:?}");
        }
    }

    #[test]
    fn a_path_that_is_moved_as_one_keeps_its_shape() {
        let (mut history, path) = winding(4 * MOST, 1);
        history.thin(MOST).unwrap();
        let keyframes = &history.keyframes;
        let off = Pose::new(3.0, -1.0, 0.7);
        let moved: Vec<Pose> =
            keyframes.of(&path, history.steps()).unwrap().into_iter().map(|pose| off.compose(pose)).collect();
        let filled = keyframes.fill(off, &path, &moved);
        assert_eq!(filled.len(), path.len());
        let first = keyframes.place(0);
        for (pose, before) in filled.iter().zip(&path).skip(first) {
            let expected = off.compose(*before);
            assert!((pose.x - expected.x).hypot(pose.y - expected.y) < 1e-9, "{pose:?} {expected:?}");
        }
    }
}
