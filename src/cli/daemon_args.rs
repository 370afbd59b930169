//! Arguments for the schedule and the tokens of the daemon.

use std::path::PathBuf;

use clap::{Args, Subcommand};

use crate::service::Role;

#[derive(Debug, Args)]
pub struct ScheduleArgs {
    /// Name of the machine; without it, all machines in the journal.
    pub name: Option<String>,
    /// Machine file, to show its next scheduled starts as well.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["name", "config"])]
    pub machine: Option<PathBuf>,
    /// Configuration file of the daemon, to show the next scheduled starts of its machines as well.
    #[arg(long, value_name = "FILE", conflicts_with = "name")]
    pub config: Option<PathBuf>,
    /// Print the schedules, armings and past starts as JSON.
    #[arg(long)]
    pub json: bool,
}

#[derive(Debug, Args)]
pub struct ArmArgs {
    /// Name of the machine.
    pub machine: String,
    /// Number of the cycle in [[serve.cycle]].
    pub cycle: u16,
    /// Your name. With it you confirm that the machine may move unattended.
    #[arg(long, value_name = "NAME")]
    pub who: String,
    /// End of the arming: a duration, such as 14d or 8h, or a time, such as 2027-01-31T18:00:00+01:00.
    #[arg(long, value_name = "WHEN")]
    pub until: String,
    /// Reason of the arming, as shown in the audit log.
    #[arg(long, value_name = "WORDS", default_value = "")]
    pub why: String,
}

#[derive(Debug, Args)]
pub struct DisarmArgs {
    /// Name of the machine.
    pub machine: String,
    /// Number of the cycle; without it, all cycles.
    pub cycle: Option<u16>,
    /// Your name.
    #[arg(long, value_name = "NAME")]
    pub who: String,
    /// Reason, as shown in the audit log.
    #[arg(long, value_name = "WORDS", default_value = "")]
    pub why: String,
}

#[derive(Debug, Args)]
pub struct TokenArgs {
    #[command(subcommand)]
    pub command: TokenCommand,
}

#[derive(Debug, Subcommand)]
pub enum TokenCommand {
    /// Create a token and print it; the token cannot be printed again later.
    Add {
        /// Name of the token's user, e.g. tablet-hall-2, as shown in the audit log.
        name: String,
        /// Role of the user: viewer (can read and hold), operator (can also start, confirm and resume runs),
        /// metrologist (can also sign runs, arm cycles and write values to the control).
        #[arg(long)]
        role: Role,
    },
    /// List the tokens; the secrets are not printed.
    List {
        /// Print the list as JSON.
        #[arg(long)]
        json: bool,
    },
    /// Revoke a token; requests with this token are refused from then on.
    Revoke {
        /// Name of the token's user; `trued token list` lists the names.
        name: String,
    },
}
