//! Looks for the landmarks that a scan should have shown, and removes those that have faded.

use super::fading::Look;
use super::work::Claims;
use super::{FastSlam, StepInfo};
use crate::association::{Box2, Decision};
use crate::geometry::{Pose, Symmetric2};
use crate::landmark::{column, innovation_covariance};
use crate::math;
use crate::measurement::MeasurementModel;
use std::f64::consts::PI;

/// What is sighted hides what is farther away and so near to its direction, beside the bearing's own error.
const HIDES_RAD: f64 = 0.02;

impl Claims<'_> {
    /// Whether a particle claims that the scan shows a landmark.
    fn shows(&self, particle: usize, slot: u32) -> bool {
        let mine = &self.decisions[particle * self.scan.len()..][..self.scan.len()];
        mine.iter().any(|claim| matches!(claim, Decision::Landmark(c) if self.table.slots[*c as usize] == slot))
    }

    /// Whether something nearer in the same direction was sighted.
    fn hides(&self, [range_m, bearing_rad]: [f64; 2]) -> bool {
        self.scan.iter().any(|sighting| {
            let ([nearer_m, towards_rad], noise) = (sighting.measured.value, sighting.measured.noise);
            let aside_rad = math::wrap_angle(towards_rad - bearing_rad).abs();
            nearer_m + 3.0 * noise.xx.sqrt() < range_m && aside_rad < HIDES_RAD + 2.0 * noise.yy.sqrt()
        })
    }
}

impl<M: MeasurementModel> FastSlam<M> {
    /// Looks for every landmark that the scan should have shown, and removes those that have faded.
    pub(super) fn fade_unconfirmed(&mut self, claims: Claims<'_>, info: &mut StepInfo) {
        let sensor = self.sensor_of(self.state.particles.best());
        let Some(fading) = &mut self.state.landmarks.fading else { return };
        if claims.scan.is_empty() {
            return;
        }
        fading.scanned();
        if !fading.begins(sensor) {
            return;
        }
        let mut looks = std::mem::take(&mut self.work.judging.looks);
        self.look_for_all(claims, &mut looks);
        for look in &looks {
            let birth = self.state.landmarks.birth(look.slot);
            let vouched_for = self.is_vouched_for(look.slot);
            if self.state.landmarks.fading.as_mut().is_some_and(|fading| fading.looked(birth, look, vouched_for)) {
                info.changes.removed += u32::from(self.remove_everywhere(look.slot));
            }
        }
        self.work.judging.looks = looks;
    }

    /// The landmarks in view, each as the best particle has it, or the first one that has it.
    fn look_for_all(&mut self, claims: Claims<'_>, looks: &mut Vec<Look>) {
        looks.clear();
        let sensor = self.sensor_of(self.state.particles.best());
        let mut region = Box2::EMPTY;
        region.include([sensor.x, sensor.y], self.state.landmarks.fading.as_ref().map_or(0.0, |fading| fading.far_m()));
        let mut in_reach = std::mem::take(&mut self.work.judging.in_reach);
        in_reach.clear();
        self.state.landmarks.find(&region, &mut in_reach);
        in_reach.retain(|slot| self.state.landmarks.birth(*slot) < self.work.correcting.first_birth);
        in_reach.sort_unstable_by_key(|slot| self.state.landmarks.birth(*slot));
        in_reach.dedup();
        let mut row = std::mem::take(&mut self.work.judging.row);
        row.resize(self.state.landmarks.columns(), 0.0);
        looks.extend(in_reach.iter().filter_map(|slot| self.look_for(*slot, claims, &mut row)));
        (self.work.judging.in_reach, self.work.judging.row) = (in_reach, row);
    }

    /// A look at one landmark; `None` where it is not in view, or may be hidden.
    fn look_for(&mut self, slot: u32, claims: Claims<'_>, row: &mut [f64]) -> Option<Look> {
        let holder = self.holder(slot, row)?;
        let (sensor, mean) = (self.sensor_of(holder), [row[column::MEAN_X], row[column::MEAN_Y]]);
        let [ahead, left] = sensor.inverse().transform(mean);
        let seen_at = [ahead.hypot(left), math::atan2(left, ahead)];
        let place = self.state.landmarks.fading.as_ref()?.place(seen_at)?;
        let sighted = claims.shows(holder, slot);
        if !sighted && claims.hides(seen_at) {
            return None;
        }
        let covariance = Symmetric2::new(row[column::COV_XX], row[column::COV_XY], row[column::COV_YY]);
        let model = &self.models.measurement;
        let by_landmark = model.linearize(sensor, mean).by_landmark;
        let innovation = innovation_covariance(by_landmark, covariance, model.noise_covariance());
        let gate_area = PI * self.settings.rules.gate * innovation.determinant().max(0.0).sqrt();
        let enough = f64::from(self.settings.config.association.existence.confirmed_sightings);
        Some(Look { slot, place, sighted, gate_area, is_often_sighted: row[column::SIGHTINGS] >= enough })
    }

    /// Where the sensor is in one particle.
    fn sensor_of(&self, particle: usize) -> Pose {
        self.state.particles.pose(particle).compose(self.models.T_robot_sensor)
    }

    /// A particle that has the landmark, if possible the best one; its row then stands in `row`.
    fn holder(&mut self, slot: u32, row: &mut [f64]) -> Option<usize> {
        let best = self.state.particles.best();
        if self.state.landmarks.read_row(slot, best, row) {
            return Some(best);
        }
        let holder =
            self.state.landmarks.read(slot).column(column::SIGHTINGS).iter().position(|count| *count != 0.0)?;
        self.state.landmarks.read_row(slot, holder, row).then_some(holder)
    }

    /// Removes a landmark from all maps; returns whether the best particle lost it.
    fn remove_everywhere(&mut self, slot: u32) -> bool {
        let counts = self.state.landmarks.read(slot).column(column::SIGHTINGS);
        let held: Vec<bool> = counts.iter().map(|count| *count != 0.0).collect();
        self.state.maps().lose(slot, &held);
        held[self.state.particles.best()]
    }
}
