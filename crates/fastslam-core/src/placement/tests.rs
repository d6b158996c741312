//! Maps whose places are known, and maps in which there is none.

use super::*;
use proptest::prelude::*;

fn scattered(seed: u64, count: usize, half_m: f64) -> Vec<[f64; 2]> {
    let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ 0x1234_5678_9ABC_DEF1;
    let mut draw = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 11) as f64 / (1_u64 << 53) as f64
    };
    (0..count).map(|_| [half_m * (2.0 * draw() - 1.0), half_m * (2.0 * draw() - 1.0)]).collect()
}

fn marks(places: &[[f64; 2]], label: Option<u32>) -> Vec<Mark> {
    places.iter().map(|&mean| Mark { mean, variance: 0.01, label }).collect()
}

fn view() -> View {
    View { sensors: vec![Pose::default()], reach_m: 5.0, half_view_rad: std::f64::consts::PI }
}

const EFFORT: Effort = Effort { refined: 150, told: 30 };

/// The landmarks nearest to the first one, in a frame at `pose`.
fn around(places: &[[f64; 2]], pose: Pose, count: usize) -> Vec<[f64; 2]> {
    let mut near = places.to_vec();
    let away = |p: &[f64; 2]| (p[0] - places[0][0]).hypot(p[1] - places[0][1]);
    near.sort_by(|a, b| away(a).total_cmp(&away(b)));
    near.truncate(count);
    near.into_iter().map(|place| pose.inverse().transform(place)).collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]

    #[test]
    fn a_local_map_is_found_where_it_was_made(seed in 1_u64..10_000, x in -9.0..9.0_f64, y in -9.0..9.0_f64, turn in -3.1..3.1_f64) {
        let places = scattered(seed, 120, 25.0);
        let pose = Pose::new(x, y, turn);
        let chart = Chart::new(marks(&places, None), Labels::Classes);
        let found = chart.placements(&marks(&around(&places, pose, 9), None), &view(), EFFORT);
        let best = found.first().expect("a place");
        prop_assert!(best.log_odds > 7.0 && best.matched == 9);
        prop_assert!((best.pose.x - x).hypot(best.pose.y - y) < 1e-6);
        prop_assert!(math::wrap_angle(best.pose.heading - turn).abs() < 1e-7);
        prop_assert!(crate::geometry::is_covariance3(&best.covariance));
        prop_assert!(found.windows(2).all(|pair| pair[0].log_odds >= pair[1].log_odds));
    }

    #[test]
    fn the_nearest_is_that_of_a_search_through_all(seed in 1_u64..10_000, count in 1_usize..60, x in -20.0..20.0_f64, y in -20.0..20.0_f64, reach in 0.0..30.0_f64) {
        let places = scattered(seed, count, 10.0);
        let by_hand = places
            .iter()
            .map(|p| (p[0] - x).powi(2) + (p[1] - y).powi(2))
            .enumerate()
            .filter(|(_, distance2)| *distance2 <= reach * reach)
            .min_by(|a, b| a.1.total_cmp(&b.1));
        let found = Nearest::new(&places).within([x, y], reach);
        prop_assert_eq!(found.map(|(row, _)| row), by_hand.map(|(row, _)| row));
    }
}

use crate::math;

#[test]
fn pairs_are_all_there_up_to_a_length_and_in_order() {
    for (count, half_m) in [(40, 10.0), (2_500, 80.0)] {
        let places = scattered(7, count, half_m);
        let pairs = Pairs::new(&places, &Nearest::new(&places));
        let length = |ends: &[u32; 2]| {
            let [a, b] = ends.map(|row| places[row as usize]);
            (a[0] - b[0]).hypot(a[1] - b[1])
        };
        let near = pairs.near(4.0, 0.5);
        let mut expected = 0;
        for i in 0..count as u32 {
            expected += (i + 1..count as u32).filter(|&j| (length(&[i, j]) - 4.0).abs() <= 0.5).count();
        }
        assert_eq!(near.len(), expected);
        assert!(expected > 10 && near.windows(2).all(|ends| length(&ends[0]) <= length(&ends[1]) + 1e-12));
        assert!(pairs.longest_m() > 4.5 && pairs.longest_m().is_finite() == (count > 1000));
    }
}

#[test]
fn a_map_in_clusters_has_no_more_pairs_than_are_kept() {
    let mut places = scattered(3, 3_000, 1.0);
    places.push([1e4, 1e4]);
    let pairs = Pairs::new(&places, &Nearest::new(&places));
    assert!(pairs.longest_m() < 2.0 && !pairs.near(0.3, 0.1).is_empty());
}

#[test]
fn strangers_are_placed_nowhere_for_sure() {
    for seed in 0..20 {
        let chart = Chart::new(marks(&scattered(seed + 1, 80, 15.0), None), Labels::Classes);
        let strangers = scattered(seed + 500, 8, 5.0);
        let found = chart.placements(&marks(&strangers, None), &view(), EFFORT);
        assert!(found.iter().all(|placement| placement.log_odds < 6.9), "{seed}: {found:?}");
    }
}

#[test]
fn a_symmetric_map_has_two_places_that_are_as_likely() {
    let half: Vec<[f64; 2]> = scattered(3, 25, 15.0).into_iter().map(|[x, y]| [x + 20.0, y]).collect();
    let both: Vec<[f64; 2]> = half.iter().copied().chain(half.iter().map(|[x, y]| [-x, -y])).collect();
    let local = marks(&around(&half, Pose::default(), 9), None);
    let found = Chart::new(marks(&both, None), Labels::Classes).placements(&local, &view(), EFFORT);
    assert!((found[0].log_odds - found[1].log_odds).abs() < 1e-6 && found[0].log_odds > 7.0);
    assert!(
        (math::wrap_angle(found[0].pose.heading - found[1].pose.heading).abs() - std::f64::consts::PI).abs() < 1e-6
    );
    let mut labelled = marks(&both, Some(0));
    labelled[25..].iter_mut().for_each(|mark| mark.label = Some(1));
    let local: Vec<Mark> = local.into_iter().map(|mark| Mark { label: Some(1), ..mark }).collect();
    let told = Chart::new(labelled.clone(), Labels::Classes).placements(&local, &view(), EFFORT);
    assert!(told[0].log_odds > told[1].log_odds + 7.0);
    let names = Chart::new(labelled, Labels::Names).placements(&local, &view(), EFFORT);
    assert!(names[0].matched == 9 && math::wrap_angle(names[0].pose.heading).abs() > 3.0);
}

#[test]
fn what_is_in_view_and_was_not_seen_speaks_against_a_place() {
    let places = scattered(11, 60, 15.0);
    let pose = Pose::new(places[0][0], places[0][1], 0.0);
    let chart = Chart::new(marks(&places, None), Labels::Classes);
    let mut local = marks(&around(&places, pose, 8), None);
    let whole = chart.placements(&local, &view(), EFFORT)[0];
    local.remove(1);
    let less = chart.placements(&local, &view(), EFFORT)[0];
    let blind = View { reach_m: 0.0, ..view() };
    let unseen = chart.placements(&local, &blind, EFFORT)[0];
    assert!(whole.log_odds > less.log_odds && less.log_odds < unseen.log_odds);
    let lost = unseen.log_odds - less.log_odds + math::ln(1.0 - SEEN);
    assert!(lost.abs() < 1e-6, "{lost}");
}

#[test]
fn too_little_is_placed_nowhere() {
    let chart = Chart::new(marks(&scattered(1, 30, 10.0), None), Labels::Classes);
    for count in 0..2 {
        assert!(chart.placements(&marks(&scattered(2, count, 3.0), None), &view(), EFFORT).is_empty());
        let small = Chart::new(marks(&scattered(2, count, 3.0), None), Labels::Classes);
        assert!(small.placements(&marks(&scattered(1, 9, 3.0), None), &view(), EFFORT).is_empty());
    }
    let one_place = marks(&[[1.0, 1.0]; 5], None);
    assert!(Chart::new(one_place.clone(), Labels::Classes).placements(&one_place, &view(), EFFORT).is_empty());
}
