//! A native log from the text of its files (`docs/native-log-format.md`, the plain dialect).

use crate::settings::Settings;
use fastslam_core::config::{AssociationMode, Config};
use fastslam_core::filter::Sighting;
use fastslam_core::geometry::Pose;
use fastslam_core::math::wrap_angle;
use fastslam_core::timeline::LogData;
use serde::Deserialize;
use serde_json::{json, Map, Value};
use std::collections::HashMap;

/// The contents of the files.
#[derive(Debug, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Files {
    /// `odometry.csv`.
    pub odometry: String,
    /// `sightings.csv`.
    pub sightings: String,
    /// `log.yaml`; empty: noise as the page has it.
    pub settings: String,
}

/// Sections of `log.yaml` that are part of the configuration.
const SECTIONS: [&str; 5] = ["motion", "sensor", "association", "filter", "initial_pose"];
/// Keys of `log.yaml` that are none of the filter's business.
const OTHERS: [&str; 3] = ["format_version", "name", "truth_landmarks_complete"];
const NO_NAME: [&str; 6] = ["", "-1", "nan", "none", "null", "unknown"];
/// Columns of sightings that are left out here.
const UNUSED: [&str; 5] =
    ["class", "signature", "range_variance_m2", "range_bearing_covariance_m_rad", "bearing_variance_rad2"];
/// Bearings beyond are no radians.
const LARGEST_BEARING_RAD: f64 = 4.0 * std::f64::consts::PI;

/// Headers of `odometry.csv`: the models that they fit, the first of which holds where nothing is said.
const HEADERS: [([&str; 3], &[&str]); 4] = [
    (["speed_m_per_s", "yaw_rate_rad_per_s", ""], &["velocity"]),
    (["speed_m_per_s", "steering_rad", ""], &["ackermann"]),
    (["dx_m", "dy_m", "dheading_rad"], &["odometry", "increments"]),
    (["x_m", "y_m", "heading_rad"], &["odometry", "increments"]),
];

/// A table of text.
struct Table {
    file: &'static str,
    header: Vec<String>,
    rows: Vec<(u64, Vec<String>)>,
}

/// The log, its configuration, and what should be told about it.
pub fn read(files: &Files, settings: &Settings) -> Result<(LogData, Config, Vec<String>), String> {
    let mut notes = Vec::new();
    let stated = stated_settings(&files.settings)?;
    let (stamps, controls, model) = odometry(&files.odometry, &stated, &mut notes)?;
    let config = configuration(stated, model, settings, &mut notes)?;
    let mut sightings = sightings(&files.sightings, &mut notes)?;
    sightings.iter_mut().for_each(|(stamp_s, _)| *stamp_s -= config.sensor.common().delay_s);
    sightings.sort_by(|(a, _), (b, _)| a.total_cmp(b));
    let (sighting_stamps_s, sightings) = sightings.into_iter().unzip();
    let log = LogData {
        control_stamps_s: stamps,
        controls,
        control_covariances: vec![],
        sighting_stamps_s,
        sightings,
        sighting_sensors: vec![],
    };
    notes.insert(0, format!("{} rows of odometry, {} sightings", log.controls.len(), log.sightings.len()));
    Ok((log, config, notes))
}

fn stated_settings(text: &str) -> Result<Map<String, Value>, String> {
    if text.trim().is_empty() {
        return Ok(Map::new());
    }
    let value: Value = serde_saphyr::from_str(text).map_err(|error| format!("log.yaml: {error}"))?;
    let Value::Object(stated) = value else { return Err("log.yaml: expected keys with values".into()) };
    match stated.keys().find(|key| !SECTIONS.contains(&key.as_str()) && !OTHERS.contains(&key.as_str())) {
        Some(key) => Err(format!("log.yaml: {key}: this page cannot use it; `fastslam convert` writes a plain log")),
        None => Ok(stated),
    }
}

/// What `log.yaml` says over what the page says.
fn configuration(
    mut stated: Map<String, Value>,
    model: &str,
    settings: &Settings,
    notes: &mut Vec<String>,
) -> Result<Config, String> {
    stated.retain(|key, _| SECTIONS.contains(&key.as_str()));
    let is_new = !stated.contains_key("motion");
    let motion = stated.entry("motion").or_insert_with(|| json!({}));
    if let Value::Object(motion) = motion {
        motion.entry("model").or_insert_with(|| json!(model));
    }
    if is_new {
        notes.push(format!("no noise of the motion is given: the defaults of the model {model} hold"));
    }
    if !stated.contains_key("sensor") {
        let believed = settings.believed_noise;
        let (range, bearing) = (settings.range_std_m * believed, settings.bearing_std_rad * believed);
        stated.insert("sensor".into(), json!({"range_std_m": range, "bearing_std_rad": bearing}));
        notes.push(format!("no noise of the sensor is given: {range:.2} m and {bearing:.3} rad, as set on this page"));
    }
    let mut config: Config =
        serde_json::from_value(Value::Object(stated)).map_err(|error| format!("log.yaml: {error}"))?;
    if !settings.names {
        config.association.mode = AssociationMode::Unknown;
    }
    Ok(config)
}

type Controls = (Vec<f64>, Vec<[f64; 3]>, &'static str);

fn odometry(text: &str, stated: &Map<String, Value>, notes: &mut Vec<String>) -> Result<Controls, String> {
    let table = Table::read("odometry.csv", text)?;
    let fits = |(names, _): &&([&str; 3], &[&str])| names.iter().all(|name| name.is_empty() || table.has(name));
    let (names, models) = HEADERS
        .iter()
        .find(fits)
        .ok_or_else(|| format!("odometry.csv: the header {} is none that this page knows", table.header.join(",")))?;
    let stated = stated.get("motion").and_then(|motion| motion.get("model")).and_then(Value::as_str);
    let model = models
        .iter()
        .find(|model| stated.is_none_or(|stated| stated == **model))
        .ok_or_else(|| format!("odometry.csv: the header does not fit motion.model {}", stated.unwrap_or_default()))?;
    let mut rows: Vec<(f64, [f64; 3])> = Vec::new();
    for row in table.numbers(&["stamp_s", names[0], names[1], names[2]], notes)? {
        rows.push((row.1[0], [row.1[1], row.1[2], row.1[3]]));
    }
    rows.sort_by(|(a, _), (b, _)| a.total_cmp(b));
    let before = rows.len();
    // Of several rows with one stamp the last holds.
    rows.reverse();
    rows.dedup_by_key(|(stamp_s, _)| *stamp_s);
    rows.reverse();
    if rows.len() < before {
        notes.push(format!("odometry.csv: {} rows that repeat a stamp were left out", before - rows.len()));
    }
    if names[0] == "x_m" {
        let poses: Vec<Pose> = rows.iter().map(|(_, [x, y, heading])| Pose::new(*x, *y, *heading)).collect();
        for i in (0..rows.len()).rev() {
            let moved = poses[i.saturating_sub(1)].inverse().compose(poses[i]);
            rows[i].1 = [moved.x, moved.y, wrap_angle(moved.heading)];
        }
    }
    let (stamps, controls) = rows.into_iter().unzip();
    Ok((stamps, controls, model))
}

fn sightings(text: &str, notes: &mut Vec<String>) -> Result<Vec<(f64, Sighting)>, String> {
    let table = Table::read("sightings.csv", text)?;
    for name in UNUSED.iter().filter(|name| table.has(name)) {
        notes.push(format!("sightings.csv: {name} is not used on this page"));
    }
    let known = |name: &String| ["stamp_s", "range_m", "bearing_rad", "landmark_id"].contains(&name.as_str());
    if let Some(name) = table.header.iter().find(|name| !known(name) && !UNUSED.contains(&name.as_str())) {
        return Err(format!("sightings.csv: this page does not know the column {name}"));
    }
    let id = table.header.iter().position(|name| name == "landmark_id");
    let mut numbers: HashMap<String, u32> = HashMap::new();
    let (mut found, mut dropped) = (Vec::new(), 0);
    for (index, [stamp_s, range_m, bearing_rad, _]) in
        table.numbers(&["stamp_s", "range_m", "bearing_rad", ""], notes)?
    {
        if range_m <= 0.0 {
            dropped += 1;
            continue;
        }
        let (line, fields) = &table.rows[index];
        if bearing_rad.abs() > LARGEST_BEARING_RAD {
            return Err(format!("sightings.csv, line {line}: bearing_rad is {bearing_rad}: are these degrees?"));
        }
        let name = id.map(|id| fields[id].trim()).filter(|name| !NO_NAME.contains(&name.to_lowercase().as_str()));
        let next = numbers.len() as u32;
        let identity = name.map(|name| *numbers.entry(name.into()).or_insert(next));
        found.push((stamp_s, Sighting::range_bearing(range_m, wrap_angle(bearing_rad), identity)));
    }
    if dropped > 0 {
        notes.push(format!("sightings.csv: {dropped} rows with a range that is not positive were left out"));
    }
    Ok(found)
}

impl Table {
    fn read(file: &'static str, text: &str) -> Result<Self, String> {
        let mut reader =
            csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(text.trim_start_matches('\u{feff}').as_bytes());
        let wrong = |error: csv::Error| match error.kind() {
            csv::ErrorKind::UnequalLengths { pos, expected_len, len } => {
                let line = pos.as_ref().map_or(0, csv::Position::line);
                format!("{file}, line {line}: {len} columns, expected {expected_len}")
            }
            _ => format!("{file}: {error}"),
        };
        let header: Vec<String> = reader.headers().map_err(wrong)?.iter().map(str::to_lowercase).collect();
        let mut rows = Vec::new();
        for record in reader.records() {
            let record = record.map_err(wrong)?;
            let line = record.position().map_or(0, csv::Position::line);
            rows.push((line, record.iter().map(String::from).collect()));
        }
        let table = Self { file, header, rows };
        if table.has("stamp_s") {
            return Ok(table);
        }
        Err(format!("{file}: no column stamp_s; {}", "the first line must name the columns, separated by commas"))
    }

    fn has(&self, name: &str) -> bool {
        self.header.iter().any(|column| column == name)
    }

    /// Numbers of the named columns, with the row's index; zero for an empty name. Rows with a number that is not finite
    /// are left out.
    fn numbers(&self, names: &[&str; 4], notes: &mut Vec<String>) -> Result<Vec<(usize, [f64; 4])>, String> {
        let mut columns = [None; 4];
        for (column, name) in columns.iter_mut().zip(names).filter(|(_, name)| !name.is_empty()) {
            let found = self.header.iter().position(|n| n == name);
            *column = Some(found.ok_or_else(|| format!("{}: no column {name}", self.file))?);
        }
        let (mut found, mut dropped) = (Vec::new(), 0);
        for (index, (line, fields)) in self.rows.iter().enumerate() {
            let mut numbers = [0.0_f64; 4];
            for (number, column) in numbers.iter_mut().zip(columns) {
                let Some(column) = column else { continue };
                let text = fields[column].trim();
                *number = text.parse().map_err(|_| {
                    format!("{}, line {line}: {}: {text:?} is no number", self.file, self.header[column])
                })?;
            }
            match numbers.iter().all(|number| number.is_finite()) {
                true => found.push((index, numbers)),
                false => dropped += 1,
            }
        }
        if dropped > 0 {
            notes.push(format!("{}: {dropped} rows with numbers that are not finite were left out", self.file));
        }
        Ok(found)
    }
}
