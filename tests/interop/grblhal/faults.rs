//! Faults that stop a run midway, and its resumption.

use std::process::Output;

use libtest_mimic::Failed;

use super::cycle::{FIRST_TRUTH_UM, check_near_truth};
use super::rig::GrblHalRig;
use crate::linuxcnc::desk::{RunWorkspace, failure_text};

/// Few angles and fast touches, with the references that a resumed run needs.
const FEW_TOUCHES_SETTINGS: [(&str, &str); 2] =
    [("feed_mm_min = 60.0", "feed_mm_min = 120.0"), ("heights_mm = [90.0]", "heights_mm = [90.0]\npositions = 6")];
/// Number of touches before the fault: the part is located, the references are measured.
const TOUCH_COUNT: usize = 12;

/// A run that `fault` stops after some touches, so that it is held.
fn run_until_held(
    rig: &mut GrblHalRig,
    fault: impl FnOnce(&mut GrblHalRig) -> Result<(), Failed>,
) -> Result<RunWorkspace, Failed> {
    let desk = rig.workspace(&FEW_TOUCHES_SETTINGS)?;
    rig.proxy.clear_record();
    let mut run = desk.start_run("self-calibration")?;
    rig.wait_for_touches(TOUCH_COUNT, &mut run)?;
    fault(rig)?;
    let output = run.wait_with_output()?;
    if output.status.code() != Some(5) {
        return Err(failure_text(&output).into());
    }
    desk.check_state("held")?;
    Ok(desk)
}

fn check_resumes(desk: &RunWorkspace) -> Result<(), Failed> {
    let arguments = ["resume", "1", "--acknowledge", "Anna", "--homed", "--json"];
    let output = desk.command(&arguments).output()?;
    if output.status.code() != Some(0) {
        return Err(failure_text(&output).into());
    }
    check_near_truth(&serde_json::from_slice(&output.stdout)?, &FIRST_TRUTH_UM)
}

/// Checks that a resume sends no motion and that the message names the missing condition.
fn check_resume_refused(rig: &GrblHalRig, desk: &RunWorkspace, named: &str) -> Result<(), Failed> {
    rig.proxy.clear_record();
    let output: Output = desk.command(&["resume", "1", "--acknowledge", "Anna", "--homed"]).output()?;
    let (said, motions) = (failure_text(&output), rig.proxy.sent_motions());
    if output.status.success() || !said.contains(named) || !motions.is_empty() {
        return Err(format!("{motions:?} was sent; {said}").into());
    }
    Ok(())
}

/// Feed hold at the machine, then a reset: the firmware loses its homed state.
pub fn run_held_at_the_machine_resumes() -> Result<(), Failed> {
    let mut rig = GrblHalRig::start_homed(&[])?;
    let desk = run_until_held(&mut rig, |rig| rig.press_button('h'))?;
    rig.reset()?;
    check_resume_refused(&rig, &desk, "not homed")?;
    rig.home()?;
    check_resumes(&desk)
}

pub fn run_resumes_after_the_firmware_was_killed() -> Result<(), Failed> {
    let mut rig = GrblHalRig::start_homed(&[])?;
    let desk = run_until_held(&mut rig, GrblHalRig::kill_firmware)?;
    rig.restart_firmware()?;
    check_resume_refused(&rig, &desk, "not homed")?;
    rig.home()?;
    check_resumes(&desk)
}
