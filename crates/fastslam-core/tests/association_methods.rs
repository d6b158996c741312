//! Each method of association against enumeration of all explanations of a scan.

use crate::dense::Matrix;
use fastslam_core::association::{
    assign, decide_assignment, decide_joint, decide_sampled, Appearance, Belief, CandidateTable, Candidates, Decision,
    FitTable, Hypothesis, ParticleHypothesis, Rules, Sampler, ScanSighting, Scratch, MOST_JOINT,
};
use fastslam_core::config::{Config, Method};
use fastslam_core::geometry::{Pose, Symmetric2};
use fastslam_core::landmark::{Fit, Measured, Tail};
use fastslam_core::measurement::{Cartesian, Placing};
use fastslam_core::random::{Purpose, RandomSource};
use proptest::prelude::*;

const MODEL: Cartesian = Cartesian { position_std_m: 0.1 };

/// One particle whose belief has no uncertainty of heading: everything is linear.
struct Scene {
    belief: Belief,
    landmarks: Vec<([f64; 2], Symmetric2)>,
    scan: Vec<ScanSighting>,
    of_sighting: Vec<Vec<u32>>,
}

impl Scene {
    fn new(pose_variance: [f64; 2], landmarks: &[[f64; 2]], seen: &[[f64; 2]]) -> Self {
        let [xx, yy] = pose_variance;
        let belief =
            Belief { mean: Pose::new(0.0, 0.0, 0.0), covariance: [[xx, 0.0, 0.0], [0.0, yy, 0.0], [0.0, 0.0, 0.0]] };
        let scan = seen.iter().map(|value| sighting(*value)).collect();
        let landmarks: Vec<_> = landmarks.iter().map(|mean| (*mean, Symmetric2::new(0.004, 0.001, 0.003))).collect();
        let of_sighting = vec![(0..landmarks.len() as u32).collect(); seen.len()];
        Self { belief, landmarks, scan, of_sighting }
    }

    fn table(&self) -> CandidateTable {
        let rows = self.landmarks.iter().flat_map(|(mean, c)| [1.0, mean[0], mean[1], c.xx, c.xy, c.yy]);
        let mut table = CandidateTable::default();
        (table.particles, table.columns) = (1, 6);
        table.slots = (0..self.landmarks.len() as u32).collect();
        table.of_sighting = self.of_sighting.clone();
        table.values = rows.collect();
        table
    }

    /// Runs `decide` on the particle.
    fn with<T>(&self, decide: impl FnOnce(&mut ParticleHypothesis<'_, Cartesian>) -> T) -> T {
        let table = self.table();
        let mut fits = FitTable::default();
        fits.fill(&table, |j, candidate, log_likelihood, distance| {
            let landmark = table.gaussian(candidate, 0).unwrap();
            let fit = self.belief.fit(&MODEL, Pose::default(), &landmark, &self.scan[j].measured);
            (log_likelihood[0], distance[0]) = (fit.log_likelihood, fit.mahalanobis_squared);
        });
        let mut hypothesis = ParticleHypothesis {
            model: &MODEL,
            T_robot_sensor: Pose::default(),
            table: &table,
            fits: &fits,
            particle: 0,
            belief: self.belief,
            refined: None,
        };
        decide(&mut hypothesis)
    }

    fn candidates(&self) -> Candidates<'_> {
        Candidates { scan: &self.scan, of_sighting: &self.of_sighting }
    }

    /// ln N and the squared joint distance of a set of pairs (sighting, landmark), stacked.
    fn joint(&self, pairs: &[(usize, usize)]) -> (f64, f64) {
        let n = 2 * pairs.len();
        let mut innovation = Matrix::zeros(n, 1);
        let mut covariance = Matrix::zeros(n, n);
        for (a, (j, k)) in pairs.iter().enumerate() {
            let (mean, c) = &self.landmarks[*k];
            let r = self.scan[*j].measured.noise;
            for axis in 0..2 {
                innovation[2 * a + axis] = self.scan[*j].measured.value[axis] - mean[axis];
                for b in 0..pairs.len() {
                    covariance[(2 * a + axis, 2 * b + axis)] += self.belief.covariance[axis][axis];
                }
            }
            covariance[(2 * a, 2 * a)] += c.xx + r.xx;
            covariance[(2 * a + 1, 2 * a + 1)] += c.yy + r.yy;
            covariance[(2 * a, 2 * a + 1)] += c.xy + r.xy;
            covariance[(2 * a + 1, 2 * a)] += c.xy + r.xy;
        }
        if n == 0 {
            return (0.0, 0.0);
        }
        let (inverse, determinant) = covariance.inverse();
        assert!(determinant > 0.0);
        let distance = (innovation.transpose() * inverse * &innovation)[0];
        (-0.5 * (distance + determinant.ln() + n as f64 * std::f64::consts::TAU.ln()), distance)
    }

    /// Every explanation of the scan in which a landmark explains at most one sighting.
    fn explanations(&self) -> Vec<Vec<Option<usize>>> {
        let mut all = vec![Vec::new()];
        for _ in &self.scan {
            all = all
                .into_iter()
                .flat_map(|prefix: Vec<Option<usize>>| {
                    let free = (0..self.landmarks.len()).filter(|k| !prefix.contains(&Some(*k))).map(Some);
                    let options: Vec<_> = free.chain([None]).collect();
                    options.into_iter().map(move |option| [prefix.clone(), vec![option]].concat())
                })
                .collect();
        }
        all
    }
}

fn sighting(value: [f64; 2]) -> ScanSighting {
    let measured = Measured { value, noise: MODEL.noise_covariance(), tail: Tail::Gaussian };
    ScanSighting { measured, identity: None, appearance: Appearance::default() }
}

fn rules(method: Method, new_landmark_density: f64) -> Rules {
    let mut config = Config::default();
    config.association.method = method;
    config.association.new_landmark_density = Some(new_landmark_density);
    Rules::new(&config, &MODEL)
}

fn pairs_of(explanation: &[Option<usize>]) -> Vec<(usize, usize)> {
    explanation.iter().enumerate().filter_map(|(j, k)| k.map(|k| (j, k))).collect()
}

fn as_explanation(decisions: &[Decision]) -> Vec<Option<usize>> {
    let landmark = |d: &Decision| if let Decision::Landmark(k) = d { Some(*k as usize) } else { None };
    decisions.iter().map(landmark).collect()
}

#[test]
fn draws_follow_the_posterior_over_all_explanations_and_weights_sum_to_the_evidence() {
    // Two sightings between three landmarks, with an uncertain pose that correlates them.
    let scene = Scene::new([0.03, 0.02], &[[2.0, 0.0], [2.0, 0.5], [2.4, 0.3]], &[[2.15, 0.2], [2.2, 0.4]]);
    let density = 0.3_f64;
    let rules = rules(Method::Sampled, density);
    let explanations = scene.explanations();
    assert_eq!(explanations.len(), 13);
    let lacking = |e: &[Option<usize>]| e.iter().filter(|k| k.is_none()).count() as i32;
    let truth: Vec<f64> =
        explanations.iter().map(|e| scene.joint(&pairs_of(e)).0.exp() * density.powi(lacking(e))).collect();
    let evidence: f64 = truth.iter().sum();
    // Importance sampling: the weighted frequency of an explanation is its likelihood.
    let n = 40_000;
    let (mut sums, mut squares) = (vec![0.0; truth.len()], vec![0.0; truth.len()]);
    let stream = RandomSource::new(5).stream(Purpose::Association, 1);
    for i in 0..n {
        let mut decisions = [Decision::Ignored; 2];
        let log_weight = scene.with(|hypothesis| {
            let draw = |j: usize| stream.uniform(i, j as u32);
            let sampler = Sampler { rules: &rules, draw };
            decide_sampled(&sampler, scene.candidates(), hypothesis, &mut Scratch::default(), &mut decisions)
        });
        let explanation = as_explanation(&decisions);
        let place = explanations.iter().position(|e| *e == explanation).unwrap();
        sums[place] += log_weight.exp();
        squares[place] += (2.0 * log_weight).exp();
    }
    let count = f64::from(n);
    for ((explanation, truth), (sum, square)) in explanations.iter().zip(&truth).zip(sums.iter().zip(&squares)) {
        let mean = sum / count;
        // Four standard errors of the mean, and one draw's worth for what is too rare to be drawn.
        let bound = 4.0 * ((square / count - mean * mean) / count).sqrt() + evidence / count;
        assert!((mean - truth).abs() < bound, "{explanation:?}: {mean} against {truth} ± {bound}");
    }
    let total: f64 = sums.iter().sum::<f64>() / count;
    assert!((total / evidence - 1.0).abs() < 0.02, "{total} against {evidence}");
}

#[test]
fn one_sampled_sighting_has_the_sum_of_likelihoods_as_its_weight() {
    let scene = Scene::new([0.0, 0.0], &[[2.0, 0.0], [2.1, 0.1]], &[[2.05, 0.02]]);
    let rules = rules(Method::Sampled, 0.5);
    let likelihoods = [0, 1].map(|k| scene.joint(&[(0, k)]).0.exp());
    let total = likelihoods[0] + likelihoods[1] + 0.5;
    let decide = |uniform: f64| {
        let mut decisions = [Decision::Ignored];
        let log_weight = scene.with(|hypothesis| {
            let sampler = Sampler { rules: &rules, draw: |_| uniform };
            decide_sampled(&sampler, scene.candidates(), hypothesis, &mut Scratch::default(), &mut decisions)
        });
        assert!((log_weight - total.ln()).abs() < 1e-12, "{log_weight}");
        decisions[0]
    };
    // The boundaries of the cumulative sums.
    let first = likelihoods[0] / total;
    let second = first + likelihoods[1] / total;
    assert_eq!(decide(first - 1e-9), Decision::Landmark(0));
    assert_eq!(decide(first + 1e-9), Decision::Landmark(1));
    assert_eq!(decide(second + 1e-9), Decision::New);
}

/// Two landmarks 0.5 m apart along x, a pose that is 0.3 m off along x: alone, the left sighting fits the wrong one.
fn shifted_pair() -> Scene {
    Scene::new([0.09, 1e-6], &[[2.0, 0.0], [2.5, 0.0]], &[[2.3, 0.0], [2.8, 0.0]])
}

#[test]
fn together_two_sightings_are_right_where_each_alone_is_wrong() {
    let scene = shifted_pair();
    let right = [Decision::Landmark(0), Decision::Landmark(1)];
    // Alone, the first sighting prefers the second landmark: 0.2 m off against 0.3 m.
    assert!(scene.joint(&[(0, 1)]).1 < scene.joint(&[(0, 0)]).1);
    let mut decisions = [Decision::Ignored; 2];
    let outcome = scene.with(|hypothesis| {
        let rules = rules(Method::Joint, 1e-3);
        decide_joint(&rules, scene.candidates(), hypothesis, &mut Scratch::default(), &mut decisions)
    });
    assert_eq!(decisions, right);
    assert!((outcome.log_weight - scene.joint(&[(0, 0), (1, 1)]).0).abs() < 1e-9 && !outcome.fell_back);
    let mut decisions = [Decision::Ignored; 2];
    let log_weight = scene.with(|hypothesis| {
        let rules = rules(Method::Assignment, 1e-3);
        let mut scratch = Scratch::default();
        decide_assignment(&rules, scene.candidates(), hypothesis, &mut scratch, &mut decisions)
    });
    assert_eq!(decisions, right);
    assert!((log_weight - scene.joint(&[(0, 0), (1, 1)]).0).abs() < 1e-9);
}

#[test]
fn a_scan_too_large_for_joint_compatibility_is_decided_one_by_one_and_says_so() {
    let many: Vec<[f64; 2]> = (0..MOST_JOINT + 1).map(|k| [2.0, 3.0 * k as f64]).collect();
    for (landmarks, fell_back) in [(&many[..], true), (&many[1..], false)] {
        let scene = Scene::new([0.01, 0.01], landmarks, landmarks);
        let mut decisions = vec![Decision::Ignored; landmarks.len()];
        let outcome = scene.with(|hypothesis| {
            let rules = rules(Method::Joint, 1e-3);
            decide_joint(&rules, scene.candidates(), hypothesis, &mut Scratch::default(), &mut decisions)
        });
        assert_eq!(outcome.fell_back, fell_back);
        let right: Vec<_> = (0..landmarks.len() as u32).map(Decision::Landmark).collect();
        assert_eq!(decisions, right);
    }
}

fn points(count: impl Into<proptest::collection::SizeRange>) -> impl Strategy<Value = Vec<[f64; 2]>> {
    proptest::collection::vec([1.5_f64..2.7, -0.6_f64..0.6], count)
}

proptest! {
    #[test]
    fn an_assignment_costs_no_more_than_any_other(
        costs in proptest::collection::vec(-5.0_f64..5.0, 20), rows in 1_usize..=4,
    ) {
        let columns = 5;
        let costs = &costs[..rows * columns];
        let total = |of_row: &[usize]| of_row.iter().enumerate().map(|(r, c)| costs[r * columns + c]).sum::<f64>();
        let mut least = f64::INFINITY;
        let mut seen = 0;
        for code in 0..columns.pow(rows as u32) {
            let of_row: Vec<usize> = (0..rows).map(|r| code / columns.pow(r as u32) % columns).collect();
            let distinct = (0..rows).all(|a| (0..a).all(|b| of_row[a] != of_row[b]));
            if distinct {
                seen += 1;
                least = least.min(total(&of_row));
            }
        }
        prop_assert!(seen > 0);
        let found = assign(costs, rows, columns);
        prop_assert!((0..rows).all(|a| (0..a).all(|b| found[a] != found[b])));
        prop_assert!((total(&found) - least).abs() < 1e-9, "{} against {}", total(&found), least);
    }

    #[test]
    fn with_a_known_pose_the_assignment_is_the_likeliest_of_all(
        landmarks in points(1..4), seen in points(1..4),
    ) {
        let scene = Scene::new([0.0, 0.0], &landmarks, &seen);
        let density = 0.05_f64;
        let rules = rules(Method::Assignment, density);
        let mut best = f64::NEG_INFINITY;
        for explanation in scene.explanations() {
            let pairs = pairs_of(&explanation);
            // Pairs outside of their gate are no explanation.
            if pairs.iter().all(|pair| scene.joint(&[*pair]).1 <= rules.gate) {
                let lacking = (seen.len() - pairs.len()) as f64;
                best = best.max(scene.joint(&pairs).0 + lacking * density.ln());
            }
        }
        let mut decisions = vec![Decision::Ignored; seen.len()];
        let log_weight = scene.with(|hypothesis| {
            let mut scratch = Scratch::default();
            decide_assignment(&rules, scene.candidates(), hypothesis, &mut scratch, &mut decisions)
        });
        prop_assert!((log_weight - best).abs() < 1e-9, "{} against {}", log_weight, best);
    }

    #[test]
    fn the_joint_search_finds_the_largest_compatible_set_and_the_nearest_of_those(
        landmarks in points(1..5), seen in points(1..5), shift in [-0.3_f64..0.3, -0.3_f64..0.3],
    ) {
        let seen: Vec<[f64; 2]> = seen.iter().map(|s| [s[0] + shift[0], s[1] + shift[1]]).collect();
        let scene = Scene::new([0.05, 0.04], &landmarks, &seen);
        let rules = rules(Method::Joint, 1e-12);
        let compatible = |pairs: &[(usize, usize)]| {
            scene.joint(pairs).1 <= rules.joint_gates[pairs.len()]
        };
        // The search adds sightings one after the other: every subset in its order has to be compatible too, and every
        // pair within its own gate given those before it. The search's order is that of its own scratch.
        let mut scratch = Scratch::default();
        let mut decisions = vec![Decision::Ignored; seen.len()];
        let outcome = scene.with(|h| decide_joint(&rules, scene.candidates(), h, &mut scratch, &mut decisions));
        prop_assert!(!outcome.fell_back);
        let found = pairs_of(&as_explanation(&decisions));
        prop_assert!(compatible(&found));
        let order = search_order(&scene, &rules);
        let mut best: Option<(usize, f64)> = None;
        for explanation in scene.explanations() {
            let mut pairs = pairs_of(&explanation);
            pairs.sort_by_key(|(j, _)| order.iter().position(|o| o == j));
            let steps = (1..=pairs.len()).all(|n| {
                let (before, now) = (scene.joint(&pairs[..n - 1]).1, scene.joint(&pairs[..n]).1);
                now <= rules.joint_gates[n] && now - before <= rules.gate
            });
            let candidate = (pairs.len(), scene.joint(&pairs).1);
            let better = best.is_none_or(|(n, d)| candidate.0 > n || (candidate.0 == n && candidate.1 < d));
            let alone = pairs.iter().all(|(j, _)| order.contains(j));
            if steps && alone && better {
                best = Some(candidate);
            }
        }
        let (pairs, distance) = best.unwrap();
        prop_assert_eq!(found.len(), pairs);
        prop_assert!((scene.joint(&found).1 - distance).abs() < 1e-9);
    }
}

/// The sightings that some landmark explains alone, the least ambiguous first: by how much their likeliest landmark is
/// better than the next one or a new one.
fn search_order(scene: &Scene, rules: &Rules) -> Vec<usize> {
    let fits = |j: usize| -> Vec<Fit> {
        scene.with(|h| {
            (0..scene.landmarks.len()).filter_map(|k| h.fit([j, k], k as u32, &scene.scan[j].measured)).collect()
        })
    };
    let mut margins: Vec<(usize, f64)> = Vec::new();
    for j in 0..scene.scan.len() {
        let mut of_j = fits(j);
        of_j.sort_by(|a, b| b.log_likelihood.total_cmp(&a.log_likelihood));
        let next = of_j.get(1).map_or(rules.log_new_density, |f| f.log_likelihood.max(rules.log_new_density));
        if of_j[0].mahalanobis_squared <= rules.gate {
            margins.push((j, of_j[0].log_likelihood - next));
        }
    }
    margins.sort_by(|a, b| b.1.total_cmp(&a.1));
    margins.into_iter().map(|(j, _)| j).collect()
}
