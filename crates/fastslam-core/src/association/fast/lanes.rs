//! The columns of a block of particles and the passes of vector code over them.

use crate::association::choice::ordered;
use crate::belief::Belief;
use crate::density::{Fit, Tail};
use crate::geometry::{Pose, Symmetric2};
use crate::landmark::Gaussian;
use crate::measurement::Placing;
use crate::sighting::Measured;

/// Particles that decide together; their columns fit into the first level of cache.
pub const BLOCK: usize = 64;

/// One number per particle of a block.
pub(super) type Column = [f64; BLOCK];

pub(super) const ZERO: Column = [0.0; BLOCK];

/// The log-likelihood of what a map lacks.
pub(super) const ABSENT: f64 = f64::NEG_INFINITY;

/// Numbers of the particles of one block. One value with columns of fixed length: the compiler sees that they do not
/// overlap.
#[derive(Clone, Debug)]
pub(super) struct Lanes {
    /// Mean (x, y, heading), then the covariance's xx, xy, xh, yy, yh, hh.
    pub(super) belief: [Column; 9],
    /// Where the sensor is by that belief.
    sensor: [Column; 3],
    /// Zero where the pose was known before the scan, so that no sighting can refine it.
    pub(super) uncertain: Column,
    /// Value, then xx, xy, yy of the noise, of the sighting that each particle decides.
    pub(super) measured: [Column; 5],
    /// What speaks for the candidate that each particle considers, beside the place.
    pub(super) evidence: Column,
    /// Of the sightings so far, tempered.
    pub(super) log_likelihood: Column,
}

impl Default for Lanes {
    fn default() -> Self {
        Self {
            belief: [ZERO; 9],
            sensor: [ZERO; 3],
            uncertain: ZERO,
            measured: [ZERO; 5],
            evidence: ZERO,
            log_likelihood: ZERO,
        }
    }
}

impl Lanes {
    #[inline(always)]
    fn belief(&self, i: usize) -> Belief {
        let [x, y, heading, xx, xy, xh, yy, yh, hh] = &self.belief;
        let (xx, xy, xh, yy, yh, hh) = (xx[i], xy[i], xh[i], yy[i], yh[i], hh[i]);
        let covariance = [[xx, xy, xh], [xy, yy, yh], [xh, yh, hh]];
        Belief { mean: Pose::new(x[i], y[i], heading[i]), covariance }
    }

    #[inline(always)]
    fn sensor(&self, i: usize) -> Pose {
        let [x, y, heading] = &self.sensor;
        Pose::new(x[i], y[i], heading[i])
    }

    #[inline(always)]
    fn measured(&self, i: usize, tail: Tail) -> Measured {
        let [a, b, xx, xy, yy] = &self.measured;
        Measured { value: [a[i], b[i]], noise: Symmetric2::new(xx[i], xy[i], yy[i]), tail }
    }

    /// Places the sensors and finds the poses that are known; nothing speaks for any candidate.
    #[inline(always)]
    pub(super) fn begin(&mut self, width: usize, T_robot_sensor: Pose) {
        self.evidence = ZERO;
        for i in 0..width.min(BLOCK) {
            let belief = self.belief(i);
            let sensor = belief.mean.compose(T_robot_sensor);
            (self.sensor[0][i], self.sensor[1][i], self.sensor[2][i]) = (sensor.x, sensor.y, sensor.heading);
            let [[xx, xy, xh], [_, yy, yh], [_, _, hh]] = belief.covariance;
            let certain = (xx == 0.0) & (xy == 0.0) & (xh == 0.0) & (yy == 0.0) & (yh == 0.0) & (hh == 0.0);
            self.uncertain[i] = if certain { 0.0 } else { 1.0 };
            self.log_likelihood[i] = 0.0;
        }
    }

    /// How well one sighting fits one candidate in all maps.
    #[inline(always)]
    pub(super) fn compare<M: Placing>(
        &self,
        width: usize,
        model: &M,
        measured: &Measured,
        candidate: &Candidate,
        [log_likelihood, mahalanobis_squared]: &mut [Column; 2],
    ) {
        for i in 0..width.min(BLOCK) {
            let belief = self.belief(i);
            let fit = belief.judge(&belief.view(model, self.sensor(i), &gaussian(&candidate.gaussian, i), measured));
            (log_likelihood[i], mahalanobis_squared[i]) = (fit.log_likelihood, fit.mahalanobis_squared);
        }
    }

    /// [`Lanes::compare`] where all poses are known, so that only the landmark and the sensor are uncertain.
    #[inline(always)]
    pub(super) fn compare_certain<M: Placing>(
        &self,
        width: usize,
        model: &M,
        measured: &Measured,
        candidate: &Candidate,
        [log_likelihood, mahalanobis_squared]: &mut [Column; 2],
    ) {
        for i in 0..width.min(BLOCK) {
            let landmark = gaussian(&candidate.gaussian, i);
            let fit = self.belief(i).view(model, self.sensor(i), &landmark, measured).judge();
            (log_likelihood[i], mahalanobis_squared[i]) = (fit.log_likelihood, fit.mahalanobis_squared);
        }
    }

    /// Compares the sighting that each particle decides with the candidate that stands at `place`, and lets that
    /// compete.
    #[inline(always)]
    pub(super) fn consider<M: Placing>(
        &self,
        width: usize,
        sight: &Sight<'_, M>,
        place: usize,
        candidate: &Candidate,
        best: &mut Best,
    ) {
        for i in 0..width.min(BLOCK) {
            let (belief, landmark) = (self.belief(i), gaussian(&candidate.gaussian, i));
            let view = belief.view(sight.model, self.sensor(i), &landmark, &self.measured(i, sight.tail));
            let mut fit = belief.judge(&view);
            fit.log_likelihood += self.evidence[i];
            let leads = best.weigh(i, place, candidate.presence[i], fit);
            for (column, new) in best.gaussian.iter_mut().zip(&candidate.gaussian) {
                column[i] = if leads { new[i] } else { column[i] };
            }
        }
    }

    /// How likely the sighting that each particle decides is as one of this candidate.
    #[inline(always)]
    pub(super) fn judge<M: Placing>(
        &self,
        width: usize,
        sight: &Sight<'_, M>,
        candidate: &Candidate,
        log_likelihood: &mut Column,
    ) {
        for i in 0..width.min(BLOCK) {
            let (belief, landmark) = (self.belief(i), gaussian(&candidate.gaussian, i));
            let view = belief.view(sight.model, self.sensor(i), &landmark, &self.measured(i, sight.tail));
            let value = belief.judge(&view).log_likelihood + self.evidence[i];
            log_likelihood[i] = if candidate.presence[i] != 0.0 { value } else { ABSENT };
        }
    }

    /// Refines the uncertain beliefs by the sighting where it was accepted as one of the best candidate.
    #[inline(always)]
    pub(super) fn refine<M: Placing>(&mut self, width: usize, sight: &Sight<'_, M>, T_robot_sensor: Pose, best: &Best) {
        for i in 0..width.min(BLOCK) {
            let before = self.belief(i);
            let landmark = gaussian(&best.gaussian, i);
            let (after, _) =
                before.refined(&before.view(sight.model, self.sensor(i), &landmark, &self.measured(i, sight.tail)));
            // Selections in place of branches: the loop must stay a straight line to become vector code.
            let active = (best.accepted[i] != 0.0) & (self.uncertain[i] != 0.0);
            let pick = |new: f64, old: f64| if active { new } else { old };
            let [[xx, xy, xh], [_, yy, yh], [_, _, hh]] = after.covariance;
            let new = [after.mean.x, after.mean.y, after.mean.heading, xx, xy, xh, yy, yh, hh];
            for (column, new) in self.belief.iter_mut().zip(new) {
                column[i] = pick(new, column[i]);
            }
            let sensor = after.mean.compose(T_robot_sensor);
            for (column, new) in self.sensor.iter_mut().zip([sensor.x, sensor.y, sensor.heading]) {
                column[i] = pick(new, column[i]);
            }
        }
    }
}

/// How a sighting is seen: the model, and the tail of its noise.
pub(super) struct Sight<'a, M> {
    pub(super) model: &'a M,
    pub(super) tail: Tail,
}

/// A landmark in all maps of a block, or another one in each.
#[derive(Clone, Debug)]
pub(super) struct Candidate {
    /// Zero where there is none, or a sighting has taken it.
    pub(super) presence: Column,
    /// Whether any map has it; those that none has need no arithmetic.
    pub(super) is_held: bool,
    /// Mean x, y, then the covariance's xx, xy, yy.
    pub(super) gaussian: [Column; 5],
}

impl Default for Candidate {
    fn default() -> Self {
        Self { presence: ZERO, is_held: false, gaussian: [ZERO; 5] }
    }
}

/// The likeliest candidate of the sighting that each particle decides.
#[derive(Clone, Debug)]
pub(super) struct Best {
    /// Its place among those of the sighting; negative for none.
    pub(super) place: Column,
    /// Not a number for none.
    log_likelihood: Column,
    mahalanobis_squared: Column,
    /// Log-likelihood of the next explanation.
    second: Column,
    /// As [`Candidate::gaussian`].
    pub(super) gaussian: [Column; 5],
    /// One where it is taken for what was sighted.
    pub(super) accepted: Column,
    /// One where the sighting shows nothing that the map should know.
    pub(super) ignored: Column,
}

impl Default for Best {
    fn default() -> Self {
        Self {
            place: ZERO,
            log_likelihood: ZERO,
            mahalanobis_squared: ZERO,
            second: ZERO,
            gaussian: [ZERO; 5],
            accepted: ZERO,
            ignored: ZERO,
        }
    }
}

impl Best {
    /// No candidate yet; the next explanation is a new landmark.
    #[inline(always)]
    pub(super) fn clear(&mut self, log_unexplained_density: f64) {
        self.place = [-1.0; BLOCK];
        self.log_likelihood = [f64::NAN; BLOCK];
        self.second = [log_unexplained_density; BLOCK];
    }

    /// Lets one more candidate of one particle compete; whether it leads now. Ties go to the earlier one.
    #[inline(always)]
    fn weigh(&mut self, i: usize, place: usize, presence: f64, fit: Fit) -> bool {
        let (value, leader, second) = (fit.log_likelihood, self.log_likelihood[i], self.second[i]);
        let present = presence != 0.0;
        // The first comes in because nothing is less than or equal to no number.
        #[allow(clippy::neg_cmp_op_on_partial_ord)]
        let better = present & !(value <= leader);
        let loser = if better { leader } else { value };
        self.second[i] = if present & (loser > second) { loser } else { second };
        self.place[i] = if better { place as f64 } else { self.place[i] };
        self.log_likelihood[i] = if better { value } else { leader };
        self.mahalanobis_squared[i] = if better { fit.mahalanobis_squared } else { self.mahalanobis_squared[i] };
        better
    }

    /// Lets one more candidate compete in all maps.
    #[inline(always)]
    pub(super) fn weigh_all(&mut self, width: usize, place: usize, presence: &Column, fits: &[Column; 2]) {
        for i in 0..width.min(BLOCK) {
            let fit = Fit { log_likelihood: fits[0][i], mahalanobis_squared: fits[1][i] };
            self.weigh(i, place, presence[i], fit);
        }
    }

    /// By how much the best explanation beats the next, as `best_choice` has it, in numbers that sort as
    /// [`f64::total_cmp`] does; all the same where the pose is known.
    #[inline(always)]
    pub(super) fn margins(
        &self,
        width: usize,
        log_unexplained_density: f64,
        uncertain: &Column,
        keys: &mut [i64; BLOCK],
    ) {
        for i in 0..width.min(BLOCK) {
            let best = self.log_likelihood[i];
            let new = if self.place[i] < 0.0 { -1e3 } else { log_unexplained_density - best - 1e6 };
            let margin = if best >= log_unexplained_density { best - self.second[i] } else { new };
            let bits = ordered(margin).to_bits() as i64;
            keys[i] = if uncertain[i] != 0.0 { bits ^ ((bits >> 63) as u64 >> 1) as i64 } else { 0 };
        }
    }

    /// Decides between the best candidate, nothing, and a new landmark, and adds the log-likelihood of that.
    #[inline(always)]
    pub(super) fn settle(
        &mut self,
        width: usize,
        [gate, least_lead]: [f64; 2],
        [new, unexplained]: [f64; 2],
        (exponent, log_likelihood): (f64, &mut Column),
    ) {
        for i in 0..width.min(BLOCK) {
            let known = self.log_likelihood[i] >= new;
            let leads = self.log_likelihood[i] - self.second[i] >= least_lead;
            let explained = (self.log_likelihood[i] >= unexplained) & (self.mahalanobis_squared[i] <= gate) & leads;
            self.accepted[i] = if explained { 1.0 } else { 0.0 };
            self.ignored[i] = if known & !explained { 1.0 } else { 0.0 };
            log_likelihood[i] += exponent * if explained { self.log_likelihood[i] } else { unexplained };
        }
    }
}

#[inline(always)]
fn gaussian([x, y, xx, xy, yy]: &[Column; 5], i: usize) -> Gaussian {
    Gaussian { mean: [x[i], y[i]], covariance: Symmetric2::new(xx[i], xy[i], yy[i]) }
}

/// Ranks the sightings of each particle, largest key first; of equal ones the earlier first.
///
/// **Why by counting:** all particles are done in the same steps, so that the passes become vector code.
#[inline(always)]
pub(super) fn rank(keys: &[[i64; BLOCK]], j: usize, ranks: &mut [i64; BLOCK]) {
    *ranks = [0; BLOCK];
    let (own, before, after) = (&keys[j], &keys[..j], &keys[j + 1..]);
    for other in before {
        for i in 0..BLOCK {
            ranks[i] += i64::from(other[i] >= own[i]);
        }
    }
    for other in after {
        for i in 0..BLOCK {
            ranks[i] += i64::from(other[i] > own[i]);
        }
    }
}
