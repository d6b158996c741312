//! Whether the filter can still be believed, and if not, why.

use super::noise::NoiseCheck;
use crate::config::{Config, HealthConfig};
use crate::geometry::{Matrix3, Pose};
use std::collections::VecDeque;

/// How the filter is doing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub enum HealthStatus {
    /// Too little was seen again to judge.
    #[default]
    Initializing = 0,
    /// Nothing speaks against the estimate.
    Ok = 1,
    /// Something does: the estimate is worse than it says, or about to be.
    Degraded = 2,
    /// The estimate should not be used.
    Lost = 3,
}

/// What speaks against the estimate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum HealthReason {
    /// Almost all weight lies on almost no particles, step after step.
    FewEffectiveParticles = 0,
    /// Sightings lie much farther from where they were predicted than the noise allows.
    InnovationsTooLarge = 1,
    /// Nothing was sighted for long.
    NoSightings = 2,
    /// Most sightings show no known landmark though known ones should be in view.
    SightingsUnexplained = 3,
    /// The particles disagree about the pose.
    PoseUncertain = 4,
    /// Most landmarks of the map that should be in view are not sighted.
    MapStale = 5,
}

impl HealthReason {
    /// All of them, in the order of their bits.
    pub const ALL: [Self; 6] = [
        Self::FewEffectiveParticles,
        Self::InnovationsTooLarge,
        Self::NoSightings,
        Self::SightingsUnexplained,
        Self::PoseUncertain,
        Self::MapStale,
    ];
}

/// Status with its reasons.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Health {
    /// The verdict.
    pub status: HealthStatus,
    /// One bit per [`HealthReason`].
    pub reasons: u8,
}

impl Health {
    /// Whether a reason applies.
    pub fn has(&self, reason: HealthReason) -> bool {
        self.reasons >> reason as u8 & 1 == 1
    }
}

/// What a step says about the state of the filter.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Vitals {
    /// Seconds.
    pub stamp_s: f64,
    /// Number of particles.
    pub particles: usize,
    /// Before resampling.
    pub effective_sample_size: f64,
    /// Pose after the step.
    pub T_world_robot: Pose,
    /// Its covariance.
    pub pose_covariance: Matrix3,
    /// Landmarks ever created before the step.
    pub births_before: u64,
    /// Of the last examined scan, where one was.
    pub map_in_view: Option<MapInView>,
}

/// Landmarks of the best particle's map that a scan should have shown.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct MapInView {
    /// How many.
    pub expected: u32,
    /// How many of these it showed.
    pub sighted: u32,
}

/// Where a sensor surely sees.
#[derive(Clone, Copy, Debug)]
pub(crate) struct View {
    /// The sensor on the robot.
    pub T_robot_sensor: Pose,
    /// Nothing nearer counts, metres.
    pub near_m: f64,
    /// Nothing farther counts, metres.
    pub far_m: f64,
    /// Half the opening angle.
    pub half_angle_rad: f64,
}

impl View {
    /// That of the configured sensor: the part in which the map must be seen to exist.
    pub fn of(config: &Config) -> Self {
        let (sensor, existence) = (&config.sensor, &config.association.existence);
        Self {
            T_robot_sensor: sensor.mounting.T_robot_sensor(),
            near_m: sensor.min_range_m,
            far_m: existence.range_fraction * sensor.max_range_m,
            half_angle_rad: 0.5 * existence.view_fraction * sensor.field_of_view_rad,
        }
    }

    /// Whether a point is in view from a pose of the robot.
    pub fn contains(&self, T_world_robot: Pose, [x, y]: [f64; 2]) -> bool {
        let [u, v] = T_world_robot.compose(self.T_robot_sensor).inverse().transform([x, y]);
        let range_m = u.hypot(v);
        range_m > self.near_m && range_m < self.far_m && crate::math::atan2(v, u).abs() < self.half_angle_rad
    }
}

/// Places of landmarks seen lately that are remembered.
const REMEMBERED: usize = 48;
/// Examined scans over which innovations are averaged.
const RECENT_SCANS: usize = 6;
/// Scans after which the first verdict is given: so many must have shown known landmarks.
const SCANS_TO_INITIALIZE: u32 = 10;
/// Fewer known landmarks in view than this prove nothing when none is sighted.
const EXPECTED_MIN: usize = 3;
/// A scan of which no more than this fraction fits the map is torn from it. In whole runs over real logs no scan is.
const LARGEST_MATCHED_FRACTION_OF_A_TEAR: f64 = 0.1;
/// Scans after a tear from which on the robot counts as lost.
const TORN_SCANS: u32 = 3;
/// A map of which so few landmarks were expected lately says nothing about its age.
const EXPECTED_LATELY_MIN: f64 = 3.0;
/// Looks at the map from which the usual share of sighted landmarks is learnt.
const VIEWS_TO_LEARN: f64 = 20.0;

/// Weight of the newest step in a moving average over about `window_steps` of them.
fn newest(window_steps: u32) -> f64 {
    2.0 / (f64::from(window_steps) + 1.0)
}

/// The scan at which the filter lost touch with its map: none of it fitted where known landmarks should have been.
///
/// **Why:** with unknown identities the next scan finds the landmarks that this one made, and all looks well. Only old
/// landmarks prove that the robot is where it thinks.
#[derive(Clone, Copy, Debug)]
struct Torn {
    /// Landmarks with a lower birth are older.
    births: u64,
    /// Scans since.
    scans: u32,
}

/// Watches over a filter, from step to step.
#[derive(Clone, Debug)]
pub(crate) struct Watch {
    settings: HealthConfig,
    view: View,
    /// The innovations so far.
    pub noise: NoiseCheck,
    /// Sightings of the step that showed known landmarks, as measured, and the births of these; and how many sightings
    /// there were.
    matches: Vec<([f64; 2], u64)>,
    sightings: usize,
    /// Where landmarks were seen lately.
    places: VecDeque<[f64; 2]>,
    scans_matched: u32,
    torn: Option<Torn>,
    last_sighting_s: Option<f64>,
    /// Moving averages: effective share of the particles; unexplained share of the sightings.
    effective: f64,
    unexplained: f64,
    /// Moving sums of landmarks that should have been seen and were, and their ratio over the whole run.
    expected: f64,
    sighted: f64,
    usual_ratio: f64,
    views: f64,
}

impl Watch {
    /// Over a filter whose sensor has this view.
    pub fn new(settings: HealthConfig, view: View) -> Self {
        Self {
            settings,
            view,
            noise: NoiseCheck::default(),
            matches: Vec::new(),
            sightings: 0,
            places: VecDeque::new(),
            scans_matched: 0,
            torn: None,
            last_sighting_s: None,
            effective: 1.0,
            unexplained: 0.0,
            expected: 0.0,
            sighted: 0.0,
            usual_ratio: 0.0,
            views: 0.0,
        }
    }

    /// Where the sensor surely sees.
    pub fn view(&self) -> View {
        self.view
    }

    /// Takes note of the sightings of known landmarks (as measured, with the landmark's birth) among those of a scan.
    pub fn matched(&mut self, known: impl Iterator<Item = ([f64; 2], u64)>, sightings: usize) {
        self.matches.extend(known);
        self.sightings += sightings;
    }

    /// Sightings of known landmarks in this step so far.
    pub fn matches(&self) -> usize {
        self.matches.len()
    }

    /// Looks for scans that have nothing to do with the map, and for those that are back in it.
    fn look_for_tears(&mut self, expected: usize, births: u64) {
        let matches = self.matches.len();
        let nothing_fits = matches as f64 <= LARGEST_MATCHED_FRACTION_OF_A_TEAR * self.sightings as f64;
        if let Some(torn) = &mut self.torn {
            torn.scans += 1;
            let old = self.matches.iter().filter(|(_, birth)| *birth < torn.births).count();
            if 2 * old >= self.sightings.max(1) {
                self.torn = None;
            }
        } else if self.sightings >= EXPECTED_MIN && expected >= EXPECTED_MIN && nothing_fits {
            self.torn = Some(Torn { births, scans: 0 });
        }
    }

    /// The verdict after a step. `place` gives the position in the world of something sighted from a pose.
    pub fn judge(&mut self, vitals: &Vitals, place: impl Fn(Pose, [f64; 2]) -> [f64; 2]) -> Health {
        let settings = self.settings;
        let expected = self.places.iter().filter(|at| self.view.contains(vitals.T_world_robot, **at)).count();
        let share = newest(settings.window_steps);
        if self.sightings > 0 {
            self.look_for_tears(expected, vitals.births_before);
            let unexplained = 1.0 - self.matches.len() as f64 / self.sightings as f64;
            // Unknown ground is no fault: only where known landmarks should be in view does an unexplained scan count.
            let fault = if expected >= EXPECTED_MIN { unexplained } else { 0.0 };
            self.unexplained += share * (fault - self.unexplained);
            self.effective += share * (vitals.effective_sample_size / vitals.particles as f64 - self.effective);
            self.scans_matched += u32::from(!self.matches.is_empty());
            self.last_sighting_s = Some(vitals.stamp_s);
        }
        if let Some(in_view) = vitals.map_in_view {
            self.count_view(in_view, share);
        }
        self.remember(vitals.T_world_robot, place);
        self.verdict(vitals)
    }

    fn count_view(&mut self, in_view: MapInView, share: f64) {
        if in_view.expected == 0 {
            return;
        }
        self.views += 1.0;
        let (expected, sighted) = (f64::from(in_view.expected), f64::from(in_view.sighted));
        let recent = share.max(1.0 / self.views);
        self.expected += recent * (expected - self.expected);
        self.sighted += recent * (sighted - self.sighted);
        // What is missed now must not become the custom.
        if self.views < VIEWS_TO_LEARN || !self.is_stale() {
            self.usual_ratio += (0.1 * share).max(1.0 / self.views) * (sighted / expected - self.usual_ratio);
        }
    }

    /// Whether much less of the map is sighted than it used to be.
    fn is_stale(&self) -> bool {
        self.views >= VIEWS_TO_LEARN
            && self.expected > EXPECTED_LATELY_MIN
            && self.sighted < self.settings.smallest_detection_ratio * self.usual_ratio * self.expected
    }

    fn remember(&mut self, T_world_robot: Pose, place: impl Fn(Pose, [f64; 2]) -> [f64; 2]) {
        let T_world_sensor = T_world_robot.compose(self.view.T_robot_sensor);
        for (value, _) in self.matches.drain(..) {
            if self.places.len() == REMEMBERED {
                self.places.pop_front();
            }
            self.places.push_back(place(T_world_sensor, value));
        }
        self.sightings = 0;
    }

    fn verdict(&self, vitals: &Vitals) -> Health {
        let settings = &self.settings;
        let mut health = Health::default();
        let mut worst = HealthStatus::Ok;
        let mut note = |reason: HealthReason, degraded: bool, lost: bool| {
            if degraded || lost {
                health.reasons |= 1 << reason as u8;
                worst = worst.max(if lost { HealthStatus::Lost } else { HealthStatus::Degraded });
            }
        };
        let few = vitals.particles >= 10 && self.effective < settings.smallest_effective_fraction;
        note(HealthReason::FewEffectiveParticles, few, false);
        let ratio = self.noise.recent_ratio(RECENT_SCANS).unwrap_or(1.0);
        let largest = settings.largest_innovation_ratio;
        note(HealthReason::InnovationsTooLarge, ratio > largest, ratio > 4.0 * largest);
        let blind_s = self.last_sighting_s.map_or(0.0, |last_s| vitals.stamp_s - last_s);
        note(HealthReason::NoSightings, blind_s > settings.longest_blindness_s, false);
        let limit = settings.largest_unexplained_fraction;
        let lost = self.unexplained > 0.5 * (1.0 + limit) || self.torn.is_some_and(|torn| torn.scans >= TORN_SCANS);
        let torn = self.torn.is_some();
        note(HealthReason::SightingsUnexplained, torn || self.unexplained > limit, lost);
        let [[xx, xy, _], [_, yy, _], [_, _, hh]] = vitals.pose_covariance;
        let position = crate::geometry::Symmetric2::new(xx, xy, yy).largest_eigenvalue().max(0.0).sqrt();
        let spread =
            (position / settings.largest_position_std_m).max(hh.max(0.0).sqrt() / settings.largest_heading_std_rad);
        note(HealthReason::PoseUncertain, spread > 1.0, spread > 3.0);
        note(HealthReason::MapStale, self.is_stale(), false);
        let started = self.scans_matched >= SCANS_TO_INITIALIZE;
        health.status = if started { worst } else { HealthStatus::Initializing };
        health
    }
}
