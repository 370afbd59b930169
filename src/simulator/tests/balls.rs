//! Contact with balls and stems, compared with closed forms, a pose by matrix products and a dense search.

use std::f64::consts::PI;

use nalgebra::{Matrix3, Matrix4, Vector3};

use super::super::balls::TrueBalls;
use super::contact::{
    STATED_ERRORS, STYLUS_CENTRE_MM, ball_centre_on_table_by_products, homogeneous_stylus_centre,
    path_fraction_at_cylinder, position_for_ball_centre, table_and_spindle_poses_by_products,
};
use super::*;
use machine::frame::perpendicular_directions;
use machine::record::artefact::Artefact;

const TWO_BALLS: &str = "
    [[balls]]\nid = 'low'\ncentre_mm = [120.0, -30.0, 50.0]\nradius_mm = 6.35
    [[balls]]\nid = 'high'\ncentre_mm = [-70.0, 80.0, 170.0]\nradius_mm = 8.0
    stem = [0.3, -0.1, -1.0]\nstem_radius_mm = 2.5\nstem_length_mm = 160.0
";
const HIGH_BALL_CENTRE_MM: Vector3<f64> = Vector3::new(-70.0, 80.0, 170.0);

/// A machine with errors in all its axes.
fn bench_with_axis_errors() -> TestBench {
    let mut bench = TestBench::with_balls(TWO_BALLS);
    bench.machine.tool_mm = STYLUS_CENTRE_MM;
    bench.truth.errors = STATED_ERRORS.map(|(key, value)| (key.to_owned(), value)).into();
    bench
}

/// Rotary positions, deg.
const ROTARY_POSES_DEG: [[f64; 3]; 4] =
    [[0.0, 0.0, 0.0], [30.0, 100.0, 200.0], [-90.0, 180.0, 90.0], [90.0, -250.0, 10.0]];

fn rotary_position_from_deg([b, c, s]: [f64; 3]) -> Position {
    let at = Position::new().with(Axis::B, b.to_radians());
    at.with(Axis::C, c.to_radians()).with(Axis::S, s.to_radians())
}

/// Touches along the straight path of the axes from `start` to `end` (points on the table, by matrix products) and
/// checks that the contact is at the share `expected_fraction` of the path.
fn assert_contact_at_path_fraction(bench: &TestBench, [start, end]: [&Position; 2], expected_fraction: f64) {
    let mut world = bench.build_world();
    world.travel(start, Speed::Rapid);
    let probed = world.probe(&end.filter_axes(Axis::is_linear), 60.0, 1);
    let contact = probed.contact.expect("contact").latched_position;
    for axis in Axis::LINEAR {
        let travel = end.get_or_zero(axis) - start.get_or_zero(axis);
        let expected = start.get_or_zero(axis) + expected_fraction * travel;
        let error = (contact.get_or_zero(axis) - expected).abs();
        assert!(error <= 1e-9, "{axis}: {error:e}");
    }
}

/// The smaller root of |from + t·(to − from) − centre| = radius.
fn path_fraction_at_sphere(from: Vector3<f64>, to: Vector3<f64>, centre: Vector3<f64>, radius: f64) -> f64 {
    let (p, d) = (from - centre, to - from);
    let (a, half_b, c) = (d.dot(&d), p.dot(&d), p.dot(&p) - radius * radius);
    (-half_b - (half_b * half_b - a * c).sqrt()) / a
}

#[test]
fn contact_on_a_ball_agrees_with_poses_by_matrix_products() {
    let mut bench = bench_with_axis_errors();
    bench.truth.ball =
        toml::from_str::<MachineTruth>("[[ball]]\nid = 'high'\noffset_mm = [0.2, -0.1, 0.3]\ndiameter_um = 50.0")
            .unwrap()
            .ball;
    let centre = HIGH_BALL_CENTRE_MM + Vector3::new(0.2, -0.1, 0.3);
    for pose in ROTARY_POSES_DEG {
        let others = rotary_position_from_deg(pose);
        for approach in [Vector3::new(0.4, 0.3, 1.0), Vector3::new(-1.0, 0.2, 0.1), Vector3::y()] {
            let outward = approach.normalize();
            let aside = perpendicular_directions(outward)[0] * 1.5;
            let start = position_for_ball_centre(centre + outward * 14.0 + aside, &others);
            let end = position_for_ball_centre(centre + outward * 5.0 + aside, &others);
            let [from, to] = [&start, &end].map(ball_centre_on_table_by_products);
            let root = path_fraction_at_sphere(from, to, centre, 8.025 + STYLUS_BALL_RADIUS_MM);
            assert_contact_at_path_fraction(&bench, [&start, &end], root);
        }
    }
}

#[test]
fn stem_causes_contact_at_its_position() {
    let bench = bench_with_axis_errors();
    let along = Vector3::new(0.3, -0.1, -1.0).normalize();
    let middle = HIGH_BALL_CENTRE_MM + along * 90.0;
    for pose in ROTARY_POSES_DEG {
        let others = rotary_position_from_deg(pose);
        let outward = perpendicular_directions(along)[0];
        let start = position_for_ball_centre(middle + outward * 9.0 + along * 4.0, &others);
        let end = position_for_ball_centre(middle + outward * 4.0, &others);
        let [from, to] = [&start, &end].map(ball_centre_on_table_by_products);
        assert_contact_at_path_fraction(
            &bench,
            [&start, &end],
            path_fraction_at_cylinder(from, to, HIGH_BALL_CENTRE_MM, along, 2.5 + STYLUS_BALL_RADIUS_MM),
        );
    }
    // Below its foot the stem ends.
    let mut world = bench.build_world();
    let others = rotary_position_from_deg(ROTARY_POSES_DEG[0]);
    let below = HIGH_BALL_CENTRE_MM + along * (160.0 + STYLUS_BALL_RADIUS_MM + 0.1);
    let aside = perpendicular_directions(along)[0] * 20.0;
    world.travel(&position_for_ball_centre(below + aside, &others), Speed::Rapid);
    let end = position_for_ball_centre(below - aside, &others).filter_axes(Axis::is_linear);
    assert_eq!(world.probe(&end, 60.0, 1).contact, None);
    let higher = position_for_ball_centre(below - along * 0.2 - aside, &others).filter_axes(Axis::is_linear);
    world.travel(&position_for_ball_centre(below + aside - along * 0.2, &others), Speed::Rapid);
    assert!(world.probe(&higher, 60.0, 1).contact.is_some());
}

#[test]
fn sag_displaces_and_rotates_the_table_as_declared() {
    for (law, share) in [("sin", -(60.0_f64.to_radians().sin())), ("one-minus-cos", 0.5)] {
        let mut bench = bench_with_axis_errors();
        let sag = format!("[[sag]]\naxis = 'B'\nlaw = '{law}'\num = [3.0, -40.0, 20.0]\nurad = [0.0, 0.0, 300.0]");
        bench.truth.sag = toml::from_str::<MachineTruth>(&sag).unwrap().sag;
        // The start follows from the nominal pose; the contact must be where the pose with sag predicts it.
        let others = rotary_position_from_deg([-60.0, 35.0, 0.0]);
        let bent = |q: &Position| {
            let (table, spindle) = table_and_spindle_poses_by_products(q);
            let origin = table.column(3).xyz();
            let turn = Matrix4::new_translation(&origin)
                * Matrix4::new_rotation(Vector3::z() * 300e-6 * share)
                * Matrix4::new_translation(&-origin);
            let down = Matrix4::new_translation(&(Vector3::new(0.003, -0.040, 0.020) * share));
            ((down * turn * table).try_inverse().unwrap() * spindle * homogeneous_stylus_centre()).xyz()
        };
        let outward = Vector3::new(0.1, 0.9, 0.4).normalize();
        let start = position_for_ball_centre(HIGH_BALL_CENTRE_MM + outward * 14.0, &others);
        let end = position_for_ball_centre(HIGH_BALL_CENTRE_MM + outward * 9.0, &others);
        let root = path_fraction_at_sphere(bent(&start), bent(&end), HIGH_BALL_CENTRE_MM, 8.0 + STYLUS_BALL_RADIUS_MM);
        assert_contact_at_path_fraction(&bench, [&start, &end], root);
        // The difference from a table without sag is some 20 µm of 5 mm, well above the tolerance.
        let [from, to] = [&start, &end].map(ball_centre_on_table_by_products);
        assert!(
            (root - path_fraction_at_sphere(from, to, HIGH_BALL_CENTRE_MM, 8.0 + STYLUS_BALL_RADIUS_MM)).abs() > 2e-3
        );
    }
}

#[test]
fn loose_ball_is_displaced_from_the_stated_time() {
    let mut bench = TestBench::with_balls(TWO_BALLS);
    let moves = "[[ball_moves]]\nball = 'low'\nat_s = 3600.0\nby_mm = [0.02, 0.0, -0.01]";
    bench.truth.ball_moves = toml::from_str::<MachineTruth>(moves).unwrap().ball_moves;
    let mut world = bench.build_world();
    let low = Vector3::new(120.0, -30.0, 50.0);
    let mut touch = |outward: Vector3<f64>, centre: Vector3<f64>| {
        let at = |off: f64| {
            let place = centre + outward * off;
            position_with_ball_at(place.x, place.y, place.z)
        };
        world.travel(&at(13.0), Speed::Rapid);
        let contact = world.probe(&at(7.0), 60.0, 1).contact.unwrap();
        world.travel(&at(13.0), Speed::Rapid);
        let [x, y, z] = Axis::LINEAR.map(|axis| contact.latched_position.get_or_zero(axis));
        let found = (Vector3::new(x, y, z - 100.0) - centre).dot(&outward);
        world.dwell(4000.0);
        found
    };
    let sum = 6.35 + STYLUS_BALL_RADIUS_MM;
    assert!((touch(Vector3::x(), low) - sum).abs() < 1e-9);
    // A lateral offset shortens the chord by at most 0.01²/(2·9.35) mm.
    assert!((touch(Vector3::x(), low) - sum - 0.02).abs() < 6e-6);
    assert!((touch(Vector3::z(), low) - sum + 0.01).abs() < 3e-5);
    assert!((touch(Vector3::z(), HIGH_BALL_CENTRE_MM) - 8.0 - STYLUS_BALL_RADIUS_MM).abs() < 1e-9);
}

/// The balls as drawn from the seed.
fn draw_balls(truth: &MachineTruth, seed: u64, text: &str) -> TrueBalls {
    let Artefact::Balls(stated) = TestBench::with_balls(text).artefact else { panic!() };
    TrueBalls::new(&stated, &MachineTruth { seed, ..truth.clone() }).unwrap()
}

#[test]
fn ball_positions_diameters_and_form_have_the_declared_variance() {
    let truth = "ball_offset_mm = 0.3\nball_diameter_um = 4.0\nball_form_um = 0.5";
    let truth: MachineTruth = toml::from_str(truth).unwrap();
    const SEEDS: u64 = 2000;
    let mut squares = [0.0; 6];
    for seed in 0..SEEDS {
        let balls = draw_balls(&truth, seed, TWO_BALLS);
        let centre = balls.centre(1, 0.0);
        // Distances along opposite directions: their sum contains the diameter, whose form part is twice that of
        // one direction.
        let out = [Vector3::x(), -Vector3::x(), Vector3::z()]
            .map(|direction| balls.nearest(centre + direction * 8.0, 0.0).signed_distance * 1e3);
        let off = centre - HIGH_BALL_CENTRE_MM;
        let values = [off.x, off.y, off.z, out[0], out[0] - out[1], out[0] - out[2]];
        for (sum, value) in squares.iter_mut().zip(values) {
            *sum += value * value;
        }
    }
    // Radius: half the diameter's 4 µm and the form's 0.5. An oval is equal in opposite directions. Between X and Z
    // the form's variance is that of s_xx − s_zz, 2·1.5·0.5².
    let expected = [0.09, 0.09, 0.09, 4.0 + 0.25, 0.0, 0.75];
    for (sum, expected) in squares.into_iter().zip(expected) {
        let found = sum / SEEDS as f64;
        // The standard deviation of a variance over 2000 seeds is 3.2 %.
        assert!((found - expected).abs() <= 0.12 * expected + 1e-6, "{found} not {expected}");
    }
}

#[test]
fn distance_of_an_oval_ball_agrees_with_a_dense_search() {
    let truth: MachineTruth = toml::from_str("ball_form_um = 200.0").unwrap();
    let balls = draw_balls(&truth, 4, TWO_BALLS);
    let centre = balls.centre(1, 0.0);
    // Radius of the surface along a direction, by bisection.
    let radius = |direction: Vector3<f64>| {
        let (mut low, mut high) = (6.0, 10.0);
        for _ in 0..60 {
            let middle = (low + high) / 2.0;
            let inside = balls.nearest(centre + direction * middle, 0.0).signed_distance < 0.0;
            (low, high) = if inside { (middle, high) } else { (low, middle) };
        }
        low
    };
    // A quadratic form has 5 parameters besides the mean: samples in a few directions determine it.
    let quadratic = {
        let r = |x: f64, y: f64, z: f64| radius(Vector3::new(x, y, z).normalize());
        let (xx, yy, zz) = (r(1.0, 0.0, 0.0), r(0.0, 1.0, 0.0), r(0.0, 0.0, 1.0));
        let [xy, xz, yz] = [r(1.0, 1.0, 0.0), r(1.0, 0.0, 1.0), r(0.0, 1.0, 1.0)];
        let off = [xy - (xx + yy) / 2.0, xz - (xx + zz) / 2.0, yz - (yy + zz) / 2.0];
        Matrix3::from([[xx, off[0], off[1]], [off[0], yy, off[2]], [off[1], off[2], zz]])
    };
    let surface = |u: Vector3<f64>| u * u.dot(&(quadratic * u));
    let mut apart = 0.0_f64;
    for point in [Vector3::new(9.0, 5.0, 3.0), Vector3::new(-4.0, 11.0, 6.0), Vector3::new(1.0, 7.0, -9.0)] {
        let nearest = balls.nearest(centre + point, 0.0);
        let start = point.normalize();
        let [a, b] = perpendicular_directions(start);
        let steps = || (-400..=400).map(|i| f64::from(i) * 2.5e-4);
        let dense = steps()
            .flat_map(|i| steps().map(move |j| (start + a * i + b * j).normalize()))
            .map(|u| point.metric_distance(&surface(u)))
            .fold(f64::INFINITY, f64::min);
        assert!((nearest.signed_distance - dense).abs() < 1e-6, "{} not {dense}", nearest.signed_distance);
        assert!(nearest.signed_distance <= dense + 1e-9);
        let foot = point - nearest.outward_normal * nearest.signed_distance;
        assert!((foot - surface(foot.normalize())).norm() < 1e-9);
        apart = apart.max(point.metric_distance(&surface(start)) - nearest.signed_distance);
    }
    // Along the line to the centre the distance is larger: the test detects the difference.
    assert!(apart > 1e-3, "{apart}");
}

const BALLS_WITH_CERTIFIED_LENGTHS: &str = "
    [[balls]]\nid = 'a'\ncentre_mm = [-150.0, 0.0, 40.0]\nradius_mm = 6.0
    [[balls]]\nid = 'b'\ncentre_mm = [150.0, 0.0, 41.0]\nradius_mm = 6.0
    [[balls]]\nid = 'c'\ncentre_mm = [0.0, 200.0, 41.0]\nradius_mm = 6.0
    [[lengths]]\nfrom = 'a'\nto = 'b'\nmm = 300.1\nu_mm = 0.002\nexpansion_um_per_m_k = 11.0
    temperature_c = 22.0\nu_temperature_k = 0.5
    [[lengths]]\nfrom = 'c'\nto = 'a'\nmm = 250.2\nu_mm = 0.001
";

#[test]
fn drawn_lengths_have_the_mean_and_variance_of_their_certificates() {
    let truth: MachineTruth = toml::from_str("ball_offset_mm = 0.1").unwrap();
    const SEEDS: u64 = 2000;
    let mut draws = [Vec::new(), Vec::new()];
    for seed in 0..SEEDS {
        let balls = draw_balls(&truth, seed, BALLS_WITH_CERTIFIED_LENGTHS);
        let apart = |i, j| balls.centre(i, 0.0).metric_distance(&balls.centre(j, 0.0));
        draws[0].push(apart(0, 1));
        draws[1].push(apart(2, 0));
    }
    // 300.1 mm, 2 K warmer: 6.6022 µm. The temperature uncertainty of 0.5 K gives 1.65 µm, the certificate 2 µm.
    for (found, mean, sd) in [(&draws[0], 300.106_602_2, 2e-3_f64.hypot(1.650_6e-3)), (&draws[1], 250.2, 1e-3)] {
        let average = found.iter().sum::<f64>() / SEEDS as f64;
        assert!((average - mean).abs() < 4.0 * sd / (SEEDS as f64).sqrt(), "{average}");
        let variance = found.iter().map(|d| (d - average).powi(2)).sum::<f64>() / SEEDS as f64;
        assert!((variance / (sd * sd) - 1.0).abs() < 0.12, "{variance}");
    }
    let wrong: MachineTruth = toml::from_str("length_error_um_per_m = 300.0").unwrap();
    let [right, off] =
        [MachineTruth::default(), wrong].map(|truth| draw_balls(&truth, 5, BALLS_WITH_CERTIFIED_LENGTHS));
    let apart = |balls: &TrueBalls| balls.centre(0, 0.0).metric_distance(&balls.centre(1, 0.0));
    assert!((apart(&off) / apart(&right) - 1.0 - 300e-6).abs() < 1e-12);
}

#[test]
fn declared_stylus_offset_displaces_the_contact() {
    let mut bench = TestBench::with_balls(TWO_BALLS);
    bench.truth.tool_offset_um = [30.0, 0.0, -20.0];
    let mut world = bench.build_world();
    world.travel(
        &position_with_ball_at(HIGH_BALL_CENTRE_MM.x, HIGH_BALL_CENTRE_MM.y, HIGH_BALL_CENTRE_MM.z + 15.0)
            .with(Axis::S, PI),
        Speed::Rapid,
    );
    let contact = world
        .probe(&position_with_ball_at(HIGH_BALL_CENTRE_MM.x, HIGH_BALL_CENTRE_MM.y, HIGH_BALL_CENTRE_MM.z), 60.0, 1)
        .contact
        .unwrap();
    // 20 µm lower, and 30 µm to the side: 0.03²/22 mm.
    let z = contact.latched_position.get_or_zero(Axis::Z) - 100.0 - HIGH_BALL_CENTRE_MM.z;
    assert!((z - 0.020 - (121.0_f64 - 0.03 * 0.03).sqrt()).abs() < 1e-9);
}

#[test]
fn unusable_truth_is_refused_with_its_reason() {
    let said = |text: &str, bench: TestBench| {
        let truth: MachineTruth = toml::from_str(text).unwrap();
        SimulatedWorld::new(&bench.machine, &bench.probe, &bench.artefact, &truth).unwrap_err().to_string()
    };
    let balls = || TestBench::with_balls(TWO_BALLS);
    assert!(said("roughness_um = 1.0", balls()).contains("roughness_um is valid only for an artefact"));
    assert!(said("[[form]]\nn = 2", balls()).contains("\"cylinder\""));
    assert!(said("ball_form_um = 0.1", TestBench::ideal()).contains("\"balls\""));
    assert!(said("[[ball]]\nid = 'hi'", balls()).contains("refers to ball `hi`"));
    assert!(said("[[ball]]\nid = 'hi'", TestBench::ideal()).contains("ball is valid only for an artefact"));
    assert!(said("[[sag]]\naxis = 'X'", balls()).contains("no rotary axis X"));
    assert!(said("ball_diameter_um = -1.0", balls()).contains("must not be negative"));
    assert!(said("radius_offset_mm = -6.5", balls()).contains("each ball of positive radius"));
    let moved = "[[ball_moves]]\nball = 'lo'\nat_s = 1\nby_mm = [0, 0, 1]";
    assert!(said(moved, balls()).contains("refers to ball `lo`"));
}

#[test]
fn drift_moves_the_table_along_the_spindle_too() {
    let mut bench = TestBench::with_balls(TWO_BALLS);
    bench.truth.seed = 11;
    bench.machine.drift_um_per_h = 40.0;
    let mut world = bench.build_world();
    world.travel(
        &position_with_ball_at(HIGH_BALL_CENTRE_MM.x, HIGH_BALL_CENTRE_MM.y, HIGH_BALL_CENTRE_MM.z + 15.0),
        Speed::Rapid,
    );
    world.dwell(7200.0);
    let contact = world
        .probe(&position_with_ball_at(HIGH_BALL_CENTRE_MM.x, HIGH_BALL_CENTRE_MM.y, HIGH_BALL_CENTRE_MM.z), 60.0, 1)
        .contact
        .unwrap();
    let moved = super::super::random_draws::ThermalDrift::draw(11, 40.0).table_displacement_mm(contact.latch_time_s);
    let perpendicular_directions = 121.0 - moved.xy().norm_squared();
    let z = contact.latched_position.get_or_zero(Axis::Z) - 100.0 - HIGH_BALL_CENTRE_MM.z;
    assert!((z - moved.z - perpendicular_directions.sqrt()).abs() < 1e-9);
    assert!(moved.z.abs() > 1e-3);
}
