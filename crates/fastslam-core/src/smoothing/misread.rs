//! Sightings whose landmark was given by a name that the rest of the past contradicts.
//!
//! One that was believed by mistake bends the path as far as its noise is small. At the mode it still stands out, with
//! those that it has bent; without the worst of them the others fall into place.

use super::graph::{Graph, Mode};
use crate::measurement::Placing;

/// Solutions at most, after the first.
const PASSES: usize = 6;
/// Sightings are left out that are as far off as so much of the worst one.
const AMONG_THE_WORST: f64 = 0.25;
/// Where more than this part of all sightings stands out, it is not the names.
const MOST_MISREAD: f64 = 0.1;

/// A sighting of the graph: its landmark, its place among that one's sightings, and its squared distance from what the
/// solution says, in standard deviations.
struct Misfit {
    landmark: usize,
    place: usize,
    distance: f64,
}

impl<M: Placing> Graph<'_, M> {
    /// The mode without the sightings whose squared distance from it exceeds `gate`, and which these are; the graph loses
    /// them. The mode as it was where they are too many, or where the others have none.
    pub fn without_misread(&mut self, mode: Mode, gate: f64) -> (Mode, Vec<u32>) {
        let (whole, sightings) = (self.landmarks.clone(), self.sightings());
        let mut left_out = Vec::new();
        let mut best = None;
        for _ in 0..PASSES {
            let misfits = self.misfits(best.as_ref().unwrap_or(&mode), gate);
            let worst = misfits.iter().map(|misfit| misfit.distance).fold(0.0, f64::max);
            if misfits.is_empty() {
                break;
            }
            for misfit in misfits.iter().rev().filter(|misfit| misfit.distance >= AMONG_THE_WORST * worst) {
                let seen = &mut self.landmarks[misfit.landmark].seen;
                // A landmark lies somewhere.
                if seen.len() > 1 {
                    left_out.push(seen.remove(misfit.place).sighting);
                }
            }
            let guess = best.as_ref().unwrap_or(&mode).solution.clone();
            let solved = (left_out.len() as f64 <= MOST_MISREAD * sightings as f64).then(|| self.solve(guess));
            let Some(solved) = solved.flatten() else {
                self.landmarks = whole;
                return (mode, Vec::new());
            };
            best = Some(solved);
        }
        (best.unwrap_or(mode), left_out)
    }

    fn sightings(&self) -> usize {
        self.landmarks.iter().map(|sights| sights.seen.len()).sum()
    }

    /// Sightings from free poses that are farther off than the gate, in the order of the graph.
    fn misfits(&self, mode: &Mode, gate: f64) -> Vec<Misfit> {
        let solution = &mode.solution;
        let mut misfits = Vec::new();
        for (landmark, sights) in self.landmarks.iter().enumerate() {
            for (place, seen) in sights.seen.iter().enumerate().filter(|(_, s)| s.step as usize >= self.first_free) {
                let at = (solution.landmarks[landmark], &sights.known);
                let distance = self.view(&solution.trajectory, at, seen).distance;
                if distance > gate {
                    misfits.push(Misfit { landmark, place, distance });
                }
            }
        }
        misfits
    }
}

#[cfg(test)]
mod tests {
    use super::super::history::NO_LANDMARK;
    use super::*;
    use crate::density::Tail;
    use crate::geometry::Pose;
    use crate::measurement::{MeasurementModel, RangeBearing};
    use crate::motion::MotionGaussian;
    use crate::sighting::Measured;
    use crate::smoothing::{by_landmark, Effort, History, Trajectory};

    const MODEL: RangeBearing = RangeBearing { range_std_m: 0.1, bearing_std_rad: 0.02 };
    const LANDMARKS: [[f64; 2]; 4] = [[3.0, 2.0], [6.0, -2.0], [9.0, 3.0], [12.0, -1.0]];

    /// A straight way past four landmarks, all seen in every step; the sightings of these numbers show something else.
    fn past(misread: &[u32]) -> (History, Trajectory) {
        let mut history = History::new(1);
        let (mut pose, mut poses) = (Pose::default(), Vec::new());
        let mean = Pose::new(0.5, 0.0, 0.0);
        let noise = MODEL.noise_covariance();
        for step in 0..20_u32 {
            history.moved(&MotionGaussian { mean, covariance: [[4e-4, 0.0, 0.0], [0.0, 1e-4, 0.0], [0.0, 0.0, 1e-4]] });
            pose = pose.compose(mean);
            poses.push(pose);
            let scan = (0..4_u32).map(|j| {
                let [range, bearing] = MODEL.expected(pose, LANDMARKS[j as usize]);
                let elsewhere = if misread.contains(&(4 * step + j)) { 4.0 } else { 0.0 };
                Measured { value: [range + elsewhere, bearing], noise, tail: Tail::Gaussian }
            });
            history.explained(scan, |_, j| j as u32);
            history.step_done(0);
        }
        (history, Trajectory { start: Pose::default(), poses })
    }

    fn left_out_of(misread: &[u32]) -> (Vec<u32>, f64, f64) {
        let (mut history, trajectory) = past(misread);
        let effort = Effort::any();
        let mut graph = Graph::over(&history, &MODEL, by_landmark(&history.seen_by(0), |_| true), &effort);
        let guess = graph.guess(trajectory, |sights| LANDMARKS[sights.birth as usize]);
        let mode = graph.solve(guess).unwrap();
        let before = mode.cost;
        let (mode, mut left_out) = graph.without_misread(mode, 49.0);
        assert_eq!(graph.sightings(), 80 - left_out.len());
        left_out.sort_unstable();
        let after = mode.cost;
        history.give(left_out.iter().map(|sighting| (*sighting, NO_LANDMARK)));
        assert_eq!(history.seen_by(0).len(), 80 - left_out.len());
        assert!(history.seen_by(0).iter().all(|seen| !left_out.contains(&seen.sighting)));
        (left_out, before, after)
    }

    #[test]
    fn just_the_misread_sightings_are_left_out() {
        let misread = [5, 38, 70];
        let (left_out, before, after) = left_out_of(&misread);
        assert_eq!(left_out, misread);
        assert!(before > 100.0 && after < 1e-3, "{before} {after}");
        assert!(left_out_of(&[]).0.is_empty());
    }

    #[test]
    fn where_much_does_not_fit_nothing_is_left_out() {
        let every_third: Vec<u32> = (0..80).step_by(3).collect();
        let (left_out, before, after) = left_out_of(&every_third);
        assert!(left_out.is_empty() && before == after, "{left_out:?}");
    }
}
