//! Applies faults during `trued run`, and checks the exit code, the message, the journal, the readings, and that the
//! machine is at rest.

use std::io::Read;
use std::process::{Child, Command};
use std::thread::sleep;
use std::time::{Duration, Instant};

use libtest_mimic::Failed;

use super::rig::{LinuxCncRig, lock_rig};
use super::run_workspace::{RunWorkspace, failure_text};

/// Number of touches before the fault.
const TOUCHES_BEFORE_FAULT: u64 = 5;

const TOUCH_TIMEOUT: Duration = Duration::from_secs(60);

/// One fault, and the expected message.
struct RigFault {
    /// When the fault is applied; polled.
    is_due: fn(&LinuxCncRig) -> Result<bool, Failed>,
    apply_fault: fn(&mut LinuxCncRig) -> Result<(), Failed>,
    error_text: &'static str,
    remedy_text: &'static str,
    /// Maximum time until the fault is detected.
    max_detection_s: f64,
}

fn check_run_held_by(fault: &RigFault) -> Result<(), Failed> {
    let mut rig = lock_rig()?;
    run_until_held(&mut rig, fault).map(drop)
}

/// Checks that the run does not resume while the fault persists, with the message `refusal_text`, and resumes once
/// the fault is removed.
fn check_held_and_resumable_after_repair(refusal_text: &str, fault: &RigFault) -> Result<(), Failed> {
    let mut rig = lock_rig()?;
    let workspace = run_until_held(&mut rig, fault)?;
    let said = failure_text(&workspace.start_resume_of_first_run()?.wait_with_output()?);
    if !said.contains(refusal_text) {
        return Err(format!("unmended: {said}").into());
    }
    workspace.check_last_run_state("held")?;
    rig.restore_or_restart()?;
    let (kept, before) = (workspace.first_run_probe_reading_count()?, rig.touch_count()?);
    let mut run = workspace.start_resume_of_first_run()?;
    // The references and two more touches; the result of the last one is unknown.
    wait_for_touches(&rig, before + 6, &mut run)?;
    wait_until(IS_ABOVE_PART, &rig, &mut run)?;
    let stopped = Command::new("kill").args(["-INT", &run.id().to_string()]).status()?;
    let output = run.wait_with_output()?;
    if !stopped.success() || output.status.code() != Some(5) || workspace.first_run_probe_reading_count()? < kept + 5 {
        return Err(failure_text(&output).into());
    }
    workspace.check_last_run_state("held")
}

/// Lets a run touch a few times, applies the fault, and checks the result.
fn run_until_held(rig: &mut LinuxCncRig, fault: &RigFault) -> Result<RunWorkspace, Failed> {
    let workspace = RunWorkspace::with_quick_touches(rig)?;
    let before = rig.touch_count()?;
    let mut run = workspace.start_self_calibration()?;
    wait_for_touches(rig, before + TOUCHES_BEFORE_FAULT, &mut run)?;
    wait_until(fault.is_due, rig, &mut run)?;
    let happened = Instant::now();
    (fault.apply_fault)(rig)?;
    let output = run.wait_with_output()?;
    let noticed = happened.elapsed().as_secs_f64();
    let said = failure_text(&output);
    eprintln!("noticed after {noticed:.2} s; {said}");
    if output.status.code() != Some(5) || !output.stdout.is_empty() {
        return Err(said.into());
    }
    if !said.contains(fault.error_text) || !said.contains(fault.remedy_text) {
        return Err(format!("{said}\nshould say: {} → {}", fault.error_text, fault.remedy_text).into());
    }
    if noticed > fault.max_detection_s {
        return Err(format!("noticed after {noticed} s").into());
    }
    check_at_rest(rig)?;
    workspace.check_last_run_state("held")?;
    let (kept, touched) = (workspace.first_run_probe_reading_count()? as u64, rig.touch_count()? - before);
    eprintln!("{kept} of {touched} touches kept");
    // The last touch may have come after the end, or without its back-off.
    if kept < TOUCHES_BEFORE_FAULT - 1 || kept > touched || touched > kept + 1 {
        return Err(format!("{kept} of {touched} touches kept").into());
    }
    Ok(workspace)
}

/// Always true: the fault is applied at once, during a touch or its back-off.
const IS_DUE_AT_ONCE: fn(&LinuxCncRig) -> Result<bool, Failed> = |_| Ok(true);
/// Between touches, over the part.
pub const IS_ABOVE_PART: fn(&LinuxCncRig) -> Result<bool, Failed> = |rig| Ok(rig.joint_position(2)? > 101.0);

/// Waits until the rig has counted this many touches. Fails after a minute without a new one, with the run's
/// output: the duration of a touch depends on the computer.
pub fn wait_for_touches(rig: &LinuxCncRig, touches: u64, run: &mut Child) -> Result<(), Failed> {
    let (mut counted, mut since) = (rig.touch_count()?, Instant::now());
    while counted < touches {
        if run.try_wait()?.is_some() || since.elapsed() > TOUCH_TIMEOUT {
            return Err(kill_run_and_describe(run, counted)?.into());
        }
        sleep(Duration::from_millis(5));
        let now = rig.touch_count()?;
        if now > counted {
            (counted, since) = (now, Instant::now());
        }
    }
    Ok(())
}

/// Waits until the condition holds; fails after a minute, or when the run ends, with its output.
pub fn wait_until(
    condition: fn(&LinuxCncRig) -> Result<bool, Failed>,
    rig: &LinuxCncRig,
    run: &mut Child,
) -> Result<(), Failed> {
    let since = Instant::now();
    while !condition(rig)? {
        if run.try_wait()?.is_some() || since.elapsed() > TOUCH_TIMEOUT {
            return Err(kill_run_and_describe(run, rig.touch_count()?)?.into());
        }
    }
    Ok(())
}

fn kill_run_and_describe(run: &mut Child, counted: u64) -> Result<String, Failed> {
    run.kill()?;
    let status = run.wait()?;
    let mut said = String::new();
    if let Some(mut stderr) = run.stderr.take() {
        stderr.read_to_string(&mut said)?;
    }
    Ok(format!("touch {counted} was the last, {status}: {said}"))
}

fn check_at_rest(rig: &LinuxCncRig) -> Result<(), Failed> {
    let stands = rig.wait_for_rest()?;
    sleep(Duration::from_millis(500));
    if rig.wait_for_rest()? == stands { Ok(()) } else { Err("it moves on".into()) }
}

pub fn emergency_stop_holds_the_run() -> Result<(), Failed> {
    check_run_held_by(&RigFault {
        is_due: IS_ABOVE_PART,
        apply_fault: |rig| rig.press_emergency_stop(),
        error_text: "the emergency stop was pressed",
        remedy_text: "release the emergency stop, switch the machine on",
        max_detection_s: 1.0,
    })
}

pub fn machine_off_holds_the_run() -> Result<(), Failed> {
    check_run_held_by(&RigFault {
        is_due: IS_DUE_AT_ONCE,
        apply_fault: |rig| rig.press_button("machine.off"),
        error_text: "the machine has switched off",
        remedy_text: "switch it on",
        max_detection_s: 2.0,
    })
}

pub fn run_resumes_after_the_task_was_killed() -> Result<(), Failed> {
    check_held_and_resumable_after_repair(
        "the control has stopped working",
        &RigFault {
            is_due: IS_ABOVE_PART,
            apply_fault: |rig| rig.signal_task("-KILL"),
            error_text: "the control has stopped working: the control accepts no command, and its status is out of date",
            remedy_text: "press the emergency stop, restart the control",
            max_detection_s: 6.0,
        },
    )
}

pub fn frozen_task_holds_the_run() -> Result<(), Failed> {
    check_run_held_by(&RigFault {
        is_due: IS_ABOVE_PART,
        apply_fault: |rig| rig.signal_task("-STOP"),
        error_text: "the control has stopped working: the control accepts no command, and its status is out of date",
        remedy_text: "press the emergency stop",
        max_detection_s: 6.0,
    })
}

pub fn run_resumes_after_linuxcncrsh_was_killed() -> Result<(), Failed> {
    check_held_and_resumable_after_repair(
        "no linuxcncrsh listens at",
        &RigFault {
            is_due: IS_DUE_AT_ONCE,
            apply_fault: |rig| rig.signal_linuxcncrsh("-KILL"),
            error_text: "is lost",
            remedy_text: "the state of the machine is unknown",
            max_detection_s: 2.0,
        },
    )
}

pub fn silent_linuxcncrsh_holds_the_run() -> Result<(), Failed> {
    check_run_held_by(&RigFault {
        is_due: IS_ABOVE_PART,
        apply_fault: |rig| rig.signal_linuxcncrsh("-STOP"),
        error_text: "no reply to `get ",
        remedy_text: "the state of the machine is unknown",
        max_detection_s: 6.0,
    })
}

pub fn run_resumes_after_a_stuck_probe() -> Result<(), Failed> {
    check_held_and_resumable_after_repair(
        "the probe reads closed",
        &RigFault {
            is_due: IS_DUE_AT_ONCE,
            apply_fault: |rig| rig.set_true_value("stuck", 1.0),
            error_text: "the probe reads closed where the stylus must be free",
            remedy_text: "check the probe's battery, cable and polarity",
            max_detection_s: 3.0,
        },
    )
}

pub fn run_resumes_after_a_missing_part() -> Result<(), Failed> {
    check_held_and_resumable_after_repair(
        "no contact before the end",
        &RigFault {
            is_due: IS_ABOVE_PART,
            apply_fault: |rig| rig.remove_part(),
            error_text: "no contact before the end of the probing move",
            remedy_text: "check the position and size of the part in the machine file",
            max_detection_s: 6.0,
        },
    )
}

pub fn pause_at_the_machine_holds_the_run() -> Result<(), Failed> {
    check_run_held_by(&RigFault {
        is_due: IS_ABOVE_PART,
        apply_fault: |rig| rig.press_button("program.pause"),
        error_text: "the program is paused at the control: pause was pressed",
        remedy_text: "nothing continues by itself",
        max_detection_s: 2.0,
    })
}

pub fn feed_override_of_zero_holds_the_run() -> Result<(), Failed> {
    check_run_held_by(&RigFault {
        is_due: IS_ABOVE_PART,
        apply_fault: |rig| rig.set_feed_override_zero(),
        // Between two programs, or during a move.
        error_text: "the feed override is 0 %",
        remedy_text: "",
        max_detection_s: 4.0,
    })
}

pub fn target_beyond_a_soft_limit_holds_the_run() -> Result<(), Failed> {
    check_run_held_by(&RigFault {
        is_due: IS_ABOVE_PART,
        apply_fault: |rig| rig.set_x_max_limit_mm(40.0),
        error_text: "the target is outside the travel limits of the control",
        remedy_text: "set [axes] min and max to the limits of the control",
        max_detection_s: 30.0,
    })
}

pub fn contact_during_a_positioning_move_holds_the_run() -> Result<(), Failed> {
    check_run_held_by(&RigFault {
        is_due: IS_ABOVE_PART,
        apply_fault: |rig| rig.deflect_stylus_briefly(),
        error_text: "unexpected contact during a positioning move",
        remedy_text: "run `trued check`, which retracts it; then check the position of the part, the fixtures",
        max_detection_s: 3.0,
    })
}
