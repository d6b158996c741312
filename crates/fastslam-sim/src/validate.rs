//! Checks of the settings of a simulation.

use crate::config::{Cones, LaserConfig, Orchard, ScanConfig, SimulationConfig, Trajectory, VehicleConfig, World};
use fastslam_core::error::{coordinate, finite, non_negative, positive, Error, Result};
use fastslam_core::measurement::SensorSettings;

/// More than this does not fit into the memory of the machines that this is for.
const MOST_LANDMARKS: u32 = 50_000_000;

impl SimulationConfig {
    /// Errors that name the first setting out of range.
    pub fn validate(&self) -> Result<()> {
        if let Some(start) = self.start {
            coordinate("start.x_m", start.x_m)?;
            coordinate("start.y_m", start.y_m)?;
            finite("start.heading_rad", start.heading_rad)?;
        }
        self.world.validate().map_err(|e| e.within("world"))?;
        self.trajectory.validate().map_err(|e| e.within("trajectory"))?;
        self.motion.validate()?;
        self.validate_sensors()?;
        self.validate_classes().map_err(|e| e.within("classes"))?;
        positive("control_period_s", self.control_period_s)?;
        if let Some(duration_s) = self.max_duration_s {
            positive("max_duration_s", duration_s)?;
        }
        self.vehicle.validate(self.control_period_s).map_err(|e| e.within("vehicle"))?;
        self.scan.validate(self.control_period_s).map_err(|e| e.within("scan"))
    }

    fn validate_sensors(&self) -> Result<()> {
        validate_sensor(&self.sensor).map_err(|e| e.within("sensor"))?;
        if self.sensors.is_empty() {
            return Ok(());
        }
        if self.sensor != Self::default().sensor {
            let expected = "one of the two: `sensor` is the only sensor, `sensors` has a section for each of several";
            return Err(Error::parameter("sensors", "`sensor` beside it", expected));
        }
        if self.scan.laser.is_some() {
            return Err(Error::parameter(
                "sensors",
                "several",
                "none with a laser (scan.laser): `sensor` is the laser",
            ));
        }
        self.sensors.validate()?;
        let mut named = self.sensors.0.keys().zip(self.each_sensor());
        named.try_for_each(|(name, sensor)| validate_sensor(&sensor).map_err(|e| e.within(&format!("sensors.{name}"))))
    }

    fn validate_classes(&self) -> Result<()> {
        let names = &self.classes.names;
        probability("confusion_probability", self.classes.confusion_probability)?;
        if !names.is_empty() && matches!(self.world, World::Cones(_)) {
            return Err(Error::parameter("names", format!("{names:?}"), "none: a track of cones brings its own"));
        }
        if let Some(name) = names.iter().enumerate().find_map(|(i, name)| names[..i].contains(name).then_some(name)) {
            return Err(Error::parameter("names", format!("{name:?} twice"), "distinct names"));
        }
        Ok(())
    }
}

fn validate_sensor(sensor: &SensorSettings) -> Result<()> {
    sensor.validate()?;
    if sensor.max_range_m <= sensor.min_range_m {
        let expected = format!("more than min_range_m ({})", sensor.min_range_m);
        return Err(Error::parameter("max_range_m", sensor.max_range_m, expected));
    }
    if sensor.field_of_view_rad > std::f64::consts::TAU {
        return Err(Error::parameter("field_of_view_rad", sensor.field_of_view_rad, "at most 2π"));
    }
    Ok(())
}

impl World {
    fn validate(&self) -> Result<()> {
        match self {
            Self::Random(field) => {
                count("count", field.count, MOST_LANDMARKS)?;
                positive("size_m", field.size_m[0])?;
                positive("size_m", field.size_m[1])?;
                non_negative("min_spacing_m", field.min_spacing_m).map(drop)
            }
            Self::Orchard(orchard) => orchard.validate(),
            Self::Cones(cones) => cones.validate(),
            Self::Explicit(explicit) => points("points_m", &explicit.points_m, 1),
        }
    }
}

impl Orchard {
    fn validate(&self) -> Result<()> {
        count("rows", self.rows, MOST_LANDMARKS)?;
        count("columns", self.columns, MOST_LANDMARKS / self.rows)?;
        positive("row_spacing_m", self.row_spacing_m)?;
        positive("column_spacing_m", self.column_spacing_m)?;
        non_negative("jitter_std_m", self.jitter_std_m)?;
        probability("missing_probability", self.missing_probability)
    }
}

impl Cones {
    fn validate(&self) -> Result<()> {
        positive("track_length_m", self.track_length_m)?;
        positive("track_width_m", self.track_width_m)?;
        positive("spacing_m", self.spacing_m)?;
        probability("irregularity", self.irregularity)?;
        // A circle whose radius is twice the width: anything shorter cannot bend without its borders touching.
        let shortest = 2.0 * self.track_width_m * std::f64::consts::TAU;
        if self.track_length_m < shortest.max(3.0 * self.spacing_m) {
            return Err(Error::parameter(
                "track_length_m",
                self.track_length_m,
                format!("at least 4π widths ({shortest:.1} m) and three cones on each side"),
            ));
        }
        if self.track_length_m / self.spacing_m > 0.5 * f64::from(MOST_LANDMARKS) {
            let expected = format!("at most {} cones on each side", MOST_LANDMARKS / 2);
            return Err(Error::parameter("track_length_m", self.track_length_m, expected));
        }
        Ok(())
    }
}

impl Trajectory {
    fn validate(&self) -> Result<()> {
        match self {
            Self::Loop(path) => {
                count("laps", path.laps, 10_000)?;
                finite("margin_m", path.margin_m)?;
                non_negative("corner_radius_m", path.corner_radius_m).map(drop)
            }
            Self::Waypoints(path) => points("points_m", &path.points_m, 2),
            Self::LawnMower(path) => {
                optional_positive("lane_spacing_m", path.lane_spacing_m)?;
                count("sweeps", path.sweeps, 1000)
            }
            Self::Line(path) => {
                non_negative("sway_m", path.sway_m)?;
                positive("sway_period_m", path.sway_period_m).map(drop)
            }
            Self::RandomWalk(path) => optional_positive("cell_m", path.cell_m),
        }
    }
}

impl VehicleConfig {
    fn validate(&self, control_period_s: f64) -> Result<()> {
        positive("speed_m_per_s", self.speed_m_per_s)?;
        positive("max_yaw_rate_rad_per_s", self.max_yaw_rate_rad_per_s)?;
        positive("lookahead_m", self.lookahead_m)?;
        let step_m = self.speed_m_per_s * control_period_s;
        if self.lookahead_m < step_m {
            let expected = format!("at least the {step_m} m of one control period");
            return Err(Error::parameter("lookahead_m", self.lookahead_m, expected));
        }
        Ok(())
    }
}

impl ScanConfig {
    fn validate(&self, control_period_s: f64) -> Result<()> {
        positive("period_s", self.period_s)?;
        let ratio = self.period_s / control_period_s;
        if ratio.round() < 1.0 || (ratio - ratio.round()).abs() > 1e-6 {
            let expected = format!("a whole multiple of control_period_s ({control_period_s})");
            return Err(Error::parameter("period_s", self.period_s, expected));
        }
        probability("detection_probability", self.detection_probability)?;
        non_negative("clutter_per_scan", self.clutter_per_scan)?;
        if self.clutter_per_scan > 1e5 {
            return Err(Error::parameter("clutter_per_scan", self.clutter_per_scan, "at most 100000"));
        }
        probability("identities.fraction", self.identities.fraction())?;
        if let Some(signature) = &self.signature {
            positive("signature.mean_m", signature.mean_m)?;
            non_negative("signature.spread_std_m", signature.spread_std_m)?;
            non_negative("signature.measurement_std_m", signature.measurement_std_m)?;
        }
        self.laser.as_ref().map_or(Ok(()), |laser| laser.validate().map_err(|e| e.within("laser")))
    }
}

impl LaserConfig {
    fn validate(&self) -> Result<()> {
        let least_step_rad = 1e-5;
        if !(least_step_rad..=std::f64::consts::PI).contains(&self.angle_step_rad) {
            return Err(Error::parameter("angle_step_rad", self.angle_step_rad, format!("{least_step_rad} to π")));
        }
        non_negative("range_std_m", self.range_std_m)?;
        probability("dropout_probability", self.dropout_probability)?;
        positive("radius_m", self.radius_m[0])?;
        finite("radius_m", self.radius_m[1])?;
        if self.radius_m[1] < self.radius_m[0] {
            let got = format!("{} to {}", self.radius_m[0], self.radius_m[1]);
            return Err(Error::parameter("radius_m", got, "the smallest first"));
        }
        non_negative("clearance_m", self.clearance_m)?;
        self.wall_margin_m.map_or(Ok(()), |margin| non_negative("wall_margin_m", margin).map(drop))
    }
}

fn probability(key: &str, value: f64) -> Result<()> {
    if (0.0..=1.0).contains(&value) {
        Ok(())
    } else {
        Err(Error::parameter(key, value, "a number from 0 to 1"))
    }
}

fn optional_positive(key: &str, value: Option<f64>) -> Result<()> {
    value.map_or(Ok(()), |value| positive(key, value).map(drop))
}

fn count(key: &str, value: u32, most: u32) -> Result<()> {
    if (1..=most).contains(&value) {
        Ok(())
    } else {
        Err(Error::parameter(key, value, format!("from 1 to {most}")))
    }
}

fn points(key: &str, points: &[[f64; 2]], at_least: usize) -> Result<()> {
    if points.len() < at_least {
        return Err(Error::parameter(key, format!("{} points", points.len()), format!("at least {at_least}")));
    }
    let coordinates = points.iter().enumerate().flat_map(|(index, point)| point.map(|value| (index, value)));
    coordinates.into_iter().try_for_each(|(index, value)| coordinate(&format!("{key}.{index}"), value).map(drop))
}
