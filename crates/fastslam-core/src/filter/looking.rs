//! Looks for the landmarks that a scan should have shown, and removes those that have faded.

use super::doubtful::is_vouched_for;
use super::fading::Look;
use super::landmarks::Landmarks;
use super::setup::Setup;
use super::state::State;
use super::work::{Claims, Judging};
use crate::association::{Box2, Decision};
use crate::gaussian::{ellipse_area, innovation_covariance};
use crate::geometry::{Pose, Symmetric2};
use crate::landmark::{column, Gaussian, Planar};
use crate::math;
use crate::measurement::Placing;

/// What is sighted hides what is farther away and so near to its direction, beside the bearing's own error.
const HIDES_RAD: f64 = 0.02;

impl Claims<'_> {
    /// Whether a particle claims that the scan shows a landmark.
    fn shows(&self, particle: usize, slot: u32) -> bool {
        let shown = |claim: &Decision| matches!(claim, Decision::Landmark(c) if self.table.slots[*c as usize] == slot);
        self.of(particle).iter().any(shown)
    }

    /// Whether something nearer in the same direction was sighted, or something of which nobody knows how far it is.
    fn hides<M: Placing>(&self, model: &M, [range_m, bearing_rad]: [f64; 2]) -> bool {
        let [tells_range, tells_bearing] = model.measures();
        tells_bearing
            && self.scan.iter().any(|sighting| {
                let ([nearer_m, towards_rad], noise) = (sighting.measured.value, sighting.measured.noise);
                let aside_rad = math::wrap_angle(towards_rad - bearing_rad).abs();
                (!tells_range || nearer_m + 3.0 * noise.xx.sqrt() < range_m)
                    && aside_rad < HIDES_RAD + 2.0 * noise.yy.sqrt()
            })
    }
}

/// Looks for every landmark that the scan should have shown, and removes those that have faded; returns how many the best
/// particle lost.
pub(super) fn fade_unconfirmed<M: Placing>(
    setup: &Setup<M>,
    state: &mut State,
    claims: Claims<'_>,
    first_birth: u64,
    judging: &mut Judging,
) -> u32 {
    let sensor = sensor_of(setup, state, state.particles.best());
    let Some(fading) = &mut state.landmarks.fading else { return 0 };
    fading.scanned();
    if !fading.begins(sensor) {
        return 0;
    }
    let mut region = Box2::EMPTY;
    region.include([sensor.x, sensor.y], fading.far_m());
    list_in_reach(&mut state.landmarks, &region, first_birth, &mut judging.in_reach);
    let Judging { in_reach, looks, row, .. } = judging;
    row.resize(state.landmarks.columns(), 0.0);
    looks.clear();
    looks.extend(in_reach.iter().filter_map(|slot| look_for(setup, state, *slot, claims, row)));
    let mut removed = 0;
    for look in looks {
        let (birth, vouched_for) = (state.landmarks.birth(look.slot), is_vouched_for(state, look.slot));
        if state.landmarks.fading.as_mut().is_some_and(|fading| fading.looked(birth, look, vouched_for)) {
            removed += u32::from(remove_everywhere(state, look.slot));
        }
    }
    removed
}

/// Lists the landmarks in a region that there were before the scan, in the order of birth.
fn list_in_reach(landmarks: &mut Landmarks, region: &Box2, first_birth: u64, in_reach: &mut Vec<u32>) {
    in_reach.clear();
    landmarks.find(region, in_reach);
    in_reach.retain(|slot| landmarks.birth(*slot) < first_birth);
    in_reach.sort_unstable_by_key(|slot| landmarks.birth(*slot));
    in_reach.dedup();
}

/// A look at one landmark, as the best particle has it, or the first one that has it; `None` where it is not in view, or
/// may be hidden.
fn look_for<M: Placing>(
    setup: &Setup<M>,
    state: &mut State,
    slot: u32,
    claims: Claims<'_>,
    row: &mut [f64],
) -> Option<Look> {
    let holder = holder(state, slot, row)?;
    let (sensor, mean) = (sensor_of(setup, state, holder), Planar::mean_of(row));
    let [ahead, left] = sensor.inverse().transform(mean);
    let seen_at = [ahead.hypot(left), math::atan2(left, ahead)];
    let place = state.landmarks.fading.as_ref()?.place(seen_at)?;
    let sighted = claims.shows(holder, slot);
    let model = setup.models.measurement();
    if !sighted && claims.hides(model, seen_at) {
        return None;
    }
    let Gaussian { covariance, .. } = Planar::gaussian_of(row);
    let by_landmark = model.linearize(sensor, mean).by_landmark;
    let innovation = innovation_covariance(by_landmark, covariance, model.noise_covariance());
    let gate_area = gate_area(setup, innovation);
    let association = &setup.settings.config.association;
    let is_often_sighted = row[column::SIGHTINGS] >= f64::from(association.existence.confirmed_sightings);
    let told_detection = association.detection_probability;
    Some(Look { slot, place, sighted, gate_area, is_often_sighted, told_detection })
}

/// Area in which a sighting is taken for a landmark, m·rad: of what is not measured all counts.
fn gate_area<M: Placing>(setup: &Setup<M>, innovation: Symmetric2) -> f64 {
    let (model, gate) = (setup.models.measurement(), setup.settings.rules.gate);
    let strip = |variance: f64| 2.0 * (gate * variance).sqrt() * model.unmeasured_extent();
    match model.measures() {
        [true, true] => ellipse_area(gate, innovation.determinant()),
        [true, false] => strip(innovation.xx),
        [false, _] => strip(innovation.yy),
    }
}

/// Where the sensor is in one particle.
fn sensor_of<M>(setup: &Setup<M>, state: &State, particle: usize) -> Pose {
    state.particles.pose(particle).compose(setup.models.T_robot_sensor)
}

/// A particle that has the landmark, if possible the best one; its row then stands in `row`.
fn holder(state: &mut State, slot: u32, row: &mut [f64]) -> Option<usize> {
    let best = state.particles.best();
    if state.landmarks.read_row(slot, best, row) {
        return Some(best);
    }
    let holder = state.landmarks.read(slot).column(column::SIGHTINGS).iter().position(|count| *count != 0.0)?;
    state.landmarks.read_row(slot, holder, row).then_some(holder)
}

/// Removes a landmark from all maps; returns whether the best particle lost it.
fn remove_everywhere(state: &mut State, slot: u32) -> bool {
    let counts = state.landmarks.read(slot).column(column::SIGHTINGS);
    let held: Vec<bool> = counts.iter().map(|count| *count != 0.0).collect();
    state.maps().lose(slot, &held);
    held[state.particles.best()]
}
