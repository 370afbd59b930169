//! A work offset as centre of rotation: a program that turns the workpiece about the work zero.

use super::*;
use machine::kinematics::{ErrorParameter, ErrorShape, ErrorTerm};

/// X and Y of C, and Z of B, with three decimals.
fn control([x, y, z]: [f64; 3]) -> ControlModel {
    let value = |axis: Axis, component: Axis, mm: f64| {
        let value = ControlValue { name: format!("G55 {component}"), present_mm: mm, text: mm.to_string() };
        (RotaryAxisCoordinate { axis, component }, value)
    };
    ControlModel::work_offset(
        vec![value(Axis::C, Axis::X, x), value(Axis::C, Axis::Y, y), value(Axis::B, Axis::Z, z)],
        3,
    )
}

fn proposed_mm(estimate: &Estimate, present: [f64; 3]) -> Proposal {
    let measured = MeasuredAxisPositions::new(&trunnion(Axis::B), STATED, estimate).unwrap();
    propose(&measured, &control(present), OPTIONS).unwrap()
}

/// With a wrong sign the tool would be off by four times the displacement of the axis.
#[test]
fn a_turn_about_the_proposed_zero_moves_no_point_of_the_workpiece() {
    for sign in [1.0, -1.0] {
        let machine = trunnion(Axis::B);
        let mut estimate = estimate_of("self-calibration", &[("EX0C", 40.0 * sign), ("EY0C", -30.0 * sign)], &[]);
        estimate.location_at_mm = Some([0.0, 0.0, 75.0]);
        let proposal = proposed_mm(&estimate, [0.0, 0.0, -50.4]);
        let kept: Vec<bool> = proposal.positions.iter().map(|position| position.kept.is_some()).collect();
        assert_eq!(kept, [false, false, true], "{proposal:?}");
        let values: Vec<f64> = proposal.values.iter().map(|value| value.proposed_mm).collect();
        assert_eq!(values, [0.04 * sign, -0.03 * sign, -50.4]);
        let chain = KinematicChain::new(&machine).unwrap();
        let location = |component: Axis, value: f64| ErrorTerm {
            parameter: ErrorParameter::new(component, Axis::C, ErrorShape::Location).unwrap(),
            value,
        };
        let truth = [location(Axis::X, 0.04 * sign), location(Axis::Y, -0.03 * sign)];
        let tip = Point::from_vec(Vector3::from(machine.tool_mm));
        let point_on_table = |[zero_x, zero_y]: [f64; 2], [x, y]: [f64; 2], c: f64| {
            let at = Position::from_xyz(Vector3::new(zero_x + x, zero_y + y, 100.0)).with(Axis::C, c);
            chain.tip_in_table(&at, tip, &truth).mm
        };
        let shift = |zero: [f64; 2]| {
            let half_turn = std::f64::consts::PI;
            (point_on_table(zero, [60.0, 20.0], 0.0) - point_on_table(zero, [-60.0, -20.0], half_turn)).norm()
        };
        assert!((shift([0.0, 0.0]) - 0.1).abs() < 1e-6, "{}", shift([0.0, 0.0]));
        assert!(shift([values[0], values[1]]) < 1e-9, "{}", shift([values[0], values[1]]));
    }
}

/// The control states three decimals: a nearer value cannot be read back.
#[test]
fn values_have_the_decimals_of_the_control() {
    let mut estimate = estimate_of("self-calibration", &[("EX0C", 40.4), ("EY0C", -30.6)], &[]);
    estimate.location_at_mm = Some([0.0, 0.0, 75.0]);
    let proposal = proposed_mm(&estimate, [0.0, 0.0, 0.0]);
    let values: Vec<f64> = proposal.values.iter().map(|value| value.proposed_mm).collect();
    assert_eq!(values, [0.04, -0.031, 0.0]);
    let unchanged = proposed_mm(&estimate, [0.04, -0.031, 0.0]);
    assert!(unchanged.values.iter().all(|value| value.proposed_mm == value.present_mm), "{unchanged:?}");
    assert!(!control([0.0; 3]).is_in_readings());
}
