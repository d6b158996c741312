//! One scan: propose, weigh, resample, sample, correct.

use super::past::{numbers, Heard, Noise, Reading};
use super::place::{spread_of, Place};
use super::sensing::{Look, Request, Sensing};
use super::state::Name;
use super::PartialSlam;
use crate::belief::{by_robot_pose, Belief};
use crate::config::Algorithm;
use crate::density::Fit;
use crate::diagnosis::health::Vitals;
use crate::diagnosis::innovations::PredictedScan;
use crate::error::Result;
use crate::filter::{mixture, NoiseInWindow, StepInfo};
use crate::gaussian::Gaussian;
use crate::geometry::{moved_by, Pose};
use crate::limits::{LEAST, LONGEST_M};
use crate::math;
use crate::motion::MotionGaussian;
use crate::normal::{fit, scaled, sum, Cholesky, Matrix, Normal};
use crate::random::Purpose;
use crate::resampling::{follow, resample};
use crate::sighting::{deal, Sighting, Skipped};

/// Innovations are examined where so much of the weight has the landmark placed.
const PLACED_BY_MOST: f64 = 0.5;

/// A sighting that can be used, with the name of its landmark.
#[derive(Clone, Copy, Debug)]
struct Named<const Z: usize> {
    identity: u32,
    reading: Reading<Z>,
}

/// A sighting as a belief predicted it.
pub(super) struct Predicted<const Z: usize> {
    pub innovation: [f64; Z],
    /// Covariance of the innovation.
    pub spread: Matrix<Z, Z>,
    pub fit: Fit,
}

impl<S: Sensing<Z>, const Z: usize> PartialSlam<S, Z> {
    pub(super) fn take_in(&mut self, stamp_s: f64, sightings: &[Sighting]) -> Result<StepInfo> {
        let mut info = StepInfo { step: self.state.counters.steps, ..StepInfo::default() };
        let usable = self.usable_of(sightings, &mut info.left_out.skipped);
        info.sightings = usable.len() as u32;
        let births_before = self.births();
        self.state.watch.begin(stamp_s, info.sightings);
        info.sampling.sampled = info.sightings > 0 || !self.state.cloud.pending.can_be_linearised_on();
        if info.sampling.sampled {
            let (motion, mut ancestors) = (self.state.cloud.pending, None);
            if self.state.unnamed.is_some() {
                let scan: Vec<Reading<Z>> = usable.iter().map(|(_, reading)| *reading).collect();
                self.process_unnamed(&scan, &mut ancestors, &mut info)?;
            } else {
                for round in &rounds(&usable) {
                    self.process(round, &mut ancestors, &mut info)?;
                }
            }
            self.check_numbers()?;
            // Only now: what was done to the paths cannot be undone.
            ancestors.iter().for_each(|ancestors| self.state.path.resample(ancestors));
            let particles = &self.state.cloud.particles;
            self.state.path.extend(stamp_s, &self.workers, |i| particles.pose(i));
            self.state.past.step_done(motion);
            if self.draw_is_due_after(0) {
                info.sampling.rejuvenated = self.draw_anew()?;
            }
        } else {
            info.weighing.effective_sample_size =
                1.0 / self.state.cloud.weights.values.iter().map(|w| w * w).sum::<f64>();
            let beliefs = self.beliefs();
            self.estimate_beliefs(&beliefs);
        }
        info.landmarks = self.state.cloud.maps[self.state.cloud.particles.best()].len() as u32;
        self.judge_health(stamp_s, births_before, &mut info);
        self.state.counters.steps += 1;
        Ok(info)
    }

    /// The sightings that can be used, with their names where they have one.
    fn usable_of(&self, sightings: &[Sighting], skipped: &mut Skipped) -> Vec<(Option<u32>, Reading<Z>)> {
        sightings.iter().filter_map(|one| Some((one.identity, self.usable(one, skipped)?))).collect()
    }

    /// Landmarks ever created.
    fn births(&self) -> u64 {
        self.state.unnamed.as_ref().map_or(self.state.cloud.names.len() as u64, |unnamed| unnamed.next_birth)
    }

    /// A sighting that can be used; others are counted by reason.
    fn usable(&self, sighting: &Sighting, skipped: &mut Skipped) -> Option<Reading<Z>> {
        let (limits, tail) = (self.config.sensor.common(), self.config.sensor.tail());
        let columns = self.sensor.columns();
        let measured = columns.map(|column| sighting.value[column]);
        let distance_m = self.sensor.distance(&self.prior.mean.corrected(measured));
        let noise = sighting.noise.map(|noise| numbers(noise, columns));
        let sized = |c: &Matrix<Z, Z>| {
            (0..Z).all(|i| (LEAST * LEAST..=LONGEST_M * LONGEST_M).contains(&c[i][i])) && Cholesky::of(c).is_some()
        };
        if !measured.iter().all(|v| v.is_finite()) {
            skipped.not_finite += 1;
        } else if distance_m.is_some_and(|distance_m| distance_m < limits.min_range_m) {
            skipped.too_near += 1;
        } else if distance_m.is_some_and(|distance_m| distance_m > limits.max_range_m) {
            skipped.too_far += 1;
        } else if sighting.identity.is_none() && self.state.unnamed.is_none() {
            skipped.without_identity += 1;
        } else if noise.is_some_and(|c| !sized(&c)) {
            skipped.bad_covariance += 1;
        } else {
            let noise = Noise { covariance: noise.unwrap_or(self.sensor.noise()), tail };
            return Some(Reading { measured, noise });
        }
        None
    }

    /// What the particles believe of their poses after the motion since the last sampling.
    pub(super) fn beliefs(&self) -> Vec<Belief> {
        let cloud = &self.state.cloud;
        let belief = |i: usize| {
            let pose = cloud.particles.pose(i);
            let (mean, _) = moved_by(pose, cloud.pending.mean);
            Belief { mean, covariance: cloud.pending.covariance_in_world(pose.heading) }
        };
        (0..cloud.particles.len()).map(belief).collect()
    }

    /// One scan that hears each landmark once at most.
    fn process(&mut self, round: &[Named<Z>], ancestors: &mut Option<Vec<u32>>, info: &mut StepInfo) -> Result<()> {
        let mut beliefs = self.beliefs();
        self.state.cloud.pending = MotionGaussian::default();
        let heard = self.give_slots(round);
        let uncalibrated = heard.iter().map(|one| self.uncalibrated(one)).collect::<Vec<_>>();
        let (known, new): (Vec<_>, Vec<_>) = uncalibrated.into_iter().partition(|one| one.slot < self.known_slots());
        if self.config.algorithm != Algorithm::Fastslam1 && !self.is_learning() {
            for one in &known {
                self.refine(one, &mut beliefs)?;
            }
        }
        self.estimate_weighed(&beliefs, info)?;
        if let Some(drawn) = self.resampled(info) {
            follow(&mut beliefs, &drawn, &mut Vec::new());
            match ancestors {
                Some(earlier) => follow(earlier, &drawn, &mut Vec::new()),
                None => *ancestors = Some(drawn),
            }
        }
        self.sample(&beliefs);
        let weighed = self.correct(&known)?;
        for one in &new {
            self.give_birth(one)?;
            info.changes.new_landmarks += 1;
        }
        for one in &heard {
            self.state.past.heard(one);
            self.state.cloud.names[one.slot].sightings += 1;
        }
        if weighed {
            info.weighing.log_likelihood += self.weights_now()?;
            self.estimate_particles();
        }
        Ok(())
    }

    /// Landmarks that all maps hold.
    fn known_slots(&self) -> usize {
        self.state.cloud.maps.first().map_or(0, Vec::len)
    }

    /// The sightings with the slots of their landmarks; new ones get the next free.
    fn give_slots(&mut self, round: &[Named<Z>]) -> Vec<Heard<Z>> {
        let slot = |named: &Named<Z>| {
            let (names, next) = (&mut self.state.cloud.names, self.state.slot_of.len() as u32);
            let slot = *self.state.slot_of.entry(named.identity).or_insert(next);
            if slot as usize == names.len() {
                names.push(Name { identity: named.identity, sightings: 0 });
            }
            Heard { slot: slot as usize, measured: named.reading.measured, noise: named.reading.noise }
        };
        round.iter().map(slot).collect()
    }

    /// Whether the calibration is still to be learned: until the first draw.
    ///
    /// **Why nothing is weighed until then:** the error of the calibration is the same in all sightings, which particles
    /// with a calibration of their own outlive only by a wrong path that happens to fit, and as noise it would count as if
    /// it were new every time. The path is that of the odometry, and landmarks are placed along it.
    pub(super) fn is_learning(&self) -> bool {
        self.state.counters.draws == 0 && self.prior.std != [0.0; 2]
    }

    /// A sighting as uncertain as the calibration, as long as that is to be learned.
    fn uncalibrated(&self, one: &Heard<Z>) -> Heard<Z> {
        let mut one = *one;
        if self.is_learning() {
            let (range, [scale_std, bias_std]) = (self.prior.mean.corrected(one.measured)[0], self.prior.std);
            one.noise.covariance[0][0] += (scale_std * range).powi(2) + bias_std * bias_std;
        }
        one
    }

    /// Normalises the weights and gives the estimate of the beliefs.
    pub(super) fn estimate_weighed(&mut self, beliefs: &[Belief], info: &mut StepInfo) -> Result<()> {
        info.weighing.log_likelihood += self.weights_now()?;
        info.weighing.effective_sample_size = self.state.cloud.weights.effective_sample_size;
        self.estimate_beliefs(beliefs);
        Ok(())
    }

    pub(super) fn weights_now(&mut self) -> Result<f64> {
        let cloud = &mut self.state.cloud;
        cloud.weights.renormalize(&cloud.particles.log_weight, self.state.counters.steps)
    }

    /// Refines the beliefs by a sighting of a landmark, in the particles that have it placed, and weighs these.
    ///
    /// **Source:** as [`Belief::refine`], for any number of numbers; in the others the pose stays proposed by the motion.
    fn refine(&mut self, one: &Heard<Z>, beliefs: &mut [Belief]) -> Result<()> {
        let holders: Vec<(usize, Gaussian)> = (0..beliefs.len())
            .filter_map(|i| match &self.state.cloud.maps[i][one.slot] {
                Place::One(gaussian) => Some((i, *gaussian)),
                Place::Many(_) => None,
            })
            .collect();
        let request = |(i, gaussian): &(usize, Gaussian)| {
            self.request(one, beliefs[*i].mean.compose(self.T_robot_sensor), *i, gaussian.mean)
        };
        let looks = self.sensor.look(&holders.iter().map(request).collect::<Vec<_>>())?;
        let mut predicted = Vec::with_capacity(holders.len());
        for ((i, gaussian), look) in holders.iter().zip(&looks) {
            let Some((belief, seen)) = refined(&beliefs[*i], look, (gaussian, &one.noise), self.T_robot_sensor) else {
                self.state.cloud.weigh(*i, f64::NEG_INFINITY);
                continue;
            };
            beliefs[*i] = belief;
            predicted.push((self.state.cloud.weights.values[*i], seen.innovation, seen.spread, gaussian.mean));
            self.state.cloud.weigh(*i, self.config.filter.likelihood_exponent * seen.fit.log_likelihood);
        }
        self.examine(one, &predicted);
        Ok(())
    }

    pub(super) fn request(&self, one: &Heard<Z>, sensor: Pose, particle: usize, landmark: [f64; 2]) -> Request<Z> {
        let calibration = self.state.cloud.calibrations[particle];
        Request { T_world_sensor: sensor, landmark, measured: one.measured, calibration }
    }

    /// Hands the watch what the particles together predicted of a landmark that most have placed.
    fn examine(&mut self, one: &Heard<Z>, predicted: &[(f64, [f64; Z], Matrix<Z, Z>, [f64; 2])]) {
        let mass: f64 = predicted.iter().map(|(weight, ..)| weight).sum();
        if mass <= PLACED_BY_MOST {
            return;
        }
        let parts: Vec<(f64, Normal<Z>)> = predicted
            .iter()
            .map(|(weight, innovation, s, _)| (weight / mass, Normal { mean: *innovation, covariance: *s }))
            .collect();
        let whole = Normal::of_mixture(parts.iter().map(|(share, part)| (*share, part)));
        let mut scan = PredictedScan { size: Z, ..PredictedScan::default() };
        for a in 0..Z {
            scan.innovation[a] = whole.mean[a];
            scan.covariance[a][..Z].copy_from_slice(&whole.covariance[a]);
        }
        self.state.watch.noise.add(&scan);
        let place = std::array::from_fn(|d| predicted.iter().map(|(w, _, _, mean)| w / mass * mean[d]).sum());
        self.state.watch.matched(std::iter::once((place, one.slot as u64)), 1);
    }

    /// Resamples if the effective sample size says so, and tells who became whom.
    pub(super) fn resampled(&mut self, info: &mut StepInfo) -> Option<Vec<u32>> {
        let settings = &self.config.filter.resampling;
        let count = self.state.cloud.particles.len();
        if info.sightings == 0 || !self.state.cloud.weights.are_uneven(settings.threshold) {
            return None;
        }
        let stream = self.random.stream(Purpose::Resampling, self.state.counters.samplings);
        let mut drawn = Vec::new();
        resample(settings.scheme, &self.state.cloud.weights.values, count, stream, &mut drawn);
        self.state.cloud.resample(&drawn);
        self.state.unnamed.iter_mut().for_each(|unnamed| unnamed.resample(&drawn));
        info.weighing.resampled = true;
        Some(drawn)
    }

    /// Corrects landmarks in all maps at the sampled poses, all of which the sensor is asked for at once; tells whether
    /// that has weighed the particles.
    fn correct(&mut self, known: &[Heard<Z>]) -> Result<bool> {
        let cloud = &self.state.cloud;
        let mut requests = Vec::new();
        for one in known {
            for (i, map) in cloud.maps.iter().enumerate() {
                let sensor = cloud.particles.pose(i).compose(self.T_robot_sensor);
                let parts = map[one.slot].parts();
                requests.extend(parts.iter().map(|part| self.request(one, sensor, i, part.gaussian.mean)));
            }
        }
        let looks = self.sensor.look(&requests)?;
        let (mut rest, mut weighed) = (looks.as_slice(), false);
        let (weighs_all, learning) = (self.config.algorithm == Algorithm::Fastslam1, self.is_learning());
        for one in known {
            for i in 0..self.state.cloud.maps.len() {
                let place = &mut self.state.cloud.maps[i][one.slot];
                let (own, others) = rest.split_at(place.parts().len());
                rest = others;
                let weighs = !learning && (weighs_all || matches!(place, Place::Many(_)));
                let likelihood = place.correct(own, &one.noise);
                if weighs {
                    weighed = true;
                    self.state.cloud.weigh(i, self.config.filter.likelihood_exponent * likelihood);
                }
            }
        }
        Ok(weighed)
    }

    /// A landmark that is sighted for the first time.
    fn give_birth(&mut self, one: &Heard<Z>) -> Result<()> {
        let cloud = &self.state.cloud;
        let from = |i: usize| {
            let sensor = cloud.particles.pose(i).compose(self.T_robot_sensor);
            (sensor, cloud.calibrations[i].corrected(one.measured))
        };
        let sightings: Vec<_> = (0..cloud.particles.len()).map(from).collect();
        let births = self.sensor.births(&sightings, &one.noise.covariance)?;
        let places: Option<Vec<Place>> = births.iter().map(|components| Place::born(components)).collect();
        let what = "a new landmark";
        let places = places.ok_or(crate::error::Error::NotFinite { step: self.state.counters.steps, what })?;
        self.state.cloud.maps.iter_mut().zip(places).for_each(|(map, place)| map.push(place));
        Ok(())
    }

    pub(super) fn estimate_beliefs(&mut self, beliefs: &[Belief]) {
        let cloud = &mut self.state.cloud;
        cloud.take_estimate(mixture(&cloud.weights.values, |i| (beliefs[i].mean, beliefs[i].covariance)));
    }

    pub(super) fn estimate_particles(&mut self) {
        let cloud = &mut self.state.cloud;
        cloud.take_estimate(mixture(&cloud.weights.values, |i| (cloud.particles.pose(i), [[0.0; 3]; 3])));
    }

    /// Gives the verdict on a step.
    fn judge_health(&mut self, stamp_s: f64, births_before: u64, info: &mut StepInfo) {
        let map_in_view = self.look_at_map();
        let cloud = &self.state.cloud;
        let particles = cloud.particles.len();
        let vitals = Vitals {
            stamp_s,
            particles,
            effective_sample_size: info.weighing.effective_sample_size,
            T_world_robot: cloud.estimate.mean,
            pose_covariance: cloud.estimate.covariance,
            births_before,
            names_known: self.state.unnamed.is_none(),
            places: true,
            map_in_view,
        };
        let watch = &mut self.state.watch;
        (info.sampling.particles, info.matched) = (particles as u32, watch.matches() as u32);
        if watch.noise.is_report_due() {
            self.state.noise_report = watch.noise.of_window();
        }
        info.noise = NoiseInWindow::from(&self.state.noise_report);
        // The watch was told where the landmarks are, not what was measured.
        info.health = watch.judge(&vitals, |_, place| place);
    }
}

/// The usable sightings, in rounds that hear each landmark once at most; one round at least.
fn rounds<const Z: usize>(usable: &[(Option<u32>, Reading<Z>)]) -> Vec<Vec<Named<Z>>> {
    let mut rounds = Vec::new();
    let named = usable.iter().filter_map(|(name, reading)| name.map(|identity| Named { identity, reading: *reading }));
    deal(&mut rounds, named, |named| Some(named.identity));
    rounds
}

/// A belief about a pose refined by a landmark that was looked at from its mean, and how it was predicted; `None` where that cannot
/// be computed.
pub(super) fn refined<const Z: usize>(
    belief: &Belief,
    look: &Look<Z>,
    (landmark, noise): (&Gaussian, &Noise<Z>),
    T_robot_sensor: Pose,
) -> Option<(Belief, Predicted<Z>)> {
    let by_pose = by_robot_pose(look.by_pose, belief.mean, belief.mean.compose(T_robot_sensor));
    let q = spread_of(look, landmark, &noise.covariance);
    let spread = sum(&crate::normal::congruence(&by_pose, &belief.covariance), &q);
    let fit = fit(&look.innovation, &spread, noise.tail).filter(|fit| fit.log_likelihood.is_finite())?;
    let more = noise.tail.noise_scale_of(Z, fit.mahalanobis_squared) - 1.0;
    let q = sum(&q, &scaled(&noise.covariance, more));
    let mut refined = *belief;
    if let Some(change) = Normal::given(&belief.covariance, &by_pose, &look.innovation, &q) {
        let [x, y, heading] = change.mean;
        let mean = belief.mean;
        let heading = math::wrap_angle(mean.heading + heading);
        refined = Belief { mean: Pose::new(mean.x + x, mean.y + y, heading), covariance: change.covariance };
    }
    Some((refined, Predicted { innovation: look.innovation, spread, fit }))
}
