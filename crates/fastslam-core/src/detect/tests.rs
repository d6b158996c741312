//! Scans whose answer is known, and scans that no sensor would send.

use super::*;
use proptest::prelude::*;

const STEP: f64 = std::f64::consts::PI / 360.0;

fn geometry() -> BeamGeometry {
    BeamGeometry {
        first_angle_rad: -180.0 * STEP,
        angle_step_rad: STEP,
        min_range_m: 0.1,
        max_range_m: 80.0,
        beam_period_s: None,
    }
}

/// Exact ranges to circles (x, y, radius) from a sensor that moves with `twist`.
fn ranges(geometry: &BeamGeometry, beams: usize, circles: &[[f64; 3]], twist: [f64; 3]) -> Vec<f64> {
    let cast = |i: usize| {
        let time = i as f64 * geometry.beam_period_s.unwrap_or(0.0);
        let pose = crate::geometry::Pose::from_twist(twist[0] * time, twist[1] * time, twist[2] * time);
        let (s, c) = math::sin_cos(pose.heading + geometry.first_angle_rad + i as f64 * geometry.angle_step_rad);
        let hits = circles.iter().filter_map(|&[x, y, radius]| {
            let (along, across) = ((x - pose.x) * c + (y - pose.y) * s, (x - pose.x) * s - (y - pose.y) * c);
            (across.abs() < radius && along > 0.0).then(|| along - (radius * radius - across * across).sqrt())
        });
        hits.fold(f64::INFINITY, f64::min)
    };
    (0..beams).map(cast).collect()
}

fn run(kind: DetectorKind, scan: &Scan) -> Vec<Detection> {
    let mut found = Vec::new();
    Detector::new(DetectorConfig { kind, ..Default::default() }).unwrap().detect(scan, &mut found).unwrap();
    found
}

fn scan(ranges_m: &[f64], geometry: BeamGeometry) -> Scan<'_> {
    Scan { ranges_m, intensities: None, geometry, twist: None }
}

fn position(d: &Detection) -> [f64; 2] {
    [d.range_m * d.bearing_rad.cos(), d.range_m * d.bearing_rad.sin()]
}

#[test]
fn one_trunk_is_found_with_its_diameter() {
    let ranges = ranges(&geometry(), 361, &[[6.0, 2.0, 0.3]], [0.0; 3]);
    let found = run(DetectorKind::Trunks, &scan(&ranges, geometry()));
    assert_eq!(found.len(), 1);
    let [x, y] = position(&found[0]);
    // The edge is known to a beam spacing of 55 mm, the arc refines it.
    assert!((x - 6.0).abs() < 0.02 && (y - 2.0).abs() < 0.02, "{x} {y}");
    assert!((found[0].signature - 0.6).abs() < 0.05, "{}", found[0].signature);
    assert!(found[0].detection_probability > 0.9);
    assert!(found[0].intensity.is_nan());
}

#[test]
fn a_scanner_that_turns_clockwise_sees_the_same() {
    let forward = ranges(&geometry(), 361, &[[6.0, 2.0, 0.3], [9.0, -3.0, 0.5]], [0.0; 3]);
    let backward: Vec<f64> = forward.iter().rev().copied().collect();
    let reversed = BeamGeometry { first_angle_rad: 180.0 * STEP, angle_step_rad: -STEP, ..geometry() };
    let mut a = run(DetectorKind::Trunks, &scan(&forward, geometry()));
    let b = run(DetectorKind::Trunks, &scan(&backward, reversed));
    a.reverse();
    assert_eq!((a.len(), b.len()), (2, 2));
    for (a, b) in a.iter().zip(&b) {
        assert!((a.range_m - b.range_m).abs() < 1e-6 && (a.bearing_rad - b.bearing_rad).abs() < 1e-6);
    }
}

#[test]
fn a_trunk_half_hidden_has_no_diameter() {
    // The near trunk hides the right half of the far one.
    let ranges = ranges(&geometry(), 361, &[[8.0, 0.3, 0.4], [4.0, -0.2, 0.25]], [0.0; 3]);
    let found = run(DetectorKind::Trunks, &scan(&ranges, geometry()));
    let near = found.iter().find(|d| d.range_m < 5.0).unwrap();
    assert!((near.signature - 0.5).abs() < 0.05);
    for far in found.iter().filter(|d| d.range_m > 5.0) {
        assert!(far.signature.is_nan(), "diameter {}", far.signature);
    }
}

#[test]
fn a_trunk_over_the_seam_of_a_full_turn_is_one() {
    let full = BeamGeometry { first_angle_rad: 0.0, ..geometry() };
    let ranges = ranges(&full, 720, &[[6.0, 0.05, 0.4]], [0.0; 3]);
    let found = run(DetectorKind::Trunks, &scan(&ranges, full));
    assert_eq!(found.len(), 1);
    assert!((found[0].signature - 0.8).abs() < 0.05, "{}", found[0].signature);
    assert!(found[0].first_beam > found[0].last_beam);
}

#[test]
fn motion_during_the_scan_is_taken_out() {
    let slow = BeamGeometry { beam_period_s: Some(0.1 / 360.0), ..geometry() };
    let (twist, truth) = ([6.0, 0.5, 1.0], [[5.0, 4.0, 0.3], [7.0, -2.0, 0.3]]);
    let ranges = ranges(&slow, 361, &truth, twist);
    let mut corrected = run(DetectorKind::Trunks, &Scan { twist: Some(twist), ..scan(&ranges, slow) });
    let raw = run(DetectorKind::Trunks, &scan(&ranges, slow));
    corrected.reverse();
    assert_eq!((corrected.len(), raw.len()), (2, 2));
    for (d, [x, y, _]) in corrected.iter().zip(truth) {
        let p = position(d);
        assert!((p[0] - x).hypot(p[1] - y) < 0.03, "{p:?}");
    }
    let [x, y] = position(&raw[1]);
    assert!((x - 5.0).hypot(y - 4.0) > 0.3, "without the correction it is off by the motion");
}

#[test]
fn a_reflector_is_the_median_of_its_bright_beams() {
    let mut ranges = vec![20.0; 361];
    let mut intensities = vec![0.0; 361];
    for (i, (range, intensity)) in [(9.97, 2.0), (9.98, 4.0), (14.0, 0.0), (9.96, 1.0)].into_iter().enumerate() {
        ranges[200 + i] = range;
        intensities[200 + i] = intensity;
    }
    let found = run(DetectorKind::Reflectors, &Scan { intensities: Some(&intensities), ..scan(&ranges, geometry()) });
    assert_eq!(found.len(), 1);
    // Half a post of 30 mm at most behind the surface, less the sagitta of beams beside the axis.
    assert!((found[0].range_m - 9.97).abs() < 0.035, "{}", found[0].range_m);
    assert!((found[0].bearing_rad - 21.5 * STEP).abs() < 1e-9);
    assert_eq!((found[0].intensity, found[0].first_beam, found[0].last_beam), (4.0, 200, 203));
    assert_eq!(run(DetectorKind::Reflectors, &scan(&ranges, geometry())), []);
}

#[test]
fn a_post_near_by_is_one_though_its_middle_comes_back_dim() {
    // Two beams of 22 mm between bright ones, as a laser saw a post of 60 mm at 2.5 m.
    let found = |middle: [f64; 2], range_m: f64| {
        let (mut ranges, mut intensities) = (vec![20.0; 361], vec![0.0; 361]);
        ranges[200..204].copy_from_slice(&[range_m, middle[0], middle[1], range_m]);
        (intensities[200], intensities[203]) = (2.0, 4.0);
        run(DetectorKind::Reflectors, &Scan { intensities: Some(&intensities), ..scan(&ranges, geometry()) })
    };
    let one = found([2.5, 2.5], 2.5);
    assert_eq!((one.len(), one[0].first_beam, one[0].last_beam), (1, 200, 203));
    assert!((one[0].bearing_rad - 21.5 * STEP).abs() < 1e-9);
    assert_eq!(found([2.5, f64::INFINITY], 2.5).len(), 1, "a beam without an echo passes nothing by");
    assert_eq!(found([2.5, 20.0], 2.5).len(), 2, "a beam between them meets what is behind");
    assert_eq!(found([6.0, 6.0], 6.0).len(), 2, "16 cm apart they are two posts");
}

#[test]
fn the_corner_of_two_walls_is_where_they_meet() {
    // Walls x = 5 and y = 3 around the sensor's left front.
    let walls = |i: usize| {
        let (s, c) = math::sin_cos(-180.0 * STEP + i as f64 * STEP);
        let front = if c > 1e-6 { 5.0 / c } else { f64::INFINITY };
        let left = if s > 1e-6 { 3.0 / s } else { f64::INFINITY };
        front.min(left)
    };
    let ranges: Vec<f64> = (0..361).map(walls).collect();
    let found = run(DetectorKind::Corners, &scan(&ranges, geometry()));
    assert_eq!(found.len(), 1);
    let [x, y] = position(&found[0]);
    assert!((x - 5.0).abs() < 0.02 && (y - 3.0).abs() < 0.02, "{x} {y}");
}

#[test]
fn every_piece_has_its_verdict() {
    // A trunk, a grazing wall y = -1 from x = 4 on, one lone echo, and a trunk beyond the range.
    let mut ranges = ranges(&geometry(), 361, &[[6.0, 2.0, 0.3], [76.0, 20.0, 1.5]], [0.0; 3]);
    for (i, range) in ranges.iter_mut().enumerate().take(180) {
        let (s, c) = math::sin_cos(-180.0 * STEP + i as f64 * STEP);
        let wall = -1.0 / s;
        *range = if wall * c > 4.0 && wall < 60.0 { wall } else { *range };
    }
    ranges[300] = 5.0;
    let mut detector = Detector::new(DetectorConfig::default()).unwrap();
    let mut found = Vec::new();
    detector.detect(&scan(&ranges, geometry()), &mut found).unwrap();
    assert_eq!(found.len(), 1, "{found:?}");
    let verdicts: Vec<Verdict> = detector.pieces().iter().map(|piece| piece.verdict).collect();
    for (verdict, count) in [(Verdict::Detected, 1), (Verdict::TooFar, 1), (Verdict::PoorFit, 1)] {
        assert_eq!(verdicts.iter().filter(|&&v| v == verdict).count(), count, "{verdicts:?}");
    }
    assert!(verdicts.contains(&Verdict::TooFewBeams), "{verdicts:?}");
    let hits: u32 = detector.pieces().iter().map(|piece| piece.last_beam - piece.first_beam + 1).sum();
    assert_eq!(hits as usize, ranges.iter().filter(|r| r.is_finite()).count());
}

#[test]
fn a_wrong_header_is_an_error_that_names_the_field() {
    let ranges = vec![5.0; 361];
    let wrong = [
        ("first_angle_rad", BeamGeometry { first_angle_rad: f64::NAN, ..geometry() }),
        ("first_angle_rad", BeamGeometry { first_angle_rad: -90.0, ..geometry() }),
        ("angle_step_rad", BeamGeometry { angle_step_rad: 0.0, ..geometry() }),
        ("angle_step_rad", BeamGeometry { angle_step_rad: 0.5, ..geometry() }),
        ("min_range_m", BeamGeometry { min_range_m: -1.0, ..geometry() }),
        ("max_range_m", BeamGeometry { max_range_m: 0.05, ..geometry() }),
        ("beam_period_s", BeamGeometry { beam_period_s: Some(f64::INFINITY), ..geometry() }),
    ];
    let mut detector = Detector::new(DetectorConfig::default()).unwrap();
    let mut found = Vec::new();
    for (field, geometry) in wrong {
        let error = detector.detect(&scan(&ranges, geometry), &mut found).unwrap_err().to_string();
        assert!(error.starts_with(&format!("geometry.{field}:")), "{error}");
    }
    let short = Scan { intensities: Some(&[1.0]), ..scan(&ranges, geometry()) };
    let error = detector.detect(&short, &mut found).unwrap_err().to_string();
    assert_eq!(error, "scan: got 1 intensities for 361 ranges");
    let spun = Scan { twist: Some([0.0, f64::NAN, 0.0]), ..scan(&ranges, geometry()) };
    assert!(detector.detect(&spun, &mut found).is_err());
    assert_eq!(found, []);
}

#[test]
fn settings_out_of_range_are_errors_that_name_the_key() {
    let wrong = [
        r#"{"trunks": {"jump_m": 0}}"#,
        r#"{"trunks": {"min_beams": 0}}"#,
        r#"{"reflectors": {"range_std_m": -1}}"#,
        r#"{"corners": {"min_beams": 1}}"#,
    ];
    for (json, key) in
        wrong.iter().zip(["trunks.jump_m", "trunks.min_beams", "reflectors.range_std_m", "corners.min_beams"])
    {
        let config: DetectorConfig = serde_json::from_str(json).unwrap();
        let error = config.validate().unwrap_err().to_string();
        assert!(error.starts_with(key), "{error}");
    }
    assert!(serde_json::from_str::<DetectorConfig>(r#"{"trunk": {}}"#).is_err());
}

/// Anything that can stand in an array of ranges, likely values more often.
fn any_range() -> impl Strategy<Value = f64> {
    prop_oneof![
        4 => 0.5..30.0,
        2 => Just(7.0),
        1 => any::<f64>(),
        1 => prop::sample::select(vec![f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 0.0, -1.0, 1e-300, 1e300, 81.91]),
    ]
}

fn any_geometry() -> impl Strategy<Value = BeamGeometry> {
    let odd = || prop_oneof![6 => -4.0..4.0, 1 => any::<f64>()];
    let step =
        prop_oneof![4 => Just(STEP), 2 => Just(-STEP), 1 => Just(std::f64::consts::TAU / 90.0), 1 => any::<f64>()];
    (odd(), step, prop_oneof![4 => Just(0.1), 1 => odd()], prop_oneof![4 => Just(80.0), 1 => odd()], any::<bool>())
        .prop_map(|(first_angle_rad, angle_step_rad, min_range_m, max_range_m, timed)| BeamGeometry {
            first_angle_rad,
            angle_step_rad,
            min_range_m,
            max_range_m,
            beam_period_s: timed.then_some(0.001),
        })
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 3000, ..Default::default() })]

    #[test]
    fn no_scan_makes_a_detector_panic_or_report_nonsense(
        scans in prop::collection::vec(
            (prop::collection::vec(any_range(), 0..120), prop::collection::vec(any_range(), 0..120), any_geometry()),
            1..3,
        ),
        twist in prop::option::of([-9.0..9.0, -9.0..9.0, -9.0..9.0]),
        kind in prop::sample::select(vec![DetectorKind::Trunks, DetectorKind::Reflectors, DetectorKind::Corners]),
        same_length in any::<bool>(),
    ) {
        let mut detector = Detector::new(DetectorConfig { kind, ..Default::default() }).unwrap();
        let mut found = Vec::new();
        for (ranges, mut intensities, geometry) in scans {
            if same_length {
                intensities.resize(ranges.len(), 1.0);
            }
            let scan = Scan { ranges_m: &ranges, intensities: Some(&intensities), geometry, twist };
            let before = found.len();
            match detector.detect(&scan, &mut found) {
                Ok(count) => prop_assert_eq!(found.len(), before + count),
                Err(_) => prop_assert_eq!(found.len(), before),
            }
            for d in &found[before..] {
                prop_assert!(d.range_m.is_finite() && d.range_m > 0.0);
                prop_assert!(d.bearing_rad.abs() <= std::f64::consts::PI + 1e-12);
                prop_assert!(d.covariance.is_positive_definite());
                prop_assert!(d.detection_probability > 0.0 && d.detection_probability <= 1.0);
                prop_assert!((d.first_beam as usize) < ranges.len() && (d.last_beam as usize) < ranges.len());
            }
            let beams = detector.pieces().iter().flat_map(|piece| [piece.first_beam, piece.last_beam]);
            prop_assert!(beams.into_iter().all(|beam| (beam as usize) < ranges.len()));
        }
    }
}
