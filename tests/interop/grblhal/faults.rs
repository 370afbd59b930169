//! Faults that stop a run midway, and its resumption.

use std::process::Output;

use libtest_mimic::Failed;

use super::cycle::{FIRST_UM, near_the_truth};
use super::rig::Rig;
use crate::linuxcnc::desk::{Desk, complaint};

/// Few angles and fast touches, with the references that a resumed run needs.
const FEW: [(&str, &str); 2] =
    [("feed_mm_min = 60.0", "feed_mm_min = 120.0"), ("heights_mm = [90.0]", "heights_mm = [90.0]\npositions = 6")];
/// Number of touches before the fault: the part is located, the references are measured.
const TOUCHES: usize = 12;

/// A run that `fault` stops after some touches, so that it is held.
fn held(rig: &mut Rig, fault: impl FnOnce(&mut Rig) -> Result<(), Failed>) -> Result<Desk, Failed> {
    let desk = rig.desk(&FEW)?;
    rig.wire.forget();
    let mut run = desk.run("self-calibration")?;
    rig.wait_for_touches(TOUCHES, &mut run)?;
    fault(rig)?;
    let output = run.wait_with_output()?;
    if output.status.code() != Some(5) {
        return Err(complaint(&output).into());
    }
    desk.is("held")?;
    Ok(desk)
}

fn goes_on(desk: &Desk) -> Result<(), Failed> {
    let arguments = ["resume", "1", "--acknowledge", "Anna", "--homed", "--json"];
    let output = desk.command(&arguments).output()?;
    if output.status.code() != Some(0) {
        return Err(complaint(&output).into());
    }
    near_the_truth(&serde_json::from_slice(&output.stdout)?, &FIRST_UM)
}

/// Checks that a resume sends no motion and that the message names the missing condition.
fn does_not_go_on(rig: &Rig, desk: &Desk, named: &str) -> Result<(), Failed> {
    rig.wire.forget();
    let output: Output = desk.command(&["resume", "1", "--acknowledge", "Anna", "--homed"]).output()?;
    let (said, motions) = (complaint(&output), rig.wire.motions());
    if output.status.success() || !said.contains(named) || !motions.is_empty() {
        return Err(format!("{motions:?} was sent; {said}").into());
    }
    Ok(())
}

/// Feed hold at the machine, then a reset: the firmware loses its homed state.
pub fn a_run_that_was_held_at_the_machine_goes_on() -> Result<(), Failed> {
    let mut rig = Rig::homed(&[])?;
    let desk = held(&mut rig, |rig| rig.press('h'))?;
    rig.reset()?;
    does_not_go_on(&rig, &desk, "not homed")?;
    rig.home()?;
    goes_on(&desk)
}

pub fn a_run_goes_on_after_the_firmware_was_killed() -> Result<(), Failed> {
    let mut rig = Rig::homed(&[])?;
    let desk = held(&mut rig, Rig::kill)?;
    rig.start_again()?;
    does_not_go_on(&rig, &desk, "not homed")?;
    rig.home()?;
    goes_on(&desk)
}
