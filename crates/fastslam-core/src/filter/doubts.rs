//! When paths must be drawn anew: when the filter is about to decide, or has decided, what its particles cannot know.
//!
//! - *A loop in sight*: an old landmark may be in view, the way since it was last seen is long enough for others to be
//!   meant, and the particles have forgotten most of that way (they descend from one or two). A draw first gives them
//!   back their spread.
//! - *Ambiguous landmarks*: where particles disagree so much about the place of an old landmark that others are as likely
//!   to lie there, none of them decides. The sighting founds a landmark, and joint evidence decides at a draw.
//! - *Suspects*: landmarks founded where an old one may lie. A few together are enough to close a loop.
//!
//! All draws together are allowed twice the work of the filter itself, counted by sizes, not by the clock.

use super::beliefs::Beliefs;
use super::landmarks::Landmarks;
use super::need::Need;
use super::settings::Algorithm;
use super::setup::Setup;
use super::state::{Drawing, Maps, Rejuvenation, State};
use crate::association::{area_m2, disagreement_m2, CandidateTable, ScanSighting, GATE};
use crate::gaussian::mahalanobis_squared;
use crate::geometry::{Pose, Symmetric2};
use crate::landmark::Planar;
use crate::measurement::Placing;

/// A landmark is ambiguous where so many others are expected within the region (99 %) in which it may lie.
const MOST_RIVALS: f64 = 0.05;
/// Particles know better than the sensor where to look for a landmark as long as it may lie in no more than so many
/// areas that one of them looks at: twice the sensor's error in each direction.
const MOST_GATES: f64 = 4.0;

/// An old landmark whose place odometry alone does not know well enough.
pub(super) struct Doubt {
    candidate: u32,
    /// Landmarks around, per square metre.
    density: f64,
    /// Area in which one particle looks for it.
    gate_m2: f64,
    /// Steps since it was seen.
    ago: usize,
}

/// Candidates that odometry alone cannot tell from others; none where paths are not drawn by need.
pub(super) fn about<M: Placing>(setup: &Setup<M>, state: &mut State, table: &CandidateTable) -> Vec<Doubt> {
    Knowledge::of(setup, state).map_or(Vec::new(), |mut knowledge| knowledge.doubts(table))
}

/// Whether a draw is needed first, since the particles go back to one at the half of the way since some of these
/// landmarks were seen, and to one at the last draw.
pub(super) fn ask_for_draw<M>(setup: &Setup<M>, state: &State, doubts: &[Doubt]) -> bool {
    let at_it = |rejuvenation: &&Rejuvenation| rejuvenation.drawing == Drawing::UnderWay;
    let Some(rejuvenation) = state.rejuvenation.as_ref().filter(|r| !at_it(r)) else { return false };
    let Some(need) = rejuvenation.need.as_ref().filter(|need| need.is_affordable()) else { return false };
    let Some(longest) = doubts.iter().map(|doubt| doubt.ago).max() else { return false };
    setup.settings.config.algorithm == Algorithm::Fastslam2
        && rejuvenation.history.is_between_steps()
        && have_forgotten(state, need, longest)
}

/// Whether the particles go back to one at the half of the way of so many steps, and to one at the last draw.
pub(super) fn have_forgotten(state: &State, need: &Need, steps: usize) -> bool {
    let last_draw = state.rejuvenation.as_ref().map_or(0, |rejuvenation| rejuvenation.last);
    let since_draw = need.drift.steps() - last_draw.min(need.drift.steps());
    state.path.distinct_ancestors((steps / 2).min(since_draw)) < 2
}

/// Takes the landmarks from the candidates that no particle can tell from others; what they explain founds landmarks,
/// which a draw joins with them if the evidence says so. Who is named needs no telling.
pub(super) fn strike_out(
    doubts: &[Doubt],
    beliefs: &Beliefs,
    landmarks: &Landmarks,
    scan: &[ScanSighting],
    table: &mut CandidateTable,
) {
    if doubts.is_empty() {
        return;
    }
    let [x, y, heading, ..] = beliefs.outline();
    let mut ambiguous = vec![false; table.slots.len()];
    for doubt in doubts {
        let area_m2 = disagreement_m2([x, y, heading], &table.rows(doubt.candidate)).unwrap_or(0.0);
        ambiguous[doubt.candidate as usize] = is_ambiguous(area_m2, doubt.density, doubt.gate_m2);
    }
    let CandidateTable { slots, of_sighting, .. } = table;
    for (sighting, found) in scan.iter().zip(of_sighting) {
        let named = sighting.identity.map_or(&[][..], |identity| landmarks.of_identity(identity));
        found.retain(|c| !ambiguous[*c as usize] || named.contains(&slots[*c as usize]));
    }
}

/// Takes note of what the best particle sighted and founded in a scan.
pub(super) fn note_need<M: Placing>(
    setup: &Setup<M>,
    state: &mut State,
    scan: &[ScanSighting],
    matched: &[u32],
    founded: &[u32],
) {
    let Some(mut knowledge) = Knowledge::of(setup, state) else { return };
    let suspects = founded.iter().filter(|slot| knowledge.is_suspect(**slot)).count();
    let State { rejuvenation, landmarks, particles, given, .. } = state;
    let Some(need) = rejuvenation.as_mut().and_then(|rejuvenation| rejuvenation.need.as_mut()) else { return };
    need.scanned(scan.len(), particles.len());
    need.suspects += suspects as u32;
    for slot in matched.iter().chain(founded) {
        need.sighted(given.clan(landmarks.birth(*slot)) as u32);
    }
}

/// Whether a landmark that may lie anywhere in an area is one of several, and most particles look beside it.
pub(super) fn is_ambiguous(area_m2: f64, density: f64, sensor_m2: f64) -> bool {
    area_m2 > MOST_GATES * sensor_m2 && area_m2 * density > MOST_RIVALS
}

/// The maps with what is known of how far odometry may be off.
struct Knowledge<'a, M> {
    setup: &'a Setup<M>,
    maps: Maps<'a>,
    need: &'a Need,
}

impl<'a, M: Placing> Knowledge<'a, M> {
    /// Where paths are drawn by need.
    fn of(setup: &'a Setup<M>, state: &'a mut State) -> Option<Self> {
        let State { rejuvenation, particles, landmarks, given, .. } = state;
        let Rejuvenation { need, .. } = rejuvenation.as_ref()?;
        Some(Self { setup, maps: Maps { particles, landmarks, given }, need: need.as_ref()? })
    }

    fn doubts(&mut self, table: &CandidateTable) -> Vec<Doubt> {
        let Maps { particles, landmarks, given } = &mut self.maps;
        let best = particles.best();
        let (known, pose) = (particles.landmarks[best] as usize, particles.pose(best));
        let mut doubts = Vec::new();
        for (candidate, &slot) in table.slots.iter().enumerate() {
            let (candidate, birth) = (candidate as u32, landmarks.birth(slot));
            if given.is_sure(birth) {
                continue;
            }
            let Some(at) = table.gaussian(candidate, best).map(|g| g.mean) else { continue };
            let (covariance, ago) = self.need.relation(given.clan(birth), at);
            let area_m2 = area_m2(covariance.determinant());
            let gate_m2 = gate_m2(self.setup, at, pose);
            if !is_ambiguous(area_m2, f64::INFINITY, gate_m2) {
                continue;
            }
            let density = landmarks.density((best, known), at, area_m2.sqrt());
            if is_ambiguous(area_m2, density, gate_m2) {
                doubts.push(Doubt { candidate, density, gate_m2, ago });
            }
        }
        doubts
    }

    /// Whether an older landmark may lie where this one was founded.
    fn is_suspect(&mut self, founded: u32) -> bool {
        let Maps { particles, landmarks, given } = &mut self.maps;
        let (best, need) = (particles.best(), self.need);
        let mut row = vec![0.0; landmarks.columns()];
        if !landmarks.read_row(founded, best, &mut row) {
            return false;
        }
        let at = Planar::mean_of(&row);
        let birth = landmarks.birth(founded);
        let sensor = self.setup.models.measurement().noise_covariance().scaled(2.0);
        let max_range_m = self.setup.settings.config.sensor.common().max_range_m;
        let tolerance = sensor.xx.max(sensor.yy * max_range_m.powi(2));
        let farthest = need.drift.of_place(at, 0).largest_eigenvalue() + tolerance;
        let reach_m = (GATE * farthest).sqrt().min(max_range_m);
        let near = landmarks.places_near(best, at, reach_m);
        near.into_iter().any(|(slot, place)| {
            let older = given.clan(landmarks.birth(slot));
            if older >= birth || need.last_seen.get(older as usize).is_some_and(|s| *s as usize >= need.drift.steps()) {
                return false;
            }
            let (c, _) = need.relation(older, place);
            let spread = Symmetric2::new(c.xx + tolerance, c.xy, c.yy + tolerance);
            mahalanobis_squared([place[0] - at[0], place[1] - at[1]], spread) <= GATE
        })
    }
}

/// Area in which a particle looks for a landmark that it expects here, square metres.
pub(super) fn gate_m2<M: Placing>(setup: &Setup<M>, at: [f64; 2], from: Pose) -> f64 {
    let range_m = (at[0] - from.x).hypot(at[1] - from.y);
    let noise = setup.models.measurement().noise_covariance();
    let exponent = setup.settings.config.filter.likelihood_exponent;
    // What is not measured counts as measured as well as the other: a strip as long as the view would leave nothing in doubt.
    let product = match setup.models.measurement().measures() {
        [true, true] => noise.xx * noise.yy,
        [true, false] => noise.xx * noise.xx / (range_m * range_m),
        [false, _] => range_m * noise.yy * range_m * noise.yy,
    };
    area_m2(product) * range_m / exponent
}
