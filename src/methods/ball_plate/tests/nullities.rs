//! The null space of one revolution with M = 48 positions (METHODS section 5).

use estimation::linear::RANK_THRESHOLD;
use faer::Mat;
use nalgebra::Vector3;

use super::Setting;
use crate::ball_plate::basis::AngleBasis;
use crate::ball_plate::design::{stagger_balls, undetermined_harmonics};
use crate::ball_plate::equations::analyse_equation_rank;

const POSITIONS: usize = 48;

fn even(balls: usize) -> Vec<usize> {
    (0..balls).map(|ball| ball * POSITIONS / balls).collect()
}

/// Nullity and condition (unscaled, for a plate of radius 1) with a value for each stop.
fn surveyed(steps: Vec<usize>, with_gauge: bool) -> (usize, f64) {
    let setting = Setting { positions: POSITIONS, revolutions: 1, radius_mm: 1.0, steps };
    let layout = setting.layout(AngleBasis::Stops(POSITIONS));
    let observations = setting.observations(|_, _, _| Some(Vector3::zeros()));
    let survey = analyse_equation_rank(&layout, &setting.stops(), &observations, with_gauge).unwrap();
    (survey.nullity, survey.condition_unscaled)
}

#[test]
fn even_balls_lose_the_multiples_of_their_number() {
    assert_eq!(surveyed(even(12), false).0, 31);
    assert_eq!(surveyed(even(6), false).0, 55);
    assert_eq!(undetermined_harmonics(&even(12), POSITIONS, 24), [12, 24]);
    assert_eq!(undetermined_harmonics(&even(6), POSITIONS, 24), [6, 12, 18, 24]);
}

#[test]
fn staggered_balls_lose_the_gauge_alone() {
    let (nullity, condition) = surveyed(vec![0, 5, 13, 22, 31, 41], false);
    println!("METHODS' layout: condition {condition:.2}");
    assert_eq!(nullity, 13);
    assert!((condition - 11.0).abs() < 0.5, "{condition}");
    for balls in [4, 6, 12] {
        let steps = stagger_balls(balls, POSITIONS);
        let (nullity, condition) = surveyed(steps.clone(), false);
        println!("{steps:?}: condition {condition:.2}");
        assert_eq!(nullity, 13, "{steps:?}");
        assert!(undetermined_harmonics(&steps, POSITIONS, POSITIONS / 2).is_empty());
    }
}

#[test]
fn gauge_conditions_reduce_the_nullity_by_13() {
    assert_eq!(surveyed(stagger_balls(6, POSITIONS), true).0, 0);
    assert_eq!(surveyed(even(12), true).0, 31 - 13);
}

/// METHODS section 5: condition (unscaled) of Eq. (2) with a constant, over three revolutions.
#[test]
fn subharmonics_need_as_many_revolutions() {
    let setting = Setting { positions: POSITIONS, revolutions: 3, radius_mm: 1.0, steps: even(12) };
    let condition = |sub_order: usize| {
        let basis = AngleBasis::Fourier { order: 8, sub_order };
        let rows: Vec<Vec<f64>> =
            setting.stops().iter().map(|stop| [vec![1.0], basis.function_values(stop.angle, 0)].concat()).collect();
        let a = Mat::from_fn(rows.len(), basis.function_count() + 1, |i, j| rows[i][j]);
        estimation::linear::analyse_rank(a.as_ref(), None, RANK_THRESHOLD).unwrap().condition_unscaled
    };
    let (enough, too_many) = (condition(3), condition(4));
    println!("condition {enough:.2} up to θ/3, {too_many:.1} up to θ/4");
    assert!((enough - 3.6).abs() < 0.05 && (too_many - 175.0).abs() < 0.5, "{enough} {too_many}");
}
