//! `trued compensate` sets a work offset of LinuxCNC. The joints show it: in the slot the axes move to zero.

use std::thread::sleep;
use std::time::Duration;

use libtest_mimic::Failed;

use super::rig::{LinuxCncRig, lock_rig};
use super::rsh_client::RshClient;
use super::run_workspace::RunWorkspace;
use crate::work_offset_trial::{WorkOffsetTrial, refusal};

/// Zero of G55 before, mm. C is at (0.05, -0.03), Z is not determined.
const BEFORE_MM: [f64; 3] = [0.125, -0.25, 3.0];
const CORRECTED_MM: [f64; 3] = [0.05, -0.03, 3.0];

/// Moves above the zero of G55, and checks that the joints are there.
fn check_zero(rig: &LinuxCncRig, [x, y, z]: [f64; 3]) -> Result<(), Failed> {
    let mut person = rig.connect_client()?;
    person.run_mdi("G21 G90 G55 G0 X0 Y0 Z150")?;
    let joints = rig.wait_for_rest()?;
    person.run_mdi("G54 G53 G0 X0 Y0 Z200")?;
    rig.wait_for_rest()?;
    let expected = [x, y, z + 150.0];
    let is_there = joints.iter().zip(expected).all(|(joint, mm)| (joint - mm).abs() < 1e-6);
    if is_there { Ok(()) } else { Err(format!("the axes are at {joints:?}, not at {expected:?}").into()) }
}

/// What `change` makes is refused; `restore` ends it.
fn check_refused(
    trial: &WorkOffsetTrial<'_>,
    person: &mut RshClient,
    [change, restore, expected]: [&str; 3],
) -> Result<(), Failed> {
    person.send_line("set enable EMCTOO")?;
    person.run_mdi(change)?;
    let refused = trial.propose()?;
    person.send_line("set enable EMCTOO")?;
    person.run_mdi(restore)?;
    refusal(&refused, expected)
}

/// A move is in progress, by a program of MDI and by a jog.
fn check_refused_in_motion(
    trial: &WorkOffsetTrial<'_>,
    rig: &LinuxCncRig,
    person: &mut RshClient,
) -> Result<(), Failed> {
    person.send_line("set enable EMCTOO")?;
    for (start, end) in [
        (&["set mode mdi", "set mdi G53 G1 X200 F1000"][..], "set abort"),
        (&["set mode manual", "set teleop_enable on", "set jog x 600"][..], "set jog_stop x"),
    ] {
        start.iter().try_for_each(|line| person.send_line(line).map(drop))?;
        sleep(Duration::from_millis(300));
        let before = rig.joint_position(0)?;
        let refused = trial.propose()?;
        let has_moved = (rig.joint_position(0)? - before).abs() > 0.1;
        person.send_line("set enable EMCTOO")?;
        person.send_line(end)?;
        rig.wait_for_rest()?;
        refusal(&refused, if end == "set abort" { "a program is running" } else { "the machine moves" })?;
        if !has_moved {
            return Err(format!("{start:?} moves nothing, or the refusal stops it").into());
        }
    }
    person.run_mdi("G53 G0 X0")?;
    rig.wait_for_rest().map(drop)
}

pub fn rotary_centre_is_written_and_restored() -> Result<(), Failed> {
    let rig = lock_rig()?;
    let workspace = RunWorkspace::with_work_offset(&rig, "G55")?;
    let trial = WorkOffsetTrial::new(&workspace, [0.0, 0.0, 90.0])?;
    let mut person = rig.connect_client()?;
    person.run_mdi("G21 G90 G54 G92.1")?;
    let [x, y, z] = BEFORE_MM;
    person.run_mdi(&format!("G10 L2 P2 X{x} Y{y} Z{z} B0 C0 R0"))?;
    check_refused(&trial, &mut person, ["G92 X1", "G92.1", "G92 is active"])?;
    check_refused(&trial, &mut person, ["G10 L2 P2 R5", "G10 L2 P2 R0", "rotated by 5°"])?;
    check_refused_in_motion(&trial, &rig, &mut person)?;
    // Inches, incremental motion and the slot itself: all remain selected.
    person.send_line("set enable EMCTOO")?;
    person.run_mdi("G55 G20 G91")?;
    let codes = person.send_line("get program_codes")?;
    let (hash, _) = trial.proposal()?;
    let written = trial.write_stdout(&hash)?;
    let after = person.send_line("get program_codes")?;
    let stored = std::fs::read_to_string(rig.directory.join("rig.var"))?;
    if !stored.lines().any(|line| line == "5241\t0.050000") {
        return Err(format!("the parameter file has other values: {stored}").into());
    }
    let has_codes = ["G55", "G20", "G91"].iter().all(|code| after.split(' ').any(|own| own == *code));
    if !has_codes || !written.contains("uses G55 now: the coordinates that it displays have changed at once") {
        return Err(format!("{codes}; {after}; {written}").into());
    }
    check_zero(&rig, CORRECTED_MM)?;
    trial.undo_stdout()?;
    check_zero(&rig, BEFORE_MM)?;
    person.send_line("set enable EMCTOO")?;
    person.run_mdi("G10 L2 P2 X0 Y0 Z0")
}
