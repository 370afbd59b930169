//! Sensors on the bed around a datum cylinder that C turns, compared with numbers computed by hand.

use super::*;
use machine::record::sensor::Sensor;

/// A machine with a cylinder of radius 30 mm, two sections and a face, with the given true errors.
fn bench_with_datum_cylinder(truth: &str) -> TestBench {
    let artefact = "kind = 'datum_cylinder'\ncentre_mm = [0, 0, 0]\naxis = [0, 0, 1]\n\
        sections = [{ z_mm = 60, radius_mm = 30 }, { z_mm = 120, radius_mm = 30 }]\n\
        face = { z_mm = 140, radius_mm = 30 }";
    let artefact = toml::from_str(artefact).unwrap();
    TestBench { artefact, truth: toml::from_str(truth).unwrap(), ..TestBench::ideal() }
}

fn sensor_on_mount(name: &str, mount: &str, zero: [f64; 3], direction: [f64; 3]) -> Sensor {
    let (zero, direction) = (format!("{zero:?}"), format!("{direction:?}"));
    toml::from_str(&format!(
        "name = '{name}'\nmount = '{mount}'\nzero_mm = {zero}\ndirection = {direction}\n\
         range_mm = [-1.0, 1.0]\nstand_off_mm = 2.0"
    ))
    .unwrap()
}

/// Sensors on the bed: at the first section, at the second section, and above the face.
fn bed_sensors() -> [Sensor; 3] {
    [
        sensor_on_mount("low", "bed", [30.0, 0.0, 60.0], [-1.0, 0.0, 0.0]),
        sensor_on_mount("high", "bed", [30.0, 0.0, 120.0], [-1.0, 0.0, 0.0]),
        sensor_on_mount("face", "bed", [20.0, 0.0, 140.0], [0.0, 0.0, -1.0]),
    ]
}

fn world_with_bed_sensors(truth: &str) -> SimulatedWorld {
    bench_with_datum_cylinder(truth).build_world().with_sensors(&bed_sensors()).unwrap()
}

/// Readings of the three sensors with C at this angle, mm.
fn readings_at_c_angle(world: &mut SimulatedWorld, degrees: f64) -> [f64; 3] {
    world.travel(&Position::new().with(Axis::C, degrees.to_radians()), Speed::Rapid);
    ["low", "high", "face"].map(|name| match world.sample_after(name, 0.0) {
        Some(SensorOutput::Distance(mm)) => mm,
        other => panic!("{other:?}"),
    })
}

#[track_caller]
fn assert_readings_near(found: [f64; 3], expected: [f64; 3]) {
    for (found, expected) in found.into_iter().zip(expected) {
        assert!((found - expected).abs() < 1e-8, "{found} {expected}");
    }
}

/// C turns the table against its command, seen from above (ISO 841).
#[test]
fn an_eccentric_cylinder_is_nearer_on_one_side() {
    let mut world = world_with_bed_sensors("centre_offset_mm = [0.01, 0.0]");
    assert_readings_near(readings_at_c_angle(&mut world, 0.0), [-0.01, -0.01, 0.0]);
    let aside = 30.0 - (30.0_f64.powi(2) - 0.01_f64.powi(2)).sqrt();
    assert_readings_near(readings_at_c_angle(&mut world, 90.0), [aside, aside, 0.0]);
    assert_readings_near(readings_at_c_angle(&mut world, 180.0), [0.01, 0.01, 0.0]);
}

#[test]
fn each_section_and_the_face_has_a_form_of_its_own() {
    let truth = "[datum_cylinder]\nsection_form = [{ section = 2, n = 3, cos_um = 2.0 }]\n\
                 face_form = [{ n = 2, cos_um = 1.0 }]";
    let mut world = world_with_bed_sensors(truth);
    assert_readings_near(readings_at_c_angle(&mut world, 0.0), [0.0, -0.002, -0.001]);
    // The artefact's 60° direction faces the sensors: cos 180°; for the face cos 120°.
    assert_readings_near(readings_at_c_angle(&mut world, 60.0), [0.0, 0.002, 0.0005]);
}

#[test]
fn indexing_stage_turns_the_artefact_with_its_declared_index_error() {
    let truth = "[datum_cylinder]\nsection_form = [{ section = 2, n = 3, cos_um = 2.0 }]\n\
                 [stage]\nfaults = [{ mounting = 2, off_deg = 20.0 }]";
    let mut world = world_with_bed_sensors(truth);
    world.remount_datum_cylinder(40.0);
    // The artefact's −40° direction faces the sensor: cos −120°.
    assert_readings_near(readings_at_c_angle(&mut world, 0.0), [0.0, 0.001, 0.0]);
    world.remount_datum_cylinder(40.0);
    assert_readings_near(readings_at_c_angle(&mut world, 0.0), [0.0, 0.001, 0.0]);
    // The second mounting: −60°, and its index error of −20°.
    world.remount_datum_cylinder(60.0);
    let expected = -0.002 * (3.0_f64 * -80.0).to_radians().cos();
    assert_readings_near(readings_at_c_angle(&mut world, 0.0), [0.0, expected, 0.0]);
}

#[test]
fn each_mounting_draws_an_eccentricity_that_repeats_with_the_seed() {
    let truth = "seed = 3\n[stage]\neccentricity_um = 2.0";
    let mut one = world_with_bed_sensors(truth);
    let first = readings_at_c_angle(&mut one, 0.0);
    assert_readings_near(first, [0.0; 3]);
    let moved = [36.0, 72.0].map(|turn_deg| {
        one.remount_datum_cylinder(turn_deg);
        readings_at_c_angle(&mut one, 0.0)
    });
    assert!(moved[0] != moved[1] && moved.iter().all(|[low, ..]| low.abs() < 0.01), "{moved:?}");
    let mut other = world_with_bed_sensors(truth);
    [36.0, 72.0].into_iter().for_each(|turn_deg| other.remount_datum_cylinder(turn_deg));
    assert_readings_near(readings_at_c_angle(&mut other, 0.0), moved[1]);
}

#[test]
fn tilted_cylinder_is_displaced_in_proportion_to_height() {
    let mut world = world_with_bed_sensors("[datum_cylinder]\ntilt_urad = [1000.0, 0.0]");
    let [low, high, _] = readings_at_c_angle(&mut world, 0.0);
    // Second order: (1 − cos) of the tilt, times the radius.
    assert!((low + 0.06).abs() < 2e-5 && (high + 0.12).abs() < 2e-5, "{low} {high}");
}

#[test]
fn drawn_motions_repeat_after_one_turn_and_half_orders_after_two() {
    let motion = "[[rotary_motion]]\naxis = 'C'\nlinear_um = 1.0\nmax_order = 20\n";
    let mut world = world_with_bed_sensors(&format!("seed = 5\n{motion}"));
    let motion_x =
        |world: &SimulatedWorld, degrees: f64| world.true_rotary_error_motion(Axis::C, Axis::X, degrees.to_radians());
    let mut largest = 0.0_f64;
    for degrees in [0.0, 17.0, 101.0, 255.0] {
        let x = motion_x(&world, degrees);
        largest = largest.max(x.abs());
        // The cylinder approaches by x and moves sideways by y: y²/2R is below 1e-7 mm.
        let [low, ..] = readings_at_c_angle(&mut world, degrees);
        assert!((low + x).abs() < 2e-7, "{low} {x}");
        assert!((x - motion_x(&world, degrees + 360.0)).abs() < 1e-12);
    }
    assert!((2e-4..5e-3).contains(&largest), "{largest}");
    let world = self::world_with_bed_sensors(&format!("seed = 5\n{motion}sub_harmonics = 2"));
    let differs = |by: f64| (motion_x(&world, 30.0) - motion_x(&world, 30.0 + by)).abs();
    assert!(differs(360.0) > 1e-5 && differs(720.0) < 1e-12, "{}", differs(360.0));
}

/// The asynchronous motion has the declared size, differs in each revolution, forward and backward, and contains no
/// synchronous part.
#[test]
fn asynchronous_motion_differs_in_each_revolution() {
    let motion = "[[rotary_motion]]\naxis = 'C'\nlinear_um = 0.0\nasynchronous_um = 0.5\nmax_order = 8\n";
    let mut world = world_with_bed_sensors(&format!("seed = 5\n{motion}"));
    assert_eq!(world.true_rotary_error_motion(Axis::C, Axis::X, 0.7), 0.0);
    let turns = [30.0, 390.0, 30.0, -330.0, 30.0].map(|degrees| readings_at_c_angle(&mut world, degrees)[0]);
    for (i, one) in turns.iter().enumerate() {
        let differs = |other: &f64| (one - other).abs() > 1e-5;
        assert!(one.abs() < 2.5e-3 && turns[i + 1..].iter().all(differs), "{turns:?}");
    }
}

#[test]
fn sensor_on_the_bed_does_not_move_with_the_spindle() {
    let spindle = sensor_on_mount("spindle", "spindle", [30.0, 0.0, 60.0], [-1.0, 0.0, 0.0]);
    let [bed, ..] = bed_sensors();
    let mut world = bench_with_datum_cylinder("").build_world().with_sensors(&[bed, spindle]).unwrap();
    let mut report = |z: f64| {
        world.travel(&Position::new().with(Axis::Z, z), Speed::Rapid);
        ["low", "spindle"].map(|name| world.sample_after(name, 0.0).unwrap())
    };
    assert_eq!(report(0.0), [SensorOutput::Distance(0.0); 2]);
    assert_eq!(report(200.0), [SensorOutput::Distance(0.0), SensorOutput::NoEcho]);
}

#[test]
fn output_beyond_clips_mm_stays_at_the_limit() {
    let truth = "centre_offset_mm = [0.01, 0.0]\n[[sensor]]\nname = 'low'\nclips_mm = [-0.004, 1.0]";
    let mut world = world_with_bed_sensors(truth);
    let [low, high, _] = readings_at_c_angle(&mut world, 0.0);
    assert_eq!(low, -0.004);
    assert!((high + 0.01).abs() < 1e-8);
}

#[test]
fn unknown_section_and_rotary_motion_of_a_linear_axis_are_refused() {
    let refused = |truth: &str| {
        let TestBench { machine, probe, artefact, truth } = bench_with_datum_cylinder(truth);
        SimulatedWorld::new(&machine, &probe, &artefact, &truth).err()
    };
    let stray = "[datum_cylinder]\nsection_form = [{ section = 3, n = 2 }]";
    assert_eq!(refused(stray), Some(SimulatedWorldError::InvalidDatumCylinder));
    let linear = "[[rotary_motion]]\naxis = 'X'\nlinear_um = 1.0";
    assert_eq!(refused(linear), Some(SimulatedWorldError::InvalidNumber));
}
