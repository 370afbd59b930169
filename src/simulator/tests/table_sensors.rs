//! Sensors on the table around the sphere in the spindle, compared with poses and an intersection computed by hand.

use nalgebra::{Matrix3, Vector3};

use super::*;
use machine::record::sensor::Sensor;

const NOMINAL_SPHERE_CENTRE_MM: [f64; 3] = [0.0, 0.0, 60.0];

/// An empty table, and a sphere of radius 11 mm.
fn bench_with_sphere_in_spindle() -> TestBench {
    let truth = "tool_offset_um = [4.0, -3.0, 2.0]\n[errors]\nEX0C_um = 30.0\nEY0C_um = -20.0\nEB0C_urad = 50.0";
    let artefact = toml::from_str("kind = 'none'").unwrap();
    let probe = toml::from_str("ball_radius_mm = 11.0").unwrap();
    TestBench { artefact, probe, truth: toml::from_str(truth).unwrap(), ..TestBench::ideal() }
}

fn table_sensor_with_zero_and_direction(azimuth_deg: f64) -> (Sensor, Vector3<f64>, Vector3<f64>) {
    let (sin, cos) = azimuth_deg.to_radians().sin_cos();
    let along = Vector3::new(-0.6 * cos, -0.6 * sin, 0.8);
    let zero = Vector3::from(NOMINAL_SPHERE_CENTRE_MM) - along * 11.0;
    let (zero_mm, direction): ([f64; 3], [f64; 3]) = (zero.into(), along.into());
    let sensor = toml::from_str(&format!(
        "name = 'at {azimuth_deg}'\nmount = 'table'\nzero_mm = {zero_mm:?}\ndirection = {direction:?}\n\
         range_mm = [-1.0, 1.0]\nstand_off_mm = 2.0"
    ));
    (sensor.unwrap(), zero, along)
}

/// Rotation about Z by the angle, counter-clockwise seen from above.
fn rotation_about_z(angle: f64) -> Matrix3<f64> {
    let (sin, cos) = angle.sin_cos();
    Matrix3::new(cos, -sin, 0.0, sin, cos, 0.0, 0.0, 0.0, 1.0)
}

fn rotation_about_y(angle: f64) -> Matrix3<f64> {
    let (sin, cos) = angle.sin_cos();
    Matrix3::new(cos, 0.0, sin, 0.0, 1.0, 0.0, -sin, 0.0, cos)
}

/// C turns the table against its command, seen from above (ISO 841). The location errors of C precede the rotation,
/// and X moves the table against its command.
#[test]
fn a_sensor_on_the_table_measures_the_sphere_in_the_spindle() {
    let all: Vec<_> = [0.0, 120.0, 240.0].map(table_sensor_with_zero_and_direction).into();
    let sensors: Vec<Sensor> = all.iter().map(|(sensor, ..)| sensor.clone()).collect();
    let mut world = bench_with_sphere_in_spindle().build_world().with_sensors(&sensors).unwrap();
    for (x, y, z, degrees) in
        [(0.0, 0.0, 0.0, 0.0), (0.05, -0.1, 0.02, 0.0), (0.0, 0.0, 0.0, 75.0), (-0.03, 0.04, -0.06, 210.0)]
    {
        let c = f64::to_radians(degrees);
        // The tool is 100 mm below the spindle.
        let at = Position::from_xyz([x, y, 160.0 + z].into()).with(Axis::C, c);
        world.travel(&at, Speed::Rapid);
        let sphere = Vector3::new(0.004, y - 0.003, 60.002 + z);
        let axis = Vector3::new(-x + 0.03, -0.02, 0.0);
        let own = rotation_about_z(c) * rotation_about_y(-50e-6) * (sphere - axis);
        for (sensor, zero, along) in &all {
            let from = own - zero;
            let (near, squared) = (from.dot(along), from.norm_squared());
            let expected = near - (near * near - squared + 121.0).sqrt();
            let Some(SensorOutput::Distance(found)) = world.sample_after(&sensor.name, 0.0) else {
                panic!("{} at {degrees}", sensor.name)
            };
            assert!((found - expected).abs() < 1e-8, "{} at {degrees}: {found} {expected}", sensor.name);
        }
    }
}
