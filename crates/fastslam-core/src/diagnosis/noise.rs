//! Whether the innovations contradict the configured noise, which noise, and in which direction.

use super::innovations::{ScanScore, NOISES, SENSOR_NOISES};
use crate::config::Config;
use crate::density::chi_squared_ratio;
use std::collections::VecDeque;
use std::fmt;

/// Scans in the sliding window.
const WINDOW: usize = 256;
/// Scans from one report about the window to the next: it costs as much as many of them.
const REPORT_EVERY: u32 = 16;
/// Fewer scans than this say nothing.
const SCANS_MIN: f64 = 40.0;
/// Standard errors between an estimate and the ends of its interval: a false alarm of one noise in about 700 windows.
const INTERVAL_STD_ERRORS: f64 = 3.0;
/// Standard errors on each side of the band of the mean NIS, which holds 95 %.
const BAND_STD_ERRORS: f64 = 1.96;
/// A factor below this is said to be below it: the log hardly tells what is right.
const SMALLEST_SAID: f64 = 0.1;
/// A noise is only called wrong when its standard deviation is surely off by more than this factor.
const WORTH_SAYING: f64 = 1.25;
/// Range and bearing that are told apart no better than this are taken as one.
const SMALLEST_DETERMINANT: f64 = 1e-3;

/// A noise of the configuration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Noise {
    /// `sensor.range_std_m`.
    Range,
    /// `sensor.bearing_std_rad`.
    Bearing,
    /// The standard deviations in `motion`.
    Motion,
    /// All of them: the log does not tell them apart.
    All,
}

/// That a noise contradicts the innovations.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NoiseWarning {
    /// Which one.
    pub noise: Noise,
    /// By what its standard deviation should be multiplied.
    pub std_factor: f64,
    /// Mean normalised innovation squared (NIS): per sighting, or per number for one component of the sensor.
    pub nis: f64,
    /// What holds 95 % of such means when the noise is right.
    pub band: [f64; 2],
}

/// The warnings about each noise; at most one each.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct NoiseWarnings {
    found: [Option<NoiseWarning>; NOISES],
}

impl NoiseWarnings {
    /// Those that there are.
    pub fn iter(&self) -> impl Iterator<Item = &NoiseWarning> {
        self.found.iter().flatten()
    }

    /// Each as a sentence that says what to change.
    pub fn sentences(&self, config: &Config) -> Vec<String> {
        self.iter().map(|warning| warning.sentence(config)).collect()
    }
}

/// What the innovations say of the noise.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct NoiseReport {
    /// Scans that were examined.
    pub scans: u64,
    /// Sightings in them.
    pub sightings: u64,
    /// Mean NIS per sighting; 2 is expected.
    pub nis: f64,
    /// What holds 95 % of such means when the noise is right, with the correlation in time that was found.
    pub band: [f64; 2],
    /// Mean squared innovation over its variance, of ranges and of bearings; 1 is expected.
    pub of_component: [f64; 2],
    /// Scans that count as one because neighbours in time tell the same story.
    pub correlated_scans: f64,
    /// By what each standard deviation (range, bearing, motion) should be multiplied, and its interval of three
    /// standard errors; `None` where the log does not say.
    pub std_factors: [Option<[f64; 3]>; NOISES],
    /// Where that is far from 1.
    pub warnings: NoiseWarnings,
}

/// Scores of many scans, summed.
#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    scans: f64,
    sightings: f64,
    nis: f64,
    of_component: [f64; 2],
    score: [f64; NOISES],
    score_squares: [f64; NOISES],
    information: [[f64; NOISES]; NOISES],
    sensor_score: [f64; SENSOR_NOISES],
    sensor_score_products: [[f64; SENSOR_NOISES]; SENSOR_NOISES],
    sensor_information: [[f64; SENSOR_NOISES]; SENSOR_NOISES],
    /// NIS per number, and the scores that the factors come from (range, bearing, motion).
    ratio: Series,
    of_noise: [Series; NOISES],
}

/// What tells how far neighbours in a series repeat each other.
#[derive(Clone, Copy, Debug, Default)]
struct Series {
    count: f64,
    last: f64,
    sum: f64,
    squares: f64,
    /// Products with the value before.
    lagged: f64,
}

impl Series {
    fn add(&mut self, value: f64) {
        self.lagged += if self.count > 0.0 { value * self.last } else { 0.0 };
        self.last = value;
        self.sum += value;
        self.squares += value * value;
        self.count += 1.0;
    }

    /// How many neighbours are worth one independent value, from the first autocorrelation ρ: (1 + ρ) / (1 − ρ), at
    /// least 1.
    fn repetition(&self) -> f64 {
        let mean = self.sum / self.count;
        let variance = self.squares / self.count - mean * mean;
        if self.count < 3.0 || variance <= 1e-12 * mean * mean {
            return 1.0;
        }
        let covariance = self.lagged / (self.count - 1.0) - mean * mean;
        let correlation = (covariance / variance).clamp(0.0, 0.95);
        (1.0 + correlation) / (1.0 - correlation)
    }
}

/// Gathers the scores of the examined scans.
#[derive(Clone, Debug, Default)]
pub(crate) struct NoiseCheck {
    window: VecDeque<ScanScore>,
    total: Sums,
    /// Scans since the last report about the window.
    unreported: u32,
}

impl NoiseCheck {
    /// Takes in a scan.
    pub fn add(&mut self, scan: &ScanScore) {
        self.total.add(scan);
        if self.window.len() == WINDOW {
            self.window.pop_front();
        }
        self.window.push_back(*scan);
        self.unreported += 1;
    }

    /// Whether so much is new that the window should be looked at; then it counts as looked at. Often at first.
    pub fn is_report_due(&mut self) -> bool {
        let due = self.unreported >= REPORT_EVERY.min(1 + self.window.len() as u32 / 8);
        if due {
            self.unreported = 0;
        }
        due
    }

    /// Mean of NIS over its expectation in the last `scans` examined ones; `None` before the first.
    pub fn recent_ratio(&self, scans: usize) -> Option<f64> {
        let (mut nis, mut expected) = (0.0, 0.0);
        for scan in self.window.iter().rev().take(scans) {
            nis += scan.nis;
            expected += 2.0 * scan.sightings;
        }
        (expected > 0.0).then(|| nis / expected)
    }

    /// What the scans of the sliding window say.
    pub fn of_window(&self) -> NoiseReport {
        let mut sums = Sums::default();
        self.window.iter().for_each(|scan| sums.add(scan));
        sums.report()
    }

    /// What all scans so far say.
    pub fn of_run(&self) -> NoiseReport {
        self.total.report()
    }
}

impl Sums {
    fn add(&mut self, scan: &ScanScore) {
        self.ratio.add(scan.nis / (2.0 * scan.sightings));
        let of_noise = [scan.sensor_score[0], scan.sensor_score[1], scan.score[2]];
        self.of_noise.iter_mut().zip(of_noise).for_each(|(series, score)| series.add(score));
        self.scans += 1.0;
        self.sightings += scan.sightings;
        self.nis += scan.nis;
        (0..2).for_each(|c| self.of_component[c] += scan.of_component[c]);
        for k in 0..NOISES {
            self.score[k] += scan.score[k];
            self.score_squares[k] += scan.score[k] * scan.score[k];
            (0..NOISES).for_each(|l| self.information[k][l] += scan.information[k][l]);
        }
        for k in 0..SENSOR_NOISES {
            self.sensor_score[k] += scan.sensor_score[k];
            for l in 0..SENSOR_NOISES {
                self.sensor_score_products[k][l] += scan.sensor_score[k] * scan.sensor_score[l];
                self.sensor_information[k][l] += scan.sensor_information[k][l];
            }
        }
    }

    fn report(&self) -> NoiseReport {
        if self.scans == 0.0 {
            return NoiseReport::default();
        }
        let correlated_scans = self.ratio.repetition();
        let nis = self.nis / self.sightings;
        let mut report = NoiseReport {
            scans: self.scans as u64,
            sightings: self.sightings as u64,
            nis,
            band: band(2.0, self.sightings / correlated_scans),
            of_component: self.of_component.map(|sum| sum / self.sightings),
            correlated_scans,
            ..NoiseReport::default()
        };
        if self.scans >= SCANS_MIN {
            report.std_factors = self.std_factors();
            report.warnings = self.warnings(&report);
        }
        report
    }

    /// One step of Fisher's scoring from the configured variances, with the spread of the scores found in the log: the
    /// sensor's noises with the pose free, then that of the motion given these.
    ///
    /// **Why:** S is linear in the variances, so one step is unbiased however far off they are. Scores vary more than
    /// the model says where the noise is wrong, hence their own squares in place of the information.
    fn std_factors(&self) -> [Option<[f64; 3]>; NOISES] {
        let factor = |k: usize, change: f64, variance: f64| {
            let reach = INTERVAL_STD_ERRORS * (variance.max(0.0) * self.of_noise[k].repetition()).sqrt();
            Some([0.0, -reach, reach].map(|offset| (1.0 + change + offset).max(0.0).sqrt()))
        };
        let Some((change, variance)) = self.sensor_changes() else { return [None; NOISES] };
        let [by_range, by_bearing, own] = self.information[2];
        let explained = by_range * change[0] + by_bearing * change[1];
        let spread = self.score_squares[2] - self.score[2] * self.score[2] / self.scans
            + by_range * by_range * variance[0]
            + by_bearing * by_bearing * variance[1];
        let motion = if own > 0.0 { factor(2, (self.score[2] - explained) / own, spread / (own * own)) } else { None };
        [factor(0, change[0], variance[0]), factor(1, change[1], variance[1]), motion]
    }

    /// By what the sensor's variances, as fractions of themselves, should change, and the variances of that; `None`
    /// where too few scans had several sightings.
    fn sensor_changes(&self) -> Option<([f64; SENSOR_NOISES], [f64; SENSOR_NOISES])> {
        let [[a, b], [_, c]] = self.sensor_information;
        let determinant = a * c - b * b;
        if determinant.is_nan() || determinant <= SMALLEST_DETERMINANT * a * c {
            return None;
        }
        let inverse = [[c / determinant, -b / determinant], [-b / determinant, a / determinant]];
        let mean = self.sensor_score.map(|score| score / self.scans);
        let change = inverse.map(|[u, v]| u * self.sensor_score[0] + v * self.sensor_score[1]);
        let variance = inverse.map(|row| {
            let mut sum = 0.0;
            for i in 0..SENSOR_NOISES {
                for j in 0..SENSOR_NOISES {
                    sum += row[i] * row[j] * (self.sensor_score_products[i][j] - self.scans * mean[i] * mean[j]);
                }
            }
            sum
        });
        Some((change, variance))
    }

    fn warnings(&self, report: &NoiseReport) -> NoiseWarnings {
        let mut warnings = NoiseWarnings::default();
        for (k, noise) in [Noise::Range, Noise::Bearing, Noise::Motion].into_iter().enumerate() {
            let Some([std_factor, low, high]) = report.std_factors[k] else { continue };
            if low <= WORTH_SAYING && high >= 1.0 / WORTH_SAYING {
                continue;
            }
            let independent = self.sightings / report.correlated_scans;
            let (nis, band) = match noise {
                Noise::Range | Noise::Bearing => (report.of_component[k], band(1.0, independent)),
                _ => (report.nis, report.band),
            };
            warnings.found[k] = Some(NoiseWarning { noise, std_factor, nis, band });
        }
        let ratio = (0.5 * report.nis).sqrt();
        let outside = report.nis < report.band[0] || report.nis > report.band[1];
        let far = !(1.0 / WORTH_SAYING..=WORTH_SAYING).contains(&ratio);
        if warnings.iter().next().is_none() && outside && far {
            let warning = NoiseWarning { noise: Noise::All, std_factor: ratio, nis: report.nis, band: report.band };
            warnings.found[0] = Some(warning);
        }
        warnings
    }
}

/// What holds 95 % of the means of `count` independent χ² numbers of `degrees` degrees of freedom.
fn band(degrees: f64, count: f64) -> [f64; 2] {
    let all = degrees * count.max(1.0);
    [-BAND_STD_ERRORS, BAND_STD_ERRORS].map(|z| degrees * chi_squared_ratio(all, z))
}

impl NoiseWarning {
    /// Says what is wrong and what to change.
    pub fn sentence(&self, config: &Config) -> String {
        let Self { std_factor, nis, band: [low, high], .. } = self;
        let found = format!("NIS {nis:.2}, band {low:.2}-{high:.2}");
        let direction = if *std_factor > 1.0 { "raise" } else { "lower" };
        let sensor = |what: &str, key: &str, configured: f64| {
            let about = Short(configured * std_factor);
            // A filter that believes repeated errors to be new ones grows too sure; wide noise is a common remedy.
            let unless = if *std_factor < 1.0 { ", unless the errors of successive scans repeat" } else { "" };
            format!(
                "{what} innovations are {} as large as {key} says ({found}): {direction} it to about {about}{unless}",
                Times(*std_factor)
            )
        };
        match self.noise {
            Noise::Range => sensor("range", "sensor.range_std_m", config.sensor.range_std_m),
            Noise::Bearing => sensor("bearing", "sensor.bearing_std_rad", config.sensor.bearing_std_rad),
            Noise::Motion => format!(
                "the odometry is off {} as much as the noise in `motion` says ({found}): {direction} its standard \
                 deviations by a factor of about {}",
                Times(*std_factor),
                Short(if *std_factor > 1.0 { *std_factor } else { 1.0 / std_factor.max(SMALLEST_SAID) })
            ),
            Noise::All => format!(
                "innovations are {} as large as the noise settings say ({found}), and the log does not tell whether \
                 `sensor` or `motion` is to blame",
                Times(*std_factor)
            ),
        }
    }
}

/// A factor in words.
struct Times(f64);

impl fmt::Display for Times {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.0 < SMALLEST_SAID {
            return f.write_str("less than 0.1 times");
        }
        write!(f, "{} times", Short(self.0))
    }
}

/// A number with two significant digits.
struct Short(f64);

impl fmt::Display for Short {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let decimals = if self.0 > 0.0 { (1.0 - self.0.log10().floor()).clamp(0.0, 6.0) as usize } else { 1 };
        write!(f, "{:.*}", decimals, self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::super::innovations::PredictedScan;
    use super::*;
    use crate::random::{Purpose, RandomSource};

    /// Scans of three sightings that share a motion, with innovations drawn from noises whose standard deviations are
    /// `factors` times what the filter believes.
    fn check(factors: [f64; NOISES], scans: u64, seed: u64) -> NoiseCheck {
        let mut check = NoiseCheck::default();
        let by_motion = [[1.0, 0.0], [0.1, 0.3], [0.6, -0.2], [-0.1, 0.3], [0.2, 1.0], [-0.3, 0.3]];
        for step in 0..scans {
            let stream = RandomSource::new(seed).stream(Purpose::Simulation, step);
            let motion = stream.normal_pair(0, 0).map(|value| 0.1 * factors[2] * value);
            let mut scan = PredictedScan { size: 6, ..PredictedScan::default() };
            for i in 0..6 {
                let std = if i % 2 == 0 { 0.1 } else { 0.03 };
                scan.noise[i] = std * std;
                let own = stream.normal_pair(i as u32, 1)[0] * std * factors[i % 2];
                scan.innovation[i] = own + by_motion[i][0] * motion[0] + by_motion[i][1] * motion[1];
                for j in 0..6 {
                    scan.motion[i][j] = 0.01 * (0..2).map(|k| by_motion[i][k] * by_motion[j][k]).sum::<f64>();
                    scan.covariance[i][j] = scan.motion[i][j];
                }
                scan.covariance[i][i] += scan.noise[i];
                scan.by_pose[i] = [by_motion[i][0], by_motion[i][1], 0.0];
            }
            check.add(&scan.score().unwrap());
        }
        check
    }

    #[test]
    fn right_noise_raises_no_warning_and_has_factors_of_one() {
        for seed in 0..20 {
            let report = check([1.0; NOISES], 250, seed).of_run();
            assert_eq!(report.warnings.iter().count(), 0, "seed {seed}: {report:?}");
            for factor in report.std_factors {
                let [_, low, high] = factor.unwrap();
                // Three standard errors: all 60 intervals hold 1 but for a chance of about 60 / 370.
                assert!(low < 1.0 && high > 1.0, "seed {seed}: {low} to {high}");
            }
        }
    }

    #[test]
    fn the_noise_that_is_wrong_is_named_with_its_direction() {
        let expected = [Noise::Range, Noise::Bearing, Noise::Motion];
        for (k, noise) in expected.into_iter().enumerate() {
            for factor in [0.4, 2.5] {
                let mut factors = [1.0; NOISES];
                factors[k] = factor;
                let report = check(factors, 256, 3).of_window();
                let found: Vec<&NoiseWarning> = report.warnings.iter().collect();
                assert_eq!(found.len(), 1, "{noise:?} {factor}: {found:?}");
                assert_eq!(found[0].noise, noise);
                // One step of scoring finds the scale of one noise to within a third here.
                assert!((found[0].std_factor / factor).ln().abs() < 0.3, "{noise:?} {factor}: {found:?}");
            }
        }
    }

    #[test]
    fn few_scans_say_nothing_and_the_window_forgets() {
        assert_eq!(check([5.0; NOISES], 30, 1).of_run().warnings.iter().count(), 0);
        let mut turned = check([3.0, 1.0, 1.0], 300, 1);
        let calm = check([1.0; NOISES], 256, 2);
        calm.window.iter().for_each(|scan| turned.add(scan));
        assert_eq!(turned.of_window().warnings.iter().count(), 0);
        assert!(turned.of_run().warnings.iter().any(|w| w.noise == Noise::Range));
    }

    #[test]
    fn scans_that_repeat_each_other_widen_the_band() {
        let mut plain = NoiseCheck::default();
        let mut repeated = NoiseCheck::default();
        for scan in &check([1.0; NOISES], 60, 5).window {
            plain.add(scan);
            (0..4).for_each(|_| repeated.add(scan));
        }
        let (plain, repeated) = (plain.of_run(), repeated.of_run());
        // Four equal neighbours: ρ = 3/4, seven scans count as one.
        assert!((repeated.correlated_scans - 7.0).abs() < 2.0, "{}", repeated.correlated_scans);
        assert!(repeated.band[1] - repeated.band[0] > plain.band[1] - plain.band[0]);
    }

    #[test]
    fn the_band_is_that_of_the_table() {
        // χ²_150(0.025, 0.975) / 50 = 2.36, 3.72; Wilson and Hilferty err by less than 0.01 here.
        let [low, high] = band(3.0, 50.0);
        assert!((low - 2.36).abs() < 0.01 && (high - 3.72).abs() < 0.01, "{low} {high}");
    }

    #[test]
    fn sentences_name_key_value_and_direction() {
        let config = Config::default();
        let warning = NoiseWarning { noise: Noise::Range, std_factor: 2.31, nis: 5.2, band: [1.9, 2.1] };
        let expected = format!(
            "range innovations are 2.3 times as large as sensor.range_std_m says (NIS 5.20, band 1.90-2.10): raise it \
             to about {}",
            Short(2.31 * config.sensor.range_std_m)
        );
        assert_eq!(warning.sentence(&config), expected);
        let small = NoiseWarning { noise: Noise::Motion, std_factor: 0.25, ..warning };
        assert!(small.sentence(&config).contains("0.25 times"), "{}", small.sentence(&config));
        assert!(small.sentence(&config).ends_with("lower its standard deviations by a factor of about 4.0"));
    }
}
