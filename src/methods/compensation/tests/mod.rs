//! Comparison with LinuxCNC's own equations (`trtfuncs.c` of LinuxCNC 2.9), written here as rotations, and with the
//! machine of paper 4, computed by plain matrix products.

mod travel;
mod verification;
mod work_offset;

use nalgebra::{Rotation3, Vector3};

use super::*;
use crate::identification::StatedStylusUncertainty;
use crate::prediction::{ErrorPredictor, WorkZero};
use crate::samba::tests::built_in::built_in_plan;
use crate::samba::tests::paper_errors;
use crate::samba::tests::reference_machine::ReferenceMachine;
use machine::frame::Point;
use machine::kinematics::KinematicChain;
use machine::record::estimate::Estimate;
use machine::record::machine::{AxisSense, Machine};
use machine::{Axis, Position};

/// A stylus of exactly the stated length, on the axis of the spindle.
const STATED: StatedStylusUncertainty = StatedStylusUncertainty { offset_u_mm: Some(0.0), length_u_mm: Some(0.0) };
const OPTIONS: ProposalOptions = ProposalOptions { applies_insignificant_changes: false, max_change_mm: 0.5 };

/// Position of the tip X, Y, Z, mm, and the angles of the tilting axis and of C in the sense of LinuxCNC, rad.
type Pose = ([f64; 3], [f64; 2]);

const POSES: [Pose; 5] = [
    ([120.0, -80.0, 40.0], [0.0, 0.0]),
    ([-20.0, 150.0, 90.0], [0.7, 2.0]),
    ([50.0, 60.0, -30.0], [-1.0, -3.0]),
    ([0.0, 0.0, 26.7], [0.5, 1.5]),
    ([-90.0, 30.0, 0.0], [-0.4, 0.9]),
];

/// The kinematics of LinuxCNC with the pins of `xyzac-trt-kins` or `xyzbc-trt-kins`.
#[derive(Debug, Clone, Copy)]
struct TrunnionKinematics {
    tilt: Axis,
    pins: TrunnionPins,
}

impl TrunnionKinematics {
    fn rot_point(self) -> Vector3<f64> {
        Vector3::new(self.pins.x_rot_point, self.pins.y_rot_point, self.pins.z_rot_point)
    }

    fn offset(self) -> Vector3<f64> {
        across(self.tilt) * self.pins.offset + Vector3::z() * self.pins.z_offset
    }

    fn turns(self, [tilt_rad, c_rad]: [f64; 2]) -> [Rotation3<f64>; 2] {
        let tilt_axis = if self.tilt == Axis::A { Vector3::x_axis() } else { Vector3::y_axis() };
        [Rotation3::from_axis_angle(&tilt_axis, -tilt_rad), Rotation3::from_axis_angle(&Vector3::z_axis(), -c_rad)]
    }

    /// Position in the workpiece from joint positions.
    fn workpiece_from_joints(self, (joints, angles): Pose) -> Vector3<f64> {
        let [turn_tilt, turn_c] = self.turns(angles);
        let moved = turn_tilt * (Vector3::from(joints) - self.offset() - self.rot_point());
        self.rot_point() + turn_c * (moved + self.offset())
    }

    /// Joint positions from a position in the workpiece.
    fn joints_from_workpiece(self, (position, angles): Pose) -> Vector3<f64> {
        let [turn_tilt, turn_c] = self.turns(angles);
        let turned = turn_c.inverse() * (Vector3::from(position) - self.rot_point()) - self.offset();
        self.rot_point() + self.offset() + turn_tilt.inverse() * turned
    }

    fn model(self) -> ControlModel {
        ControlModel::linuxcnc_trunnion(self.tilt, self.pins)
    }

    fn with_values(self, proposal: &Proposal) -> Self {
        let mm = |index: usize| proposal.values[index].proposed_mm;
        let [x_rot_point, y_rot_point, z_rot_point, offset, z_offset] = [0, 1, 2, 3, 4].map(mm);
        Self { pins: TrunnionPins { x_rot_point, y_rot_point, z_rot_point, offset, z_offset }, ..self }
    }

    /// Errors of the tool at the poses, with a machine that moves as `tip_in_workpiece` says, relative to the first.
    fn tool_errors(self, tip_in_workpiece: impl Fn(Pose) -> Vector3<f64>) -> Vec<Vector3<f64>> {
        let error = |(position, angles): Pose| {
            tip_in_workpiece((self.joints_from_workpiece((position, angles)).into(), angles)) - Vector3::from(position)
        };
        POSES.into_iter().map(|pose| error(pose) - error(POSES[0])).collect()
    }
}

fn largest(errors: &[Vector3<f64>]) -> f64 {
    errors.iter().map(Vector3::norm).fold(0.0, f64::max)
}

/// A trunnion whose rotary axes turn as LinuxCNC's kinematics expect: opposite to ISO 841. Its C is at (0, 0), its
/// tilting axis 3 mm beside it in Y and at Z = −50 mm.
fn trunnion(tilt: Axis) -> Machine {
    let mut machine = built_in_plan().machine;
    if tilt == Axis::A {
        machine.topology = "w-C-A-Y-F-X-Z-S-t".to_owned();
        let stated = machine.axes.remove(&Axis::B).unwrap();
        machine.axes.insert(Axis::A, stated);
    }
    for (axis, point_mm) in [(tilt, [0.0, 3.0, -50.0]), (Axis::C, [0.0, 0.0, 10.0])] {
        let stated = machine.axes.get_mut(&axis).unwrap();
        (stated.positive, stated.point_mm) = (AxisSense::Reversed, point_mm);
    }
    machine
}

/// Horizontal direction across the tilting axis.
fn across(tilt: Axis) -> Vector3<f64> {
    if tilt == Axis::A { Vector3::y() } else { Vector3::x() }
}

/// A control that takes the axes of `trunnion` to be where they are stated.
fn nominal_control(tilt: Axis) -> TrunnionKinematics {
    // The 3 mm along Y count only across A.
    let offset = if tilt == Axis::A { 3.0 } else { 0.0 };
    let pins = TrunnionPins { x_rot_point: 0.0, y_rot_point: 0.0, z_rot_point: 5.0, offset, z_offset: -55.0 };
    TrunnionKinematics { tilt, pins }
}

fn position(tilt: Axis, (joints, [tilt_rad, c_rad]): Pose) -> Position {
    Position::from_xyz(Vector3::from(joints)).with(tilt, tilt_rad).with(Axis::C, c_rad)
}

#[test]
fn control_model_equals_the_equations_of_linuxcnc() {
    for tilt in [Axis::A, Axis::B] {
        let chain = KinematicChain::new(&trunnion(tilt)).unwrap();
        let pins = TrunnionPins { x_rot_point: 0.3, y_rot_point: -0.2, z_rot_point: 5.0, offset: 0.7, z_offset: -55.4 };
        let control = TrunnionKinematics { tilt, pins };
        let model = control.model();
        let errors = model.compensated_errors(&chain, &model.present_mm(), Some([0.0; 3]), |_| true).unwrap();
        let tip = |pose| chain.tip_in_table(&position(tilt, pose), Point::from_vec(Vector3::zeros()), &errors).mm;
        // LinuxCNC's workpiece frame is that of the machine at the first pose; ours moves with the errors of the axes.
        let shift = tip(POSES[0]) - control.workpiece_from_joints(POSES[0]);
        for pose in POSES {
            let difference = tip(pose) - shift - control.workpiece_from_joints(pose);
            assert!(difference.norm() < 1e-10, "{tilt} {pose:?}: {difference}");
        }
    }
}

/// An estimate of `method` with these values in their units (µm, µrad, µm/m; mm for the stylus), each with u = 0.5 µm
/// or
/// 0.5 µrad, u = 0.5 µm for the stylus.
fn estimate_of(method: &str, values: &[(&str, f64)], held_at_zero: &[&str]) -> Estimate {
    let unit_and_u = |symbol: &str| -> (&str, f64) {
        match symbol.as_bytes() {
            [b't', ..] => ("mm", 0.5e-3),
            [_, b'A'..=b'C', ..] => ("urad", 0.5),
            [.., b'1'] => ("um/m", 0.5),
            _ => ("um", 0.5),
        }
    };
    let parameter = |(symbol, value): &(&str, f64)| {
        let (unit, u) = unit_and_u(symbol);
        serde_json::json!({"symbol": symbol, "value": value, "unit": unit, "u": u, "U": 2.0 * u, "k": 2.0, "dof": null,
            "identifiable": true})
    };
    let symbols: Vec<&str> = values.iter().map(|(symbol, _)| *symbol).collect();
    let row = |i: usize| -> Vec<f64> {
        (0..symbols.len()).map(|j| if i == j { unit_and_u(symbols[i]).1.powi(2) } else { 0.0 }).collect()
    };
    serde_json::from_value(serde_json::json!({
        "trued_estimate": 1, "method": method, "parameters": values.iter().map(parameter).collect::<Vec<_>>(),
        "functions": [], "gauge": [],
        "covariance": {"symbols": symbols, "rows": (0..symbols.len()).map(row).collect::<Vec<_>>()},
        "held_at_zero": held_at_zero, "not_identifiable": [], "rank": 0, "unknowns": 0, "condition": 1.0,
        "residual_rms_um": 0.3, "degrees_of_freedom": 50, "chi2_per_dof": 1.0, "verdict": "none", "warnings": [],
        "priors": [], "measured": {"X": [-150.0, 150.0], "Y": [-150.0, 150.0]},
    }))
    .unwrap()
}

/// Location errors of a trunnion as SAMBA reports and holds them.
fn errors_of_trunnion(tilt: Axis) -> ([&'static str; 4], [&'static str; 4]) {
    match tilt {
        Axis::A => (["EX0C", "EY0C", "EX0S", "EY0S"], ["EX0A", "EY0A", "EZ0A", "EZ0S"]),
        _ => (["EX0C", "EY0C", "EX0S", "EY0S"], ["EX0B", "EY0B", "EZ0B", "EZ0S"]),
    }
}

fn propose_for(
    machine: &Machine,
    stylus: StatedStylusUncertainty,
    control: TrunnionKinematics,
    estimate: &Estimate,
) -> Result<Proposal, crate::MethodRefusal> {
    propose(&MeasuredAxisPositions::new(machine, stylus, estimate)?, &control.model(), OPTIONS)
}

/// Errors of both signs: with a wrong sign the error of the tool would double.
#[test]
fn proposal_decreases_the_tool_centre_error_to_the_resolution() {
    for (tilt, sign) in [(Axis::A, 1.0), (Axis::A, -1.0), (Axis::B, 1.0), (Axis::B, -1.0)] {
        let machine = trunnion(tilt);
        let (reported, held) = errors_of_trunnion(tilt);
        let um = [50.0, -40.0, 30.0, -60.0].map(|um| um * sign);
        // The tilting axis is 25 µm higher than stated: the stylus seems longer.
        let length = [("tool_z", machine.tool_mm[2] - 0.025 * sign)];
        let values: Vec<(&str, f64)> = reported.into_iter().zip(um).chain(length).collect();
        let before = nominal_control(tilt);
        let proposal = propose_for(&machine, STATED, before, &estimate_of("samba", &values, &held)).unwrap();
        assert!(proposal.positions.iter().all(|position| position.kept.is_none()), "{proposal:?}");
        // The axes as they truly are, relative to the spindle: C is carried by the tilting axis.
        let of_spindle = Vector3::new(um[2], um[3], 0.0) * 1e-3;
        let of_c = Vector3::new(um[0], um[1], 0.0) * 1e-3;
        let mut truth = before;
        truth.pins.x_rot_point += of_c.x - of_spindle.x;
        truth.pins.y_rot_point += of_c.y - of_spindle.y;
        truth.pins.offset -= of_c.dot(&across(tilt));
        truth.pins.z_offset += 0.025 * sign;
        let errors =
            |control: TrunnionKinematics| largest(&control.tool_errors(|joints| truth.workpiece_from_joints(joints)));
        let after = errors(before.with_values(&proposal));
        assert!(errors(before) > 0.05 && after < 3e-4, "{tilt} {}: {after}", errors(before));
        let is_in_steps = |value: &ProposedValue| value.proposed_mm == (value.proposed_mm * 1e4).round() / 1e4;
        assert!(proposal.values.iter().all(is_in_steps), "{proposal:?}");
    }
}

/// The machine of paper 4 with all its errors, of which the control corrects the positions only. The predicted error,
/// before and after, is the true one.
#[test]
fn predicted_errors_before_and_after_are_those_of_the_true_machine() {
    let mut machine = built_in_plan().machine;
    machine.tool_mm = [0.0, 0.0, machine.tool_mm[2]];
    let tool = Vector3::from(machine.tool_mm);
    let truth = ReferenceMachine { errors: paper_errors().into_iter().collect(), tool };
    let scaled = |(symbol, value): (String, f64)| {
        let is_position = symbol.starts_with("EX0") || symbol.starts_with("EY0");
        (symbol, value * if is_position { 1e3 } else { 1e6 })
    };
    let values: Vec<(String, f64)> = paper_errors().into_iter().map(scaled).collect();
    let values: Vec<(&str, f64)> = values.iter().map(|(symbol, value)| (symbol.as_str(), *value)).collect();
    let values = [&values[..], &[("tool_z", tool.z)]].concat();
    let mut estimate = estimate_of("samba", &values, &["EX0B", "EZ0B", "EY0C"]);
    estimate.measured_ranges.insert(Axis::Z, [-tool.z - 40.0, -tool.z + 60.0]);
    let pins = TrunnionPins { x_rot_point: 0.0, y_rot_point: 0.0, z_rot_point: 0.0, offset: 0.0, z_offset: 0.0 };
    let before = TrunnionKinematics { tilt: Axis::B, pins };
    let proposal = propose_for(&machine, STATED, before, &estimate).unwrap();
    assert_eq!(proposal.at_mm, Some([0.0, 0.0, 10.0]));
    let chain = KinematicChain::new(&machine).unwrap();
    // This machine turns as ISO 841 states, LinuxCNC's the other way.
    let tip = |(joints, [b, c]): Pose| truth.tip_in_table(Vector3::from(joints) - tool, [-b, -c, 0.0]);
    let errors_with = |control: TrunnionKinematics| {
        let actual = control.tool_errors(tip);
        let model = control.model();
        let errors = model.compensated_errors(&chain, &model.present_mm(), proposal.at_mm, |_| true).unwrap();
        let at = |(tip, [b, c]): Pose| {
            let others = Position::new().with(Axis::B, -b).with(Axis::C, -c);
            let target = Point::from_vec(Vector3::from(tip));
            chain.solve_linear_axes(target, Point::from_vec(tool), &others, &[]).unwrap().updated_by(&others)
        };
        let predictor = ErrorPredictor::new(&machine, STATED, &estimate, WorkZero::Pose(at(POSES[0]))).unwrap();
        let predictor = predictor.with_compensated_errors(errors);
        for (pose, actual) in POSES.into_iter().zip(&actual) {
            let predicted = predictor.pose_error(&at(pose)).tip_error_mm;
            assert!((predicted - actual).norm() < 2e-4, "{pose:?}: {predicted} {actual}");
        }
        largest(&actual)
    };
    let [before_mm, after_mm] = [before, before.with_values(&proposal)].map(errors_with);
    assert!(before_mm > 0.1 && after_mm < 0.015, "{before_mm} {after_mm}");
}

/// Self-calibration gives X and Y of the control at which the tip is on the axis. With Y not square to X they are not
/// the true position of the axis.
#[test]
fn positions_of_a_self_calibration_are_those_of_the_control() {
    let mut machine = trunnion(Axis::B);
    machine.axes.get_mut(&Axis::C).unwrap().point_mm = [100.0, -200.0, 10.0];
    machine.axes.get_mut(&Axis::B).unwrap().point_mm = [100.0, -200.0, -50.0];
    let mut estimate =
        estimate_of("self-calibration", &[("EX0C", 40.0), ("EY0C", -30.0), ("EB0C", 20.0), ("EC0Y", 30.0)], &[]);
    estimate.location_at_mm = Some([100.0, -200.0, 75.0]);
    let measured = MeasuredAxisPositions::new(&machine, STATED, &estimate).unwrap();
    for (component, expected) in [(Axis::X, 100.04), (Axis::Y, -200.03)] {
        let position = measured.position(RotaryAxisCoordinate { axis: Axis::C, component }).unwrap();
        assert!((position.mm - expected).abs() < 1e-6 && (position.expanded_mm - 1e-3).abs() < 1e-6, "{position:?}");
    }
    // At half a turn, with the tip at that point, the tool is off by twice the distance to the axis.
    let chain = KinematicChain::new(&machine).unwrap();
    let tip = Point::from_vec(Vector3::from(machine.tool_mm));
    let at = Point::from_vec(Vector3::from(estimate.location_at_mm.unwrap()));
    let zero = chain.solve_linear_axes(at, tip, &Position::new(), &[]).unwrap();
    let predictor = ErrorPredictor::new(&machine, STATED, &estimate, WorkZero::Pose(zero.clone())).unwrap();
    let error = predictor.pose_error(&zero.with(Axis::C, std::f64::consts::PI)).tip_error_mm;
    assert!((error - Vector3::new(0.08, -0.06, 0.0)).norm() < 1e-5, "{error}");
}

/// With an angle of 30 µrad more than 90° between X and Y a diagonal is 1.3 µm shorter, whichever axis carries the
/// other.
#[test]
fn squareness_of_a_self_calibration_shortens_the_diagonal() {
    for topology in ["w-C-B-b-Y-X-Z-S-t", "w-C-B-b-X-Y-Z-S-t", "w-C-B-X-F-Z-Y-S-t"] {
        let mut machine = trunnion(Axis::B);
        machine.topology = topology.to_owned();
        let mut estimate = estimate_of("self-calibration", &[("EX0C", 0.0), ("EY0C", 0.0), ("EC0Y", 30.0)], &[]);
        estimate.location_at_mm = Some([0.0, 0.0, 75.0]);
        let chain = KinematicChain::new(&machine).unwrap();
        let tip = Point::from_vec(Vector3::from(machine.tool_mm));
        let at = |x, y| chain.solve_linear_axes(Point::new(x, y, 75.0), tip, &Position::new(), &[]).unwrap();
        let predictor = ErrorPredictor::new(&machine, STATED, &estimate, WorkZero::Pose(at(0.0, 0.0))).unwrap();
        let error = predictor.pose_error(&at(60.0, 60.0)).tip_error_mm;
        let along_diagonal = error.dot(&Vector3::new(1.0, 1.0, 0.0).normalize());
        assert!((along_diagonal + 30e-6 * 60.0 / 2.0_f64.sqrt()).abs() < 1e-7, "{topology}: {error}");
    }
}

/// A run that measures C only must not move the tilting axis in the control.
#[test]
fn unmeasured_axis_stays_where_it_is() {
    for tilt in [Axis::A, Axis::B] {
        let before = nominal_control(tilt);
        let of_c = estimate_of("self-calibration", &[("EX0C", 50.0), ("EY0C", -30.0)], &[]);
        let proposal = propose_for(&trunnion(tilt), STATED, before, &of_c).unwrap();
        let kept: Vec<bool> = proposal.positions.iter().map(|position| position.kept.is_some()).collect();
        assert_eq!(kept, [false, false, true, true], "{proposal:?}");
        let after = before.with_values(&proposal);
        let tilting_axis = |control: TrunnionKinematics| {
            across(tilt) * across(tilt).dot(&control.rot_point()) + control.offset() + Vector3::z() * 5.0
        };
        assert!((tilting_axis(after) - tilting_axis(before)).norm() < 1e-9, "{after:?}");
        assert!((after.rot_point() - before.rot_point() - Vector3::new(0.05, -0.03, 0.0)).norm() < 1e-9, "{after:?}");
        // The prediction takes the unmeasured axis to be where the control has it.
        let model = after.model();
        let chain = KinematicChain::new(&trunnion(tilt)).unwrap();
        let is_determined = |own| proposal.is_determined(own);
        let errors = model.compensated_errors(&chain, &model.present_mm(), proposal.at_mm, is_determined).unwrap();
        let errors: Vec<(String, f64)> = errors.iter().map(|own| (own.parameter.to_string(), own.value)).collect();
        assert_eq!(errors, [("EX0C".to_owned(), 0.05), ("EY0C".to_owned(), -0.03)]);
        let reason = &proposal.positions[2].kept.as_ref().unwrap().reason;
        assert!(reason.contains(&format!("does not determine the position of {tilt} in")), "{reason}");
    }
}

#[test]
fn spindle_position_needs_a_stated_stylus() {
    let machine = trunnion(Axis::B);
    let values =
        [("EX0C", 50.0), ("EY0C", 0.0), ("tool_x", 0.01), ("tool_y", 0.0), ("tool_z", machine.tool_mm[2] + 0.0165)];
    let estimate = estimate_of("samba", &values, &["EX0B", "EY0B", "EZ0B", "EZ0S"]);
    let kept = |stylus: StatedStylusUncertainty, estimate: &Estimate| -> Vec<Option<String>> {
        let positions = propose_for(&machine, stylus, nominal_control(Axis::B), estimate).unwrap().positions;
        positions.into_iter().map(|position| position.kept.map(|refusal| refusal.remedy)).collect()
    };
    let without_length = StatedStylusUncertainty { length_u_mm: None, ..STATED };
    let [None, Some(_), None, Some(length)] = &kept(without_length, &estimate)[..] else { panic!() };
    assert!(length.contains("u_stylus_length_um"), "{length}");
    let without_offset = StatedStylusUncertainty { offset_u_mm: None, ..STATED };
    let [Some(x), Some(y), Some(_), None] = &kept(without_offset, &estimate)[..] else { panic!() };
    assert!(x.contains("stylus_offset_um") && y.contains("oriented spindle"), "{x} {y}");
    // An assumed value is not a statement.
    let probe = built_in_plan().probe;
    let assumed = ["probe.stylus_offset_um".to_owned()];
    assert_eq!(StatedStylusUncertainty::new(&probe, &assumed).offset_u_mm, None);
    assert!(StatedStylusUncertainty::new(&probe, &[]).offset_u_mm.is_some());
    // With an oriented spindle the stylus is separate from it, if the position of the spindle is identified.
    let mut oriented = estimate.clone();
    oriented.measured_ranges.insert(Axis::S, [0.0, 270.0]);
    let [Some(x), Some(_), Some(_), None] = &kept(STATED, &oriented)[..] else { panic!() };
    assert!(x.contains("add EX0S and EY0S"), "{x}");
    let with_spindle = [&values[..], &[("EX0S", 10.0), ("EY0S", 20.0)]].concat();
    let mut oriented = estimate_of("samba", &with_spindle, &["EX0B", "EY0B", "EZ0B", "EZ0S"]);
    oriented.measured_ranges.insert(Axis::S, [0.0, 270.0]);
    assert_eq!(kept(without_offset, &oriented), vec![None; 4]);
    // The stated uncertainties are in U, except where two positions differ.
    let stated = StatedStylusUncertainty { offset_u_mm: Some(3e-3), length_u_mm: Some(4e-3) };
    let proposal = propose_for(&machine, stated, nominal_control(Axis::B), &estimate).unwrap();
    let expected = |variances: &[f64]| 2.0 * variances.iter().map(|u| u * u).sum::<f64>().sqrt();
    let expanded: Vec<f64> = proposal.positions.iter().map(|position| position.expanded_mm.unwrap()).collect();
    assert!((expanded[0] - expected(&[0.5e-3, 0.5e-3, 3e-3])).abs() < 1e-8, "{expanded:?}");
    assert!((expanded[3] - expected(&[0.5e-3, 4e-3])).abs() < 1e-8, "{expanded:?}");
    // A displacement sensor in the spindle.
    let mut of_sensor = estimate_of("laser-r-test", &[("EX0C", 50.0), ("EY0C", 0.0), ("zero_x", 0.0)], &["EX0B"]);
    of_sensor.covariance.symbols.truncate(2);
    let refusal = propose_for(&machine, STATED, nominal_control(Axis::B), &of_sensor).unwrap_err();
    assert!(refusal.remedy.contains("samba"), "{refusal:?}");
    // A position that is equivalent to an error which the run did not identify.
    let without_spindle = estimate_of("samba", &[("EA0C", 5.0)], &["EX0B", "EX0C", "EY0C"]);
    let refusal = propose_for(&machine, STATED, nominal_control(Axis::B), &without_spindle).unwrap_err();
    assert!(refusal.reason.contains("no error of the samba run has an effect"), "{refusal:?}");
}

#[test]
fn positions_that_the_readings_do_not_determine_are_refused() {
    let machine = trunnion(Axis::B);
    let of_c = estimate_of("self-calibration", &[("EX0C", 50.0), ("EY0C", -30.0)], &[]);
    let refusal = |estimate: &Estimate| {
        propose_for(&machine, STATED, nominal_control(Axis::B), estimate).map(|_| ()).unwrap_err()
    };
    let mut reversed = of_c.clone();
    reversed.parameters.iter_mut().for_each(|parameter| parameter.identifiable = false);
    assert!(refusal(&reversed).reason.contains("do not determine EX0C, EY0C"));
    assert!(ErrorPredictor::new(&machine, STATED, &reversed, WorkZero::TableOrigin).is_err());
    let mut tilted = of_c;
    tilted.measured_ranges.insert(Axis::B, [90.0, 90.0]);
    assert!(refusal(&tilted).reason.contains("did not measure with B at 0"));
    let none = estimate_of("samba", &[("EA0C", 50.0)], &[]);
    assert!(refusal(&none).remedy.contains("EX0C"));
    // A wrong point in the machine file would give a large change.
    let far = estimate_of("samba", &[("EX0C", 800.0), ("EY0C", -30.0)], &[]);
    assert!(refusal(&far).reason.contains("the change of C in X by 0.8000 mm is larger than 0.5000 mm"));
}

/// B, not parallel to Y, passes 0.06 mm beside C. Its point in the machine file may be anywhere on it.
#[test]
fn axes_are_measured_at_one_point() {
    for y in [0.0, 300.0] {
        let mut machine = trunnion(Axis::B);
        machine.axes.get_mut(&Axis::B).unwrap().point_mm = [0.0, y, -50.0];
        let at_point_um = 60.0 - 40.0 * y / 1000.0;
        let values = [("EX0B", at_point_um), ("EC0B", 40.0), ("EX0C", 0.0), ("EY0C", 0.0), ("EZ0B", 0.0)];
        let estimate = estimate_of("samba", &values, &[]);
        let measured = MeasuredAxisPositions::new(&machine, STATED, &estimate).unwrap();
        let position = measured.position(RotaryAxisCoordinate { axis: Axis::B, component: Axis::X }).unwrap();
        assert!((position.mm - 0.06).abs() < 1e-8, "{y}: {position:?}");
    }
}

/// Beyond a metre a pin reads back in steps of a micrometre.
#[test]
fn values_have_the_digits_that_the_control_prints() {
    let mut machine = trunnion(Axis::B);
    for axis in [Axis::B, Axis::C] {
        machine.axes.get_mut(&axis).unwrap().point_mm = [1234.5, 0.0, -50.0];
    }
    let estimate = estimate_of("self-calibration", &[("EX0C", 67.83), ("EY0C", 12.34)], &[]);
    let mut control = nominal_control(Axis::B);
    control.pins.x_rot_point = 1234.5;
    let proposal = propose_for(&machine, STATED, control, &estimate).unwrap();
    assert_eq!([0, 1].map(|index: usize| proposal.values[index].proposed_mm), [1234.568, 0.0123]);
}

/// C drifts by 8 µm from run to run. Its position is measured anew each time, and no correction is made twice.
#[test]
fn repeated_corrections_follow_a_drifting_axis() {
    let mut control = nominal_control(Axis::B);
    for run in 0..5 {
        let true_um = 60.0 + 8.0 * f64::from(run);
        let estimate = estimate_of("self-calibration", &[("EX0C", true_um), ("EY0C", 0.0)], &[]);
        let proposal = propose_for(&trunnion(Axis::B), STATED, control, &estimate).unwrap();
        control = control.with_values(&proposal);
        assert!((control.pins.x_rot_point - true_um * 1e-3).abs() < 1e-9, "run {run}: {control:?}");
    }
    let within_u = estimate_of("self-calibration", &[("EX0C", 92.9), ("EY0C", 0.0)], &[]);
    let unchanged = propose_for(&trunnion(Axis::B), STATED, control, &within_u).unwrap();
    assert!(unchanged.values.iter().all(|value| value.present_mm == value.proposed_mm), "{unchanged:?}");
    assert!(unchanged.positions[0].kept.as_ref().unwrap().reason.contains("within U = 1.0 µm"), "{unchanged:?}");
}
