//! Compares short runs, with the bytes on the wire, over each wire to a simulated control or sensor.

use super::compare::check_json_against_baseline;
use super::method_cases::{LASER_MACHINE_FILE, METHOD_CASES, SIMULATED_MACHINE_FILE, append_method_settings};
use super::runs::RunOutput;
use super::workspace::{Workspace, replace_line_starts};

/// Compares a run of `latch-delay` on a simulated control with the stored one; `wire_keys`: its protocol and its kind
/// of wire (memory, pty or tcp).
fn check_run_over_control_wire(name: &str, wire_keys: &str) {
    let machine = replace_line_starts(SIMULATED_MACHINE_FILE, &[("wire = \"memory\"\n", wire_keys)]);
    RunOutput::run_method("latch-delay", &append_method_settings(&machine, "latch-delay", "touches = 6\n"))
        .check_estimate_readings_and_capture("wires", name);
}

pub fn run_over_grbl_in_memory_is_as_stored() {
    check_run_over_control_wire("grbl-memory", "wire = \"memory\"\n");
}

pub fn run_over_grbl_on_pty_is_as_stored() {
    check_run_over_control_wire("grbl-pty", "wire = \"pty\"\n");
}

pub fn run_over_line_window_on_tcp_is_as_stored() {
    check_run_over_control_wire("line-window-tcp", "speaks = \"modbus\"\nwire = \"tcp\"\n");
}

pub fn run_over_line_window_on_pty_is_as_stored() {
    check_run_over_control_wire("line-window-pty", "speaks = \"modbus\"\nwire = \"pty\"\n");
}

pub fn run_over_resident_program_on_tcp_is_as_stored() {
    check_run_over_control_wire("resident-program-tcp", "speaks = \"modbus-program\"\nwire = \"tcp\"\n");
}

pub fn run_over_resident_program_on_pty_is_as_stored() {
    check_run_over_control_wire("resident-program-pty", "speaks = \"modbus-program\"\nwire = \"pty\"\n");
}

/// Sensors that send without requests over a pseudo-terminal or a bus measure in wall time, so that no two runs are
/// identical. They are left out.
fn check_run_with_sensor_wire(name: &str, wire_keys: &str) {
    let from = "speaks = \"can\"\nwire = \"memory\"\n";
    let machine = replace_line_starts(LASER_MACHINE_FILE, &[(from, wire_keys)]);
    let case = &METHOD_CASES[1];
    RunOutput::run_method(case.method, &append_method_settings(&machine, case.method, case.short_run_settings))
        .check_estimate_readings_and_capture("wires", name);
}

pub fn run_with_serial_sensor_in_memory_is_as_stored() {
    check_run_with_sensor_wire("sensor-serial-memory", "speaks = \"serial\"\nwire = \"memory\"\n");
}

pub fn run_with_frame_sensor_in_memory_is_as_stored() {
    check_run_with_sensor_wire("sensor-serial-frames-memory", "speaks = \"serial-frames\"\nwire = \"memory\"\n");
}

pub fn run_with_modbus_sensor_on_tcp_is_as_stored() {
    check_run_with_sensor_wire("sensor-modbus-tcp", "speaks = \"modbus\"\nwire = \"tcp\"\n");
}

/// A run of the real LinuxCNC 2.9: every request and file of the driver is compared with the capture, and the
/// replies come from the capture.
pub fn linuxcnc_capture_replays_to_the_stored_estimate() {
    let machine = include_str!("../data/linuxcnc/machine.toml");
    let workspace = Workspace::with_machine_file(&format!("{machine}monte_carlo_trials = 1000\n"));
    let capture = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/linuxcnc/self-calibration.capture");
    let machine = workspace.file_path("machine.toml");
    let arguments = ["run", "self-calibration", "--machine", &machine, "--replay", capture, "--json"];
    check_json_against_baseline("replays/linuxcnc-self-calibration.json", &workspace.run_json(&arguments));
}
