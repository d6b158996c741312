//! A filter that begins in a given map: what sightings do to its landmarks, and what they do not.

use super::beliefs::Beliefs;
use super::estimate::estimate_particles;
use super::given::Given;
use super::rejuvenation::remember_start;
use super::setup::Setup;
use super::state::State;
use super::work::Claims;
use crate::association::{Belief, Decision, ScanSighting};
use crate::config::Config;
use crate::diagnosis::kept_map::KeptMap;
use crate::diagnosis::names::IMPLAUSIBLE;
use crate::error::{Error, Result};
use crate::geometry::Pose;
use crate::given::{lower_triangle, Beginning, GivenLandmark, Role, Start};
use crate::landmark::{Gaussian, Measured};
use crate::math;
use crate::measurement::Placing;
use crate::random::Purpose;

/// No landmark is founded so near to a fixed one, in standard deviations of the range.
const NEAR_STD: f64 = 3.0;

/// Starts in a given map, at a given pose: before anything else.
///
/// **Errors:** [`Error::Parameter`] for a landmark or a start that makes no sense, [`Error::Input`] when the filter has
/// begun.
pub(super) fn begin<M>(setup: &Setup<M>, state: &mut State, beginning: &Beginning) -> Result<()> {
    if state.counters.controls + state.counters.steps + state.landmarks.births() > 0 {
        return Err(Error::Input("a map and a start are given before the first control and scan".into()));
    }
    beginning.validate()?;
    if beginning.is_empty() {
        return Ok(());
    }
    start_at(setup, state, &beginning.start);
    for landmark in &beginning.landmarks {
        adopt_landmark(setup, state, landmark.usable())?;
    }
    let count = beginning.landmarks.len();
    state.particles.landmarks.fill(count as u32);
    state.given.seen = vec![[0; 2]; count];
    *state.diagnosis.watch.kept_map_mut() = KeptMap::of(count as u64);
    estimate_particles(state);
    Ok(())
}

fn start_at<M>(setup: &Setup<M>, state: &mut State, start: &Start) {
    let count = state.particles.len();
    let poses: Vec<Pose> = match start {
        Start::Configured => return,
        Start::Samples(poses) => (0..count).map(|i| poses[i * poses.len() / count]).collect(),
        Start::Gaussian(mean, covariance) => {
            draw_start(setup, count, *mean, lower_triangle(covariance).unwrap_or_default())
        }
    };
    for (i, pose) in poses.into_iter().enumerate() {
        state.particles.set_pose(i, Pose { heading: math::wrap_angle(pose.heading), ..pose });
    }
    let (mean, spread) = start.moments(setup.settings.config.initial_pose.T_world_robot());
    state.given.start = Some(mean);
    remember_start(state, mean, &spread);
}

fn draw_start<M>(setup: &Setup<M>, count: usize, mean: Pose, lower: [[f64; 3]; 3]) -> Vec<Pose> {
    let stream = setup.settings.random.stream(Purpose::Start, 0);
    let draw = |i: usize| {
        let [a, b] = stream.normal_pair(i as u32, 0);
        let [c, _] = stream.normal_pair(i as u32, 1);
        let [x, y, heading] = lower.map(|row| row[0] * a + row[1] * b + row[2] * c);
        Pose::new(mean.x + x, mean.y + y, mean.heading + heading)
    };
    (0..count).map(draw).collect()
}

fn adopt_landmark<M>(setup: &Setup<M>, state: &mut State, landmark: GivenLandmark) -> Result<()> {
    let settings = &setup.settings.config.association;
    if let (Some(classes), Some(class)) = (&settings.classes, landmark.appearance.class) {
        if class >= classes.number {
            let expected = format!("less than association.classes.number = {}", classes.number);
            return Err(Error::parameter(format!("map.{}.class", state.given.landmarks.len()), class, expected));
        }
    }
    let highest = settings.existence.highest_log_odds;
    state.landmarks.adopt(&landmark, landmark.log_odds.map_or(highest, |odds| odds.min(highest)));
    state.given.landmarks.push(landmark);
    Ok(())
}

/// Leaves out what would found a landmark and cannot: all sightings of a sensor that places none; and those that would
/// found a second landmark over a fixed one, which they may show, however badly.
pub(super) fn refuse_foundings<M: Placing>(
    setup: &Setup<M>,
    given: &Given,
    beliefs: &Beliefs,
    scan: &[ScanSighting],
    decisions: &mut [Decision],
) {
    if !setup.models.measurement().places() {
        decisions.iter_mut().filter(|decision| **decision == Decision::New).for_each(|d| *d = Decision::Ignored);
        return;
    }
    let fixed = Fixed::of(given);
    if scan.is_empty() || fixed.places.is_empty() {
        return;
    }
    for (i, mine) in decisions.chunks_exact_mut(scan.len()).enumerate() {
        let belief = beliefs.get(i);
        for (sighting, decision) in scan.iter().zip(mine).filter(|(_, decision)| **decision == Decision::New) {
            if may_show(setup, &belief, &sighting.measured, &fixed) {
                *decision = Decision::Ignored;
            }
        }
    }
}

/// The landmarks that stay where they are.
struct Fixed {
    places: Vec<Gaussian>,
    /// The largest trace of their covariances.
    largest_m2: f64,
}

impl Fixed {
    fn of(given: &Given) -> Self {
        let fixed = given.landmarks.iter().filter(|l| l.role == Role::Fixed);
        let places: Vec<Gaussian> = fixed.map(|l| l.place).collect();
        let traces = places.iter().map(|place| place.covariance.xx + place.covariance.yy);
        Self { largest_m2: traces.fold(0.0, f64::max), places }
    }
}

/// Whether a sighting may show one of these landmarks.
fn may_show<M: Placing>(setup: &Setup<M>, belief: &Belief, measured: &Measured, fixed: &Fixed) -> bool {
    let (model, T_robot_sensor) = (setup.models.measurement(), setup.models.T_robot_sensor);
    let [x, y] = model.inverse(belief.mean.compose(T_robot_sensor), measured.value);
    let [[xx, ..], [_, yy, _], [.., hh]] = belief.covariance;
    let lever_m = model.range(measured.value) + setup.models.lever_arm_m;
    let spread_m2 = xx + yy + lever_m * lever_m * hh + fixed.largest_m2;
    let reach_m2 = 2.0 * IMPLAUSIBLE * (spread_m2 + model.position_variance(measured.value, measured.noise));
    // A bearing is sharp near by, where a pose that is a little off sees past a landmark.
    let beside_m2 = NEAR_STD * NEAR_STD * measured.noise.xx;
    fixed.places.iter().any(|place| {
        let apart_m2 = (place.mean[0] - x).powi(2) + (place.mean[1] - y).powi(2);
        if apart_m2 > reach_m2 {
            return false;
        }
        apart_m2 <= beside_m2 || belief.fit(model, T_robot_sensor, place, measured).mahalanobis_squared <= IMPLAUSIBLE
    })
}

/// Counts a scan whose sightings all name their landmarks.
pub(super) fn count_given_named<M: Placing>(
    setup: &Setup<M>,
    state: &mut State,
    scan: &[ScanSighting],
    named: &[Option<u32>],
) {
    if !scan.is_empty() && !state.given.landmarks.is_empty() {
        let slots: Vec<u32> = named.iter().copied().flatten().collect();
        count_given(setup, state, &slots, &[]);
    }
}

/// Counts a scan as the best particle explains it.
pub(super) fn count_given_decided<M: Placing>(setup: &Setup<M>, state: &mut State, claims: Claims<'_>) {
    if claims.scan.is_empty() || state.given.landmarks.is_empty() {
        return;
    }
    let (mut slots, mut unexplained) = (Vec::new(), Vec::new());
    for (sighting, decision) in claims.scan.iter().zip(claims.of(state.particles.best())) {
        match decision {
            Decision::Landmark(candidate) => slots.push(claims.table.slots[*candidate as usize]),
            _ => unexplained.push(sighting.measured),
        }
    }
    count_given(setup, state, &slots, &unexplained);
}

/// Counts a scan for the given landmarks that the best particle sighted in it, and against those in view that it did
/// not, unless one of the `unexplained` sightings may show them.
fn count_given<M: Placing>(setup: &Setup<M>, state: &mut State, sighted: &[u32], unexplained: &[Measured]) {
    let births: Vec<u64> = sighted.iter().map(|slot| state.landmarks.birth(*slot)).collect();
    let pose = state.particles.pose(state.particles.best());
    let belief = Belief { mean: pose, covariance: [[0.0; 3]; 3] };
    let (model, T_robot_sensor) = (setup.models.measurement(), setup.models.T_robot_sensor);
    let sensor = pose.compose(T_robot_sensor);
    let config = &setup.settings.config;
    let Given { landmarks, seen, is_entered, .. } = &mut state.given;
    for (birth, (landmark, count)) in landmarks.iter().zip(seen).enumerate() {
        let place = &landmark.place;
        let shows =
            |measured: &Measured| belief.fit(model, T_robot_sensor, place, measured).mahalanobis_squared <= IMPLAUSIBLE;
        if births.contains(&(birth as u64)) {
            count[0] += 1;
            *is_entered = true;
        } else if is_surely_in_view(config, sensor, place.mean) && !unexplained.iter().any(shows) {
            count[1] += 1;
        }
    }
}

/// Whether a place is where the sensor surely sees a landmark.
fn is_surely_in_view(config: &Config, sensor: Pose, place: [f64; 2]) -> bool {
    let (settings, limits) = (&config.association.existence, config.sensor.common());
    let reach_m = settings.range_fraction * limits.max_range_m;
    let [x, y] = [place[0] - sensor.x, place[1] - sensor.y];
    let squared = x * x + y * y;
    if squared >= reach_m * reach_m || squared <= limits.min_range_m * limits.min_range_m {
        return false;
    }
    let bearing_rad = math::wrap_angle(math::atan2(y, x) - sensor.heading);
    bearing_rad.abs() < 0.5 * settings.view_fraction * limits.field_of_view_rad
}
