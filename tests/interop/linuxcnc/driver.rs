//! Tests the driver with a running LinuxCNC, and builds the blocks for such tests.

use std::f64::consts::{FRAC_PI_2, TAU};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use devices::controllers::linuxcnc::{LinuxCncDriver, LinuxCncSettings, result_log_path};
use devices::controllers::{ControllerDriver as _, ControllerError, HaltHandle};
use libtest_mimic::Failed;
use link::LinkAddress;
use machine::record::motion::{Motion, MotionBlock, MotionBlockOutcome};
use machine::{Axis, Position};
use planning::gcode::Dialect;
use planning::proof::{ProvenBlock, for_tests, render_and_prove_mode_text};

use super::rig::{LinuxCncRig, lock_rig};

/// Sum of the radii of cylinder and ball, mm.
const CONTACT_RADIUS_MM: f64 = 48.0;

pub fn block_on<T>(future: impl Future<Output = Result<T, Failed>>) -> Result<T, Failed> {
    tokio::runtime::Builder::new_current_thread().enable_all().build()?.block_on(future)
}

pub async fn open_driver(rig: &LinuxCncRig) -> Result<(LinuxCncDriver, HaltHandle), Failed> {
    open_driver_at_port(rig.rsh_port, rig).await
}

/// Opens the driver over another port, behind which the traffic is observed.
pub async fn open_driver_at_port(port: u16, rig: &LinuxCncRig) -> Result<(LinuxCncDriver, HaltHandle), Failed> {
    let settings = LinuxCncSettings {
        address: LinkAddress::Tcp { host: "127.0.0.1".to_owned(), port },
        shared_directory: rig.directory.clone(),
        axes: AXES.to_vec(),
        ini_path: Some(rig_ini_path()),
    };
    let log = result_log_path(&rig.directory);
    let modes = render_and_prove_mode_text(&Dialect::from_name("linuxcnc")?, "rig", AXES, Some(&log))?;
    Ok(LinuxCncDriver::open(settings, modes).await?)
}

const AXES: [Axis; 5] = [Axis::X, Axis::Y, Axis::Z, Axis::B, Axis::C];

/// The block as it is sent to the rig, without a collision check.
pub fn prove_without_collision_check(driver: &LinuxCncDriver, block: &MotionBlock) -> ProvenBlock {
    let dialect = Dialect::from_name("linuxcnc").expect("its templates");
    for_tests::prove_block_text(block, &AXES, &dialect, &driver.transmission()).expect("a program")
}

/// The INI file with which the rig is started.
pub fn rig_ini_path() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/peers/linuxcnc/rig.ini")
}

pub fn polar_xy_position(radius: f64, angle: f64) -> Position {
    Position::new().with(Axis::X, radius * angle.cos()).with(Axis::Y, radius * angle.sin())
}

pub fn z_position(height: f64) -> Position {
    Position::new().with(Axis::Z, height)
}

/// A touch: from above down beside the flank, from `start_radius` to `end_radius`, mm, back and up. Angles in rad.
pub fn cylinder_touch_block(step: u32, angle: f64, c: f64, start_radius: f64, end_radius: f64) -> MotionBlock {
    let motions = vec![
        Motion::Rapid { to: z_position(150.0) },
        Motion::Rapid { to: polar_xy_position(60.0, angle).with(Axis::B, 0.0).with(Axis::C, c) },
        Motion::Guarded { to: z_position(50.0), feed_mm_min: 6000.0 },
        Motion::Guarded { to: polar_xy_position(start_radius, angle), feed_mm_min: 2000.0 },
        Motion::Probe { to: polar_xy_position(end_radius, angle), feed_mm_min: 30.0 },
        Motion::BackOff { to: polar_xy_position(50.0, angle), feed_mm_min: 600.0 },
        Motion::Guarded { to: polar_xy_position(60.0, angle), feed_mm_min: 6000.0 },
    ];
    MotionBlock { step, repeat: 0, motions }
}

pub fn expect_error(
    result: Result<MotionBlockOutcome, ControllerError>,
    is_expected: fn(&ControllerError) -> bool,
) -> Result<(), Failed> {
    match result {
        Err(error) if is_expected(&error) => Ok(()),
        other => Err(format!("{other:?}").into()),
    }
}

/// The centre of the circle that the spindle's axis describes, from touches in four directions.
async fn measure_cylinder_centre(driver: &mut LinuxCncDriver, c: f64) -> Result<[f64; 2], Failed> {
    let mut at = Vec::new();
    for quarter in 0..4 {
        let angle = f64::from(quarter) * FRAC_PI_2;
        let started = Instant::now();
        let outcome = driver
            .execute(prove_without_collision_check(driver, &cylinder_touch_block(quarter, angle, c, 48.6, 46.0)))
            .await?;
        let touch = outcome.trigger_position.ok_or("no touch")?;
        eprintln!("touch {quarter}: {touch:?} in {:.2} s", started.elapsed().as_secs_f64());
        if (touch.get_or_zero(Axis::Z) - 50.0).abs() > 1e-4 || (touch.get_or_zero(Axis::C) - c).abs() > 1e-6 {
            return Err(format!("{touch:?}").into());
        }
        at.push(touch);
    }
    let middle = |axis, i: usize| (at[i].get_or_zero(axis) + at[i + 2].get_or_zero(axis)) / 2.0;
    Ok([middle(Axis::X, 0), middle(Axis::Y, 1)])
}

pub fn touches_find_the_true_cylinder_centre() -> Result<(), Failed> {
    let rig = lock_rig()?;
    block_on(async {
        let (mut driver, _halt) = open_driver(&rig).await?;
        let prepared = driver.prepare().await?;
        if !prepared.identity.starts_with("LinuxCNC 2.") {
            return Err(prepared.identity.into());
        }
        let still = vec![Motion::Rapid { to: z_position(200.0) }];
        let started = Instant::now();
        for step in 0..10 {
            driver
                .execute(prove_without_collision_check(
                    &driver,
                    &MotionBlock { step, repeat: 0, motions: still.clone() },
                ))
                .await?;
        }
        eprintln!("a block that does nothing: {:.3} s", started.elapsed().as_secs_f64() / 10.0);
        for c in [0.0, 2.0] {
            let found = measure_cylinder_centre(&mut driver, c).await?;
            // The table turns by +C; the cylinder is eccentric on the table, the stylus on the spindle.
            let (sin, cos) = f64::sin_cos(c);
            let truth = [0.050 + 0.120 * cos + 0.080 * sin - 0.0121, -0.030 + 0.120 * sin - 0.080 * cos + 0.0082];
            let off_um = [0, 1].map(|i| (found[i] - truth[i]) * 1e3);
            eprintln!("C {c} rad: off by {off_um:.3?} um");
            if off_um.iter().any(|off| off.abs() > 1.0) {
                return Err(format!("{found:?} instead of {truth:?}").into());
            }
        }
        Ok(driver.restore_modes().await?)
    })
}

pub fn missed_touch_blocks_motion_until_prepared_again() -> Result<(), Failed> {
    let rig = lock_rig()?;
    block_on(async {
        let (mut driver, _halt) = open_driver(&rig).await?;
        driver.prepare().await?;
        let missed = driver
            .execute(prove_without_collision_check(&driver, &cylinder_touch_block(7, 0.0, 0.0, 55.0, 54.0)))
            .await;
        expect_error(missed, |error| matches!(error, ControllerError::NoContact { step: 7 }))?;
        if (rig.joint_position(0)? - 54.0).abs() > 1e-3 {
            return Err("it moved on after a missed touch".into());
        }
        let next = driver
            .execute(prove_without_collision_check(&driver, &cylinder_touch_block(8, 0.0, 0.0, 48.6, 46.0)))
            .await;
        expect_error(next, |error| matches!(error, ControllerError::NotReady { .. }))?;
        driver.prepare().await?;
        driver.execute(prove_without_collision_check(&driver, &cylinder_touch_block(9, 0.0, 0.0, 48.6, 46.0))).await?;
        Ok(())
    })
}

pub fn contact_stops_a_guarded_move_and_only_a_retract_is_accepted() -> Result<(), Failed> {
    let rig = lock_rig()?;
    block_on(async {
        let (mut driver, _halt) = open_driver(&rig).await?;
        driver.prepare().await?;
        let hit = driver
            .execute(prove_without_collision_check(&driver, &cylinder_touch_block(3, TAU / 3.0, 0.0, 40.0, 35.0)))
            .await;
        expect_error(hit, |error| matches!(error, ControllerError::UnexpectedContact { step: 3 }))?;
        let radius = rig.joint_position(0)?.hypot(rig.joint_position(1)?);
        if !(CONTACT_RADIUS_MM - 2.0..CONTACT_RADIUS_MM + 0.5).contains(&radius) {
            return Err(format!("it stands at radius {radius}").into());
        }
        // In contact: the driver accepts only a retract.
        driver.prepare().await?;
        let again = driver
            .execute(prove_without_collision_check(&driver, &cylinder_touch_block(4, 0.0, 0.0, 48.6, 46.0)))
            .await;
        expect_error(again, |error| matches!(error, ControllerError::ProbeStillClosed { step: 4 }))?;
        driver.prepare().await?;
        let out = vec![Motion::BackOff { to: polar_xy_position(50.0, TAU / 3.0), feed_mm_min: 600.0 }];
        driver
            .execute(prove_without_collision_check(&driver, &MotionBlock { step: 5, repeat: 0, motions: out }))
            .await?;
        Ok(())
    })
}

pub fn contact_in_a_rapid_move_is_reported() -> Result<(), Failed> {
    let rig = lock_rig()?;
    block_on(async {
        let (mut driver, _halt) = open_driver(&rig).await?;
        driver.prepare().await?;
        let motions = vec![
            Motion::Rapid { to: z_position(150.0) },
            Motion::Rapid { to: polar_xy_position(60.0, 0.0) },
            Motion::Rapid { to: z_position(50.0) },
            Motion::Rapid { to: polar_xy_position(47.0, 0.0) },
        ];
        let hit =
            driver.execute(prove_without_collision_check(&driver, &MotionBlock { step: 6, repeat: 0, motions })).await;
        expect_error(hit, |error| matches!(error, ControllerError::UnexpectedContact { step: 6 }))
    })
}

pub fn dead_and_stuck_probes_are_reported() -> Result<(), Failed> {
    let rig = lock_rig()?;
    block_on(async {
        let (mut driver, _halt) = open_driver(&rig).await?;
        driver.prepare().await?;
        rig.set_true_value("dead", 1.0)?;
        let missed = driver
            .execute(prove_without_collision_check(&driver, &cylinder_touch_block(1, 0.0, 0.0, 48.6, 47.6)))
            .await;
        expect_error(missed, |error| matches!(error, ControllerError::NoContact { step: 1 }))?;
        let up = vec![Motion::BackOff { to: polar_xy_position(60.0, 0.0), feed_mm_min: 600.0 }];
        driver.prepare().await?;
        driver
            .execute(prove_without_collision_check(&driver, &MotionBlock { step: 2, repeat: 0, motions: up.clone() }))
            .await?;
        rig.set_true_value("dead", 0.0)?;
        rig.set_true_value("stuck", 1.0)?;
        let stuck = driver
            .execute(prove_without_collision_check(&driver, &cylinder_touch_block(3, 0.0, 0.0, 48.6, 46.0)))
            .await;
        expect_error(stuck, |error| matches!(error, ControllerError::ProbeStillClosed { step: 3 }))?;
        driver.prepare().await?;
        let stuck = driver
            .execute(prove_without_collision_check(&driver, &MotionBlock { step: 4, repeat: 0, motions: up }))
            .await;
        expect_error(stuck, |error| matches!(error, ControllerError::ProbeStillClosed { step: 4 }))
    })
}

pub fn emergency_stop_ends_the_block_and_is_named() -> Result<(), Failed> {
    let rig = lock_rig()?;
    block_on(async {
        let (mut driver, _halt) = open_driver(&rig).await?;
        driver.prepare().await?;
        let motions = vec![
            Motion::Rapid { to: z_position(150.0) },
            Motion::Guarded { to: polar_xy_position(100.0, 2.0), feed_mm_min: 1000.0 },
        ];
        let block = MotionBlock { step: 12, repeat: 0, motions };
        let stop = async {
            tokio::time::sleep(Duration::from_millis(700)).await;
            rig.press_emergency_stop()
        };
        let (stopped, hit) = tokio::join!(driver.execute(prove_without_collision_check(&driver, &block)), stop);
        hit?;
        expect_error(stopped, |error| matches!(error, ControllerError::EmergencyStop))?;
        match driver.prepare().await {
            Err(ControllerError::NotReady { state, .. }) if state.contains("emergency") => Ok(()),
            other => Err(format!("{other:?}").into()),
        }
    })
}

pub fn frozen_control_ends_the_block_without_later_motion() -> Result<(), Failed> {
    let rig = lock_rig()?;
    block_on(async {
        let (mut driver, _halt) = open_driver(&rig).await?;
        driver.prepare().await?;
        let motions = vec![
            Motion::Rapid { to: z_position(150.0) },
            Motion::Guarded { to: polar_xy_position(100.0, 2.0), feed_mm_min: 200.0 },
        ];
        let block = MotionBlock { step: 13, repeat: 0, motions };
        let freeze = async {
            tokio::time::sleep(Duration::from_millis(700)).await;
            rig.signal_task("-STOP")
        };
        let (hung, frozen) = tokio::join!(driver.execute(prove_without_collision_check(&driver, &block)), freeze);
        rig.signal_task("-CONT")?;
        frozen?;
        expect_error(hung, |error| matches!(error, ControllerError::ControlFrozen))?;
        // An abort is sent to LinuxCNC meanwhile.
        tokio::time::sleep(Duration::from_millis(500)).await;
        let stands = rig.joint_position(0)?;
        tokio::time::sleep(Duration::from_millis(300)).await;
        if rig.joint_position(0)? == stands { Ok(()) } else { Err("it moves on".into()) }
    })
}

pub fn out_of_travel_error_contains_the_controls_message() -> Result<(), Failed> {
    let rig = lock_rig()?;
    block_on(async {
        let (mut driver, _halt) = open_driver(&rig).await?;
        driver.prepare().await?;
        let motions =
            vec![Motion::Rapid { to: z_position(150.0) }, Motion::Rapid { to: polar_xy_position(400.0, 0.0) }];
        let refused =
            driver.execute(prove_without_collision_check(&driver, &MotionBlock { step: 2, repeat: 0, motions })).await;
        expect_error(
            refused,
            |error| matches!(error, ControllerError::OutOfTravel { step: 2, message } if message.contains("limit")),
        )
    })
}

pub fn work_offsets_are_kept_and_an_offset_g59_3_is_refused() -> Result<(), Failed> {
    let rig = lock_rig()?;
    block_on(async {
        let mut person = rig.connect_client()?;
        person.run_mdi("G10 L2 P2 X11 Y-7 Z3 R30")?;
        person.run_mdi("G55 G64 P0.05 G91 G20")?;
        person.run_mdi("G92 X1")?;
        let codes = person.send_line("get program_codes")?;
        let (mut driver, _halt) = open_driver(&rig).await?;
        driver.prepare().await?;
        let outcome = driver
            .execute(prove_without_collision_check(&driver, &cylinder_touch_block(1, 0.0, 0.0, 48.6, 46.0)))
            .await?;
        let x = outcome.trigger_position.ok_or("no touch")?.get_or_zero(Axis::X);
        if (x - (48.0 + 0.170 - 0.0121)).abs() > 0.001 {
            return Err(format!("touched at {x}").into());
        }
        let mut person = rig.connect_client()?;
        let after = person.send_line("get program_codes")?;
        person.run_mdi("G21 G90 G54 G92.1")?;
        person.run_mdi("G10 L2 P2 X0 Y0 Z0 R0")?;
        let words = |codes: &str, axis: char| {
            codes.split(' ').filter(|c| !c.starts_with(axis)).map(str::to_owned).collect::<Vec<_>>()
        };
        // The motion group and F contain the last executed values, not the last set ones.
        let modal = |codes: &str| {
            words(codes, 'F')
                .into_iter()
                .filter(|c| !matches!(c.as_str(), "G0" | "G1" | "G38.3" | "G80" | "G92"))
                .collect::<Vec<_>>()
        };
        if modal(&codes) != modal(&after) {
            return Err(format!("before {codes}, after {after}").into());
        }
        person.run_mdi("G10 L2 P9 Y0.001")?;
        let (mut driver, _halt) = open_driver(&rig).await?;
        let refused = driver.prepare().await;
        let mut person = rig.connect_client()?;
        person.run_mdi("G10 L2 P9 Y0")?;
        match refused {
            Err(ControllerError::NotReady { state, .. }) if state.contains("G59.3") => Ok(()),
            other => Err(format!("{other:?}").into()),
        }
    })
}
