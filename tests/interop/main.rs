//! Interoperability with third-party programs: LinuxCNC, grblHAL, pymodbus, prometheus_client, python3, the CAN of
//! a real kernel, Chromium. A trial whose program is missing is skipped, with the reason; with `TRUED_REQUIRE_PEERS=1` it fails.

#![allow(clippy::too_many_lines, reason = "a trial is one story, and lists of cases are long")]

mod grblhal;
mod linuxcnc;
mod page;
mod prometheus;
mod pymodbus;
mod sensors;
mod serve_modbus;
mod socketcan;
#[path = "../support/mod.rs"]
#[allow(dead_code, reason = "each test binary uses a part of it")]
mod support;
mod work_offset_trial;

use support::harness::{Trials, run_trials};

fn main() {
    let suites = [
        grblhal::trials(),
        linuxcnc::trials(),
        page::trials(),
        prometheus::trials(),
        pymodbus::trials(),
        sensors::trials(),
        serve_modbus::trials(),
        socketcan::trials(),
    ];
    run_trials(suites.into_iter().fold(Trials::default(), Trials::with_trials))
}
