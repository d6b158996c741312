//! What a particle takes the sightings of a scan for, where they have no names.
//!
//! A landmark may be a mixture, and the likelihood of a sighting is then the sum over its components; a ray is thereby
//! followed by its bearings as long as it is undecided. Sightings and landmarks are paired one to one, the likeliest
//! pairing of the scan together; pairs are then taken one by one, the least ambiguous first, each at the pose as those before have
//! refined it, and a pair that does not fit there is given up: that is the joint test. What is left is paired once more.

use super::past::Reading;
use super::place::{log_sum, Part, Place};
use super::sensing::{Calibration, Look, Request, Sensing};
use super::PartialSlam;
use crate::association::assign;
use crate::belief::{by_robot_pose, Belief};
use crate::config::Config;
use crate::density::{chi_squared, LN_TAU};
use crate::error::Result;
use crate::gaussian::Gaussian;
use crate::geometry::Pose;
use crate::math;
use crate::normal::{congruence, fit, sum, Cholesky, Matrix};

/// A cost that nobody pays.
const IMPOSSIBLE: f64 = 1e12;
/// The pairings of a scan: the first at the predicted pose, the second of what is left at the refined one.
const PAIRINGS: usize = 2;
/// Directions in which a landmark may be off by so many standard deviations are looked into.
const REACH: f64 = 3.0;

/// What a sighting is taken for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Taken {
    /// This landmark of the particle's map.
    Landmark(usize),
    /// A new one.
    New,
    /// Nothing: too near to a landmark to be a new one, and too far from it to be that.
    Nothing,
}

/// A scan as a particle explains it.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Choice {
    /// For every sighting.
    pub taken: Vec<Taken>,
    /// ln of the likelihood of what is taken for nothing that the map holds, or for a landmark at one place.
    pub log_likelihood: f64,
}

/// When a sighting is of a landmark, and when of a new one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Rules {
    /// Squared distances: a sighting nearer than the first is of a landmark at one place, one nearer than the second of no new one.
    gates: [f64; 2],
    /// ln of the density of new landmarks, in the units of a sighting.
    pub log_new_density: f64,
}

impl Rules {
    /// As [`crate::association::Rules`], for any number of numbers.
    pub fn of<const Z: usize>(config: &Config, noise: &Matrix<Z, Z>) -> Self {
        let settings = &config.association;
        let gates = [settings.gate_probability, settings.new_landmark_gate_probability].map(|p| chi_squared(Z, p));
        let twice = noise.map(|row| row.map(|v| 2.0 * v));
        let log_determinant = Cholesky::of(&twice).map_or(0.0, |factor| factor.log_determinant());
        let excess = config.sensor.tail().log_excess_of(Z, gates[1]);
        let usual = -0.5 * (gates[1] + log_determinant + Z as f64 * LN_TAU) + excess;
        Self { gates, log_new_density: settings.new_landmark_density.map_or(usual, math::ln) }
    }
}

/// A landmark as a particle expects to see it.
struct Expected<const Z: usize> {
    slot: usize,
    is_at_one_place: bool,
    /// Logarithm of the share of each component, how it is seen, and how far the particle may be wrong in that.
    parts: Vec<(f64, Look<Z>, Matrix<Z, Z>)>,
}

/// A sighting that may be of a landmark.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Pair {
    sighting: usize,
    slot: usize,
    /// How much likelier it is than the next best explanation, in nats.
    lead: f64,
}

impl<S: Sensing<Z>, const Z: usize> PartialSlam<S, Z> {
    /// What one particle takes a scan for, at the pose that it believes in, which landmarks at one place refine.
    ///
    /// **Errors:** those of a sensor of one's own.
    pub(super) fn choose(&self, particle: usize, belief: &mut Belief, scan: &[Reading<Z>]) -> Result<Choice> {
        let rules = Rules::of(&self.config, &self.sensor.noise());
        let mut choice = Choice { taken: vec![Taken::New; scan.len()], log_likelihood: 0.0 };
        let mut open: Vec<usize> = (0..scan.len()).collect();
        for pairing in 0..PAIRINGS {
            let expected = self.expected(particle, belief, (scan, &choice.taken))?;
            let costs = self.costs(&rules, &expected, (scan, &open));
            for pair in pairs(&costs, (&open, &expected), rules.log_new_density) {
                let place = &self.state.cloud.maps[particle][pair.slot];
                if let Place::One(_) = place {
                    let one = &scan[pair.sighting];
                    let Some(likelihood) = self.refine_one(particle, belief, (one, pair.slot), rules.gates[0])? else {
                        continue;
                    };
                    choice.log_likelihood += likelihood;
                }
                choice.taken[pair.sighting] = Taken::Landmark(pair.slot);
            }
            open.retain(|j| choice.taken[*j] == Taken::New);
            if pairing + 1 == PAIRINGS || open.is_empty() {
                self.end(&rules, (&open, scan), &expected, &mut choice);
                break;
            }
        }
        Ok(choice)
    }

    /// What no landmark explains is new, unless it is near to one that nothing else was taken for.
    fn end(
        &self,
        rules: &Rules,
        (open, scan): (&[usize], &[Reading<Z>]),
        expected: &[Expected<Z>],
        choice: &mut Choice,
    ) {
        for &j in open {
            let free = |landmark: &&Expected<Z>| !choice.taken.contains(&Taken::Landmark(landmark.slot));
            let near = |landmark: &Expected<Z>| {
                let Some((_, distance)) = self.likelihood(landmark, (&scan[0], &scan[j])) else { return false };
                landmark.is_at_one_place && distance < rules.gates[1]
            };
            if expected.iter().filter(free).any(near) {
                choice.taken[j] = Taken::Nothing;
            }
            choice.log_likelihood += rules.log_new_density;
        }
    }

    /// The landmarks that may be in view and were not seen yet, as they are expected from a pose.
    fn expected(
        &self,
        particle: usize,
        belief: &Belief,
        (scan, taken): (&[Reading<Z>], &[Taken]),
    ) -> Result<Vec<Expected<Z>>> {
        let map = self.state.cloud.maps[particle].iter().enumerate();
        let open = map.filter(|(slot, _)| !taken.contains(&Taken::Landmark(*slot)));
        let places = open.map(|(slot, place)| (slot, matches!(place, Place::One(_)), place.parts()));
        self.expected_of(places, (belief, &self.state.cloud.calibrations[particle]), scan)
    }

    /// Of these landmarks (slot, whether it is at one place, components) those that may be in view, as they are expected.
    fn expected_of(
        &self,
        places: impl Iterator<Item = (usize, bool, Vec<Part>)>,
        (belief, calibration): (&Belief, &Calibration),
        scan: &[Reading<Z>],
    ) -> Result<Vec<Expected<Z>>> {
        let Some(first) = scan.first() else { return Ok(Vec::new()) };
        let sensor = belief.mean.compose(self.T_robot_sensor);
        let (mut found, mut requests) = (Vec::new(), Vec::new());
        for (slot, is_at_one_place, mut parts) in places {
            parts.retain(|part| self.may_be_seen(sensor, part));
            requests.extend(parts.iter().map(|part| Request {
                T_world_sensor: sensor,
                landmark: part.gaussian.mean,
                measured: first.measured,
                calibration: *calibration,
            }));
            if !parts.is_empty() {
                found.push((slot, is_at_one_place, parts));
            }
        }
        let mut looks = self.sensor.look(&requests)?.into_iter();
        let expect = |(slot, is_at_one_place, parts): (usize, bool, Vec<Part>)| {
            let part = |part: Part, look: Look<Z>| {
                let by_pose = by_robot_pose(look.by_pose, belief.mean, sensor);
                let of_landmark = congruence(&look.by_landmark, &part.gaussian.normal().covariance);
                (part.log_share, look, sum(&of_landmark, &congruence(&by_pose, &belief.covariance)))
            };
            let parts = parts.into_iter().zip(looks.by_ref()).map(|(own, look)| part(own, look)).collect();
            Expected { slot, is_at_one_place, parts }
        };
        Ok(found.into_iter().map(expect).collect())
    }

    /// What a scan shows of landmarks at these places (by slot) from a pose that is known: a slot for each sighting, or none.
    ///
    /// **Errors:** those of a sensor of one's own.
    pub(super) fn shown(
        &self,
        places: &[(usize, Gaussian)],
        (pose, calibration): (Pose, &Calibration),
        scan: &[Reading<Z>],
    ) -> Result<Vec<Option<usize>>> {
        let rules = Rules::of(&self.config, &self.sensor.noise());
        let rules = Rules { gates: [rules.gates[1]; 2], ..rules };
        let one =
            |(slot, gaussian): &(usize, Gaussian)| (*slot, true, vec![Part { log_share: 0.0, gaussian: *gaussian }]);
        let belief = Belief { mean: pose, covariance: [[0.0; 3]; 3] };
        let expected = self.expected_of(places.iter().map(one), (&belief, calibration), scan)?;
        let open: Vec<usize> = (0..scan.len()).collect();
        let costs = self.costs(&rules, &expected, (scan, &open));
        let mut shown = vec![None; scan.len()];
        for pair in pairs(&costs, (&open, &expected), rules.log_new_density) {
            shown[pair.sighting] = Some(pair.slot);
        }
        Ok(shown)
    }

    /// Whether a component of a landmark may be in the sensor's view.
    fn may_be_seen(&self, sensor: Pose, part: &Part) -> bool {
        let limits = self.config.sensor.common();
        let [x, y] = sensor.inverse().transform(part.gaussian.mean);
        let (distance, off) = (x.hypot(y), REACH * part.gaussian.covariance.largest_eigenvalue().sqrt());
        let half = 0.5 * limits.field_of_view_rad;
        let aside = if off < distance { off / distance } else { std::f64::consts::PI };
        distance - off <= limits.max_range_m
            && distance + off >= limits.min_range_m
            && math::atan2(y, x).abs() <= half + aside
    }

    /// ln of the likelihood of a sighting of a landmark that was looked at for the first one of its scan, and the least
    /// squared distance.
    fn likelihood(&self, landmark: &Expected<Z>, (first, one): (&Reading<Z>, &Reading<Z>)) -> Option<(f64, f64)> {
        let (mut total, mut nearest) = (f64::NEG_INFINITY, f64::INFINITY);
        for (log_share, look, spread) in &landmark.parts {
            let innovation = self.again(look, (&first.measured, &one.measured));
            let fitted = fit(&innovation, &sum(spread, &one.noise.covariance), one.noise.tail)?;
            total = log_sum(total, log_share + fitted.log_likelihood);
            nearest = nearest.min(fitted.mahalanobis_squared);
        }
        total.is_finite().then_some((total, nearest))
    }

    /// The innovation of another sighting of what was looked at.
    fn again(&self, look: &Look<Z>, (first, other): (&[f64; Z], &[f64; Z])) -> [f64; Z] {
        let columns = self.sensor.columns();
        std::array::from_fn(|z| {
            let moved = look.innovation[z] + (other[z] - first[z]);
            if columns[z] == 1 {
                math::wrap_angle(moved)
            } else {
                moved
            }
        })
    }

    /// What it costs to take the open sightings for these landmarks, row by row.
    fn costs(&self, rules: &Rules, expected: &[Expected<Z>], (scan, open): (&[Reading<Z>], &[usize])) -> Vec<Vec<f64>> {
        let cost = |j: usize, landmark: &Expected<Z>| match self.likelihood(landmark, (&scan[0], &scan[j])) {
            Some((likelihood, distance)) => {
                let fits = !landmark.is_at_one_place || distance <= rules.gates[0];
                if fits && likelihood > rules.log_new_density {
                    -likelihood
                } else {
                    IMPOSSIBLE
                }
            }
            None => IMPOSSIBLE,
        };
        open.iter().map(|j| expected.iter().map(|landmark| cost(*j, landmark)).collect()).collect()
    }

    /// Refines a belief by a sighting of a landmark at one place; the likelihood, or `None` where it does not fit and nothing is
    /// changed.
    fn refine_one(
        &self,
        particle: usize,
        belief: &mut Belief,
        (one, slot): (&Reading<Z>, usize),
        gate: f64,
    ) -> Result<Option<f64>> {
        let Place::One(gaussian) = &self.state.cloud.maps[particle][slot] else { return Ok(None) };
        let request = Request {
            T_world_sensor: belief.mean.compose(self.T_robot_sensor),
            landmark: gaussian.mean,
            measured: one.measured,
            calibration: self.state.cloud.calibrations[particle],
        };
        let looks = self.sensor.look(&[request])?;
        let Some((refined, seen)) = looks
            .first()
            .and_then(|look| super::scan::refined(belief, look, (gaussian, &one.noise), self.T_robot_sensor))
        else {
            return Ok(None);
        };
        if seen.fit.mahalanobis_squared > gate {
            return Ok(None);
        }
        *belief = refined;
        Ok(Some(seen.fit.log_likelihood))
    }
}

/// The cheapest one-to-one pairing of rows and columns, in which a row may stay alone at the cost of what is new; the
/// least ambiguous pairs first.
fn pairs<const Z: usize>(
    costs: &[Vec<f64>],
    (open, expected): (&[usize], &[Expected<Z>]),
    log_new_density: f64,
) -> Vec<Pair> {
    let alone = -log_new_density;
    let possible =
        |row: &Vec<f64>| row.iter().enumerate().filter(|(_, c)| **c < alone).map(|(k, _)| k).collect::<Vec<_>>();
    let options: Vec<Vec<usize>> = costs.iter().map(possible).collect();
    let mut wanted = vec![0; expected.len()];
    options.iter().flatten().for_each(|k| wanted[*k] += 1);
    let is_plain = |row: &usize| options[*row].len() == 1 && wanted[options[*row][0]] == 1;
    let (plain, rest): (Vec<usize>, Vec<usize>) =
        (0..costs.len()).filter(|row| !options[*row].is_empty()).partition(is_plain);
    let mut chosen: Vec<(usize, usize)> = plain.into_iter().map(|row| (row, options[row][0])).collect();
    chosen.extend(assigned(costs, &options, &rest, alone));
    let pair = |(row, column): (usize, usize)| {
        let others = (0..expected.len()).filter(|k| *k != column).map(|k| costs[row][k]);
        let next = others.fold(alone, f64::min);
        Pair { sighting: open[row], slot: expected[column].slot, lead: next - costs[row][column] }
    };
    let mut pairs: Vec<Pair> = chosen.into_iter().map(pair).collect();
    pairs.sort_by(|a, b| b.lead.total_cmp(&a.lead).then(a.sighting.cmp(&b.sighting)));
    pairs
}

/// The cheapest assignment of some rows to the columns that they may have.
fn assigned(costs: &[Vec<f64>], options: &[Vec<usize>], rows: &[usize], alone: f64) -> Vec<(usize, usize)> {
    let mut columns: Vec<usize> = rows.iter().flat_map(|row| options[*row].iter().copied()).collect();
    columns.sort_unstable();
    columns.dedup();
    let width = columns.len() + rows.len();
    let mut table = vec![IMPOSSIBLE; rows.len() * width];
    for (r, row) in rows.iter().enumerate() {
        for (c, column) in columns.iter().enumerate() {
            table[r * width + c] = costs[*row][*column];
        }
        table[r * width + columns.len() + r] = alone;
    }
    let found = assign(&table, rows.len(), width);
    rows.iter().zip(found).filter_map(|(row, c)| columns.get(c).map(|column| (*row, *column))).collect()
}

#[cfg(test)]
mod tests {
    use super::super::past::Noise;
    use super::*;
    use crate::density::Tail;
    use crate::measurement::{SensorModel, SensorSettings};

    fn expected(slots: &[usize]) -> Vec<Expected<1>> {
        slots.iter().map(|slot| Expected { slot: *slot, is_at_one_place: true, parts: Vec::new() }).collect()
    }

    #[test]
    fn the_scan_is_paired_as_a_whole_and_the_least_ambiguous_pair_comes_first() {
        // The second sighting is a little nearer to the landmark that the first one needs.
        let costs = vec![vec![1.0, 9.0, IMPOSSIBLE], vec![0.5, 1.5, IMPOSSIBLE], vec![IMPOSSIBLE, IMPOSSIBLE, 2.0]];
        let pairs = pairs(&costs, (&[4, 5, 6], &expected(&[10, 11, 12])), -20.0);
        let found: Vec<_> = pairs.iter().map(|pair| (pair.sighting, pair.slot, pair.lead)).collect();
        assert_eq!(found, [(6, 12, 18.0), (4, 10, 8.0), (5, 11, -1.0)]);
    }

    #[test]
    fn what_is_no_likelier_than_a_new_landmark_stays_alone() {
        let costs = vec![vec![7.0], vec![IMPOSSIBLE]];
        assert!(pairs(&costs, (&[0, 1], &expected(&[3])), -5.0).is_empty());
    }

    #[test]
    fn a_sighting_is_of_a_landmark_within_the_gate_new_beyond_the_outer_one_and_nothing_between() {
        let sensor = SensorSettings { model: SensorModel::Bearing, bearing_std_rad: 0.01, ..Default::default() };
        let config = Config { sensor: sensor.into(), ..Config::default() };
        let filter = PartialSlam::bearing_only_unnamed(config).unwrap();
        let at = Gaussian { mean: [5.0, 0.0], covariance: crate::geometry::Symmetric2::new(1e-9, 0.0, 1e-9) };
        let reading =
            |bearing: f64| Reading { measured: [bearing], noise: Noise { covariance: [[1e-4]], tail: Tail::Gaussian } };
        let shown = |bearing: f64| {
            filter.shown(&[(7, at)], (Pose::default(), &Calibration::NONE), &[reading(bearing)]).unwrap()
        };
        assert_eq!(shown(0.04), [Some(7)]);
        assert_eq!(shown(0.06), [None]);
        let mut filter = filter;
        filter.state.cloud.maps[0].push(Place::One(at));
        let taken = |bearing: f64| {
            let mut belief = Belief { mean: Pose::default(), covariance: [[0.0; 3]; 3] };
            filter.choose(0, &mut belief, &[reading(bearing)]).unwrap().taken[0]
        };
        assert_eq!([taken(0.02), taken(0.035), taken(0.06)], [Taken::Landmark(0), Taken::Nothing, Taken::New]);
    }
}
