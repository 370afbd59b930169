//! Modules that the test binaries share.

pub mod daemon_process;
pub mod grbl_control;
pub mod harness;
pub mod http;
pub mod journal_checksums;
pub mod machine_shop;
pub mod plan_player;
pub mod pymodbus;
pub mod recording_control;
pub mod stored_run;
pub mod terminal_operator;
