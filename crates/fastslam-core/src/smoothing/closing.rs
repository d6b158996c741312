//! Loops that were missed: landmarks of one map that are the same thing become one.
//!
//! A robot that comes back with a pose worse than it believes founds its landmarks anew. The joint posterior over path and
//! map knows better than any particle how far apart two landmarks of one thing may have got, and that those founded
//! together lie off together. A set of pairs is taken for the same things when the density of all their differences at
//! zero is high enough against that of things which lie there by chance; the set is accepted when the least-squares
//! problem, solved again with it, fits as well as it should.
//!
//! **Source:** joint compatibility (`neira2001jcbb`), here between landmarks and as a likelihood ratio.

use super::differences::{Candidate, Differences, Pair, Set};
use super::factor::{Lanes, LANES};
use super::graph::{Graph, Mode, Sights};
use super::history::Seen;
use crate::density::chi_squared_ratio;
use crate::gaussian::mahalanobis_squared;
use crate::geometry::Symmetric2;
use crate::math;
use crate::measurement::Placing;

/// Largest squared Mahalanobis distance of two landmarks that may be one, as 16 draws show it: Hotelling's T² that one
/// pair in a thousand exceeds, 2 · 16 / 15 · F(2, 15).
const LOOSE_GATE: f64 = 24.1;
/// Younger landmarks whose pairs are judged together.
const YOUNGER_AT_ONCE: usize = 10;
/// Older landmarks that a younger one is compared with.
const OLDER_EACH: usize = 6;
/// Sets are looked for so many times: what a closed loop makes sure lets others close.
pub const PASSES: usize = 8;
/// Two landmarks are two things when they were sighted together once in so many sightings of the younger (of either,
/// where loops are closed).
///
/// **Why:** not never, because a particle that takes a sighting for the wrong one of two duplicates takes another one of
/// the scan for the right one now and then.
pub const RARE: f64 = 20.0;
/// The density of landmarks is that among so many neighbours.
const NEIGHBOURS: usize = 8;

/// So many times as far as the noise says pairs may be off together where nothing closes else.
///
/// **Why:** noise is told roughly, and what errs the same way all along a loop (a wheel, a clock) is no noise. That many
/// pairs lie as one body lies elsewhere is no chance, whatever the way between says.
const FARTHER: f64 = 10.0;
/// Fewer pairs than this are not believed then: three numbers move a body.
const FEWEST_FARTHER: usize = 4;
/// Nor are pairs farther apart than this share of the way to the next landmark: a row fits on itself one further on.
const AMBIGUOUS: f64 = 0.25;

/// What it takes to close a loop.
pub struct Closing<'a> {
    /// ln of how many times likelier one thing must be than two.
    pub log_odds: f64,
    /// Whether odds far beyond these outweigh that the problem fits worse than it should: a unit of twice the cost above
    /// the limit takes one from the logarithm of the odds.
    pub odds_outweigh_misfit: bool,
    /// Added to the variance of a difference, square metres.
    pub tolerance_m2: f64,
    /// ln of how many times likelier two landmarks (named by their births, older first) look as they do if they are one
    /// thing; `None` when they cannot be.
    pub evidence: &'a dyn Fn([u32; 2]) -> Option<f64>,
}

impl<M: Placing> Graph<'_, M> {
    /// Closes the loops that the associations have missed; returns the mode with them, and the births of which landmark
    /// went over into which, in this order (younger, older).
    ///
    /// `normal` gives standard normal numbers, so many rows, new ones for each pass.
    pub fn close_loops(
        &mut self,
        mut mode: Mode,
        closing: &Closing<'_>,
        normal: impl Fn(usize, usize) -> Vec<Lanes>,
    ) -> (Mode, Vec<[u32; 2]>) {
        let mut merges = Vec::new();
        for pass in 0..PASSES {
            let deviations = self.deviations(&mode, &mut normal(mode.factor.size(), pass));
            let closed = [1.0, FARTHER].into_iter().find_map(|farther| {
                let sets = self.sets(&mode, closing, (&deviations, farther));
                // All together, or else the likeliest alone.
                let mut attempts: Vec<&[Set]> = vec![&sets];
                attempts.extend(sets.get(..1).filter(|_| sets.len() > 1));
                attempts.into_iter().find_map(|sets| self.closed(sets, &mode, closing, farther))
            });
            let Some((landmarks, new_mode, pairs)) = closed else { break };
            merges.extend(pairs.iter().map(|[older, younger]| [*younger, *older].map(|k| self.landmarks[k].birth)));
            (self.landmarks, mode) = (landmarks, new_mode);
        }
        (mode, merges)
    }

    /// The landmarks and the mode with the pairs made one; `None` when that does not fit or there are none.
    fn closed(
        &self,
        sets: &[Set],
        mode: &Mode,
        closing: &Closing<'_>,
        farther: f64,
    ) -> Option<(Vec<Sights>, Mode, Vec<Pair>)> {
        let pairs: Vec<Pair> = sets.iter().flat_map(|set| set.pairs.iter().copied()).collect();
        if pairs.is_empty() {
            return None;
        }
        let (landmarks, new_mode) = self.joined(&pairs, mode)?;
        let worse = 2.0 * (new_mode.cost - mode.cost);
        let together = (farther * farther - 1.0) * sets.len() as f64 * chi_squared_limit(3);
        let unlikely = worse - chi_squared_limit(2 * pairs.len()) - together;
        let odds: f64 = sets.iter().map(|set| set.log_odds).sum();
        let paid = closing.odds_outweigh_misfit && odds >= sets.len() as f64 * closing.log_odds + unlikely;
        (unlikely <= 0.0 || paid).then_some((landmarks, new_mode, pairs))
    }

    /// The landmarks and the mode with the younger of each pair gone over into the older.
    pub(super) fn joined(&self, pairs: &[Pair], mode: &Mode) -> Option<(Vec<Sights>, Mode)> {
        let mut landmarks = self.landmarks.clone();
        for &[older, younger] in pairs {
            let seen = std::mem::take(&mut landmarks[younger].seen);
            landmarks[older].seen.extend(seen);
            landmarks[older].seen.sort_by_key(|seen| seen.sighting);
        }
        self.solved_with(landmarks, mode)
    }

    /// The graph's landmarks with other sightings, without those of which nothing is left, and the mode then.
    pub(super) fn solved_with(&self, mut landmarks: Vec<Sights>, mode: &Mode) -> Option<(Vec<Sights>, Mode)> {
        let mut guess = mode.solution.clone();
        let mut kept = landmarks.iter().map(Sights::is_left);
        guess.landmarks.retain(|_| kept.next().unwrap_or(false));
        landmarks.retain(Sights::is_left);
        let graph = Graph { landmarks, ..*self };
        let mode = graph.solve(guess)?;
        Some((graph.landmarks, mode))
    }

    /// Sets of pairs that are likely enough the same things, the likeliest first; no landmark is in two of them. The pairs
    /// of a set may be so many times farther off together than the noise says.
    fn sets(&self, mode: &Mode, closing: &Closing<'_>, (deviations, farther): (&[Deviations], f64)) -> Vec<Set> {
        let candidates: Vec<Vec<Candidate>> = (0..self.landmarks.len())
            .map(|younger| self.candidates(younger, mode, closing, (deviations, farther)))
            .filter(|found| !found.is_empty())
            .collect();
        let groups = candidates.chunks(YOUNGER_AT_ONCE);
        let mut sets: Vec<Set> =
            groups.filter_map(|group| self.likeliest_set(&group.concat(), mode, closing, farther)).collect();
        sets.sort_by(|a, b| b.log_odds.total_cmp(&a.log_odds));
        let mut used = vec![false; self.landmarks.len()];
        sets.retain(|set| {
            let free = set.pairs.iter().flatten().all(|k| !used[*k]);
            if free {
                set.pairs.iter().flatten().for_each(|k| used[*k] = true);
            }
            free
        });
        sets
    }

    /// How far the landmarks lie from the mode in a few draws.
    pub(super) fn deviations(&self, mode: &Mode, normal: &mut [Lanes]) -> Vec<Deviations> {
        let first = self.first_landmark_variable(mode);
        let mut drawn = vec![[[0.0; LANES]; 2]; self.landmarks.len()];
        mode.factor.draw(normal, |variable, lanes| {
            if let Some(place) = variable.checked_sub(first) {
                drawn[place / 2][place % 2] = *lanes;
            }
        });
        drawn.into_iter().map(Deviations::new).collect()
    }

    /// The older landmarks that may be the same thing as this one, the nearest first.
    fn candidates(
        &self,
        younger: usize,
        mode: &Mode,
        closing: &Closing<'_>,
        (deviations, farther): (&[Deviations], f64),
    ) -> Vec<Candidate> {
        let at = &mode.solution.landmarks;
        let distance = |older: usize| {
            let apart = [0, 1].map(|axis| (at[older][axis] - at[younger][axis]) / farther);
            deviations[older].distance(&deviations[younger], apart, closing.tolerance_m2)
        };
        let mut near: Vec<(f64, usize)> =
            (0..younger).filter_map(|older| distance(older).map(|distance| (distance, older))).collect();
        near.sort_by(|a, b| a.0.total_cmp(&b.0));
        let log_density = if near.is_empty() { 0.0 } else { log_density(at, younger) };
        let candidate = |older: usize| {
            if farther > 1.0 && !is_unambiguous(at, [older, younger]) {
                return None;
            }
            let [old, young] = [older, younger].map(|k| &self.landmarks[k]);
            let evidence = (closing.evidence)([old.birth, young.birth])?;
            let apart =
                RARE * seen_together(&old.seen, &young.seen) as f64 <= old.seen.len().min(young.seen.len()) as f64;
            apart.then_some(Candidate { pair: [older, younger], log_odds: evidence - log_density })
        };
        near.into_iter().filter_map(|(_, older)| candidate(older)).take(OLDER_EACH).collect()
    }

    /// The likeliest set of these pairs without those that another likely set contradicts; `None` when it is not likely
    /// enough.
    fn likeliest_set(&self, candidates: &[Candidate], mode: &Mode, closing: &Closing<'_>, farther: f64) -> Option<Set> {
        let mut differences = self.differences(candidates, mode, closing.tolerance_m2);
        if farther > 1.0 {
            let places: Vec<[f64; 2]> = candidates.iter().map(|c| mode.solution.landmarks[c.pair[0]]).collect();
            differences = differences.with_rigid_variance(&places, farther * farther);
        }
        let grown = (0..candidates.len()).filter_map(|first| differences.grow(candidates, first));
        let mut sets: Vec<Set> = grown.filter(|set| set.log_odds > 0.0).collect();
        sets.sort_by(|a, b| b.log_odds.total_cmp(&a.log_odds));
        let mut likeliest = sets.first()?.clone();
        for rival in sets.iter().filter(|rival| rival.log_odds > sets[0].log_odds - closing.log_odds) {
            likeliest.pairs.retain(|pair| !rival.contradicts(*pair));
        }
        if likeliest.pairs.len() < sets[0].pairs.len() {
            likeliest.log_odds = differences.log_odds_of(candidates, &likeliest.pairs);
        }
        if farther > 1.0 && likeliest.pairs.len() < FEWEST_FARTHER {
            return None;
        }
        (likeliest.log_odds >= closing.log_odds + 2.0 * math::ln(farther)).then_some(likeliest)
    }

    /// The joint belief about how far the landmarks of each pair are apart.
    fn differences(&self, candidates: &[Candidate], mode: &Mode, tolerance_m2: f64) -> Differences {
        let mut landmarks: Vec<usize> = candidates.iter().flat_map(|c| c.pair).collect();
        landmarks.sort_unstable();
        landmarks.dedup();
        let first = self.first_landmark_variable(mode);
        let variables: Vec<usize> = landmarks.iter().flat_map(|k| [first + 2 * k, first + 2 * k + 1]).collect();
        let covariance = mode.factor.covariance(&variables);
        let place = |k: usize| 2 * landmarks.partition_point(|other| *other < k);
        let places: Vec<Pair> = candidates.iter().map(|c| c.pair.map(place)).collect();
        let mean = candidates.iter().map(|c| {
            let [older, younger] = c.pair.map(|k| mode.solution.landmarks[k]);
            [older[0] - younger[0], older[1] - younger[1]]
        });
        Differences::new(mean.collect(), tolerance_m2, |[p, a], [q, b]| {
            let of = |r: usize, c: usize| covariance[places[p][r] + a][places[q][c] + b];
            of(0, 0) - of(0, 1) - of(1, 0) + of(1, 1)
        })
    }

    fn first_landmark_variable(&self, mode: &Mode) -> usize {
        3 * (mode.solution.trajectory.poses.len() - self.first_free)
    }
}

/// How far a landmark lies from the mode in a few draws.
pub(super) struct Deviations {
    /// x and y of each draw, metres.
    drawn: [Lanes; 2],
    /// Root mean square over the draws, metres.
    rms_m: f64,
}

impl Deviations {
    fn new(drawn: [Lanes; 2]) -> Self {
        let squares: f64 = drawn.iter().flatten().map(|d| d * d).sum();
        Self { drawn, rms_m: (squares / LANES as f64).sqrt() }
    }

    /// How far two landmarks lie from where they should relative to each other, mean square over the draws, square metres.
    pub fn relative(&self, other: &Self) -> f64 {
        let ([ax, ay], [bx, by]) = (&self.drawn, &other.drawn);
        (0..LANES).map(|i| (ax[i] - bx[i]).powi(2) + (ay[i] - by[i]).powi(2)).sum::<f64>() / LANES as f64
    }

    /// The squared Mahalanobis distance of two landmarks that are `apart`, with the covariance of these draws; `None`
    /// beyond the gate.
    fn distance(&self, other: &Self, apart: [f64; 2], tolerance_m2: f64) -> Option<f64> {
        // No variance of the difference exceeds the square of the sum, so that most pairs need no more than this.
        let most = (self.rms_m + other.rms_m).powi(2) + tolerance_m2;
        let [x, y] = apart;
        if x * x + y * y > LOOSE_GATE * most {
            return None;
        }
        let (a, b) = (&self.drawn, &other.drawn);
        let moment = |r: usize, c: usize| {
            (0..LANES).map(|i| (a[r][i] - b[r][i]) * (a[c][i] - b[c][i])).sum::<f64>() / LANES as f64
        };
        let spread = Symmetric2::new(moment(0, 0) + tolerance_m2, moment(0, 1), moment(1, 1) + tolerance_m2);
        let distance = mahalanobis_squared(apart, spread);
        (distance <= LOOSE_GATE).then_some(distance)
    }
}

/// Whether two landmarks are far nearer to each other than the next landmark, of those before the younger, is to the older.
fn is_unambiguous(at: &[[f64; 2]], [older, younger]: Pair) -> bool {
    let squared = |k: usize| (at[k][0] - at[older][0]).powi(2) + (at[k][1] - at[older][1]).powi(2);
    let next = (0..younger).filter(|k| *k != older).map(squared).fold(f64::INFINITY, f64::min);
    squared(younger) <= AMBIGUOUS * AMBIGUOUS * next
}

/// ln of the number of landmarks per square metre around one of them.
fn log_density(at: &[[f64; 2]], around: usize) -> f64 {
    let squared = |k: usize| (at[k][0] - at[around][0]).powi(2) + (at[k][1] - at[around][1]).powi(2);
    let mut distances: Vec<f64> = (0..at.len()).map(squared).collect();
    let neighbours = NEIGHBOURS.min(at.len() - 1);
    let (_, farthest, _) = distances.select_nth_unstable_by(neighbours, f64::total_cmp);
    math::ln(neighbours as f64 / (std::f64::consts::PI * *farthest))
}

/// Scans in which both were sighted.
pub(super) fn seen_together(a: &[Seen], b: &[Seen]) -> usize {
    let mut others = b.iter().map(|seen| seen.step).peekable();
    let together = a.iter().filter(|seen| {
        while others.next_if(|step| *step < seen.step).is_some() {}
        others.peek() == Some(&seen.step)
    });
    together.count()
}

/// What a sum of squares of so many independent normal numbers stays below with 99.9 %.
fn chi_squared_limit(degrees_of_freedom: usize) -> f64 {
    let k = degrees_of_freedom as f64;
    k * chi_squared_ratio(k, 3.09)
}

#[cfg(test)]
mod tests {
    use super::super::effort::Effort;
    use super::super::graph::{by_landmark, Known, Solution};
    use super::super::history::{History, Trajectory, NO_LANDMARK};
    use super::*;
    use crate::geometry::Pose;
    use crate::landmark::{Measured, Tail};
    use crate::measurement::{MeasurementModel, RangeBearing};
    use crate::motion::MotionGaussian;
    use crate::random::{Purpose, RandomSource};

    const MODEL: RangeBearing = RangeBearing { range_std_m: 0.1, bearing_std_rad: 0.01 };
    const STEPS: usize = 80;

    /// A round through a ring of landmarks, twice, with a gyro that errs; the second round calls every landmark by a new
    /// name. Returns the past and how it looks from the odometry alone.
    fn two_rounds(landmarks: &[[f64; 2]]) -> (History, Vec<Sights>, Solution) {
        let stream = RandomSource::new(5).stream(Purpose::Simulation, 0);
        let mut history = History::new(1);
        let turn = 2.0 * std::f64::consts::TAU / STEPS as f64;
        let covariance = [[1e-4, 0.0, 0.0], [0.0, 1e-6, 0.0], [0.0, 0.0, 4e-4]];
        let (mut truth, mut dead) = (Pose::default(), Pose::default());
        let mut poses = Vec::new();
        let mut named = std::collections::HashMap::new();
        for step in 0..STEPS {
            let [a, b] = stream.normal_pair(step as u32, 0);
            let told = Pose::new(1.0, 0.0, turn);
            truth = truth.compose(Pose::new(1.0 + 0.01 * a, 0.0, turn + 0.02 * b));
            dead = dead.compose(told);
            poses.push(dead);
            history.moved(&MotionGaussian { mean: told, covariance });
            let round = step / (STEPS / 2);
            let mut scan = Vec::new();
            let mut births = Vec::new();
            for (k, at) in landmarks.iter().enumerate() {
                let value = MODEL.expected(truth, *at);
                if value[0] > 4.0 {
                    continue;
                }
                let [e, f] = stream.normal_pair(step as u32, 1 + k as u32);
                let noise = Symmetric2::new(0.01, 0.0, 1e-4);
                let value = [value[0] + 0.1 * e, value[1] + 0.01 * f];
                scan.push(Measured { value, noise, tail: Tail::Gaussian });
                let birth = (round * landmarks.len() + k) as u32;
                named.entry(birth).or_insert_with(|| MODEL.inverse(dead, value));
                births.push(birth);
            }
            history.explained_alike(scan.into_iter(), &births);
            history.step_done(0);
        }
        let sights = by_landmark(&history.seen_by(0), |birth| birth != NO_LANDMARK);
        let places = sights.iter().map(|s| named[&s.birth]).collect();
        let trajectory = Trajectory { start: Pose::default(), poses };
        (history, sights, Solution { trajectory, landmarks: places })
    }

    fn close(landmarks: &[[f64; 2]], closing: &Closing<'_>) -> (usize, Vec<[u32; 2]>) {
        let (history, sights, guess) = two_rounds(landmarks);
        let effort = Effort::any();
        let mut graph = Graph::over(&history, &MODEL, sights, &effort);
        let mode = graph.solve(guess).unwrap();
        let stream = RandomSource::new(2).stream(Purpose::Rejuvenation, 0);
        let (mode, merges) = graph.close_loops(mode, closing, |size, pass| {
            let number = |row: usize, lane: usize| stream.normal_pair((pass * LANES + lane) as u32, row as u32)[0];
            (0..size).map(|row| std::array::from_fn(|lane| number(row, lane))).collect()
        });
        assert_eq!(mode.solution.landmarks.len(), graph.landmarks.len());
        (graph.landmarks.len(), merges)
    }

    /// Twelve around the circle of the robot's way, whose radius is 40 / τ, at distances that never repeat.
    fn ring() -> Vec<[f64; 2]> {
        let center = [0.0, 40.0 / std::f64::consts::TAU];
        let around = |k: usize| {
            let (angle, radius) = (0.5 * k as f64 + 0.07 * (k * k) as f64, 6.4 + 2.0 * ((k * 7) % 5) as f64 / 4.0);
            [center[0] + radius * angle.cos(), center[1] + radius * angle.sin()]
        };
        (0..12).map(around).collect()
    }

    #[test]
    fn what_was_founded_twice_becomes_one() {
        let landmarks = ring();
        let closing =
            Closing { log_odds: 7.0, odds_outweigh_misfit: false, tolerance_m2: 0.0, evidence: &|_| Some(0.0) };
        let (left, merges) = close(&landmarks, &closing);
        assert!(merges.len() >= 10, "{merges:?}");
        assert!(merges.iter().all(|[younger, older]| younger % 12 == older % 12), "{merges:?}");
        assert_eq!(left, 24 - merges.len());
    }

    #[test]
    fn what_looks_different_stays_two() {
        let closing = Closing { log_odds: 7.0, odds_outweigh_misfit: false, tolerance_m2: 0.0, evidence: &|_| None };
        assert!(close(&ring(), &closing).1.is_empty());
        // Each pair is a billion times likelier two things than one by its looks.
        let closing = Closing { evidence: &|_| Some(-20.7), ..closing };
        assert!(close(&ring(), &closing).1.is_empty());
    }

    #[test]
    fn nothing_within_the_gate_is_passed_over() {
        let stream = RandomSource::new(3).stream(Purpose::Simulation, 0);
        let mut within = 0;
        for case in 0..2000_u32 {
            let drawn = |which: u32| {
                let pair = |lane: usize| stream.normal_pair(case, which * LANES as u32 + lane as u32);
                let common = stream.normal_pair(case, 99)[0];
                Deviations::new([0, 1].map(|axis| std::array::from_fn(|lane| common + 0.3 * pair(lane)[axis])))
            };
            let (a, b) = (drawn(0), drawn(1));
            let apart = stream.normal_pair(case, 100).map(|n| 1.5 * n);
            // Without the quick way out.
            let wide = |d: &Deviations| Deviations { drawn: d.drawn, rms_m: 1e3 };
            let slow = wide(&a).distance(&wide(&b), apart, 0.01);
            assert_eq!(a.distance(&b, apart, 0.01), slow);
            within += usize::from(slow.is_some());
        }
        assert!((500..1900).contains(&within), "{within} of 2000 within the gate");
    }

    #[test]
    fn sighted_together_means_two_things() {
        let sights = |steps: &[u32]| {
            let seen = |step: &u32| super::super::history::Seen { birth: 0, step: *step, sighting: *step };
            Sights { birth: 0, known: Known::Nothing, seen: steps.iter().map(seen).collect() }
        };
        assert_eq!(seen_together(&sights(&[1, 2, 5, 9]).seen, &sights(&[0, 2, 3, 9, 12]).seen), 2);
        assert_eq!(seen_together(&sights(&[1]).seen, &sights(&[]).seen), 0);
    }

    #[test]
    fn the_limit_is_that_of_tables() {
        for (degrees_of_freedom, limit) in [(2, 13.816), (4, 18.467), (10, 29.588), (40, 73.402)] {
            let got = chi_squared_limit(degrees_of_freedom);
            assert!((got / limit - 1.0).abs() < 0.03, "{degrees_of_freedom}: {got} for {limit}");
        }
    }
}
