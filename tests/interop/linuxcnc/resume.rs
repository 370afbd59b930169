//! `trued resume` against a running LinuxCNC.

use libtest_mimic::Failed;
use machine::record::estimate::Estimate;

use super::cycle::TRUE_C_AXIS_UM;
use super::faults::{IS_ABOVE_PART, wait_for_touches, wait_until};
use super::rig::{LinuxCncRig, lock_rig};
use super::run_workspace::{RunWorkspace, failure_text, value_and_expanded_u};

/// Number of touches before the stop: the part is located; the references, Test 1a, and some of Test 1b.
const TOUCHES_BEFORE_STOP: u64 = 18;

/// Runs until an emergency stop between two touches, after `touches` of them; checks that the run is held.
fn run_until_emergency_stop(rig: &LinuxCncRig, positions: u32, touches: u64) -> Result<RunWorkspace, Failed> {
    let workspace = RunWorkspace::with_position_count(rig, positions)?;
    let before = rig.touch_count()?;
    let mut run = workspace.start_self_calibration()?;
    wait_for_touches(rig, before + touches, &mut run)?;
    wait_until(IS_ABOVE_PART, rig, &mut run)?;
    rig.press_emergency_stop()?;
    let output = run.wait_with_output()?;
    if output.status.code() == Some(5) { Ok(workspace) } else { Err(failure_text(&output).into()) }
}

/// Releases the machine as an operator does after an inspection, without manual motion.
pub fn release_stop_and_switch_machine_on(rig: &LinuxCncRig) -> Result<(), Failed> {
    rig.release_emergency_stop()?;
    let mut person = rig.connect_client()?;
    person.send_line("set estop off")?;
    person.send_line("set machine on").map(drop)
}

/// The part is 1 mm off its stated position.
pub fn run_resumes_after_a_released_emergency_stop() -> Result<(), Failed> {
    let rig = lock_rig()?;
    rig.set_true_value("ecc-x", 1.120)?;
    let workspace = run_until_emergency_stop(&rig, 5, TOUCHES_BEFORE_STOP)?;
    let stands = rig.wait_for_rest()?;
    let early = workspace.start_resume_of_first_run()?.wait_with_output()?;
    let said = failure_text(&early);
    if early.status.success() || !said.contains("the emergency stop is pressed") {
        return Err(said.into());
    }
    if rig.wait_for_rest()? != stands {
        return Err("it moved although the stop was pressed".into());
    }
    release_stop_and_switch_machine_on(&rig)?;
    let output = workspace.start_resume_of_first_run()?.wait_with_output()?;
    if output.status.code() != Some(0) {
        return Err(failure_text(&output).into());
    }
    workspace.check_last_run_state("finished")?;
    eprintln!("{}", failure_text(&output));
    let estimate: Estimate = serde_json::from_slice(&output.stdout)?;
    for (symbol, truth) in TRUE_C_AXIS_UM {
        let (value, expanded) = value_and_expanded_u(&estimate, symbol)?;
        eprintln!("{symbol} = {value:.3} um, U = {expanded:.3} um");
        if (value - truth).abs() > expanded || expanded > 3.0 {
            return Err(format!("{symbol} = {value} um, U = {expanded} um").into());
        }
    }
    Ok(())
}

/// The part moved by 20 µm along Y: the references at 72° and 216° detect it, the one in X does not.
pub fn resume_is_refused_when_the_part_has_moved() -> Result<(), Failed> {
    let rig = lock_rig()?;
    let workspace = run_until_emergency_stop(&rig, 5, 13)?;
    release_stop_and_switch_machine_on(&rig)?;
    let kept = workspace.first_run_probe_reading_count()?;
    let before = rig.touch_count()?;
    rig.set_true_value("ecc-y", -0.060)?;
    let output = workspace.start_resume_of_first_run()?.wait_with_output()?;
    let said = failure_text(&output);
    eprintln!("{said}");
    let refused = "the references have shifted since the stop";
    if output.status.success() || !said.contains(refused) {
        return Err(said.into());
    }
    let named = |place: &str| said.contains(&format!("{place} moved by"));
    if !named("P072") || !named("P216") || named("P000") {
        return Err(said.into());
    }
    workspace.check_last_run_state("closed")?;
    let (touched, more) = (rig.touch_count()? - before, workspace.first_run_probe_reading_count()? - kept);
    eprintln!("{touched} touches more, {more} kept");
    if touched == 4 && more == 4 { Ok(()) } else { Err("other than the references".into()) }
}
