//! What can be typed.

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
    /// Where journal and locks are kept [default: $STATE_DIRECTORY, then the user's state folder].
    #[arg(long, global = true, value_name = "DIR")]
    pub state: Option<PathBuf>,
    #[command(subcommand)]
    pub command: Command,
}

#[derive(Debug, Subcommand)]
pub enum Command {
    /// Measure, identify, judge and store.
    Run(RunArgs),
    /// Wait for triggers from the machine, as [serve] in the machine file allows; run, judge, wait.
    Serve(ServeArgs),
    /// Does the machine do what its file says? Part by part, with a person beside it; the simulated
    /// machine without one.
    Check(CheckArgs),
    /// Go on with a run that was stopped or interrupted, once a person has looked at the machine; or identify
    /// one that was measured to its end, without motion.
    Resume(ResumeArgs),
    /// Print what would be measured; nothing moves.
    Plan(PlanArgs),
    /// Turn readings into an estimate.
    Identify(IdentifyArgs),
    /// Write a commented machine file from what the control says of itself; nothing moves.
    Init(InitArgs),
    /// Show what a sensor says, sample by sample; nothing moves.
    Watch(WatchArgs),
    /// Serve the simulated machine on a pseudo-terminal, for any program to drive.
    Simulate(SimulateArgs),
    /// List the stored runs.
    Runs(RunsArgs),
    /// Tell how a machine's values went over its runs, and what changed.
    Trend(TrendArgs),
    /// Tell what a machine's schedule does when, who armed it, and what became of the last times.
    Schedule(ScheduleArgs),
    /// Let a cycle start by the schedule while nobody is there, until a time.
    Arm(ArmArgs),
    /// Nothing of this machine starts by the schedule any more, until it is armed again.
    Disarm(DisarmArgs),
    /// Show one stored run.
    Show(ShowArgs),
    /// Compare the estimates of two stored runs: differences, their U, and E_n (ISO 13528).
    Compare(CompareArgs),
    /// Tell how far the tool is off at given poses, by the errors of an estimate.
    Predict(PredictArgs),
    /// Write plan, readings, estimate and report of a stored run to files.
    Export(ExportArgs),
    /// Copy the journal to one file, also while a daemon writes it; the copy is verified.
    Backup(BackupArgs),
    /// Tokens, with which the page of `trued serve` and its interface are reached from elsewhere.
    Token(TokenArgs),
}

#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, ValueEnum)]
pub enum Speed {
    /// The simulated machine takes the time that a real one would.
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
    /// Estimates that are taken as known.
    #[arg(long = "with", value_name = "EST.json")]
    pub with: Vec<PathBuf>,
    /// Measure the whole cycle this many times.
    #[arg(long, value_name = "N")]
    pub repeat: Option<u32>,
    /// Your name, where a daemon has the machine and is asked for one of its cycles: you have looked at it, it
    /// is free to be moved, in its automatic mode, its guards are closed. On a terminal you are asked for it.
    /// By this name Enter answers what the run asks a person; otherwise by that of your login.
    #[arg(long, value_name = "NAME")]
    pub acknowledge: Option<String>,
    /// Nothing is opened and nothing moves: a capture answers as the devices did then. It is not
    /// kept in the journal.
    #[arg(long, value_name = "FILE", conflicts_with = "capture")]
    pub replay: Option<PathBuf>,
    #[command(flatten)]
    pub output: OutputArgs,
}

/// What comes out of a measurement, and how fast.
#[derive(Debug, Args)]
pub struct OutputArgs {
    /// Print the estimate as JSON.
    #[arg(long)]
    pub json: bool,
    /// Write the report here.
    #[arg(long, value_name = "FILE.html")]
    pub report: Option<PathBuf>,
    /// Write every byte of every link here, with its time.
    #[arg(long, value_name = "FILE")]
    pub capture: Option<PathBuf>,
    /// Pace of the simulated machine, fast unless told; a real one has its own.
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
    /// Pace of the simulated machine; a real one has its own.
    #[arg(long, value_enum, default_value = "fast")]
    pub speed: Speed,
}

#[derive(Debug, Args)]
pub struct ServeArgs {
    /// What the daemon serves: its machines and its page.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// One machine alone: its file, with a section [serve]. Without either, the simulated machine is served,
    /// with its page at 127.0.0.1:8137.
    #[arg(long, value_name = "FILE", conflicts_with = "config")]
    pub machine: Option<PathBuf>,
    /// Read every file and rehearse every cycle, then end: nothing is opened.
    #[arg(long)]
    pub check: bool,
    #[arg(long, value_enum, default_value = "fast")]
    pub speed: Speed,
    /// Keep every byte of each run's links in a file of its own: FILE, with the run's number before its
    /// ending.
    #[arg(long, value_name = "FILE")]
    pub capture: Option<PathBuf>,
}

#[derive(Debug, Args)]
pub struct ResumeArgs {
    /// Number of the run, as `trued runs` lists it.
    pub run: i64,
    /// Your name: you have looked at the machine, its way is free and the stylus whole. On a
    /// terminal you are asked for it.
    #[arg(long, value_name = "NAME")]
    pub acknowledge: Option<String>,
    /// All axes were homed since: asked for where the control may have lost its position.
    #[arg(long, requires = "acknowledge")]
    pub homed: bool,
    /// The machine file that the run began with, for comparison; without it, the stored one serves.
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
    /// Print the program of this dialect.
    #[arg(long, value_name = "DIALECT")]
    pub gcode: Option<String>,
}

#[derive(Debug, Args)]
pub struct IdentifyArgs {
    pub method: String,
    #[arg(long, value_name = "FILE.csv", required_unless_present = "run")]
    pub readings: Option<PathBuf>,
    /// Identify a stored run again, from its own plan and readings; the new estimate joins the
    /// run, the old ones stay.
    #[arg(long, value_name = "RUN", conflicts_with_all = ["readings", "plan"])]
    pub run: Option<i64>,
    /// The plan that was measured; without it, the plan of the machine file.
    #[arg(long, value_name = "FILE.json")]
    pub plan: Option<PathBuf>,
    #[arg(long, value_name = "FILE")]
    pub machine: Option<PathBuf>,
    /// Estimates that are taken as known, in the place of those that the run was begun with.
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
    /// A port by its name in /dev/serial/by-id, or a part of it.
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
    /// A folder that this program and the control both see (LinuxCNC, which needs it).
    #[arg(long, value_name = "DIR", required_if_eq("kind", linuxcnc::KIND))]
    pub program_dir: Option<PathBuf>,
    /// The INI file that the control was started with (LinuxCNC).
    #[arg(long, value_name = "FILE")]
    pub ini: Option<PathBuf>,
    /// The language that the control understands, where it is not the usual one of its kind.
    #[arg(long)]
    pub dialect: Option<String>,
    /// Which axis stands on which, e.g. V[w-C-B-b-Y-X-Z-(C)-t]; without it, the usual for its axes.
    #[arg(long)]
    pub topology: Option<String>,
    #[arg(long)]
    pub name: Option<String>,
    /// Where nothing answers: ask at other speeds, under other numbers and in the languages of other
    /// controls. What another device takes that for, nobody knows: see that nothing can move.
    #[arg(long)]
    pub search: bool,
    /// Write it here; never over a file that is there. Without it, to standard output.
    #[arg(long, value_name = "FILE")]
    pub to: Option<PathBuf>,
}

#[derive(Debug, Args)]
pub struct WatchArgs {
    /// Its name in the machine file.
    pub sensor: String,
    /// The machine file, with a [[sensor]] of this name.
    #[arg(long, value_name = "FILE")]
    pub machine: PathBuf,
    /// End after so many samples; silence is none.
    #[arg(long, value_name = "N")]
    pub samples: Option<u64>,
    /// Print each sample as a line of JSON.
    #[arg(long)]
    pub json: bool,
}

#[derive(Debug, Args)]
pub struct SimulateArgs {
    /// Whose embedded machine is served, where there is no machine file.
    #[arg(default_value = "self-calibration")]
    pub method: String,
    #[arg(long, value_name = "FILE")]
    pub machine: Option<PathBuf>,
    /// Put a bad wire in between: it delays, drops, doubles, flips, splits, stalls and cuts, as the
    /// seed says, and tells what it does.
    #[arg(long, value_name = "SEED")]
    pub faults: Option<u64>,
    #[arg(long, value_enum, default_value = "fast")]
    pub speed: Speed,
}

#[derive(Debug, Args)]
pub struct TrendArgs {
    /// Name of the machine; without it, the one of the last run.
    pub machine: Option<String>,
    /// So many days back is asked what changed.
    #[arg(long, value_name = "DAYS", default_value_t = 7)]
    pub days: u32,
    #[arg(long)]
    pub json: bool,
}

#[derive(Debug, Args)]
pub struct ScheduleArgs {
    /// Name of the machine; without it, all that the journal knows.
    pub name: Option<String>,
    /// The machine file, for what comes next.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["name", "config"])]
    pub machine: Option<PathBuf>,
    /// The daemon's file, likewise.
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
    /// Your name: the machine will move while nobody is there, and you have seen to it that it may.
    #[arg(long, value_name = "NAME")]
    pub who: String,
    /// For so long, such as 14d or 8h, or until an instant, such as 2027-01-31T18:00:00+01:00.
    #[arg(long, value_name = "WHEN")]
    pub until: String,
    #[arg(long, value_name = "WORDS", default_value = "")]
    pub why: String,
}

#[derive(Debug, Args)]
pub struct DisarmArgs {
    /// Name of the machine.
    pub machine: String,
    /// Number of the cycle; without it, all of them.
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
    /// Make one and print it; it is shown this once.
    Add {
        /// Whose it is, e.g. tablet-hall-2: it stands in the audit log.
        name: String,
        /// viewer (reads, and may hold), operator (starts, acknowledges, resumes as well), metrologist
        /// (signs and arms as well).
        #[arg(long)]
        role: Role,
    },
    /// List them, without what makes them valid.
    List {
        #[arg(long)]
        json: bool,
    },
    /// From now on it opens nothing.
    Revoke { name: String },
}
