//! What crosses to Python about a step: the one list. The arrays of a run, the answer to one update, `steps.csv` and the
//! fields of `fastslam.result.StepFields` all follow it.

use fastslam_core::diagnosis::Health;
use fastslam_core::filter::{LeftOut, MapChanges, NoiseInWindow, Sampling, Skipped, StepInfo, Weighing};
use numpy::IntoPyArray;
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::{PyDict, PyString};

/// What a field is; in Python `number` is a float, `count` an integer, `flag` a bool; `status` and `reasons` are coded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    Number,
    Count,
    Flag,
    Status,
    Reasons,
}

impl Kind {
    fn label(self) -> &'static str {
        match self {
            Self::Number => "number",
            Self::Count => "count",
            Self::Flag => "flag",
            Self::Status => "status",
            Self::Reasons => "reasons",
        }
    }
}

/// How a field is read from a step.
enum Read {
    Number(fn(&StepInfo) -> f64),
    Whole(fn(&StepInfo) -> i64),
    Flag(fn(&StepInfo) -> bool),
}

/// One field of a step.
pub struct Field {
    pub name: &'static str,
    pub kind: Kind,
    read: Read,
}

/// Turns blocks `core_field (where.it.stands) { name: Kind = how to make it of the core's field, … }` into the list.
///
/// Every field of the core's `StepInfo`, which the pattern takes apart, must have its block, or this does not compile
/// without a warning.
macro_rules! step_fields {
    (@at $info:ident ($($place:tt)+)) => { $info.$($place)+ };
    (@read Number, $read:expr) => { Read::Number($read) };
    (@read Flag, $read:expr) => { Read::Flag($read) };
    (@read $whole:ident, $read:expr) => { Read::Whole($read) };
    ($whole:pat => $($field:ident $place:tt { $($name:ident: $kind:ident = $make:expr),* })*) => {
        /// All fields, in the order in which they are shown.
        pub const FIELDS: &[Field] = &[$($(Field {
            name: stringify!($name),
            kind: Kind::$kind,
            read: step_fields!(@read $kind, |info| ($make)(step_fields!(@at info $place))),
        },)*)*];

        /// Only names all fields, so that none can be added to the core and forgotten here.
        const _: fn(StepInfo) = |$whole| { $(let _ = $field;)* };
    };
}

step_fields! {
    StepInfo {
        step,
        sightings,
        changes: MapChanges { new_landmarks, removed, merged },
        fell_back,
        left_out: LeftOut { ignored, skipped },
        weighing: Weighing { effective_sample_size, resampled, log_likelihood },
        landmarks,
        sampling: Sampling { rejuvenated, sampled, particles },
        matched,
        repaired,
        noise: NoiseInWindow { nis, nis_band, warnings },
        health,
    } =>
    step (step) { step: Count = |n| n as i64 }
    sightings (sightings) { sightings: Count = i64::from }
    skipped (left_out.skipped) { skipped: Count = |s: Skipped| i64::from(s.total()) }
    matched (matched) { matched: Count = i64::from }
    new_landmarks (changes.new_landmarks) { new_landmarks: Count = i64::from }
    ignored (left_out.ignored) { ignored: Count = i64::from }
    landmarks (landmarks) { landmarks: Count = i64::from }
    removed (changes.removed) { removed: Count = i64::from }
    merged (changes.merged) { merged: Count = i64::from }
    particles (sampling.particles) { particles: Count = i64::from }
    effective_sample_size (weighing.effective_sample_size) { effective_sample_size: Number = f64::from }
    log_likelihood (weighing.log_likelihood) { log_likelihood: Number = f64::from }
    resampled (weighing.resampled) { resampled: Flag = bool::from }
    rejuvenated (sampling.rejuvenated) { rejuvenated: Flag = bool::from }
    sampled (sampling.sampled) { sampled: Flag = bool::from }
    repaired (repaired) { repaired: Count = i64::from }
    fell_back (fell_back) { fell_back: Count = i64::from }
    nis (noise.nis) { nis: Number = f64::from }
    nis_band (noise.nis_band) { nis_band_low: Number = |band: [f64; 2]| band[0], nis_band_high: Number = |band: [f64; 2]| band[1] }
    health (health) {
        health: Status = |health: Health| health.status as i64,
        health_reasons: Reasons = |health: Health| i64::from(health.reasons)
    }
    // Crosses as sentences, which need the configuration.
    warnings (noise.warnings) {}
}

/// The names of the fields as Python has them: made once, not for every step of a robot on its way.
static NAMES: PyOnceLock<Vec<Py<PyString>>> = PyOnceLock::new();

/// Name and kind of each field of a step, in the order in which they are shown.
#[pyfunction]
pub fn step_fields() -> Vec<(&'static str, &'static str)> {
    FIELDS.iter().map(|field| (field.name, field.kind.label())).collect()
}

/// Adds the fields of one step to `dict`, a value each.
pub fn set_values(dict: &Bound<'_, PyDict>, info: &StepInfo) -> PyResult<()> {
    let names = NAMES.get_or_init(dict.py(), || {
        FIELDS.iter().map(|field| PyString::intern(dict.py(), field.name).unbind()).collect()
    });
    FIELDS.iter().zip(names).try_for_each(|(field, name)| match field.read {
        Read::Number(read) => dict.set_item(name, read(info)),
        Read::Whole(read) => dict.set_item(name, read(info)),
        Read::Flag(read) => dict.set_item(name, read(info)),
    })
}

/// Adds the fields of many steps to `dict`, an array each.
pub fn set_columns<'a>(dict: &Bound<'_, PyDict>, infos: impl Iterator<Item = &'a StepInfo> + Clone) -> PyResult<()> {
    let py = dict.py();
    FIELDS.iter().try_for_each(|field| {
        let infos = infos.clone();
        match field.read {
            Read::Number(read) => dict.set_item(field.name, infos.map(read).collect::<Vec<_>>().into_pyarray(py)),
            Read::Whole(read) => dict.set_item(field.name, infos.map(read).collect::<Vec<_>>().into_pyarray(py)),
            Read::Flag(read) => dict.set_item(field.name, infos.map(read).collect::<Vec<_>>().into_pyarray(py)),
        }
    })
}
