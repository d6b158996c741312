//! Filters beside each other that watch one robot: a simulated one that somebody drives, or that of a log.

use crate::observer::Observer;
use crate::replay::{Moment, Replay};
use crate::settings::Settings;
use crate::world::{World, TICKS_PER_SCAN, TICK_S};
use fastslam_core::filter::{Identities, Sighting};
use fastslam_core::geometry::Pose;
use fastslam_core::measurement::SystematicError;
use fastslam_core::motion::RowPart;
use std::collections::HashMap;

/// What the robot does.
pub enum Scene {
    /// It is driven in a simulated world.
    Simulated(Box<World>),
    /// It did what a log says.
    Logged(Box<Replay>),
}

/// What a scan showed one filter's best hypothesis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Match {
    /// Where the sighting ends, in the world.
    pub end_m: [f64; 2],
    /// The landmark of the map that it was taken for: its place.
    pub landmark_m: Option<[f64; 2]>,
    /// Whether that landmark was another one when it was first seen. Known in simulated worlds.
    pub mistaken: bool,
}

/// A seat in the classroom.
pub struct Seat {
    /// The filter.
    pub observer: Observer,
    /// What it made of the last scan.
    pub matches: Vec<Match>,
    /// The true landmark for which each landmark of the map was first taken, by its birth.
    taken_for: HashMap<u64, u32>,
}

/// A robot and the filters that watch it.
pub struct Classroom {
    /// What the robot does.
    pub scene: Scene,
    /// The filters.
    pub seats: Vec<Seat>,
    /// How the sensor is mounted and wrong.
    view: SensorView,
    names: bool,
}

/// From what a sensor reports to places in the world.
#[derive(Clone, Copy)]
struct SensorView {
    T_robot_sensor: Pose,
    error: SystematicError,
    std: [f64; 2],
}

impl Classroom {
    /// A simulated world.
    pub fn simulated(settings: &Settings) -> Result<Self, String> {
        settings.validate()?;
        let identities = if settings.names { Identities::All } else { Identities::None };
        let configs = settings.filters.iter().map(|&algorithm| settings.config(algorithm));
        let observers: Result<Vec<_>, _> = configs.map(|config| Observer::new(config, identities)).collect();
        let view = SensorView {
            T_robot_sensor: Pose::default(),
            error: SystematicError::NONE,
            std: [settings.range_std_m, settings.bearing_std_rad],
        };
        let scene = Scene::Simulated(Box::new(World::new(settings)));
        let seats = seats(observers.map_err(|error| error.to_string())?);
        let mut room = Self { scene, seats, view, names: settings.names };
        room.scan();
        Ok(room)
    }

    /// A log, from its beginning.
    pub fn logged(replay: Replay, settings: &Settings) -> Result<Self, String> {
        settings.validate()?;
        let sensor = &replay.config.sensor;
        let model = sensor.range_bearing().map_err(|error| error.to_string())?;
        let view = SensorView {
            T_robot_sensor: sensor.T_robot_sensor(),
            error: sensor.systematic_error(),
            std: [model.range_std_m, model.bearing_std_rad],
        };
        let configs = settings.filters.iter().map(|&algorithm| settings.adapt(replay.config.clone(), algorithm));
        let observers: Result<Vec<_>, _> = configs.map(|config| Observer::new(config, replay.identities)).collect();
        let seats = seats(observers.map_err(|error| error.to_string())?);
        Ok(Self { names: settings.names, scene: Scene::Logged(Box::new(replay)), seats, view })
    }

    /// Drives the simulated robot for some ticks; `command` gives speed and yaw rate.
    pub fn drive(&mut self, ticks: u32, command: impl Fn(&World) -> [f64; 2]) -> Result<(), String> {
        for _ in 0..ticks {
            let Scene::Simulated(world) = &mut self.scene else { return Err("a log cannot be driven".into()) };
            let [speed, yaw_rate] = command(world);
            if speed == 0.0 && yaw_rate == 0.0 {
                return Ok(());
            }
            let [speed, yaw_rate] = world.drive(speed, yaw_rate);
            let is_scan = world.ticks % TICKS_PER_SCAN == 0;
            let part = RowPart::whole([speed, yaw_rate, 0.0], TICK_S);
            self.seats.iter_mut().for_each(|seat| seat.observer.advance(&part));
            if is_scan {
                self.scan();
            }
        }
        Ok(())
    }

    /// Goes on with the log for so long in its time. Returns whether more is left.
    pub fn replay(&mut self, seconds: f64) -> Result<bool, String> {
        let Scene::Logged(replay) = &mut self.scene else { return Err("no log is loaded".into()) };
        let until_s = replay.now_s() + seconds;
        let mut scans = Vec::new();
        while let Some(moment) = replay.next(until_s)? {
            match moment {
                Moment::Moved(part) => self.seats.iter_mut().for_each(|seat| seat.observer.advance(&part)),
                Moment::Scan { stamp_s, sightings } => {
                    self.seats.iter_mut().for_each(|seat| seat.observer.update(stamp_s, &sightings));
                    scans = sightings;
                }
            }
        }
        let more = !replay.is_done();
        if !scans.is_empty() {
            self.judge(&scans, None);
        }
        Ok(more)
    }

    fn scan(&mut self) {
        let Scene::Simulated(world) = &mut self.scene else { return };
        world.look();
        let stamp_s = world.ticks as f64 * TICK_S;
        let sightings: Vec<Sighting> = world.seen.iter().map(|seen| seen.sighting(self.names)).collect();
        let truth: Vec<u32> = world.seen.iter().map(|seen| seen.landmark).collect();
        self.seats.iter_mut().for_each(|seat| seat.observer.update(stamp_s, &sightings));
        self.judge(&sightings, Some(&truth));
    }

    /// Finds the landmark of each sighting in the map that each filter has after the scan.
    fn judge(&mut self, sightings: &[Sighting], truth: Option<&[u32]>) {
        for seat in &mut self.seats {
            let best = seat.observer.best_pose();
            let taken_for = &mut seat.taken_for;
            let landmarks = &seat.observer.map.landmarks;
            let found = sightings.iter().enumerate().map(|(j, sighting)| {
                let (end_m, distances) = self.view.explain(best, sighting);
                let known = landmarks.iter().find(|l| sighting.identity.is_some() && l.identity == sighting.identity);
                let near = landmarks
                    .iter()
                    .map(|landmark| (distances(landmark.mean), landmark))
                    .min_by(|(a, _), (b, _)| a.total_cmp(b))
                    .filter(|(distance, _)| *distance < 16.0)
                    .map(|(_, landmark)| landmark);
                let landmark = known.or(near);
                let mistaken = landmark
                    .zip(truth)
                    .is_some_and(|(landmark, truth)| *taken_for.entry(landmark.birth).or_insert(truth[j]) != truth[j]);
                Match { end_m, landmark_m: landmark.map(|landmark| landmark.mean), mistaken }
            });
            seat.matches = found.collect();
        }
    }

    /// Mean distance of the landmarks of a map from the true ones for which they were first taken.
    pub fn map_error_m(&self, seat: usize) -> f64 {
        let Scene::Simulated(world) = &self.scene else { return f64::NAN };
        let Seat { observer, taken_for, .. } = &self.seats[seat];
        let distances = observer.map.landmarks.iter().filter(|landmark| landmark.confirmed).filter_map(|landmark| {
            let truth = world.landmarks[*taken_for.get(&landmark.birth)? as usize];
            let [x, y] = [landmark.mean[0] - truth[0], landmark.mean[1] - truth[1]];
            Some((x * x + y * y).sqrt())
        });
        let (sum, count) = distances.fold((0.0, 0.0), |(sum, count), distance| (sum + distance, count + 1.0));
        sum / count
    }
}

fn seats(observers: Vec<Observer>) -> Vec<Seat> {
    let seat = |observer| Seat { observer, matches: Vec::new(), taken_for: HashMap::new() };
    observers.into_iter().map(seat).collect()
}

impl SensorView {
    /// Where a sighting ends that was made at a pose, and a function that tells how many standard deviations of the
    /// sensor, squared, a place is away from it.
    fn explain(&self, T_world_robot: Pose, sighting: &Sighting) -> ([f64; 2], impl Fn([f64; 2]) -> f64) {
        let [range_m, bearing_rad] = self.error.corrected(sighting.value);
        let T_world_ray = T_world_robot.compose(self.T_robot_sensor).compose(Pose::new(0.0, 0.0, bearing_rad));
        let end_m = T_world_ray.transform([range_m, 0.0]);
        let T_ray_world = T_world_ray.inverse();
        // Landmarks are known a little worse than the sensor sees: 0.1 m beside its noise.
        let [along, across] = [self.std[0] + 0.1, self.std[1] * range_m + 0.1];
        let squared = move |place_m: [f64; 2]| {
            let [x, y] = T_ray_world.transform(place_m);
            ((x - range_m) / along).powi(2) + (y / across).powi(2)
        };
        (end_m, squared)
    }
}
