//! Whether the filter can still be believed, and if not, why.

use super::kept_map::KeptMap;
use super::looks::{InView, Looks, MapInView};
use super::names::Names;
use super::noise::NoiseCheck;
use super::Returns;
use crate::config::{Config, HealthConfig};
use crate::geometry::{Matrix3, Pose};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// How the filter is doing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
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
    /// Landmarks to which the robot came back are in view and not sighted any more.
    NotFoundAgain = 6,
}

impl HealthReason {
    /// All of them, in the order of their bits.
    pub const ALL: [Self; 7] = [
        Self::FewEffectiveParticles,
        Self::InnovationsTooLarge,
        Self::NoSightings,
        Self::SightingsUnexplained,
        Self::PoseUncertain,
        Self::MapStale,
        Self::NotFoundAgain,
    ];
}

/// Status with its reasons.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
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
    /// Whether every sighting names its landmark: then one of a new landmark is explained by its name.
    pub names_known: bool,
    /// Whether the sensor says where a landmark is. Of one that does not, much shows what the map never had.
    pub places: bool,
    /// Of the last examined scan, where one was.
    pub map_in_view: Option<MapInView>,
}

/// Where a sensor surely sees.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
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
        let (sensor, existence) = (config.sensor.common(), &config.association.existence);
        Self {
            T_robot_sensor: sensor.mounting.T_robot_sensor(),
            near_m: sensor.min_range_m,
            far_m: existence.range_fraction * sensor.max_range_m,
            half_angle_rad: 0.5 * existence.view_fraction * sensor.field_of_view_rad,
        }
    }

    /// What it sees from a pose of the robot.
    pub fn from(&self, T_world_robot: Pose) -> Outlook<'_> {
        let T_sensor_world = T_world_robot.compose(self.T_robot_sensor).inverse();
        Outlook { view: self, T_sensor_world, sin_cos: T_sensor_world.heading.sin_cos() }
    }
}

/// Where a sensor surely sees from where it is.
pub(crate) struct Outlook<'a> {
    view: &'a View,
    T_sensor_world: Pose,
    /// Of the heading of that transform.
    sin_cos: (f64, f64),
}

impl Outlook<'_> {
    /// Whether a point of the world is in view.
    pub fn contains(&self, [x, y]: [f64; 2]) -> bool {
        let (Self { view, T_sensor_world, .. }, (s, c)) = (self, self.sin_cos);
        let (u, v) = (T_sensor_world.x + c * x - s * y, T_sensor_world.y + s * x + c * y);
        let range_m = u.hypot(v);
        range_m > view.near_m && range_m < view.far_m && crate::math::atan2(v, u).abs() < view.half_angle_rad
    }
}

/// What the watch knows of one of several sensors.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(crate) struct Gaze {
    view: View,
    /// Where the robot was when it last looked at the map with it.
    last: Option<Pose>,
}

impl Gaze {
    /// Of a sensor with this view that has not looked yet.
    pub fn new(view: View) -> Self {
        Self { view, last: None }
    }
}

/// One scan in so many is examined.
///
/// **Why:** an examination costs as much as about a hundred sightings of a particle, and neighbouring scans tell the
/// same story; those far apart in time do not.
const EXAMINED_EVERY: u64 = 4;
/// A scan that comes so long after the last examined one is examined too.
const LONGEST_UNEXAMINED_S: f64 = 0.75;
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
/// Blindness is no news up to so many times the longest from which the filter came back.
const BLIND_AGAIN: f64 = 1.5;
/// Weight of the newest scan in a moving average over about `window_scans` of them.
fn newest(window_scans: u32) -> f64 {
    2.0 / (f64::from(window_scans) + 1.0)
}

/// The scan at which the filter lost touch with its map: none of it fitted where known landmarks should have been.
///
/// **Why:** with unknown identities the next scan finds the landmarks that this one made, and all looks well. Only old
/// landmarks prove that the robot is where it thinks.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
struct Torn {
    /// Landmarks with a lower birth are older.
    births: u64,
    /// Scans since.
    scans: u32,
}

/// Which scans are examined.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
struct Examinations {
    /// Scans so far, those examined, and when the last of these was.
    scans: u64,
    done: u64,
    last_s: f64,
    /// Whether the scan of this step is.
    is_due: bool,
}

/// How long the robot saw nothing.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
struct Blindness {
    last_sighting_s: Option<f64>,
    /// Longest time without sightings after which known landmarks were sighted.
    longest_survived_s: f64,
}

/// How well scans fit.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
struct Fits {
    /// Scans that showed known landmarks.
    scans_matched: u32,
    /// Moving averages: effective share of the particles; unexplained share of the sightings.
    effective: f64,
    unexplained: f64,
}

/// Watches over a filter, from step to step.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct Watch {
    settings: HealthConfig,
    view: View,
    /// The innovations so far.
    pub noise: NoiseCheck,
    /// Names that may be wrong.
    pub names: Names,
    /// Sightings of the step that showed known landmarks, as measured, and the births of these; and how many sightings
    /// there were.
    matches: Vec<([f64; 2], u64)>,
    sightings: usize,
    /// Where landmarks were seen lately.
    places: VecDeque<[f64; 2]>,
    fits: Fits,
    examinations: Examinations,
    torn: Option<Torn>,
    blindness: Blindness,
    looks: Looks,
}

impl Watch {
    /// Over a filter whose sensor has this view.
    pub fn new(settings: HealthConfig, view: View) -> Self {
        Self {
            settings,
            view,
            noise: NoiseCheck::default(),
            names: Names::default(),
            matches: Vec::new(),
            sightings: 0,
            places: VecDeque::new(),
            fits: Fits { scans_matched: 0, effective: 1.0, unexplained: 0.0 },
            examinations: Examinations { scans: 0, done: 0, last_s: f64::NEG_INFINITY, is_due: false },
            torn: None,
            blindness: Blindness::default(),
            looks: Looks::default(),
        }
    }

    /// Exchanges what is known of the sensor that looks with that of another one.
    pub fn swap(&mut self, gaze: &mut Gaze) {
        std::mem::swap(&mut self.view, &mut gaze.view);
        std::mem::swap(self.looks.last(), &mut gaze.last);
    }

    /// Begins a step with so many sightings; a scan is a step with some.
    pub fn begin(&mut self, stamp_s: f64, sightings: u32) {
        let examined = &mut self.examinations;
        let due = examined.scans.is_multiple_of(EXAMINED_EVERY) || stamp_s - examined.last_s >= LONGEST_UNEXAMINED_S;
        examined.is_due = sightings > 0 && due;
        examined.scans += u64::from(sightings > 0);
        if examined.is_due {
            examined.done += 1;
            examined.last_s = stamp_s;
        }
    }

    /// Whether the scan of this step is to be examined.
    pub fn examines(&self) -> bool {
        self.examinations.is_due
    }

    /// Examinations so far.
    pub fn examinations(&self) -> u64 {
        self.examinations.done
    }

    /// Where the sensor surely sees.
    pub fn view(&self) -> View {
        self.view
    }

    /// Takes note of the sightings of known landmarks (as measured, with the landmark's birth) among those of a scan.
    pub fn matched(&mut self, known: impl Iterator<Item = ([f64; 2], u64)>, sightings: usize) {
        for (value, birth) in known {
            self.looks.sighted(birth);
            self.looks.kept_map.sighted(value, birth);
            self.matches.push((value, birth));
        }
        self.sightings += sightings;
    }

    /// Whether a sighting of this step shows this landmark.
    pub fn has_matched(&self, birth: u64) -> bool {
        self.matches.iter().any(|(_, matched)| *matched == birth)
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

    /// How many of the places seen lately are in view from a pose of the robot.
    fn expected_from(&self, T_world_robot: Pose) -> usize {
        let outlook = self.view.from(T_world_robot);
        self.places.iter().filter(|at| outlook.contains(**at)).count()
    }

    /// The verdict after a step. `place` gives the position in the world of something sighted from a pose.
    pub fn judge(&mut self, vitals: &Vitals, place: impl Fn(Pose, [f64; 2]) -> [f64; 2]) -> Health {
        let settings = self.settings;
        // Names answer what else the places of landmarks seen lately are asked for.
        let expected = if vitals.names_known { 0 } else { self.expected_from(vitals.T_world_robot) };
        let share = newest(settings.window_scans);
        if self.sightings > 0 {
            if !vitals.names_known && vitals.places {
                self.look_for_tears(expected, vitals.births_before);
            }
            let unexplained = 1.0 - self.matches.len() as f64 / self.sightings as f64;
            // Unknown ground is no fault: only where known landmarks should be in view does an unexplained scan count.
            let fault = if expected >= EXPECTED_MIN && !vitals.names_known { unexplained } else { 0.0 };
            let effective = vitals.effective_sample_size / vitals.particles as f64;
            self.fits.effective += share * (effective - self.fits.effective);
            if vitals.places {
                self.fits.unexplained += share * (fault - self.fits.unexplained);
            }
            self.fits.scans_matched += u32::from(!self.matches.is_empty());
            let blindness = &mut self.blindness;
            if let (Some(last_s), false) = (blindness.last_sighting_s, self.matches.is_empty()) {
                blindness.longest_survived_s = blindness.longest_survived_s.max(vitals.stamp_s - last_s);
            }
            blindness.last_sighting_s = Some(vitals.stamp_s);
        }
        if let Some(in_view) = vitals.map_in_view {
            self.looks.end(in_view, share);
        }
        self.remember(vitals.T_world_robot, place);
        self.verdict(vitals)
    }

    /// Whether a look at the map from here says anything new; then it counts as taken.
    pub fn looks_from(&mut self, T_world_robot: Pose) -> bool {
        self.looks.begin(T_world_robot, self.view.far_m)
    }

    /// Takes note of whether a landmark that is in view was sighted, in what the scan shows of the map.
    pub fn looked(&mut self, in_view: &mut MapInView, landmark: InView) {
        self.looks.looked(in_view, landmark);
    }

    /// What was seen lately of the map in which the robot began.
    pub fn kept_map(&self) -> &KeptMap {
        &self.looks.kept_map
    }

    /// The same, to be set.
    pub fn kept_map_mut(&mut self) -> &mut KeptMap {
        &mut self.looks.kept_map
    }

    /// The part of the view in which most sightings lie, for a robot in a kept map.
    pub fn reach(&self) -> Option<View> {
        let (far_m, half_angle_rad) = self.looks.kept_map.reach()?;
        Some(View { far_m, half_angle_rad, ..self.view })
    }

    /// Takes note of whether a landmark within that reach was sighted, if it is a kept one.
    pub fn looked_at_kept(&mut self, birth: u64, sighted: bool) {
        if self.looks.kept_map.holds(birth) {
            self.looks.kept_map.looked(sighted);
        }
    }

    /// Another landmark went over into this one.
    pub fn merged(&mut self, birth: u64) {
        self.looks.merged(birth);
    }

    /// Loops were closed.
    pub fn closed(&mut self) {
        self.looks.closed();
    }

    /// What came of the returns to these landmarks.
    pub fn returns(&self, births: impl Iterator<Item = u64>) -> Returns {
        self.looks.returns(births)
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
        let Fits { scans_matched, effective, unexplained } = self.fits;
        let few = vitals.particles >= 10 && effective < settings.smallest_effective_fraction;
        note(HealthReason::FewEffectiveParticles, few, false);
        let ratio = self.noise.recent_ratio(RECENT_SCANS).unwrap_or(1.0);
        let largest = settings.largest_innovation_ratio;
        note(HealthReason::InnovationsTooLarge, ratio > largest, ratio > 4.0 * largest);
        let blind_s = self.blindness.last_sighting_s.map_or(0.0, |last_s| vitals.stamp_s - last_s);
        let longest_s = settings.longest_blindness_s.max(BLIND_AGAIN * self.blindness.longest_survived_s);
        note(HealthReason::NoSightings, blind_s > longest_s, false);
        let limit = settings.largest_unexplained_fraction;
        let lost = unexplained > 0.5 * (1.0 + limit) || self.torn.is_some_and(|torn| torn.scans >= TORN_SCANS);
        let torn = self.torn.is_some();
        note(HealthReason::SightingsUnexplained, torn || unexplained > limit, lost || self.looks.kept_map.is_left());
        let [[xx, xy, _], [_, yy, _], [_, _, hh]] = vitals.pose_covariance;
        let position = crate::geometry::Symmetric2::new(xx, xy, yy).largest_eigenvalue().max(0.0).sqrt();
        let spread =
            (position / settings.largest_position_std_m).max(hh.max(0.0).sqrt() / settings.largest_heading_std_rad);
        note(HealthReason::PoseUncertain, spread > 1.0, spread > 3.0);
        note(HealthReason::MapStale, self.looks.find_map_stale(settings.smallest_detection_ratio), false);
        note(HealthReason::NotFoundAgain, self.looks.find_returns_in_vain(), false);
        let started = scans_matched >= SCANS_TO_INITIALIZE;
        health.status = if started { worst } else { HealthStatus::Initializing };
        health
    }
}
