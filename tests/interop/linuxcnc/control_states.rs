//! Tests the reported states of a running LinuxCNC, and those in which the driver must not measure.

use std::time::{Duration, Instant};

use devices::controllers::{ControllerDriver as _, ControllerError, PreparedControl};
use libtest_mimic::Failed;
use machine::record::motion::{Motion, MotionBlock};
use machine::{Axis, Position};
use tokio::time::sleep;

use super::driver::{
    block_on, cylinder_touch_block, expect_error, open_driver, polar_xy_position, prove_without_collision_check,
    z_position,
};
use super::rig::{LinuxCncRig, lock_rig};

fn check_prepare_refused(prepared: Result<PreparedControl, ControllerError>, words: &str) -> Result<(), Failed> {
    match prepared {
        Err(ControllerError::NotReady { state, .. }) if state.contains(words) => Ok(()),
        other => Err(format!("{other:?}").into()),
    }
}

/// A slow move past the part, high above it.
fn slow_move_block(step: u32) -> MotionBlock {
    let motions = vec![
        Motion::Rapid { to: z_position(150.0) },
        Motion::Guarded { to: polar_xy_position(100.0, 2.0), feed_mm_min: 1000.0 },
    ];
    MotionBlock { step, repeat: 0, motions }
}

pub fn position_is_reported() -> Result<(), Failed> {
    let rig = lock_rig()?;
    rig.connect_client()?.run_mdi("G53 G0 X10 Y-20 Z150 B5 C400")?;
    block_on(async {
        let (mut driver, _halt) = open_driver(&rig).await?;
        let stands = driver.prepare().await?.position;
        let truth: Position = [
            (Axis::X, 10.0),
            (Axis::Y, -20.0),
            (Axis::Z, 150.0),
            (Axis::B, 5f64.to_radians()),
            (Axis::C, 400f64.to_radians()),
        ]
        .into_iter()
        .collect();
        let off = truth.iter().map(|(axis, at)| (stands.get_or_zero(axis) - at).abs()).fold(0.0, f64::max);
        if off < 1e-6 && stands.iter().count() == 5 {
            return Ok(());
        }
        Err(format!("{stands:?}").into())
    })
}

/// The reported identification is correct: an axis moves up to the reported limit, and not beyond.
pub fn reported_identity_and_travel_limit_are_correct() -> Result<(), Failed> {
    let rig = lock_rig()?;
    let (identity, b) = block_on(async {
        let (mut driver, _halt) = open_driver(&rig).await?;
        let said = driver.identify_device().await?;
        Ok((said.identity, said.axes.get(&Axis::B).copied()))
    })?;
    let most = b.and_then(|b| b.travel_max).ok_or("no limit of B")?;
    rig.connect_client()?.run_mdi(&format!("G53 G0 X0 Y0 Z150 B{most}"))?;
    let stands = block_on(async {
        let (mut driver, _halt) = open_driver(&rig).await?;
        Ok(driver.prepare().await?.position.get_or_zero(Axis::B))
    })?;
    rig.connect_client()?.run_mdi("G53 G0 B0")?;
    let beyond = (stands - most.to_radians()).abs();
    if identity.starts_with("LinuxCNC, ") && beyond < 1e-6 && most == 110.0 {
        return Ok(());
    }
    Err(format!("{identity}: {b:?}, B stands at {stands}").into())
}

/// M428 of the sample configurations, by the HAL switch that it sets. At B = C = 0 each axis equals its joint in
/// both modes.
pub fn compensating_kinematics_are_refused() -> Result<(), Failed> {
    let rig = lock_rig()?;
    block_on(async {
        let (mut driver, _halt) = open_driver(&rig).await?;
        rig.set_tool_centre_point_mode(true)?;
        let at_zero = driver.prepare().await;
        rig.set_tool_centre_point_mode(false)?;
        check_prepare_refused(at_zero, "the kinematics compensate the rotary axes: motion.switchkins-type is 1")?;
        driver.prepare().await?;
        driver.execute(prove_without_collision_check(&driver, &cylinder_touch_block(1, 0.0, 0.6, 48.6, 46.0))).await?;
        rig.set_tool_centre_point_mode(true)?;
        let compensated = open_driver(&rig).await?.0.prepare().await;
        rig.set_tool_centre_point_mode(false)?;
        check_prepare_refused(compensated, "the positions of axes and joints differ")?;
        driver.prepare().await?;
        Ok(())
    })
}

/// The table entry of a loaded tool is not an offset; G43 and G43.1 apply an offset, of any tool.
pub fn an_active_tool_length_offset_is_refused() -> Result<(), Failed> {
    let rig = lock_rig()?;
    block_on(async {
        let mut person = rig.connect_client()?;
        person.run_mdi("G10 L1 P1 Z12")?;
        for (lines, is_active) in [
            (&["T1 M6", "G49"][..], false),
            (&["G43"], true),
            (&["G49", "G43 H1"], true),
            (&["G49", "T0 M6", "G43 H1"], true),
            (&["G49", "G43.1 Z3"], true),
            (&["G49"], false),
        ] {
            for line in lines {
                person.run_mdi(line)?;
            }
            let prepared = open_driver(&rig).await?.0.prepare().await;
            person = rig.connect_client()?;
            if is_active {
                check_prepare_refused(prepared, "a tool length offset is active")?;
            } else {
                prepared?;
            }
        }
        person.run_mdi("G10 L1 P1 Z0")
    })
}

/// The table stops within a degree: the stylus is deflected while the table turns at feed.
pub fn contact_stops_a_table_turn() -> Result<(), Failed> {
    let rig = lock_rig()?;
    block_on(async {
        let (mut driver, _halt) = open_driver(&rig).await?;
        driver.prepare().await?;
        let turn = Position::new().with(Axis::C, 1.0);
        let motions = vec![Motion::Rapid { to: z_position(150.0) }, Motion::Feed { to: turn, feed_mm_min: 300.0 }];
        let presses = async {
            while rig.joint_position(4)? < 5.0 {
                sleep(Duration::from_millis(2)).await;
            }
            rig.set_true_value("stuck", 1.0)
        };
        let block = prove_without_collision_check(&driver, &MotionBlock { step: 3, repeat: 0, motions });
        let (hit, pressed) = tokio::join!(driver.execute(block), presses);
        pressed?;
        expect_error(hit, |error| matches!(error, ControllerError::UnexpectedContact { step: 3 }))?;
        let c = rig.wait_for_rest()?[4];
        if c < 7.0 { Ok(()) } else { Err(format!("C stands at {c}").into()) }
    })
}

pub fn feed_override_other_than_100_percent_is_refused() -> Result<(), Failed> {
    let rig = lock_rig()?;
    block_on(async {
        let (mut driver, _halt) = open_driver(&rig).await?;
        rig.connect_client()?.send_line("set feed_override 80")?;
        check_prepare_refused(driver.prepare().await, "the feed override is 80 %")?;
        rig.connect_client()?.send_line("set feed_override 100")?;
        driver.prepare().await?;
        rig.connect_client()?.send_line("set feed_override 120")?;
        let hurried = driver
            .execute(prove_without_collision_check(&driver, &cylinder_touch_block(1, 0.0, 0.0, 48.6, 46.0)))
            .await;
        let is_named = |error: &ControllerError| error.to_string().contains("is 120 %");
        expect_error(hurried, is_named)?;
        if rig.joint_position(2)? < 199.0 { Err("it moved".into()) } else { Ok(()) }
    })
}

pub fn program_opened_by_another_client_is_not_run() -> Result<(), Failed> {
    let rig = lock_rig()?;
    let other = rig.directory.join("other.ngc");
    std::fs::write(&other, "%\nG53 G0 X77\n%\n")?;
    block_on(async {
        let (mut driver, _halt) = open_driver(&rig).await?;
        driver.prepare().await?;
        rig.connect_client()?.send_line(&format!("set open {}", other.display()))?;
        let not_ours = driver
            .execute(prove_without_collision_check(&driver, &cylinder_touch_block(1, 0.0, 0.0, 48.6, 46.0)))
            .await;
        expect_error(not_ours, |error| error.to_string().contains("another program is open"))?;
        if rig.joint_position(0)?.abs() > 1e-9 { Err("it moved".into()) } else { Ok(()) }
    })
}

/// Each cause is detected and named, the run is given up, and it does not continue when the cause is removed.
pub fn cause_of_a_hold_is_named_and_its_removal_starts_no_motion() -> Result<(), Failed> {
    let rig = lock_rig()?;
    type OperatorAction = fn(&LinuxCncRig) -> Result<(), Failed>;
    let hands: [(OperatorAction, OperatorAction, &str); 3] = [
        (|rig| rig.press_button("program.pause"), |rig| rig.press_button("program.resume"), "pause was pressed"),
        (
            |rig| rig.set_feed_override_zero(),
            |rig| rig.connect_client()?.send_line("set feed_override 100").map(drop),
            "the feed override is 0 %",
        ),
        (|rig| rig.set_feed_inhibit(true), |rig| rig.set_feed_inhibit(false), "does not move: a feed hold"),
    ];
    for (step, (holds, lets_go, words)) in (0..).zip(hands) {
        block_on(async {
            let (mut driver, _halt) = open_driver(&rig).await?;
            driver.prepare().await?;
            let hand = async {
                sleep(Duration::from_millis(900)).await;
                holds(&rig)?;
                Ok::<_, Failed>(Instant::now())
            };
            let block = slow_move_block(step);
            let (held, since) = tokio::join!(driver.execute(prove_without_collision_check(&driver, &block)), hand);
            eprintln!("{words}: after {:.2} s", since?.elapsed().as_secs_f64());
            let error = held.err().ok_or("it ended")?;
            if !matches!(&error, ControllerError::ProgramPaused { reason } if reason.contains(words)) {
                return Err(format!("{error:?}").into());
            }
            let stands = rig.wait_for_rest()?;
            lets_go(&rig)?;
            sleep(Duration::from_millis(500)).await;
            if rig.wait_for_rest()? != stands {
                return Err("it goes on".into());
            }
            let mut person = rig.connect_client()?;
            person.run_mdi("G53 G0 X0 Y0")
        })?;
    }
    Ok(())
}

/// Stopped while at rest between two blocks; released; enabled. Each state is checked with the same driver and with
/// a new one.
pub fn control_is_ready_after_a_stop_only_when_released_and_switched_on() -> Result<(), Failed> {
    let rig = lock_rig()?;
    block_on(async {
        let (mut driver, _halt) = open_driver(&rig).await?;
        driver.prepare().await?;
        rig.press_emergency_stop()?;
        sleep(Duration::from_millis(200)).await;
        let stopped = driver.execute(prove_without_collision_check(&driver, &slow_move_block(1))).await;
        expect_error(stopped, |error| matches!(error, ControllerError::EmergencyStop))?;
        let again = driver.execute(prove_without_collision_check(&driver, &slow_move_block(1))).await;
        expect_error(again, |error| matches!(error, ControllerError::NotReady { .. }))?;
        check_prepare_refused(driver.prepare().await, "the emergency stop is pressed")?;
        rig.release_emergency_stop()?;
        check_prepare_refused(driver.prepare().await, "the emergency stop is pressed")?;
        rig.connect_client()?.send_line("set estop off")?;
        check_prepare_refused(driver.prepare().await, "the machine is off")?;
        check_prepare_refused(open_driver(&rig).await?.0.prepare().await, "the machine is off")?;
        rig.connect_client()?.send_line("set machine on")?;
        let (mut driver, _halt) = open_driver(&rig).await?;
        driver.prepare().await?;
        driver.execute(prove_without_collision_check(&driver, &slow_move_block(2))).await?;
        Ok(())
    })
}

/// The probe stays closed after the touch: the retract upwards is not executed.
pub fn no_motion_after_back_off_while_the_probe_is_closed() -> Result<(), Failed> {
    let rig = lock_rig()?;
    block_on(async {
        let (mut driver, _halt) = open_driver(&rig).await?;
        driver.prepare().await?;
        let mut block = cylinder_touch_block(1, 0.0, 0.0, 48.6, 46.0);
        block.motions.push(Motion::Rapid { to: z_position(150.0) });
        let before = rig.touch_count()?;
        let sticks = async {
            while rig.touch_count()? == before {
                sleep(Duration::from_millis(2)).await;
            }
            rig.set_true_value("stuck", 1.0)
        };
        let (stuck, done) = tokio::join!(driver.execute(prove_without_collision_check(&driver, &block)), sticks);
        done?;
        expect_error(stuck, |error| matches!(error, ControllerError::ProbeStillClosed { step: 1 }))?;
        let at = rig.wait_for_rest()?;
        if (at[0] - 50.0).abs() < 1e-3 && (at[2] - 50.0).abs() < 1e-3 {
            return Ok(());
        }
        Err(format!("it stands at {at:?}").into())
    })
}
