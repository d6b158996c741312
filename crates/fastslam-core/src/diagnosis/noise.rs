//! Whether the innovations contradict the configured noise, which noise, and in which direction.

use super::innovations::{Found, PredictedScan, ScanScore, MOTION_NOISES, SENSOR_NOISES};
use super::totals::{Factors, Series, Totals};
use crate::density::chi_squared_ratio;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// Scans in the sliding window.
const WINDOW: usize = 256;
/// Scans from one report about the window to the next: it costs as much as many of them.
const REPORT_EVERY: u32 = 16;
/// Fewer scans than this say nothing.
const SCANS_MIN: f64 = 40.0;
/// Standard errors on each side of the band of the mean NIS, which holds 95 %.
const BAND_STD_ERRORS: f64 = 1.96;
/// A noise is only called wrong when its standard deviation is surely off by more than this factor.
const WORTH_SAYING: f64 = 1.25;
/// No advice goes farther than this beyond what is sure: the next run sees better, and must not say the opposite.
const FARTHEST_BEYOND: f64 = 1.6;
/// Nor farther than this at a time.
const LARGEST_STEP: f64 = 10.0;
/// Scans over which it is averaged what scans usually have.
const USUAL_SCANS: f64 = 64.0;
/// One scan moves that by no more than if it had this many times as much.
const USUALLY_AT_MOST: f64 = 6.0;

/// Noises: those of the sensor, then those of the motion.
pub const NOISES: usize = SENSOR_NOISES + MOTION_NOISES;

/// A noise of the configuration.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Noise {
    /// `sensor.range_std_m`.
    Range,
    /// `sensor.bearing_std_rad`.
    Bearing,
    /// One of those in `motion`; see [`Motion::noises`](crate::motion::Motion::noises).
    Motion(usize),
    /// All of them: the log does not tell them apart.
    All,
}

impl Noise {
    /// Each noise, in the order of [`NoiseReport::std_factors`].
    pub const EACH: [Self; NOISES] = [Self::Range, Self::Bearing, Self::Motion(0), Self::Motion(1), Self::Motion(2)];
}

/// That a noise contradicts the innovations.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
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
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct NoiseWarnings {
    found: [Option<NoiseWarning>; NOISES],
}

impl NoiseWarnings {
    /// Those that there are.
    pub fn iter(&self) -> impl Iterator<Item = &NoiseWarning> {
        self.found.iter().flatten()
    }
}

/// What the innovations say of the noise.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
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
    /// By what each standard deviation (range, bearing, those of the motion) should be multiplied, and its interval of
    /// three standard errors; `None` where the log does not say.
    pub std_factors: [Option<[f64; 3]>; NOISES],
    /// Where that is far from 1.
    pub warnings: NoiseWarnings,
}

/// Scores of many scans, summed.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
struct Sums {
    scans: f64,
    sightings: f64,
    nis: f64,
    of_component: [f64; 2],
    /// NIS per number.
    ratio: Series,
    sensor: Totals<SENSOR_NOISES>,
    motion: Totals<MOTION_NOISES>,
    motion_by_sensor: [[f64; SENSOR_NOISES]; MOTION_NOISES],
}

/// Gathers the scores of the examined scans.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct NoiseCheck {
    window: VecDeque<ScanScore>,
    total: Sums,
    /// Scans since the last report about the window.
    unreported: u32,
    /// What scans of this run usually have of what is expected: as they are, and with the pose free.
    usual: [f64; 2],
    counts: [f64; 2],
}

impl Default for NoiseCheck {
    fn default() -> Self {
        Self { window: VecDeque::new(), total: Sums::default(), unreported: 0, usual: [1.0; 2], counts: [1.0; 2] }
    }
}

impl NoiseCheck {
    /// Takes in a scan.
    pub fn add(&mut self, scan: &PredictedScan) {
        let Some(score) = scan.score(self.usual) else { return };
        for (which, ratio) in score.ratios.into_iter().enumerate().filter(|(_, ratio)| ratio.is_finite()) {
            let (usual, count) = (&mut self.usual[which], &mut self.counts[which]);
            *count = (*count + 1.0).min(USUAL_SCANS);
            *usual += (ratio.min(USUALLY_AT_MOST * *usual) - *usual) / *count;
        }
        self.take(score);
    }

    fn take(&mut self, score: ScanScore) {
        self.total.add(&score);
        if self.window.len() == WINDOW {
            self.window.pop_front();
        }
        self.window.push_back(score);
        self.unreported += 1;
    }

    /// By how much squared innovations of this run usually exceed what the noise explains; at least 1.
    pub fn usual_excess(&self) -> f64 {
        self.usual[0].max(1.0)
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
        self.scans += 1.0;
        self.sightings += scan.sightings;
        self.nis += scan.nis;
        (0..2).for_each(|c| self.of_component[c] += scan.of_component[c]);
        if scan.ratios[1].is_finite() {
            self.sensor.add(&scan.sensor);
        }
        self.motion.add(&scan.motion);
        for (sums, row) in self.motion_by_sensor.iter_mut().zip(&scan.motion_by_sensor) {
            sums.iter_mut().zip(row).for_each(|(sum, value)| *sum += value);
        }
    }

    fn report(&self) -> NoiseReport {
        if self.scans == 0.0 {
            return NoiseReport::default();
        }
        let correlated_scans = self.ratio.repetition();
        let mut report = NoiseReport {
            scans: self.scans as u64,
            sightings: self.sightings as u64,
            nis: self.nis / self.sightings,
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

    /// Factors of the sensor's variances with the pose free; given these, those of the motion. Without the first nobody
    /// knows what of an innovation is whose.
    fn std_factors(&self) -> [Option<[f64; 3]>; NOISES] {
        let mut factors = [None; NOISES];
        let Some(sensor) = self.sensor_factors() else { return factors };
        (0..SENSOR_NOISES).for_each(|k| factors[k] = sensor.of_std(k));
        if sensor.observed == [true; SENSOR_NOISES] {
            if let Some(motion) = self.motion_factors(&sensor) {
                (0..MOTION_NOISES).for_each(|k| factors[SENSOR_NOISES + k] = motion.of_std(k));
            }
        }
        factors
    }

    /// **Why:** besides the noise of this scan's sightings S holds that of the landmarks, which came from the same sensor:
    /// what is expected of a noise is divided among both as the noises alone would. A sensor whose noise is all wrong by
    /// one factor then has that factor, however certain the map is.
    fn sensor_factors(&self) -> Option<Factors<SENSOR_NOISES>> {
        let Found { squares, expected, mut shares } = self.sensor.sum;
        for (row, expected) in shares.iter_mut().zip(expected) {
            let sum: f64 = row.iter().sum();
            // Of what was never measured there is nothing to divide.
            row.iter_mut().filter(|share| **share != 0.0).for_each(|share| *share *= expected / sum);
        }
        Factors::solve(self.sensor.observed(), &shares, &squares, &self.sensor.chance())
    }

    /// What a noise of the motion has beyond the others': landmarks and the pose at the last scan, which came from the
    /// sensor, count as the sensor's noise does.
    fn motion_factors(&self, sensor: &Factors<SENSOR_NOISES>) -> Option<Factors<MOTION_NOISES>> {
        let observed = self.motion.observed();
        let Found { squares, expected, shares } = self.motion.sum;
        let mut chance = self.motion.chance();
        let mut own = squares;
        // What is expected of each noise of the motion and comes from those of the sensor.
        let mut by_sensor = self.motion_by_sensor;
        for k in 0..MOTION_NOISES {
            let sum: f64 = by_sensor[k].iter().sum();
            let rest = expected[k] - shares[k].iter().sum::<f64>();
            by_sensor[k].iter_mut().for_each(|share| *share *= if sum > 0.0 { rest.max(0.0) / sum } else { 0.0 });
            own[k] -= (0..SENSOR_NOISES).map(|l| by_sensor[k][l] * sensor.values[l]).sum::<f64>();
            // Noises that nobody can tell are taken to be right.
            own[k] -= (0..MOTION_NOISES).filter(|l| !observed[*l]).map(|l| shares[k][l]).sum::<f64>();
        }
        for k in 0..MOTION_NOISES {
            for l in 0..MOTION_NOISES {
                for (i, j) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
                    chance[k][l] += by_sensor[k][i] * sensor.covariance[i][j] * by_sensor[l][j];
                }
            }
        }
        Factors::solve(observed, &shares, &own, &chance)
    }

    fn warnings(&self, report: &NoiseReport) -> NoiseWarnings {
        let mut warnings = NoiseWarnings::default();
        let independent = self.sightings / report.correlated_scans;
        for (k, noise) in Noise::EACH.into_iter().enumerate() {
            let Some(std_factor) = report.std_factors[k].and_then(advice) else { continue };
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

/// The factor to recommend, given the estimate and its interval; `None` where 1 may be right.
fn advice([estimate, low, high]: [f64; 3]) -> Option<f64> {
    if low > WORTH_SAYING {
        Some(estimate.min(FARTHEST_BEYOND * low).min(LARGEST_STEP))
    } else if high < 1.0 / WORTH_SAYING {
        Some(estimate.max(high / FARTHEST_BEYOND).max(1.0 / LARGEST_STEP))
    } else {
        None
    }
}

/// What holds 95 % of the means of `count` independent χ² numbers of `degrees` degrees of freedom.
fn band(degrees: f64, count: f64) -> [f64; 2] {
    let all = degrees * count.max(1.0);
    [-BAND_STD_ERRORS, BAND_STD_ERRORS].map(|z| degrees * chi_squared_ratio(all, z))
}

#[cfg(test)]
mod tests {
    use super::super::innovations::PredictedScan;
    use super::*;
    use crate::random::{Purpose, RandomSource};

    const BY_POSE: [[f64; 3]; 6] =
        [[1.0, 0.0, 0.0], [0.1, 0.3, 0.0], [0.6, -0.2, 0.0], [-0.1, 0.3, 0.0], [0.2, 1.0, 0.0], [-0.3, 0.3, 0.0]];

    /// Scans of so many sightings that share a motion with two noises, with innovations drawn from noises whose standard
    /// deviations are `factors` times what the filter believes.
    fn check_of(sightings: usize, factors: [f64; 4], scans: u64, seed: u64) -> NoiseCheck {
        let mut check = NoiseCheck::default();
        for step in 0..scans {
            let stream = RandomSource::new(seed).stream(Purpose::Simulation, step);
            let [along, across] = stream.normal_pair(0, 0);
            let motion = [0.1 * factors[2] * along, 0.1 * factors[3] * across];
            let mut scan = PredictedScan { size: 2 * sightings, ..PredictedScan::default() };
            (scan.motion[0][0][0], scan.motion[1][1][1]) = (0.01, 0.01);
            for i in 0..scan.size {
                let std = if i % 2 == 0 { 0.1 } else { 0.03 };
                scan.noise[i] = std * std;
                let own = stream.normal_pair(i as u32, 1)[0] * std * factors[i % 2];
                scan.innovation[i] = own + BY_POSE[i][0] * motion[0] + BY_POSE[i][1] * motion[1];
                scan.by_pose[i] = BY_POSE[i];
                scan.covariance[i][i] += scan.noise[i];
            }
            let whole = std::array::from_fn(|i| std::array::from_fn(|j| (0..2).map(|k| scan.motion[k][i][j]).sum()));
            scan.add_uncertain_pose(&whole);
            check.add(&scan);
        }
        check
    }

    fn check(factors: [f64; 4], scans: u64, seed: u64) -> NoiseCheck {
        check_of(3, factors, scans, seed)
    }

    #[test]
    fn right_noise_raises_no_warning_and_has_factors_of_one() {
        let mut missed = 0;
        for seed in 0..20 {
            let report = check([1.0; 4], 250, seed).of_run();
            assert_eq!(report.warnings.iter().count(), 0, "seed {seed}: {report:?}");
            for factor in &report.std_factors[..4] {
                let [_, low, high] = factor.unwrap();
                missed += u32::from(low > 1.0 || high < 1.0);
            }
            assert_eq!(report.std_factors[4], None);
        }
        // Of 80 intervals of three standard errors 0.2 miss on average; four or more once in 14,000 such tests.
        assert!(missed < 4, "{missed} of 80 intervals do not hold 1");
    }

    #[test]
    fn the_noise_that_is_wrong_is_named_with_its_direction() {
        let expected = [Noise::Range, Noise::Bearing, Noise::Motion(0), Noise::Motion(1)];
        let mut seen = 0;
        for (k, noise) in expected.into_iter().enumerate() {
            for factor in [0.2, 0.4, 2.5, 5.0] {
                let mut factors = [1.0; 4];
                factors[k] = factor;
                let report = check(factors, 256, 3).of_window();
                let found: Vec<&NoiseWarning> = report.warnings.iter().collect();
                assert_eq!(found.len(), 1, "{noise:?} {factor}: {found:?}");
                assert_eq!(found[0].noise, noise);
                // What is below a fifth of the noise of everything else hardly shows: the advice stops where it is sure.
                let slack = if factor < 0.3 { 0.6 } else { 0.3 };
                assert!((found[0].std_factor / factor).ln().abs() < slack, "{noise:?} {factor}: {found:?}");
                seen += 1;
            }
        }
        assert_eq!(seen, 16);
    }

    #[test]
    fn one_sighting_a_scan_is_no_evidence_about_any_noise() {
        for factor in [0.2, 1.0, 5.0] {
            let report = check_of(1, [factor; 4], 400, 2).of_run();
            assert_eq!(report.std_factors, [None; NOISES]);
            let found: Vec<Noise> = report.warnings.iter().map(|warning| warning.noise).collect();
            // That all of it together is off can be said.
            assert_eq!(found, if factor == 1.0 { vec![] } else { vec![Noise::All] });
        }
    }

    #[test]
    fn wild_scans_count_no_more_than_they_usually_do() {
        let mut check = check([1.0; 4], 200, 4);
        for _ in 0..2 {
            let mut wild = PredictedScan { size: 6, ..PredictedScan::default() };
            for i in 0..6 {
                (wild.noise[i], wild.covariance[i][i], wild.by_pose[i]) = (0.01, 0.01, BY_POSE[i]);
                wild.innovation[i] = 1e3 * (i as f64 - 2.5);
            }
            check.add(&wild);
        }
        assert_eq!(check.of_run().warnings.iter().count(), 0, "{:?}", check.of_run());
    }

    #[test]
    fn few_scans_say_nothing_and_the_window_forgets() {
        assert_eq!(check([5.0; 4], 30, 1).of_run().warnings.iter().count(), 0);
        let mut turned = check([3.0, 1.0, 1.0, 1.0], 300, 1);
        let calm = check([1.0; 4], 256, 2);
        calm.window.iter().for_each(|scan| turned.take(*scan));
        assert_eq!(turned.of_window().warnings.iter().count(), 0);
        assert!(turned.of_run().warnings.iter().any(|w| w.noise == Noise::Range));
    }

    #[test]
    fn scans_that_repeat_each_other_widen_the_band() {
        let mut plain = NoiseCheck::default();
        let mut repeated = NoiseCheck::default();
        for scan in &check([1.0; 4], 60, 5).window {
            plain.take(*scan);
            (0..4).for_each(|_| repeated.take(*scan));
        }
        let (plain, repeated) = (plain.of_run(), repeated.of_run());
        // Four equal neighbours: ρ = 3/4, seven scans count as one.
        assert!((repeated.correlated_scans - 7.0).abs() < 2.0, "{}", repeated.correlated_scans);
        assert!(repeated.band[1] - repeated.band[0] > plain.band[1] - plain.band[0]);
    }

    #[test]
    fn advice_goes_no_farther_than_is_sure() {
        assert_eq!(advice([1.2, 0.9, 1.5]), None);
        assert_eq!(advice([2.0, 1.8, 2.2]), Some(2.0));
        assert_eq!(advice([4.0, 2.0, 9.0]), Some(FARTHEST_BEYOND * 2.0));
        assert_eq!(advice([0.0, 0.0, 0.4]), Some(0.4 / FARTHEST_BEYOND));
        assert_eq!(advice([1e4, 9e3, 1.1e4]), Some(LARGEST_STEP));
    }

    #[test]
    fn the_band_is_that_of_the_table() {
        // χ²_150(0.025, 0.975) / 50 = 2.36, 3.72; Wilson and Hilferty err by less than 0.01 here.
        let [low, high] = band(3.0, 50.0);
        assert!((low - 2.36).abs() < 0.01 && (high - 3.72).abs() < 0.01, "{low} {high}");
    }
}
