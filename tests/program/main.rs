//! Tests that run the program as a child process, or wait for simulated devices most of the time. Each trial is
//! named by its path: `cargo test --test program serve::` runs one suite.

#![allow(clippy::too_many_lines, reason = "a trial is one story, and lists of cases are long")]

mod artefact_register;
mod check_command;
mod cli_bad_input;
mod cli_run;
mod combine_command;
mod command_line;
mod compensation;
mod contract_files;
mod daemon;
mod durability;
mod encoder_turns;
mod fault_schedules;
mod halt_latency;
mod identification;
mod init_command;
mod laser_runs;
mod latch_delay;
mod machine_zero;
mod modbus_run;
mod plan_contract_player;
mod predict_command;
mod residual_figures;
mod result_texts;
mod samba_machines;
mod schedule;
mod sent_text;
mod serve;
mod store_kill;
mod studies;
#[path = "../support/mod.rs"]
#[allow(dead_code, reason = "each test binary uses a part of it")]
mod support;
mod table_axis;

use support::harness::{Trials, run_trials};

fn main() {
    if let Some((port, token)) = serve::crowd::crowd_port_and_token() {
        return serve::crowd::run_client_crowd(port, &token);
    }
    if let Some((port, from)) = serve::crowd::connecting_process_port_and_source() {
        return serve::crowd::open_idle_connections_until_killed(port, from);
    }
    if store_kill::is_writer_child() {
        return store_kill::write_readings_until_killed();
    }
    let suites = [
        artefact_register::trials(),
        check_command::trials(),
        cli_bad_input::trials(),
        cli_run::trials(),
        combine_command::trials(),
        command_line::trials(),
        compensation::trials(),
        contract_files::trials(),
        plan_contract_player::trials(),
        daemon::trials(),
        durability::trials(),
        encoder_turns::trials(),
        fault_schedules::trials(),
        halt_latency::trials(),
        identification::trials(),
        init_command::trials(),
        laser_runs::trials(),
        latch_delay::trials(),
        machine_zero::trials(),
        modbus_run::trials(),
        predict_command::trials(),
        residual_figures::trials(),
        result_texts::trials(),
        samba_machines::trials(),
        schedule::trials(),
        sent_text::trials(),
        serve::trials(),
        store_kill::trials(),
        studies::trials(),
        table_axis::trials(),
    ];
    run_trials(suites.into_iter().fold(Trials::default(), Trials::with_trials))
}
