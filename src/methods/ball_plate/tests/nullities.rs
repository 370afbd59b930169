//! The null space of one revolution with M = 48 positions (METHODS section 5).

use estimation::linear_least_squares::RANK_THRESHOLD;
use faer::Mat;
use nalgebra::Vector3;

use super::PlateSimulation;
use crate::ball_plate::angle_basis::AngleBasis;
use crate::ball_plate::design::{stagger_balls, undetermined_harmonics};
use crate::ball_plate::equations::analyse_equation_rank;

const MEASURING_POSITION_COUNT: usize = 48;

fn even_ball_steps(balls: usize) -> Vec<usize> {
    (0..balls).map(|ball| ball * MEASURING_POSITION_COUNT / balls).collect()
}

/// Nullity and unscaled condition number for a plate of radius 1, if each motion has a value for each stop.
fn nullity_and_condition(steps: Vec<usize>, with_gauge: bool) -> (usize, f64) {
    let setting = PlateSimulation {
        measuring_position_count: MEASURING_POSITION_COUNT,
        revolutions: 1,
        circle_radius_mm: 1.0,
        ball_steps: steps,
    };
    let layout = setting.layout(AngleBasis::ValuePerStop(MEASURING_POSITION_COUNT));
    let observations = setting.observations(|_, _, _| Some(Vector3::zeros()));
    let survey = analyse_equation_rank(&layout, &setting.stops(), &observations, with_gauge).unwrap();
    (survey.nullity, survey.condition_unscaled)
}

#[test]
fn evenly_spaced_balls_lose_harmonics_at_multiples_of_their_count() {
    assert_eq!(nullity_and_condition(even_ball_steps(12), false).0, 31);
    assert_eq!(nullity_and_condition(even_ball_steps(6), false).0, 55);
    assert_eq!(undetermined_harmonics(&even_ball_steps(12), MEASURING_POSITION_COUNT, 24), [12, 24]);
    assert_eq!(undetermined_harmonics(&even_ball_steps(6), MEASURING_POSITION_COUNT, 24), [6, 12, 18, 24]);
}

#[test]
fn staggered_balls_have_only_the_13_gauge_nullities() {
    let (nullity, condition) = nullity_and_condition(vec![0, 5, 13, 22, 31, 41], false);
    println!("METHODS' layout: condition {condition:.2}");
    assert_eq!(nullity, 13);
    assert!((condition - 11.0).abs() < 0.5, "{condition}");
    for balls in [4, 6, 12] {
        let steps = stagger_balls(balls, MEASURING_POSITION_COUNT);
        let (nullity, condition) = nullity_and_condition(steps.clone(), false);
        println!("{steps:?}: condition {condition:.2}");
        assert_eq!(nullity, 13, "{steps:?}");
        assert!(undetermined_harmonics(&steps, MEASURING_POSITION_COUNT, MEASURING_POSITION_COUNT / 2).is_empty());
    }
}

#[test]
fn gauge_conditions_reduce_the_nullity_by_13() {
    assert_eq!(nullity_and_condition(stagger_balls(6, MEASURING_POSITION_COUNT), true).0, 0);
    assert_eq!(nullity_and_condition(even_ball_steps(12), true).0, 31 - 13);
}

/// METHODS section 5: condition (unscaled) of Eq. (2) with a constant, over three revolutions.
#[test]
fn sub_harmonics_beyond_the_revolution_count_are_ill_conditioned() {
    let setting = PlateSimulation {
        measuring_position_count: MEASURING_POSITION_COUNT,
        revolutions: 3,
        circle_radius_mm: 1.0,
        ball_steps: even_ball_steps(12),
    };
    let condition = |sub_order: usize| {
        let basis = AngleBasis::Fourier { order: 8, sub_order };
        let rows: Vec<Vec<f64>> =
            setting.stops().iter().map(|stop| [vec![1.0], basis.function_values(stop.angle, 0)].concat()).collect();
        let a = Mat::from_fn(rows.len(), basis.function_count() + 1, |i, j| rows[i][j]);
        estimation::linear_least_squares::analyse_rank(a.as_ref(), None, RANK_THRESHOLD).unwrap().condition_unscaled
    };
    let (enough, too_many) = (condition(3), condition(4));
    println!("condition {enough:.2} up to θ/3, {too_many:.1} up to θ/4");
    assert!((enough - 3.6).abs() < 0.05 && (too_many - 175.0).abs() < 0.5, "{enough} {too_many}");
}
