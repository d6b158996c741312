//! Two landmarks of one thing that stand side by side: what the sensor cannot tell apart and never shows together.
//!
//! A wild sighting founds a landmark a few standard deviations from the one that it shows. By the joint covariance of two
//! landmarks that were sighted for long they are two, since that knows nothing of wild sightings; by what the scans show
//! they are one: who sees one of two that stand so near sees the other as well, as often as neighbours further away.

use super::closing::{seen_together, Closing, RARE};
use super::differences::GATE;
use super::graph::{Graph, Mode};
use super::history::Seen;
use super::second_thoughts::Related;
use crate::diagnosis::looks::is_another_look;
use crate::math;
use crate::measurement::Placing;

/// Neighbours that say how often two landmarks are sighted together.
const NEIGHBOURS: usize = 3;
/// Sightings of a landmark, at least, that say something of that.
const FEWEST: usize = 10;

/// Two landmarks by birth, older first, and ln of how much likelier the scans are if they are one.
struct Twins {
    births: [u32; 2],
    log_odds: f64,
}

impl<M: Placing> Graph<'_, M> {
    /// Makes twins one where what the scans show outweighs that the problem fits worse; returns the mode with them, and
    /// the births of which landmark went over into which (younger, older).
    pub fn join_twins(&mut self, mut mode: Mode, closing: &Closing<'_>, related: &Related) -> (Mode, Vec<[u32; 2]>) {
        let mut merges = Vec::new();
        let pairs = self.related_pairs(&mode, related);
        let mut twins: Vec<Twins> = pairs.into_iter().filter_map(|pair| self.as_twins(pair, &mode, closing)).collect();
        twins.sort_by(|a, b| b.log_odds.total_cmp(&a.log_odds));
        for Twins { births, log_odds } in twins {
            let place = |birth: u32| self.landmarks.iter().position(|sights| sights.birth == birth);
            let [Some(older), Some(younger)] = births.map(place) else { continue };
            let Some((landmarks, joined)) = self.joined(&[[older, younger]], &mode) else { continue };
            if joined.cost - mode.cost + closing.log_odds <= log_odds {
                (self.landmarks, mode) = (landmarks, joined);
                merges.push([births[1], births[0]]);
            }
        }
        (mode, merges)
    }

    /// The pair, where nothing speaks against it but the scans for it.
    fn as_twins(&self, [older, younger]: [usize; 2], mode: &Mode, closing: &Closing<'_>) -> Option<Twins> {
        let [old, young] = [older, younger].map(|k| &self.landmarks[k]);
        let births = [old.birth, young.birth];
        let looks = (closing.evidence)(births)?;
        let together = seen_together(&old.seen, &young.seen) as f64;
        if RARE * together > old.seen.len().min(young.seen.len()) as f64 {
            return None;
        }
        let [few, many] = if old.seen.len() < young.seen.len() { [older, younger] } else { [younger, older] };
        if !self.is_taken_for(few, many, mode) {
            return None;
        }
        let shown = self.shown_together(&[many, few], &self.landmarks[many].seen, mode)?;
        let scans = old.seen.iter().chain(&young.seen);
        let log_odds = looks - self.looks(scans, mode) * math::ln(1.0 - shown);
        (log_odds > closing.log_odds).then_some(Twins { births, log_odds })
    }

    /// Whether most sightings of a landmark would be taken for another one.
    fn is_taken_for(&self, landmark: usize, other: usize, mode: &Mode) -> bool {
        let at = (mode.solution.landmarks[other], &self.landmarks[other].known);
        let seen = &self.landmarks[landmark].seen;
        let near = seen.iter().filter(|seen| self.view(&mode.solution.trajectory, at, seen).distance <= GATE);
        2 * near.count() > seen.len()
    }

    /// In what part of these scans, of which each shows all of a `group`, neighbours of its first landmark are sighted
    /// too; `None` where nothing says it.
    pub(super) fn shown_together(&self, group: &[usize], scans: &[Seen], mode: &Mode) -> Option<f64> {
        let (places, landmark) = (&mode.solution.landmarks, *group.first()?);
        let squared =
            |k: usize| [0, 1].map(|axis| (places[k][axis] - places[landmark][axis]).powi(2)).iter().sum::<f64>();
        let mut others: Vec<usize> =
            (0..places.len()).filter(|k| !group.contains(k) && self.landmarks[*k].seen.len() >= FEWEST).collect();
        others.sort_by(|a, b| squared(*a).total_cmp(&squared(*b)));
        others.truncate(NEIGHBOURS);
        let share = |k: &usize| seen_together(scans, &self.landmarks[*k].seen) as f64 / scans.len() as f64;
        let sum: f64 = others.iter().map(share).sum();
        (!others.is_empty()).then(|| (sum / others.len() as f64).min(0.95))
    }

    /// Looks among these scans: those after which the robot has moved on.
    pub(super) fn looks<'a>(&self, scans: impl Iterator<Item = &'a Seen> + Clone, mode: &Mode) -> f64 {
        let mut steps: Vec<u32> = scans.clone().map(|one| one.step).collect();
        steps.sort_unstable();
        let range_m = |one: &Seen| self.model(one.step as usize).range(self.history.sighting(one.sighting).value);
        let far_m = scans.map(range_m).fold(0.0, f64::max);
        let (mut last, mut looks) = (None, 0.0);
        for step in steps {
            let pose = mode.solution.trajectory.poses[step as usize];
            if last.is_none_or(|last| is_another_look(last, pose, far_m)) {
                (last, looks) = (Some(pose), looks + 1.0);
            }
        }
        looks
    }
}
