//! What the page can set, and the configurations of the filters that follow from it.

use fastslam_core::config::{Algorithm, AssociationMode, Config};
use fastslam_core::motion::{Motion, Proportional, Velocity};
use fastslam_core::store::StoreKind;
use serde::Deserialize;

/// When paths are drawn anew.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Redraws {
    /// The plain filter of the papers.
    #[default]
    Never,
    /// When somebody asks for it.
    OnRequest,
    /// By need where nobody says which landmark is which, else every 25 scans.
    Regularly,
}

/// A world, a robot in it, and filters of one kind each.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Settings {
    /// Of the world, of all noise, and of the filters.
    pub seed: u64,
    /// The filters, each of which sees the same.
    pub filters: Vec<Algorithm>,
    /// Particles of each.
    pub particles: u32,
    /// Landmarks in the world.
    pub landmarks: usize,
    /// Side of the square that they stand in.
    pub side_m: f64,
    /// How far the sensor sees.
    pub reach_m: f64,
    /// Standard deviation of the range.
    pub range_std_m: f64,
    /// Standard deviation of the bearing.
    pub bearing_std_rad: f64,
    /// Noise of the odometry, as a multiple of 0.05 m and 0.01 rad after one metre and 0.03 rad after one radian.
    pub odometry_noise: f64,
    /// Noise of the sensor that the filters assume, as a multiple of the true one.
    pub believed_noise: f64,
    /// Whether the filters are told which landmark they see.
    pub names: bool,
    /// When paths are drawn anew.
    pub redraws: Redraws,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            seed: 1,
            filters: vec![Algorithm::Fastslam1, Algorithm::Fastslam2, Algorithm::Ekf],
            particles: 100,
            landmarks: 40,
            side_m: 40.0,
            reach_m: 8.0,
            range_std_m: 0.2,
            bearing_std_rad: 0.03,
            odometry_noise: 1.0,
            believed_noise: 1.0,
            names: false,
            redraws: Redraws::Never,
        }
    }
}

impl Settings {
    /// The noise of the odometry.
    pub fn odometry(&self) -> Proportional {
        Proportional {
            distance_std_m_per_sqrt_m: 0.05 * self.odometry_noise,
            lateral_std_m_per_sqrt_m: 0.0,
            turn_std_rad_per_sqrt_m: 0.01 * self.odometry_noise,
            turn_std_rad_per_sqrt_rad: 0.03 * self.odometry_noise,
        }
    }

    /// Errors that name what is out of range, before a world is built.
    pub fn validate(&self) -> Result<(), String> {
        let within = |name: &str, value: f64, low: f64, high: f64| {
            let fits = (low..=high).contains(&value);
            fits.then_some(()).ok_or_else(|| format!("{name}: got {value}, expected {low} to {high}"))
        };
        within("landmarks", self.landmarks as f64, 1.0, 2000.0)?;
        within("side_m", self.side_m, 5.0, 1000.0)?;
        within("reach_m", self.reach_m, 0.5, 1000.0)?;
        within("particles", f64::from(self.particles), 1.0, 10_000.0)?;
        within("range_std_m", self.range_std_m, 0.001, 100.0)?;
        within("bearing_std_rad", self.bearing_std_rad, 1e-4, 3.0)?;
        within("odometry_noise", self.odometry_noise, 0.001, 100.0)?;
        within("believed_noise", self.believed_noise, 0.01, 100.0)?;
        within("filters", self.filters.len() as f64, 1.0, 3.0)
    }

    /// The configuration of one filter in the simulated world.
    pub fn config(&self, algorithm: Algorithm) -> Config {
        let velocity = Velocity {
            speed_std_m_per_s: 0.0,
            yaw_rate_std_rad_per_s: 0.0,
            proportional: self.odometry(),
            ..Velocity::default()
        };
        let mut config = Config { motion: Motion::Velocity(velocity), ..Config::default() };
        config.sensor.change(|sensor| {
            sensor.range_std_m = self.range_std_m * self.believed_noise;
            sensor.bearing_std_rad = self.bearing_std_rad * self.believed_noise;
            sensor.max_range_m = self.reach_m + 10.0 * self.range_std_m;
        });
        config.association.mode = if self.names { AssociationMode::Known } else { AssociationMode::Unknown };
        self.adapt(config, algorithm)
    }

    /// A configuration with what the page sets for worlds and logs alike.
    pub fn adapt(&self, mut config: Config, algorithm: Algorithm) -> Config {
        config.algorithm = algorithm;
        config.seed = self.seed;
        config.filter.particles = self.particles;
        // Every particle's own map is read after every scan, which this store is made for.
        config.filter.store = StoreKind::Dense;
        config.filter.rejuvenation.every_steps = match self.redraws {
            Redraws::Never => Some(0),
            Redraws::OnRequest => Some(u32::MAX),
            Redraws::Regularly if config.association.mode == AssociationMode::Unknown => None,
            Redraws::Regularly => Some(25),
        };
        config
    }
}
