//! The program itself, from one command to a stored estimate, with a running LinuxCNC whose true axes it does not
//! have.

use std::process::Command;
use std::thread::sleep;
use std::time::{Duration, Instant};

use libtest_mimic::Failed;
use machine::record::estimate::Estimate;

use super::rig::{LinuxCncRig, lock_rig};
use super::run_workspace::{RunWorkspace, failure_text, value_and_expanded_u};

/// Location of the true C axis, and the tolerance of a result, µm.
pub const TRUE_C_AXIS_UM: [(&str, f64); 2] = [("EX0C", 50.0), ("EY0C", -30.0)];
const TRUTH_TOLERANCE_UM: f64 = 1.0;

/// Runs self-calibration to its end; returns the estimate.
fn run_self_calibration(workspace: &RunWorkspace) -> Result<Estimate, Failed> {
    let started = Instant::now();
    let output = workspace.start_self_calibration()?.wait_with_output()?;
    let seconds = started.elapsed().as_secs_f64();
    if output.status.code() != Some(0) {
        return Err(failure_text(&output).into());
    }
    let estimate: Estimate = serde_json::from_slice(&output.stdout)?;
    for (symbol, _) in TRUE_C_AXIS_UM {
        let (value, expanded) = value_and_expanded_u(&estimate, symbol)?;
        eprintln!("{symbol} = {value:.3} um, U = {expanded:.3} um");
    }
    eprintln!("the whole cycle took {seconds:.0} s");
    Ok(estimate)
}

/// Tests 1a, 1b, 1c, 2, 3 and the references with N = 8: with the part in its original position, and moved by 1 mm.
pub fn true_c_axis_is_found_also_with_the_part_moved_by_1_mm() -> Result<(), Failed> {
    let rig = lock_rig()?;
    let first = run_self_calibration(&RunWorkspace::for_rig(&rig)?)?;
    rig.set_true_value("ecc-x", 1.120)?;
    let second = run_self_calibration(&RunWorkspace::for_rig(&rig)?)?;
    check_near_true_c_axis(&first)?;
    check_near_true_c_axis(&second)?;
    for (symbol, _) in TRUE_C_AXIS_UM {
        let change = value_and_expanded_u(&second, symbol)?.0 - value_and_expanded_u(&first, symbol)?.0;
        eprintln!("the part moved by 1 mm: {symbol} changes by {change:.3} um");
        if change.abs() > TRUTH_TOLERANCE_UM {
            return Err(format!("{symbol} follows the part by {change} um").into());
        }
    }
    Ok(())
}

fn check_near_true_c_axis(estimate: &Estimate) -> Result<(), Failed> {
    for (symbol, truth) in TRUE_C_AXIS_UM {
        let (value, expanded) = value_and_expanded_u(estimate, symbol)?;
        let error = (value - truth).abs();
        if error > TRUTH_TOLERANCE_UM || error > expanded || expanded > 2.0 * TRUTH_TOLERANCE_UM {
            return Err(format!("{symbol} = {value} um, U = {expanded} um").into());
        }
    }
    Ok(())
}

/// Ctrl-C while the table turns in Test 1a.
pub fn ctrl_c_holds_the_run_and_keeps_its_readings() -> Result<(), Failed> {
    let rig = lock_rig()?;
    let workspace = RunWorkspace::for_rig(&rig)?;
    let mut run = workspace.start_self_calibration()?;
    while rig.joint_position(4)?.abs() < 1.0 {
        if run.try_wait()?.is_some() {
            return Err(failure_text(&run.wait_with_output()?).into());
        }
    }
    let stopped = Command::new("kill").args(["-INT", &run.id().to_string()]).status()?;
    let output = run.wait_with_output()?;
    if !stopped.success() || output.status.code() != Some(5) || !output.stdout.is_empty() {
        return Err(failure_text(&output).into());
    }
    let stands = joint_positions(&rig)?;
    eprintln!("held at C {:.2} deg", stands[4]);
    sleep(Duration::from_millis(500));
    if joint_positions(&rig)? != stands {
        return Err(format!("it moves on from {stands:?}").into());
    }
    workspace.check_last_run_state("held")?;
    // Readings before the table turns: five to locate the part, four references, Test 1a at 0°.
    let kept = workspace.first_run_probe_reading_count()?;
    eprintln!("{kept} readings kept");
    if (10..69).contains(&kept) { Ok(()) } else { Err(format!("{kept} readings").into()) }
}

/// The communication and the files of a run, and a replay of the run from them. (`tests/peers/linuxcnc/thin.py`
/// reduces such a capture; `tests/data/linuxcnc/` was created this way.)
pub fn capture_replays_to_the_same_estimate() -> Result<(), Failed> {
    let rig = lock_rig()?;
    let workspace = RunWorkspace::with_quick_touches(&rig)?;
    let machine = workspace.machine_file_path();
    let capture = machine.with_file_name("a.capture").display().to_string();
    let machine = machine.display().to_string();
    let run = |how: &str| -> Result<Estimate, Failed> {
        let said = ["run", "self-calibration", "--json", "--machine", &machine, how, &capture];
        Ok(serde_json::from_str(&workspace.run_stdout(&said)?)?)
    };
    let (measured, touches) = (run("--capture")?, rig.touch_count()?);
    let replayed = run("--replay")?;
    if rig.touch_count()? != touches {
        return Err("the replay moved the machine".into());
    }
    for parameter in &measured.parameters {
        let (again, _) = value_and_expanded_u(&replayed, &parameter.symbol)?;
        if (again - parameter.value).abs() > 1e-4 {
            return Err(format!("{} was {}, is {again}", parameter.symbol, parameter.value).into());
        }
    }
    Ok(())
}

fn joint_positions(rig: &LinuxCncRig) -> Result<Vec<f64>, Failed> {
    (0..5).map(|joint| rig.joint_position(joint)).collect()
}
