//! The life of landmarks: sightings speak for them, scans that should have shown them and did not speak against them.
//!
//! **Source:** `montemerlo2003fastslam`, eq. 22: log-odds per particle and landmark, counted up when it is sighted and
//! down when it lies in view and is not. They are kept apart from the Gaussians, which a missed landmark leaves alone.
//! In place of fixed numbers they can follow Bayes' rule; and where the probability of a detection is known, a map that
//! holds landmarks in view that were not sighted loses weight.

use super::believed::{Existence, EXISTENCE_COLUMNS};
use super::landmarks::Landmarks;
use super::state::Maps;
use super::work::{Claims, Correcting, Judging, Verdicts};
use super::{Particles, Settings};
use crate::association::{Box2, Decision};
use crate::config::{AssociationConfig, ExistenceForm, Removal};
use crate::landmark::{column, SensorPoses};
use crate::math;
use crate::vector::{any, vectorized};

/// Whether scans are judged by what they should have shown.
pub(super) fn is_judged(settings: &Settings, landmarks: &Landmarks) -> bool {
    let association = &settings.config.association;
    let counts = association.existence.removal == Removal::WhenMissed
        || association.existence.form == ExistenceForm::Bayes
        || association.detection_of_all_in_view().is_some();
    landmarks.existence.is_some() && counts
}

/// The log-odds of a landmark at its first sighting.
pub(super) fn initial_log_odds(settings: &Settings) -> f64 {
    let existence = &settings.config.association.existence;
    match (existence.form, settings.rules.initial_log_odds) {
        (ExistenceForm::Bayes, Some(log_odds)) => log_odds,
        _ => existence.initial_log_odds,
    }
}

/// The odds that each of these landmarks is sighted rather than missed, r P_D / (1 − r P_D), as logarithms: a column of all
/// particles for each; `None` where they do not count.
///
/// **Why:** every landmark in view costs ln(1 − r P_D), sighted or not ([`judge`]); a sighting takes that back.
pub(super) fn detection_odds<'a>(
    settings: &Settings,
    existence: &'a mut Option<Existence>,
    slots: &[u32],
) -> Option<&'a [f64]> {
    let detection = settings.config.association.detection_of_all_in_view()?;
    Some(existence.as_mut()?.detection_odds(slots, detection))
}

/// Whether the best particle's landmark, seen so often, counts as real.
pub(super) fn is_confirmed(settings: &Settings, maps: Maps<'_>, slot: u32, sightings: f64) -> bool {
    if maps.given.of(maps.landmarks.birth(slot)).is_some() {
        return true;
    }
    let settings = &settings.config.association.existence;
    let birth = maps.landmarks.birth(slot);
    let trusted = maps.landmarks.fading.as_ref().is_none_or(|fading| fading.trusts(birth));
    let Some(existence) = &mut maps.landmarks.existence else { return true };
    let likely = match settings.form {
        ExistenceForm::Counted => trusted,
        ExistenceForm::Bayes => existence.read(slot).column(1)[maps.particles.best()] >= settings.confirmed_log_odds,
    };
    likely && sightings >= f64::from(settings.confirmed_sightings)
}

/// Counts a scan for and against every landmark in view, and removes what no longer exists in a particle's map. Returns
/// how many the best particle lost.
///
/// The claims are those of the particles as they stand now. Landmarks that this scan founded are not judged by it.
pub(super) fn judge(
    settings: &Settings,
    mut maps: Maps<'_>,
    claims: Claims<'_>,
    correcting: &Correcting,
    judging: &mut Judging,
) -> u32 {
    let odds = Odds::of(settings);
    let view = View::of(settings);
    note_sighted(claims, maps.particles.len(), &mut judging.sighted);
    let mut directions = std::mem::take(&mut judging.directions);
    let eyes = Eyes::of(&correcting.sensor_poses, &mut directions);
    list_in_reach(&view, &mut maps, claims, &eyes, judging);
    judging.verdicts.judged.resize(maps.particles.len(), false);
    let mut removed = 0;
    for place in 0..judging.in_reach.len() {
        let slot = judging.in_reach[place];
        // Candidates that nobody holds any more are gone; they have no birth.
        if maps.landmarks.birth(slot) >= correcting.first_birth {
            continue;
        }
        view.find_in_view(maps.landmarks, slot, &eyes, &mut judging.verdicts.judged);
        enter_sighted(claims.table.candidate_of(slot), &correcting.sighting_densities, judging);
        if !any(&judging.verdicts.judged) {
            continue;
        }
        if maps.is_fixed(slot) {
            odds.weigh_missed(&mut maps, slot, &judging.verdicts.judged);
        } else {
            removed += odds.count(&mut maps, slot, judging);
        }
    }
    judging.directions = directions;
    removed
}

/// Lists the landmarks that some sensor may see for sure, and those that some particle sighted, in the order of birth.
fn list_in_reach(
    view: &View,
    maps: &mut Maps<'_>,
    claims: Claims<'_>,
    eyes: &Eyes<'_>,
    Judging { in_reach, sighted, .. }: &mut Judging,
) {
    let particles = maps.particles.len();
    in_reach.clear();
    let region = view.region(particles, eyes);
    maps.landmarks.find(&region, in_reach);
    in_reach.retain(|slot| maps.landmarks.may_lie_in(*slot, &region));
    let sighted = claims.table.slots.iter().zip(sighted.chunks_exact(particles));
    in_reach.extend(sighted.filter(|(_, sighted)| any(sighted)).map(|(slot, _)| *slot));
    in_reach.sort_unstable_by_key(|slot| maps.landmarks.birth(*slot));
    in_reach.dedup();
}

/// Notes which particle took some sighting for which candidate.
fn note_sighted(claims: Claims<'_>, particles: usize, sighted: &mut Vec<bool>) {
    sighted.clear();
    sighted.resize(claims.table.slots.len() * particles, false);
    let share = claims.decisions.len() / particles;
    for (i, mine) in claims.decisions.chunks_exact(share).enumerate() {
        for decision in mine {
            if let Decision::Landmark(candidate) = decision {
                sighted[*candidate as usize * particles + i] = true;
            }
        }
    }
}

/// Enters the particles that took some sighting for a landmark, if that is a candidate, among the verdicts on it; only
/// Bayes' rule asks for `densities`, those of the sightings of all candidates in all maps.
fn enter_sighted(candidate: Option<u32>, densities: &[f64], judging: &mut Judging) {
    let Verdicts { judged, sighted, densities: own } = &mut judging.verdicts;
    let n = judged.len();
    sighted.clear();
    own.clear();
    if let Some(candidate) = candidate.map(|candidate| candidate as usize) {
        sighted.extend_from_slice(&judging.sighted[candidate * n..][..n]);
        own.extend_from_slice(densities.get(candidate * n..).and_then(|rest| rest.get(..n)).unwrap_or_default());
        judged.iter_mut().zip(&*sighted).for_each(|(judged, sighted)| *judged |= *sighted);
    }
    sighted.resize(n, false);
    own.resize(n, 0.0);
}

/// Where a landmark is surely in view and would have been sighted.
#[derive(Clone, Copy, Debug)]
struct View {
    near_m: f64,
    far_m: f64,
    half_width_rad: f64,
    /// Slope of the side of a slightly wider view; infinite where it has none to speak of.
    slope: f64,
}

/// A view is so much wider where directions are looked at that are not worked out; beside it, rounding is nothing.
const ROUNDING_RAD: f64 = 1e-6;
/// Views of this half width and more are not narrowed by a slope.
const WIDE_RAD: f64 = 1.5;

impl View {
    fn of(settings: &Settings) -> Self {
        let (sensor, existence) = (settings.config.sensor.common(), &settings.config.association.existence);
        let half_width_rad = 0.5 * existence.view_fraction * sensor.field_of_view_rad;
        Self::around(sensor.min_range_m, existence.range_fraction * sensor.max_range_m, half_width_rad)
    }

    /// From a least range to a largest one.
    fn around(near_m: f64, far_m: f64, half_width_rad: f64) -> Self {
        let (sine, cosine) = math::sin_cos(half_width_rad + ROUNDING_RAD);
        let slope = if half_width_rad < WIDE_RAD { sine / cosine } else { f64::INFINITY };
        Self { near_m, far_m, half_width_rad, slope }
    }

    /// A box around everything that any particle's sensor can see for sure.
    fn region(&self, particles: usize, eyes: &Eyes<'_>) -> Box2 {
        let ([ahead, radius], n) = (self.circle(), particles);
        let (x, y, sine, cosine) = (&eyes.poses.x[..n], &eyes.poses.y[..n], &eyes.sine[..n], &eyes.cosine[..n]);
        vectorized(
            #[inline(always)]
            || {
                Box2::around(
                    n,
                    #[inline(always)]
                    |i| {
                        let (x, y) = (x[i] + ahead * cosine[i], y[i] + ahead * sine[i]);
                        ([x - radius, y - radius], [x + radius, y + radius])
                    },
                )
            },
        )
    }

    /// A circle around all that is in view: how far ahead of the sensor its middle is, and its radius.
    ///
    /// **Why:** a sector of up to 120° lies in the circle through its corners, r / (2 cos w) ahead for a half width w.
    fn circle(&self) -> [f64; 2] {
        let corners_m = 0.5 * self.far_m * (1.0 + self.slope * self.slope).sqrt();
        if corners_m < self.far_m {
            [corners_m, corners_m * (1.0 + ROUNDING_RAD)]
        } else {
            [0.0, self.far_m]
        }
    }

    /// In which maps a landmark is in view.
    fn find_in_view(&self, landmarks: &mut Landmarks, slot: u32, eyes: &Eyes<'_>, in_view: &mut [bool]) {
        let Self { near_m: near, far_m: reach, half_width_rad, slope } = *self;
        let rows = landmarks.read(slot);
        let (count, x, y) = (rows.column(column::SIGHTINGS), rows.column(column::MEAN_X), rows.column(column::MEAN_Y));
        let n = in_view.len();
        let (count, x, y) = (&count[..n], &x[..n], &y[..n]);
        let (sensor_x, sensor_y, heading) = (&eyes.poses.x[..n], &eyes.poses.y[..n], &eyes.poses.heading[..n]);
        let (sine, cosine) = (&eyes.sine[..n], &eyes.cosine[..n]);
        let is_wide = slope == f64::INFINITY;
        vectorized(
            #[inline(always)]
            || {
                // No branches: the loops must stay straight lines to become vector code.
                for i in 0..n {
                    let (dx, dy) = (x[i] - sensor_x[i], y[i] - sensor_y[i]);
                    let (ahead, aside) = (dx * cosine[i] + dy * sine[i], dy * cosine[i] - dx * sine[i]);
                    let range_squared = dx * dx + dy * dy;
                    let in_reach = (range_squared < reach * reach) & (range_squared > near * near);
                    in_view[i] = (count[i] != 0.0) & in_reach & (is_wide | (aside.abs() < slope * ahead));
                }
                // Most are in view of nobody, and the direction itself costs more.
                if !any(in_view) {
                    return;
                }
                for i in 0..n {
                    let (dx, dy) = (x[i] - sensor_x[i], y[i] - sensor_y[i]);
                    let bearing = math::wrap_angle(math::atan2(dy, dx) - heading[i]);
                    in_view[i] &= bearing.abs() < half_width_rad;
                }
            },
        );
    }
}

/// Where the sensors are, and where they look.
struct Eyes<'a> {
    poses: &'a SensorPoses,
    sine: &'a [f64],
    cosine: &'a [f64],
}

impl<'a> Eyes<'a> {
    /// Of these sensors; `memory` is used for the directions.
    fn of(poses: &'a SensorPoses, [sine, cosine]: &'a mut [Vec<f64>; 2]) -> Self {
        let n = poses.heading.len();
        sine.resize(n, 0.0);
        cosine.resize(n, 0.0);
        let (heading, sine, cosine) = (&poses.heading[..n], &mut sine[..n], &mut cosine[..n]);
        vectorized(
            #[inline(always)]
            || {
                for i in 0..n {
                    (sine[i], cosine[i]) = math::sin_cos(heading[i]);
                }
            },
        );
        Self { poses, sine, cosine }
    }
}

/// What a scan does to the odds that a landmark exists, and to the weights of the maps that have it in view.
#[derive(Clone, Copy, Debug)]
struct Odds {
    /// Probability that what exists and is in view is sighted, where maps are weighed by that.
    detection: Option<f64>,
    /// What a sighting adds to the log-odds.
    gain: Gain,
    /// The log-odds are never higher.
    highest_log_odds: f64,
    /// Taken away from the log-odds by a scan that misses the landmark.
    missed_log_odds: f64,
    /// Below this a landmark is removed.
    lowest_log_odds: f64,
    /// Whether landmarks are.
    removes: bool,
    /// Power of the likelihood in the weight.
    likelihood_exponent: f64,
}

impl Odds {
    fn of(settings: &Settings) -> Self {
        let association = &settings.config.association;
        let existence = &association.existence;
        Self {
            detection: association.detection_of_all_in_view(),
            gain: Gain::of(association, settings.rules.clutter_density),
            highest_log_odds: existence.highest_log_odds,
            missed_log_odds: match (existence.form, association.detection_probability) {
                (ExistenceForm::Bayes, Some(detection)) => -math::ln(1.0 - detection),
                _ => existence.missed_log_odds,
            },
            lowest_log_odds: initial_log_odds(settings) + existence.lowest_log_odds - existence.initial_log_odds,
            removes: existence.removal == Removal::WhenMissed,
            likelihood_exponent: settings.rules.likelihood_exponent,
        }
    }

    /// What it costs a map to have a landmark in view that exists with these odds: ln(1 − r P_D).
    #[inline(always)]
    fn log_weight_of_missing(&self, detection: f64, log_odds: f64) -> f64 {
        self.likelihood_exponent * math::ln(1.0 - math::logistic(log_odds) * detection)
    }

    /// The log-odds after a scan that had a landmark in view, or showed it.
    #[inline(always)]
    fn after(&self, sighted: bool, density: f64, log_odds: f64) -> f64 {
        // Below this its odds would round to nothing, and nothing could bring it back.
        let floor = self.lowest_log_odds.min(-50.0) - 1.0;
        let missed = (log_odds - self.missed_log_odds).max(floor);
        let gained = (log_odds + self.gain.of_sighting(density)).min(self.highest_log_odds);
        if sighted {
            gained
        } else {
            missed
        }
    }

    /// What a scan says against the maps that have a landmark in view, where nothing changes the landmark itself.
    fn weigh_missed(&self, maps: &mut Maps<'_>, slot: u32, judged: &[bool]) {
        let Some(existence) = &mut maps.landmarks.existence else { return };
        self.weigh(maps.particles, existence.read(slot).column(1), |i| judged[i]);
    }

    /// Weighs the maps that `chosen` marks by these log-odds of a landmark that they have in view.
    #[inline(always)]
    fn weigh(&self, particles: &mut Particles, log_odds: &[f64], chosen: impl Fn(usize) -> bool) {
        let (Some(detection), n) = (self.detection, log_odds.len()) else { return };
        let (odds, log_weight, score) = (*self, &mut particles.log_weight[..n], &mut particles.score[..n]);
        vectorized(
            #[inline(always)]
            move || {
                for i in 0..n {
                    let missed = odds.log_weight_of_missing(detection, log_odds[i]);
                    let add = |to: f64| if chosen(i) { to + missed } else { to };
                    (log_weight[i], score[i]) = (add(log_weight[i]), add(score[i]));
                }
            },
        );
    }

    /// Gives a landmark the odds that it has after the scan, in the maps that are judged; `news` says which sighted it,
    /// with the log-likelihoods of that, where any did.
    fn settle(
        self,
        [present, log_odds]: [&mut [f64]; EXISTENCE_COLUMNS],
        judged: &[bool],
        news: Option<(&[bool], &[f64])>,
        dead: &mut [bool],
    ) {
        let n = judged.len();
        vectorized(
            #[inline(always)]
            move || {
                let (judged, dead) = (&judged[..n], &mut dead[..n]);
                let (present, log_odds) = (&mut present[..n], &mut log_odds[..n]);
                if let Some((sighted, densities)) = news {
                    let (sighted, densities) = (&sighted[..n], &densities[..n]);
                    for i in 0..n {
                        let after = self.after(sighted[i], densities[i], log_odds[i]);
                        dead[i] = self.enter(after, judged[i], &mut present[i], &mut log_odds[i]);
                    }
                } else {
                    for i in 0..n {
                        let after = self.after(false, 0.0, log_odds[i]);
                        dead[i] = self.enter(after, judged[i], &mut present[i], &mut log_odds[i]);
                    }
                }
            },
        );
    }

    /// Enters the odds after the scan in one map; whether the landmark is removed from it.
    #[inline(always)]
    fn enter(&self, after: f64, judged: bool, present: &mut f64, log_odds: &mut f64) -> bool {
        let counts = judged & (*present != 0.0);
        let gone = counts & self.removes & (after < self.lowest_log_odds);
        let kept = if counts { after } else { *log_odds };
        *log_odds = if gone { 0.0 } else { kept };
        *present = if gone { 0.0 } else { *present };
        gone
    }

    /// Counts one scan for a landmark in every map and removes it from those in which it no longer exists. Returns
    /// whether the best particle lost it.
    fn count(&self, maps: &mut Maps<'_>, slot: u32, judging: &mut Judging) -> u32 {
        let Judging { verdicts: Verdicts { judged, sighted, densities }, dead, .. } = judging;
        let (odds, n) = (*self, judged.len());
        dead.resize(n, false);
        let Some(existence) = &mut maps.landmarks.existence else { return 0 };
        existence.update(slot, judged, &mut |rows| {
            let [present, log_odds] = rows.columns::<EXISTENCE_COLUMNS>().map(|column| &mut column[..n]);
            let (judged, dead) = (&judged[..n], &mut dead[..n]);
            self.weigh(maps.particles, log_odds, |i| judged[i] & (present[i] != 0.0));
            let news = any(sighted).then_some((&sighted[..n], &densities[..n]));
            odds.settle([present, log_odds], judged, news, dead);
        });
        if !any(dead) {
            return 0;
        }
        maps.lose(slot, dead);
        u32::from(dead[maps.particles.best()])
    }
}

/// What a sighting adds to the log-odds.
#[derive(Clone, Copy, Debug)]
enum Gain {
    /// By Bayes' rule, from P_D and λ_c.
    Bayes {
        detection: f64,
        clutter: f64,
    },
    Counted(f64),
}

impl Gain {
    fn of(association: &AssociationConfig, clutter_density: Option<f64>) -> Self {
        match (association.existence.form, association.detection_probability, clutter_density) {
            (ExistenceForm::Bayes, Some(detection), Some(clutter)) => Self::Bayes { detection, clutter },
            _ => Self::Counted(association.existence.sighted_log_odds),
        }
    }

    /// Of a sighting with this log-likelihood: ln(1 − P_D + P_D N / λ_c), or a fixed number.
    #[inline(always)]
    fn of_sighting(&self, log_likelihood: f64) -> f64 {
        match *self {
            Self::Bayes { detection, clutter } => {
                math::ln(1.0 - detection + detection * math::exp(log_likelihood) / clutter)
            }
            Self::Counted(log_odds) => log_odds,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::association::Identities;
    use crate::config::Config;
    use crate::random::{Purpose, RandomSource};

    #[test]
    fn views_narrowed_by_a_slope_show_what_directions_show() {
        let maps = 37;
        let mut config = Config::default();
        config.filter.particles = maps as u32;
        let mut landmarks = Landmarks::new(&config, Identities::None, 1.0, 3.0);
        let stream = RandomSource::new(6).stream(Purpose::Motion, 0);
        let (mut seen, mut unseen) = (0, 0);
        for case in 0..400 {
            let draw = |i: usize, k: u32| stream.uniform(case, 8 * i as u32 + k) - 0.5;
            let column = |scale: f64, k: u32| (0..maps).map(|i| scale * draw(i, k)).collect::<Vec<_>>();
            let half_width_rad = [0.1, 0.48, 1.2, 1.499, 1.501, 2.5, 4.0][case as usize % 7];
            let view = View::around(0.05, 3.0, half_width_rad);
            let mut poses = SensorPoses::default();
            poses.set(&column(2.0, 0), &column(2.0, 1), &column(9.0, 2), Default::default());
            let count = (0..maps).map(|i| if draw(i, 3) < -0.4 { 0.0 } else { 1.0 }).collect::<Vec<_>>();
            let (x, y) = (column(8.0, 4), column(8.0, 5));
            let rows = [count.clone(), x.clone(), y.clone(), vec![0.01; 3 * maps]].concat();
            let slot = landmarks.insert(None, &rows, 0.0);
            let mut in_view = vec![false; maps];
            let mut memory = Default::default();
            view.find_in_view(&mut landmarks, slot, &Eyes::of(&poses, &mut memory), &mut in_view);
            for i in 0..maps {
                let (dx, dy) = (x[i] - poses.x[i], y[i] - poses.y[i]);
                let bearing = math::wrap_angle(math::atan2(dy, dx) - poses.heading[i]);
                let range = dx.hypot(dy);
                let expected = count[i] != 0.0 && (0.05..3.0).contains(&range) && bearing.abs() < half_width_rad;
                assert_eq!(in_view[i], expected, "case {case}, map {i}");
                *(if expected { &mut seen } else { &mut unseen }) += 1;
            }
            landmarks.remove(slot);
        }
        assert!(seen > 1000 && unseen > 1000, "{seen} {unseen}");
    }
}
