//! The bytes on each wire to a simulated control, and to a simulated sensor.

use super::compare::check_json;
use super::machines::{CASES, LASER, SELF_CALIBRATION, with_method};
use super::runs::RunOutput;
use super::workspace::{Workspace, with_replaced_lines};

/// A short measurement over the wire.
fn check_control(name: &str, keys: &str) {
    let machine = with_replaced_lines(SELF_CALIBRATION, &[("wire = \"memory\"\n", keys)]);
    RunOutput::run_method("latch-delay", &with_method(&machine, "latch-delay", "touches = 6\n"))
        .compare_with_stored("wires", name);
}

pub fn grbl_in_memory() {
    check_control("grbl-memory", "wire = \"memory\"\n");
}

pub fn grbl_on_pty() {
    check_control("grbl-pty", "wire = \"pty\"\n");
}

pub fn line_window_on_tcp() {
    check_control("line-window-tcp", "speaks = \"modbus\"\nwire = \"tcp\"\n");
}

pub fn line_window_on_pty() {
    check_control("line-window-pty", "speaks = \"modbus\"\nwire = \"pty\"\n");
}

pub fn resident_program_on_tcp() {
    check_control("resident-program-tcp", "speaks = \"modbus-program\"\nwire = \"tcp\"\n");
}

pub fn resident_program_on_pty() {
    check_control("resident-program-pty", "speaks = \"modbus-program\"\nwire = \"pty\"\n");
}

/// Sensors that send without requests over a pseudo-terminal or a bus measure in wall time, so that no two runs are
/// identical. They are left out.
fn check_sensor(name: &str, keys: &str) {
    let from = "speaks = \"can\"\nwire = \"memory\"\n";
    let machine = with_replaced_lines(LASER, &[(from, keys)]);
    let case = &CASES[1];
    RunOutput::run_method(case.method, &with_method(&machine, case.method, case.short_settings))
        .compare_with_stored("wires", name);
}

pub fn serial_sensor_in_memory() {
    check_sensor("sensor-serial-memory", "speaks = \"serial\"\nwire = \"memory\"\n");
}

pub fn frame_sensor_in_memory() {
    check_sensor("sensor-serial-frames-memory", "speaks = \"serial-frames\"\nwire = \"memory\"\n");
}

pub fn modbus_sensor_on_tcp() {
    check_sensor("sensor-modbus-tcp", "speaks = \"modbus\"\nwire = \"tcp\"\n");
}

/// A run of the real LinuxCNC 2.9: every request and file of the driver is compared with the capture, and the
/// replies come from the capture.
pub fn replay_of_linuxcnc() {
    let machine = include_str!("../data/linuxcnc/machine.toml");
    let workspace = Workspace::with_machine(&format!("{machine}monte_carlo_trials = 1000\n"));
    let capture = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/linuxcnc/self-calibration.capture");
    let machine = workspace.path("machine.toml");
    let arguments = ["run", "self-calibration", "--machine", &machine, "--replay", capture, "--json"];
    check_json("replays/linuxcnc-self-calibration.json", &workspace.json(&arguments));
}
