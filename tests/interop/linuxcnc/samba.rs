//! Balls on the rig's table: checks that they are at the positions of the rig's pins, and that `trued run samba`
//! finds the true rotary axes with them.

use std::f64::consts::FRAC_PI_2;
use std::time::Instant;

use devices::controllers::ControllerDriver as _;
use devices::controllers::linuxcnc::LinuxCncDriver;
use estimation::sphere::fit_sphere;
use libtest_mimic::Failed;
use machine::record::estimate::Estimate;
use machine::record::motion::{Motion, MotionBlock};
use machine::{Axis, Position};
use nalgebra::{Rotation3, Vector3};

use super::compensation::{check_correction_by_run, check_verification, finish_after_restart, undo, write_by_run};
use super::driver::{block_on, open_driver, prove_without_collision_check, z_position};
use super::rig::{LinuxCncRig, RigVariant, lock_rig, lock_rig_variant};
use super::run_workspace::{RunWorkspace, failure_text, value_and_expanded_u};

/// The true rotary axes and the true stylus: the rig's pins.
pub struct TrueAxes {
    /// The table tilts on A, not on B.
    pub tilts_on_a: bool,
    /// Of the tilting axis.
    b_point_mm: Vector3<f64>,
    /// Orientation of B about X and Z, rad.
    b_tilt_rad: [f64; 2],
    c_point_mm: Vector3<f64>,
    /// Orientation about X and Y, rad.
    c_tilt_rad: [f64; 2],
    stylus_error_mm: Vector3<f64>,
}

pub const TILTED_AXES: TrueAxes = TrueAxes {
    tilts_on_a: false,
    b_point_mm: Vector3::new(0.035, 0.0, -0.060),
    b_tilt_rad: [40e-6, -30e-6],
    c_point_mm: Vector3::new(0.110, -0.030, 0.0),
    c_tilt_rad: [-25e-6, 55e-6],
    stylus_error_mm: Vector3::new(0.0121, -0.0082, 0.045),
};
/// Location errors only.
const DISPLACED_AXES: TrueAxes = TrueAxes { b_tilt_rad: [0.0; 2], c_tilt_rad: [0.0; 2], ..TILTED_AXES };
/// The same for a table that tilts on A, with other signs.
const DISPLACED_AXES_ON_A: TrueAxes = TrueAxes {
    tilts_on_a: true,
    b_point_mm: Vector3::new(0.0, -0.045, 0.050),
    c_point_mm: Vector3::new(-0.090, 0.070, 0.0),
    ..DISPLACED_AXES
};
/// X moves this much too far.
const TRUE_SCALE_OF_X_UM_PER_M: f64 = 120.0;

impl TrueAxes {
    fn tilting_axis(&self) -> Vector3<f64> {
        if self.tilts_on_a { Vector3::x() } else { Vector3::y() }
    }
}

/// Positions of the balls with all axes at zero, up to half a millimetre from those of samba.toml; the first two
/// are 150 mm apart.
pub const BALL_CENTRES_MM: [[f64; 3]; 4] =
    [[80.3, -0.2, 90.4], [-69.7, -0.2, 90.4], [9.8, 75.4, 130.1], [-15.3, -84.7, 109.8]];
const BALL_RADIUS_MM: f64 = 10.0;
/// Radius of the stylus ball.
const STYLUS_BALL_RADIUS_MM: f64 = 3.0;

/// Expected estimate, µm, µrad, and mm for the stylus, which is measured from the true axes: B along X and Z, C
/// along Y. Then the tolerance in the same units.
const TRUE_SAMBA_PARAMETERS: [(&str, f64, f64); 8] = [
    ("EX0C", 75.0, 2.0),
    ("EA0B", 40.0, 10.0),
    ("EC0B", -30.0, 10.0),
    ("EA0C", -65.0, 10.0),
    ("EB0C", 55.0, 10.0),
    ("tool_x", -0.0229, 0.002),
    ("tool_y", 0.0218, 0.002),
    ("tool_z", 0.105, 0.002),
];

/// The same from one ball: the rotation of B about its own axis and the tilt of C about Y are then one parameter.
const TRUE_CHASE_THE_BALL_PARAMETERS: [(&str, f64, f64); 8] = [
    ("EX0C", 75.0, 2.0),
    ("EA0B", 40.0, 10.0),
    ("EB0B", 55.0, 10.0),
    ("EC0B", -30.0, 10.0),
    ("EA0C", -65.0, 10.0),
    ("zero_x", -0.0229, 0.002),
    ("zero_y", 0.0218, 0.002),
    ("zero_z", 0.105, 0.002),
];

/// Removes the cylinder, puts the balls on the table, and sets the axis errors above.
pub fn place_balls_and_axis_errors(rig: &LinuxCncRig, truth: &TrueAxes) -> Result<(), Failed> {
    let axes = [
        ("b-x", if truth.tilts_on_a { truth.b_point_mm.y } else { truth.b_point_mm.x }),
        ("b-z", truth.b_point_mm.z),
        ("b-a", truth.b_tilt_rad[0]),
        ("b-c", truth.b_tilt_rad[1]),
        ("c-x", truth.c_point_mm.x),
        ("c-y", truth.c_point_mm.y),
        ("c-a", truth.c_tilt_rad[0]),
        ("c-b", truth.c_tilt_rad[1]),
        ("stylus-x", truth.stylus_error_mm.x),
        ("stylus-y", truth.stylus_error_mm.y),
        ("stylus-z", truth.stylus_error_mm.z),
        ("radius", 0.0),
    ];
    for (name, value) in axes {
        rig.set_true_value(name, value)?;
    }
    for (i, ball) in BALL_CENTRES_MM.iter().enumerate() {
        for (axis, value) in ["x", "y", "z"].into_iter().zip(ball) {
            rig.set_true_value(&format!("ball-{axis}-{i}"), *value)?;
        }
        rig.set_true_value(&format!("ball-radius-{i}"), BALL_RADIUS_MM)?;
    }
    Ok(())
}

/// Positions of X, Y, Z at which the stylus ball and the ball coincide: computed with plain matrices, whereas the
/// rig rotates points about lines.
fn tool_position_at_ball(truth: &TrueAxes, ball: [f64; 3], b: f64, c: f64) -> Vector3<f64> {
    let about = |p: Vector3<f64>, through: Vector3<f64>, lies: Rotation3<f64>, turn: Rotation3<f64>| {
        through + lies * turn * lies.inverse() * (p - through)
    };
    let ([x, y, z], tilt) = ([Vector3::x(), Vector3::y(), Vector3::z()], truth.tilting_axis());
    let c_lies = Rotation3::new(y * truth.c_tilt_rad[1]) * Rotation3::new(x * truth.c_tilt_rad[0]);
    let b_lies = Rotation3::new(z * truth.b_tilt_rad[1]) * Rotation3::new(x * truth.b_tilt_rad[0]);
    let turned = about(Vector3::from(ball), truth.c_point_mm, c_lies, Rotation3::new(z * c));
    about(turned, truth.b_point_mm, b_lies, Rotation3::new(tilt * b)) - truth.stylus_error_mm
}

/// Point of the table, at its position with all axes at zero, where a tool on the axis of the spindle is: the inverse of
/// [`tool_position_at_ball`]. The tool is as long as the stylus.
pub fn point_on_table(truth: &TrueAxes, tool: Vector3<f64>, b: f64, c: f64) -> Vector3<f64> {
    let back = |p: Vector3<f64>, through: Vector3<f64>, lies: Rotation3<f64>, turn: Rotation3<f64>| {
        through + lies * turn.inverse() * lies.inverse() * (p - through)
    };
    let ([x, y, z], tilt) = ([Vector3::x(), Vector3::y(), Vector3::z()], truth.tilting_axis());
    let c_lies = Rotation3::new(y * truth.c_tilt_rad[1]) * Rotation3::new(x * truth.c_tilt_rad[0]);
    let b_lies = Rotation3::new(z * truth.b_tilt_rad[1]) * Rotation3::new(x * truth.b_tilt_rad[0]);
    let tip = tool + z * truth.stylus_error_mm.z;
    back(back(tip, truth.b_point_mm, b_lies, Rotation3::new(tilt * b)), truth.c_point_mm, c_lies, Rotation3::new(z * c))
}

/// A touch of the ball at `centre` against `normal`, from above and back up.
fn ball_touch_block(step: u32, centre: Vector3<f64>, normal: Vector3<f64>, (b, c): (f64, f64)) -> MotionBlock {
    let place = |far: f64| Position::from_xyz(centre + (BALL_RADIUS_MM + STYLUS_BALL_RADIUS_MM + far) * normal);
    let over = place(0.4).with(Axis::Z, 200.0).with(Axis::B, b).with(Axis::C, c);
    let motions = vec![
        Motion::Rapid { to: z_position(200.0) },
        Motion::Rapid { to: over },
        Motion::Guarded { to: place(0.4), feed_mm_min: 6000.0 },
        Motion::Probe { to: place(-1.0), feed_mm_min: 30.0 },
        Motion::BackOff { to: place(0.4), feed_mm_min: 600.0 },
        Motion::Guarded { to: z_position(200.0), feed_mm_min: 6000.0 },
    ];
    MotionBlock { step, repeat: 0, motions }
}

/// Measures the centre by four touches around the ball and one at its pole.
async fn measure_ball_centre(
    driver: &mut LinuxCncDriver,
    expected_centre: Vector3<f64>,
    rotary_rad: (f64, f64),
) -> Result<Vector3<f64>, Failed> {
    let round = (0..4).map(|i| {
        let (sin, cos) = ((f64::from(i) + 0.5) * FRAC_PI_2).sin_cos();
        Vector3::new(cos, sin, 0.0)
    });
    let mut points = Vec::new();
    for (step, normal) in (0..).zip(round.chain([Vector3::z()])) {
        let outcome = driver
            .execute(prove_without_collision_check(
                driver,
                &ball_touch_block(step, expected_centre, normal, rotary_rad),
            ))
            .await?;
        let touch = outcome.trigger_position.ok_or("no touch")?;
        points.push(touch.xyz_or_zero().into());
    }
    let sphere = fit_sphere(&points)?;
    eprintln!("radius off by {:.3} um", (sphere.radius - BALL_RADIUS_MM - STYLUS_BALL_RADIUS_MM) * 1e3);
    if (sphere.radius - BALL_RADIUS_MM - STYLUS_BALL_RADIUS_MM).abs() > 0.001 {
        return Err(format!("{sphere:?}").into());
    }
    Ok(Vector3::from(sphere.centre))
}

/// Touches the rig's balls directly through the driver.
pub fn touched_ball_centres_agree_with_the_true_axes() -> Result<(), Failed> {
    let rig = lock_rig()?;
    place_balls_and_axis_errors(&rig, &TILTED_AXES)?;
    block_on(async {
        let (mut driver, _halt) = open_driver(&rig).await?;
        driver.prepare().await?;
        for (ball, b, c) in [(2, 30.0, 50.0), (3, -40.0, 200.0)] {
            let (b, c) = (f64::to_radians(b), f64::to_radians(c));
            let truth = tool_position_at_ball(&TILTED_AXES, BALL_CENTRES_MM[ball], b, c);
            // The start is a tenth of a millimetre off, because the true position is unknown.
            let near = truth + Vector3::new(0.05, -0.1, 0.04);
            let off_um = (measure_ball_centre(&mut driver, near, (b, c)).await? - truth) * 1e3;
            eprintln!("ball {ball} at B {b:.3} C {c:.3}: off by {:.3?} um", off_um.as_slice());
            if off_um.abs().max() > 1.0 {
                return Err(format!("ball {ball}: off by {:?} um", off_um.as_slice()).into());
            }
        }
        Ok(driver.restore_modes().await?)
    })
}

/// Runs `trued run samba` with the errors of the rig, and corrects the control by it.
pub fn samba_finds_the_true_axes() -> Result<(), Failed> {
    let rig = lock_rig()?;
    place_balls_and_axis_errors(&rig, &TILTED_AXES)?;
    let workspace = RunWorkspace::with_balls(&rig)?;
    run_and_check_parameters(&workspace, "samba", &TRUE_SAMBA_PARAMETERS)?;
    let errors = check_correction_by_run(&rig, &workspace, &TILTED_AXES)?;
    match errors.largest_um < 20.0 {
        true => Ok(()),
        false => Err(format!("{errors:?}").into()),
    }
}

/// Location errors of more than 0.1 mm; the corrected control moves the tool without error.
pub fn control_is_corrected_by_a_samba_run() -> Result<(), Failed> {
    let rig = lock_rig()?;
    place_balls_and_axis_errors(&rig, &DISPLACED_AXES)?;
    let workspace = RunWorkspace::with_balls(&rig)?;
    run_and_check_parameters(&workspace, "samba", &[])?;
    let errors = check_correction_by_run(&rig, &workspace, &DISPLACED_AXES)?;
    match errors.largest_um < 3.0 {
        true => Ok(()),
        false => Err(format!("{errors:?}").into()),
    }
}

/// A run at other positions verifies the written values through the control; after C was displaced, another does not.
pub fn second_run_verifies_the_control() -> Result<(), Failed> {
    let rig = lock_rig()?;
    place_balls_and_axis_errors(&rig, &DISPLACED_AXES)?;
    let workspace = RunWorkspace::with_balls(&rig)?;
    run_and_check_parameters(&workspace, "samba", &[])?;
    write_by_run(&workspace, 1)?;
    workspace.change_to_verification()?;
    rig.with_kinematics_switch(|| run_and_check_parameters(&workspace, "samba", &[]))?;
    check_verification(&workspace, 2, true)?;
    rig.set_true_value("c-x", DISPLACED_AXES.c_point_mm.x + 0.02)?;
    rig.with_kinematics_switch(|| run_and_check_parameters(&workspace, "samba", &[]))?;
    check_verification(&workspace, 3, false)?;
    undo(&workspace)
}

/// As above, with xyzac-trt-kins.
pub fn control_of_a_table_on_a_is_corrected() -> Result<(), Failed> {
    let rig = lock_rig_variant(RigVariant { tilt: 'A', has_x_table: false })?;
    place_balls_and_axis_errors(&rig, &DISPLACED_AXES_ON_A)?;
    let workspace = RunWorkspace::with_balls_on_a(&rig)?;
    run_and_check_parameters(&workspace, "samba", &[])?;
    let errors = check_correction_by_run(&rig, &workspace, &DISPLACED_AXES_ON_A)?;
    match errors.largest_um < 3.0 {
        true => Ok(()),
        false => Err(format!("{errors:?}").into()),
    }
}

/// The scale of X is measured, corrected in the compensation file, in effect after a restart, and measured again.
pub fn scale_of_x_is_corrected_in_its_file() -> Result<(), Failed> {
    let mut rig = lock_rig_variant(RigVariant { tilt: 'B', has_x_table: true })?;
    let place = |rig: &LinuxCncRig| {
        place_balls_and_axis_errors(rig, &DISPLACED_AXES)?;
        rig.set_true_value("scale-x", TRUE_SCALE_OF_X_UM_PER_M * 1e-6)
    };
    place(&rig)?;
    let workspace = RunWorkspace::with_balls_and_x_table(&rig)?;
    run_and_check_parameters(&workspace, "samba", &[("EXX1", TRUE_SCALE_OF_X_UM_PER_M, 5.0)])?;
    write_by_run(&workspace, 1)?;
    rig.restart()?;
    place(&rig)?;
    finish_after_restart(&rig, &workspace)?;
    run_and_check_parameters(&workspace, "samba", &[("EXX1", 0.0, 5.0)])
}

/// Runs `trued run laser-r-test` with the touch probe, on one ball.
pub fn chase_the_ball_finds_the_true_axes() -> Result<(), Failed> {
    let rig = lock_rig()?;
    place_balls_and_axis_errors(&rig, &TILTED_AXES)?;
    run_and_check_parameters(&RunWorkspace::with_balls(&rig)?, "laser-r-test", &TRUE_CHASE_THE_BALL_PARAMETERS)
}

/// Checks the result of `method`: for each symbol its value and the tolerance.
pub fn run_and_check_parameters(
    workspace: &RunWorkspace,
    method: &str,
    truth: &[(&str, f64, f64)],
) -> Result<(), Failed> {
    let started = Instant::now();
    let output = workspace.start_run(method)?.wait_with_output()?;
    eprintln!("{}in {:.0} s", failure_text(&output), started.elapsed().as_secs_f64());
    if output.status.code() != Some(0) {
        return Err(failure_text(&output).into());
    }
    let estimate: Estimate = serde_json::from_slice(&output.stdout)?;
    let mut wrong = String::new();
    for (symbol, truth, near) in truth {
        let (value, expanded) = value_and_expanded_u(&estimate, symbol)?;
        eprintln!("{symbol} = {value:.4}, U = {expanded:.4}, truth {truth}");
        if (value - truth).abs() > *near || expanded > 2.0 * near {
            wrong += &format!("{symbol} = {value}, U = {expanded}; ");
        }
    }
    if wrong.is_empty() { Ok(()) } else { Err(wrong.into()) }
}
