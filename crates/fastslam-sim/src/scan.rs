//! What the sensor reports along the path.

use crate::config::SimulationConfig;
use crate::draws::{poisson, Draws, Part};
use crate::grid::PointGrid;
use crate::log::SimulatedSightings;
use crate::world::Scene;
use fastslam_core::geometry::Pose;
use fastslam_core::measurement::{MeasurementModel, RangeBearing, SensorSettings};

/// One report of the sensor, before it is filed.
#[derive(Clone, Copy, Debug)]
struct Sighting {
    range_m: f64,
    bearing_rad: f64,
    identity: i64,
    true_identity: i64,
    class_index: i64,
    signature: f64,
}

/// Looks once per scan period with each sensor, from the first pose on; says also which landmarks were ever reported.
pub fn scan(config: &SimulationConfig, scene: &Scene, poses: &[Pose], draws: Draws) -> (SimulatedSightings, Vec<bool>) {
    let scanners: Vec<Scanner<'_>> =
        config.each_sensor().into_iter().map(|sensor| Scanner::new(config, scene, draws, sensor)).collect();
    let mut log = SimulatedSightings::default();
    let mut seen = vec![false; scene.position_m.len()];
    let (mut visible, mut reported) = (vec![], vec![]);
    for (step, T_world_robot) in poses.iter().enumerate().step_by(config.controls_per_scan()) {
        let stamp_s = step as f64 * config.control_period_s;
        for (sensor, scanner) in scanners.iter().enumerate() {
            reported.clear();
            scanner.find_visible(T_world_robot.compose(scanner.sensor.mounting.T_robot_sensor()), &mut visible);
            // Numbers of their own for each look: those of the only sensor are numbered by step.
            let look = step * scanners.len() + sensor;
            scanner.report_landmarks(look, &visible, &mut reported);
            scanner.report_clutter(look, &mut reported);
            // In the order of a turning sensor, which tells nothing about what was sighted.
            reported.sort_by(|a: &Sighting, b| a.bearing_rad.total_cmp(&b.bearing_rad));
            for sighting in &reported {
                log.push((stamp_s, sensor), sighting);
                if let Ok(landmark) = usize::try_from(sighting.true_identity) {
                    seen[landmark] = true;
                }
            }
        }
    }
    (log, seen)
}

/// A landmark in view: number, true range and bearing.
#[derive(Clone, Copy, Debug)]
struct Visible {
    landmark: usize,
    range_m: f64,
    bearing_rad: f64,
}

struct Scanner<'a> {
    config: &'a SimulationConfig,
    scene: &'a Scene,
    grid: PointGrid,
    draws: Draws,
    sensor: SensorSettings,
    model: RangeBearing,
}

impl<'a> Scanner<'a> {
    fn new(config: &'a SimulationConfig, scene: &'a Scene, draws: Draws, sensor: SensorSettings) -> Self {
        // A quarter of the range: the cells' union then exceeds the disc by little.
        let grid = PointGrid::from_points(&scene.position_m, 0.25 * sensor.max_range_m);
        let SensorSettings { range_std_m, bearing_std_rad, .. } = sensor;
        Self { config, scene, grid, draws, model: RangeBearing { range_std_m, bearing_std_rad }, sensor }
    }

    /// Whether the sensor can report this range and bearing.
    fn in_view(&self, range_m: f64, bearing_rad: f64) -> bool {
        let sensor = &self.sensor;
        (sensor.min_range_m..=sensor.max_range_m).contains(&range_m)
            && bearing_rad.abs() <= 0.5 * sensor.field_of_view_rad
    }

    /// All landmarks within range and field of view, nearest first.
    fn find_visible(&self, T_world_sensor: Pose, visible: &mut Vec<Visible>) {
        visible.clear();
        let center = [T_world_sensor.x, T_world_sensor.y];
        self.grid.visit_within(center, self.sensor.max_range_m, |landmark, _| {
            let [range_m, bearing_rad] = self.model.expected(T_world_sensor, self.grid.points()[landmark]);
            if self.in_view(range_m, bearing_rad) {
                visible.push(Visible { landmark, range_m, bearing_rad });
            }
            true
        });
        visible.sort_by(|a, b| a.range_m.total_cmp(&b.range_m).then(a.landmark.cmp(&b.landmark)));
    }

    /// Every draw is addressed by the landmark, so that none depends on what else is in view.
    fn report_landmarks(&self, look: usize, visible: &[Visible], reported: &mut Vec<Sighting>) {
        let scan = &self.config.scan;
        let stream = self.draws.stream(Part::Sighting, look);
        let most = scan.max_sightings_per_scan.map_or(usize::MAX, |most| most as usize);
        for seen in visible {
            if reported.len() >= most {
                break;
            }
            let address = seen.landmark as u32;
            let [detection, naming] = stream.uniform_pair(address, 0);
            if detection >= scan.detection_probability {
                continue;
            }
            let [range_noise, bearing_noise] = stream.normal_pair(address, 1);
            let range_m = seen.range_m + self.model.range_std_m * range_noise;
            let raw = seen.bearing_rad + self.model.bearing_std_rad * bearing_noise;
            let [_, bearing_rad] = self.model.innovation([0.0, raw], [0.0, 0.0]);
            // A sensor never reports what lies outside of its limits, even where noise has carried it there.
            if !self.in_view(range_m, bearing_rad) {
                continue;
            }
            let identity = seen.landmark as i64;
            let signature_noise = stream.normal_pair(address, 3)[0];
            reported.push(Sighting {
                range_m,
                bearing_rad,
                identity: if naming < scan.identities.fraction() { identity } else { -1 },
                true_identity: identity,
                class_index: self
                    .reported_class(self.scene.class_index[seen.landmark], stream.uniform_pair(address, 2)),
                signature: self.scene.signature[seen.landmark] + self.signature_std_m() * signature_noise,
            });
        }
    }

    fn signature_std_m(&self) -> f64 {
        self.config.scan.signature.as_ref().map_or(0.0, |signature| signature.measurement_std_m)
    }

    /// The true class, or with the probability of confusion one of the others.
    fn reported_class(&self, class_index: i64, [confusion, other]: [f64; 2]) -> i64 {
        let count = self.scene.class_names.len() as i64;
        if count < 2 || class_index < 0 || confusion >= self.config.classes.confusion_probability {
            return class_index;
        }
        (class_index + 1 + (other * (count - 1) as f64) as i64) % count
    }

    /// False sightings, uniform over the area in view.
    fn report_clutter(&self, look: usize, reported: &mut Vec<Sighting>) {
        let (scan, sensor) = (&self.config.scan, &self.sensor);
        let stream = self.draws.stream(Part::Clutter, look);
        let classes = self.scene.class_names.len();
        for index in 1..=poisson(stream, 0, scan.clutter_per_scan) {
            let [u, v] = stream.uniform_pair(index, 0);
            let (near, far) = (sensor.min_range_m * sensor.min_range_m, sensor.max_range_m * sensor.max_range_m);
            let class = (stream.uniform(index, 1) * classes as f64) as i64;
            let [population, measurement] = stream.normal_pair(index, 2);
            reported.push(Sighting {
                range_m: (near + u * (far - near)).sqrt(),
                bearing_rad: (v - 0.5) * sensor.field_of_view_rad,
                identity: -1,
                true_identity: -1,
                class_index: if classes == 0 { -1 } else { class },
                signature: scan
                    .signature
                    .as_ref()
                    .map_or(f64::NAN, |s| s.of_population(population) + s.measurement_std_m * measurement),
            });
        }
    }
}

impl SimulatedSightings {
    fn push(&mut self, (stamp_s, sensor): (f64, usize), sighting: &Sighting) {
        self.stamp_s.push(stamp_s);
        self.sensor.push(sensor as u8);
        self.range_m.push(sighting.range_m);
        self.bearing_rad.push(sighting.bearing_rad);
        self.identity.push(sighting.identity);
        self.true_identity.push(sighting.true_identity);
        self.class_index.push(sighting.class_index);
        self.signature.push(sighting.signature);
    }
}
