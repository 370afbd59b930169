//! Comparison with LinuxCNC's own equations (`trtfuncs.c` of LinuxCNC 2.9), written here as rotations.

use nalgebra::{Rotation3, Vector3};

use super::*;
use crate::samba::tests::built_in::built_in_plan;
use machine::frame::Point;
use machine::kinematics::KinematicChain;
use machine::record::estimate::Estimate;
use machine::record::machine::{AxisSense, Machine};
use machine::{Axis, Position};

/// Values of the pins, mm.
#[derive(Debug, Clone, Copy)]
struct Pins {
    rot_point: Vector3<f64>,
    /// y-offset or x-offset, and z-offset.
    offset: Vector3<f64>,
}

/// Joint positions X, Y, Z, mm, and the angles of the tilting axis and of C, rad.
type Pose = ([f64; 3], [f64; 2]);

const POSES: [Pose; 5] = [
    ([120.0, -80.0, 40.0], [0.0, 0.0]),
    ([-20.0, 150.0, 90.0], [0.7, 2.0]),
    ([50.0, 60.0, -30.0], [-1.0, -3.0]),
    ([0.0, 0.0, 26.7], [0.5, 1.5]),
    ([-90.0, 30.0, 0.0], [-0.4, 0.9]),
];

impl Pins {
    fn turns(tilt: Axis, [tilt_rad, c_rad]: [f64; 2]) -> [Rotation3<f64>; 2] {
        let tilt_axis = if tilt == Axis::A { Vector3::x_axis() } else { Vector3::y_axis() };
        [Rotation3::from_axis_angle(&tilt_axis, -tilt_rad), Rotation3::from_axis_angle(&Vector3::z_axis(), -c_rad)]
    }

    /// Position in the workpiece from joint positions.
    fn forward(self, tilt: Axis, (joints, angles): Pose) -> Vector3<f64> {
        let [turn_tilt, turn_c] = Self::turns(tilt, angles);
        let Self { rot_point, offset } = self;
        rot_point + turn_c * (turn_tilt * (Vector3::from(joints) - offset - rot_point) + offset)
    }

    /// Joint positions from a position in the workpiece.
    fn inverse(self, tilt: Axis, position: Vector3<f64>, angles: [f64; 2]) -> Vector3<f64> {
        let [turn_tilt, turn_c] = Self::turns(tilt, angles);
        let Self { rot_point, offset } = self;
        rot_point + offset + turn_tilt.inverse() * (turn_c.inverse() * (position - rot_point) - offset)
    }

    fn present_mm(self, pin: &str) -> f64 {
        match pin {
            "x-rot-point" => self.rot_point.x,
            "y-rot-point" => self.rot_point.y,
            "z-rot-point" => self.rot_point.z,
            "x-offset" => self.offset.x,
            "y-offset" => self.offset.y,
            "z-offset" => self.offset.z,
            other => panic!("{other}"),
        }
    }

    fn with_values(mut self, tilt: Axis, values_mm: &[f64]) -> Self {
        let [x, y, across, z] = values_mm[..] else { panic!("{values_mm:?}") };
        (self.rot_point.x, self.rot_point.y, self.offset.z) = (x, y, z);
        if tilt == Axis::A {
            self.offset.y = across
        } else {
            self.offset.x = across
        }
        self
    }
}

/// A trunnion whose rotary axes turn as LinuxCNC's kinematics expect: opposite to ISO 841.
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

fn nominal_pins(tilt: Axis) -> Pins {
    // `trunnion` states the tilting axis 3 mm off in Y, which counts only for A.
    let y = if tilt == Axis::A { 3.0 } else { 0.0 };
    Pins { rot_point: Vector3::new(0.0, 0.0, 5.0), offset: Vector3::new(0.0, y, -55.0) }
}

fn position(tilt: Axis, (joints, [tilt_rad, c_rad]): Pose) -> Position {
    Position::from_xyz(Vector3::from(joints)).with(tilt, tilt_rad).with(Axis::C, c_rad)
}

#[test]
fn control_model_equals_the_equations_of_linuxcnc() {
    for tilt in [Axis::A, Axis::B] {
        let machine = trunnion(tilt);
        let chain = KinematicChain::new(&machine).unwrap();
        let pins = Pins { rot_point: Vector3::new(0.3, -0.2, 5.0), offset: across(tilt) * 0.7 - Vector3::z() * 55.4 };
        let values = trunnion_values(tilt, |pin| pins.present_mm(pin));
        let present: Vec<f64> = values.iter().map(|value| value.present_mm).collect();
        let errors = location_errors_of_control(&machine, &values, &present).unwrap();
        let tip = |pose| chain.tip_in_table(&position(tilt, pose), Point::from_vec(Vector3::zeros()), &errors).mm;
        // LinuxCNC's workpiece frame is that of the machine at the first pose; ours moves with the errors of the axes.
        let shift = tip(POSES[0]) - pins.forward(tilt, POSES[0]);
        for pose in POSES {
            let difference = tip(pose) - shift - pins.forward(tilt, pose);
            assert!(difference.norm() < 1e-10, "{tilt} {pose:?}: {difference}");
        }
    }
}

/// An estimate with these errors, µm, each with u = 0.5 µm, and a stylus as stated.
fn estimate_of(machine: &Machine, errors_um: &[(&str, f64)], held_at_zero: &[&str]) -> Estimate {
    let parameter = |symbol: &str, value: f64, unit: &str, u: f64| {
        serde_json::json!({"symbol": symbol, "value": value, "unit": unit, "u": u, "U": 2.0 * u, "k": 2.0,
            "dof": null, "identifiable": true})
    };
    let mut parameters: Vec<_> = errors_um.iter().map(|(symbol, um)| parameter(symbol, *um, "um", 0.5)).collect();
    parameters.push(parameter("tool_z", machine.tool_mm[2], "mm", 5e-4));
    let count = parameters.len();
    let variance = |i: usize| if i + 1 == count { 5e-4 * 5e-4 } else { 0.25 };
    let row = |i: usize| -> Vec<f64> { (0..count).map(|j| if i == j { variance(i) } else { 0.0 }).collect() };
    let symbols: Vec<&str> = errors_um.iter().map(|(symbol, _)| *symbol).chain(["tool_z"]).collect();
    serde_json::from_value(serde_json::json!({
        "trued_estimate": 1, "method": "samba", "parameters": parameters, "functions": [], "gauge": [],
        "covariance": {"symbols": symbols, "rows": (0..count).map(row).collect::<Vec<_>>()},
        "held_at_zero": held_at_zero, "not_identifiable": [], "rank": 0, "unknowns": 0, "condition": 1.0,
        "residual_rms_um": 0.3, "degrees_of_freedom": 50, "chi2_per_dof": 1.0, "verdict": "none", "warnings": [],
        "priors": [], "measured": {"X": [-150.0, 150.0], "Y": [-150.0, 150.0], "Z": [-50.0, 100.0]},
    }))
    .unwrap()
}

/// Symbols of a trunnion's location errors, as SAMBA reports and holds them.
fn errors_of_trunnion(tilt: Axis) -> ([&'static str; 4], [&'static str; 4]) {
    match tilt {
        Axis::A => (["EX0C", "EY0C", "EX0S", "EY0S"], ["EX0A", "EY0A", "EZ0A", "EZ0S"]),
        _ => (["EX0C", "EY0C", "EX0S", "EY0S"], ["EX0B", "EY0B", "EZ0B", "EZ0S"]),
    }
}

/// Errors of both signs: with a wrong sign the error of the tool would double.
#[test]
fn proposal_decreases_the_tool_centre_error_to_the_resolution() {
    for (tilt, sign) in [(Axis::A, 1.0), (Axis::A, -1.0), (Axis::B, 1.0), (Axis::B, -1.0)] {
        let machine = trunnion(tilt);
        let (reported, held) = errors_of_trunnion(tilt);
        let um = [50.0, -40.0, 30.0, -60.0].map(|um| um * sign);
        let errors: Vec<(&str, f64)> = reported.into_iter().zip(um).collect();
        let estimate = estimate_of(&machine, &errors, &held);
        let measured = MeasuredAxisPositions::new(&machine, 0.0, &estimate).unwrap();
        let before = nominal_pins(tilt);
        let values = trunnion_values(tilt, |pin| before.present_mm(pin));
        let proposal = propose(&measured, &values, ProposalOptions::default()).unwrap();
        assert!(proposal.has_changes());
        let after = before.with_values(tilt, &proposal.proposed_mm());
        // The axes as they truly are, relative to the spindle: C is carried by the tilting axis.
        let of_spindle = Vector3::new(um[2], um[3], 0.0) * 1e-3;
        let of_c = Vector3::new(um[0], um[1], 0.0) * 1e-3;
        let truth = Pins {
            rot_point: before.rot_point + of_c - of_spindle,
            offset: before.offset - across(tilt) * of_c.dot(&across(tilt)),
        };
        let largest = |control: Pins| {
            let error = |(position, angles): Pose| {
                let joints = control.inverse(tilt, Vector3::from(position), angles);
                truth.forward(tilt, (joints.into(), angles)) - Vector3::from(position)
            };
            let zero = error(([0.0; 3], [0.0; 2]));
            POSES.into_iter().map(|pose| (error(pose) - zero).norm()).fold(0.0, f64::max)
        };
        assert!(largest(before) > 0.05 && largest(after) < 3e-4, "{tilt} {}: {}", largest(before), largest(after));
    }
}

/// The axis drifts by 8 µm from run to run. A value that the readings do not contain is measured anew; one that they
/// contain is corrected by what they show. Neither is corrected twice.
#[test]
fn repeated_corrections_follow_a_drifting_axis() {
    let machine = trunnion(Axis::B);
    for effect in [ValueEffect::NotInReadings, ValueEffect::InReadings] {
        let coordinate = AxisCoordinate { axis: Axis::C, component: Axis::X };
        let mut value = TargetValue { effect, ..trunnion_values(Axis::B, |_| 0.0).remove(0) };
        assert_eq!(value.terms, [(coordinate, 1.0)]);
        for run in 0..5 {
            let true_mm = 0.06 + 0.008 * f64::from(run);
            let seen_mm = if effect == ValueEffect::InReadings { true_mm - value.present_mm } else { true_mm };
            let estimate = estimate_of(&machine, &[("EX0C", seen_mm * 1e3), ("EX0S", 0.0)], &[]);
            let measured = MeasuredAxisPositions::new(&machine, 0.0, &estimate).unwrap();
            let proposal = propose(&measured, &[value.clone()], ProposalOptions::default()).unwrap();
            value.present_mm = proposal.values[0].proposed_mm;
            assert!((value.present_mm - true_mm).abs() < 1e-4, "{effect:?}, run {run}: {}", value.present_mm);
        }
        let estimate =
            estimate_of(&machine, &[("EX0C", if effect == ValueEffect::InReadings { 0.9 } else { 92.9 })], &[]);
        let measured = MeasuredAxisPositions::new(&machine, 0.0, &estimate).unwrap();
        let unchanged = propose(&measured, &[value.clone()], ProposalOptions::default()).unwrap();
        assert!(!unchanged.has_changes(), "{unchanged:?}");
        assert!(unchanged.values[0].kept_because.as_ref().unwrap().contains("within U = 1.0 µm"), "{unchanged:?}");
    }
}

#[test]
fn undetermined_positions_are_refused_with_a_remedy() {
    let machine = trunnion(Axis::B);
    let propose_all = |estimate: &Estimate, u_stylus_offset_mm: f64| {
        let measured = MeasuredAxisPositions::new(&machine, u_stylus_offset_mm, estimate)?;
        propose(
            &measured,
            &trunnion_values(Axis::B, |pin| nominal_pins(Axis::B).present_mm(pin)),
            ProposalOptions::default(),
        )
    };
    // Self-calibration determines C, but not B.
    let of_c = estimate_of(&machine, &[("EX0C", 50.0), ("EY0C", -30.0)], &[]);
    let proposal = propose_all(&of_c, 0.0).unwrap();
    let kept: Vec<bool> = proposal.values.iter().map(|value| value.kept_because.is_some()).collect();
    assert_eq!(kept, [false, false, true, true], "{proposal:?}");
    assert!(proposal.values[2].kept_because.as_ref().unwrap().contains("does not determine the position of B in X"));
    // Without an oriented spindle the stylus is not separated from it.
    let mut with_tool = estimate_of(&machine, &[("EX0C", 50.0), ("EY0C", -30.0)], &[]);
    let symbol = "tool_x".to_owned();
    with_tool.parameters.last_mut().unwrap().symbol.clone_from(&symbol);
    *with_tool.covariance.symbols.last_mut().unwrap() = symbol;
    with_tool.parameters.last_mut().unwrap().value = 0.0;
    let refused = propose_all(&with_tool, 0.0).unwrap();
    assert!(refused.values[0].kept_because.as_ref().unwrap().contains("does not separate the stylus"), "{refused:?}");
    let value = propose_all(&with_tool, 3e-3).unwrap().values.remove(0);
    let expected = 2.0 * (0.5e-3_f64.powi(2) + 0.5e-3_f64.powi(2) + 3e-3_f64.powi(2)).sqrt();
    assert!((value.expanded_mm.unwrap() - expected).abs() < 1e-9, "{value:?}");
    // A wrong point in the machine file would give a large change.
    let far = estimate_of(&machine, &[("EX0C", 800.0), ("EY0C", -30.0)], &[]);
    let refusal = propose_all(&far, 0.0).unwrap_err();
    assert!(refusal.reason.contains("x-rot-point by 0.8000 mm"), "{refusal}");
    let none = estimate_of(&machine, &[("EA0C", 50.0)], &[]);
    assert!(propose_all(&none, 0.0).unwrap_err().remedy.contains("EX0C"));
}
