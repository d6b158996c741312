//! Looks at some scans before the filter uses them: what it predicted of their sightings, and what came.

use super::landmarks::Landmarks;
use super::settings::Algorithm;
use super::setup::Setup;
use super::state::State;
use super::work::{Examination, Pair, Prediction, Work, SUBSET};
use crate::association::{by_robot_pose, Box2, Decision, Identities, ScanSighting};
use crate::diagnosis::innovations::{PredictedScan, JOINT_MAX};
use crate::diagnosis::looks::{InView, MapInView};
use crate::diagnosis::Returns;
use crate::gaussian::innovation_covariance;
use crate::landmark::{column, Gaussian, Planar};
use crate::measurement::Placing;

/// A landmark seen less often than this may be clutter, of which nobody expects to see it again.
const SIGHTINGS_TO_COUNT: f64 = 3.0;

/// Looks at what the filter predicted of the sightings of a scan, and at what came, before poses and maps change.
///
/// What the particles decided is looked at as the one has it that explains all best, the scan included; names are
/// known before.
pub(super) fn examine<M: Placing>(setup: &Setup<M>, state: &mut State, work: &mut Work, scan: &[ScanSighting]) {
    if setup.settings.identities == Identities::All {
        examine_named(setup, state, work, scan);
    } else {
        let best = state.particles.best_with(&work.log_likelihood);
        examine_decided(setup, state, work, scan, best);
    }
}

/// Examines a scan whose sightings all name their landmark.
fn examine_named<M: Placing>(setup: &Setup<M>, state: &mut State, work: &mut Work, scan: &[ScanSighting]) {
    let Work { examination, associating, .. } = work;
    let Examination { matches, known, particles, pairs, .. } = examination;
    known.clear();
    known.extend(associating.named.iter().enumerate().filter_map(|(j, slot)| Some((j, (*slot)?))));
    matches.clear();
    matches.extend(known.iter().map(|(j, slot)| (scan[*j].measured.value, state.landmarks.birth(*slot))));
    complete(setup, state, matches, known.iter().map(|(_, slot)| *slot));
    state.diagnosis.watch.matched(matches.iter().copied(), scan.len());
    if !state.diagnosis.watch.examines() || known.is_empty() {
        return;
    }
    choose_subset(state.particles.len(), particles);
    pairs.clear();
    for place in spread(known.len(), state.diagnosis.watch.examinations()) {
        let (j, slot) = known[place];
        let rows = state.landmarks.read(slot);
        pairs.push((scan[j].measured, of_subset(particles, |i| Planar::gaussian_in(&rows, i))));
    }
    score(setup, state, examination, state.particles.best());
}

/// Examines a scan after the particles decided what it shows.
fn examine_decided<M: Placing>(
    setup: &Setup<M>,
    state: &mut State,
    work: &mut Work,
    scan: &[ScanSighting],
    best: usize,
) {
    let Work { examination, associating, .. } = &mut *work;
    let claims = associating.claims(scan);
    let known = claims.of(best).iter().enumerate().filter_map(|(j, decision)| match decision {
        Decision::Landmark(candidate) => Some((j, *candidate)),
        _ => None,
    });
    examination.known.clear();
    examination.known.extend(known);
    let Examination { matches, known, .. } = examination;
    matches.clear();
    let birth = |candidate: u32| state.landmarks.birth(claims.table.slots[candidate as usize]);
    matches.extend(known.iter().map(|(j, candidate)| (scan[*j].measured.value, birth(*candidate))));
    complete(setup, state, matches, known.iter().map(|(_, candidate)| claims.table.slots[*candidate as usize]));
    state.diagnosis.watch.matched(matches.iter().copied(), scan.len());
    if !state.diagnosis.watch.examines() || scan.is_empty() {
        return;
    }
    look_at_map(setup, state, work, best);
    let (examination, claims) = (&mut work.examination, work.associating.claims(scan));
    let Examination { known, particles, pairs, .. } = examination;
    if known.is_empty() {
        return;
    }
    let chosen = || spread(known.len(), state.diagnosis.watch.examinations()).map(|place| known[place]);
    choose_subset(state.particles.len(), particles);
    particles.retain(|i| chosen().all(|(j, candidate)| claims.of(*i)[j] == Decision::Landmark(candidate)));
    let landmarks = |candidate| of_subset(particles, |i| claims.table.gaussian(candidate, i));
    pairs.clear();
    pairs.extend(chosen().map(|(j, candidate)| (scan[j].measured, landmarks(candidate))));
    score(setup, state, examination, best);
}

/// Completes sightings of known landmarks, in these slots, by where the best particle has them.
fn complete<M: Placing>(
    setup: &Setup<M>,
    state: &State,
    matches: &mut [([f64; 2], u64)],
    slots: impl Iterator<Item = u32>,
) {
    for ((value, _), slot) in matches.iter_mut().zip(slots) {
        *value = completed(setup, state, slot, *value);
    }
}

/// A sighting of the landmark in this slot, with what the sensor does not measure as the best particle has it.
pub(super) fn completed<M: Placing>(setup: &Setup<M>, state: &State, slot: u32, value: [f64; 2]) -> [f64; 2] {
    let model = setup.models.measurement();
    if model.places() {
        return value;
    }
    let best = state.particles.best();
    let sensor = state.belief_of(setup.settings.config.algorithm, best).mean.compose(setup.models.T_robot_sensor);
    let held = state.landmarks.held_by(best, slot);
    held.map_or(value, |(held, _)| model.completed(value, model.expected(sensor, held.mean)))
}

/// Counts the landmarks of the best particle's map that the scan should have shown, and those that it did.
fn look_at_map<M>(setup: &Setup<M>, state: &mut State, work: &mut Work, best: usize) {
    let Work { examination, associating, beliefs, map_in_view, .. } = work;
    let Examination { known, sighted, in_reach, row, .. } = examination;
    let State { landmarks, diagnosis, .. } = state;
    let (view, pose) = (diagnosis.watch.view(), beliefs.get(best).mean);
    if !diagnosis.watch.looks_from(pose) {
        return;
    }
    let sensor = pose.compose(setup.models.T_robot_sensor);
    let mut region = Box2::EMPTY;
    region.include([sensor.x, sensor.y], view.far_m);
    in_reach.clear();
    landmarks.find(&region, in_reach);
    row.resize(landmarks.columns(), 0.0);
    sighted.clear();
    sighted.resize(associating.table.slots.len(), false);
    known.iter().for_each(|(_, candidate)| sighted[*candidate as usize] = true);
    let (outlook, mut in_view) = (view.from(pose), MapInView::default());
    let near = diagnosis.watch.reach();
    for &slot in &*in_reach {
        let birth = landmarks.birth(slot);
        let counts =
            |row: &[f64]| diagnosis.watch.kept_map().holds(birth) || row[column::SIGHTINGS] >= SIGHTINGS_TO_COUNT;
        if !landmarks.read_row(slot, best, row) || !counts(row) || !outlook.contains(Planar::mean_of(row)) {
            continue;
        }
        let sighted = associating.table.candidate_of(slot).is_some_and(|candidate| sighted[candidate as usize]);
        diagnosis.watch.looked(&mut in_view, InView { birth, sighted });
        if near.as_ref().is_some_and(|near| near.from(pose).contains(Planar::mean_of(row))) {
            diagnosis.watch.looked_at_kept(birth, sighted);
        }
    }
    *map_in_view = Some(in_view);
}

/// What came of the returns to the landmarks of the best particle's map that are no clutter.
pub(super) fn returns(state: &State) -> Returns {
    let best = state.particles.best();
    let landmarks: &Landmarks = &state.landmarks;
    let mut row = vec![0.0; landmarks.columns()];
    let known = landmarks
        .live_slots()
        .into_iter()
        .filter(|slot| landmarks.read_row(*slot, best, &mut row) && row[column::SIGHTINGS] >= SIGHTINGS_TO_COUNT);
    state.diagnosis.watch.returns(known.map(|slot| landmarks.birth(slot)))
}

/// Some of so many particles, evenly spaced.
fn choose_subset(count: usize, particles: &mut Vec<usize>) {
    let size = count.min(SUBSET);
    particles.clear();
    particles.extend((0..size).map(|k| k * count / size));
}

/// Scores sightings (value and noise) of landmarks, given as each particle of the subset has them.
fn score<M: Placing>(setup: &Setup<M>, state: &mut State, examination: &mut Examination, best: usize) {
    let Examination { particles, pairs, predictions, .. } = examination;
    predictions.clear();
    predictions.extend(particles.iter().enumerate().filter_map(|(row, i)| prediction(setup, state, (*i, row), pairs)));
    if let Some(mut scan) = mixture(predictions) {
        let heading = state.belief_of(setup.settings.config.algorithm, best).mean.heading;
        scan.motion = state.motions.since_scan.covariances_in_world(heading);
        state.diagnosis.watch.noise.add(&scan);
    }
}

/// What one particle predicts; `None` where it lacks a landmark or has no weight.
fn prediction<M: Placing>(
    setup: &Setup<M>,
    state: &State,
    (particle, row): (usize, usize),
    pairs: &[Pair],
) -> Option<Prediction> {
    let (model, algorithm) = (setup.models.measurement(), setup.settings.config.algorithm);
    let weight = state.weights.values[particle];
    let belief = state.belief_of(algorithm, particle);
    let sensor = belief.mean.compose(setup.models.T_robot_sensor);
    let mut scan = PredictedScan::of_sightings(pairs.len(), model.measures());
    for (j, (measured, landmarks)) in pairs.iter().enumerate() {
        let landmark = landmarks[row]?;
        let linear = model.linearize(sensor, landmark.mean);
        let rows = by_robot_pose(linear.by_pose, belief.mean, sensor);
        let innovation = model.innovation(measured.value, linear.expected);
        let q = innovation_covariance(linear.by_landmark, landmark.covariance, measured.noise);
        scan.predict(j, (innovation, q), measured.noise, &rows);
    }
    // In FastSLAM 1.0 the spread of the particles holds what their motion added.
    if algorithm != Algorithm::Fastslam1 {
        scan.add_uncertain_pose(&belief.covariance);
    }
    (weight > 0.0).then_some(Prediction { weight, scan })
}

/// The landmark of each of these particles.
fn of_subset(particles: &[usize], of: impl Fn(usize) -> Option<Gaussian>) -> [Option<Gaussian>; SUBSET] {
    std::array::from_fn(|row| particles.get(row).and_then(|i| of(*i)))
}

/// The prediction of all particles together: mean innovation; covariance within plus between them.
///
/// **Why:** one particle's own covariance is too small: its pose is a sample. The spread of n particles is n / (n − 1)
/// times that of their sample, and their mean is itself uncertain by an n-th of it.
fn mixture(predictions: &[Prediction]) -> Option<PredictedScan> {
    let total: f64 = predictions.iter().map(|p| p.weight).sum();
    let first = predictions.first()?;
    let size = first.scan.size;
    let PredictedScan { noise, by_pose, component, .. } = first.scan;
    let mut mixed = PredictedScan { size, component, noise, by_pose, ..PredictedScan::default() };
    let mut concentration = 0.0;
    for Prediction { weight, scan } in predictions {
        let share = weight / total;
        concentration += share * share;
        for i in 0..size {
            mixed.innovation[i] += share * scan.innovation[i];
            for j in 0..size {
                mixed.covariance[i][j] += share * scan.covariance[i][j];
            }
        }
    }
    if concentration < 1.0 - 1e-9 {
        let inflation = (1.0 + concentration) / (1.0 - concentration) / total;
        for Prediction { weight, scan } in predictions {
            let d: [f64; 2 * JOINT_MAX] = std::array::from_fn(|i| scan.innovation[i] - mixed.innovation[i]);
            for i in 0..size {
                for j in 0..size {
                    mixed.covariance[i][j] += inflation * weight * d[i] * d[j];
                }
            }
        }
    }
    Some(mixed)
}

/// Up to [`JOINT_MAX`] of `count` places, evenly spaced; another first one at every examination.
fn spread(count: usize, examination: u64) -> impl Iterator<Item = usize> {
    let size = count.min(JOINT_MAX);
    let first = examination as usize % count;
    (0..size).map(move |k| (first + k * count / size) % count)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_are_different_and_take_turns() {
        let mut seen = [0; 7];
        for examination in 0..28 {
            let places: Vec<usize> = spread(7, examination).collect();
            let mut unique = places.clone();
            unique.sort_unstable();
            unique.dedup();
            assert_eq!((places.len(), unique.len()), (JOINT_MAX, JOINT_MAX));
            places.iter().for_each(|place| seen[*place] += 1);
        }
        assert_eq!(seen, [16; 7]);
        assert_eq!(spread(2, 2).collect::<Vec<_>>(), vec![0, 1]);
    }

    #[test]
    fn the_mixture_adds_between_to_within_without_bias() {
        let prediction = |innovation: f64| {
            let mut scan = PredictedScan { size: 2, ..PredictedScan::default() };
            scan.innovation[0] = innovation;
            scan.covariance[0][0] = 0.5;
            scan.covariance[1][1] = 1.0;
            Prediction { weight: 0.2, scan }
        };
        let mixed = mixture(&[prediction(1.0), prediction(3.0)]).unwrap();
        // Mean 2; sample variance with n - 1 is 2, and the mean is uncertain by half of that.
        assert!((mixed.innovation[0] - 2.0).abs() < 1e-12);
        assert!((mixed.covariance[0][0] - (0.5 + 2.0 + 1.0)).abs() < 1e-12, "{}", mixed.covariance[0][0]);
        assert_eq!(mixture(&[prediction(1.0)]).unwrap().covariance[0][0], 0.5);
    }
}
