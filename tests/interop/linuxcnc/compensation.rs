//! The values that `trued compensate` writes to LinuxCNC's kinematics, verified with these kinematics: tool centre point
//! control moves the tool, and the true axes show where it is on the table.

use libtest_mimic::Failed;
use nalgebra::Vector3;
use serde_json::Value;

use super::rig::{LinuxCncRig, halcmd};
use super::run_workspace::RunWorkspace;
use super::samba::{TrueAxes, point_on_table};

/// Names of the pins for a table that tilts on A, or on B.
fn pin_names(tilts_on_a: bool) -> [String; 5] {
    let (module, offset) = if tilts_on_a { ("xyzac-trt-kins", "y-offset") } else { ("xyzbc-trt-kins", "x-offset") };
    ["x-rot-point", "y-rot-point", "z-rot-point", offset, "z-offset"].map(|pin| format!("{module}.{pin}"))
}

/// Positions of the tool in the workpiece, mm, and the tilting axis and C, degrees. The run measured the tilting axis from
/// −30° to 30°.
const POSES: [([f64; 3], [f64; 2]); 20] = [
    ([60.0, 40.0, 110.0], [0.0, 0.0]),
    ([60.0, 40.0, 110.0], [30.0, 0.0]),
    ([60.0, 40.0, 110.0], [-30.0, 0.0]),
    ([60.0, 40.0, 110.0], [0.0, 90.0]),
    ([60.0, 40.0, 110.0], [0.0, 180.0]),
    ([60.0, 40.0, 110.0], [0.0, -90.0]),
    ([-70.0, 20.0, 90.0], [20.0, 45.0]),
    ([-70.0, 20.0, 90.0], [-20.0, 135.0]),
    ([10.0, -70.0, 120.0], [25.0, 225.0]),
    ([10.0, -70.0, 120.0], [-25.0, 315.0]),
    ([0.0, 0.0, 100.0], [30.0, 180.0]),
    ([0.0, 0.0, 100.0], [-30.0, 180.0]),
    ([50.0, -50.0, 95.0], [60.0, 0.0]),
    ([50.0, -50.0, 95.0], [-60.0, 0.0]),
    ([50.0, -50.0, 95.0], [60.0, 90.0]),
    ([50.0, -50.0, 95.0], [-60.0, 90.0]),
    ([-40.0, 60.0, 105.0], [60.0, 180.0]),
    ([-40.0, 60.0, 105.0], [-60.0, 180.0]),
    ([-40.0, 60.0, 105.0], [60.0, 270.0]),
    ([-40.0, 60.0, 105.0], [-60.0, 270.0]),
];
const MEASURED_POSE_COUNT: usize = 12;

/// Errors of the tool relative to its error at the first pose.
#[derive(Debug, Clone, Copy)]
pub struct ToolErrors {
    /// Over the poses within the measured ranges.
    largest_in_measured_ranges_um: f64,
    pub largest_um: f64,
}

/// Proposes, approves, writes and verifies; then restores the values before. Returns the errors after the write.
pub fn check_correction_by_run(
    rig: &LinuxCncRig,
    workspace: &RunWorkspace,
    truth: &TrueAxes,
) -> Result<ToolErrors, Failed> {
    let machine = workspace.machine_file_path().display().to_string();
    let compensate =
        |arguments: &[&str]| workspace.run_stdout(&[&["compensate"], arguments, &["--machine", &machine]].concat());
    let pins = pin_names(truth.tilts_on_a);
    let before = pin_values(&pins)?;
    let proposal: Value = serde_json::from_str(&compensate(&["propose", "1", "--json"])?)?;
    let text = compensate(&["propose", "1"])?;
    eprintln!("{text}");
    let hash = text.lines().find_map(|line| line.strip_prefix("SHA-256 of the proposal: ")).ok_or("no hash")?;
    let before_write = tool_errors(rig, truth)?;
    if compensate(&["write", "1", "--approve", &hash.replace(['0', '1'], "2"), "--who", "Ada"]).is_ok() {
        return Err("another hash was accepted".into());
    }
    rig.set_tool_centre_point_mode(true)?;
    if compensate(&["write", "1", "--approve", hash, "--who", "Ada"]).is_ok() || pin_values(&pins)? != before {
        return Err("values were written while the kinematics applied them".into());
    }
    rig.set_tool_centre_point_mode(false)?;
    compensate(&["write", "1", "--approve", hash, "--who", "Ada"])?;
    check_pins(&pins, &proposal)?;
    let after_write = tool_errors(rig, truth)?;
    eprintln!("before: {before_write:.2?}, after: {after_write:.2?}");
    let predicted = &proposal["predicted"][1];
    let [largest_um, expanded_um] =
        ["largest_um", "U_largest_um"].map(|key| predicted[key].as_f64().unwrap_or_default());
    let is_as_predicted = after_write.largest_in_measured_ranges_um <= largest_um + expanded_um;
    if before_write.largest_in_measured_ranges_um < 100.0 || !is_as_predicted {
        return Err(format!("{largest_um} um was predicted, U = {expanded_um} um").into());
    }
    compensate(&["undo", "--who", "Ada"])?;
    if pin_values(&pins)? == before { Ok(after_write) } else { Err("the values are not as before".into()) }
}

/// Writes what `run` proposes for the compensation files.
pub fn write_by_run(workspace: &RunWorkspace, run: u32) -> Result<(), Failed> {
    let (machine, run) = (workspace.machine_file_path().display().to_string(), run.to_string());
    let text = workspace.run_stdout(&["compensate", "propose", &run, "--machine", &machine])?;
    eprintln!("{text}");
    let hash = text.lines().find_map(|line| line.strip_prefix("SHA-256 of the proposal: ")).ok_or("no hash")?;
    let write = ["compensate", "write", &run, "--approve", hash, "--who", "Ada", "--machine", &machine];
    workspace.run_stdout(&write).map(drop)
}

/// Verifies by `run`. If it confirms the values, the tool is right at all positions within 3 um.
pub fn check_verification(workspace: &RunWorkspace, run: u32, is_confirmed: bool) -> Result<(), Failed> {
    let (machine, run) = (workspace.machine_file_path().display().to_string(), run.to_string());
    let verify = |more: &[&str]| {
        let arguments = ["compensate", "verify", &run, "--who", "Ada", "--machine", &machine];
        workspace.trued_command_with_journal(&[&arguments, more].concat()).output()
    };
    eprintln!("{}", String::from_utf8_lossy(&verify(&[])?.stdout));
    let output = verify(&["--json"])?;
    if output.status.code() != Some(if is_confirmed { 0 } else { 3 }) {
        return Err(format!("{:?}: {}", output.status, String::from_utf8_lossy(&output.stderr)).into());
    }
    let result: Value = serde_json::from_slice(&output.stdout)?;
    let tool_centres = result["tool_centres"].as_array().ok_or("no tool centres")?;
    let length_um = |own: &Value| -> f64 {
        let components = own["measured_mm"].as_array().into_iter().flatten();
        1e3 * components.filter_map(Value::as_f64).map(|mm| mm * mm).sum::<f64>().sqrt()
    };
    let largest_um = tool_centres.iter().map(length_um).fold(0.0, f64::max);
    match tool_centres.len() >= 5 && (largest_um < 3.0) == is_confirmed {
        true => Ok(()),
        false => Err(format!("{} tool centres, error {largest_um} um", tool_centres.len()).into()),
    }
}

pub fn undo(workspace: &RunWorkspace) -> Result<(), Failed> {
    let machine = workspace.machine_file_path().display().to_string();
    workspace.run_stdout(&["compensate", "undo", "--who", "Ada", "--machine", &machine]).map(drop)
}

/// Confirms the restart: near zero LinuxCNC does not show which file it uses, near the end of the travel it does.
pub fn finish_after_restart(rig: &LinuxCncRig, workspace: &RunWorkspace) -> Result<(), Failed> {
    let machine = workspace.machine_file_path().display().to_string();
    let finish = || workspace.run_stdout(&["compensate", "finish", "--who", "Ada", "--machine", &machine]);
    if finish().is_ok() {
        return Err("X = 0 does not show the correction".into());
    }
    let mut person = rig.connect_client()?;
    person.run_mdi("G53 G0 X250")?;
    rig.wait_for_rest()?;
    finish()?;
    person.run_mdi("G53 G0 X0")?;
    rig.wait_for_rest().map(drop)
}

fn pin_values(pins: &[String]) -> Result<Vec<f64>, Failed> {
    pins.iter().map(|pin| Ok(halcmd(&["getp", pin])?.parse()?)).collect()
}

fn check_pins(pins: &[String], proposal: &Value) -> Result<(), Failed> {
    for ((pin, actual), value) in
        pins.iter().zip(pin_values(pins)?).zip(proposal["values"].as_array().ok_or("no values")?)
    {
        let proposed = value["proposed_mm"].as_f64().ok_or("no value")?;
        if value["name"] != *pin || (actual - proposed).abs() > 1e-6 {
            return Err(format!("{pin} is {actual}: {value}").into());
        }
    }
    Ok(())
}

/// Moves the tool to the poses by tool centre point control.
fn tool_errors(rig: &LinuxCncRig, truth: &TrueAxes) -> Result<ToolErrors, Failed> {
    rig.set_tool_centre_point_mode(true)?;
    let mut person = rig.connect_client()?;
    let tilt = if truth.tilts_on_a { 'A' } else { 'B' };
    let mut errors = Vec::new();
    for ([x, y, z], [b, c]) in POSES {
        person.run_mdi(&format!("G53 G0 X{x} Y{y} Z{z} {tilt}{b} C{c}"))?;
        let joints = rig.wait_for_rest()?;
        let [joint_x, joint_y, joint_z, joint_b, joint_c] = joints[..] else { return Err("five joints".into()) };
        if (joint_b - b).abs() > 1e-6 || (joint_c - c).abs() > 1e-6 {
            return Err(format!("B {joint_b} C {joint_c} instead of B {b} C {c}").into());
        }
        let tool = Vector3::new(joint_x, joint_y, joint_z);
        let on_table = point_on_table(truth, tool, joint_b.to_radians(), joint_c.to_radians());
        errors.push((on_table - Vector3::new(x, y, z)) * 1e3);
    }
    person.run_mdi(&format!("G53 G0 X0 Y0 Z200 {tilt}0 C0"))?;
    rig.wait_for_rest()?;
    rig.set_tool_centre_point_mode(false)?;
    let largest = |count: usize| errors.iter().take(count).map(|error| (error - errors[0]).norm()).fold(0.0, f64::max);
    Ok(ToolErrors { largest_in_measured_ranges_um: largest(MEASURED_POSE_COUNT), largest_um: largest(POSES.len()) })
}
