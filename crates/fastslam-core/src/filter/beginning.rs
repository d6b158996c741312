//! A filter that begins in a given map: what sightings do to its landmarks, and what they do not.

use super::given::Given;
use super::scan::ScanSighting;
use super::FastSlam;
use crate::association::{Belief, CandidateTable, Decision};
use crate::config::Config;
use crate::diagnosis::names::IMPLAUSIBLE;
use crate::error::{Error, Result};
use crate::geometry::Pose;
use crate::given::{lower_triangle, Beginning, GivenLandmark, Role, Start};
use crate::landmark::{Correction, Gaussian, Measured};
use crate::math;
use crate::measurement::MeasurementModel;
use crate::random::Purpose;
use crate::store::RowsMut;

/// No landmark is founded so near to a fixed one, in standard deviations of the range.
const NEAR_STD: f64 = 3.0;

impl<M: MeasurementModel> FastSlam<M> {
    /// Starts in a given map, at a given pose: before anything else.
    ///
    /// Given landmarks count as confirmed. They keep their places in the frame of the map, which is that of the path.
    ///
    /// **Errors:** [`Error::Parameter`] for a landmark or a start that makes no sense, [`Error::Input`] when the filter
    /// has begun.
    pub fn begin(&mut self, beginning: &Beginning) -> Result<()> {
        let counters = self.state.counters;
        if counters.controls + counters.steps + self.state.landmarks.births() > 0 {
            return Err(Error::Input("a map and a start are given before the first control and scan".into()));
        }
        beginning.validate()?;
        if beginning.is_empty() {
            return Ok(());
        }
        self.start_at(&beginning.start);
        for landmark in &beginning.landmarks {
            self.adopt_landmark(landmark.usable())?;
        }
        let count = beginning.landmarks.len();
        self.state.particles.landmarks.fill(count as u32);
        self.state.given.seen = vec![[0; 2]; count];
        self.estimate_particles();
        Ok(())
    }

    /// The given landmarks, by birth.
    pub fn given(&self) -> &[GivenLandmark] {
        &self.state.given.landmarks
    }

    /// Where the path begins.
    pub fn start(&self) -> Pose {
        self.state.given.start.unwrap_or_else(|| self.settings.config.initial_pose.T_world_robot())
    }

    fn start_at(&mut self, start: &Start) {
        let count = self.state.particles.len();
        let poses: Vec<Pose> = match start {
            Start::Configured => return,
            Start::Samples(poses) => (0..count).map(|i| poses[i * poses.len() / count]).collect(),
            Start::Gaussian(mean, covariance) => self.draw_start(*mean, lower_triangle(covariance).unwrap_or_default()),
        };
        for (i, pose) in poses.into_iter().enumerate() {
            self.state.particles.set_pose(i, Pose { heading: math::wrap_angle(pose.heading), ..pose });
        }
        let (mean, spread) = start.moments(self.settings.config.initial_pose.T_world_robot());
        self.state.given.start = Some(mean);
        self.remember_start(mean, &spread);
    }

    fn draw_start(&self, mean: Pose, lower: [[f64; 3]; 3]) -> Vec<Pose> {
        let stream = self.settings.random.stream(Purpose::Start, 0);
        let draw = |i: usize| {
            let [a, b] = stream.normal_pair(i as u32, 0);
            let [c, _] = stream.normal_pair(i as u32, 1);
            let [x, y, heading] = lower.map(|row| row[0] * a + row[1] * b + row[2] * c);
            Pose::new(mean.x + x, mean.y + y, mean.heading + heading)
        };
        (0..self.state.particles.len()).map(draw).collect()
    }

    fn adopt_landmark(&mut self, landmark: GivenLandmark) -> Result<()> {
        let settings = &self.settings.config.association;
        if let (Some(classes), Some(class)) = (&settings.classes, landmark.appearance.class) {
            if class >= classes.number {
                let expected = format!("less than association.classes.number = {}", classes.number);
                return Err(Error::parameter(
                    format!("map.{}.class", self.state.given.landmarks.len()),
                    class,
                    expected,
                ));
            }
        }
        let highest = settings.existence.highest_log_odds;
        self.state.landmarks.adopt(&landmark, landmark.log_odds.map_or(highest, |odds| odds.min(highest)));
        self.state.given.landmarks.push(landmark);
        Ok(())
    }

    /// Whether nothing may change the landmark of a slot.
    pub(super) fn is_fixed(&self, slot: u32) -> bool {
        !self.state.given.landmarks.is_empty() && self.state.given.is_fixed(self.state.landmarks.birth(slot))
    }

    /// Adds to `log_likelihood` what a sighting of a landmark that stays as it is says in the maps that `mask` marks.
    pub(super) fn weigh_fixed(&mut self, slot: u32, sighting: &ScanSighting, mask: Option<&[bool]>) {
        let mut rows = std::mem::take(&mut self.work.correcting.rows);
        rows.clear();
        self.state.landmarks.append_rows(slot, &mut rows);
        let (model, poses) = (&self.models.measurement, &self.work.correcting.sensor_poses);
        let correction = Correction { model, poses, measured: sighting.measured, mask };
        let count = poses.x.len();
        // Only the likelihoods count; the corrected rows are dropped.
        correction.apply(0, RowsMut::new(&mut rows, count).columns(), &mut self.work.log_likelihood);
        self.work.correcting.rows = rows;
    }

    /// Leaves out what would found a second landmark over a fixed one: sightings that may show it, however badly.
    pub(super) fn refuse_foundings(&self, scan: &[ScanSighting], decisions: &mut [Decision]) {
        let given = &self.state.given.landmarks;
        let fixed: Vec<Gaussian> = given.iter().filter(|l| l.role == Role::Fixed).map(|l| l.place).collect();
        if scan.is_empty() || fixed.is_empty() {
            return;
        }
        let largest_m2 = fixed.iter().map(|place| place.covariance.xx + place.covariance.yy).fold(0.0, f64::max);
        for (i, mine) in decisions.chunks_exact_mut(scan.len()).enumerate() {
            let belief = self.work.beliefs.get(i);
            for (sighting, decision) in scan.iter().zip(mine).filter(|(_, decision)| **decision == Decision::New) {
                if self.may_show(&belief, &sighting.measured, &fixed, largest_m2) {
                    *decision = Decision::Ignored;
                }
            }
        }
    }

    /// Whether a sighting may show one of these landmarks, the trace of whose covariances is at most `largest_m2`.
    fn may_show(&self, belief: &Belief, measured: &Measured, fixed: &[Gaussian], largest_m2: f64) -> bool {
        let (model, T_robot_sensor) = (&self.models.measurement, self.models.T_robot_sensor);
        let [x, y] = model.inverse(belief.mean.compose(T_robot_sensor), measured.value);
        let [[xx, ..], [_, yy, _], [.., hh]] = belief.covariance;
        let lever_m = model.range(measured.value) + self.models.lever_arm_m;
        let spread_m2 = xx + yy + lever_m * lever_m * hh + largest_m2;
        let reach_m2 = 2.0 * IMPLAUSIBLE * (spread_m2 + model.position_variance(measured.value, measured.noise));
        // A bearing is sharp near by, where a pose that is a little off sees past a landmark.
        let beside_m2 = NEAR_STD * NEAR_STD * measured.noise.xx;
        fixed.iter().any(|place| {
            let apart_m2 = (place.mean[0] - x).powi(2) + (place.mean[1] - y).powi(2);
            if apart_m2 > reach_m2 {
                return false;
            }
            apart_m2 <= beside_m2
                || belief.fit(model, T_robot_sensor, place, measured).mahalanobis_squared <= IMPLAUSIBLE
        })
    }

    /// Counts a scan whose sightings all name their landmarks.
    pub(super) fn count_given_names(&mut self, scan: &[ScanSighting]) {
        if scan.is_empty() || self.state.given.landmarks.is_empty() {
            return;
        }
        let slots: Vec<u32> = scan.iter().filter_map(|sighting| self.known_slot(sighting)).collect();
        self.count_given(&slots, &[]);
    }

    /// Counts a scan as the best particle explains it.
    pub(super) fn count_given_decided(
        &mut self,
        scan: &[ScanSighting],
        decisions: &[Decision],
        table: &CandidateTable,
    ) {
        if scan.is_empty() || self.state.given.landmarks.is_empty() {
            return;
        }
        let mine = &decisions[self.state.particles.best() * scan.len()..][..scan.len()];
        let (mut slots, mut unexplained) = (Vec::new(), Vec::new());
        for (sighting, decision) in scan.iter().zip(mine) {
            match decision {
                Decision::Landmark(candidate) => slots.push(table.slots[*candidate as usize]),
                _ => unexplained.push(sighting.measured),
            }
        }
        self.count_given(&slots, &unexplained);
    }

    /// Counts a scan for the given landmarks that the best particle sighted in it, and against those in view that it
    /// did not, unless one of the `unexplained` sightings may show them.
    fn count_given(&mut self, sighted: &[u32], unexplained: &[Measured]) {
        let births: Vec<u64> = sighted.iter().map(|slot| self.state.landmarks.birth(*slot)).collect();
        let pose = self.state.particles.pose(self.state.particles.best());
        let belief = Belief { mean: pose, covariance: [[0.0; 3]; 3] };
        let (model, T_robot_sensor) = (&self.models.measurement, self.models.T_robot_sensor);
        let sensor = pose.compose(T_robot_sensor);
        let config = &self.settings.config;
        let Given { landmarks, seen, is_entered, .. } = &mut self.state.given;
        for (birth, (landmark, count)) in landmarks.iter().zip(seen).enumerate() {
            let place = &landmark.place;
            let shows = |measured: &Measured| {
                belief.fit(model, T_robot_sensor, place, measured).mahalanobis_squared <= IMPLAUSIBLE
            };
            if births.contains(&(birth as u64)) {
                count[0] += 1;
                *is_entered = true;
            } else if is_surely_in_view(config, sensor, place.mean) && !unexplained.iter().any(shows) {
                count[1] += 1;
            }
        }
    }
}

/// Whether a place is where the sensor surely sees a landmark.
fn is_surely_in_view(config: &Config, sensor: Pose, place: [f64; 2]) -> bool {
    let (settings, limits) = (&config.association.existence, &config.sensor);
    let reach_m = settings.range_fraction * limits.max_range_m;
    let [x, y] = [place[0] - sensor.x, place[1] - sensor.y];
    let squared = x * x + y * y;
    if squared >= reach_m * reach_m || squared <= limits.min_range_m * limits.min_range_m {
        return false;
    }
    let bearing_rad = math::wrap_angle(math::atan2(y, x) - sensor.heading);
    bearing_rad.abs() < 0.5 * settings.view_fraction * limits.field_of_view_rad
}
