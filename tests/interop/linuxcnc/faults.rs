//! Faults during `trued run`, and their results: the exit code, the message, the journal, the readings, and a
//! machine at rest.

use std::io::Read;
use std::process::{Child, Command};
use std::thread::sleep;
use std::time::{Duration, Instant};

use libtest_mimic::Failed;

use super::desk::{Desk, complaint};
use super::rig::{Rig, rig};

/// Number of touches before the fault.
const BEFORE: u64 = 5;

const MINUTE: Duration = Duration::from_secs(60);

/// One fault, and the expected message.
struct Fault {
    /// When the fault is applied; polled.
    when: fn(&Rig) -> Result<bool, Failed>,
    happens: fn(&mut Rig) -> Result<(), Failed>,
    error: &'static str,
    remedy: &'static str,
    /// Maximum time until the fault is detected.
    seconds: f64,
}

fn held_by(fault: &Fault) -> Result<(), Failed> {
    let mut rig = rig()?;
    held(&mut rig, fault).map(drop)
}

/// Checks that the run does not resume while the fault persists, with the message `unmended`, and resumes once it
/// is removed.
fn resumable_after(unmended: &str, fault: &Fault) -> Result<(), Failed> {
    let mut rig = rig()?;
    let desk = held(&mut rig, fault)?;
    let said = complaint(&desk.resume()?.wait_with_output()?);
    if !said.contains(unmended) {
        return Err(format!("unmended: {said}").into());
    }
    desk.is("held")?;
    rig.mend()?;
    let (kept, before) = (desk.kept()?, rig.touches()?);
    let mut run = desk.resume()?;
    // The references and two more touches; the result of the last one is unknown.
    wait_for(&rig, before + 6, &mut run)?;
    wait_until(TRAVELLING, &rig, &mut run)?;
    let stopped = Command::new("kill").args(["-INT", &run.id().to_string()]).status()?;
    let output = run.wait_with_output()?;
    if !stopped.success() || output.status.code() != Some(5) || desk.kept()? < kept + 5 {
        return Err(complaint(&output).into());
    }
    desk.is("held")
}

/// Lets a run touch a few times, applies the fault, and checks the result.
fn held(rig: &mut Rig, fault: &Fault) -> Result<Desk, Failed> {
    let desk = Desk::in_a_hurry(rig)?;
    let before = rig.touches()?;
    let mut run = desk.start()?;
    wait_for(rig, before + BEFORE, &mut run)?;
    wait_until(fault.when, rig, &mut run)?;
    let happened = Instant::now();
    (fault.happens)(rig)?;
    let output = run.wait_with_output()?;
    let noticed = happened.elapsed().as_secs_f64();
    let said = complaint(&output);
    eprintln!("noticed after {noticed:.2} s; {said}");
    if output.status.code() != Some(5) || !output.stdout.is_empty() {
        return Err(said.into());
    }
    if !said.contains(fault.error) || !said.contains(fault.remedy) {
        return Err(format!("{said}\nshould say: {} → {}", fault.error, fault.remedy).into());
    }
    if noticed > fault.seconds {
        return Err(format!("noticed after {noticed} s").into());
    }
    stands_still(rig)?;
    desk.is("held")?;
    let (kept, touched) = (desk.kept()? as u64, rig.touches()? - before);
    eprintln!("{kept} of {touched} touches kept");
    // The last touch may have come after the end, or without its back-off.
    if kept < BEFORE - 1 || kept > touched || touched > kept + 1 {
        return Err(format!("{kept} of {touched} touches kept").into());
    }
    Ok(desk)
}

/// During a touch or its back-off.
const TOUCHING: fn(&Rig) -> Result<bool, Failed> = |_| Ok(true);
/// Between touches, over the part.
pub const TRAVELLING: fn(&Rig) -> Result<bool, Failed> = |rig| Ok(rig.joint(2)? > 101.0);

/// Waits until the rig has counted this many touches. Fails after a minute without a new one, with the run's
/// output: the duration of a touch depends on the computer.
pub fn wait_for(rig: &Rig, touches: u64, run: &mut Child) -> Result<(), Failed> {
    let (mut counted, mut since) = (rig.touches()?, Instant::now());
    while counted < touches {
        if run.try_wait()?.is_some() || since.elapsed() > MINUTE {
            return Err(given_up(run, counted)?.into());
        }
        sleep(Duration::from_millis(5));
        let now = rig.touches()?;
        if now > counted {
            (counted, since) = (now, Instant::now());
        }
    }
    Ok(())
}

/// Waits until the condition holds; fails like `wait_for`.
pub fn wait_until(there: fn(&Rig) -> Result<bool, Failed>, rig: &Rig, run: &mut Child) -> Result<(), Failed> {
    let since = Instant::now();
    while !there(rig)? {
        if run.try_wait()?.is_some() || since.elapsed() > MINUTE {
            return Err(given_up(run, rig.touches()?)?.into());
        }
    }
    Ok(())
}

fn given_up(run: &mut Child, counted: u64) -> Result<String, Failed> {
    run.kill()?;
    let status = run.wait()?;
    let mut said = String::new();
    if let Some(mut stderr) = run.stderr.take() {
        stderr.read_to_string(&mut said)?;
    }
    Ok(format!("touch {counted} was the last, {status}: {said}"))
}

fn stands_still(rig: &Rig) -> Result<(), Failed> {
    let stands = rig.stands()?;
    sleep(Duration::from_millis(500));
    if rig.stands()? == stands { Ok(()) } else { Err("it moves on".into()) }
}

pub fn emergency_stop() -> Result<(), Failed> {
    held_by(&Fault {
        when: TRAVELLING,
        happens: |rig| rig.emergency_stop(),
        error: "the emergency stop was pressed",
        remedy: "release the emergency stop, switch the machine on",
        seconds: 1.0,
    })
}

pub fn machine_off() -> Result<(), Failed> {
    held_by(&Fault {
        when: TOUCHING,
        happens: |rig| rig.press("machine.off"),
        error: "the machine has switched off",
        remedy: "switch it on",
        seconds: 2.0,
    })
}

pub fn killed_task() -> Result<(), Failed> {
    resumable_after(
        "the control has stopped working",
        &Fault {
            when: TRAVELLING,
            happens: |rig| rig.task("-KILL"),
            error: "the control has stopped working: the control accepts no command, and its status is out of date",
            remedy: "press the emergency stop, restart the control",
            seconds: 6.0,
        },
    )
}

pub fn frozen_task() -> Result<(), Failed> {
    held_by(&Fault {
        when: TRAVELLING,
        happens: |rig| rig.task("-STOP"),
        error: "the control has stopped working: the control accepts no command, and its status is out of date",
        remedy: "press the emergency stop",
        seconds: 6.0,
    })
}

pub fn killed_linuxcncrsh() -> Result<(), Failed> {
    resumable_after(
        "no linuxcncrsh listens at",
        &Fault {
            when: TOUCHING,
            happens: |rig| rig.rsh("-KILL"),
            error: "is lost",
            remedy: "the state of the machine is unknown",
            seconds: 2.0,
        },
    )
}

pub fn silent_linuxcncrsh() -> Result<(), Failed> {
    held_by(&Fault {
        when: TRAVELLING,
        happens: |rig| rig.rsh("-STOP"),
        error: "no reply to `get ",
        remedy: "the state of the machine is unknown",
        seconds: 6.0,
    })
}

pub fn stuck_probe() -> Result<(), Failed> {
    resumable_after(
        "the probe reads closed",
        &Fault {
            when: TOUCHING,
            happens: |rig| rig.make_true("stuck", 1.0),
            error: "the probe reads closed where the stylus must be free",
            remedy: "check the probe's battery, cable and polarity",
            seconds: 3.0,
        },
    )
}

pub fn missing_part() -> Result<(), Failed> {
    resumable_after(
        "no contact before the end",
        &Fault {
            when: TRAVELLING,
            happens: |rig| rig.remove_part(),
            error: "no contact before the end of the probing move",
            remedy: "check the position and size of the part in the machine file",
            seconds: 6.0,
        },
    )
}

pub fn pause_at_the_machine() -> Result<(), Failed> {
    held_by(&Fault {
        when: TRAVELLING,
        happens: |rig| rig.press("program.pause"),
        error: "the program is paused at the control: pause was pressed",
        remedy: "nothing continues by itself",
        seconds: 2.0,
    })
}

pub fn no_feed() -> Result<(), Failed> {
    held_by(&Fault {
        when: TRAVELLING,
        happens: |rig| rig.no_feed(),
        // Between two programs, or during a move.
        error: "the feed override is 0 %",
        remedy: "",
        seconds: 4.0,
    })
}

pub fn soft_limit() -> Result<(), Failed> {
    held_by(&Fault {
        when: TRAVELLING,
        happens: |rig| rig.limit_x(40.0),
        error: "the target is outside the travel limits of the control",
        remedy: "set [axes] min and max to the limits of the control",
        seconds: 30.0,
    })
}

pub fn foreign_contact() -> Result<(), Failed> {
    held_by(&Fault {
        when: TRAVELLING,
        happens: |rig| rig.foreign_contact(),
        error: "unexpected contact during a positioning move",
        remedy: "run `trued check`, which retracts it; then check the position of the part, the fixtures",
        seconds: 3.0,
    })
}
