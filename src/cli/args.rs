//! Arguments of the command line.

use std::path::PathBuf;

use clap::{Args, Parser, Subcommand, ValueEnum};

use super::method_list::methods_help;
use super::result_args::{BackupArgs, CompareArgs, ExportArgs, PredictArgs, RunsArgs, ShowArgs};
use crate::service::Role;
use devices::controllers::linuxcnc;

/// Keeps five-axis machine tools true: the machine measures itself, with an uncertainty.
#[derive(Debug, Parser)]
#[command(name = "trued", version, about, color = clap::ColorChoice::Never)]
pub struct Cli {
    /// Directory of journal and locks [default: $STATE_DIRECTORY, then the user's state folder].
    #[arg(long, global = true, value_name = "DIR")]
    pub state: Option<PathBuf>,
    #[command(subcommand)]
    pub command: Command,
}

#[derive(Debug, Subcommand)]
pub enum Command {
    /// Measure, identify, judge and store.
    Run(RunArgs),
    /// Wait for triggers from the machine, as [serve] in the machine file allows; run and judge the cycles.
    Serve(ServeArgs),
    /// Check that the machine agrees with its machine file, part by part, with an operator at the machine. A
    /// simulated machine needs no operator.
    Check(CheckArgs),
    /// Resume a run that was stopped or interrupted, once a person has checked the machine; or identify a run
    /// that was measured to its end, without motion.
    Resume(ResumeArgs),
    /// Print what would be measured; nothing moves.
    Plan(PlanArgs),
    /// Turn readings into an estimate.
    Identify(IdentifyArgs),
    /// Write a commented machine file from the data that the control reports; nothing moves.
    Init(InitArgs),
    /// Show the samples of a sensor; nothing moves.
    Watch(WatchArgs),
    /// Serve the simulated machine on a pseudo-terminal, for any program to drive.
    Simulate(SimulateArgs),
    /// List the stored runs.
    Runs(RunsArgs),
    /// Show the values of a machine over its runs, and what changed.
    Trend(TrendArgs),
    /// Show the schedule of a machine, its armings and its last slots.
    Schedule(ScheduleArgs),
    /// Allow the schedule to start a cycle unattended, until a time.
    Arm(ArmArgs),
    /// Forbid the schedule to start anything on this machine until it is armed again.
    Disarm(DisarmArgs),
    /// Show one stored run.
    Show(ShowArgs),
    /// Compare the estimates of two stored runs: differences, their U, and E_n (ISO 13528).
    Compare(CompareArgs),
    /// Compute the position error of the tool at given poses from an estimate.
    Predict(PredictArgs),
    /// Write plan, readings, estimate and report of a stored run to files.
    Export(ExportArgs),
    /// Copy the journal to one file, also while a daemon writes it; the copy is verified.
    Backup(BackupArgs),
    /// Manage the tokens for access from other computers to the page and interface of `trued serve`.
    Token(TokenArgs),
}

#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, ValueEnum)]
pub enum Speed {
    /// The simulated machine needs the time of a real one.
    Real,
    /// Simulated time passes as fast as it can be computed.
    #[default]
    Fast,
}

#[derive(Debug, Args)]
#[command(after_help = methods_help())]
pub struct RunArgs {
    pub method: String,
    /// The machine file; without one, the embedded simulated machine measures itself.
    #[arg(long, value_name = "FILE")]
    pub machine: Option<PathBuf>,
    /// Estimates whose values are taken as known.
    #[arg(long = "with", value_name = "EST.json")]
    pub with: Vec<PathBuf>,
    /// Measure the whole cycle this many times.
    #[arg(long, value_name = "N")]
    pub repeat: Option<u32>,
    /// Your name, if a daemon has the machine and shall run one of its cycles: you have checked that the
    /// machine may move, that it is in automatic mode and that its guards are closed. On a terminal the command
    /// asks for the name. Enter confirms a prompt of the run under this name, otherwise under your login name.
    #[arg(long, value_name = "NAME")]
    pub acknowledge: Option<String>,
    /// Replay a capture: nothing is opened and nothing moves, the capture contains the answers of the devices.
    /// The replay is not kept in the journal.
    #[arg(long, value_name = "FILE", conflicts_with = "capture")]
    pub replay: Option<PathBuf>,
    #[command(flatten)]
    pub output: OutputArgs,
}

/// Output of a measurement, and the pace of the simulation.
#[derive(Debug, Args)]
pub struct OutputArgs {
    /// Print the estimate as JSON.
    #[arg(long)]
    pub json: bool,
    /// Write the report to this file.
    #[arg(long, value_name = "FILE.html")]
    pub report: Option<PathBuf>,
    /// Write every byte of every link to this file, with its time.
    #[arg(long, value_name = "FILE")]
    pub capture: Option<PathBuf>,
    /// Pace of the simulated machine, by default fast; a real machine has its own.
    #[arg(long, value_enum)]
    pub speed: Option<Speed>,
}

#[derive(Debug, Args)]
pub struct CheckArgs {
    /// The machine file; without one, the embedded simulated machine is checked.
    #[arg(long, value_name = "FILE")]
    pub machine: Option<PathBuf>,
    /// Print the summary as JSON.
    #[arg(long)]
    pub json: bool,
    /// Pace of the simulated machine; a real machine has its own.
    #[arg(long, value_enum, default_value = "fast")]
    pub speed: Speed,
}

#[derive(Debug, Args)]
pub struct ServeArgs {
    /// File of the daemon: its machines and its page.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Machine file of a single machine, with a section [serve]. Without this and --config the simulated
    /// machine is served, with its page at 127.0.0.1:8137.
    #[arg(long, value_name = "FILE", conflicts_with = "config")]
    pub machine: Option<PathBuf>,
    /// Read every file, rehearse every cycle, then exit: nothing is opened.
    #[arg(long)]
    pub check: bool,
    #[arg(long, value_enum, default_value = "fast")]
    pub speed: Speed,
    /// Write every byte of each run's links to a file of its own: FILE, with the run's number before the file
    /// extension.
    #[arg(long, value_name = "FILE")]
    pub capture: Option<PathBuf>,
}

#[derive(Debug, Args)]
pub struct ResumeArgs {
    /// Number of the run, as `trued runs` lists it.
    pub run: i64,
    /// Your name: you have checked the machine, its path is free and the stylus undamaged. On a terminal the
    /// command asks for the name.
    #[arg(long, value_name = "NAME")]
    pub acknowledge: Option<String>,
    /// All axes were homed since the stop; required if the control may have lost its position.
    #[arg(long, requires = "acknowledge")]
    pub homed: bool,
    /// The machine file with which the run began, for comparison; without it, the stored one is used.
    #[arg(long, value_name = "FILE")]
    pub machine: Option<PathBuf>,
    #[command(flatten)]
    pub output: OutputArgs,
}

#[derive(Debug, Args)]
#[command(after_help = methods_help())]
pub struct PlanArgs {
    pub method: String,
    #[arg(long, value_name = "FILE")]
    pub machine: Option<PathBuf>,
    /// Print the plan as JSON.
    #[arg(long, conflicts_with = "gcode")]
    pub json: bool,
    /// Print the program in this dialect.
    #[arg(long, value_name = "DIALECT")]
    pub gcode: Option<String>,
}

#[derive(Debug, Args)]
pub struct IdentifyArgs {
    pub method: String,
    #[arg(long, value_name = "FILE.csv", required_unless_present = "run")]
    pub readings: Option<PathBuf>,
    /// Identify a stored run again from its own plan and readings. The new estimate is added to the run, the
    /// old ones stay.
    #[arg(long, value_name = "RUN", conflicts_with_all = ["readings", "plan"])]
    pub run: Option<i64>,
    /// The plan that was measured; without it, the plan of the machine file.
    #[arg(long, value_name = "FILE.json")]
    pub plan: Option<PathBuf>,
    #[arg(long, value_name = "FILE")]
    pub machine: Option<PathBuf>,
    /// Estimates whose values are taken as known, instead of those with which the run began.
    #[arg(long = "with", value_name = "EST.json")]
    pub with: Vec<PathBuf>,
    #[arg(long)]
    pub json: bool,
}

#[derive(Debug, Args)]
#[command(group = clap::ArgGroup::new("link").required(true).args(["serial", "serial_id", "tcp"]))]
pub struct InitArgs {
    /// grbl, linuxcnc or modbus
    #[arg(long)]
    pub kind: String,
    #[arg(long, value_name = "/dev/...")]
    pub serial: Option<String>,
    /// Name of a port in /dev/serial/by-id, or a part of the name.
    #[arg(long, value_name = "NAME")]
    pub serial_id: Option<String>,
    #[arg(long, value_name = "N", conflicts_with = "tcp")]
    pub baud: Option<u32>,
    /// none, even or odd (Modbus)
    #[arg(long, conflicts_with = "tcp")]
    pub parity: Option<String>,
    #[arg(long, value_name = "HOST:PORT")]
    pub tcp: Option<String>,
    /// Number of the device (Modbus).
    #[arg(long, value_name = "N")]
    pub unit: Option<u8>,
    /// Folder that both this program and the control can access (LinuxCNC, which needs it).
    #[arg(long, value_name = "DIR", required_if_eq("kind", linuxcnc::KIND))]
    pub program_dir: Option<PathBuf>,
    /// INI file with which the control was started (LinuxCNC).
    #[arg(long, value_name = "FILE")]
    pub ini: Option<PathBuf>,
    /// Dialect of the control, if it is not the usual one of its kind.
    #[arg(long)]
    pub dialect: Option<String>,
    /// Kinematic chain, e.g. V[w-C-B-b-Y-X-Z-(C)-t]; without it, the usual one for the axes.
    #[arg(long)]
    pub topology: Option<String>,
    #[arg(long)]
    pub name: Option<String>,
    /// If nothing answers, try other baud rates, device numbers and protocols. Another device may misinterpret
    /// these requests: make sure that nothing can move.
    #[arg(long)]
    pub search: bool,
    /// Output file, which must not exist; without it, standard output.
    #[arg(long, value_name = "FILE")]
    pub to: Option<PathBuf>,
}

#[derive(Debug, Args)]
pub struct WatchArgs {
    /// Name of the sensor in the machine file.
    pub sensor: String,
    /// The machine file, with a [[sensor]] of this name.
    #[arg(long, value_name = "FILE")]
    pub machine: PathBuf,
    /// Exit after this number of samples; a missing signal does not count.
    #[arg(long, value_name = "N")]
    pub samples: Option<u64>,
    /// Print each sample as a line of JSON.
    #[arg(long)]
    pub json: bool,
}

#[derive(Debug, Args)]
pub struct SimulateArgs {
    /// Method whose built-in machine is served if there is no machine file.
    #[arg(default_value = "self-calibration")]
    pub method: String,
    #[arg(long, value_name = "FILE")]
    pub machine: Option<PathBuf>,
    /// Insert a faulty wire, which delays, drops, doubles, flips, splits, stalls and cuts according to the
    /// seed, and report its faults.
    #[arg(long, value_name = "SEED")]
    pub faults: Option<u64>,
    #[arg(long, value_enum, default_value = "fast")]
    pub speed: Speed,
}

#[derive(Debug, Args)]
pub struct TrendArgs {
    /// Name of the machine; without it, the machine of the last run.
    pub machine: Option<String>,
    /// Number of days for which changes are shown.
    #[arg(long, value_name = "DAYS", default_value_t = 7)]
    pub days: u32,
    #[arg(long)]
    pub json: bool,
}

#[derive(Debug, Args)]
pub struct ScheduleArgs {
    /// Name of the machine; without it, all machines in the journal.
    pub name: Option<String>,
    /// Machine file, to show the next slots.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["name", "config"])]
    pub machine: Option<PathBuf>,
    /// File of the daemon, to show the next slots.
    #[arg(long, value_name = "FILE", conflicts_with = "name")]
    pub config: Option<PathBuf>,
    #[arg(long)]
    pub json: bool,
}

#[derive(Debug, Args)]
pub struct ArmArgs {
    /// Name of the machine.
    pub machine: String,
    /// Number of the cycle, as in [[serve.cycle]].
    pub cycle: u16,
    /// Your name: you have made sure that the machine may move unattended.
    #[arg(long, value_name = "NAME")]
    pub who: String,
    /// A duration, such as 14d or 8h, or an instant, such as 2027-01-31T18:00:00+01:00.
    #[arg(long, value_name = "WHEN")]
    pub until: String,
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
    #[arg(long, value_name = "WORDS", default_value = "")]
    pub why: String,
}

#[derive(Debug, Args)]
pub struct TokenArgs {
    #[command(subcommand)]
    pub what: TokenCommand,
}

#[derive(Debug, Subcommand)]
pub enum TokenCommand {
    /// Create a token and print it; it cannot be shown again.
    Add {
        /// Name of the token's user, e.g. tablet-hall-2, as shown in the audit log.
        name: String,
        /// viewer (reads, and may hold), operator (also starts, acknowledges and resumes), metrologist (also
        /// signs and arms).
        #[arg(long)]
        role: Role,
    },
    /// List the tokens without their secrets.
    List {
        #[arg(long)]
        json: bool,
    },
    /// Revoke a token: it gives no access any more.
    Revoke { name: String },
}
