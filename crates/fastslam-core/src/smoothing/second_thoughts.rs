//! Second thoughts: sightings go over to the landmarks that they show, as the whole path has it.
//!
//! A particle decides what a sighting shows when it comes, from a pose that may be off by more than landmarks stand apart.
//! Once the path is known such a sighting lies beside its landmark and on another one. Scan by scan, sightings change
//! places while that brings them nearer to what they show; then the problem is solved again.
//!
//! **Source:** hard expectation maximisation; in a scan each landmark is sighted once.

use super::closing::Closing;
use super::differences::GATE;
use super::factor::Lanes;
use super::graph::{Graph, Known, Mode, Sights};
use super::history::{Seen, NO_LANDMARK};
use crate::measurement::Placing;
use rustc_hash::{FxHashMap, FxHashSet};

/// Solutions at most, after the first.
const PASSES: usize = 4;
/// A change must bring its sightings nearer by so much, in squared standard deviations of the sensor.
const GAIN: f64 = 2.0;
/// A sighting that shows another landmark than was thought.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Moved {
    /// Number of the sighting.
    pub sighting: u32,
    /// Births of the landmark that it was taken for and of that which it shows, or [`NO_LANDMARK`].
    pub from: u32,
    pub to: u32,
}

/// What second thoughts come to.
#[derive(Debug, Default)]
pub struct SecondThoughts {
    /// Sightings that go over.
    pub moved: Vec<Moved>,
    /// Births of landmarks that went over into others, having lost all their sightings, and of these.
    pub gone_over: Vec<[u32; 2]>,
}

/// Pairs of landmarks by birth, older first, the relation of which is known better than a sighting.
pub type Related = FxHashSet<[u32; 2]>;

/// A sighting of the scan at hand and the landmark that it is taken for.
struct Claim {
    landmark: usize,
    seen: Seen,
}

impl<M: Placing> Graph<'_, M> {
    /// The mode with the sightings where they belong, and which those are; `normal` gives so many rows of standard normal
    /// numbers.
    pub fn reassociate(
        &mut self,
        mut mode: Mode,
        closing: &Closing<'_>,
        normal: impl FnOnce(usize) -> Vec<Lanes>,
    ) -> (Mode, SecondThoughts) {
        let reach = self.reach();
        let pairs = self.side_by_side(&reach, &mode);
        if pairs.is_empty() {
            return (mode, SecondThoughts::default());
        }
        let deviations = self.deviations(&mode, &mut normal(mode.factor.size()));
        let births = |pair: [usize; 2]| pair.map(|k| self.landmarks[k].birth);
        // With a loop open the relation of a landmark and the one that was founded anew for it is not known.
        let is_known =
            |[a, b]: [usize; 2]| deviations[a].relative(&deviations[b]) <= reach[a].max(reach[b]).powi(2) / GATE;
        let may_be = |pair| (closing.evidence)(births(pair)).is_some_and(|evidence| evidence >= 0.0);
        let related = pairs.into_iter().filter(|pair| is_known(*pair) && may_be(*pair)).map(births).collect();
        let before = self.births();
        for _ in 0..PASSES {
            let Some((landmarks, moved)) = self.rearranged(&mode, &related) else { break };
            // A landmark less is worth what it takes to make two one.
            let fewer = (self.landmarks.len() - landmarks.len()) as f64;
            if moved.cost >= mode.cost + fewer * closing.log_odds {
                break;
            }
            (self.landmarks, mode) = (landmarks, moved);
        }
        let mut thoughts = SecondThoughts::between(&before, &self.births());
        let (mode, twins) = self.join_twins(mode, closing, &related);
        thoughts.gone_over.extend(twins);
        let (mode, surplus) = self.without_surplus(mode, closing, &related);
        thoughts.moved.extend(surplus.moved);
        thoughts.gone_over.extend(surplus.gone_over);
        (mode, thoughts)
    }

    /// Sighting and birth of the landmark that it is taken for.
    pub(super) fn births(&self) -> FxHashMap<u32, u32> {
        let of = |sights: &Sights| sights.seen.iter().map(|seen| (seen.sighting, sights.birth)).collect::<Vec<_>>();
        self.landmarks.iter().flat_map(of).collect()
    }

    /// The landmarks with every scan's sightings where they fit best, and the mode then; `None` where none moves.
    fn rearranged(&self, mode: &Mode, related: &Related) -> Option<(Vec<Sights>, Mode)> {
        let mut beside = vec![Vec::new(); self.landmarks.len()];
        for [a, b] in self.related_pairs(mode, related) {
            beside[a].push(b);
            beside[b].push(a);
        }
        beside.iter_mut().for_each(|others| others.sort_unstable());
        let mut claims: Vec<Claim> = Vec::new();
        for (landmark, sights) in self.landmarks.iter().enumerate().filter(|(k, _)| !beside[*k].is_empty()) {
            claims.extend(sights.seen.iter().map(|&seen| Claim { landmark, seen }));
        }
        claims.sort_by_key(|claim| claim.seen.sighting);
        let mut changes = 0;
        for scan in claims.chunk_by_mut(|a, b| a.seen.step == b.seen.step) {
            changes += self.rearrange(scan, &beside, mode);
        }
        (changes > 0).then(|| self.with_claims(&claims, &beside, mode)).flatten()
    }

    /// Lets the sightings of one scan change places while that brings them nearer; returns how often they did.
    fn rearrange(&self, scan: &mut [Claim], beside: &[Vec<usize>], mode: &Mode) -> usize {
        let mut changes = 0;
        for _ in 0..scan.len() {
            let Some((claim, to)) = self.best_change(scan, beside, mode) else { break };
            let from = scan[claim].landmark;
            if let Some(other) = scan.iter().position(|claim| claim.landmark == to) {
                scan[other].landmark = from;
            }
            scan[claim].landmark = to;
            changes += 1;
        }
        changes
    }

    /// The claim that gains most by going over to another landmark, with that of the other sighting that has to give way.
    fn best_change(&self, scan: &[Claim], beside: &[Vec<usize>], mode: &Mode) -> Option<(usize, usize)> {
        let distance = |claim: &Claim, landmark: usize| {
            let at = (mode.solution.landmarks[landmark], &self.landmarks[landmark].known);
            self.view(&mode.solution.trajectory, at, &claim.seen).distance
        };
        let gain = |claim: &Claim, to: usize| {
            let own = distance(claim, claim.landmark) - distance(claim, to);
            let other = scan.iter().find(|other| other.landmark == to);
            own + other.map_or(0.0, |other| distance(other, to) - distance(other, claim.landmark))
        };
        let changes =
            scan.iter().enumerate().flat_map(|(i, claim)| beside[claim.landmark].iter().map(move |to| (i, *to)));
        let gains = changes.map(|(i, to)| (gain(&scan[i], to), i, to));
        gains.max_by(|a, b| a.0.total_cmp(&b.0)).filter(|(gain, ..)| *gain > GAIN).map(|(_, i, to)| (i, to))
    }

    /// The landmarks with these claims, and the mode then.
    fn with_claims(&self, claims: &[Claim], beside: &[Vec<usize>], mode: &Mode) -> Option<(Vec<Sights>, Mode)> {
        let mut landmarks = self.landmarks.clone();
        landmarks.iter_mut().zip(beside).filter(|(_, beside)| !beside.is_empty()).for_each(|(l, _)| l.seen.clear());
        for claim in claims {
            let sights = &mut landmarks[claim.landmark];
            sights.seen.push(Seen { birth: sights.birth, ..claim.seen });
        }
        self.solved_with(landmarks, mode)
    }

    /// Pairs of landmarks that stand so near to each other that their sightings may be taken for one another, and that may
    /// be.
    pub(super) fn related_pairs(&self, mode: &Mode, related: &Related) -> Vec<[usize; 2]> {
        let mut pairs = self.side_by_side(&self.reach(), mode);
        pairs.retain(|pair| related.contains(&pair.map(|k| self.landmarks[k].birth)));
        pairs
    }

    /// Pairs of landmarks of which one is in reach of the other's sightings, in order.
    fn side_by_side(&self, reach: &[f64], mode: &Mode) -> Vec<[usize; 2]> {
        let places = &mode.solution.landmarks;
        let mut by_x: Vec<usize> = (0..places.len()).collect();
        by_x.sort_by(|a, b| places[*a][0].total_cmp(&places[*b][0]));
        let farthest = reach.iter().copied().fold(0.0, f64::max);
        let mut pairs = Vec::new();
        for (i, &a) in by_x.iter().enumerate() {
            for &b in by_x[i + 1..].iter().take_while(|b| places[**b][0] - places[a][0] <= farthest) {
                let [dx, dy] = [0, 1].map(|axis| places[a][axis] - places[b][axis]);
                if dx.hypot(dy) <= reach[a].max(reach[b]) && reach[a].min(reach[b]) > 0.0 {
                    pairs.push([a.min(b), a.max(b)]);
                }
            }
        }
        pairs.sort_unstable();
        pairs
    }

    /// How far from each landmark its sightings may lie, metres; 0 for one of which something is known beside them.
    fn reach(&self) -> Vec<f64> {
        let variance = |seen: &Seen| {
            let measured = self.history.sighting(seen.sighting);
            self.model(seen.step as usize).position_variance(measured.value, measured.noise)
        };
        let places = |seen: &&Seen| self.model(seen.step as usize).places();
        let most = |sights: &Sights| sights.seen.iter().filter(places).map(variance).fold(0.0, f64::max);
        let known = |sights: &Sights| !matches!(sights.known, Known::Nothing);
        self.landmarks.iter().map(|sights| if known(sights) { 0.0 } else { (GATE * most(sights)).sqrt() }).collect()
    }
}

impl SecondThoughts {
    /// What changed between two ways to explain the sightings.
    pub(super) fn between(before: &FxHashMap<u32, u32>, after: &FxHashMap<u32, u32>) -> Self {
        let mut moved: Vec<Moved> = before
            .iter()
            .map(|(sighting, from)| (sighting, from, after.get(sighting).unwrap_or(&NO_LANDMARK)))
            .map(|(sighting, from, to)| Moved { sighting: *sighting, from: *from, to: *to })
            .filter(|moved| moved.from != moved.to)
            .collect();
        moved.sort_unstable_by_key(|moved| moved.sighting);
        let mut lost: FxHashMap<u32, FxHashMap<u32, usize>> = FxHashMap::default();
        for one in moved.iter().filter(|one| one.to != NO_LANDMARK) {
            *lost.entry(one.from).or_default().entry(one.to).or_default() += 1;
        }
        let held: FxHashSet<u32> = after.values().copied().collect();
        let mut gone_over: Vec<[u32; 2]> = lost
            .iter()
            .filter(|(birth, _)| !held.contains(*birth))
            .filter_map(|(birth, to)| to.iter().max_by_key(|(to, n)| (**n, **to)).map(|(to, _)| [*birth, *to]))
            .collect();
        gone_over.sort_unstable();
        Self { moved, gone_over }
    }
}

#[cfg(test)]
mod tests {
    use super::super::effort::Effort;
    use super::super::factor::LANES;
    use super::super::graph::{by_landmark, Solution};
    use super::super::history::{History, Trajectory};
    use super::*;
    use crate::geometry::{Pose, Symmetric2};
    use crate::landmark::{Measured, Tail};
    use crate::measurement::{MeasurementModel, RangeBearing};
    use crate::motion::MotionGaussian;
    use crate::random::{Purpose, RandomSource};

    const MODEL: RangeBearing = RangeBearing { range_std_m: 0.1, bearing_std_rad: 0.02 };
    const STEPS: usize = 60;
    const PLACES: [[f64; 2]; 3] = [[3.0, 4.0], [3.4, 4.0], [8.0, 4.0]];

    /// A straight way past three landmarks, all seen in each scan; `taken(step, k)` is what the sighting of landmark k was
    /// taken for.
    fn solved<T>(taken: impl Fn(usize, usize) -> u32, ask: impl FnOnce(Graph<'_, RangeBearing>, Mode) -> T) -> T {
        let stream = RandomSource::new(3).stream(Purpose::Simulation, 0);
        let mut history = History::new(1);
        let covariance = [[1e-4, 0.0, 0.0], [0.0, 1e-6, 0.0], [0.0, 0.0, 1e-4]];
        let mut poses = Vec::new();
        for step in 0..STEPS {
            poses.push(Pose::new(0.2 * (step + 1) as f64, 0.0, 0.0));
            history.moved(&MotionGaussian { mean: Pose::new(0.2, 0.0, 0.0), covariance });
            let scan: Vec<Measured> = (0..3)
                .map(|k| {
                    let [e, f] = stream.normal_pair(step as u32, k as u32);
                    let [range_m, bearing_rad] = MODEL.expected(poses[step], PLACES[k]);
                    let value = [range_m + 0.1 * e, bearing_rad + 0.02 * f];
                    Measured { value, noise: Symmetric2::new(0.01, 0.0, 4e-4), tail: Tail::Gaussian }
                })
                .collect();
            let births: Vec<u32> = (0..3).map(|k| taken(step, k)).collect();
            history.explained_alike(scan.into_iter(), &births);
            history.step_done(0);
        }
        let effort = Effort::any();
        let graph = Graph::over(&history, &MODEL, by_landmark(&history.seen_by(0), |_| true), &effort);
        let landmarks = graph.landmarks.iter().map(|sights| PLACES[sights.birth as usize % 3]).collect();
        let guess = Solution { trajectory: Trajectory { start: Pose::default(), poses }, landmarks };
        let mode = graph.solve(guess).unwrap();
        ask(graph, mode)
    }

    /// Draws that are all the mode.
    fn still(size: usize) -> Vec<Lanes> {
        vec![[0.0; LANES]; size]
    }

    fn closing(evidence: &dyn Fn([u32; 2]) -> Option<f64>) -> Closing<'_> {
        Closing { log_odds: 6.9, odds_outweigh_misfit: true, tolerance_m2: 0.0, evidence }
    }

    #[test]
    fn sightings_of_neighbours_that_were_exchanged_for_a_while_change_back() {
        let taken = |step: usize, k: usize| if k < 2 && (20..30).contains(&step) { 1 - k as u32 } else { k as u32 };
        solved(taken, |mut graph, mode| {
            let before = mode.cost;
            let (after, thoughts) = graph.reassociate(mode, &closing(&|_| Some(0.0)), still);
            // Noise exchanges one or the other in a scan where they stand in one direction.
            let right = thoughts.moved.iter().filter(|moved| (60..90).contains(&moved.sighting)).count();
            assert!(right >= 18 && thoughts.moved.len() <= right + 8, "{:?}", thoughts.moved);
            assert!(thoughts.moved.iter().all(|moved| moved.from != moved.to && moved.from.max(moved.to) == 1));
            assert!(thoughts.gone_over.is_empty() && after.cost < before);
        });
    }

    #[test]
    fn a_third_landmark_among_two_that_got_sightings_of_both_is_done_without() {
        // Any two of the three are sighted together in every third scan, so that no pair of them is twins.
        let taken = |step: usize, k: usize| if k < 2 && step % 3 == k { 3 } else { k as u32 };
        solved(taken, |mut graph, mode| {
            assert_eq!(graph.landmarks.len(), 4);
            let (_, thoughts) = graph.reassociate(mode, &closing(&|_| Some(0.0)), still);
            assert_eq!((graph.landmarks.len(), thoughts.gone_over.len()), (3, 1), "{:?}", thoughts.gone_over);
            let most = |sights: &Sights| sights.seen.len();
            assert!(graph.landmarks.iter().map(most).eq([STEPS; 3]), "each is sighted in every scan");
        });
    }

    #[test]
    fn what_may_not_be_taken_for_each_other_stays() {
        let taken = |step: usize, k: usize| if k < 2 && step < 10 { 1 - k as u32 } else { k as u32 };
        solved(taken, |mut graph, mode| {
            let (_, thoughts) = graph.reassociate(mode, &closing(&|_| None), still);
            assert!(thoughts.moved.is_empty());
        });
    }

    #[test]
    fn a_landmark_without_a_sighting_left_goes_over_into_the_one_that_got_most_of_them() {
        let births = |pairs: &[(u32, u32)]| pairs.iter().copied().collect::<FxHashMap<u32, u32>>();
        let before = births(&[(0, 5), (1, 5), (2, 5), (3, 2), (4, 1)]);
        let after = births(&[(0, 2), (1, 1), (2, 2), (3, 2), (4, 2)]);
        let thoughts = SecondThoughts::between(&before, &after);
        assert_eq!(thoughts.gone_over, [[5, 2]]);
        let moved: Vec<[u32; 3]> = thoughts.moved.iter().map(|moved| [moved.sighting, moved.from, moved.to]).collect();
        assert_eq!(moved, [[0, 5, 2], [1, 5, 1], [2, 5, 2], [4, 1, 2]]);
    }

    #[test]
    fn what_is_never_shown_together_beside_is_one_and_what_is_shown_together_is_two() {
        // Every third sighting of landmark 2 founded another one, 5, which stands beside it.
        let taken = |step: usize, k: usize| if k == 2 && step % 3 == 2 { 5 } else { k as u32 };
        solved(taken, |mut graph, mode| {
            let (_, thoughts) = graph.reassociate(mode, &closing(&|_| Some(0.0)), still);
            assert_eq!(thoughts.gone_over, [[5, 2]], "0 and 1 stand nearer to each other, and are seen together");
        });
        solved(taken, |mut graph, mode| {
            let (_, thoughts) = graph.reassociate(mode, &closing(&|_| None), still);
            assert!(thoughts.gone_over.is_empty());
        });
    }
}
