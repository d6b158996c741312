//! Laser scans of a stream: landmarks are detected in each as soon as it is known how the sensor moves meanwhile.

use crate::association::Appearance;
use crate::config::Config;
use crate::detect::{BeamGeometry, Detection, Detector, DetectorConfig, Scan};
use crate::error::{Error, Result};
use crate::geometry::Pose;
use crate::math;
use crate::measurement::Sensor;
use crate::motion::{ControlTiming, Motion};
use crate::sighting::Sighting;
use crate::timeline::ControlRow;
use serde::{Deserialize, Serialize};

/// A laser scanner that sits where the sensor of the configuration does.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Scanner {
    /// Where its beams point and how far they reach.
    pub geometry: BeamGeometry,
    /// How landmarks are found in its scans.
    pub detector: DetectorConfig,
}

/// One turn of it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ScanRow {
    /// Of beam 0, in seconds.
    pub stamp_s: f64,
    /// As in [`Scan::ranges_m`].
    pub ranges_m: Vec<f64>,
    /// As in [`Scan::intensities`].
    pub intensities: Option<Vec<f64>>,
}

/// A scanner at work: its detector, and the scans that wait.
#[derive(Clone, Debug)]
pub(super) struct Scanning {
    scanner: Scanner,
    detector: Detector,
    found: Vec<Detection>,
    queue: Queue,
}

/// What a snapshot holds of it beside the scanner.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
struct Queue {
    /// In the order of time.
    scans: Vec<ScanRow>,
    /// Rows of odometry, as far back as a scan may ask for.
    controls: Vec<ControlRow>,
    /// Whether nothing more comes.
    ended: bool,
}

impl Scanning {
    /// **Errors:** settings of the detector that are out of range.
    pub fn new(scanner: Scanner) -> Result<Self> {
        let detector = Detector::new(scanner.detector.clone())?;
        scanner.geometry.validate(0).map_err(|e| e.within("geometry"))?;
        Ok(Self { scanner, detector, found: Vec::new(), queue: Queue::default() })
    }

    /// **Errors:** a scan that does not fit the scanner.
    pub fn check(&self, scan: &ScanRow) -> Result<()> {
        scan.of(self.scanner.geometry, None).check()?;
        if scan.stamp_s.is_finite() {
            return Ok(());
        }
        Err(Error::Input(format!("the stamp is {}, expected seconds", scan.stamp_s)))
    }

    /// Takes a scan; `false` for one that is there already.
    pub fn put(&mut self, scan: ScanRow) -> bool {
        let scans = &mut self.queue.scans;
        let place = scans.partition_point(|known| known.stamp_s < scan.stamp_s);
        let repeated = scans.get(place).is_some_and(|known| known.stamp_s == scan.stamp_s);
        if !repeated {
            scans.insert(place, scan);
        }
        !repeated
    }

    /// Remembers a row of odometry.
    pub fn moves(&mut self, row: ControlRow) {
        if self.corrects() {
            let controls = &mut self.queue.controls;
            controls.insert(controls.partition_point(|known| known.stamp_s < row.stamp_s), row);
        }
    }

    /// Nothing more comes.
    pub fn end(&mut self) {
        self.queue.ended = true;
    }

    /// Whether nothing more comes.
    pub fn has_ended(&self) -> bool {
        self.queue.ended
    }

    /// Scans that wait.
    pub fn waiting(&self) -> usize {
        self.queue.scans.len()
    }

    /// Stamp of the first scan that waits.
    pub fn next_s(&self) -> f64 {
        self.queue.scans.first().map_or(f64::INFINITY, |scan| scan.stamp_s)
    }

    /// What was seen in the next scan, with its stamp; none where it must wait. All rows before `settled_s` have come.
    ///
    /// **Errors:** a motion that no scan can be corrected for. The scan is passed over.
    pub fn next(&mut self, config: &Config, settled_s: f64, wait_s: f64) -> Result<Option<(f64, Vec<Sighting>)>> {
        let settled_s = if self.queue.ended { f64::INFINITY } else { settled_s };
        self.forget(settled_s);
        let Some(stamp_s) = self.queue.scans.first().map(|scan| scan.stamp_s) else { return Ok(None) };
        if self.corrects() && !self.knows_motion(config.motion.timing(), stamp_s, (settled_s, wait_s)) {
            return Ok(None);
        }
        let twist = self.corrects().then(|| {
            at_sensor(velocity_at(&config.motion, &self.queue.controls, stamp_s), config.sensor.T_robot_sensor())
        });
        let scan = self.queue.scans.remove(0);
        self.found.clear();
        self.detector.detect(&scan.of(self.scanner.geometry, twist), &mut self.found)?;
        let seen = self.found.iter().map(|detection| sighting(detection, &config.sensor)).collect();
        Ok(Some((stamp_s, seen)))
    }

    /// For a snapshot: the scanner as JSON, and the rows that wait.
    pub fn stored(&self) -> Result<(String, Vec<u8>)> {
        let failed = |e: &dyn std::fmt::Display| Error::Input(format!("the scanner cannot be stored: {e}"));
        let scanner = serde_json::to_string(&self.scanner).map_err(|e| failed(&e))?;
        Ok((scanner, postcard::to_allocvec(&self.queue).map_err(|e| failed(&e))?))
    }

    /// What was stored.
    ///
    /// **Errors:** [`Error::Input`] where it cannot be read.
    pub fn restored((scanner, queue): (String, Vec<u8>)) -> Result<Self> {
        let failed =
            |e: &dyn std::fmt::Display| Error::Input(format!("the scanner of the snapshot cannot be read ({e})"));
        let scanner = serde_json::from_str(&scanner).map_err(|e| failed(&e))?;
        Ok(Self { queue: postcard::from_bytes(&queue).map_err(|e| failed(&e))?, ..Self::new(scanner)? })
    }

    /// Whether the motion within a scan is corrected.
    fn corrects(&self) -> bool {
        self.scanner.geometry.beam_period_s.is_some_and(|period| period > 0.0)
    }
    /// Whether the rows tell how the robot moves at a moment, or never will.
    fn knows_motion(&self, timing: ControlTiming, stamp_s: f64, (settled_s, wait_s): (f64, f64)) -> bool {
        let next = self.queue.controls.iter().find(|row| row.stamp_s >= stamp_s);
        match (timing, next) {
            (ControlTiming::Held, _) => stamp_s < settled_s,
            (ControlTiming::Increment, Some(next)) => next.stamp_s <= settled_s,
            (ControlTiming::Increment, None) => settled_s - stamp_s > wait_s,
        }
    }

    /// Drops rows of odometry that no scan can ask for: all but the last two before the first that may come.
    fn forget(&mut self, settled_s: f64) {
        let first_s = settled_s.min(self.next_s());
        let passed = self.queue.controls.partition_point(|row| row.stamp_s < first_s);
        self.queue.controls.drain(..passed.saturating_sub(2));
    }
}

impl ScanRow {
    fn of(&self, geometry: BeamGeometry, twist: Option<[f64; 3]>) -> Scan<'_> {
        Scan { ranges_m: &self.ranges_m, intensities: self.intensities.as_deref(), geometry, twist }
    }
}

/// Velocity of the robot at a moment by rows of odometry in the order of time: forward and left in metres per second,
/// turn in radians per second. Zero where no row tells.
///
/// A row that holds counts from its stamp on; a displacement between the stamp before and its own.
pub fn velocity_at(motion: &Motion, rows: &[ControlRow], stamp_s: f64) -> [f64; 3] {
    let begun = match motion.timing() {
        ControlTiming::Held => rows.partition_point(|row| row.stamp_s <= stamp_s),
        ControlTiming::Increment => rows.partition_point(|row| row.stamp_s < stamp_s),
    };
    begun.checked_sub(1).map_or([0.0; 3], |row| velocity_from(motion, rows, row))
}

/// As [`velocity_at`], from the stamp of row `row` until the next one.
pub fn velocity_from(motion: &Motion, rows: &[ControlRow], row: usize) -> [f64; 3] {
    match motion.timing() {
        ControlTiming::Held => motion.row(rows[row].control, 1.0).twist,
        ControlTiming::Increment => rows.get(row + 1).map_or([0.0; 3], |next| {
            let row_s = next.stamp_s - rows[row].stamp_s;
            motion.row(next.control, row_s).twist.map(|way| way / row_s)
        }),
    }
}

/// The velocity of a sensor in its own frame.
pub fn at_sensor([forward, left, turn]: [f64; 3], T_robot_sensor: Pose) -> [f64; 3] {
    let (forward, left) = (forward - turn * T_robot_sensor.y, left + turn * T_robot_sensor.x);
    let (s, c) = math::sin_cos(T_robot_sensor.heading);
    [c * forward + s * left, c * left - s * forward, turn]
}

fn sighting(detection: &Detection, sensor: &Sensor) -> Sighting {
    let Detection { range_m, bearing_rad, covariance, signature, .. } = *detection;
    let appearance = Appearance { class: None, signature: (!signature.is_nan()).then_some(signature) };
    Sighting { value: sensor.value_of(range_m, bearing_rad), identity: None, noise: Some(covariance), appearance }
}
