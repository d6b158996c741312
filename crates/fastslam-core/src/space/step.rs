//! One scan: propose, weigh, resample, sample, correct, remember, draw anew.

use super::draw;
use super::estimate::SpaceEstimate;
use super::look::Stand;
use super::map::{Birth, Landmark, Measured, Slot};
use super::motion::SpaceMotion;
use super::past::Heard;
use super::pose::SpacePose;
use super::propose::{Motion, Proposal, Scene};
use super::sensor::Spatial;
use super::sighting::{merged, usable, SpaceSighting};
use super::state::{column, of_lane, State};
use super::track;
use super::wander::Ahead;
use super::wide::{Wide, LANES};
use super::{SpaceSlam, TO_DRAW};
use crate::error::{Error, Result};
use crate::random::Purpose;
use crate::resampling::{resample, ResamplingScheme};
use crate::sighting::Skipped;
use crate::vector::vectorized;
use crate::weights::Weights;

/// Blocks of a part of a pass over particles.
const PART: usize = crate::workers::PART / LANES;

/// What happened in one step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SpaceStep {
    /// Sightings used.
    pub sightings: u32,
    /// Landmarks that were created.
    pub new_landmarks: u32,
    /// Sightings that changed nothing.
    pub skipped: Skipped,
    /// 1 / Σ weight², before resampling.
    pub effective_sample_size: f64,
    /// Increment of the log evidence.
    pub log_likelihood: f64,
    /// νᵀ L⁻¹ ν of the scan, on average over the particles.
    pub mahalanobis_squared: f64,
    /// Numbers that it is made of: what is expected.
    pub degrees_of_freedom: u32,
    /// Whether the particles were resampled.
    pub resampled: bool,
    /// Whether they were drawn anew.
    pub drawn: bool,
}

/// Sightings of a scan: those of landmarks in the map, and the others.
struct Scan {
    known: Vec<(usize, Measured)>,
    new: Vec<(u32, Measured)>,
}

/// What a scan makes of the particles, before it counts.
struct Outcome {
    weights: Weights,
    log_weight: Vec<f64>,
    /// Where they were resampled.
    ancestors: Option<Vec<u32>>,
    poses: Vec<SpacePose<Wide>>,
    corrected: Vec<(usize, Vec<Landmark<Wide>>)>,
    born: Vec<Slot>,
}

impl<M: Spatial> SpaceSlam<M> {
    /// Processes all sightings of one stamp (there may be none).
    ///
    /// **Errors:** [`Error::AllWeightsZero`] when no particle can explain the sightings, [`Error::NotFinite`] when the step
    /// would leave a number that is none. The filter is then as it was.
    pub fn update(&mut self, stamp_s: f64, sightings: &[SpaceSighting]) -> Result<SpaceStep> {
        let (used, skipped) = usable(sightings, &self.model, &self.config.sensor);
        let scan = self.sorted(merged(&self.model, used));
        let mut info = SpaceStep { skipped, ..SpaceStep::default() };
        info.sightings = (scan.known.len() + scan.new.len()) as u32;
        if info.sightings == 0 {
            self.glance(stamp_s);
            info.effective_sample_size = self.state.weights.effective_sample_size;
            return Ok(info);
        }
        self.step(stamp_s, &scan, &mut info)?;
        info.drawn = self.draw_is_due() && self.draw_anew();
        Ok(info)
    }

    /// A pose of the path where nothing is seen, which the least squares has too.
    ///
    /// **Errors:** [`Error::NotFinite`] when the step would leave a number that is none. The filter is then as it was.
    pub fn pass(&mut self, stamp_s: f64) -> Result<SpaceStep> {
        let mut info = SpaceStep::default();
        self.step(stamp_s, &Scan { known: Vec::new(), new: Vec::new() }, &mut info)?;
        Ok(info)
    }

    fn step(&mut self, stamp_s: f64, scan: &Scan, info: &mut SpaceStep) -> Result<()> {
        let ahead = self.state.ahead(&self.config.motion);
        let (outcome, estimate) = self.outcome(ahead.as_ref(), scan, info)?;
        self.check_numbers(&outcome, &estimate)?;
        let flat = Error::NotPositiveDefinite { step: self.state.counters.steps, what: "the motion's covariance" };
        let moved = self.state.moved(&self.config.motion);
        self.state.past.push(stamp_s, &moved, ahead.map(|ahead| ahead.leg)).ok_or(flat)?;
        self.follow(ahead.as_ref(), &outcome);
        self.adopt(stamp_s, outcome, estimate);
        self.remember(scan);
        Ok(())
    }

    fn sorted(&self, sightings: Vec<(u32, Measured)>) -> Scan {
        let mut scan = Scan { known: Vec::new(), new: Vec::new() };
        for (identity, measured) in sightings {
            match self.state.slot_of.get(&identity) {
                Some(slot) => scan.known.push((*slot as usize, measured)),
                None => scan.new.push((identity, measured)),
            }
        }
        scan
    }

    /// Fully adapted: the weight does not depend on the sampled pose, so that poses are sampled after resampling.
    ///
    /// **Source:** `montemerlo2003fastslam2`, equations 7 to 19.
    fn outcome(&self, ahead: Option<&Ahead>, scan: &Scan, info: &mut SpaceStep) -> Result<(Outcome, SpaceEstimate)> {
        let (motion, predicted) = self.predict(ahead);
        let motion = &motion;
        let mut proposals = self.propose(motion, predicted, scan); // s_t ~ N(μ_s, Σ_s), eq. 9 to 15
        let (mut log_weight, mut weights) = self.weigh(&proposals, scan, info)?; // p(z), eq. 19
        let estimate = self.estimate(motion, &proposals, &weights);
        let ancestors = self.resample(&weights, &log_weight);
        if let Some(ancestors) = &ancestors {
            info.resampled = true;
            proposals = followed(&proposals, ancestors);
            log_weight.fill(0.0);
            weights.restart(log_weight.len());
        }
        let poses = self.sample(motion, &proposals);
        let corrected = self.correct(&poses, ancestors.as_deref(), &scan.known); // at the sampled pose, eq. 7
        let born = self.create(&poses, &scan.new);
        info.new_landmarks = born.len() as u32;
        Ok((Outcome { weights, log_weight, ancestors, poses, corrected, born }, estimate))
    }

    /// How surely the particles moved, and where they are without the scan.
    fn predict(&self, ahead: Option<&Ahead>) -> (Motion, Vec<SpacePose<Wide>>) {
        let state = &self.state;
        let mut poses = state.poses.clone();
        let (Some(track), Some(ahead)) = (&state.track, ahead) else {
            poses.iter_mut().for_each(|pose| *pose = pose.compose(state.pending.mean.constant()));
            return (Motion::from(&state.pending), poses);
        };
        for (block, velocities) in track.velocity.chunks(LANES).enumerate() {
            let mut way = [Wide::default(); 6];
            for (lane, velocity) in velocities.iter().enumerate() {
                let own = ahead.leg.way(velocity);
                (0..6).for_each(|i| way[i].0[lane] = own[i]);
            }
            poses[block] = poses[block].compose(SpacePose::exp(way));
        }
        let [velocity, _] = track.moments(&state.weights.values);
        (Motion::unsure(&track::motion(&ahead.leg, &velocity, &ahead.way)), poses)
    }

    fn propose(&self, motion: &Motion, predicted: Vec<SpacePose<Wide>>, scan: &Scan) -> Vec<Proposal> {
        let poses = &predicted;
        let mut out: Vec<Proposal> = poses.iter().map(|pose| Proposal::at(*pose)).collect();
        let scene = Scene { eye: self.eye(), motion, known: &scan.known, slots: &self.state.slots };
        self.workers.share(out.as_mut_slice(), PART, &|first, part: &mut [Proposal]| {
            vectorized(
                #[inline(always)]
                || {
                    for (k, proposal) in part.iter_mut().enumerate() {
                        let block = first + k;
                        *proposal = Proposal::of(&scene, poses[block], block);
                    }
                },
            );
        });
        out
    }

    /// The weights after the scan, logarithms first.
    fn weigh(&self, proposals: &[Proposal], scan: &Scan, info: &mut SpaceStep) -> Result<(Vec<f64>, Weights)> {
        let count = self.state.particles();
        let before = &self.state.weights;
        let seen = column(proposals.iter().map(|p| p.log_likelihood), count);
        let log_weight: Vec<f64> = self.state.log_weight.iter().zip(&seen).map(|(a, b)| a + b).collect();
        let mut weights = Weights::default();
        weights.normalize(&log_weight, self.state.counters.steps)?;
        info.effective_sample_size = weights.effective_sample_size;
        info.log_likelihood = weights.log_mean - before.log_mean;
        let squared = column(proposals.iter().map(|p| p.mahalanobis_squared), count);
        let sound = weights.values.iter().zip(&squared).filter(|(weight, _)| **weight > 0.0);
        info.mahalanobis_squared = sound.map(|(weight, squared)| weight * squared).sum();
        info.degrees_of_freedom = 3 * scan.known.len() as u32;
        Ok((log_weight, weights))
    }

    /// The mixture of the proposals, which has less noise than their samples.
    fn estimate(&self, motion: &Motion, proposals: &[Proposal], weights: &Weights) -> SpaceEstimate {
        let mut parts = Vec::with_capacity(weights.values.len());
        for (block, proposal) in proposals.iter().enumerate() {
            let root = proposal.root(motion);
            for (lane, weight) in weights.values[block * LANES..].iter().take(LANES).enumerate() {
                let mean = of_lane(&proposal.pose, lane);
                let own = root.map(|row| row.map(|v| v.0[lane]));
                let covariance = super::matrix::multiply_transposed(&own, &own);
                parts.push((*weight, SpaceEstimate { mean, covariance }));
            }
        }
        SpaceEstimate::of_mixture(&parts)
    }

    /// Whose copy each particle becomes, of all lanes; `None` where they stay.
    fn resample(&self, weights: &Weights, log_weight: &[f64]) -> Option<Vec<u32>> {
        let count = log_weight.len();
        let broken = log_weight.iter().any(|w| w.is_nan());
        if !weights.are_uneven(self.config.filter.resampling_threshold) && !broken {
            return None;
        }
        let stream = self.random.stream(Purpose::Resampling, self.state.counters.steps);
        let mut ancestors = Vec::new();
        resample(ResamplingScheme::Systematic, &weights.values, count, stream, &mut ancestors);
        let last = ancestors.last().copied().unwrap_or(0);
        ancestors.resize(self.state.poses.len() * LANES, last);
        Some(ancestors)
    }

    fn sample(&self, motion: &Motion, proposals: &[Proposal]) -> Vec<SpacePose<Wide>> {
        let stream = self.random.stream(Purpose::Proposal, self.state.counters.steps);
        let mut poses: Vec<SpacePose<Wide>> = proposals.iter().map(|p| p.pose).collect();
        for (block, (pose, proposal)) in poses.iter_mut().zip(proposals).enumerate() {
            let mut normal = [Wide::default(); 6];
            for lane in 0..LANES {
                for pair in 0..3 {
                    let [a, b] = stream.normal_pair((block * LANES + lane) as u32, pair as u32);
                    normal[2 * pair].0[lane] = a;
                    normal[2 * pair + 1].0[lane] = b;
                }
            }
            *pose = proposal.sample(motion, &normal);
        }
        poses
    }

    fn correct(
        &self,
        poses: &[SpacePose<Wide>],
        ancestors: Option<&[u32]>,
        known: &[(usize, Measured)],
    ) -> Vec<(usize, Vec<Landmark<Wide>>)> {
        let stands: Vec<Stand<Wide>> = poses.iter().map(|pose| Stand::from(*pose)).collect();
        let eye = self.eye();
        let corrected = |(slot, measured): &(usize, Measured)| {
            let before = &self.state.slots[*slot];
            let rows = before.rows_after(ancestors);
            let mut blocks = vec![Landmark::default(); poses.len()];
            self.workers.share(blocks.as_mut_slice(), PART, &|first, part: &mut [Landmark<Wide>]| {
                vectorized(
                    #[inline(always)]
                    || {
                        for (k, landmark) in part.iter_mut().enumerate() {
                            let block = first + k;
                            *landmark = before.seen((&rows, block), &eye, &stands[block], measured);
                        }
                    },
                );
            });
            (*slot, blocks)
        };
        known.iter().map(corrected).collect()
    }

    fn create(&self, poses: &[SpacePose<Wide>], new: &[(u32, Measured)]) -> Vec<Slot> {
        let T_robot_sensor = self.config.sensor.mounting.pose();
        let born = new.iter().filter_map(|(identity, measured)| {
            let birth = Birth::of(&self.model, T_robot_sensor, measured)?;
            Some(Slot::new(*identity, poses.iter().map(|pose| birth.at(*pose)).collect()))
        });
        born.collect()
    }

    /// Errors unless all numbers can be computed with.
    fn check_numbers(&self, outcome: &Outcome, estimate: &SpaceEstimate) -> Result<()> {
        let corrected = outcome.corrected.iter().flat_map(|(_, blocks)| blocks);
        let poses = &outcome.poses;
        let finite = |pose: &SpacePose<Wide>| (0..LANES).all(|lane| of_lane(pose, lane).is_finite());
        for (what, sound) in [
            ("a pose", poses.iter().all(finite)),
            ("the pose", estimate.mean.is_finite() && estimate.covariance.iter().flatten().all(|v| v.is_finite())),
            ("a landmark", corrected.chain(outcome.born.iter().flat_map(Slot::blocks)).all(Landmark::is_usable)),
        ] {
            if !sound {
                return Err(Error::NotFinite { step: self.state.counters.steps, what });
            }
        }
        Ok(())
    }

    /// The velocities of the particles, from the ways to where they were sampled.
    fn follow(&mut self, ahead: Option<&Ahead>, outcome: &Outcome) {
        let State { track, poses, .. } = &mut self.state;
        let (Some(track), Some(ahead)) = (track, ahead) else { return };
        let of = |poses: &[SpacePose<Wide>], i: usize| of_lane(&poses[i / LANES], i % LANES);
        track.go(ahead, outcome.ancestors.as_deref(), |from, i| (of(poses, from), of(&outcome.poses, i)));
    }

    fn adopt(&mut self, stamp_s: f64, outcome: Outcome, estimate: SpaceEstimate) {
        let state = &mut self.state;
        let Outcome { weights, log_weight, ancestors, poses, corrected, born } = outcome;
        if let Some(ancestors) = &ancestors {
            let mut spare = Vec::new();
            state.slots.iter_mut().for_each(|slot| slot.resample(ancestors, &mut spare));
            state.path.resample(&ancestors[..log_weight.len()]);
        }
        for (slot, blocks) in corrected {
            state.slots[slot].sightings += 1;
            state.slots[slot].replace(blocks);
        }
        for slot in born {
            state.slot_of.insert(slot.identity, state.slots.len() as u32);
            state.slots.push(slot);
        }
        (state.weights, state.log_weight, state.poses) = (weights, log_weight, poses);
        (state.estimate, state.pending) = (estimate, SpaceMotion::default());
        if let Some(track) = &mut state.track {
            track.mode.poses.push(estimate.mean);
        }
        state.counters.steps += 1;
        let poses = &state.poses;
        state.path.extend(stamp_s, &self.workers, |i| of_lane(&poses[i / LANES], i % LANES));
    }

    fn remember(&mut self, scan: &Scan) {
        let state = &mut self.state;
        let number = state.past.scans.len() as u32 - 1;
        let slot_of = &state.slot_of;
        let new = scan.new.iter().filter_map(|(identity, measured)| Some((*slot_of.get(identity)?, *measured)));
        let known = scan.known.iter().map(|(slot, measured)| (*slot as u32, *measured));
        let heard = known.chain(new).map(|(slot, measured)| Heard { scan: number, slot, measured });
        state.past.sightings.extend(heard);
    }

    fn draw_is_due(&self) -> bool {
        let filter = &self.config.filter;
        let scans = self.state.past.scans.len() as u64;
        let apart = u64::from(filter.draw_every_scans).max((filter.draw_fraction * scans as f64) as u64);
        filter.draw_every_scans > 0 && scans - self.state.counters.drawn_at >= apart
    }

    /// All particles anew from the posterior over the past; false where it cannot be had, and they stay as they are.
    fn draw_anew(&mut self) -> bool {
        self.state.counters.drawn_at = self.state.past.scans.len() as u64;
        let Some(solution) = self.solve(TO_DRAW) else { return false };
        let stream = self.random.stream(Purpose::Rejuvenation, self.state.counters.draws);
        let blocks = self.state.poses.len();
        let drawn: Option<Vec<_>> = (0..blocks).map(|block| draw::draw(&solution, block, stream)).collect();
        let Some(drawn) = drawn else { return false };
        let state = &mut self.state;
        for (n, slot) in state.slots.iter_mut().enumerate() {
            slot.replace(drawn.iter().map(|block| block.landmarks[n]).collect());
        }
        state.poses = drawn.iter().map(|block| block.pose).collect();
        if let Some(track) = &mut state.track {
            let of = |i: usize| drawn[i / LANES].velocity(&state.past, self.config.initial_pose.pose(), i % LANES);
            track.velocity = (0..state.log_weight.len()).map(of).collect();
            track.mode = solution.at.clone();
        }
        let poses = &state.poses;
        state.path.replace(&solution.at.poses, |i| of_lane(&poses[i / LANES], i % LANES));
        state.log_weight.fill(0.0);
        state.weights.restart(state.log_weight.len());
        state.counters.draws += 1;
        if let Some(mean) = solution.at.poses.last() {
            state.estimate = SpaceEstimate { mean: *mean, covariance: solution.newest_covariance() };
        }
        true
    }
}

/// The proposals of the ancestors.
fn followed(proposals: &[Proposal], ancestors: &[u32]) -> Vec<Proposal> {
    let mut out = proposals.to_vec();
    for (block, proposal) in out.iter_mut().enumerate() {
        for lane in 0..LANES {
            let from = ancestors[block * LANES + lane] as usize;
            proposal.take(lane, &proposals[from / LANES], from % LANES);
        }
    }
    out
}
