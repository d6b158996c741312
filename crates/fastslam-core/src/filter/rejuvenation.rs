//! A cure for depletion: all particles start anew from draws of whole paths, given all that was seen.
//!
//! Resampling leaves a particle filter with one common past, so that a loop that closes late cannot correct it. Here
//! the best particle's associations turn motions and sightings into a sparse least-squares problem; its solution and
//! precision (the Laplace approximation) describe the posterior over paths; every particle draws a path from it, and
//! gets the landmarks that follow from that path.
//!
//! **Source:** `beevers2007fixedlag` for the idea of drawing past poses again; the exact factorisation
//! (`montemerlo2002fastslam`, eq. 3) is what makes landmarks follow from a path. Exact in a linear-Gaussian world.

use super::need::Need;
use super::state::Rejuvenation;
use super::{FastSlam, Identities};
use crate::association::{CandidateTable, Decision, ScanSighting};
use crate::geometry::Pose;
use crate::landmark::{column, Gaussian};
use crate::math;
use crate::measurement::MeasurementModel;
use crate::motion::MotionGaussian;
use crate::random::{Purpose, Stream};
use crate::smoothing::{by_landmark, draw, fill_normal, Drawn, Sampling, LANES};
use crate::smoothing::{Closing, Graph, Known, Mode, Sights, Solution, Trajectory, NO_LANDMARK};
use crate::store::RowsMut;
use rustc_hash::{FxHashMap, FxHashSet};
use std::cell::Cell;

impl<M: MeasurementModel> FastSlam<M> {
    /// Remembers a control.
    pub(super) fn remember_motion(&mut self, motion: &MotionGaussian) {
        if let Some(rejuvenation) = &mut self.state.rejuvenation {
            rejuvenation.history.moved(motion);
        }
    }

    /// Remembers a scan whose sightings all belong to the same landmarks in all maps.
    pub(super) fn remember_identified(&mut self, scan: &[ScanSighting]) {
        let Some(mut rejuvenation) = self.state.rejuvenation.take() else { return };
        let birth = |sighting: &ScanSighting| {
            let slot = sighting.identity.and_then(|identity| self.state.landmarks.of_identity(identity).first());
            slot.map_or(NO_LANDMARK, |slot| self.state.landmarks.birth(*slot) as u32)
        };
        let births: Vec<u32> = scan.iter().map(birth).collect();
        rejuvenation.history.explained_alike(scan.iter().map(|s| s.measured), &births);
        self.state.rejuvenation = Some(rejuvenation);
    }

    /// Remembers a scan with every particle's decisions (an equal share each); sightings taken for new landmarks made
    /// those of `births`.
    pub(super) fn remember_decided(
        &mut self,
        scan: &[ScanSighting],
        decisions: &[Decision],
        table: &CandidateTable,
        births: &[u64],
    ) {
        let Some(mut rejuvenation) = self.state.rejuvenation.take() else { return };
        let old: Vec<u32> = table.slots.iter().map(|slot| self.state.landmarks.birth(*slot) as u32).collect();
        let choice = |particle: usize, j: usize| match decisions[particle * scan.len() + j] {
            Decision::Landmark(candidate) => old[candidate as usize],
            Decision::New => births[j] as u32,
            Decision::Ignored => NO_LANDMARK,
        };
        rejuvenation.history.explained(scan.iter().map(|s| s.measured), choice);
        self.state.rejuvenation = Some(rejuvenation);
    }

    /// Remembers that a pose was added to every path.
    pub(super) fn remember_step(&mut self) {
        let best = self.state.particles.best();
        if let Some(rejuvenation) = &mut self.state.rejuvenation {
            rejuvenation.history.step_done();
            if let Some(need) = &mut rejuvenation.need {
                let after = self.state.particles.pose(best);
                need.step_done(&rejuvenation.history, after);
            }
        }
    }

    /// The past follows the ancestors like everything else.
    pub(super) fn resample_history(&mut self) {
        if let Some(rejuvenation) = &mut self.state.rejuvenation {
            rejuvenation.history.resample(&self.work.ancestor_indices);
        }
    }

    /// Whether it is time.
    pub(super) fn rejuvenation_is_due(&self) -> bool {
        let settings = &self.settings.config.filter.rejuvenation;
        self.state.rejuvenation.as_ref().is_some_and(|r| {
            if let Some(need) = &r.need {
                return need.asks();
            }
            let least = f64::from(settings.every_steps.unwrap_or(0)).max(settings.growth * r.last as f64);
            (r.history.steps() - r.last) as f64 >= least
        })
    }

    /// Draws all particles anew from the posterior over paths and maps, given the best particle's associations.
    ///
    /// Returns false, and leaves everything as it is, when the filter was not configured for it
    /// (`filter.rejuvenation`), when nothing happened since the last time, or when no finite solution was
    /// found.
    pub fn rejuvenate(&mut self) -> bool {
        let Some(mut rejuvenation) = self.state.rejuvenation.take() else { return false };
        let fresh = rejuvenation.history.steps() > rejuvenation.last;
        let work = Cell::new(0.0);
        let anew = fresh.then(|| self.start_anew(&rejuvenation, &work)).flatten();
        rejuvenation.count += u64::from(anew.is_some());
        rejuvenation.last = rejuvenation.history.steps();
        rejuvenation.merged = anew.as_ref().map_or(0, |(_, merges)| merges.len() as u32);
        if let Some((trajectory, merges)) = &anew {
            rejuvenation.history.resample(&self.work.ancestor_indices);
            if let Some(need) = &mut rejuvenation.need {
                need.drawn(work.get(), merges, (&rejuvenation.history, trajectory));
            }
        }
        self.state.rejuvenation = Some(rejuvenation);
        anew.is_some()
    }

    /// Landmarks that went over into others when all was drawn anew the last time.
    pub(super) fn closed(&self) -> u32 {
        self.state.rejuvenation.as_ref().map_or(0, |rejuvenation| rejuvenation.merged)
    }

    /// Returns the path and the births of landmarks that went over into others (younger, older); `None` when nothing was
    /// done.
    fn start_anew(&mut self, rejuvenation: &Rejuvenation, work: &Cell<f64>) -> Option<(Trajectory, Vec<[u32; 2]>)> {
        let (history, best) = (&rejuvenation.history, self.state.particles.best());
        let means = self.means_of(best);
        let window = self.settings.config.filter.rejuvenation.window_steps.map_or(usize::MAX, |steps| steps as usize);
        let first_free = history.steps().saturating_sub(window);
        let landmarks = self.sights(rejuvenation, &means, first_free);
        let trajectory = self.trajectory(rejuvenation, first_free)?;
        let mut graph = Graph {
            history,
            model: &self.models.measurement,
            T_robot_sensor: self.models.T_robot_sensor,
            likelihood_exponent: self.settings.config.filter.likelihood_exponent,
            first_free,
            landmarks,
            work,
        };
        let mode = graph.solve(graph.guess(trajectory, |sights| means[&sights.birth].1))?;
        let stream = self.settings.random.stream(Purpose::Rejuvenation, rejuvenation.count);
        let (mode, merges) = self.close_loops(&mut graph, mode, stream, &means);
        let sampling = Sampling {
            stream,
            count: self.state.particles.len(),
            spread: self.settings.config.filter.rejuvenation.spread,
        };
        let drawn = draw(&graph, &mode, &sampling);
        if !drawn.last_poses.iter().all(|pose| pose.is_finite()) {
            return None;
        }
        let landmarks = graph.landmarks;
        self.adopt(best, &mode.solution, &drawn, &landmarks, &means);
        for [younger, older] in &merges {
            self.unite([older, younger].map(|birth| means[birth].0));
        }
        if !merges.is_empty() {
            self.state.diagnosis.watch.closed();
        }
        Some((mode.solution.trajectory, merges))
    }

    /// The best particle's path, joined where the last draw ended; `None` where it lacks steps.
    fn trajectory(&self, rejuvenation: &Rejuvenation, first_free: usize) -> Option<Trajectory> {
        let path = self.state.path.path(self.state.particles.best());
        let poses: Vec<Pose> = path.into_iter().map(|(_, pose)| pose).collect();
        if poses.len() != rejuvenation.history.steps() {
            return None;
        }
        let drawn = (rejuvenation.count > 0).then(|| rejuvenation.last.saturating_sub(1));
        // What is held must not be moved.
        let drawn = drawn.filter(|step| *step >= first_free);
        Some(Trajectory::joined(self.start(), poses, drawn, &rejuvenation.history))
    }

    /// The landmarks of the best particle with its sightings of them, those of a given map first; only those seen in a
    /// step that is drawn anew.
    fn sights(
        &self,
        rejuvenation: &Rejuvenation,
        means: &FxHashMap<u32, (u32, [f64; 2])>,
        first_free: usize,
    ) -> Vec<Sights> {
        let mut seen = rejuvenation.history.seen_by(self.state.particles.best());
        for sight in &mut seen {
            sight.birth = self.state.merger.present_name(sight.birth, |birth| means.contains_key(&birth));
        }
        let fading = self.state.landmarks.fading.as_ref();
        let may_exist = |birth: u32| fading.is_none_or(|fading| fading.may_exist(birth.into()));
        let mut landmarks = by_landmark(&seen, |birth| means.contains_key(&birth) && may_exist(birth));
        landmarks.retain(|sights| sights.seen.last().is_some_and(|last| last.step as usize >= first_free));
        self.put_given_first(&mut landmarks, means);
        landmarks
    }

    /// Puts the landmarks of a given map before the others, with what is known of them: those too that were not seen,
    /// since others may turn out to be one with them.
    fn put_given_first(&self, landmarks: &mut Vec<Sights>, means: &FxHashMap<u32, (u32, [f64; 2])>) {
        let given = &self.state.given;
        if given.landmarks.is_empty() {
            return;
        }
        let seen: FxHashSet<u32> = landmarks.iter().map(|sights| sights.birth).collect();
        let unseen =
            (0..given.landmarks.len() as u32).filter(|birth| !seen.contains(birth) && means.contains_key(birth));
        landmarks.extend(unseen.map(|birth| Sights { birth, known: Known::Nothing, seen: Vec::new() }));
        landmarks.iter_mut().for_each(|sights| sights.known = given.known(sights.birth.into()));
        landmarks.sort_by_key(|sights| sights.known == Known::Nothing);
    }

    /// Remembers that the path begins with an error.
    pub(super) fn remember_start(&mut self, mean: Pose, spread: &MotionGaussian) {
        if let Some(rejuvenation) = &mut self.state.rejuvenation {
            rejuvenation.history.moved(spread);
            if let Some(need) = &mut rejuvenation.need {
                *need = Need::new(mean);
            }
        }
    }

    /// Closes the loops that the best particle has missed, if the configuration wants that.
    fn close_loops(
        &self,
        graph: &mut Graph<'_, M>,
        mode: Mode,
        stream: Stream,
        slots: &FxHashMap<u32, (u32, [f64; 2])>,
    ) -> (Mode, Vec<[u32; 2]>) {
        let odds = self.settings.config.filter.rejuvenation.closing_odds;
        if odds == 0.0 || self.settings.identities == Identities::All {
            return (mode, Vec::new());
        }
        let best = self.state.particles.best();
        let evidence = |births: [u32; 2]| {
            let [older, younger] = births.map(|birth| slots[&birth].0);
            // Two of a given map are two, whatever lies between them.
            let apart = self.state.landmarks.is_named(younger, best) || self.state.given.of(births[1].into()).is_some();
            let looks = self.state.landmarks.appearances.as_ref();
            (!apart).then(|| looks.map_or(0.0, |looks| looks.evidence_of_one([older, younger], best)))
        };
        let tolerance = self.settings.config.association.merging.tolerance_std_m;
        let closing = Closing {
            log_odds: math::ln(odds),
            odds_outweigh_misfit: self.settings.config.filter.rejuvenation.every_steps.is_none(),
            tolerance_m2: tolerance * tolerance,
            evidence: &evidence,
        };
        graph.close_loops(mode, &closing, |size, pass| {
            let mut numbers = vec![[0.0; LANES]; size];
            // Particles have lower numbers.
            let sampling = Sampling { stream, count: LANES, spread: 1.0 };
            fill_normal(&mut numbers, &sampling, u32::MAX - ((pass + 1) * LANES) as u32);
            numbers
        })
    }

    /// Slot and mean of every landmark in one map, by birth.
    fn means_of(&self, particle: usize) -> FxHashMap<u32, (u32, [f64; 2])> {
        let mut row = vec![0.0; self.state.landmarks.columns()];
        let mut means = FxHashMap::default();
        for slot in self.state.landmarks.live_slots() {
            if self.state.landmarks.read_row(slot, particle, &mut row) {
                let mean = [row[column::MEAN_X], row[column::MEAN_Y]];
                means.insert(self.state.landmarks.birth(slot) as u32, (slot, mean));
            }
        }
        means
    }

    /// Makes every particle a copy of the best one, with its own draw in place of poses and landmarks.
    fn adopt(
        &mut self,
        best: usize,
        solution: &Solution,
        drawn: &Drawn,
        landmarks: &[Sights],
        slots: &FxHashMap<u32, (u32, [f64; 2])>,
    ) {
        let count = self.state.particles.len();
        self.work.ancestor_indices.clear();
        self.work.ancestor_indices.resize(count, best as u32);
        self.state.particles.resample(&self.work.ancestor_indices);
        self.state.landmarks.resample(&self.work.ancestor_indices);
        self.state.path.resample(&self.work.ancestor_indices);
        self.state.path.replace(&solution.trajectory.poses, |i| drawn.last_poses[i]);
        for (i, pose) in drawn.last_poses.iter().enumerate() {
            self.state.particles.set_pose(i, *pose);
        }
        for (sights, gaussians) in landmarks.iter().zip(drawn.landmarks.chunks_exact(count)) {
            if sights.seen.is_empty() || matches!(sights.known, Known::Place(_)) {
                continue;
            }
            self.state.landmarks.update(slots[&sights.birth].0, None, |rows| put(gaussians, rows));
        }
        self.restart_weights();
        self.estimate_beliefs();
    }
}

/// Puts what was drawn of a landmark into its rows.
fn put(gaussians: &[Gaussian], mut rows: RowsMut<'_>) {
    let number = |g: &Gaussian, c: usize| match c {
        column::MEAN_X => g.mean[0],
        column::MEAN_Y => g.mean[1],
        column::COV_XX => g.covariance.xx,
        column::COV_XY => g.covariance.xy,
        _ => g.covariance.yy,
    };
    for c in [column::MEAN_X, column::MEAN_Y, column::COV_XX, column::COV_XY, column::COV_YY] {
        for (value, gaussian) in rows.column(c).iter_mut().zip(gaussians) {
            // A landmark at the sensor has no direction; it stays what it was.
            if gaussian.is_usable() {
                *value = number(gaussian, c);
            }
        }
    }
}
