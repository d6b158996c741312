//! What a filter is given to begin with: landmarks of a map, and where the robot may be.

use crate::error::{coordinate, Error, Result};
use crate::gaussian::{Gaussian, GaussianOf};
use crate::geometry::{Matrix3, Pose, Symmetric2};
use crate::limits::{FARTHEST_M, WIDEST_RAD};
use crate::motion::MotionGaussian;
use crate::sighting::Appearance;
use rustc_hash::FxHashMap;
use serde::{Deserialize, Serialize};

/// Added to the variances of a fixed landmark, square metres: no place is known better than to a tenth of a millimetre.
const LEAST_VARIANCE_M2: f64 = 1e-8;

/// What sightings may do to a landmark of a given map.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Role {
    /// Surveyed: nothing changes or removes it, and none is founded over it.
    Fixed,
    /// Known as a Gaussian, which sightings improve.
    Prior,
}

/// A landmark of a given map.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct GivenLandmark {
    /// Where it lies.
    pub place: Gaussian,
    /// Which landmark it is, where somebody says so.
    pub identity: Option<u32>,
    /// What it looks like.
    pub appearance: Appearance,
    /// Log-odds that it exists, where somebody says so; else the highest that are counted.
    pub log_odds: Option<f64>,
    /// How often it was seen when the map was made.
    pub sightings: u32,
    /// What sightings may do to it.
    pub role: Role,
}

/// Where the robot may be.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub enum Start {
    /// At the configured pose.
    #[default]
    Configured,
    /// Mean, and covariance in the world (x, y, heading).
    Gaussian(Pose, Matrix3),
    /// At one of these, each as likely.
    Samples(Vec<Pose>),
}

/// What a filter is given to begin with.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Beginning {
    /// Landmarks, in the frame that the path will be in.
    pub landmarks: Vec<GivenLandmark>,
    /// Where the robot may be.
    pub start: Start,
}

impl GivenLandmark {
    /// The landmark as a filter takes it.
    pub(crate) fn usable(mut self) -> Self {
        if self.role == Role::Fixed {
            self.place.covariance.xx += LEAST_VARIANCE_M2;
            self.place.covariance.yy += LEAST_VARIANCE_M2;
        }
        self
    }

    fn validate(&self) -> Result<()> {
        for (key, value) in [("x_m", self.place.mean[0]), ("y_m", self.place.mean[1])] {
            coordinate(key, value)?;
        }
        let Symmetric2 { xx, xy, yy } = self.place.covariance;
        let within = [xx, xy, yy].iter().all(|v| v.abs() <= FARTHEST_M * FARTHEST_M);
        let definite = xx >= 0.0 && yy >= 0.0 && self.place.covariance.determinant() >= 0.0;
        let known = self.role == Role::Fixed && definite;
        if !within || !(known || self.place.is_usable()) {
            let what = if self.role == Role::Fixed { "a covariance" } else { "a positive definite covariance" };
            return Err(Error::parameter("covariance", format!("{xx}, {xy}, {yy}"), what));
        }
        match self.log_odds {
            Some(odds) if !odds.is_finite() => Err(Error::parameter("existence", odds, "a number between 0 and 1")),
            _ => Ok(()),
        }
    }
}

impl Beginning {
    /// Whether nothing is given.
    pub fn is_empty(&self) -> bool {
        self.landmarks.is_empty() && self.start == Start::Configured
    }

    /// **Errors:** [`Error::Parameter`] that names the landmark or `start`.
    pub(crate) fn validate(&self) -> Result<()> {
        let mut named = FxHashMap::default();
        for (row, landmark) in self.landmarks.iter().enumerate() {
            landmark.validate().map_err(|e| e.within(&format!("map.{row}")))?;
            let Some(identity) = landmark.identity else { continue };
            if let Some(other) = named.insert(identity, row) {
                let expected = format!("another identity than that of landmark {other}");
                return Err(Error::parameter(format!("map.{row}.identity"), identity, expected));
            }
        }
        self.start.validate()
    }
}

impl Start {
    fn validate(&self) -> Result<()> {
        let poses = match self {
            Self::Configured => return Ok(()),
            Self::Gaussian(mean, _) => std::slice::from_ref(mean),
            Self::Samples(poses) => poses,
        };
        let sound =
            |pose: &Pose| [pose.x, pose.y].iter().all(|v| v.abs() <= FARTHEST_M) && pose.heading.abs() <= WIDEST_RAD;
        if poses.is_empty() || !poses.iter().all(sound) {
            return Err(Error::parameter("start", "poses", "one pose at least, of finite numbers"));
        }
        match self {
            Self::Gaussian(_, covariance) if lower_triangle(covariance).is_none() => {
                Err(Error::parameter("start.covariance", format!("{covariance:?}"), "a covariance"))
            }
            _ => Ok(()),
        }
    }

    /// Mean, and spread in its frame: the Gaussian nearest to what is known.
    pub(crate) fn moments(&self, configured: Pose) -> (Pose, MotionGaussian) {
        let (mean, covariance) = match self {
            Self::Configured => return (configured, MotionGaussian::default()),
            Self::Gaussian(mean, covariance) => (*mean, *covariance),
            Self::Samples(poses) => moments_of(poses),
        };
        let (s, c) = crate::math::sin_cos(mean.heading);
        let turn = [[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]];
        let turned = crate::geometry::multiply3(&turn, &covariance);
        let back = std::array::from_fn(|r| std::array::from_fn(|k| turn[k][r]));
        let covariance = crate::geometry::multiply3(&turned, &back);
        (mean, MotionGaussian { covariance, ..MotionGaussian::default() })
    }
}

/// Mean and covariance of poses.
fn moments_of(poses: &[Pose]) -> (Pose, Matrix3) {
    let share = 1.0 / poses.len() as f64;
    let sum = |of: &dyn Fn(&Pose) -> f64| share * poses.iter().map(of).sum::<f64>();
    let heading = crate::math::atan2(sum(&|p| p.heading.sin()), sum(&|p| p.heading.cos()));
    let mean = Pose::new(sum(&|p| p.x), sum(&|p| p.y), heading);
    let off = |p: &Pose| [p.x - mean.x, p.y - mean.y, crate::math::wrap_angle(p.heading - mean.heading)];
    let covariance = std::array::from_fn(|r| std::array::from_fn(|c| sum(&|p| off(p)[r] * off(p)[c])));
    (mean, covariance)
}

/// L with L Lᵀ = `covariance`, which may be singular; `None` when it is no covariance.
pub(crate) fn lower_triangle(covariance: &Matrix3) -> Option<Matrix3> {
    let mut lower = [[0.0; 3]; 3];
    let scale = (0..3).map(|i| covariance[i][i]).fold(0.0, f64::max);
    let symmetric =
        (0..3).all(|r| (0..3).all(|c| covariance[r][c] == covariance[c][r] && covariance[r][c].is_finite()));
    if !symmetric || scale > FARTHEST_M * FARTHEST_M {
        return None;
    }
    for c in 0..3 {
        let rest = covariance[c][c] - (0..c).map(|k| lower[c][k] * lower[c][k]).sum::<f64>();
        if rest < -1e-12 * scale || covariance[c][c] < 0.0 {
            return None;
        }
        lower[c][c] = rest.max(0.0).sqrt();
        for r in c + 1..3 {
            let rest: f64 = covariance[r][c] - (0..c).map(|k| lower[r][k] * lower[c][k]).sum::<f64>();
            if lower[c][c] > 0.0 {
                lower[r][c] = rest / lower[c][c];
            } else if rest.abs() > 1e-12 * scale {
                return None;
            }
        }
    }
    Some(lower)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_triangle_times_itself_is_the_covariance_and_what_is_none_has_none() {
        for covariance in [
            [[0.5, 0.1, 0.02], [0.1, 0.3, -0.05], [0.02, -0.05, 0.04]],
            [[0.25, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.01]],
        ] {
            let lower = lower_triangle(&covariance).unwrap();
            for r in 0..3 {
                for c in 0..3 {
                    let product: f64 = (0..3).map(|k| lower[r][k] * lower[c][k]).sum();
                    assert!((product - covariance[r][c]).abs() < 1e-15);
                }
            }
        }
        assert_eq!(lower_triangle(&[[1.0, 2.0, 0.0], [2.0, 1.0, 0.0], [0.0, 0.0, 1.0]]), None);
        assert_eq!(lower_triangle(&[[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]), None);
        assert_eq!(lower_triangle(&[[0.0, 0.1, 0.0], [0.1, 1.0, 0.0], [0.0, 0.0, 1.0]]), None);
    }

    #[test]
    fn the_spread_of_a_start_is_in_its_own_frame() {
        // Looking along y, what is uncertain along x lies to the left.
        let pose = Pose::new(1.0, 2.0, std::f64::consts::FRAC_PI_2);
        let covariance = [[4.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 0.1]];
        let (mean, spread) = Start::Gaussian(pose, covariance).moments(Pose::default());
        assert_eq!(mean, pose);
        assert!((spread.covariance[0][0] - 1.0).abs() < 1e-12 && (spread.covariance[1][1] - 4.0).abs() < 1e-12);
        let samples = [0.1, -0.1].map(|h| Pose::new(3.0, 10.0 * h, std::f64::consts::PI - h));
        let (mean, spread) = Start::Samples(samples.to_vec()).moments(Pose::default());
        assert!((mean.heading.abs() - std::f64::consts::PI).abs() < 1e-12 && mean.x == 3.0);
        assert!((spread.covariance[2][2] - 0.01).abs() < 1e-12 && (spread.covariance[1][1] - 1.0).abs() < 1e-12);
    }
}
