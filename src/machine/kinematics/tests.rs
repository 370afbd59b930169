//! Conventions of the chain, each tested against a case with a known exact result.

use std::f64::consts::PI;

use nalgebra::Vector3;

use super::*;
use crate::Position;
use crate::frame::{Point, Pose, SpindleFrame};
use crate::record::machine::{AxisSense, Carrier, Machine, StatedAxis};

fn machine_with_topology(topology: &str) -> Machine {
    let parsed: Topology = topology.parse().unwrap();
    let spec: StatedAxis = serde_json::from_str(r#"{"min":-500,"max":500}"#).unwrap();
    Machine {
        name: "test".into(),
        topology: topology.into(),
        axes: parsed.axes().map(|axis| (axis, spec.clone())).collect(),
        tool_mm: [0.0; 3],
        drift_um_per_h: 0.0,
        squareness_urad: 0.0,
    }
}

fn error_term(name: &str, value: f64) -> ErrorTerm {
    ErrorTerm { parameter: name.parse().unwrap(), value }
}

fn tip_at_spindle_datum() -> Point<SpindleFrame> {
    Point::new(0.0, 0.0, 0.0)
}

fn xyz_position(x: f64, y: f64, z: f64) -> Position {
    Position::new().with(Axis::X, x).with(Axis::Y, y).with(Axis::Z, z)
}

#[track_caller]
fn assert_same_pose(actual: Pose, expected: Pose) {
    let off = actual.to_homogeneous() - expected.to_homogeneous();
    assert!(off.abs().max() < 1e-12, "{actual} instead of {expected}");
}

fn assert_near(actual: Vector3<f64>, expected: Vector3<f64>) {
    assert!(actual.metric_distance(&expected) < 1e-12, "{actual} instead of {expected}");
}

/// METHODS section 1: at table angle C, a probe at machine angle φ touches the workpiece at φ + C.
#[test]
fn fixed_probe_at_angle_phi_touches_the_workpiece_at_phi_plus_c() {
    let (phi, c) = (0.3_f64, 1.1_f64);
    let pose = xyz_position(50.0 * phi.cos(), 50.0 * phi.sin(), 7.0).with(Axis::C, c);
    for (sense, sign) in [(AxisSense::Iso, 1.0), (AxisSense::Reversed, -1.0)] {
        let mut machine = machine_with_topology("wCFXYZt");
        machine.axes.get_mut(&Axis::C).unwrap().positive = sense;
        let angle = phi + sign * c;
        let expected = Vector3::new(50.0 * angle.cos(), 50.0 * angle.sin(), 7.0);
        assert_near(
            KinematicChain::new(&machine).unwrap().tip_in_table(&pose, tip_at_spindle_datum(), &[]).mm,
            expected,
        );
    }
}

#[test]
fn with_rotary_axes_at_zero_the_tip_is_at_command_plus_offset() {
    for topology in ["wFXYZt", "wXYFZt", "wCBXFZYSt", "wCAYFXZt", "wAFXYZBt"] {
        let chain = KinematicChain::new(&machine_with_topology(topology)).unwrap();
        let point = chain.tip_in_table(&xyz_position(1.0, -2.0, 3.0), Point::new(0.0, 0.0, -9.0), &[]);
        assert_near(point.mm, Vector3::new(1.0, -2.0, -6.0));
    }
}

#[test]
fn a_rotary_axis_turns_about_its_point_and_direction() {
    let mut machine = machine_with_topology("wCFXYZt");
    machine.axes.get_mut(&Axis::C).unwrap().point_mm = [10.0, 20.0, 0.0];
    machine.axes.get_mut(&Axis::C).unwrap().direction = [0.0, 0.0, -2.0];
    let chain = KinematicChain::new(&machine).unwrap();
    let on_axis = xyz_position(10.0, 20.0, 5.0).with(Axis::C, 1.0);
    assert_near(chain.tip_in_table(&on_axis, tip_at_spindle_datum(), &[]).mm, Vector3::new(10.0, 20.0, 5.0));
    let beside = xyz_position(11.0, 20.0, 5.0).with(Axis::C, PI / 2.0);
    assert_near(chain.tip_in_table(&beside, tip_at_spindle_datum(), &[]).mm, Vector3::new(10.0, 19.0, 5.0));
}

/// A gain lengthens the motion, with the joint's sign: in the table frame it is positive on both branches.
#[test]
fn gains_lengthen_the_motion_on_both_branches() {
    for topology in ["wCXFYZt", "wCFXYZt"] {
        let chain = KinematicChain::new(&machine_with_topology(topology)).unwrap();
        let point =
            chain.tip_in_table(&xyz_position(100.0, 0.0, 0.0), tip_at_spindle_datum(), &[error_term("EXX1", 1e-4)]);
        assert_near(point.mm, Vector3::new(100.01, 0.0, 0.0));
    }
}

/// The axis is at E_X0C instead of 0: a point on the true axis does not move with C.
#[test]
fn a_location_error_moves_the_axis_itself() {
    let chain = KinematicChain::new(&machine_with_topology("wCFXYZt")).unwrap();
    let errors = [error_term("EX0C", 0.05), error_term("EY0C", -0.03)];
    for c in [0.0, 1.0, 4.0] {
        let point =
            chain.tip_in_table(&xyz_position(0.05, -0.03, 0.0).with(Axis::C, c), tip_at_spindle_datum(), &errors);
        assert_near(point.mm, Vector3::zeros());
    }
}

#[test]
fn topology_and_axes_must_name_the_same_axes() {
    let mut without_b = machine_with_topology("wCBXFZYSt");
    without_b.axes.remove(&Axis::B);
    let error = KinematicChain::new(&without_b).unwrap_err();
    assert!(matches!(error, KinematicsError::NotInAxes { axis: Axis::B, .. }), "{error}");

    let mut with_a = machine_with_topology("wCFXYZt");
    with_a.axes.insert(Axis::A, with_a.axes[&Axis::C].clone());
    let error = KinematicChain::new(&with_a).unwrap_err();
    assert!(matches!(error, KinematicsError::NotInTopology { axis: Axis::A, .. }), "{error}");

    let mut fixed_spindle = machine_with_topology("wCFXYZSt");
    fixed_spindle.axes.remove(&Axis::S);
    assert!(KinematicChain::new(&fixed_spindle).is_ok());
}

#[test]
fn invalid_directions_and_parameters_are_refused() {
    let mut flat = machine_with_topology("wCFXYZt");
    flat.axes.get_mut(&Axis::Y).unwrap().direction = [1.0, 0.0, 0.0];
    assert_eq!(KinematicChain::new(&flat).unwrap_err(), KinematicsError::DependentLinearAxes);

    let mut nan = machine_with_topology("wCFXYZt");
    nan.axes.get_mut(&Axis::C).unwrap().direction = [f64::NAN, 0.0, 1.0];
    assert_eq!(KinematicChain::new(&nan).unwrap_err(), KinematicsError::InvalidDirectionOrPoint { axis: Axis::C });

    let chain = KinematicChain::new(&machine_with_topology("wCFXYZt")).unwrap();
    assert!(chain.check_parameter_axis("EX0C".parse().unwrap()).is_ok());
    assert!(chain.check_parameter_axis("EX0B".parse().unwrap()).is_err());
}

/// The poses at the ends of both branches equal those of the chain; those in between are computed by hand.
#[test]
fn carrier_poses_follow_their_axes() {
    let chain = KinematicChain::new(&machine_with_topology("wCBXFZYSt")).unwrap();
    let position = [11.0, -7.0, 23.0, 0.0, 0.4, -1.1, 0.8];
    let named: Position = Axis::ALL.into_iter().zip(position).collect();
    let pose = |carrier| chain.carrier_chain(carrier).unwrap().pose(&position);
    let table = chain.machine_from_table(&named, &[]);
    assert_same_pose(pose(Carrier::Table), table);
    assert_same_pose(pose(Carrier::Axis(Axis::C)), table);
    let spindle = chain.machine_from_spindle(&named, &[]);
    assert_same_pose(pose(Carrier::Axis(Axis::S)), spindle);
    let point = Vector3::new(1.0, 2.0, 3.0);
    // X moves the table side, so it moves the opposite way; the spindle's body does not turn.
    assert_near(pose(Carrier::Axis(Axis::X)).transform_point(&point.into()).coords, Vector3::new(-10.0, 2.0, 3.0));
    assert_near(pose(Carrier::Axis(Axis::Z)).transform_point(&point.into()).coords, Vector3::new(1.0, 2.0, 26.0));
    assert_near(pose(Carrier::Spindle).transform_point(&point.into()).coords, Vector3::new(1.0, -5.0, 26.0));
    assert_near(pose(Carrier::Bed).transform_point(&point.into()).coords, point);
    let side = |carrier| chain.carrier_chain(carrier).map(|carried| carried.side);
    assert_eq!(side(Carrier::Axis(Axis::B)), Some(MachineSide::Workpiece));
    assert_eq!(side(Carrier::Axis(Axis::Y)), Some(MachineSide::Tool));
    assert_eq!(side(Carrier::Axis(Axis::A)), None);
}

/// However the axes move within ± half, no corner moves farther than the bound; for one axis alone, the bound is
/// reached exactly.
#[test]
fn the_displacement_bound_holds_and_is_reached() {
    let mut machine = machine_with_topology("wCBXFZYSt");
    machine.axes.get_mut(&Axis::B).unwrap().point_mm = [5.0, 0.0, -20.0];
    let chain = KinematicChain::new(&machine).unwrap();
    let carried = chain.carrier_chain(Carrier::Table).unwrap();
    let corners = [Vector3::new(30.0, -20.0, 10.0), Vector3::new(-15.0, 40.0, 60.0)];
    let middle = [11.0, -7.0, 23.0, 0.0, 0.4, -1.1, 0.8];
    let half = [3.0, 5.0, 7.0, 0.0, 0.2, 0.9, 1.0];
    let swept = |half: &[f64; 7], corners: &[Vector3<f64>]| {
        let [from, to] = [-1.0, 1.0].map(|side| std::array::from_fn(|i| middle[i] + side * half[i]));
        carried.motion_between(&from, &to).pose_and_displacement_bound(&middle, half, corners, 0.0)
    };
    let (pose, bound) = swept(&half, &corners);
    assert_same_pose(pose, carried.pose(&middle));
    let mut farthest = 0.0_f64;
    for i in 0..3_usize.pow(3) {
        let share = |digit: u32| (i / 3_usize.pow(digit) % 3) as f64 - 1.0;
        let mut at = middle;
        for (digit, axis) in [(0, Axis::X), (1, Axis::B), (2, Axis::C)] {
            at[axis as usize] += share(digit) * half[axis as usize];
        }
        let there = carried.pose(&at);
        for corner in corners {
            let way = there
                .transform_point(&corner.into())
                .coords
                .metric_distance(&pose.transform_point(&corner.into()).coords);
            farthest = farthest.max(way);
        }
    }
    assert!(farthest <= bound && farthest > 0.6 * bound, "{farthest} of {bound}");
    let mut alone = [0.0; 7];
    alone[Axis::C as usize] = 0.9;
    let (pose, bound) = swept(&alone, &corners[..1]);
    assert_same_pose(pose, carried.pose(&middle));
    let chord = 2.0 * 0.45_f64.sin() * 30.0_f64.hypot(20.0);
    assert!((bound - chord).abs() < 1e-12, "{bound} instead of {chord}");
}
