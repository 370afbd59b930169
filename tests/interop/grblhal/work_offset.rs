//! `trued compensate` sets a work offset of grblHAL. The firmware itself reports what it holds, over another connection.

use std::collections::BTreeMap;
use std::time::Duration;

use libtest_mimic::Failed;

use serde_json::{Value, json};
use trued::store::CompensationState;

use super::rig::GrblHalRig;
use crate::linuxcnc::run_workspace::RunWorkspace;
use crate::support::daemon_process::DaemonProcess;
use crate::support::http::{HttpClient, JSON_HEADER};
use crate::work_offset_trial::{WorkOffsetTrial, refusal};

const SLOT_SECTION: &str = "\n[compensation.work-offset]\nslot = \"G55\"\n";
const SERVE_SECTION: &str = "\n[serve]\nmin_interval_s = 0.0\n[[serve.cycle]]\nnumber = 1\nmethod = \"self-calibration\"\n\
    [serve.http]\nlisten = \"127.0.0.1:0\"\ntokens = true\n";
const RUN_PATH: &str = "/api/v1/runs/1/compensation";
const MACHINE_PATH: &str = "/api/v1/machines/grblhal-sim5/compensation";
/// Zero of G55 before, mm and degrees. C is at (-149.95, -100.03).
const BEFORE: &str = "[G55:-149.900,-100.010,-3.000,0.000,2.000]";
/// Point on the stated axis C.
const AXIS_C_POINT_MM: [f64; 3] = [-150.0, -100.0, -360.0];
const CORRECTED: &str = "[G55:-149.950,-100.030,-3.000,0.000,2.000]";

/// The line of `$#` for G55. The firmware may first send the rest of its answers to a killed client.
fn reported_offset(rig: &GrblHalRig) -> Result<String, Failed> {
    for _ in 0..5 {
        let answer = rig.query("$#")?;
        if let Some(line) = answer.lines().find(|line| line.starts_with("[G55:")) {
            return Ok(line.to_owned());
        }
    }
    Err("no G55".into())
}

fn check_offset(rig: &GrblHalRig, expected: &str) -> Result<(), Failed> {
    let offset = reported_offset(rig)?;
    if offset == expected { Ok(()) } else { Err(format!("{offset} instead of {expected}").into()) }
}

/// The worker of the service has the link: it proposes the same, writes and restores.
fn check_page(rig: &GrblHalRig, workspace: &RunWorkspace, hash: &str) -> Result<(), Failed> {
    let token = workspace.run_stdout(&["token", "add", "Ada", "--role", "metrologist"])?;
    let machine = workspace.machine_file_path().display().to_string();
    let daemon = DaemonProcess::start(&mut workspace.trued_command_with_journal(&["serve", "--machine", &machine]));
    let headers = format!("{JSON_HEADER}Authorization: Bearer {}\r\n", token.trim());
    let request = |method: &str, path: &str, body: &Value, expected: u16| -> Result<String, Failed> {
        let body = if method == "GET" { String::new() } else { body.to_string() };
        let (status, text) = HttpClient::new(daemon.http_port()).request(method, path, &headers, &body);
        if status == expected { Ok(text) } else { Err(format!("{path}: {status} {text}").into()) }
    };
    let proposal: Value = serde_json::from_str(&request("GET", RUN_PATH, &Value::Null, 200)?)?;
    if proposal["sha256"] != hash {
        return Err(format!("the page proposes {proposal}").into());
    }
    let page = request("GET", "/runs/1/compensation", &Value::Null, 200)?;
    let is_shown = page.contains("G55 X") && page.contains("programs with G55 are not searched");
    request("POST", RUN_PATH, &json!({"who": "Ada", "approve": hash}), 201)?;
    check_offset(rig, CORRECTED)?;
    let status = request("GET", MACHINE_PATH, &Value::Null, 200)?;
    request("POST", &format!("{MACHINE_PATH}/undo"), &json!({"who": "Ada"}), 201)?;
    check_offset(rig, BEFORE)?;
    if is_shown && status.contains("-149.95") { Ok(()) } else { Err(format!("{page}\n{status}").into()) }
}

/// A write to another slot leaves the first one to be undone.
fn check_each_slot_is_undone(
    rig: &GrblHalRig,
    workspace: &RunWorkspace,
    trial: &WorkOffsetTrial<'_>,
) -> Result<(), Failed> {
    let path = workspace.machine_file_path();
    let with_g55 = std::fs::read_to_string(&path)?;
    let with_g56 = with_g55.replace("\"G55\"", "\"G56\"");
    rig.query("G10 L2 P3 X-149.8 Y-100.05 Z-3 B0 C2")?;
    for text in [&with_g55, &with_g56] {
        std::fs::write(&path, text)?;
        trial.write_stdout(&trial.proposal()?.0)?;
    }
    check_offset(rig, CORRECTED)?;
    std::fs::write(&path, &with_g55)?;
    trial.undo_stdout()?;
    check_offset(rig, BEFORE)?;
    refusal(&trial.undo()?, "nothing to undo")?;
    let corrected_g56 = CORRECTED.replace("G55", "G56");
    let offsets = rig.query("$#")?;
    if !offsets.contains(&corrected_g56) {
        return Err(offsets.into());
    }
    std::fs::write(&path, &with_g56)?;
    trial.undo_stdout()?;
    std::fs::write(&path, &with_g55)?;
    let offsets = rig.query("$#")?;
    if offsets.contains("[G56:-149.800,-100.050,-3.000,0.000,2.000]") { Ok(()) } else { Err(offsets.into()) }
}

fn start_with_slot() -> Result<(GrblHalRig, RunWorkspace), Failed> {
    let rig = GrblHalRig::start_homed(&[])?;
    rig.query("G10 L2 P2 X-149.9 Y-100.01 Z-3 B0 C2")?;
    check_offset(&rig, BEFORE)?;
    let workspace = rig.create_run_workspace(&[("[probe]", &format!("{SLOT_SECTION}{SERVE_SECTION}\n[probe]"))])?;
    rig.proxy.clear_record();
    Ok((rig, workspace))
}

/// Killed after each line of a write: the firmware has the offset before or the new one, and unless the journal states
/// which, no run starts until `undo` or `finish` ends the write.
pub fn program_killed_at_any_line_of_a_write_leaves_a_known_state() -> Result<(), Failed> {
    let (rig, workspace) = start_with_slot()?;
    let trial = WorkOffsetTrial::new(&workspace, AXIS_C_POINT_MM)?;
    let (hash, _) = trial.proposal()?;
    rig.proxy.clear_record();
    trial.write_stdout(&hash)?;
    let line_count = rig.proxy.sent_lines().len();
    trial.undo_stdout()?;
    let mut states = BTreeMap::new();
    for killed_at in 1..=line_count {
        rig.proxy.clear_record();
        let mut write = trial.write_command(&hash).spawn()?;
        while rig.proxy.sent_lines().len() < killed_at && write.try_wait()?.is_none() {
            std::thread::sleep(Duration::from_millis(1));
        }
        let _ = write.kill();
        write.wait()?;
        let offset = reported_offset(&rig)?;
        let state = trial.state()?;
        *states.entry(state.map_or("none", CompensationState::as_str)).or_insert(0) += 1;
        match state {
            None | Some(CompensationState::Undone) => check_offset(&rig, BEFORE)?,
            Some(CompensationState::Written) => check_offset(&rig, CORRECTED)?,
            Some(CompensationState::Writing) if [BEFORE, CORRECTED].contains(&offset.as_str()) => {
                refusal(&workspace.start_self_calibration()?.wait_with_output()?, "is unfinished")?;
                if killed_at % 2 == 0 {
                    trial.finish_stdout()?;
                    check_offset(&rig, CORRECTED)?;
                }
            }
            other => return Err(format!("line {killed_at}: {other:?}, {offset}").into()),
        }
        if trial.state()?.is_some_and(|state| !state.is_undone()) {
            trial.undo_stdout()?;
        }
        check_offset(&rig, BEFORE)?;
    }
    eprintln!("{line_count} lines, states after the kill: {states:?}");
    match states.contains_key("writing") {
        true => Ok(()),
        false => Err(format!("no kill within the write: {states:?}").into()),
    }
}

pub fn rotary_centre_is_written_and_restored() -> Result<(), Failed> {
    let (rig, workspace) = start_with_slot()?;
    let trial = WorkOffsetTrial::new(&workspace, AXIS_C_POINT_MM)?;
    for (line, undo, expected) in [
        ("G92 X1", "G92.1", "G92 is active"),
        ("G20", "G21", "in inches"),
        ("G10 L2 P2 B1", "G10 L2 P2 B0", "G55 has 1° of B"),
        ("$13=1", "$13=0", "in inches"),
        ("$C", "$C", "Check"),
    ] {
        rig.query(line)?;
        refusal(&trial.propose()?, expected)?;
        // grblHAL resets itself after the check mode.
        let _ = rig.query(undo);
    }
    // Incremental motion does not count for the write, and remains.
    rig.query("G91 G54")?;
    let (hash, text) = trial.proposal()?;
    if !text.contains("programs with G55 are not searched") || !text.contains("Z of B") {
        return Err(text.into());
    }
    refusal(&trial.write(&hash.replace(['0', '1'], "2"))?, "is not the present proposal")?;
    check_offset(&rig, BEFORE)?;
    let written = trial.write_stdout(&hash)?;
    check_offset(&rig, CORRECTED)?;
    if written.contains("have changed at once") {
        return Err(format!("G54 is selected: {written}").into());
    }
    rig.query("G55")?;
    let undone = trial.undo_stdout()?;
    if !undone.contains("uses G55 now: the coordinates that it displays have changed at once") {
        return Err(undone.into());
    }
    check_offset(&rig, BEFORE)?;
    rig.query("G54")?;
    check_each_slot_is_undone(&rig, &workspace, &trial)?;
    check_page(&rig, &workspace, &hash)?;
    let modes = rig.query("$G")?;
    if !["G91", "G54"].iter().all(|word| modes.contains(word)) {
        return Err(modes.into());
    }
    let motions = rig.proxy.sent_motions();
    if motions.is_empty() { Ok(()) } else { Err(format!("{motions:?}").into()) }
}
