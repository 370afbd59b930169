//! Arguments of the command line.

use std::path::PathBuf;

use clap::builder::PossibleValuesParser;
use clap::{Args, Parser, Subcommand, ValueEnum};

use super::artefact::ArtefactArgs;
use super::daemon_args::{ArmArgs, DisarmArgs, ScheduleArgs, TokenArgs};
use super::method_list::{method_name_parser, methods_help};
use super::result_args::{
    BackupArgs, CombineArgs, CompareArgs, CompensateArgs, ExportArgs, PredictPoseErrorsArgs, RepeatabilityArgs,
    RunsArgs, ShowArgs,
};
use crate::setup::control_kinds;
use devices::controllers::linuxcnc;
use planning::gcode::Dialect;

/// Keeps five-axis machine tools in tolerance: the machine measures its geometric errors with its own touch
/// probe and states their uncertainty.
#[derive(Debug, Parser)]
#[command(name = "trued", version = env!("TRUED_VERSION"), about, color = clap::ColorChoice::Never)]
pub struct Cli {
    /// State folder: the journal (journal.sqlite), the lock files, the register of artefacts and the tokens. Without
    /// this option:
    /// $STATE_DIRECTORY, otherwise $XDG_STATE_HOME/trued, otherwise ~/.local/state/trued.
    #[arg(long, global = true, value_name = "DIR")]
    pub state: Option<PathBuf>,
    #[command(subcommand)]
    pub command: Command,
}

#[derive(Debug, Subcommand)]
pub enum Command {
    /// Measure with a method, estimate the parameters, compare them with the tolerances and store the run.
    Run(RunArgs),
    /// Run as a daemon: start the cycles of [serve] in the machine file on a trigger of the control, from the
    /// page or by the schedule.
    Serve(ServeArgs),
    /// Check that the machine agrees with its machine file, part by part, with an operator at the machine. A
    /// simulated machine needs no operator.
    Check(CheckArgs),
    /// Resume a stopped or interrupted run after the operator has checked the machine. If all steps are
    /// measured, only compute the estimate, without motion.
    Resume(ResumeArgs),
    /// Print the plan of a measurement; nothing moves.
    Plan(PlanArgs),
    /// Compute an estimate from readings.
    Identify(IdentifyArgs),
    /// Write a commented machine file from the data that the control reports; nothing moves.
    Init(InitArgs),
    /// Print the samples of a sensor; nothing moves.
    Watch(WatchArgs),
    /// Start the simulated machine on a pseudo-terminal or a TCP port, as a target for other programs.
    Simulate(SimulateMachineArgs),
    /// List the stored runs.
    Runs(RunsArgs),
    /// Show the history of the parameters of a machine, and their significant changes.
    Trend(TrendArgs),
    /// Show the schedule of a machine, the cycles that are armed and the last scheduled starts.
    Schedule(ScheduleArgs),
    /// Allow the schedule to start a cycle unattended until a given time.
    Arm(ArmArgs),
    /// Stop unattended starts by the schedule on this machine until a cycle is armed again.
    Disarm(DisarmArgs),
    /// Show a stored run: its state, its estimate and its interruptions.
    Show(ShowArgs),
    /// Compare the estimates of two stored runs: differences, their U, and E_n (ISO 13528).
    Compare(CompareArgs),
    /// Combine stored runs of one machine into one estimate, and test whether the runs agree. The combined estimate is
    /// stored as the estimate of the newest run.
    Combine(CombineArgs),
    /// Compensate errors of a stored run in the control: propose, write, undo.
    Compensate(CompensateArgs),
    /// Scatter and drift of repeated measurements: the passes of one run, or several runs.
    Repeatability(RepeatabilityArgs),
    /// Compute the position error of the tool at given poses from an estimate.
    Predict(PredictPoseErrorsArgs),
    /// Write plan, readings, estimate and report of a stored run to files.
    Export(ExportArgs),
    /// Manage the register of calibrated artefacts and check standards. A run with an artefact whose certificate has
    /// expired does not start.
    Artefact(ArtefactArgs),
    /// Copy the journal to one file and verify the copy; a daemon may be running.
    Backup(BackupArgs),
    /// Manage the tokens for access from other computers to the page and the HTTP interface of `trued serve`.
    Token(TokenArgs),
    /// Write shell completions and man pages to a folder, for a package.
    #[command(hide = true)]
    Generate(GenerateArgs),
}

#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, ValueEnum)]
pub enum SimulationSpeed {
    /// The simulated machine runs in real time.
    Real,
    /// The simulated machine runs as fast as the computer allows.
    #[default]
    Fast,
}

#[derive(Debug, Args)]
#[command(after_help = methods_help())]
pub struct RunArgs {
    /// Measuring method.
    #[arg(value_parser = method_name_parser())]
    pub method: String,
    /// Machine file; without it, the built-in simulated machine is measured.
    #[arg(long, value_name = "FILE")]
    pub machine: Option<PathBuf>,
    /// Earlier estimates; their values and uncertainties are used as known parameters.
    #[arg(long = "with", value_name = "EST.json")]
    pub with: Vec<PathBuf>,
    /// Number of passes of the whole cycle in this run: the estimate uses all passes, and the repeatability of the
    /// passes is printed after it (`trued repeatability RUN --json` prints it as JSON).
    #[arg(long, value_name = "N")]
    pub repeat: Option<u32>,
    /// Your name, if a daemon controls the machine and runs the cycle. With it you confirm that the machine
    /// may move, that the control is in automatic mode and that the guards are closed. Without this option
    /// the command prompts for the name on a terminal. Prompts of the run that you confirm with Enter are
    /// stored with this name, otherwise with your login name.
    #[arg(long, value_name = "NAME")]
    pub acknowledge: Option<String>,
    /// Replay a capture: the replies of the devices come from this file, no device is opened and nothing
    /// moves. The replay is not stored in the journal.
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
    /// Write every byte of every device link, with its time, to this file.
    #[arg(long, value_name = "FILE")]
    pub capture: Option<PathBuf>,
    /// Speed of the simulated machine, by default `fast`; without effect on a real machine.
    #[arg(long, value_enum)]
    pub speed: Option<SimulationSpeed>,
}

#[derive(Debug, Args)]
pub struct CheckArgs {
    /// Machine file; without it, the built-in simulated machine is checked.
    #[arg(long, value_name = "FILE")]
    pub machine: Option<PathBuf>,
    /// Print the summary as JSON.
    #[arg(long)]
    pub json: bool,
    /// Speed of the simulated machine; without effect on a real machine.
    #[arg(long, value_enum, default_value = "fast")]
    pub speed: SimulationSpeed,
}

#[derive(Debug, Args)]
pub struct ServeArgs {
    /// Configuration file of the daemon: its machines and its page.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Machine file of a single machine, with a section [serve]. Without this option and --config, the daemon
    /// controls the simulated machine, with its page at 127.0.0.1:8137.
    #[arg(long, value_name = "FILE", conflicts_with = "config")]
    pub machine: Option<PathBuf>,
    /// Read every file, plan and collision-check every cycle, then exit; no device is opened.
    #[arg(long)]
    pub check: bool,
    /// Speed of the simulated machine; without effect on a real machine.
    #[arg(long, value_enum, default_value = "fast")]
    pub speed: SimulationSpeed,
    /// Write every byte of the device links to one file per run: FILE with the number of the run before the
    /// file extension.
    #[arg(long, value_name = "FILE")]
    pub capture: Option<PathBuf>,
}

#[derive(Debug, Args)]
pub struct ResumeArgs {
    /// Number of the run; `trued runs` lists the numbers.
    pub run: i64,
    /// Your name. With it you confirm that you have checked the machine, that its path is free and that the
    /// stylus is undamaged. Without this option the command prompts for the name on a terminal.
    #[arg(long, value_name = "NAME")]
    pub acknowledge: Option<String>,
    /// Confirm that all axes were homed after the stop; required if the control may have lost its position.
    #[arg(long, requires = "acknowledge")]
    pub homed: bool,
    /// Machine file for comparison with the machine file stored with the run; the command fails if they differ. The run
    /// always uses its stored machine file.
    #[arg(long, value_name = "FILE")]
    pub machine: Option<PathBuf>,
    #[command(flatten)]
    pub output: OutputArgs,
}

#[derive(Debug, Args)]
#[command(after_help = methods_help())]
pub struct PlanArgs {
    /// Measuring method.
    #[arg(value_parser = method_name_parser())]
    pub method: String,
    /// Machine file; without it, the built-in simulated machine of the method.
    #[arg(long, value_name = "FILE")]
    pub machine: Option<PathBuf>,
    /// Print the plan as JSON.
    #[arg(long, conflicts_with = "gcode")]
    pub json: bool,
    /// Print the G-code program in this dialect.
    #[arg(long, value_name = "DIALECT", value_parser = PossibleValuesParser::new(Dialect::names()))]
    pub gcode: Option<String>,
}

#[derive(Debug, Args)]
pub struct IdentifyArgs {
    /// Measuring method.
    #[arg(value_parser = method_name_parser())]
    pub method: String,
    /// Readings file of a measurement, from this or another program.
    #[arg(long, value_name = "FILE.csv", required_unless_present = "run")]
    pub readings: Option<PathBuf>,
    /// Compute a new estimate of a stored run from its plan and readings. The new estimate is added to the
    /// run; the older estimates stay.
    #[arg(long, value_name = "RUN", conflicts_with_all = ["readings", "plan"])]
    pub run: Option<i64>,
    /// Plan of the readings; without it, the plan that follows from the machine file.
    #[arg(long, value_name = "FILE.json")]
    pub plan: Option<PathBuf>,
    /// Machine file with the tolerances; without it, the machine file of the run, or the built-in machine of the
    /// method.
    #[arg(long, value_name = "FILE")]
    pub machine: Option<PathBuf>,
    /// Earlier estimates; their values and uncertainties are used as known parameters, instead of the
    /// estimates that the run was started with.
    #[arg(long = "with", value_name = "EST.json")]
    pub with: Vec<PathBuf>,
    /// Print the estimate as JSON.
    #[arg(long)]
    pub json: bool,
}

#[derive(Debug, Args)]
#[command(group = clap::ArgGroup::new("link").required(true).args(["serial", "serial_id", "tcp"]))]
pub struct InitArgs {
    /// Kind of the control.
    #[arg(long, value_parser = PossibleValuesParser::new(control_kinds()))]
    pub kind: String,
    /// Serial port of the control.
    #[arg(long, value_name = "/dev/...")]
    pub serial: Option<String>,
    /// Name of a serial port in /dev/serial/by-id, or a part of the name.
    #[arg(long, value_name = "NAME")]
    pub serial_id: Option<String>,
    /// Baud rate of the serial port; without it, the usual rate of this kind of control.
    #[arg(long, value_name = "N", conflicts_with = "tcp")]
    pub baud: Option<u32>,
    /// Parity of the serial port (Modbus).
    #[arg(long, conflicts_with = "tcp", value_parser = ["none", "even", "odd"])]
    pub parity: Option<String>,
    /// Network address of the control.
    #[arg(long, value_name = "HOST:PORT")]
    pub tcp: Option<String>,
    /// Unit identifier of the device (Modbus).
    #[arg(long, value_name = "N")]
    pub unit: Option<u8>,
    /// Folder that both this program and the control can access; required for LinuxCNC.
    #[arg(long, value_name = "DIR", required_if_eq("kind", linuxcnc::CONTROL_KIND))]
    pub program_dir: Option<PathBuf>,
    /// INI file of the running LinuxCNC.
    #[arg(long, value_name = "FILE")]
    pub ini: Option<PathBuf>,
    /// G-code dialect of the control, if it differs from the usual dialect of this kind of control.
    #[arg(long, value_parser = PossibleValuesParser::new(Dialect::names()))]
    pub dialect: Option<String>,
    /// Kinematic chain, e.g. V[w-C-B-b-Y-X-Z-(C)-t]; without it, the usual chain for these axes.
    #[arg(long)]
    pub topology: Option<String>,
    /// Name of the machine, as printed in every report.
    #[arg(long)]
    pub name: Option<String>,
    /// If no device replies, try other baud rates, unit identifiers and protocols. Another device may
    /// misinterpret these requests: make sure that nothing can move.
    #[arg(long)]
    pub search: bool,
    /// Output file; it must not exist yet. Without this option the file is printed to standard output.
    #[arg(long, value_name = "FILE")]
    pub to: Option<PathBuf>,
}

#[derive(Debug, Args)]
pub struct WatchArgs {
    /// Name of the sensor in the machine file.
    pub sensor: String,
    /// Machine file with a [[sensor]] of this name.
    #[arg(long, value_name = "FILE")]
    pub machine: PathBuf,
    /// Exit after this number of samples; missing samples are not counted.
    #[arg(long, value_name = "N")]
    pub samples: Option<u64>,
    /// Print each sample as a line of JSON.
    #[arg(long)]
    pub json: bool,
}

#[derive(Debug, Args)]
pub struct SimulateMachineArgs {
    /// Method whose built-in machine is simulated if no machine file is given.
    #[arg(default_value = "self-calibration", value_parser = method_name_parser())]
    pub method: String,
    /// Machine file; without it, the built-in simulated machine of the method.
    #[arg(long, value_name = "FILE")]
    pub machine: Option<PathBuf>,
    /// Simulate a faulty link, which delays, drops, duplicates, corrupts, splits, stalls and cuts the data
    /// according to this seed, and print its faults.
    #[arg(long, value_name = "SEED")]
    pub faults: Option<u64>,
    /// Speed of the simulated machine.
    #[arg(long, value_enum, default_value = "fast")]
    pub speed: SimulationSpeed,
}

#[derive(Debug, Args)]
pub struct TrendArgs {
    /// Name of the machine; without it, the machine of the last run.
    pub machine: Option<String>,
    /// Number of past days for which changes are listed.
    #[arg(long, value_name = "DAYS", default_value_t = 7)]
    pub days: u32,
    /// Print the history as JSON.
    #[arg(long)]
    pub json: bool,
}

#[derive(Debug, Args)]
pub struct GenerateArgs {
    /// Output folder; created if missing.
    pub folder: PathBuf,
}
