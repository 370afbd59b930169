//! Faults that stop a run midway, and its resumption.

use std::process::Output;

use libtest_mimic::Failed;

use super::cycle::{FIRST_TRUE_C_AXIS_UM, check_truth_within_u};
use super::rig::GrblHalRig;
use crate::linuxcnc::run_workspace::{RunWorkspace, failure_text};

/// Few angles and fast touches, with the references that a resumed run needs.
const FEW_TOUCHES_TEXT_CHANGES: [(&str, &str); 2] =
    [("feed_mm_min = 60.0", "feed_mm_min = 120.0"), ("heights_mm = [90.0]", "heights_mm = [90.0]\npositions = 6")];
/// Number of touches before the fault: the part is located, the references are measured.
const TOUCHES_BEFORE_FAULT: usize = 12;

/// Runs until `fault` stops the run after some touches, and checks that the run is held.
fn run_until_held(
    rig: &mut GrblHalRig,
    fault: impl FnOnce(&mut GrblHalRig) -> Result<(), Failed>,
) -> Result<RunWorkspace, Failed> {
    let workspace = rig.create_run_workspace(&FEW_TOUCHES_TEXT_CHANGES)?;
    rig.proxy.clear_record();
    let mut run = workspace.start_run("self-calibration")?;
    rig.wait_for_touches(TOUCHES_BEFORE_FAULT, &mut run)?;
    fault(rig)?;
    let output = run.wait_with_output()?;
    if output.status.code() != Some(5) {
        return Err(failure_text(&output).into());
    }
    workspace.check_last_run_state("held")?;
    Ok(workspace)
}

fn check_resumed_run_finds_truth(workspace: &RunWorkspace) -> Result<(), Failed> {
    let arguments = ["resume", "1", "--acknowledge", "Anna", "--homed", "--json"];
    let output = workspace.trued_command_with_journal(&arguments).output()?;
    if output.status.code() != Some(0) {
        return Err(failure_text(&output).into());
    }
    check_truth_within_u(&serde_json::from_slice(&output.stdout)?, &FIRST_TRUE_C_AXIS_UM)
}

/// Checks that a resume sends no motion and that the message names the missing condition.
fn check_resume_refused(rig: &GrblHalRig, workspace: &RunWorkspace, named: &str) -> Result<(), Failed> {
    rig.proxy.clear_record();
    let output: Output =
        workspace.trued_command_with_journal(&["resume", "1", "--acknowledge", "Anna", "--homed"]).output()?;
    let (said, motions) = (failure_text(&output), rig.proxy.sent_motions());
    if output.status.success() || !said.contains(named) || !motions.is_empty() {
        return Err(format!("{motions:?} was sent; {said}").into());
    }
    Ok(())
}

/// Feed hold at the machine, then a reset: the firmware loses its homed state.
pub fn run_held_and_reset_at_the_machine_resumes_only_after_homing() -> Result<(), Failed> {
    let mut rig = GrblHalRig::start_homed(&[])?;
    let workspace = run_until_held(&mut rig, |rig| rig.press_button('h'))?;
    rig.soft_reset()?;
    check_resume_refused(&rig, &workspace, "not homed")?;
    rig.home_axes()?;
    check_resumed_run_finds_truth(&workspace)
}

pub fn run_resumes_only_after_homing_if_the_firmware_was_killed() -> Result<(), Failed> {
    let mut rig = GrblHalRig::start_homed(&[])?;
    let workspace = run_until_held(&mut rig, GrblHalRig::kill_firmware)?;
    rig.restart_firmware()?;
    check_resume_refused(&rig, &workspace, "not homed")?;
    rig.home_axes()?;
    check_resumed_run_finds_truth(&workspace)
}
