//! The decision of one particle about one scan.

use super::joint::{joint_gates, MOST_JOINT};
use super::settings::{Appearance, Method};
use crate::config::{AssociationOrder, Config, Exclusion};
use crate::geometry::{Matrix3, Pose, Symmetric2};
use crate::landmark::{column, fit_with_tail, innovation_covariance, Fit, Gaussian, Measured, Tail, LN_TAU};
use crate::math;
use crate::measurement::MeasurementModel;
use crate::store::Rows;
use rustc_hash::FxHashMap;

/// What a particle decides about a sighting.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Decision {
    /// It shows this landmark (an index into the candidate table).
    Landmark(u32),
    /// It shows a landmark that the map lacks.
    New,
    /// It shows nothing that the map should know.
    Ignored,
}

impl Decision {
    /// The candidate, or a number that is none.
    pub fn number(&self) -> u32 {
        match self {
            Self::Landmark(candidate) => *candidate,
            Self::New => u32::MAX,
            Self::Ignored => u32::MAX - 1,
        }
    }
}

/// What a particle believes about the robot's pose while it looks at a scan.
///
/// In FastSLAM 1.0 the pose is a sample and the covariance zero; in 2.0 it is the proposal, refined sighting by
/// sighting.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Belief {
    /// Mean of `T_world_robot`.
    pub mean: Pose,
    /// Covariance of (x, y, heading) in the world's axes.
    pub covariance: Matrix3,
}

/// A sighting with what the scan knows about it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScanSighting {
    /// Value and noise.
    pub measured: Measured,
    /// Identity, where somebody says it.
    pub identity: Option<u32>,
    /// What it looks like, where the detector says so.
    pub appearance: Appearance,
}

/// Landmarks that some particle might have seen in a scan, with their rows.
#[derive(Clone, Debug, Default)]
pub struct CandidateTable {
    /// Slot of each candidate, in the order of birth.
    pub slots: Vec<u32>,
    /// Candidates of each sighting: indices into `slots`, ascending.
    pub of_sighting: Vec<Vec<u32>>,
    /// Rows of candidate c: `columns` columns of `particles` numbers each.
    pub values: Vec<f64>,
    /// Particles.
    pub particles: usize,
    /// Columns per candidate.
    pub columns: usize,
    /// Which candidate a slot is.
    index: FxHashMap<u32, u32>,
    /// Lists of candidates of longer scans; kept for their memory.
    spare: Vec<Vec<u32>>,
}

impl CandidateTable {
    /// Empties the table, for so many sightings.
    pub fn clear(&mut self, sightings: usize) {
        self.slots.clear();
        self.values.clear();
        while self.of_sighting.len() > sightings {
            self.spare.extend(self.of_sighting.pop());
        }
        while self.of_sighting.len() < sightings {
            self.of_sighting.push(self.spare.pop().unwrap_or_default());
        }
        self.of_sighting.iter_mut().for_each(Vec::clear);
    }

    /// Turns the slots that [`Self::of_sighting`] names into candidates; those that are none disappear.
    pub fn number_candidates(&mut self) {
        let Self { slots, of_sighting, index, .. } = self;
        index.clear();
        index.extend(slots.iter().copied().zip(0..));
        for found in of_sighting {
            found.retain_mut(|slot| match index.get(slot) {
                Some(candidate) => {
                    *slot = *candidate;
                    true
                }
                None => false,
            });
            found.sort_unstable();
            found.dedup();
        }
    }

    #[inline(always)]
    fn value(&self, candidate: u32, column: usize, particle: usize) -> f64 {
        self.values[(candidate as usize * self.columns + column) * self.particles + particle]
    }

    /// The rows of a candidate.
    pub fn rows(&self, candidate: u32) -> Rows<'_> {
        let size = self.columns * self.particles;
        Rows::new(&self.values[candidate as usize * size..][..size], self.particles)
    }

    /// Whether one particle's map has the landmark.
    #[inline(always)]
    fn holds(&self, candidate: u32, particle: usize) -> bool {
        self.value(candidate, column::SIGHTINGS, particle) != 0.0
    }

    /// The landmark in one particle's map, if it is there.
    #[inline(always)]
    pub fn gaussian(&self, candidate: u32, particle: usize) -> Option<Gaussian> {
        if !self.holds(candidate, particle) {
            return None;
        }
        let size = self.columns * self.particles;
        let values = &self.values[candidate as usize * size..][..size];
        let at = |column: usize| values[column * self.particles + particle];
        Some(Gaussian {
            mean: [at(column::MEAN_X), at(column::MEAN_Y)],
            covariance: Symmetric2::new(at(column::COV_XX), at(column::COV_XY), at(column::COV_YY)),
        })
    }

    /// Identity that the landmark was seen with in one particle's map, plus one; 0 for none.
    fn identity_mark(&self, candidate: u32, particle: usize) -> f64 {
        if self.columns > column::IDENTITY {
            self.value(candidate, column::IDENTITY, particle)
        } else {
            0.0
        }
    }
}

/// How well every candidate of every sighting fits in every map, with the beliefs before the scan.
///
/// **Why:** worked out for all particles in passes of vector code, before the particles decide one by one.
#[derive(Clone, Debug, Default)]
pub struct FitTable {
    /// Per sighting, the first of its pairs with a candidate.
    first_pair: Vec<usize>,
    /// Log-likelihoods, then squared Mahalanobis distances, of all particles; per pair.
    values: Vec<f64>,
    /// What else speaks for each pair, as a logarithm and apart from the place: one number per particle and pair, or
    /// none at all.
    evidence: Vec<f64>,
    particles: usize,
}

impl FitTable {
    /// Lays out the pairs of the table and lets `fill` write each: the sighting, the candidate, and the columns of
    /// log-likelihoods and squared distances. Where a map lacks the candidate, what is written does not count.
    pub fn fill(&mut self, table: &CandidateTable, mut fill: impl FnMut(usize, u32, &mut [f64], &mut [f64])) {
        self.particles = table.particles;
        self.first_pair.clear();
        let mut pairs = 0;
        for candidates in &table.of_sighting {
            self.first_pair.push(pairs);
            pairs += candidates.len();
        }
        self.values.resize(2 * self.particles * pairs, 0.0);
        self.evidence.clear();
        let mut columns = self.values.chunks_exact_mut(2 * self.particles.max(1));
        for (j, candidates) in table.of_sighting.iter().enumerate() {
            for (candidate, columns) in candidates.iter().zip(&mut columns) {
                let (log_likelihood, mahalanobis_squared) = columns.split_at_mut(self.particles);
                fill(j, *candidate, log_likelihood, mahalanobis_squared);
            }
        }
    }

    /// Adds to every pair what speaks for it apart from the place: `add` gets the sighting, the candidate, and a column
    /// of zeros to add logarithms to.
    pub fn add_evidence(&mut self, table: &CandidateTable, mut add: impl FnMut(usize, u32, &mut [f64])) {
        let n = self.particles;
        self.evidence.resize(self.values.len() / 2, 0.0);
        let pairs = table.of_sighting.iter().enumerate().flat_map(|(j, c)| c.iter().map(move |c| (j, *c)));
        for (pair, (j, candidate)) in pairs.enumerate() {
            let evidence = &mut self.evidence[pair * n..][..n];
            add(j, candidate, evidence);
            let log_likelihood = &mut self.values[2 * pair * n..][..n];
            log_likelihood.iter_mut().zip(evidence).for_each(|(value, more)| *value += *more);
        }
    }

    /// What else speaks for a pair.
    #[inline(always)]
    fn evidence(&self, sighting: usize, place: usize, particle: usize) -> f64 {
        if self.evidence.is_empty() {
            return 0.0;
        }
        self.evidence[self.particles * (self.first_pair[sighting] + place) + particle]
    }

    /// The fit of the candidate that stands at `place` among those of a sighting.
    #[inline(always)]
    fn get(&self, sighting: usize, place: usize, particle: usize) -> Fit {
        let at = 2 * self.particles * (self.first_pair[sighting] + place) + particle;
        Fit { log_likelihood: self.values[at], mahalanobis_squared: self.values[at + self.particles] }
    }
}

/// What deciding about a scan needs to remember; kept from particle to particle.
#[derive(Clone, Debug, Default)]
pub struct Scratch {
    pub(super) used: Vec<u32>,
    pub(super) order: Vec<usize>,
    pub(super) margins: Vec<f64>,
    pub(super) weights: Vec<f64>,
}

/// The rules of association with their thresholds worked out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rules {
    /// How one explanation is chosen.
    pub method: Method,
    /// A sighting belongs to its likeliest landmark when the squared Mahalanobis distance is at most this.
    pub gate: f64,
    /// ln of the density below which a sighting is a new landmark: that of new landmarks and clutter together.
    pub log_new_density: f64,
    /// The log-odds that a new landmark exists, where clutter is modelled.
    pub initial_log_odds: Option<f64>,
    /// ln of the most by which anything but the place can raise a likelihood.
    pub log_most_evidence: f64,
    /// The squared joint distance at which so many pairs together are still accepted.
    pub joint_gates: [f64; MOST_JOINT + 1],
    /// What one landmark may explain.
    pub exclusion: Exclusion,
    /// Order of the decisions.
    pub order: AssociationOrder,
    /// Power of the likelihood in the weight.
    pub likelihood_exponent: f64,
}

impl Rules {
    /// The configured rules for a sensor.
    pub fn new<M: MeasurementModel>(config: &Config, model: &M) -> Self {
        let association = &config.association;
        let gate = |probability: f64| -2.0 * math::ln(1.0 - probability);
        let twice = model.noise_covariance().scaled(2.0);
        let log_new_density = association.new_landmark_density.map_or_else(
            || {
                let outer = gate(association.new_landmark_gate_probability);
                let excess = config.sensor.tail().log_excess(outer);
                -0.5 * (outer + math::ln(twice.determinant())) - LN_TAU + excess
            },
            math::ln,
        );
        let density = math::exp(log_new_density);
        Self {
            method: association.method,
            gate: gate(association.gate_probability),
            log_new_density: association.clutter_density.map_or(log_new_density, |clutter| math::ln(density + clutter)),
            initial_log_odds: association.clutter_density.map(|clutter| math::ln(density / clutter)),
            log_most_evidence: association.log_most_evidence(),
            joint_gates: joint_gates(association.gate_probability),
            exclusion: association.exclusion,
            order: association.order,
            likelihood_exponent: config.filter.likelihood_exponent,
        }
    }

    /// How many standard deviations a landmark can lie off and still be likelier than a new one: its likelihood is at
    /// most that with the sensor's noise alone.
    pub fn gate_radius<M: MeasurementModel>(&self, model: &M, tail: Tail) -> f64 {
        let peak = -0.5 * math::ln(model.noise_covariance().determinant()) - LN_TAU;
        tail.reach(peak + self.log_most_evidence - self.log_new_density)
    }
}

/// A landmark as a particle sees it: innovation, how it depends on the pose, and how uncertain it is.
pub(super) struct View {
    innovation: [f64; 2],
    by_pose: [[f64; 3]; 2],
    q: Symmetric2,
    noise: Symmetric2,
    tail: Tail,
}

impl View {
    /// How likely the sighting is when the pose is known.
    #[inline(always)]
    pub(super) fn judge(&self) -> Fit {
        fit_with_tail(self.innovation, self.q, self.tail)
    }
}

/// G_s for the robot's pose: the sensor turns about the robot, so its lever arm enters.
#[inline(always)]
pub(crate) fn by_robot_pose(by_sensor: [[f64; 3]; 2], T_world_robot: Pose, T_world_sensor: Pose) -> [[f64; 3]; 2] {
    let (ax, ay) = (T_world_sensor.x - T_world_robot.x, T_world_sensor.y - T_world_robot.y);
    let [[x0, y0, h0], [x1, y1, h1]] = by_sensor;
    [[x0, y0, h0 - ay * x0 + ax * y0], [x1, y1, h1 - ay * x1 + ax * y1]]
}

impl Belief {
    /// A landmark as this belief, which has the sensor there, sees it.
    #[inline(always)]
    pub(super) fn view<M: MeasurementModel>(
        &self,
        model: &M,
        sensor: Pose,
        landmark: &Gaussian,
        measured: &Measured,
    ) -> View {
        let linear = model.linearize(sensor, landmark.mean);
        View {
            innovation: model.innovation(measured.value, linear.expected),
            by_pose: by_robot_pose(linear.by_pose, self.mean, sensor),
            q: innovation_covariance(linear.by_landmark, landmark.covariance, measured.noise),
            noise: measured.noise,
            tail: measured.tail,
        }
    }

    /// P G_sᵀ, one row per component of the pose.
    #[inline(always)]
    fn cross(&self, by_pose: &[[f64; 3]; 2]) -> [[f64; 2]; 3] {
        let [row0, row1, row2] = &self.covariance;
        let [g0, g1] = by_pose;
        [[dot3(row0, g0), dot3(row0, g1)], [dot3(row1, g0), dot3(row1, g1)], [dot3(row2, g0), dot3(row2, g1)]]
    }

    /// L = G_s P G_sᵀ + Q.
    #[inline(always)]
    fn total_covariance(cross: &[[f64; 2]; 3], view: &View) -> Symmetric2 {
        let [g0, g1] = &view.by_pose;
        let [[a0, b0], [a1, b1], [a2, b2]] = *cross;
        let (first, second) = ([a0, a1, a2], [b0, b1, b2]);
        Symmetric2::new(dot3(g0, &first) + view.q.xx, dot3(g0, &second) + view.q.xy, dot3(g1, &second) + view.q.yy)
    }

    /// How likely the sighting is under this belief, with the pose's uncertainty.
    #[inline(always)]
    pub(super) fn judge(&self, view: &View) -> Fit {
        let cross = self.cross(&view.by_pose);
        fit_with_tail(view.innovation, Self::total_covariance(&cross, view), view.tail)
    }

    /// How well a sighting of a landmark fits.
    #[inline(always)]
    pub fn fit<M: MeasurementModel>(
        &self,
        model: &M,
        T_robot_sensor: Pose,
        landmark: &Gaussian,
        measured: &Measured,
    ) -> Fit {
        self.judge(&self.view(model, self.mean.compose(T_robot_sensor), landmark, measured))
    }

    /// The belief after a sighting of a landmark, and how well it fitted.
    ///
    /// **Source:** `montemerlo2003fastslam`, eqs. 9–15, in gain form, which holds for a singular P: K = P G_sᵀ L⁻¹,
    /// μ ← μ + K ν, P ← P − K L Kᵀ.
    #[inline(always)]
    pub(super) fn refined(&self, view: &View) -> (Self, Fit) {
        let cross = self.cross(&view.by_pose);
        let plain = Self::total_covariance(&cross, view);
        let fitted = fit_with_tail(view.innovation, plain, view.tail);
        let more = view.noise.scaled(view.tail.noise_scale(fitted.mahalanobis_squared) - 1.0);
        let l = Symmetric2::new(plain.xx + more.xx, plain.xy + more.xy, plain.yy + more.yy);
        let inverse = 1.0 / l.determinant();
        let [c0, c1, c2] = cross;
        let row = |[a, b]: [f64; 2]| [(a * l.yy - b * l.xy) * inverse, (b * l.xx - a * l.xy) * inverse];
        let (k0, k1, k2) = (row(c0), row(c1), row(c2));
        // K Lᵀ Kᵀ is K crossᵀ; the mean of both halves keeps it symmetric to the bit.
        let less = |a: [f64; 2], b: [f64; 2], ca: [f64; 2], cb: [f64; 2]| 0.5 * (dot2(a, cb) + dot2(b, ca));
        let [[xx, xy, xh], [_, yy, yh], [_, _, hh]] = self.covariance;
        let (xx, xy, xh) = (xx - dot2(k0, c0), xy - less(k0, k1, c0, c1), xh - less(k0, k2, c0, c2));
        let (yy, yh, hh) = (yy - dot2(k1, c1), yh - less(k1, k2, c1, c2), hh - dot2(k2, c2));
        let covariance = [[xx, xy, xh], [xy, yy, yh], [xh, yh, hh]];
        let mean = Pose::new(
            self.mean.x + dot2(k0, view.innovation),
            self.mean.y + dot2(k1, view.innovation),
            crate::math::wrap_angle(self.mean.heading + dot2(k2, view.innovation)),
        );
        (Self { mean, covariance }, fitted)
    }

    /// Refines by a sighting of a known landmark and gives the log-likelihood of the sighting.
    #[inline(always)]
    pub fn refine<M: MeasurementModel>(
        &mut self,
        model: &M,
        T_robot_sensor: Pose,
        landmark: &Gaussian,
        measured: &Measured,
    ) -> Fit {
        let view = self.view(model, self.mean.compose(T_robot_sensor), landmark, measured);
        let (refined, fit) = self.refined(&view);
        *self = refined;
        fit
    }
}

#[inline(always)]
fn dot3(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[inline(always)]
fn dot2(a: [f64; 2], b: [f64; 2]) -> f64 {
    a[0] * b[0] + a[1] * b[1]
}

/// The best explanation of a sighting that is still undecided.
#[derive(Clone, Copy)]
pub(super) struct Choice {
    pub(super) best: Option<(u32, Fit)>,
    /// By how much (in log-likelihood) it is better than the next explanation.
    pub(super) margin: f64,
    /// Somebody says so: believed wherever the landmark lies.
    pub(super) certain: bool,
}

impl Choice {
    /// What maximum likelihood makes of it, with the log-likelihood of that.
    pub(super) fn decision(&self, rules: &Rules) -> (Decision, f64) {
        match self.best {
            Some((candidate, fit)) if self.certain => (Decision::Landmark(candidate), fit.log_likelihood),
            Some((candidate, fit)) if fit.log_likelihood >= rules.log_new_density => {
                if fit.mahalanobis_squared <= rules.gate {
                    (Decision::Landmark(candidate), fit.log_likelihood)
                } else {
                    (Decision::Ignored, rules.log_new_density)
                }
            }
            _ => (Decision::New, rules.log_new_density),
        }
    }
}

/// One map with a belief about the pose, as the rules of association see it.
pub trait Hypothesis {
    /// Whether the pose is known, so that no sighting can refine it.
    fn pose_is_certain(&self) -> bool;
    /// How well a sighting fits a candidate; `None` where the map lacks it. `pair` is the number of the sighting and the
    /// place of the candidate among those of the sighting.
    fn fit(&self, pair: [usize; 2], candidate: u32, measured: &Measured) -> Option<Fit>;
    /// Identity that a candidate was seen with, plus one; 0 for none.
    fn identity_mark(&self, candidate: u32) -> f64;
    /// Takes a sighting for one of a candidate: the belief is refined by it.
    fn accept(&mut self, candidate: u32, sighting: &ScanSighting);
}

/// A particle and the candidates in its map.
pub struct ParticleHypothesis<'a, M> {
    /// How the sensor measures.
    pub model: &'a M,
    /// Where the sensor is on the robot.
    pub T_robot_sensor: Pose,
    /// What may have been sighted.
    pub table: &'a CandidateTable,
    /// How well it fits, with the belief before the scan.
    pub fits: &'a FitTable,
    /// Which particle.
    pub particle: usize,
    /// What it believes before the scan.
    pub belief: Belief,
    /// What it believes once a sighting refined that, with the pose of the sensor.
    pub refined: Option<(Belief, Pose)>,
}

// Derived, it would ask the model for the same.
impl<M> Clone for ParticleHypothesis<'_, M> {
    fn clone(&self) -> Self {
        Self { ..*self }
    }
}

impl<M: MeasurementModel> Hypothesis for ParticleHypothesis<'_, M> {
    fn pose_is_certain(&self) -> bool {
        self.belief.covariance == [[0.0; 3]; 3]
    }

    #[inline(always)]
    fn fit(&self, [sighting, place]: [usize; 2], candidate: u32, measured: &Measured) -> Option<Fit> {
        match &self.refined {
            None => self.table.holds(candidate, self.particle).then(|| self.fits.get(sighting, place, self.particle)),
            Some((belief, T_world_sensor)) => {
                let landmark = self.table.gaussian(candidate, self.particle)?;
                let mut fit = belief.judge(&belief.view(self.model, *T_world_sensor, &landmark, measured));
                fit.log_likelihood += self.fits.evidence(sighting, place, self.particle);
                Some(fit)
            }
        }
    }

    #[inline(always)]
    fn identity_mark(&self, candidate: u32) -> f64 {
        self.table.identity_mark(candidate, self.particle)
    }

    fn accept(&mut self, candidate: u32, sighting: &ScanSighting) {
        if self.pose_is_certain() {
            return;
        }
        if let Some(landmark) = self.table.gaussian(candidate, self.particle) {
            let mut belief = self.refined.map_or(self.belief, |(belief, _)| belief);
            belief.refine(self.model, self.T_robot_sensor, &landmark, &sighting.measured);
            self.refined = Some((belief, belief.mean.compose(self.T_robot_sensor)));
        }
    }
}

/// Decides about every sighting of a scan for one hypothesis and returns its log-likelihood, tempered.
///
/// **Source:** `montemerlo2002fastslam`, eqs. 14 and 15: the likeliest landmark, or a new one when even that is less
/// likely than the threshold.
pub fn decide<H: Hypothesis>(
    rules: &Rules,
    scan: &[ScanSighting],
    of_sighting: &[Vec<u32>],
    hypothesis: &mut H,
    scratch: &mut Scratch,
    decisions: &mut [Decision],
) -> f64 {
    let mut log_weight = 0.0;
    order_decisions(rules, scan, of_sighting, hypothesis, scratch);
    let Scratch { used, order, .. } = scratch;
    used.clear();
    for &mut index in order {
        let choice = best_choice(rules, (index, &scan[index]), &of_sighting[index], hypothesis, used);
        let (decision, log_density) = choice.decision(rules);
        if let Decision::Landmark(candidate) = decision {
            hypothesis.accept(candidate, &scan[index]);
            if rules.exclusion == Exclusion::OneSighting {
                used.push(candidate);
            }
        }
        decisions[index] = decision;
        log_weight += rules.likelihood_exponent * log_density;
    }
    log_weight
}

/// The order in which one hypothesis decides about the sightings: those with an identity first, then the rest as they
/// come or the least ambiguous first.
///
/// **Why:** a sure sighting refines the pose, and the smaller uncertainty then decides the doubtful ones. The order is
/// that of the belief before the scan; judging it anew after every decision costs the square of the sightings and gains
/// nothing that the logs show.
pub(super) fn order_decisions<H: Hypothesis>(
    rules: &Rules,
    scan: &[ScanSighting],
    of_sighting: &[Vec<u32>],
    hypothesis: &H,
    scratch: &mut Scratch,
) {
    let Scratch { order, margins, .. } = scratch;
    order.clear();
    order.extend(0..scan.len());
    if rules.order == AssociationOrder::LeastAmbiguousFirst && !hypothesis.pose_is_certain() {
        let margin = |j: &usize| best_choice(rules, (*j, &scan[*j]), &of_sighting[*j], hypothesis, &[]).margin;
        margins.clear();
        margins.extend(order.iter().map(margin));
        order.sort_by(|a, b| margins[*b].total_cmp(&margins[*a]));
    }
    if scan.iter().any(|sighting| sighting.identity.is_some()) {
        order.sort_by_key(|j| scan[*j].identity.is_none());
    }
}

/// The likeliest landmark of a sighting under one hypothesis. Ties go to the older landmark.
pub(super) fn best_choice<H: Hypothesis>(
    rules: &Rules,
    (index, sighting): (usize, &ScanSighting),
    candidates: &[u32],
    hypothesis: &H,
    used: &[u32],
) -> Choice {
    let wanted = sighting.identity.map(|identity| f64::from(identity) + 1.0);
    let mut best: Option<(u32, Fit)> = None;
    let mut second = rules.log_new_density;
    for (place, &candidate) in candidates.iter().enumerate() {
        if used.contains(&candidate) {
            continue;
        }
        let Some(fit) = hypothesis.fit([index, place], candidate, &sighting.measured) else { continue };
        if let Some(wanted) = wanted {
            let mark = hypothesis.identity_mark(candidate);
            if mark == wanted {
                return Choice { best: Some((candidate, fit)), margin: f64::INFINITY, certain: true };
            }
            if mark != 0.0 {
                continue;
            }
        }
        match best {
            Some((_, leader)) if fit.log_likelihood <= leader.log_likelihood => {
                second = second.max(fit.log_likelihood);
            }
            leader => {
                second = leader.map_or(second, |(_, l)| second.max(l.log_likelihood));
                best = Some((candidate, fit));
            }
        }
    }
    let margin = match best {
        Some((_, fit)) if fit.log_likelihood >= rules.log_new_density => fit.log_likelihood - second,
        Some((_, fit)) => rules.log_new_density - fit.log_likelihood - 1e6,
        None => -1e3,
    };
    Choice { best, margin, certain: false }
}
