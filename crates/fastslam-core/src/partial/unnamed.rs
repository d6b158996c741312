//! One scan without names: every particle decides what it shows, and keeps what it decided until paths are drawn.

use super::choose::{Choice, Taken};
use super::past::{Heard, Reading};
use super::place::Place;
use super::sensing::{Request, Sensing};
use super::state::{Unnamed, NOTHING};
use super::PartialSlam;
use crate::diagnosis::innovations::PredictedScan;
use crate::diagnosis::looks::{InView, MapInView};
use crate::error::{Error, Result};
use crate::filter::StepInfo;
use crate::motion::MotionGaussian;

/// A landmark that was seen less often may be none: nobody expects to see it again.
const SIGHTINGS_TO_COUNT: u32 = 3;

impl<S: Sensing<Z>, const Z: usize> PartialSlam<S, Z> {
    /// One scan, each sighting of which may be of any landmark.
    pub(super) fn process_unnamed(
        &mut self,
        scan: &[Reading<Z>],
        ancestors: &mut Option<Vec<u32>>,
        info: &mut StepInfo,
    ) -> Result<()> {
        let mut beliefs = self.beliefs();
        self.state.cloud.pending = MotionGaussian::default();
        let choose = |(i, belief)| self.choose(i, belief, scan);
        let mut choices = beliefs.iter_mut().enumerate().map(choose).collect::<Result<Vec<Choice>>>()?;
        for (i, choice) in choices.iter().enumerate() {
            self.state.cloud.weigh(i, self.config.filter.likelihood_exponent * choice.log_likelihood);
        }
        self.estimate_weighed(&beliefs, info)?;
        let best = self.state.cloud.particles.best();
        self.tell(&choices[best], best, info);
        self.examine_scan(scan, &choices[best], (best, &beliefs[best]))?;
        if let Some(drawn) = self.resampled(info) {
            beliefs = drawn.iter().map(|a| beliefs[*a as usize]).collect();
            choices = drawn.iter().map(|a| choices[*a as usize].clone()).collect();
            *ancestors = Some(drawn);
        }
        self.sample(&beliefs);
        let weighed = self.correct_chosen(scan, &choices)?;
        info.changes.new_landmarks += self.found_chosen(scan, &choices)?;
        self.remember(scan, &choices);
        if weighed {
            info.weighing.log_likelihood += self.weights_now()?;
            self.estimate_particles();
        }
        Ok(())
    }

    /// Counts what the best particle made of the scan, and tells the watch which landmarks it has seen again.
    fn tell(&mut self, choice: &Choice, best: usize, info: &mut StepInfo) {
        let Some(unnamed) = &self.state.unnamed else { return };
        let known = choice.taken.iter().filter_map(|taken| match taken {
            Taken::Landmark(slot) => {
                let place = self.state.cloud.maps[best][*slot].moments().mean;
                Some((place, unnamed.births[best][*slot]))
            }
            Taken::New | Taken::Nothing => None,
        });
        let known: Vec<_> = known.collect();
        info.left_out.ignored += choice.taken.iter().filter(|taken| **taken == Taken::Nothing).count() as u32;
        self.state.watch.matched(known.into_iter(), choice.taken.len());
    }

    /// Hands the watch what the best particle predicted of the landmarks that it has placed.
    fn examine_scan(
        &mut self,
        scan: &[Reading<Z>],
        choice: &Choice,
        (best, belief): (usize, &crate::belief::Belief),
    ) -> Result<()> {
        for (one, taken) in scan.iter().zip(&choice.taken) {
            let Taken::Landmark(slot) = taken else { continue };
            let Place::One(gaussian) = &self.state.cloud.maps[best][*slot] else { continue };
            let request = self.request_of(one, belief.mean.compose(self.T_robot_sensor), best, gaussian.mean);
            let looks = self.sensor.look(&[request])?;
            let Some((_, seen)) = looks
                .first()
                .and_then(|look| super::scan::refined(belief, look, (gaussian, &one.noise), self.T_robot_sensor))
            else {
                continue;
            };
            let mut predicted = PredictedScan { size: Z, ..PredictedScan::default() };
            for a in 0..Z {
                predicted.innovation[a] = seen.innovation[a];
                predicted.covariance[a][..Z].copy_from_slice(&seen.spread[a]);
            }
            self.state.watch.noise.add(&predicted);
        }
        Ok(())
    }

    /// The landmarks of the best particle's map that the scan should have shown, where that is looked at.
    pub(super) fn look_at_map(&mut self) -> Option<MapInView> {
        let unnamed = self.state.unnamed.as_ref()?;
        let best = self.state.cloud.particles.best();
        let pose = self.state.cloud.particles.pose(best);
        let watch = &mut self.state.watch;
        if !watch.examines() || !watch.looks_from(pose) {
            return None;
        }
        let (view, mut in_view) = (watch.view(), MapInView::default());
        let outlook = view.from(pose);
        for (slot, place) in self.state.cloud.maps[best].iter().enumerate() {
            let Place::One(gaussian) = place else { continue };
            let counted = unnamed.sightings_of(best, slot, &self.state.cloud.names) >= SIGHTINGS_TO_COUNT;
            if counted && outlook.contains(gaussian.mean) {
                let birth = unnamed.births[best][slot];
                watch.looked(&mut in_view, InView { birth, sighted: watch.has_matched(birth) });
            }
        }
        Some(in_view)
    }

    /// Numbers of the landmarks of the best particle that are no chance.
    pub(super) fn births_that_count(&self) -> Vec<u64> {
        let best = self.state.cloud.particles.best();
        let Some(unnamed) = &self.state.unnamed else { return Vec::new() };
        let counts = |slot: &usize| unnamed.sightings_of(best, *slot, &self.state.cloud.names) >= SIGHTINGS_TO_COUNT;
        (0..unnamed.births[best].len()).filter(counts).map(|slot| unnamed.births[best][slot]).collect()
    }

    fn request_of(
        &self,
        one: &Reading<Z>,
        sensor: crate::geometry::Pose,
        particle: usize,
        landmark: [f64; 2],
    ) -> Request<Z> {
        let calibration = self.state.cloud.calibrations[particle];
        Request { T_world_sensor: sensor, landmark, measured: one.measured, calibration }
    }

    /// Corrects in every map the landmarks that its particle chose; tells whether that has weighed the particles.
    fn correct_chosen(&mut self, scan: &[Reading<Z>], choices: &[Choice]) -> Result<bool> {
        let mut requests = Vec::new();
        for (i, choice) in choices.iter().enumerate() {
            let sensor = self.state.cloud.particles.pose(i).compose(self.T_robot_sensor);
            for (one, slot) in chosen(scan, choice) {
                let parts = self.state.cloud.maps[i][slot].parts();
                requests.extend(parts.iter().map(|part| self.request_of(one, sensor, i, part.gaussian.mean)));
            }
        }
        let looks = self.sensor.look(&requests)?;
        let (mut rest, mut weighed) = (looks.as_slice(), false);
        for (i, choice) in choices.iter().enumerate() {
            for (one, slot) in chosen(scan, choice) {
                let place = &mut self.state.cloud.maps[i][slot];
                let (own, others) = rest.split_at(place.parts().len());
                rest = others;
                let weighs = matches!(place, Place::Many(_));
                let likelihood = place.correct(own, &one.noise);
                if weighs {
                    weighed = true;
                    self.state.cloud.weigh(i, self.config.filter.likelihood_exponent * likelihood);
                }
            }
        }
        Ok(weighed)
    }

    /// Founds the landmarks that particles take sightings for; how many sightings found one.
    fn found_chosen(&mut self, scan: &[Reading<Z>], choices: &[Choice]) -> Result<u32> {
        let mut founding = 0;
        for (j, one) in scan.iter().enumerate() {
            let holders: Vec<usize> = (0..choices.len()).filter(|i| choices[*i].taken[j] == Taken::New).collect();
            if holders.is_empty() {
                continue;
            }
            let from = |i: &usize| {
                let sensor = self.state.cloud.particles.pose(*i).compose(self.T_robot_sensor);
                (sensor, self.state.cloud.calibrations[*i].corrected(one.measured))
            };
            let sightings: Vec<_> = holders.iter().map(from).collect();
            let births = self.sensor.births(&sightings, &one.noise.covariance)?;
            for (i, components) in holders.iter().zip(&births) {
                let what = "a new landmark";
                let place = Place::born(components);
                let place = place.ok_or(Error::NotFinite { step: self.state.counters.steps, what })?;
                self.state.cloud.maps[*i].push(place);
                if let Some(unnamed) = &mut self.state.unnamed {
                    unnamed.births[*i].push(unnamed.next_birth);
                }
            }
            founding += 1;
            if let Some(unnamed) = &mut self.state.unnamed {
                unnamed.next_birth += 1;
            }
        }
        Ok(founding)
    }

    /// Keeps the sightings, and what every particle took them for.
    fn remember(&mut self, scan: &[Reading<Z>], choices: &[Choice]) {
        for one in scan {
            let open = Heard { slot: NOTHING as usize, measured: one.measured, noise: one.noise };
            self.state.past.heard(&open);
        }
        let Some(Unnamed { births, claims, .. }) = &mut self.state.unnamed else { return };
        for ((choice, births), claims) in choices.iter().zip(births).zip(claims) {
            let founded = choice.taken.iter().filter(|taken| **taken == Taken::New).count();
            let mut next = births.len() - founded;
            claims.extend(choice.taken.iter().map(|taken| match taken {
                Taken::Landmark(slot) => *slot as u32,
                Taken::New => {
                    next += 1;
                    next as u32 - 1
                }
                Taken::Nothing => NOTHING,
            }));
        }
    }
}

/// The sightings that a particle takes for landmarks of its map, with these.
fn chosen<'a, const Z: usize>(
    scan: &'a [Reading<Z>],
    choice: &'a Choice,
) -> impl Iterator<Item = (&'a Reading<Z>, usize)> {
    scan.iter().zip(&choice.taken).filter_map(|(one, taken)| match taken {
        Taken::Landmark(slot) => Some((one, *slot)),
        Taken::New | Taken::Nothing => None,
    })
}
