//! `run` is refused, and no line that moves is sent, while the firmware is not homed or has unsuitable settings or
//! overrides.

use libtest_mimic::Failed;

use super::rig::GrblHalRig;
use crate::linuxcnc::run_workspace::{RunWorkspace, failure_text};

/// A method that needs no angle of the table.
const METHOD_WITHOUT_TABLE_ANGLE: &str = "latch-delay";

fn check_run_refused(rig: &GrblHalRig, workspace: &RunWorkspace, named: [&str; 2]) -> Result<(), Failed> {
    rig.proxy.clear_record();
    let output = workspace.start_run(METHOD_WITHOUT_TABLE_ANGLE)?.wait_with_output()?;
    let said = failure_text(&output);
    let motions = rig.proxy.sent_motions();
    if !motions.is_empty() {
        return Err(format!("{named:?}: it was sent {motions:?}").into());
    }
    let is_named = named.iter().all(|words| said.contains(words));
    if output.status.code() != Some(1) || !is_named || rig.proxy.sent_lines().is_empty() {
        return Err(format!("{named:?} is not in {said}").into());
    }
    Ok(())
}

/// Real-time commands of Grbl 1.1: feed override to 100 %, 10 % more; rapid override to 100 %, to 25 %.
const FEED_OVERRIDE_100: &[u8] = &[0x90];
const FEED_OVERRIDE_200: &[u8] = &[0x91; 10];
const RAPID_OVERRIDE_100: &[u8] = &[0x95];
const RAPID_OVERRIDE_25: &[u8] = &[0x97];

pub fn a_control_that_is_not_ready_is_sent_no_motion() -> Result<(), Failed> {
    let mut rig = GrblHalRig::start_not_homed(&[])?;
    let workspace = rig.create_run_workspace(&[])?;
    check_run_refused(&rig, &workspace, ["not homed", "$H"])?;
    rig.home_axes()?;
    for (wrong, right, named) in [
        ("$13=1", "$13=0", ["in inches", "$13=0"]),
        ("$10=510", "$10=511", ["the machine position", "$10=511"]),
        ("$10=447", "$10=511", ["the overrides", "$10=511"]),
        ("$20=0", "$20=1", ["soft limits are off", "$20=1"]),
        ("$131=0", "$131=200", ["do not limit Y", "$131"]),
    ] {
        rig.query(wrong)?;
        check_run_refused(&rig, &workspace, named)?;
        rig.query(right)?;
    }
    for (wrong, reported, right, named) in [
        (FEED_OVERRIDE_200, "|Ov:200,100,", FEED_OVERRIDE_100, ["feed 200 %", "100 %"]),
        (RAPID_OVERRIDE_25, "|Ov:100,25,", RAPID_OVERRIDE_100, ["rapid 25 %", "100 %"]),
    ] {
        rig.send_bytes_until_reported(wrong, reported)?;
        check_run_refused(&rig, &workspace, named)?;
        rig.send_bytes_until_reported(right, "|Ov:100,100,")?;
    }
    rig.soft_reset()?;
    check_run_refused(&rig, &workspace, ["not homed", "$H"])?;
    rig.home_axes()?;
    rig.restart_firmware()?;
    check_run_refused(&rig, &workspace, ["not homed", "$H"])
}
