//! A cure for depletion: all particles start anew from draws of whole paths, given all that was seen.
//!
//! Resampling leaves a particle filter with one common past, so that a loop that closes late cannot correct it. Here
//! the best particle's associations turn motions and sightings into a sparse least-squares problem; its solution and
//! precision (the Laplace approximation) describe the posterior over paths; every particle draws a path from it, and
//! gets the landmarks that follow from that path.
//!
//! **Source:** `beevers2007fixedlag` for the idea of drawing past poses again; the exact factorisation
//! (`montemerlo2002fastslam`, eq. 3) is what makes landmarks follow from a path. Exact in a linear-Gaussian world.

use super::errors::MEMBERS;
use super::estimate::estimate_beliefs;
use super::imagine::imagine_drawn;
use super::landmarks::{Landmarks, Place};
use super::merging::Unions;
use super::need::{Need, Returns};
use super::propose::propose;
use super::setup::Setup;
use super::state::{Drawing, Rejuvenation, State};
use super::work::{Asked, Moment, Work};
use super::StepInfo;
use crate::association::Identities;
use crate::diagnosis::names::IMPLAUSIBLE;
use crate::gaussian::{Gaussian, GaussianOf};
use crate::geometry::Pose;
use crate::landmark::Planar;
use crate::math;
use crate::measurement::Placing;
use crate::motion::MotionGaussian;
use crate::random::{Purpose, Stream};
use crate::smoothing::{by_landmark, draw, fill_normal, Drawn, Effort, Sampling, LANES};
use crate::smoothing::{Closing, Graph, Known, Mode, Moved, SecondThoughts, Sights, Trajectory, NO_LANDMARK, PASSES};
use crate::store::RowsMut;
use rustc_hash::{FxHashMap, FxHashSet};

/// Remembers that the path begins with an error.
pub(super) fn remember_start(state: &mut State, mean: Pose, spread: &MotionGaussian) {
    if let Some(rejuvenation) = &mut state.rejuvenation {
        rejuvenation.history.moved(spread);
        if let Some(need) = &mut rejuvenation.need {
            *need = Need::new(mean);
        }
    }
}

/// Remembers that a pose was added to every path; returns the motion that led to it.
pub(super) fn remember_step<M>(setup: &Setup<M>, state: &mut State) -> Option<MotionGaussian> {
    let best = state.particles.best();
    let rejuvenation = state.rejuvenation.as_mut()?;
    let motion = rejuvenation.history.step_done(setup.models.sensor);
    if let Some(need) = &mut rejuvenation.need {
        need.step_done(&motion, state.particles.pose(best));
    }
    Some(motion)
}

/// Forgets old steps where the past has become longer than the configuration wants, and counts anew what counts steps.
pub(super) fn thin_past<M>(setup: &Setup<M>, state: &mut State) {
    let most = setup.settings.config.filter.rejuvenation.keyframes as usize;
    let start = state.start(&setup.settings.config);
    let Some(rejuvenation) = state.rejuvenation.as_mut().filter(|r| r.drawing != Drawing::UnderWay) else { return };
    let Some(left) = rejuvenation.history.thin(most) else { return };
    let Rejuvenation { history, last, need, .. } = rejuvenation;
    let step_now = |step: usize| left.partition_point(|left| (*left as usize) < step);
    *last = last.checked_sub(1).map_or(0, |drawn| step_now(drawn) + 1);
    let Some(need) = need else { return };
    let (best, steps) = (state.particles.best(), history.steps());
    if state.path.length(best) != history.keyframes.path_length(steps) {
        return;
    }
    let places: Vec<usize> = (0..steps).map(|step| history.keyframes.place(step)).collect();
    if let Some(poses) = state.path.poses_at(best, &places) {
        need.thinned(step_now, (history, &Trajectory { start, poses }));
    }
}

/// Whether it is time to draw all particles anew.
pub(super) fn rejuvenation_is_due<M>(setup: &Setup<M>, state: &State) -> bool {
    let settings = &setup.settings.config.filter.rejuvenation;
    state.rejuvenation.as_ref().is_some_and(|r| {
        if r.drawing == Drawing::UnderWay {
            return false;
        }
        if let Some(need) = &r.need {
            return need.asks() || r.returns.ask(need);
        }
        settings.is_due(settings.every_steps.unwrap_or(0), r.history.steps() as f64, r.last as f64)
    })
}

/// Whether a step that needs a draw does it itself.
pub(super) fn draws_in_place(state: &State) -> bool {
    state.rejuvenation.as_ref().is_some_and(|rejuvenation| rejuvenation.drawing == Drawing::InPlace)
}

/// Does the draw that a step needs.
pub(super) fn draw_in_place<M: Placing>(setup: &Setup<M>, state: &mut State, work: &mut Work, info: &mut StepInfo) {
    work.draws.begin();
    info.sampling.rejuvenated |= rejuvenate_by_need(setup, state, work);
    let merged = state.rejuvenation.as_ref().map_or(0, |rejuvenation| rejuvenation.merged);
    info.changes.merged += merged;
    work.draws.merged += merged;
}

/// Leaves the draw that a step needs to a filter beside this one.
pub(super) fn leave_draw(state: &mut State, work: &mut Work, moment: Moment) {
    work.draws.asked = hand_over(state).map(|state| Box::new(Asked { state, moment }));
}

/// The state with all its past, for a filter that draws in place; what is left goes on without the past.
fn hand_over(state: &mut State) -> Option<State> {
    let history = state.rejuvenation.as_mut()?.history.hand_over();
    let mut whole = state.clone();
    let (ours, theirs) = (state.rejuvenation.as_mut()?, whole.rejuvenation.as_mut()?);
    (theirs.history, theirs.drawing, ours.drawing) = (history, Drawing::InPlace, Drawing::UnderWay);
    Some(whole)
}

/// Takes the past back after a step that failed.
pub(super) fn take_back(state: &mut State, asked: Asked) {
    if let (Some(ours), Some(theirs)) = (&mut state.rejuvenation, asked.state.rejuvenation) {
        if ours.drawing == Drawing::UnderWay {
            (ours.history, ours.drawing) = (theirs.history, Drawing::Beside);
        }
    }
}

/// Draws all particles anew from the posterior over paths and maps, given the best particle's associations: somebody asks
/// for it, or the log has ended. Where draws follow need it may take many times the filter's work, not any time.
///
/// Returns false, and leaves everything as it is, when the filter was not configured for it (`filter.rejuvenation`), when
/// nothing happened since the last time, when no finite solution was found, or none at that price: the map of a robot that
/// was lost all along may be a problem that is solved in hours.
pub(super) fn rejuvenate<M: Placing>(setup: &Setup<M>, state: &mut State, work: &mut Work) -> bool {
    let need = state.rejuvenation.as_ref().and_then(|rejuvenation| rejuvenation.need.as_ref());
    let effort = need.map_or(Effort::any(), |need| Effort::in_all(need.most_work_at_end()));
    rejuvenate_within(setup, state, work, &effort)
}

/// The same between two steps: not where paths are drawn by need and this draw would take too much.
fn rejuvenate_by_need<M: Placing>(setup: &Setup<M>, state: &mut State, work: &mut Work) -> bool {
    let need = state.rejuvenation.as_ref().and_then(|rejuvenation| rejuvenation.need.as_ref());
    let effort = need.map_or(Effort::any(), |need| Effort::up_to(need.most_work()));
    rejuvenate_within(setup, state, work, &effort)
}

fn rejuvenate_within<M: Placing>(setup: &Setup<M>, state: &mut State, work: &mut Work, effort: &Effort) -> bool {
    let Some(rejuvenation) = &state.rejuvenation else { return false };
    let fresh = rejuvenation.history.steps() > rejuvenation.last;
    let anew = fresh.then(|| start_anew(setup, state, work, effort)).flatten();
    let Some(rejuvenation) = &mut state.rejuvenation else { return false };
    rejuvenation.merged = anew.as_ref().map_or(0, |anew| anew.merges.len() as u32);
    if let (None, Some(refused)) = (&anew, effort.refused()) {
        rejuvenation.need.iter_mut().for_each(|need| need.refused(refused));
        return false;
    }
    rejuvenation.count += u64::from(anew.is_some());
    rejuvenation.last = rejuvenation.history.steps();
    if let Some(Anew { trajectory, merges, given }) = &anew {
        rejuvenation.history.resample(&work.ancestor_indices);
        rejuvenation.history.give(given.iter().map(|moved| (moved.sighting, moved.to)));
        if let Some(need) = &mut rejuvenation.need {
            need.drawn(effort.done(), merges, (&rejuvenation.history, trajectory));
            rejuvenation.returns = Returns::default();
        }
    }
    anew.is_some()
}

/// What a draw has found.
struct Anew {
    /// The likeliest path.
    trajectory: Trajectory,
    /// Births of landmarks that went over into others: younger, older.
    merges: Vec<[u32; 2]>,
    /// Sightings that show another landmark than was thought, or none.
    given: Vec<Moved>,
}

/// `None` when nothing was done.
fn start_anew<M: Placing>(setup: &Setup<M>, state: &mut State, work: &mut Work, effort: &Effort) -> Option<Anew> {
    let Rejuvenation { history, .. } = state.rejuvenation.as_ref()?;
    let settings = &setup.settings.config.filter.rejuvenation;
    let window = settings.window_steps.map_or(usize::MAX, |steps| steps as usize);
    let first_free = history.keyframes.first_within(window, history.steps());
    let places = places_of(&state.landmarks, state.particles.best());
    let mut graph = graph_of(setup, state, &places, first_free, effort)?;
    let trajectory = trajectory(setup, state, first_free)?;
    let mode = graph.solve(graph.guess(trajectory, |sights| places[&sights.birth].1))?;
    let (mode, misread) = leave_out_misread(setup, state, &mut graph, mode);
    let stream = stream_of(setup, state);
    let (mode, merges, moved) = close_loops(setup, state, &mut graph, mode, &places);
    let sampling = Sampling { stream, count: state.particles.len(), least: MEMBERS, spread: settings.spread };
    let drawn = draw(&graph, &mode, &sampling);
    if !drawn.last_poses.iter().all(|pose| pose.is_finite()) {
        return None;
    }
    let landmarks = graph.landmarks;
    let trajectory = mode.solution.trajectory;
    become_copies_of_best(state, work, &trajectory, &drawn);
    take_over(&mut state.landmarks, &landmarks, &drawn, &places);
    imagine_drawn(setup, state, (&landmarks, &drawn), &places);
    state.weights.restart(state.particles.len());
    propose(setup, state, &mut work.beliefs);
    estimate_beliefs(state, &work.beliefs);
    let mut unions = Unions::of(&setup.settings, state);
    merges.iter().for_each(|[younger, older]| unions.unite([older, younger].map(|birth| places[birth].0)));
    if !merges.is_empty() {
        unions.closed();
    }
    recount(state, &moved, &places);
    let misread = misread.into_iter().map(|sighting| Moved { sighting, from: NO_LANDMARK, to: NO_LANDMARK });
    Some(Anew { trajectory, merges, given: misread.chain(moved).collect() })
}

/// The mode without the sightings whose names cannot be right.
fn leave_out_misread<M: Placing>(
    setup: &Setup<M>,
    state: &State,
    graph: &mut Graph<'_, M>,
    mode: Mode,
) -> (Mode, Vec<u32>) {
    match setup.settings.identities {
        Identities::All => graph.without_misread(mode, IMPLAUSIBLE * state.diagnosis.watch.noise.usual_excess()),
        _ => (mode, Vec::new()),
    }
}

/// Random numbers of this draw.
fn stream_of<M>(setup: &Setup<M>, state: &State) -> Stream {
    let count = state.rejuvenation.as_ref().map_or(0, |rejuvenation| rejuvenation.count);
    setup.settings.random.stream(Purpose::Rejuvenation, count)
}

/// The least-squares problem over the best particle's past; poses before the step `first_free` stand still.
fn graph_of<'a, M: Placing>(
    setup: &'a Setup<M>,
    state: &'a State,
    places: &FxHashMap<u32, Place>,
    first_free: usize,
    effort: &'a Effort,
) -> Option<Graph<'a, M>> {
    Some(Graph {
        history: &state.rejuvenation.as_ref()?.history,
        models: &setup.models.all,
        mountings: &setup.models.mountings,
        likelihood_exponent: setup.settings.config.filter.likelihood_exponent,
        first_free,
        landmarks: sights(state, places, first_free)?,
        effort,
    })
}

/// The landmarks of the best particle with its sightings of them, those of a given map first; only those seen in a step
/// that is drawn anew.
fn sights(state: &State, places: &FxHashMap<u32, Place>, first_free: usize) -> Option<Vec<Sights>> {
    let mut seen = state.rejuvenation.as_ref()?.history.seen_by(state.particles.best());
    for sight in &mut seen {
        sight.birth = state.merger.present_name(sight.birth, |birth| places.contains_key(&birth));
    }
    let fading = state.landmarks.fading.as_ref();
    let may_exist = |birth: u32| fading.is_none_or(|fading| fading.may_exist(birth.into()));
    let mut landmarks = by_landmark(&seen, |birth| places.contains_key(&birth) && may_exist(birth));
    landmarks.retain(|sights| sights.seen.last().is_some_and(|last| last.step as usize >= first_free));
    put_given_first(state, &mut landmarks, places);
    Some(landmarks)
}

/// Puts the landmarks of a given map before the others, with what is known of them: those too that were not seen, since
/// others may turn out to be one with them.
fn put_given_first(state: &State, landmarks: &mut Vec<Sights>, places: &FxHashMap<u32, Place>) {
    let given = &state.given;
    if given.landmarks.is_empty() {
        return;
    }
    let seen: FxHashSet<u32> = landmarks.iter().map(|sights| sights.birth).collect();
    let unseen = (0..given.landmarks.len() as u32).filter(|birth| !seen.contains(birth) && places.contains_key(birth));
    landmarks.extend(unseen.map(|birth| Sights { birth, known: Known::Nothing, seen: Vec::new() }));
    landmarks.iter_mut().for_each(|sights| sights.known = given.known(sights.birth.into()));
    landmarks.sort_by_key(|sights| sights.known == Known::Nothing);
}

/// The best particle's path, joined where the last draw ended; `None` where it lacks steps.
fn trajectory<M>(setup: &Setup<M>, state: &State, first_free: usize) -> Option<Trajectory> {
    let Rejuvenation { history, count, last, .. } = state.rejuvenation.as_ref()?;
    let path = state.path.path(state.particles.best());
    let poses: Vec<Pose> = path.into_iter().map(|(_, pose)| pose).collect();
    let poses = history.keyframes.of(&poses, history.steps())?;
    let drawn = (*count > 0).then(|| last.saturating_sub(1));
    // What is held must not be moved.
    let drawn = drawn.filter(|step| *step >= first_free);
    Some(Trajectory::joined(state.start(&setup.settings.config), poses, drawn, history))
}

/// Closes the loops that the best particle has missed, if the configuration wants that.
fn close_loops<M: Placing>(
    setup: &Setup<M>,
    state: &State,
    graph: &mut Graph<'_, M>,
    mode: Mode,
    places: &FxHashMap<u32, Place>,
) -> (Mode, Vec<[u32; 2]>, Vec<Moved>) {
    let (settings, association) = (&setup.settings.config.filter.rejuvenation, &setup.settings.config.association);
    if settings.closing_odds == 0.0 || setup.settings.identities == Identities::All {
        return (mode, Vec::new(), Vec::new());
    }
    let best = state.particles.best();
    let evidence = |births: [u32; 2]| {
        let [older, younger] = births.map(|birth| places[&birth].0);
        // Two of a given map are two, whatever lies between them.
        let apart = state.landmarks.is_named(younger, best) || state.given.of(births[1].into()).is_some();
        let looks = state.landmarks.appearances.as_ref();
        (!apart).then(|| looks.map_or(0.0, |looks| looks.evidence_of_one([older, younger], best)))
    };
    let closing = Closing {
        log_odds: math::ln(settings.closing_odds),
        odds_outweigh_misfit: settings.every_steps.is_none(),
        tolerance_m2: association.merging.tolerance_std_m * association.merging.tolerance_std_m,
        evidence: &evidence,
    };
    let stream = stream_of(setup, state);
    // Particles have lower numbers.
    let normal = |size, pass: usize| {
        let mut numbers = vec![[0.0; LANES]; size];
        let sampling = Sampling { stream, count: LANES, least: 0, spread: 1.0 };
        fill_normal(&mut numbers, &sampling, u32::MAX - ((pass + 1) * LANES) as u32);
        numbers
    };
    let (mode, mut merges) = graph.close_loops(mode, &closing, normal);
    let (mode, SecondThoughts { moved, gone_over }) = graph.reassociate(mode, &closing, |size| normal(size, PASSES));
    merges.extend(gone_over);
    (mode, merges, moved)
}

/// Slot and mean of every landmark in one map, by birth.
fn places_of(landmarks: &Landmarks, particle: usize) -> FxHashMap<u32, Place> {
    let mut row = vec![0.0; landmarks.columns()];
    let mut places = FxHashMap::default();
    for slot in landmarks.live_slots() {
        if landmarks.read_row(slot, particle, &mut row) {
            places.insert(landmarks.birth(slot) as u32, (slot, Planar::mean_of(&row)));
        }
    }
    places
}

/// Makes every particle a copy of the best one, with its own draw in place of poses.
fn become_copies_of_best(state: &mut State, work: &mut Work, trajectory: &Trajectory, drawn: &Drawn) {
    let (count, best) = (state.particles.len(), state.particles.best());
    work.ancestor_indices.clear();
    work.ancestor_indices.resize(count, best as u32);
    state.particles.resample(&work.ancestor_indices);
    state.landmarks.resample(&work.ancestor_indices);
    state.path.resample(&work.ancestor_indices);
    if let Some(rejuvenation) = &state.rejuvenation {
        let before: Vec<Pose> = state.path.path(best).into_iter().map(|(_, pose)| pose).collect();
        let path = rejuvenation.history.keyframes.fill(trajectory.start, &before, &trajectory.poses);
        state.path.replace(&path, |i| drawn.last_poses[i]);
    }
    for (i, pose) in drawn.last_poses[..count].iter().enumerate() {
        state.particles.set_pose(i, *pose);
    }
}

/// Counts the sightings that went over from one landmark to another, or to none, where they belong now.
fn recount(state: &mut State, moved: &[Moved], places: &FxHashMap<u32, Place>) {
    let mut more: FxHashMap<u32, f64> = FxHashMap::default();
    let is_held =
        |birth: u32| state.landmarks.slot(places[&birth].0).is_some_and(|slot| slot.birth == u64::from(birth));
    for one in moved {
        let name = |birth: u32| if birth == NO_LANDMARK { birth } else { state.merger.present_name(birth, is_held) };
        let [from, to] = [one.from, one.to].map(name);
        if from != to {
            *more.entry(from).or_default() -= 1.0;
            *more.entry(to).or_default() += 1.0;
        }
    }
    more.retain(|birth, _| *birth != NO_LANDMARK && is_held(*birth));
    for (birth, more) in more {
        state.landmarks.update(places[&birth].0, None, |mut rows| {
            rows.column(Planar::SIGHTINGS).iter_mut().for_each(|count| *count = (*count + more).max(1.0));
        });
    }
}

/// Puts every particle's draw of the landmarks into its map.
fn take_over(maps: &mut Landmarks, landmarks: &[Sights], drawn: &Drawn, places: &FxHashMap<u32, Place>) {
    for (sights, gaussians) in landmarks.iter().zip(drawn.landmarks.chunks_exact(drawn.last_poses.len())) {
        if !sights.seen.is_empty() && !matches!(sights.known, Known::Place(_)) {
            maps.update(places[&sights.birth].0, None, |rows| put(gaussians, rows));
        }
    }
}

/// Puts what was drawn of a landmark into its rows.
fn put(gaussians: &[Gaussian], mut rows: RowsMut<'_>) {
    let particles = rows.column(Planar::SIGHTINGS).len();
    for (i, gaussian) in gaussians.iter().enumerate().take(particles) {
        // A landmark at the sensor has no direction; it stays what it was.
        if gaussian.is_usable() {
            Planar::put(gaussian, &mut rows, i);
        }
    }
}
