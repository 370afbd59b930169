//! Error motions of B as Fourier series.

use nalgebra::Vector3;

use super::gate_g2::{TABLE_5_SYMBOLS, equations_of_42_poses_and_nominal_unknowns};
use super::ideal_plan;
use crate::laser_r_test::parameter_selection::select_parameters;
use machine::kinematics::KinematicChain;

const BALL_CENTRE_MM: Vector3<f64> = Vector3::new(80.0, 0.0, 60.0);

#[test]
fn second_harmonics_of_b_have_full_rank() {
    let (problem, x) = equations_of_42_poses_and_nominal_unknowns(&[], &[2], BALL_CENTRE_MM, 1e-3);
    let survey = problem.analyse_rank(&x).unwrap();
    println!("condition {}", survey.condition);
    assert_eq!((survey.rank, survey.nullity), (23, 0));
    assert!((survey.condition - 5.5).abs() < 0.1, "{}", survey.condition);
}

/// METHODS: two directions are not determined with {EA, EC}, four with {EX, EZ} as well. Two of B's first harmonics
/// equal the location of C. The others rotate or move the sphere with the table.
#[test]
fn first_harmonics_have_gauge_directions_that_are_held_and_named() {
    let lost = |motions: &[&str]| {
        let names = [&TABLE_5_SYMBOLS[..], motions].concat();
        let (problem, x) = equations_of_42_poses_and_nominal_unknowns(&names, &[], BALL_CENTRE_MM, 1e-3);
        problem.analyse_rank(&x).unwrap().nullity
    };
    let angles = ["EAB_cos1", "EAB_sin1", "ECB_cos1", "ECB_sin1"];
    assert_eq!(lost(&angles), 2);
    let places = ["EXB_cos1", "EXB_sin1", "EZB_cos1", "EZB_sin1"];
    assert_eq!(lost(&[&angles[..], &places].concat()), 4);

    let chain = KinematicChain::new(&ideal_plan(1.0).machine).unwrap();
    let chosen = select_parameters(&chain, &[], &[1]).unwrap();
    println!("{:#?}", chosen.gauge_lines);
    let held = chosen.gauge_lines.len();
    assert_eq!(chosen.parameters.len() + held, 5 + 12);
    let (problem, x) = equations_of_42_poses_and_nominal_unknowns(&[], &[1], BALL_CENTRE_MM, 1e-3);
    assert_eq!(problem.analyse_rank(&x).unwrap().nullity, 0);
    assert!(chosen.gauge_lines.iter().any(|line| line.contains("EA0C")), "{:?}", chosen.gauge_lines);
    assert!(chosen.gauge_lines.iter().any(|line| line.contains("EX0C")), "{:?}", chosen.gauge_lines);
}
