//! Position of contact, compared with closed forms and with an independently computed pose.

use std::f64::consts::{FRAC_PI_2, TAU};

use nalgebra::{Matrix3, Matrix4, Vector2, Vector3, Vector4};

use super::super::true_round_part::{RadiusProfile, TrueCylinder};
use super::*;
use machine::record::artefact::{Artefact, Cylinder};

/// Errors of the world below, as keys of the machine file and their values.
pub(super) const STATED_ERRORS: [(&str, f64); 16] = [
    ("EX0C_um", 50.0),
    ("EY0C_um", -30.0),
    ("EA0C_urad", -110.0),
    ("EB0C_urad", 170.0),
    ("EA0B_urad", 90.0),
    ("EC0B_urad", -60.0),
    ("EB0Z_urad", 40.0),
    ("EA0Y_urad", -70.0),
    ("EC0Y_urad", 55.0),
    ("EX0S_um", 21.0),
    ("EY0S_um", -17.0),
    ("EXX1_um_per_m", 120.0),
    ("EYY1_um_per_m", -80.0),
    ("EZZ1_um_per_m", 35.0),
    ("EXC_cos2_um", 4.0),
    ("EBC_sin3_urad", 12.0),
];
pub(super) const STYLUS_CENTRE_MM: [f64; 3] = [0.4, -0.2, -100.0];

/// Ball centre by plain 4×4 products, written out by hand from the conventions of the machine's chain: errors
/// before a joint's motion in the order X, Y, Z, A, B, C, gains with the motion.
pub(super) fn ball_centre_on_table_by_products(q: &Position) -> Vector3<f64> {
    let (table, spindle) = table_and_spindle_poses_by_products(q);
    (table.try_inverse().unwrap() * spindle * homogeneous_stylus_centre()).xyz()
}

pub(super) fn homogeneous_stylus_centre() -> Vector4<f64> {
    Vector4::new(STYLUS_CENTRE_MM[0], STYLUS_CENTRE_MM[1], STYLUS_CENTRE_MM[2], 1.0)
}

/// Poses of table and spindle.
pub(super) fn table_and_spindle_poses_by_products(q: &Position) -> (Matrix4<f64>, Matrix4<f64>) {
    let shift = |x, y, z| Matrix4::new_translation(&Vector3::new(x, y, z));
    let rows = |r: [[f64; 3]; 3]| Matrix3::from(r).transpose().to_homogeneous();
    let about_x = |a: f64| rows([[1.0, 0.0, 0.0], [0.0, a.cos(), -a.sin()], [0.0, a.sin(), a.cos()]]);
    let about_y = |b: f64| rows([[b.cos(), 0.0, b.sin()], [0.0, 1.0, 0.0], [-b.sin(), 0.0, b.cos()]]);
    let about_z = |c: f64| rows([[c.cos(), -c.sin(), 0.0], [c.sin(), c.cos(), 0.0], [0.0, 0.0, 1.0]]);
    let [x, y, z, b, c, s] = [Axis::X, Axis::Y, Axis::Z, Axis::B, Axis::C, Axis::S].map(|a| q.get_or_zero(a));
    let table = shift(-x * (1.0 + 120e-6), 0.0, 0.0)
        * about_x(90e-6)
        * about_z(-60e-6)
        * about_y(-b)
        * shift(0.050 + 0.004 * (2.0 * c).cos(), -0.030, 0.0)
        * about_x(-110e-6)
        * about_y(170e-6 + 12e-6 * (3.0 * c).sin())
        * about_z(-c);
    let spindle = about_y(40e-6)
        * shift(0.0, 0.0, z * (1.0 + 35e-6))
        * about_x(-70e-6)
        * about_z(55e-6)
        * shift(0.0, y * (1.0 - 80e-6), 0.0)
        * shift(0.021, -0.017, 0.0)
        * about_z(s);
    (table, spindle)
}

/// X, Y, Z that bring the ball to `target` with the other axes unchanged: the pose by products is affine in them.
pub(super) fn position_for_ball_centre(target: Vector3<f64>, others: &Position) -> Position {
    let origin = ball_centre_on_table_by_products(others);
    let column = |axis| ball_centre_on_table_by_products(&others.clone().with(axis, 1.0)) - origin;
    let inverse = Matrix3::from_columns(&Axis::LINEAR.map(column)).try_inverse().unwrap();
    let at = |xyz: Vector3<f64>| others.updated_by(&Position::from_xyz(xyz));
    let mut xyz = inverse * (target - origin);
    for _ in 0..2 {
        xyz += inverse * (target - ball_centre_on_table_by_products(&at(xyz)));
    }
    at(xyz)
}

/// Share of the segment `from`..`to` at which the distance from the axis (through `foot`, along the unit vector
/// `along`) is `radius`: the smaller root of a quadratic.
pub(super) fn path_fraction_at_cylinder(
    from: Vector3<f64>,
    to: Vector3<f64>,
    foot: Vector3<f64>,
    along: Vector3<f64>,
    radius: f64,
) -> f64 {
    let across = |v: Vector3<f64>| v - along * along.dot(&v);
    let (p, d) = (across(from - foot), across(to - from));
    let (a, half_b, c) = (d.dot(&d), p.dot(&d), p.dot(&p) - radius * radius);
    (-half_b - (half_b * half_b - a * c).sqrt()) / a
}

#[test]
fn contact_on_a_cylinder_agrees_with_poses_by_matrix_products() {
    let mut bench = TestBench::ideal();
    bench.machine.tool_mm = STYLUS_CENTRE_MM;
    bench.truth.errors = STATED_ERRORS.map(|(key, value)| (key.to_owned(), value)).into();
    bench.truth.centre_offset_mm = [1.2, -1.6];
    bench.truth.radius_offset_mm = 0.3;
    let Artefact::Cylinder(Cylinder { axis, .. }) = &mut bench.artefact else { panic!() };
    *axis = [0.02, -0.01, 1.0];
    let (along, foot) = (Vector3::from(*axis).normalize(), Vector3::new(1.2, -1.6, 0.0));
    for (number, (b, c, s)) in [(0.0, 0.0, 0.0), (0.0, 45.0, 45.0), (0.0, -250.0, 10.0), (30.0, 100.0, 200.0)]
        .map(|(b, c, s): (f64, f64, f64)| (b.to_radians(), c.to_radians(), s.to_radians()))
        .into_iter()
        .enumerate()
    {
        let mut world = bench.build_world();
        let others = Position::new().with(Axis::B, b).with(Axis::C, c).with(Axis::S, s);
        let psi = 0.3 + 1.7 * number as f64;
        let outward = Vector3::new(psi.cos(), psi.sin(), 0.0);
        let start = position_for_ball_centre(outward * 70.0 + Vector3::new(0.0, 3.0, 40.0), &others);
        let end = position_for_ball_centre(outward * 35.0 + Vector3::z() * 55.0, &others);
        // The path to the start leads through the part; the test checks only the touch.
        world.travel(&start, Speed::Rapid);
        assert!(!world.is_probe_closed());
        let probed = world.probe(&end.filter_axes(Axis::is_linear), 60.0, 1);
        let (from, to) = (ball_centre_on_table_by_products(&start), ball_centre_on_table_by_products(&end));
        let root = path_fraction_at_cylinder(from, to, foot, along, BALL_CENTRE_CIRCLE_RADIUS_MM + 0.3);
        let contact = probed.contact.unwrap().latched_position;
        for axis in Axis::LINEAR {
            let expected = start.get_or_zero(axis) + root * (end.get_or_zero(axis) - start.get_or_zero(axis));
            let error = (contact.get_or_zero(axis) - expected).abs();
            assert!(error <= 1e-9, "pose {number}, {axis}: {error:e}");
        }
    }
}

#[test]
fn axis_position_has_the_closed_form_of_a_tilted_line() {
    let mut bench = TestBench::ideal();
    for (key, value) in [("EX0C_um", 50.0), ("EY0C_um", -30.0), ("EA0C_urad", -110.0)] {
        bench.truth.errors.insert(key.to_owned(), value);
    }
    bench.truth.errors.insert("EB0C_urad".to_owned(), 170.0);
    bench.truth.errors.insert("EXC_sin1_um".to_owned(), 5.0);
    let world = bench.build_world();
    let (a, b) = (-110e-6_f64, 170e-6_f64);
    for height in [0.0, 80.0] {
        let [x, y] = world.true_rotary_axis_position_mm(Axis::C, height, 0.0);
        assert!((x - (0.050 + height * b.tan() / a.cos())).abs() < 1e-9);
        assert!((y - (-0.030 - height * a.tan())).abs() < 1e-9);
    }
}

#[test]
fn nearest_point_of_uneven_profile_agrees_with_dense_search() {
    let form = [(2, 80.0, -40.0), (3, 900.0, 0.0), (7, 30.0, 60.0), (31, 0.0, 8.0)]
        .map(|(n, cos_um, sin_um)| FormHarmonic { n, cos_um, sin_um });
    let radius = |psi: f64| {
        form.iter().fold(PART_RADIUS_MM + 0.2, |r, h| {
            let angle = f64::from(h.n) * psi;
            r + 1e-3 * (h.cos_um * angle.cos() + h.sin_um * angle.sin())
        })
    };
    let towards = |angle: f64| Vector2::new(angle.cos(), angle.sin());
    let cylinder = TrueCylinder::new(Vector3::zeros(), Vector3::z(), 100.0, RadiusProfile::new(PART_RADIUS_MM, form));
    for step in 0..20 {
        let angle = 0.314 * f64::from(step);
        let rho = [48.2, 45.9, 60.0, 44.0][step as usize % 4];
        let point = towards(angle) * rho;
        const DENSE_SEARCH_SAMPLES: u32 = 200_000;
        let dense = (0..DENSE_SEARCH_SAMPLES)
            .map(|i| TAU * f64::from(i) / f64::from(DENSE_SEARCH_SAMPLES))
            .map(|psi| point.metric_distance(&(towards(psi) * radius(psi))))
            .fold(f64::INFINITY, f64::min);
        let nearest = cylinder.nearest(point.push(50.0), 0.2);
        let sign = if rho < radius(angle) { -1.0 } else { 1.0 };
        // A sample is within half a spacing (0.7 µm) of the foot. The error is 1e-7 mm at a distance of 3 mm, and
        // the spacing itself where the point is on the profile.
        assert!(nearest.signed_distance.abs() <= dense + 1e-9);
        assert!((nearest.signed_distance - sign * dense).abs() < 8e-4, "{angle}");
        if dense > 1.0 {
            assert!((nearest.signed_distance - sign * dense).abs() < 2e-7, "{angle}");
        }
        // A step of the distance along the normal leads to the surface.
        let foot = point.push(50.0) - nearest.outward_normal * nearest.signed_distance;
        assert!((foot.xy().norm() - radius(foot.y.atan2(foot.x))).abs() < 1e-9);
    }
}

#[test]
fn cylinder_has_a_flat_top_at_its_height() {
    let cylinder = TrueCylinder::new(Vector3::zeros(), Vector3::z(), 100.0, RadiusProfile::new(PART_RADIUS_MM, []));
    let at = |x: f64, z: f64| cylinder.nearest(Vector3::new(x, 0.0, z), 0.0);
    assert_eq!(at(0.0, 104.0).signed_distance, 4.0);
    assert_eq!(at(10.0, 104.0).outward_normal, Vector3::z());
    assert!((at(PART_RADIUS_MM + 3.0, 104.0).signed_distance - 5.0).abs() < 1e-12);
    assert!((at(PART_RADIUS_MM - 2.0, 50.0).signed_distance + 2.0).abs() < 1e-12);
    assert!((at(PART_RADIUS_MM + 2.0, -0.0).outward_normal - Vector3::x()).norm() < 1e-12);
}

#[test]
fn form_harmonic_changes_the_touched_radius_at_its_angle() {
    let mut bench = TestBench::ideal();
    bench.truth.form = vec![FormHarmonic { n: 3, cos_um: 100.0, sin_um: 0.0 }];
    let mut world = bench.build_world();
    // On a crest and in a hollow the profile is perpendicular to its radius.
    assert!((touch_radius_and_latch_time(&mut world, 0.0, 0.0, 1).0 - BALL_CENTRE_CIRCLE_RADIUS_MM - 0.1).abs() < 1e-9);
    assert!(
        (touch_radius_and_latch_time(&mut world, TAU / 6.0, 0.0, 2).0 - BALL_CENTRE_CIRCLE_RADIUS_MM + 0.1).abs()
            < 1e-9
    );
    // C turned by 90°: a positive command of the table turns the part in the opposite direction (ISO 841).
    world.travel(&Position::new().with(Axis::C, FRAC_PI_2), Speed::Rapid);
    assert!(
        (touch_radius_and_latch_time(&mut world, -FRAC_PI_2, 0.0, 3).0 - BALL_CENTRE_CIRCLE_RADIUS_MM - 0.1).abs()
            < 1e-9
    );
}
