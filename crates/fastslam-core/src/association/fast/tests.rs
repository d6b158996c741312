//! The block against the particles one by one.

use super::*;
use crate::association::{decide, decide_sampled, Appearance, Belief, Candidates};
use crate::association::{FitTable, ParticleHypothesis, Sampler, Scratch};
use crate::config::Config;
use crate::measurement::RangeBearing;
use crate::random::{Purpose, RandomSource, Stream};

const MODEL: RangeBearing = RangeBearing { range_std_m: 0.3, bearing_std_rad: 0.05 };
const MOUNTING: Pose = Pose { x: 0.4, y: -0.1, heading: 0.2 };

/// Uniform numbers one after the other.
struct Draws(Stream, u32);

impl Draws {
    fn next(&mut self) -> f64 {
        self.1 += 1;
        self.0.uniform(0, self.1)
    }

    fn below(&mut self, count: usize) -> usize {
        (self.next() * count as f64) as usize
    }

    fn chance(&mut self, probability: f64) -> bool {
        self.next() < probability
    }
}

/// Landmarks about 6 m ahead, so close to one another that sightings are doubtful; some are missing in some maps, some
/// are twins, and a few are no numbers at all.
fn random_table(draws: &mut Draws, particles: usize, sightings: usize) -> CandidateTable {
    let landmarks = draws.below(9);
    let mut table = CandidateTable::default();
    (table.particles, table.columns) = (particles, column::COUNT);
    table.clear(sightings);
    for slot in 0..landmarks {
        table.slots.push(slot as u32);
        if slot > 0 && draws.chance(0.2) {
            table.values.extend_from_within(table.values.len() - column::COUNT * particles..);
            continue;
        }
        let [x, y] = [5.0 + 2.0 * draws.next(), 2.0 * draws.next() - 1.0];
        let mut columns = vec![0.0; column::COUNT * particles];
        for i in (0..particles).filter(|_| !draws.chance(0.2)).collect::<Vec<_>>() {
            let broken = if draws.chance(0.02) { f64::NAN } else { 0.0 };
            let (u, v) = (0.3 * draws.next(), 0.3 * draws.next());
            let row = [1.0, x + u + broken, y + v, 0.02 + u * u, 0.5 * u * v, 0.03 + v * v];
            row.iter().enumerate().for_each(|(c, value)| columns[c * particles + i] = *value);
        }
        table.values.extend(columns);
    }
    for found in &mut table.of_sighting {
        found.extend((0..landmarks as u32).filter(|_| draws.chance(0.6)));
    }
    table
}

fn random_scan(draws: &mut Draws, sightings: usize, tail: Tail) -> Vec<ScanSighting> {
    let own_noise = draws.chance(0.5);
    (0..sightings)
        .map(|_| {
            let scale = if own_noise { 0.2 + 4.0 * draws.next() } else { 1.0 };
            let noise = MODEL.noise_covariance().scaled(scale);
            let value = [5.0 + 2.0 * draws.next(), 0.3 * draws.next() - 0.35];
            ScanSighting {
                measured: Measured { value, noise, tail },
                identity: None,
                appearance: Appearance::default(),
            }
        })
        .collect()
}

/// Something speaks for or against each pair, or nothing for any.
fn random_evidence(draws: &mut Draws, table: &CandidateTable) -> Evidence {
    let mut evidence = Evidence::default();
    if draws.chance(0.5) {
        evidence.gather(table, |_, _, column| column.iter_mut().for_each(|value| *value = 4.0 * draws.next() - 2.0));
    }
    evidence
}

/// Poses near the origin, each known or uncertain.
fn random_belief(draws: &mut Draws, certain: f64) -> Belief {
    let mean = Pose::new(0.3 * draws.next(), 0.3 * draws.next(), 0.1 * draws.next());
    if draws.chance(certain) {
        return Belief { mean, covariance: [[0.0; 3]; 3] };
    }
    let (a, b, c) = (0.1 * draws.next(), 0.1 * draws.next(), 0.05 * draws.next());
    Belief { mean, covariance: [[a, 0.2 * b * a, 0.0], [0.2 * b * a, b, 0.1 * c * b], [0.0, 0.1 * c * b, c]] }
}

fn numbers_of(belief: &Belief) -> [f64; 9] {
    let [[xx, xy, xh], [_, yy, yh], [_, _, hh]] = belief.covariance;
    [belief.mean.x, belief.mean.y, belief.mean.heading, xx, xy, xh, yy, yh, hh]
}

/// What each particle decides alone, with its belief afterwards and the log-likelihood.
fn one_by_one(question: &Question<'_, RangeBearing>, beliefs: &[Belief]) -> (Vec<Decision>, Vec<[f64; 9]>, Vec<f64>) {
    let Question { rules, model, T_robot_sensor, scan, table, evidence, stream } = *question;
    let mut fits = FitTable::default();
    fits.evidence.clone_from(evidence);
    fits.fill(table, |j, candidate, log_likelihood, distance| {
        for (i, belief) in beliefs.iter().enumerate() {
            if let Some(landmark) = table.gaussian(candidate, i) {
                let fit = belief.fit(model, T_robot_sensor, &landmark, &scan[j].measured);
                (log_likelihood[i], distance[i]) = (fit.log_likelihood, fit.mahalanobis_squared);
            }
        }
    });
    let mut scratch = Scratch::default();
    let (mut decisions, mut refined, mut log_likelihood) = (Vec::new(), Vec::new(), Vec::new());
    for (particle, &belief) in beliefs.iter().enumerate() {
        let mut mine = vec![Decision::Ignored; scan.len()];
        let fits = &fits;
        let among = Candidates { scan, of_sighting: &table.of_sighting };
        let mut one = ParticleHypothesis { model, T_robot_sensor, table, fits, particle, belief, refined: None };
        let draw = |j: usize| stream.uniform(particle as u32, j as u32);
        log_likelihood.push(match rules.method {
            Method::Sampled => decide_sampled(&Sampler { rules, draw }, among, &mut one, &mut scratch, &mut mine),
            _ => decide(rules, among, &mut one, &mut scratch, &mut mine),
        });
        refined.push(numbers_of(&one.refined.map_or(belief, |(belief, _)| belief)));
        decisions.extend(mine);
    }
    (decisions, refined, log_likelihood)
}

fn bits(values: &[f64]) -> Vec<u64> {
    // The sign and the payload of what is no number say nothing.
    values.iter().map(|v| if v.is_nan() { f64::NAN.to_bits() } else { v.to_bits() }).collect()
}

/// Compares the two ways and counts what was decided.
fn compare(
    question: &Question<'_, RangeBearing>,
    beliefs: &[Belief],
    seen: &mut [usize; 3],
    workspace: &mut Workspace,
) {
    let (expected, refined, expected_log_likelihood) = one_by_one(question, beliefs);
    let mut columns: [Vec<f64>; 9] =
        std::array::from_fn(|c| beliefs.iter().map(|belief| numbers_of(belief)[c]).collect());
    let mut decisions = vec![Decision::Ignored; expected.len()];
    let mut log_likelihood = vec![0.0; beliefs.len()];
    for first in (0..beliefs.len()).step_by(BLOCK) {
        let range = first..(first + BLOCK).min(beliefs.len());
        let share = question.scan.len();
        let answers = Answers {
            beliefs: columns.each_mut().map(|column| &mut column[range.clone()]),
            decisions: &mut decisions[range.start * share..range.end * share],
            log_likelihood: &mut log_likelihood[range],
        };
        decide_block(question, first, answers, workspace);
    }
    assert_eq!(decisions, expected);
    assert_eq!(bits(&log_likelihood), bits(&expected_log_likelihood));
    for (i, refined) in refined.iter().enumerate() {
        assert_eq!(bits(&columns.each_ref().map(|column| column[i])), bits(refined), "particle {i}");
    }
    for decision in decisions {
        match decision {
            Decision::Landmark(_) => seen[0] += 1,
            Decision::New => seen[1] += 1,
            Decision::Ignored => seen[2] += 1,
        }
    }
}

#[test]
fn a_block_decides_as_its_particles_do_one_by_one() {
    let (mut seen, mut cases, mut workspace) = ([0; 3], 0, Workspace::default());
    for case in 0..800 {
        let mut draws = Draws(RandomSource::new(8).stream(Purpose::Simulation, case), 0);
        let mut config = Config::default();
        let pick = case / 2 % 12;
        config.association.exclusion = if pick % 2 == 0 { Exclusion::OneSighting } else { Exclusion::None };
        config.association.order =
            if pick % 3 == 0 { AssociationOrder::Given } else { AssociationOrder::LeastAmbiguousFirst };
        config.association.method = if case % 2 == 0 { Method::Sampled } else { Method::MaximumLikelihood };
        config.filter.likelihood_exponent = if draws.chance(0.5) { 1.0 } else { 0.4 };
        let tail = if draws.chance(0.5) { Tail::Gaussian } else { Tail::StudentT(4.0) };
        let particles = 1 + draws.below(150);
        let sightings = if case / 2 % 40 == 7 { MOST_COUNTED + 1 } else { 1 + draws.below(7) };
        let certain = [0.0, 1.0, 0.3][draws.below(3)];
        let table = random_table(&mut draws, particles, sightings);
        let scan = random_scan(&mut draws, sightings, tail);
        let beliefs: Vec<Belief> = (0..particles).map(|_| random_belief(&mut draws, certain)).collect();
        let rules = Rules::new(&config, &MODEL);
        let (evidence, stream) = (random_evidence(&mut draws, &table), draws.0);
        let (rules, scan, table, evidence) = (&rules, &scan[..], &table, &evidence);
        let question = Question { rules, model: &MODEL, T_robot_sensor: MOUNTING, scan, table, evidence, stream };
        assert!(applies(rules.method, scan));
        compare(&question, &beliefs, &mut seen, &mut workspace);
        cases += 1;
    }
    assert_eq!(cases, 800);
    assert!(seen.iter().all(|count| *count > 2_000), "landmark, new, ignored: {seen:?}");
}

#[test]
fn named_sightings_and_mixed_tails_are_left_to_the_particles() {
    let mut draws = Draws(RandomSource::new(9).stream(Purpose::Simulation, 0), 0);
    let mut scan = random_scan(&mut draws, 3, Tail::Gaussian);
    let applies = |scan: &[ScanSighting]| applies(Method::Sampled, scan);
    assert!(applies(&scan) && applies(&[]) && !super::applies(Method::Joint, &scan));
    scan[1].measured.tail = Tail::StudentT(4.0);
    assert!(!applies(&scan));
    scan[1].measured.tail = Tail::Gaussian;
    scan[2].identity = Some(3);
    assert!(!applies(&scan));
}

#[test]
fn zero_covariances_of_either_sign_are_certain() {
    let mut lanes = Lanes::default();
    lanes.belief[3][1] = -0.0;
    lanes.belief[8][2] = 1e-300;
    lanes.begin(VECTOR, MOUNTING);
    assert_eq!(lanes.uncertain[..3], [0.0, 0.0, 1.0]);
}
