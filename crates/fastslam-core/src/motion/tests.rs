//! What all motion models have in common.

use super::*;
use crate::geometry::{transform3, Matrix3};
use crate::math;
use crate::random::{Purpose, RandomSource};
use crate::testing::check_cutting;
use proptest::prelude::*;
use row::LEAST_BLUR;

/// The diffusion of a row added up in many small steps, each with its noise at the middle.
fn added_up(row: &RowMotion, steps: u32) -> MotionGaussian {
    let share = 1.0 / f64::from(steps);
    let (mean, half) = (row.part(share).mean, row.part(0.5 * share).mean);
    let (s, c) = math::sin_cos(half.heading);
    let rest = [mean.x - half.x, mean.y - half.y];
    let to_end = [[c, -s, -rest[1]], [s, c, rest[0]], [0.0, 0.0, 1.0]];
    let noise = row.diffusion().map(|line| line.map(|v| v * share));
    let step = MotionGaussian { mean, covariance: transform3(&to_end, &noise) };
    (0..steps).fold(MotionGaussian::default(), |sum, _| sum.then(&step))
}

fn worst(a: &Matrix3, b: &Matrix3) -> f64 {
    a.iter().flatten().zip(b.iter().flatten()).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

fn correction() -> impl Strategy<Value = Correction> {
    let gain = || prop_oneof![Just(1.0), 0.5..1.5_f64, -1.5..-0.5_f64];
    (gain(), gain(), -0.2..0.2_f64).prop_map(|(distance_gain, turn_gain, yaw_rate_bias_rad_per_s)| Correction {
        distance_gain,
        turn_gain,
        yaw_rate_bias_rad_per_s,
    })
}

fn proportional() -> impl Strategy<Value = Proportional> {
    let std = || prop_oneof![Just(0.0), 0.0..0.3_f64];
    (std(), std(), std(), std()).prop_map(|(ahead, aside, by_way, by_turn)| Proportional {
        distance_std_m_per_sqrt_m: ahead,
        lateral_std_m_per_sqrt_m: aside,
        turn_std_rad_per_sqrt_m: by_way,
        turn_std_rad_per_sqrt_rad: by_turn,
    })
}

fn model() -> impl Strategy<Value = Motion> {
    let std = || prop_oneof![Just(0.0), 1e-4..0.5_f64];
    let period = prop_oneof![Just(None), (1e-3..2.0_f64).prop_map(Some)];
    (0..4, [std(), std(), std()], 1e-3..0.3_f64, period, correction(), proportional()).prop_map(
        |(kind, [a, b, c], least, noise_period_s, correction, proportional)| match kind {
            0 => Motion::Velocity(Velocity {
                speed_std_m_per_s: least + a,
                yaw_rate_std_rad_per_s: b,
                lateral_std_m_per_s: c,
                noise_period_s,
                correction,
                proportional,
            }),
            1 => Motion::Ackermann(Ackermann {
                speed_std_m_per_s: least + a,
                steering_std_rad: b,
                lateral_std_m_per_s: c,
                noise_period_s,
                steering_gain: 0.8,
                steering_bias_rad: 0.03,
                correction,
                proportional,
                ..Ackermann::default()
            }),
            2 => Motion::Increments(Increments {
                x_std_m: least + a,
                y_std_m: b,
                heading_std_rad: c,
                correction,
                proportional,
            }),
            _ => {
                Motion::Odometry(Odometry { alpha1: least, alpha2: a, alpha3: b, alpha4: c, correction, proportional })
            }
        },
    )
}

fn control() -> impl Strategy<Value = [f64; 3]> {
    let way = || prop_oneof![Just(0.0), -3.0..3.0_f64, -1e-7..1e-7_f64];
    let turn = prop_oneof![Just(0.0), -3.1..3.1_f64, -1e-7..1e-7_f64];
    (way(), prop_oneof![Just(0.0), -1.2..1.2_f64, -1e-7..1e-7_f64], turn).prop_map(|(a, b, c)| [a, b, c])
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    #[test]
    fn wherever_a_row_is_cut_its_parts_make_the_row(
        model in model(),
        control in control(),
        row_s in prop_oneof![Just(0.0), 1e-3..3.0_f64],
        cuts in prop::collection::vec(0.0..1.0_f64, 0..12),
    ) {
        prop_assert_eq!(model.validate(), Ok(()));
        let outcome = check_cutting(&model.row(control, row_s), &cuts);
        prop_assert!(outcome.is_ok(), "{model:?} {control:?} {row_s}: {outcome:?}");
    }

    #[test]
    fn the_closed_form_is_the_sum_of_many_small_steps(model in model(), control in control()) {
        let row = model.row(control, 0.7);
        let (got, expected) = (row.part(1.0), added_up(&row, 400));
        let way = 1.0 + row.twist[0].hypot(row.twist[1]);
        let c = row.diffusion();
        let largest = c[0][0] + c[1][1] + c[2][2] * way * way;
        // The rule of the midpoint in 400 steps: θ²/24 · 400⁻² of the whole, for turns up to 5 rad.
        prop_assert!(worst(&got.covariance, &expected.covariance) <= 1e-5 * largest, "{model:?} {control:?}");
    }

    #[test]
    fn a_row_ends_with_the_covariance_that_was_stated(
        twist in (-2.0..2.0_f64, -0.5..0.5_f64, -1.5..1.5_f64),
        half in [[0.05..0.3_f64, -0.1..0.1, -0.05..0.05], [-0.1..0.1_f64, 0.05..0.3, -0.05..0.05], [-0.01..0.01_f64, -0.01..0.01, 0.01..0.03]],
    ) {
        let stated = transform3(&half, &[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]);
        let whole = RowMotion::reaching([twist.0, twist.1, twist.2], [stated, [[0.0; 3]; 3], [[0.0; 3]; 3]], 0).part(1.0);
        let added = worst(&whole.covariance, &stated);
        // Nothing is lost in any direction, and the heading has what it was given.
        prop_assert!((whole.covariance[2][2] - stated[2][2]).abs() < 1e-15);
        for direction in 0..12 {
            let (s, c) = math::sin_cos(f64::from(direction) * 0.5);
            let along = |m: &Matrix3| c * c * m[0][0] + 2.0 * s * c * m[0][1] + s * s * m[1][1];
            prop_assert!(along(&whole.covariance) >= along(&stated) - 1e-14, "{whole:?} {stated:?}");
        }
        // Wider than the heading's swing in every direction, and rounder than the turn blurs: exactly what was stated.
        let swing = stated[2][2].sqrt() * (twist.0.hypot(twist.1) + stated[0][2].hypot(stated[1][2]) / stated[2][2]);
        let (mean, difference) = (0.5 * (stated[0][0] + stated[1][1]), 0.5 * (stated[0][0] - stated[1][1]));
        let narrowest = mean - difference.hypot(stated[0][1]) / LEAST_BLUR;
        if narrowest > 4.0 * swing * swing {
            prop_assert!(added < 1e-14, "{whole:?} {stated:?}");
        }
    }
}

#[test]
fn a_row_that_states_its_covariance_has_it_and_no_noise_explains_it() {
    let stated = [[0.04, 0.01, 0.002], [0.01, 0.05, 0.004], [0.002, 0.004, 0.01]];
    let correction = Correction { distance_gain: 1.1, ..Correction::default() };
    let model = Motion::Increments(Increments { correction, ..Increments::default() });
    let part = RowPart { covariance: Some(stated), ..RowPart::whole([1.0, 0.1, 0.2], 0.5) };
    let (motion, by_noise) = model.with_noises(&part).unwrap();
    assert!(worst(&motion.covariance, &stated) < 1e-15, "{motion:?}");
    assert_eq!(by_noise.covariances, [[[0.0; 3]; 3]; 3]);
    // The correction still holds: it says what was driven.
    assert_eq!(motion.mean, model.of(&RowPart::whole([1.0, 0.1, 0.2], 0.5)).unwrap().mean);
    let half = RowPart { share: 0.5, ..part };
    assert!((model.of(&half).unwrap().covariance[2][2] - 0.005).abs() < 1e-15);
}

#[test]
fn straight_rows_have_the_variances_of_the_documentation() {
    // A heading error that grows evenly over 2 m: half of it by the middle, L² σ² / 3 aside, L σ² / 2 with the heading.
    let velocity = Velocity { speed_std_m_per_s: 0.1, yaw_rate_std_rad_per_s: 0.06, ..Velocity::default() };
    let covariance = velocity.row([4.0, 0.0, 0.0], 0.5).part(1.0).covariance;
    let turn = 0.03_f64 * 0.03;
    let expected = [[0.0025, 0.0, 0.0], [0.0, 4.0 * turn / 3.0, turn], [0.0, turn, turn]];
    assert!(worst(&covariance, &expected) < 1e-16, "{covariance:?}");
    // The same over a period of 2 s: four times the variance of a row of half a second.
    let slow = Velocity { noise_period_s: Some(2.0), ..velocity };
    let covariance = slow.row([4.0, 0.0, 0.0], 0.5).part(1.0).covariance;
    assert!(worst(&covariance, &expected.map(|row| row.map(|v| 4.0 * v))) < 1e-16, "{covariance:?}");
    // Displacements keep what they state where a diffusion can; 3 m and 0.1 rad need 0.3 / √12 m aside.
    let wide = Increments { x_std_m: 0.1, y_std_m: 0.2, heading_std_rad: 0.1, ..Increments::default() };
    let covariance = wide.row([3.0, 0.0, 0.0], 1.0).part(1.0).covariance;
    assert!(worst(&covariance, &[[0.01, 0.0, 0.0], [0.0, 0.04, 0.0], [0.0, 0.0, 0.01]]) < 1e-15, "{covariance:?}");
    let narrow = Increments { y_std_m: 0.0, ..wide };
    let covariance = narrow.row([3.0, 0.0, 0.0], 1.0).part(1.0).covariance;
    assert!(
        worst(&covariance, &[[0.01, 0.0, 0.0], [0.0, 0.09 / 12.0, 0.0], [0.0, 0.0, 0.01]]) < 1e-15,
        "{covariance:?}"
    );
}

#[test]
fn noise_in_proportion_grows_with_way_and_turn() {
    let proportional = Proportional {
        distance_std_m_per_sqrt_m: 0.1,
        lateral_std_m_per_sqrt_m: 0.2,
        turn_std_rad_per_sqrt_m: 0.3,
        turn_std_rad_per_sqrt_rad: 0.4,
    };
    let [ahead, aside, turn] = proportional.variances([-3.0, 4.0, -0.5]);
    assert!((ahead - 0.05).abs() < 1e-15 && (aside - 0.2).abs() < 1e-15 && (turn - (0.45 + 0.08)).abs() < 1e-15);
    let base = Velocity { yaw_rate_std_rad_per_s: 0.0, ..Velocity::default() };
    let heading = |row: RowMotion| row.part(1.0).covariance[2][2];
    let velocity = Velocity { proportional, ..base };
    assert!((heading(velocity.row([-5.0, -0.5, 0.0], 1.0)) - 0.53).abs() < 1e-15);
    assert_eq!(heading(velocity.row([0.0, 0.0, 0.0], 1.0)), 0.0);
}

#[test]
fn gains_and_bias_make_the_truth_of_what_is_reported() {
    let correction = Correction { distance_gain: 1.1, turn_gain: 0.64, yaw_rate_bias_rad_per_s: 0.05 };
    let expected = [1.1 * 2.0, 0.0, 0.64 * 0.3 + 0.05 * 0.4];
    let velocity = Velocity { correction, ..Velocity::default() }.row([5.0, 0.75, 0.0], 0.4).twist;
    let arc = Pose::from_twist(2.0, 0.0, 0.3).to_array();
    let increments = Increments { correction, ..Increments::default() }.row(arc, 0.4).twist;
    let odometry = Odometry { correction, ..Odometry::default() }.row(arc, 0.4).twist;
    for twist in [velocity, increments, odometry] {
        assert!(twist.iter().zip(expected).all(|(got, want)| (got - want).abs() < 1e-14), "{twist:?}");
        let back = correction.report_of(twist, 0.4);
        assert!(back.iter().zip([2.0, 0.0, 0.3]).all(|(got, want)| (got - want).abs() < 1e-14), "{back:?}");
    }
}

#[test]
fn settings_out_of_range_are_named() {
    let zero = Correction { turn_gain: 0.0, ..Correction::default() };
    let lost = Correction { yaw_rate_bias_rad_per_s: f64::NAN, ..Correction::default() };
    let negative = Proportional { turn_std_rad_per_sqrt_m: -1.0, ..Proportional::default() };
    let message = |motion: Motion| motion.validate().unwrap_err().to_string();
    let velocity = |correction| message(Motion::Velocity(Velocity { correction, ..Velocity::default() }));
    let car = |steering_gain| Motion::Ackermann(Ackermann { steering_gain, ..Ackermann::default() });
    let still = Velocity { speed_std_m_per_s: 0.0, ..Velocity::default() };
    for (message, expected) in [
        (velocity(zero), "motion.correction.turn_gain: got 0, expected a finite number other than 0"),
        (velocity(lost), "motion.correction.yaw_rate_bias_rad_per_s: got NaN, expected a finite number"),
        (
            message(Motion::Increments(Increments { proportional: negative, ..Increments::default() })),
            "motion.proportional.turn_std_rad_per_sqrt_m: got -1, expected a finite number, at least 0",
        ),
        (message(car(0.0)), "motion.steering_gain: got 0, expected a finite number other than 0"),
        (message(Motion::Velocity(still.clone())), "motion.speed_std_m_per_s: got 0, expected a finite number above 0"),
    ] {
        assert!(message.starts_with(expected), "{message}");
    }
    let rolling = Proportional { distance_std_m_per_sqrt_m: 0.1, ..Proportional::default() };
    assert_eq!(Motion::Velocity(Velocity { proportional: rolling, ..still }).validate(), Ok(()));
}

#[test]
fn a_motion_that_is_not_finite_is_an_error() {
    let motion = Motion::default();
    for part in [
        RowPart::whole([1.0, 0.0, 0.0], f64::NAN),
        RowPart::whole([1.0, 0.0, 0.0], 1e308),
        RowPart::whole([1e6, 1e6, 0.0], f64::INFINITY),
        RowPart::whole([f64::INFINITY, 0.0, 0.0], 1.0),
        RowPart::whole([1.0, 0.0, 0.0], -1.0),
    ] {
        assert!(matches!(motion.of(&part), Err(Error::Input(_))), "{part:?}");
    }
}

#[test]
fn the_linearised_motion_has_the_moments_of_the_samples() {
    // Small noise, so that linearisation errors stay below the standard error of 40,000 samples.
    let control = [3.0, 0.2, 0.0];
    let (n, steps) = (40_000_usize, 4_u64);
    let car = Ackermann { speed_std_m_per_s: 0.4, steering_std_rad: 0.05, ..Ackermann::default() };
    let slipping = Velocity { lateral_std_m_per_s: 0.1, yaw_rate_std_rad_per_s: 0.02, ..Velocity::default() };
    let arrows = Increments { x_std_m: 0.03, y_std_m: 0.0, heading_std_rad: 0.01, ..Increments::default() };
    for motion in [Motion::Ackermann(car), Motion::Velocity(slipping), Motion::Increments(arrows)] {
        let (mut x, mut y, mut heading) = (vec![0.0; n], vec![0.0; n], vec![0.0; n]);
        let mut gaussian = MotionGaussian::default();
        for step in 0..steps {
            let stream = RandomSource::new(11).stream(Purpose::Motion, step);
            let part = motion.of(&RowPart::whole(control, 0.1)).unwrap();
            part.sample(stream, PoseColumns { first_particle: 0, x: &mut x, y: &mut y, heading: &mut heading });
            gaussian = gaussian.then(&part);
        }
        let columns = [&x, &y, &heading];
        let mean = columns.map(|c| c.iter().sum::<f64>() / n as f64);
        for (i, expected) in gaussian.mean.to_array().into_iter().enumerate() {
            let bound = 5.0 * (gaussian.covariance[i][i] / n as f64).sqrt() + 3e-4;
            assert!((mean[i] - expected).abs() < bound, "{motion:?} mean {i}: {} against {expected}", mean[i]);
            for j in 0..3 {
                let covariance =
                    columns[i].iter().zip(columns[j]).map(|(a, b)| (a - mean[i]) * (b - mean[j])).sum::<f64>()
                        / n as f64;
                // The sample covariance of a Gaussian has standard error √(2/n) = 0.7 % of the deviations at most.
                let size = (gaussian.covariance[i][i] * gaussian.covariance[j][j]).sqrt();
                let apart = (covariance - gaussian.covariance[i][j]).abs() / size;
                assert!(apart < 0.04, "{motion:?} covariance {i}, {j}: off by {apart}");
            }
        }
    }
}

#[test]
fn the_covariance_turns_with_the_heading() {
    let motion = MotionGaussian {
        mean: Pose::default(),
        covariance: [[0.3, 0.05, 0.02], [0.05, 0.2, -0.01], [0.02, -0.01, 0.1]],
    };
    let (s, c) = libm::sincos(0.7);
    let expected = transform3(&[[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]], &motion.covariance);
    assert!(worst(&motion.covariance_in_world(0.7), &expected) < 1e-15);
}
