//! Gate G0 (METHODS.md section 0): the chain compared with an independent construction, its Jacobian with finite
//! differences, its inverse with itself.

use std::f64::consts::PI;

use estimation::random;
use machine::kinematics::{ErrorParameter, ErrorTerm, KinematicChain, Topology};
use machine::record::machine::{AxisSense, Machine, StatedAxis};
use machine::{Axis, Position, frame::Point, frame::SpindleFrame};
use nalgebra::{Matrix4, Vector3, Vector4};
use rand::{Rng, RngExt};

const LOCATION_ERRORS_AND_GAINS_13: [&str; 13] =
    ["EA0B", "EC0B", "EX0C", "EA0C", "EB0C", "EB0Z", "EA0Y", "EC0Y", "EY0S", "EX0S", "EXX1", "EYY1", "EZZ1"];

/// Axes in `reversed` turn against ISO 841; rotary axes pass through points off the origin.
fn machine_of_topology(topology: &str, reversed: &[Axis]) -> Machine {
    let parsed: Topology = topology.parse().unwrap();
    let spec = |axis: Axis| -> StatedAxis {
        let mut spec: StatedAxis = serde_json::from_str(r#"{"min":-400,"max":400}"#).unwrap();
        if reversed.contains(&axis) {
            spec.positive = AxisSense::Reversed;
            spec.point_mm = [12.5, -7.25, 3.0];
        }
        spec
    };
    Machine {
        name: "g0".into(),
        topology: topology.into(),
        axes: parsed.axes().map(|axis| (axis, spec(axis))).collect(),
        tool_mm: [0.0; 3],
        drift_um_per_h: 0.0,
        squareness_urad: 0.0,
    }
}

fn parse_parameters<S: AsRef<str>>(names: &[S]) -> Vec<ErrorParameter> {
    names.iter().map(|name| name.as_ref().parse().unwrap()).collect()
}

/// Six location errors of each of five axes and the spindle, and two gains of each linear axis: along its own direction
/// and along one other. Together 42.
fn location_errors_and_gains_42() -> Vec<ErrorParameter> {
    let mut names = Vec::new();
    for axis in ["X", "Y", "Z", "B", "C", "S"] {
        names.extend(["X", "Y", "Z", "A", "B", "C"].map(|k| format!("E{k}0{axis}")));
    }
    names.extend(["XX", "YY", "ZZ", "YX", "ZY", "XZ"].map(|pair| format!("E{pair}1")));
    parse_parameters(&names)
}

/// Six error motions of each rotary axis of `axes`: harmonics 1 and 2, and table entries.
fn error_motion_parameters(axes: &[&str]) -> Vec<ErrorParameter> {
    let mut names = Vec::new();
    for axis in axes {
        for k in ["X", "Y", "Z", "A", "B", "C"] {
            names.extend(["sin1", "cos1", "sin2", "cos2"].map(|n| format!("E{k}{axis}_{n}")));
        }
        names.extend((0..4).map(|entry| format!("EA{axis}_{entry}/4")));
    }
    parse_parameters(&names)
}

/// Every parameter at a random value: up to 0.1 mm, 1 mrad, 1e-4.
fn random_errors(parameters: &[ErrorParameter], random: &mut impl Rng) -> Vec<ErrorTerm> {
    let value = |name: &str, random: &mut _| -> f64 {
        let angular = name.starts_with("EA") || name.starts_with("EB") || name.starts_with("EC");
        let scale = if name.ends_with('1') && !name.contains('_') {
            1e-4
        } else if angular {
            1e-3
        } else {
            0.1
        };
        scale * uniform_between_minus_1_and_1(random)
    };
    parameters.iter().map(|p| ErrorTerm { parameter: *p, value: value(&p.to_string(), random) }).collect()
}

/// Uniform in [-1, 1].
fn uniform_between_minus_1_and_1(random: &mut impl Rng) -> f64 {
    random.random_range(-1.0..=1.0)
}

fn random_pose(random: &mut impl Rng) -> Position {
    let scale = |axis: Axis| if axis.is_linear() { 200.0 } else { PI };
    Axis::ALL.into_iter().map(|axis| (axis, scale(axis) * uniform_between_minus_1_and_1(random))).collect()
}

fn random_tip(random: &mut impl Rng) -> Point<SpindleFrame> {
    Point::new(
        5.0 * uniform_between_minus_1_and_1(random),
        5.0 * uniform_between_minus_1_and_1(random),
        -150.0 + 50.0 * uniform_between_minus_1_and_1(random),
    )
}

fn with_changed_error(errors: &[ErrorTerm], index: usize, change: f64) -> Vec<ErrorTerm> {
    let mut changed = errors.to_vec();
    changed[index].value += change;
    changed
}

/// Largest deviation of a Jacobian column from 4th-order central differences, relative to the
/// norm of the differences, over 20 random poses.
fn worst_relative_jacobian_deviation(topology: &str, reversed: &[Axis], set: &[ErrorParameter]) -> f64 {
    let chain = KinematicChain::new(&machine_of_topology(topology, reversed)).unwrap();
    let mut random = random::seeded_stream(7, &[topology.len() as u64, set.len() as u64]);
    let mut worst: f64 = 0.0;
    for _ in 0..20 {
        let (pose, tip) = (random_pose(&mut random), random_tip(&mut random));
        let errors = random_errors(set, &mut random);
        let columns = chain.error_jacobian(&pose, tip, &errors, set);
        assert_eq!(columns.len(), set.len());
        for (index, (column, parameter)) in columns.iter().zip(set).enumerate() {
            chain.check_parameter_axis(*parameter).unwrap();
            // The pose is linear in translations, so the step is long; it is curved in angles.
            let h = if parameter.component().is_linear() { 0.5 } else { 2e-3 };
            let at = |k: f64| chain.tip_in_table(&pose, tip, &with_changed_error(&errors, index, k * h)).mm;
            let difference = (8.0 * (at(1.0) - at(-1.0)) - (at(2.0) - at(-2.0))) / (12.0 * h);
            // Table entries are exactly zero at all other angles.
            if parameter.shape_factor(pose.get_or_zero(parameter.axis())) == 0.0 {
                assert_eq!(column.norm(), 0.0);
            } else {
                worst = worst.max((*column - difference).norm() / difference.norm());
            }
        }
    }
    worst
}

#[track_caller]
fn assert_jacobian_agrees_with_differences(topology: &str, reversed: &[Axis], set: &[ErrorParameter]) {
    let worst = worst_relative_jacobian_deviation(topology, reversed, set);
    println!("{topology}, {} parameters: {worst:.1e}", set.len());
    assert!(worst <= 1e-9, "{topology}, {} parameters: {worst:e}", set.len());
}

#[test]
fn jacobian_of_13_parameters_agrees_with_differences() {
    assert_jacobian_agrees_with_differences("wCBXFZYSt", &[], &parse_parameters(&LOCATION_ERRORS_AND_GAINS_13));
}

#[test]
fn jacobian_of_42_parameters_agrees_with_differences() {
    assert_eq!(location_errors_and_gains_42().len(), 42);
    assert_jacobian_agrees_with_differences("wCBXFZYSt", &[], &location_errors_and_gains_42());
    assert_jacobian_agrees_with_differences(
        "wCBXFZYSt",
        &[Axis::B, Axis::C, Axis::X, Axis::S],
        &location_errors_and_gains_42(),
    );
}

#[test]
fn jacobian_with_error_motions_agrees_with_differences() {
    let mut set = error_motion_parameters(&["B", "C"]);
    set.extend(parse_parameters(&["EX0C", "EA0C", "EB0C", "EA0B", "EC0B", "EXX1", "EYY1", "EC0Y"]));
    assert_jacobian_agrees_with_differences("wCBFXYZt", &[], &set);
    assert_jacobian_agrees_with_differences("wCBFXYZt", &[Axis::B, Axis::C], &set);
}

#[test]
fn jacobian_of_other_machines_agrees_with_differences() {
    let locations = |axes: &[&str]| {
        let mut names = vec!["EXX1".to_owned(), "EYY1".to_owned(), "EZZ1".to_owned()];
        for axis in axes {
            names.extend(["X", "Y", "Z", "A", "B", "C"].map(|k| format!("E{k}0{axis}")));
        }
        parse_parameters(&names)
    };
    assert_jacobian_agrees_with_differences("wCAYFXZt", &[], &locations(&["C", "A", "Y", "X", "Z"]));
    assert_jacobian_agrees_with_differences("wCAYFXZt", &[Axis::A, Axis::Y], &locations(&["C", "A", "Y", "X", "Z"]));
    assert_jacobian_agrees_with_differences("wCBbYXZ(C)t", &[], &locations(&["C", "B", "Y", "X", "Z", "S"]));
    assert_jacobian_agrees_with_differences("wAFXYZBt", &[], &locations(&["A", "X", "Y", "Z", "B"]));
    assert_jacobian_agrees_with_differences("wAFXYZBt", &[Axis::B], &locations(&["A", "X", "Y", "Z", "B"]));
}

/// Homogeneous matrix written out element by element, as in a textbook (row by row).
fn homogeneous_matrix(rows: [[f64; 4]; 3]) -> Matrix4<f64> {
    let [x, y, z] = rows.map(Vector4::from);
    Matrix4::from_columns(&[x, y, z, Vector4::w()]).transpose()
}

fn translation_matrix(x: f64, y: f64, z: f64) -> Matrix4<f64> {
    homogeneous_matrix([[1.0, 0.0, 0.0, x], [0.0, 1.0, 0.0, y], [0.0, 0.0, 1.0, z]])
}

fn rotation_about_x(a: f64) -> Matrix4<f64> {
    let (s, c) = a.sin_cos();
    homogeneous_matrix([[1.0, 0.0, 0.0, 0.0], [0.0, c, -s, 0.0], [0.0, s, c, 0.0]])
}

fn rotation_about_y(b: f64) -> Matrix4<f64> {
    let (s, c) = b.sin_cos();
    homogeneous_matrix([[c, 0.0, s, 0.0], [0.0, 1.0, 0.0, 0.0], [-s, 0.0, c, 0.0]])
}

fn rotation_about_z(c: f64) -> Matrix4<f64> {
    let (s, c) = c.sin_cos();
    homogeneous_matrix([[c, -s, 0.0, 0.0], [s, c, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]])
}

/// Paper 2, Eq. (1): ʳT_w = D_x D_y D_z D_a D_b D_c(BY) D_b(−B) D_x(δx_CB) D_a(α_CB) D_c(−C), with the location
/// errors of its Table 1; also with values a thousand times the paper's, so that the order of the factors matters.
#[test]
fn paper_2_equation_1_is_the_workpiece_branch() {
    let chain = KinematicChain::new(&machine_of_topology("wCBFXYZt", &[])).unwrap();
    let mut random = random::seeded_stream(2, &[]);
    let mut worst: f64 = 0.0;
    for round in 0..200 {
        let scale = if round % 2 == 0 { 1.0 } else { 1000.0 };
        let [dx, dy, dz, dx_cb] =
            [1e-3, 1e-3, 1e-3, 1e-3].map(|v| v * scale * uniform_between_minus_1_and_1(&mut random));
        let [a, b, c, a_cb] = [5e-5; 4].map(|v| v * scale * uniform_between_minus_1_and_1(&mut random));
        let names = ["EX0B", "EY0B", "EZ0B", "EA0B", "EB0B", "EC0B", "EX0C", "EA0C"];
        let values = [dx, dy, dz, a, b, c, dx_cb, a_cb];
        // The order of the terms must not matter: the chain itself uses X, Y, Z, A, B, C.
        let errors: Vec<ErrorTerm> = parse_parameters(&names)
            .into_iter()
            .zip(values)
            .rev()
            .map(|(parameter, value)| ErrorTerm { parameter, value })
            .collect();
        let pose = random_pose(&mut random);
        let product = translation_matrix(dx, dy, dz)
            * rotation_about_x(a)
            * rotation_about_y(b)
            * rotation_about_z(c)
            * rotation_about_y(-pose.get_or_zero(Axis::B));
        let product = product
            * translation_matrix(dx_cb, 0.0, 0.0)
            * rotation_about_x(a_cb)
            * rotation_about_z(-pose.get_or_zero(Axis::C));
        let point = Vector3::new(80.0, -60.0, 60.0);
        let expected = product.transform_point(&point.into()).coords;
        let actual = chain.machine_from_table(&pose, &errors).transform_point(&point.into()).coords;
        worst = worst.max(actual.metric_distance(&expected));
    }
    println!("worst deviation from Eq. (1): {worst:.1e} mm");
    assert!(worst <= 1e-12, "{worst:e} mm");
}

/// Paper 4, Eq. (2), with the machine of its Table 2 (X, B, C under the table; Z, Y, S at the tool): the whole
/// machine constructed independently, each error placed as in METHODS.md section 0.
#[test]
fn paper_4_machine_as_plain_matrix_products() {
    let chain = KinematicChain::new(&machine_of_topology("wCBXFZYSt", &[])).unwrap();
    let values = [-11e-6, -8e-6, -0.105, -11e-6, -8e-6, -13e-6, -18e-6, 21e-6, 0.020, -0.106, -16e-6, 11e-6, 21e-6];
    let errors: Vec<ErrorTerm> = parse_parameters(&LOCATION_ERRORS_AND_GAINS_13)
        .into_iter()
        .zip(values)
        .map(|(parameter, value)| ErrorTerm { parameter, value })
        .collect();
    let [ea0b, ec0b, ex0c, ea0c, eb0c, eb0z, ea0y, ec0y, ey0s, ex0s, exx1, eyy1, ezz1] = values;
    let mut random = random::seeded_stream(4, &[]);
    for _ in 0..100 {
        let (pose, tip) = (random_pose(&mut random), random_tip(&mut random));
        let q = |axis: Axis| pose.get_or_zero(axis);
        let workpiece = translation_matrix(-q(Axis::X) * (1.0 + exx1), 0.0, 0.0)
            * (rotation_about_x(ea0b) * rotation_about_z(ec0b) * rotation_about_y(-q(Axis::B)))
            * (translation_matrix(ex0c, 0.0, 0.0)
                * rotation_about_x(ea0c)
                * rotation_about_y(eb0c)
                * rotation_about_z(-q(Axis::C)));
        let tool = (rotation_about_y(eb0z) * translation_matrix(0.0, 0.0, q(Axis::Z) * (1.0 + ezz1)))
            * (rotation_about_x(ea0y)
                * rotation_about_z(ec0y)
                * translation_matrix(0.0, q(Axis::Y) * (1.0 + eyy1), 0.0))
            * (translation_matrix(ex0s, ey0s, 0.0) * rotation_about_z(q(Axis::S)));
        let expected = workpiece.try_inverse().unwrap().transform_point(&tool.transform_point(&tip.mm.into())).coords;
        let actual = chain.tip_in_table(&pose, tip, &errors).mm;
        // The general matrix inverse of the independent construction has larger rounding errors than the chain
        // itself.
        assert!(actual.metric_distance(&expected) <= 5e-12, "{:e}", actual.metric_distance(&expected));
    }
}

#[test]
fn inverse_of_forward_is_identity() {
    let machines: [(&str, &[Axis], Vec<ErrorParameter>); 5] = [
        ("wCBXFZYSt", &[], location_errors_and_gains_42()),
        ("wCBFXYZt", &[Axis::B, Axis::C], error_motion_parameters(&["B", "C"])),
        ("wCAYFXZt", &[Axis::A], parse_parameters(&["EA0Y", "EC0Y", "EX0A", "EB0C"])),
        ("wCBbYXZ(C)t", &[], parse_parameters(&["EA0Y", "EC0Y", "EX0S", "EB0C", "EB0Z"])),
        ("wAFXYZBt", &[Axis::X], parse_parameters(&["EA0Y", "EC0Y", "EX0A", "EB0Z", "EX0B"])),
    ];
    let mut random = random::seeded_stream(11, &[]);
    let mut worst: f64 = 0.0;
    for (topology, reversed, set) in machines {
        let chain = KinematicChain::new(&machine_of_topology(topology, reversed)).unwrap();
        for _ in 0..50 {
            let (pose, tip) = (random_pose(&mut random), random_tip(&mut random));
            let errors = random_errors(&set, &mut random);
            let target = chain.tip_in_table(&pose, tip, &errors);
            let found = chain.solve_linear_axes(target, tip, &pose, &errors).unwrap();
            for (axis, value) in found.iter() {
                assert!(axis.is_linear());
                worst = worst.max((value - pose.get_or_zero(axis)).abs());
            }
            assert_eq!(found.iter().count(), 3);
        }
    }
    println!("worst inverse of forward: {worst:.1e} mm");
    assert!(worst <= 1e-11, "{worst:e} mm");
}
