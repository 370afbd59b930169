//! The implied set on other machines is complete, without redundancy, and is recovered.

use std::f64::consts::TAU;

use nalgebra::{Matrix3, Vector3};

use super::machine;
use crate::samba::confounding::MeasuringConditions;
use crate::samba::fit::{GeometryProblem, LengthConstraint, ObservedValues, PlannedBallMeasurement};
use crate::samba::geometry_model::GeometryModel;
use crate::samba::parameters::implied_parameters;
use machine::kinematics::{ErrorShape, ErrorTerm, KinematicChain};
use machine::{Axis, Position, frame::Point};

const STYLUS_MM: Vector3<f64> = Vector3::new(0.03, -0.02, -150.0);

#[track_caller]
fn check_implied_errors_are_recovered(topology: &str, unknowns: usize) {
    let machine = machine(topology);
    let chain = KinematicChain::new(&machine).unwrap();
    let set = implied_parameters(MeasuringConditions { chain: &chain, fixed_axes: &[], length_directions: &[] });
    let value = |i: usize, angular: bool, gain: bool| {
        let scale = if angular || gain { 2e-5 } else { 0.05 };
        scale * (1.0 + i as f64 * 1.3).sin()
    };
    let terms: Vec<ErrorTerm> = set
        .iter()
        .enumerate()
        .map(|(i, parameter)| {
            let (angular, gain) = (!parameter.component().is_linear(), parameter.shape() == ErrorShape::Gain);
            ErrorTerm { parameter: *parameter, value: value(i, angular, gain) }
        })
        .collect();
    let balls: Vec<Vector3<f64>> = (0..5)
        .map(|i| f64::from(i) * 1.3)
        .map(|a| Vector3::new(150.0 * a.cos(), 140.0 * a.sin(), 60.0 + 25.0 * a))
        .collect();
    let rotary: Vec<Axis> = chain.topology().axes().filter(|a| !a.is_linear()).collect();
    let (mut places, mut seen, mut xyz) = (Vec::new(), Vec::new(), Vec::new());
    for pose in 0..24_u32 {
        let angle = |n: usize| (f64::from(pose) * [0.37, 0.59, 0.83][n]).fract() * TAU;
        let place: Position = rotary.iter().enumerate().map(|(n, axis)| (*axis, angle(n))).collect();
        for (ball, centre) in balls.iter().enumerate() {
            let (target, tip) = (Point::from_vec(*centre), Point::from_vec(STYLUS_MM));
            let linear = chain.solve_linear_axes(target, tip, &place, &terms).unwrap();
            xyz.push(linear.xyz_or_zero());
            let whitening = Matrix3::identity() / 1e-3;
            seen.push(PlannedBallMeasurement { rotary_position_index: places.len(), ball_index: ball, whitening });
        }
        places.push(place);
    }
    let model = GeometryModel::new(&machine, &set).unwrap();
    let bar = LengthConstraint { from_ball: 0, to_ball: 2, u_mm: 1e-4 };
    let measured = ObservedValues { centre_axes_mm: xyz, lengths_mm: vec![balls[0].metric_distance(&balls[2])] };
    let tool = Vector3::new(0.0, 0.0, STYLUS_MM.z);
    let problem = GeometryProblem::new(model, places, seen, vec![bar], balls.len(), tool);
    assert_eq!(problem.unknown_count(), unknowns, "{topology}");
    let found = problem.solve(&measured, problem.initial_values(&measured)).unwrap();
    let survey = found.factorisation.analyse_rank().unwrap();
    println!("{topology}: rank {}, condition {:.1}", survey.rank, survey.condition);
    assert_eq!((survey.rank, survey.nullity), (unknowns, 0));
    for (term, x) in terms.iter().zip(&found.x) {
        assert!((x - term.value).abs() < 1e-9, "{topology}, {}: {x}", term.parameter);
    }
}

#[test]
fn implied_errors_of_other_topologies_are_recovered() {
    check_implied_errors_are_recovered("wCBXFZYSt", 13 + 3 + 15);
    check_implied_errors_are_recovered("wCAYFXZt", 11 + 3 + 15);
    check_implied_errors_are_recovered("wAFXYZBt", 11 + 3 + 15);
    check_implied_errors_are_recovered("V[w-C-B-b-Y-X-Z-(C)-t]", 13 + 3 + 15);
    // No axis turns across the stylus: its length only shifts all balls and keeps its stated value.
    check_implied_errors_are_recovered("wCFXYZt", 7 + 2 + 15);
    check_implied_errors_are_recovered("wCFXYZSt", 9 + 2 + 15);
    // The length of the stylus keeps its stated value also with tables that tilt: the rotation shows the gain of Z
    // here, and not that of Y or X.
    check_implied_errors_are_recovered("wBFXYZt", 7 + 2 + 15);
    check_implied_errors_are_recovered("wAFXYZt", 7 + 2 + 15);
}
