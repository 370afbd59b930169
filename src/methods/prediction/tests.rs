//! Comparison with the machine of paper 4, computed by plain matrix products.

use nalgebra::{Matrix3, Vector3};

use super::{ErrorPredictor, WorkZero, WorkpieceTransform};
use crate::identification::StatedStylusUncertainty;
use crate::samba::tests::reference_machine::{BcsAnglesRad, ReferenceMachine};
use crate::samba::tests::{built_in, exact_estimate, paper_errors};
use machine::record::estimate::Estimate;
use machine::record::machine::Machine;
use machine::record::plan::Plan;
use machine::record::reading::Reading;
use machine::{Axis, Position};

const POSES: [([f64; 3], BcsAnglesRad); 4] = [
    ([120.0, -80.0, 400.0], [0.0, 0.0, 0.0]),
    ([-200.0, 150.0, 500.0], [0.7, 2.0, 0.0]),
    ([50.0, 60.0, 330.0], [-1.2, -3.0, 1.5]),
    ([0.0, 0.0, 326.7], [1.5, 0.5, 0.0]),
];

/// A stylus of exactly the stated length, on the axis of the spindle.
const STATED: StatedStylusUncertainty = StatedStylusUncertainty { offset_u_mm: Some(0.0), length_u_mm: Some(0.0) };

fn machine() -> Machine {
    built_in::built_in_plan().machine
}

fn position(xyz: [f64; 3], [b, c, s]: BcsAnglesRad) -> Position {
    Position::from_xyz(Vector3::from(xyz)).with(Axis::B, b).with(Axis::C, c).with(Axis::S, s)
}

fn estimate_with_measured_ranges() -> Estimate {
    let mut estimate = exact_estimate();
    estimate.measured_ranges = [(Axis::B, [-90.0, 90.0]), (Axis::X, [-300.0, 300.0])].into();
    estimate
}

#[test]
fn predicted_errors_equal_those_of_matrix_products() {
    let (machine, estimate) = (machine(), estimate_with_measured_ranges());
    let tool = Vector3::from(machine.tool_mm);
    let truth = ReferenceMachine { errors: paper_errors().into_iter().collect(), tool };
    let nominal = ReferenceMachine { errors: Default::default(), tool };
    let off = |xyz: [f64; 3], bcs_rad| {
        truth.tip_in_table(Vector3::from(xyz), bcs_rad) - nominal.tip_in_table(Vector3::from(xyz), bcs_rad)
    };
    let along = Vector3::z() * 100.0;
    let direction = |xyz: [f64; 3], bcs_rad| {
        let of = |of: &ReferenceMachine| {
            let above = ReferenceMachine { errors: of.errors.clone(), tool: tool + along };
            let xyz = Vector3::from(xyz);
            (above.tip_in_table(xyz, bcs_rad) - of.tip_in_table(xyz, bcs_rad)) / along.norm()
        };
        of(&truth) - of(&nominal)
    };
    // The tip is on the origin of the table.
    let zero = ([0.0, 0.0, -machine.tool_mm[2]], [0.0; 3]);
    let predictor = ErrorPredictor::new(&machine, STATED, &estimate, WorkZero::TableOrigin).unwrap();
    for (xyz, bcs_rad) in POSES {
        let predicted = predictor.pose_error(&position(xyz, bcs_rad));
        let expected = off(xyz, bcs_rad) - off(zero.0, zero.1);
        assert!((predicted.tip_error_mm - expected).norm() < 1e-9, "{predicted:?} {expected}");
        assert!((predicted.direction_error_rad - direction(xyz, bcs_rad)).norm() < 1e-9);
    }
    let elsewhere = position(POSES[1].0, POSES[1].1);
    let predictor = ErrorPredictor::new(&machine, STATED, &estimate, WorkZero::Pose(elsewhere.clone())).unwrap();
    assert!(predictor.pose_error(&elsewhere).tip_error_mm.norm() < 1e-12);
}

/// Without tool centre point control the tip has no error at the origin of the table, at each position of the
/// rotary axes.
#[test]
fn work_zero_is_reset_without_tool_centre_control() {
    let (machine, estimate) = (machine(), estimate_with_measured_ranges());
    let tool = Vector3::from(machine.tool_mm);
    let truth = ReferenceMachine { errors: paper_errors().into_iter().collect(), tool };
    let nominal = ReferenceMachine { errors: Default::default(), tool };
    let predictor = ErrorPredictor::new(&machine, STATED, &estimate, WorkZero::EachRotaryPosition).unwrap();
    for (xyz, bcs_rad) in POSES {
        let off = |xyz: Vector3<f64>| truth.tip_in_table(xyz, bcs_rad) - nominal.tip_in_table(xyz, bcs_rad);
        // The nominal tip position is linear in X, Y and Z: a linear system gives the X, Y and Z with the tip
        // at the origin.
        let at_zero = nominal.tip_in_table(Vector3::zeros(), bcs_rad);
        let axis = |k: usize| nominal.tip_in_table(Vector3::ith(k, 1.0), bcs_rad) - at_zero;
        let columns = Matrix3::from_columns(&[axis(0), axis(1), axis(2)]);
        let zero = -columns.try_inverse().unwrap() * at_zero;
        let expected = off(Vector3::from(xyz)) - off(zero);
        let predicted = predictor.pose_error(&position(xyz, bcs_rad)).tip_error_mm;
        assert!((predicted - expected).norm() < 1e-9, "{predicted} {expected}");
    }
}

/// A correction removes the error and leaves its uncertainty. An offset of C of u = 2 µm moves the tip by
/// twice its value at C = 180°. The absolute value of a normal quantity is below 2u with the probability of k
/// = 2.
#[test]
fn correction_removes_the_error_and_leaves_its_uncertainty() {
    let mut estimate = estimate_with_measured_ranges();
    let offset = estimate.covariance.symbols.iter().position(|own| own == "EX0C").unwrap();
    estimate.covariance.rows.iter_mut().flatten().for_each(|entry| *entry = 0.0);
    estimate.covariance.rows[offset][offset] = 4.0;
    let machine = machine();
    let new = || ErrorPredictor::new(&machine, STATED, &estimate, WorkZero::TableOrigin).unwrap();
    let symbols = new().predicted_error_symbols().to_vec();
    let half_turn = position([30.0, 20.0, 400.0], [0.0, std::f64::consts::PI, 0.0]);
    let corrected = new().with_corrected_errors(&symbols).unwrap();
    assert!(corrected.pose_error(&half_turn).tip_error_mm.norm() < 1e-12);
    let [error, _] = corrected
        .volume_errors(std::slice::from_ref(&half_turn), &corrected.tip_errors(std::slice::from_ref(&half_turn)));
    assert!((error.largest_95_percent_bound_mm * 1e3 - 8.0).abs() < 1.2, "{error:?}");
    let rest = new().with_corrected_errors(&["EX0C"]).unwrap().pose_error(&half_turn).tip_error_mm;
    let mut without = paper_errors();
    without.iter_mut().filter(|(symbol, _)| symbol == "EX0C").for_each(|(_, value)| *value = 0.0);
    let tool = Vector3::from(machine.tool_mm);
    let (truth, nominal) = (
        ReferenceMachine { errors: without.into_iter().collect(), tool },
        ReferenceMachine { errors: Default::default(), tool },
    );
    let off = |xyz: Vector3<f64>, bcs_rad| truth.tip_in_table(xyz, bcs_rad) - nominal.tip_in_table(xyz, bcs_rad);
    let expected = off(Vector3::new(30.0, 20.0, 400.0), [0.0, std::f64::consts::PI, 0.0])
        - off(Vector3::new(0.0, 0.0, -tool.z), [0.0; 3]);
    assert!((rest - expected).norm() < 1e-9, "{rest} {expected}");
    assert!(new().with_corrected_errors(&["EX9C"]).is_err_and(|why| why.remedy.contains("EX0C")));
}

/// The values of slices are the errors of single poses with the other axes as given.
#[test]
fn slice_values_equal_the_errors_of_single_poses() {
    let (machine, mut estimate) = (machine(), estimate_with_measured_ranges());
    estimate.measured_ranges.extend([(Axis::C, [0.0, 360.0]), (Axis::Y, [-100.0, 100.0]), (Axis::Z, [300.0, 500.0])]);
    let predictor = ErrorPredictor::new(&machine, STATED, &estimate, WorkZero::TableOrigin).unwrap();
    let tilted = position([0.0; 3], [0.5, 1.0, 0.0]);
    let slices = predictor.xy_and_rotary_error_slices(&tilted).unwrap();
    assert_eq!(slices.len(), 5);
    let at = predictor.pose_error(&position([300.0, -100.0, 400.0], [0.0; 3]));
    assert!((slices[0].error_mm[0][6] - at.tip_error_mm.norm()).abs() < 1e-12);
    let at = predictor.pose_error(&position([300.0, -100.0, 500.0], [0.5, 1.0, 0.0]));
    let (error, u) = (slices[3].error_mm[0][6], slices[3].u_mm[0][6]);
    assert_eq!((error, u), (at.tip_error_mm.norm(), at.u_tip_error_mm.norm()));
    let at = predictor.pose_error(&position([0.0, 0.0, 400.0], [-90_f64.to_radians(), std::f64::consts::TAU, 0.0]));
    assert!((slices[4].error_mm[0][6] - at.tip_error_mm.norm()).abs() < 1e-12);
    assert_eq!((slices[4].horizontal_axis.0, slices[4].vertical_axis.0), (Axis::C, Axis::B));
    estimate.measured_ranges.clear();
    assert!(
        ErrorPredictor::new(&machine, STATED, &estimate, WorkZero::TableOrigin)
            .unwrap()
            .xy_and_rotary_error_slices(&tilted)
            .is_err()
    );
}

/// An offset of C along X with the work zero at C = 0: the uncertainty of the tip is twice that of the offset
/// at C = 180°, and equal along X and Y at 90°.
#[test]
fn uncertainty_is_relative_to_the_work_zero() {
    let mut estimate = estimate_with_measured_ranges();
    let of = |symbol: &str| estimate.covariance.symbols.iter().position(|own| own == symbol).unwrap();
    let (offset, angle) = (of("EX0C"), of("EA0Y"));
    estimate.covariance.rows[offset][offset] = 4.0;
    let mut predictor = ErrorPredictor::new(&machine(), STATED, &estimate, WorkZero::TableOrigin).unwrap();
    let u = |c: f64, predictor: &ErrorPredictor<'_>| {
        predictor.pose_error(&position([30.0, 20.0, 400.0], [0.0, c, 0.0])).u_tip_error_mm * 1e3
    };
    let near = |u: Vector3<f64>, expected: [f64; 3]| {
        assert!((u - Vector3::from(expected)).norm() < 0.01, "{u} {expected:?}");
    };
    near(u(0.0, &predictor), [0.0, 0.0, 0.0]);
    near(u(std::f64::consts::PI, &predictor), [4.0, 0.0, 0.0]);
    near(u(std::f64::consts::FRAC_PI_2, &predictor), [2.0, 2.0, 0.0]);
    // 3 µrad about X: the uncertainty of the direction is all along Y.
    estimate.covariance.rows[offset][offset] = 0.0;
    estimate.covariance.rows[angle][angle] = 9.0;
    predictor = ErrorPredictor::new(&machine(), STATED, &estimate, WorkZero::TableOrigin).unwrap();
    let pose = predictor.pose_error(&position([0.0, 0.0, 400.0], [0.0; 3]));
    near(pose.u_direction_error_rad * 1e6, [0.0, 3.0, 0.0]);
}

#[test]
fn prediction_outside_the_measured_ranges_is_refused() {
    let (machine, mut estimate) = (machine(), estimate_with_measured_ranges());
    let predictor = ErrorPredictor::new(&machine, STATED, &estimate, WorkZero::TableOrigin).unwrap();
    assert!(predictor.check_measured_range(&Position::new().with(Axis::X, 250.0).with(Axis::B, 1.0)).is_ok());
    let why = predictor.check_measured_range(&position([350.0, 0.0, 0.0], [0.0; 3])).unwrap_err().reason;
    assert!(why.contains("X 350.000 is outside -300.000 to 300.000"), "{why}");
    // An axis that the pose does not name is at 0.
    let why = predictor.check_measured_range(&Position::new().with(Axis::C, 1.0)).unwrap_err().reason;
    assert!(why.contains("C 57.296 was not measured"), "{why}");
    estimate.measured_ranges.insert(Axis::Z, [300.0, 500.0]);
    let predictor = ErrorPredictor::new(&machine, STATED, &estimate, WorkZero::TableOrigin).unwrap();
    let why = predictor.check_measured_range(&Position::new().with(Axis::X, 1.0)).unwrap_err().reason;
    assert!(why.contains("Z 0.000 is outside 300.000 to 500.000"), "{why}");
    estimate.measured_ranges.clear();
    let predictor = ErrorPredictor::new(&machine, STATED, &estimate, WorkZero::TableOrigin).unwrap();
    assert!(predictor.check_measured_range(&Position::new()).unwrap_err().reason.contains("does not contain"));
    // An estimate of another machine.
    let mut other = machine.clone();
    other.topology = other.topology.replace('B', "A");
    let axis = other.axes.remove(&Axis::B).unwrap();
    other.axes.insert(Axis::A, axis);
    let why = ErrorPredictor::new(&other, STATED, &estimate, WorkZero::TableOrigin).err().unwrap().reason;
    assert!(why.contains("is of another machine: this machine has no EA0B, EC0B"), "{why}");
    estimate.parameters.clear();
    assert!(ErrorPredictor::new(&machine, STATED, &estimate, WorkZero::TableOrigin).is_err());
}

/// Reading of this machine with its stylus at `place` of the table.
fn touch_reading(truth: &ReferenceMachine, place: Vector3<f64>, bcs_rad: BcsAnglesRad) -> Reading {
    Reading {
        step: 1,
        repeat: 0,
        position: position(truth.axis_positions_at_ball(place, bcs_rad).into(), bcs_rad),
        value_mm: None,
        sensor: "probe".to_owned(),
        t_s: 0.0,
        flag: Default::default(),
        temperatures_c: Default::default(),
    }
}

/// A touch read by the machine of the paper with its stylus at a known place of the table.
#[test]
fn touch_gives_its_true_ball_centre_and_uncertainty() {
    let (mut plan, mut estimate) = (built_in::built_in_plan(), estimate_with_measured_ranges());
    plan.probe.lobing_um = 0.0;
    plan.probe.u_stylus_offset_um = 0.0;
    for spec in plan.machine.axes.values_mut() {
        (spec.error_motion_um, spec.resolution_um) = (0.0, 0.0);
    }
    let tool = Vector3::from(plan.machine.tool_mm);
    let truth = ReferenceMachine { errors: paper_errors().into_iter().collect(), tool };
    let place = Vector3::new(110.0, -70.0, 90.0);
    let (_, bcs_rad) = POSES[1];
    let reading = touch_reading(&truth, place, bcs_rad);
    let point = |plan: &Plan, estimate: Option<&Estimate>| {
        WorkpieceTransform::new(plan, estimate).unwrap().point_in_workpiece_frame(&reading).unwrap()
    };
    let calibrated = point(&plan, Some(&estimate));
    assert!((calibrated.position_mm - place).norm() < 1e-9, "{calibrated:?}");
    // The uncertainty is that of the touch alone: 0.5 µm, as the machine file declares.
    assert!((calibrated.u_mm - Vector3::repeat(0.5e-3)).norm() < 1e-9);
    let nominal = point(&plan, None);
    let off = (nominal.position_mm - place).norm();
    assert!(off > 0.02 && off < 0.3 && nominal.u_mm == calibrated.u_mm, "{off}");
    let offset = estimate.covariance.symbols.iter().position(|own| own == "EX0C").unwrap();
    estimate.covariance.rows[offset][offset] = 4.0;
    // Uncertainty of 2 µm along X of the table at C = 114.6°.
    let u = point(&plan, Some(&estimate)).u_mm * 1e3;
    let expected = Vector3::new(2.0 * bcs_rad[1].cos(), 2.0 * bcs_rad[1].sin(), 0.0);
    assert!((u - expected.map(|part: f64| part.hypot(0.5))).norm() < 0.01, "{u} {expected}");
    // Contributions: 3 µm, 4 µm and 12 µm of the probe and the axes, rounding by 1 µm, and drift of 5 µm/h
    // for an hour.
    estimate.covariance.rows[offset][offset] = 0.0;
    plan.probe.repeatability_um = Some(3.0);
    plan.probe.lobing_um = 4.0;
    plan.machine.axes.get_mut(&Axis::B).unwrap().error_motion_um = 12.0;
    plan.machine.axes.get_mut(&Axis::X).unwrap().resolution_um = 1.0;
    plan.machine.drift_um_per_h = 5.0;
    let later = Reading { t_s: 3600.0, ..reading.clone() };
    let u =
        WorkpieceTransform::new(&plan, Some(&estimate)).unwrap().point_in_workpiece_frame(&later).unwrap().u_mm * 1e3;
    assert!((u - Vector3::repeat((169.0_f64 + 1.0 / 12.0 + 25.0).sqrt())).norm() < 1e-6, "{u}");
}

/// The stylus and its uncertainty come from the estimate; the uncertainty of a stated stylus is that of its
/// offset.
#[test]
fn points_use_the_identified_stylus() {
    let (mut plan, mut estimate) = (built_in::built_in_plan(), estimate_with_measured_ranges());
    plan.probe.lobing_um = 0.0;
    plan.probe.repeatability_um = Some(0.0);
    for spec in plan.machine.axes.values_mut() {
        (spec.error_motion_um, spec.resolution_um) = (0.0, 0.0);
    }
    let stated = Vector3::from(plan.machine.tool_mm);
    let tool = stated + Vector3::new(0.02, -0.01, -0.017);
    let truth = ReferenceMachine { errors: paper_errors().into_iter().collect(), tool };
    let (place, bcs_rad) = (Vector3::new(110.0, -70.0, 90.0), POSES[2].1);
    let reading = touch_reading(&truth, place, bcs_rad);
    for (k, symbol) in ["tool_x", "tool_y", "tool_z"].into_iter().enumerate() {
        let found = serde_json::json!({"symbol": symbol, "value": tool[k], "unit": "mm", "u": 0.001, "U": 0.002,
            "k": 2.0, "dof": null, "identifiable": true});
        estimate.parameters.push(serde_json::from_value(found).unwrap());
        estimate.covariance.symbols.push(symbol.to_owned());
        estimate.covariance.rows.iter_mut().for_each(|row| row.push(0.0));
        let mut row = vec![0.0; estimate.covariance.symbols.len()];
        *row.last_mut().unwrap() = 1e-6;
        estimate.covariance.rows.push(row);
    }
    let frame = WorkpieceTransform::new(&plan, Some(&estimate)).unwrap();
    assert_eq!(frame.describe_stylus(), "stylus of the estimate");
    let point = frame.point_in_workpiece_frame(&reading).unwrap();
    assert!((point.position_mm - place).norm() < 1e-9, "{point:?}");
    assert!((point.u_mm - Vector3::repeat(1e-3)).norm() < 1e-6, "{point:?}");
    // 10 µm in each coordinate, as stylus_offset_um declares.
    plan.probe.u_stylus_offset_um = 10.0;
    let stated = WorkpieceTransform::new(&plan, None).unwrap().point_in_workpiece_frame(&reading).unwrap();
    assert!((stated.u_mm - Vector3::repeat(0.01)).norm() < 1e-6, "{stated:?}");
}

/// Errors of an offset e of C along X only: with the work zero at C = 0 the error is 2·e·sin(C/2), largest at
/// 180°.
#[test]
fn volume_errors_of_an_axis_offset_have_the_expected_size() {
    let mut estimate = estimate_with_measured_ranges();
    estimate.parameters.retain(|parameter| parameter.symbol == "EX0C");
    estimate.covariance.symbols = vec!["EX0C".to_owned()];
    estimate.covariance.rows = vec![vec![4.0]];
    estimate.measured_ranges = [(Axis::C, [0.0, 330.0]), (Axis::Z, [400.0, 400.0])].into();
    let predictor = ErrorPredictor::new(&machine(), STATED, &estimate, WorkZero::TableOrigin).unwrap();
    let poses = predictor.volume_grid_poses().unwrap();
    assert_eq!(poses.len(), 12);
    let [zeroed, fitted] = predictor.volume_errors(&poses, &predictor.tip_errors(&poses));
    assert_eq!(poses[zeroed.worst_pose_index].get_or_zero(Axis::C).to_degrees().round(), 180.0);
    let near = |value: f64, expected: f64, within: f64| {
        assert!((value - expected).abs() < within, "{value} {expected}");
    };
    near(zeroed.largest_mm, 0.210, 1e-9);
    // The u of the largest error is twice 2 µm, within the accuracy of the number of draws.
    near(zeroed.u_largest_mm, 4e-3, 0.6e-3);
    let mean = (0..12).map(|k| 0.21 * (f64::from(k) * 15.0).to_radians().sin()).sum::<f64>() / 12.0;
    near(zeroed.mean_mm, mean, 1e-9);
    assert!(fitted.largest_mm < zeroed.largest_mm);
}
