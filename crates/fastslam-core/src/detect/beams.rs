//! A scan as points: which beams hit something, where, and from where they were sent.

use crate::error::{finite, non_negative, positive, Error, Result};
use crate::geometry::Pose;
use crate::math;
use serde::{Deserialize, Serialize};

/// One turn of a planar laser.
#[derive(Clone, Copy, Debug)]
pub struct Scan<'a> {
    /// One range per beam. Infinity or [`BeamGeometry::max_range_m`] and beyond: nothing was hit. NaN, zero or
    /// negative: nothing is known of this beam. Below [`BeamGeometry::min_range_m`]: something near, of no use but as
    /// an occluder.
    pub ranges_m: &'a [f64],
    /// Strength of each echo in any unit.
    pub intensities: Option<&'a [f64]>,
    /// Where the beams point and how far they reach.
    pub geometry: BeamGeometry,
    /// Velocity of the sensor in its own frame during the scan: forward and left in metres per second, turn in radians
    /// per second. Used where [`BeamGeometry::beam_period_s`] is known.
    pub twist: Option<[f64; 3]>,
}

impl Scan<'_> {
    /// **Errors:** a geometry that makes no sense, intensities of another number than the ranges, or a twist that is not
    /// finite.
    pub fn check(&self) -> Result<()> {
        self.geometry.validate(self.ranges_m.len()).map_err(|e| e.within("geometry"))?;
        if let Some(intensities) = self.intensities {
            if intensities.len() != self.ranges_m.len() {
                let (got, expected) = (intensities.len(), self.ranges_m.len());
                return Err(Error::Input(format!("scan: got {got} intensities for {expected} ranges")));
            }
        }
        for value in self.twist.unwrap_or_default() {
            finite("twist", value)?;
        }
        Ok(())
    }
}

/// More beams than any planar laser has; bounds the memory that a wrong header can ask for.
const MAX_BEAMS: usize = 1 << 20;

/// Where the beams of a scan point and how far they reach.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BeamGeometry {
    /// Direction of beam 0, counter-clockwise from straight ahead.
    pub first_angle_rad: f64,
    /// From one beam to the next; negative where the scanner turns clockwise.
    pub angle_step_rad: f64,
    /// Echoes nearer than this are no measurements.
    pub min_range_m: f64,
    /// Ranges from here on say that nothing was hit.
    pub max_range_m: f64,
    /// Time from one beam to the next, where it is known and the motion within a scan is to be corrected.
    pub beam_period_s: Option<f64>,
}

impl BeamGeometry {
    /// Errors that name the first field out of range for a scan of so many beams.
    pub fn validate(&self, beams: usize) -> Result<()> {
        finite("first_angle_rad", self.first_angle_rad)?;
        if self.first_angle_rad.abs() > 2.0 * std::f64::consts::TAU {
            return Err(Error::parameter("first_angle_rad", self.first_angle_rad, "radians, at most two turns"));
        }
        non_negative("min_range_m", self.min_range_m)?;
        positive("max_range_m", self.max_range_m)?;
        if self.max_range_m <= self.min_range_m {
            return Err(Error::parameter("max_range_m", self.max_range_m, "more than min_range_m"));
        }
        if !(self.angle_step_rad.abs() <= std::f64::consts::TAU && self.angle_step_rad != 0.0) {
            return Err(Error::parameter("angle_step_rad", self.angle_step_rad, "at most a turn, and not 0"));
        }
        if beams > MAX_BEAMS {
            return Err(Error::parameter("beams", beams, format!("at most {MAX_BEAMS}")));
        }
        // Half a step of slack: some drivers repeat the first beam at the end of a full turn.
        if (beams as f64 - 1.5) * self.angle_step_rad.abs() > std::f64::consts::TAU {
            let expected = format!("at most one turn for {beams} beams");
            return Err(Error::parameter("angle_step_rad", self.angle_step_rad, expected));
        }
        self.beam_period_s.map_or(Ok(()), |period| non_negative("beam_period_s", period).map(|_| ()))
    }
}

/// What came back from a beam.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Echo {
    /// A surface within the limits.
    Hit,
    /// Nothing up to the largest range.
    Beyond,
    /// Something too near to be measured.
    Near,
    /// No information.
    Unknown,
}

/// The beams of one scan, corrected for the motion of the sensor. Coordinates are in the sensor frame at beam 0.
#[derive(Clone, Debug, Default)]
pub(super) struct Beams {
    geometry: Option<BeamGeometry>,
    unmoved: Vec<[f64; 2]>,
    /// Ranges as measured; meaningful where the echo is a hit.
    pub range: Vec<f64>,
    /// What came back.
    pub echo: Vec<Echo>,
    /// Where each beam was sent from.
    pub origin: Vec<[f64; 2]>,
    /// Unit vector of each beam.
    pub direction: Vec<[f64; 2]>,
    /// Whether the last beam is next to the first.
    pub closed: bool,
    /// Angle from one beam to the next.
    pub step: f64,
}

impl Beams {
    /// Take over one scan, whose geometry is valid.
    pub fn load(&mut self, scan: &Scan) {
        let (geometry, n) = (scan.geometry, scan.ranges_m.len());
        if self.geometry != Some(geometry) || self.unmoved.len() != n {
            self.unmoved.clear();
            self.unmoved.extend((0..n).map(|i| {
                let (s, c) = math::sin_cos(geometry.first_angle_rad + i as f64 * geometry.angle_step_rad);
                [c, s]
            }));
            self.geometry = Some(geometry);
            self.step = geometry.angle_step_rad;
            self.closed = n > 2 && n as f64 * self.step.abs() > std::f64::consts::TAU - 0.5 * self.step.abs();
        }
        self.range.clear();
        self.range.extend_from_slice(scan.ranges_m);
        self.echo.clear();
        self.echo.extend(scan.ranges_m.iter().map(|&range| classify(range, &geometry)));
        self.place(scan.twist, geometry.beam_period_s);
    }

    fn place(&mut self, twist: Option<[f64; 3]>, beam_period_s: Option<f64>) {
        let n = self.range.len();
        self.origin.clear();
        self.direction.clear();
        match (twist, beam_period_s) {
            (Some([forward, left, turn]), Some(period)) if period > 0.0 => {
                for (i, &direction) in self.unmoved.iter().enumerate() {
                    let time = i as f64 * period;
                    let moved = Pose::from_twist(forward * time, left * time, turn * time);
                    let tip = moved.transform(direction);
                    self.origin.push([moved.x, moved.y]);
                    self.direction.push([tip[0] - moved.x, tip[1] - moved.y]);
                }
            }
            _ => {
                self.origin.resize(n, [0.0; 2]);
                self.direction.extend_from_slice(&self.unmoved);
            }
        }
    }

    /// Number of beams.
    pub fn len(&self) -> usize {
        self.range.len()
    }

    /// The point that beam `i` hit.
    #[inline]
    pub fn point(&self, i: usize) -> [f64; 2] {
        let (o, d, r) = (self.origin[i], self.direction[i], self.range[i]);
        [o[0] + r * d[0], o[1] + r * d[1]]
    }

    /// Beam `i`, which may count on over the seam of a full turn.
    #[inline]
    pub fn index(&self, i: usize) -> usize {
        if i < self.len() {
            i
        } else {
            i - self.len()
        }
    }
}

fn classify(range: f64, geometry: &BeamGeometry) -> Echo {
    if range.is_nan() || range <= 0.0 {
        Echo::Unknown
    } else if range < geometry.min_range_m {
        Echo::Near
    } else if range >= geometry.max_range_m {
        Echo::Beyond
    } else {
        Echo::Hit
    }
}
