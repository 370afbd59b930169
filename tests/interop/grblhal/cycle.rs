//! The program itself, from one command to a stored estimate, on a machine whose zero is a corner, with soft limits
//! enabled. Only the firmware has the true axes.

use std::time::Instant;

use libtest_mimic::Failed;
use machine::record::estimate::Estimate;

use super::rig::GrblHalRig;
use crate::linuxcnc::run_workspace::{RunWorkspace, failure_text, value_and_expanded_u};

/// Settings for a short run: higher feeds, no references; with the usual 8 positions no touch is repeated.
pub const SHORT_RUN_TEXT_CHANGES: [(&str, &str); 4] = [
    ("feed_mm_min = 60.0", "feed_mm_min = 240.0"),
    ("search_feed_mm_min = 300.0", "search_feed_mm_min = 600.0"),
    ("guarded_feed_mm_min = 3000.0", "guarded_feed_mm_min = 6000.0"),
    ("heights_mm = [90.0]", "heights_mm = [90.0]\nreferences = false"),
];
/// Maximum of U, µm: a step of the rig's axes is 4 µm long.
const MAX_EXPANDED_U_UM: f64 = 6.0;

/// Location of the true C axis relative to the machine file, µm.
pub const FIRST_TRUE_C_AXIS_UM: [(&str, f64); 2] = [("EX0C", 50.0), ("EY0C", -30.0)];
const SECOND_TRUE_C_AXIS_UM: [(&str, f64); 2] = [("EX0C", -80.0), ("EY0C", 110.0)];

pub fn run_method_for_estimate(workspace: &RunWorkspace, method: &str) -> Result<Estimate, Failed> {
    let output = workspace.start_run(method)?.wait_with_output()?;
    if output.status.code() != Some(0) {
        return Err(failure_text(&output).into());
    }
    Ok(serde_json::from_slice(&output.stdout)?)
}

pub fn check_truth_within_u(estimate: &Estimate, truth_um: &[(&str, f64)]) -> Result<(), Failed> {
    for (symbol, truth) in truth_um {
        let (value, expanded) = value_and_expanded_u(estimate, symbol)?;
        eprintln!("{symbol} = {value:.3} um, U = {expanded:.3} um, truly {truth}");
        if (value - truth).abs() > expanded || expanded > MAX_EXPANDED_U_UM {
            return Err(format!("{symbol} = {value} um, U = {expanded} um, truly {truth}").into());
        }
    }
    Ok(())
}

pub fn short_cycle_finds_the_true_axis() -> Result<(), Failed> {
    let rig = GrblHalRig::start_homed(&[])?;
    check_truth_within_u(
        &run_method_for_estimate(&rig.create_run_workspace(&SHORT_RUN_TEXT_CHANGES)?, "self-calibration")?,
        &FIRST_TRUE_C_AXIS_UM,
    )
}

pub fn two_true_axis_positions_are_found_in_the_planned_time() -> Result<(), Failed> {
    let second = [("cx", -0.08), ("cy", 0.11)];
    for (truth, truth_um) in [(&[][..], FIRST_TRUE_C_AXIS_UM), (&second[..], SECOND_TRUE_C_AXIS_UM)] {
        let rig = GrblHalRig::start_homed(truth)?;
        let workspace = rig.create_run_workspace(&[])?;
        let planned_s = planned_machine_time_s(&workspace)?;
        let started = Instant::now();
        let estimate = run_method_for_estimate(&workspace, "self-calibration")?;
        let took_s = started.elapsed().as_secs_f64();
        eprintln!("took {took_s:.0} s; {planned_s:.0} s were planned");
        check_truth_within_u(&estimate, &truth_um)?;
        if (took_s / planned_s - 1.0).abs() > 0.1 {
            return Err(format!("took {took_s} s; {planned_s} s were planned").into());
        }
    }
    Ok(())
}

/// The machine time that `trued plan` predicts.
fn planned_machine_time_s(workspace: &RunWorkspace) -> Result<f64, Failed> {
    let machine = workspace.machine_file_path().display().to_string();
    let output = workspace.trued_command_with_journal(&["plan", "self-calibration", "--machine", &machine]).output()?;
    let said = String::from_utf8_lossy(&output.stdout).into_owned() + &failure_text(&output);
    let time = said.split_once("machine time: about ").ok_or(said.clone())?.1;
    let words: Vec<&str> = time.lines().next().unwrap_or_default().split_whitespace().collect();
    let mut seconds = 0.0;
    for pair in words.chunks_exact(2) {
        let unit_s = [("h", 3600.0), ("min", 60.0), ("s", 1.0)];
        let Some((_, unit)) = unit_s.iter().find(|(unit, _)| *unit == pair[1]) else { break };
        seconds += pair[0].parse::<f64>()? * unit;
    }
    Ok(seconds)
}

pub fn true_axis_is_found_with_a_reversed_c_axis() -> Result<(), Failed> {
    let rig = GrblHalRig::start_homed(&[("sC", 1.0)])?;
    let c = "[axes.C]\npositive = \"iso\"";
    let workspace = rig.create_run_workspace(&[(c, "[axes.C]\npositive = \"reversed\"")])?;
    check_truth_within_u(&run_method_for_estimate(&workspace, "self-calibration")?, &FIRST_TRUE_C_AXIS_UM)
}

/// The probe of the rig is latched in the firmware itself, without delay.
pub fn latch_delay_of_zero_is_found_within_u() -> Result<(), Failed> {
    let rig = GrblHalRig::start_homed(&[])?;
    let estimate = run_method_for_estimate(&rig.create_run_workspace(&[])?, "latch-delay")?;
    let (delay_ms, expanded_ms) = value_and_expanded_u(&estimate, "t_latch")?;
    match delay_ms.abs() <= expanded_ms && expanded_ms < 2.0 {
        true => Ok(()),
        false => Err(format!("t_latch = {delay_ms} ms, U = {expanded_ms} ms").into()),
    }
}
