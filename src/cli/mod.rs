//! The commands. They read files, build the parts, show progress and choose the exit code; they compute
//! nothing.

/// Prints a line on standard output.
macro_rules! outln {
    ($($words:tt)*) => { $crate::cli::print_to_stdout(format_args!($($words)*)) };
}

/// Prints a line on standard error.
macro_rules! errln {
    ($($words:tt)*) => { $crate::cli::print_to_stderr(format_args!($($words)*)) };
}

mod args;
#[cfg(test)]
mod args_tests;
mod artefact;
mod backup;
mod check;
mod combine;
mod compare;
mod compensate;
mod daemon_args;
mod daemon_client;
mod device_links;
mod failure;
mod files;
mod generate;
mod identify;
mod init;
mod live_values;
mod method_list;
mod plan;
mod predict;
mod progress;
mod repeatability;
mod result_args;
mod resume;
mod run;
mod runs;
mod schedule;
mod serve;
mod show;
mod signals;
mod simulate;
mod terminal;
mod token;
mod trend;
mod watch;

use std::io::Write;
use std::path::Path;
use std::process::ExitCode;

use clap::Parser;

use self::args::{Cli, Command};
use self::failure::CommandFailure;
use machine::record::estimate::Verdict;

/// Exit code of a command; README.md lists the exit codes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum ExitStatus {
    /// Success; also a result without a tolerance.
    Pass = 0,
    /// Error without an exit code of its own.
    Error = 1,
    /// Wrong usage, or the operator's confirmation is missing.
    UsageError = 2,
    /// A parameter is outside its tolerance by more than its U, or a compensation is not confirmed by its
    /// verification.
    OutOfTolerance = 3,
    /// The limit is within the uncertainty, or the readings contradict the model.
    Undecided = 4,
    /// The run or the check was stopped; the readings are kept.
    Stopped = 5,
}

impl From<Verdict> for ExitStatus {
    fn from(verdict: Verdict) -> Self {
        match verdict {
            Verdict::Pass | Verdict::None => ExitStatus::Pass,
            Verdict::Fail => ExitStatus::OutOfTolerance,
            Verdict::Undecided | Verdict::UndecidedModel => ExitStatus::Undecided,
        }
    }
}

/// Runs the program with the arguments of this process. A usage error ends the process with exit code 2.
pub fn main() -> ExitCode {
    let cli = Cli::parse();
    let state = cli.state.clone();
    match dispatch_command(cli) {
        Ok(exit) => ExitCode::from(exit as u8),
        Err(failure) => {
            let remedy = failure.remedy.map(|remedy| add_state_option(&remedy, state.as_deref()));
            let remedy = remedy.map(|remedy| format!("\n  → {remedy}"));
            errln!("error: {}{}", failure.message, remedy.unwrap_or_default());
            ExitCode::from(failure.exit_status as u8)
        }
    }
}

/// Adds `--state` to the commands in `advice`, so that pasted commands find the journal of this command.
fn add_state_option(advice: &str, state: Option<&Path>) -> String {
    let Some(state) = state else { return advice.to_owned() };
    let folder = state.display().to_string().replace('\'', r"'\''");
    let parts = advice.split('`').map(|part| match part.strip_prefix("trued ") {
        // A command name without arguments is not a command line.
        Some(rest) if rest.contains(' ') => format!("trued --state '{folder}' {rest}"),
        _ => part.to_owned(),
    });
    parts.collect::<Vec<_>>().join("`")
}

/// Prints to standard error. A closed standard error does not stop the program.
fn print_to_stderr(text: std::fmt::Arguments<'_>) {
    let _ = writeln!(std::io::stderr(), "{text}");
}

/// Runs the command. A command without an exit status of its own has passed if it ends without an error.
fn dispatch_command(cli: Cli) -> Result<ExitStatus, CommandFailure> {
    let state = cli.state.as_deref();
    let ended = match cli.command {
        Command::Run(args) => return run::measurement_run_command(&args, state),
        Command::Check(args) => return check::commissioning_check_command(&args, state),
        Command::Serve(args) => return serve::serve_command(&args, state),
        Command::Resume(args) => return resume::resume_command(&args, state),
        Command::Plan(args) => plan::plan_command(&args, state),
        Command::Identify(args) => return identify::identify_command(&args, state),
        Command::Init(args) => init::init_command(&args),
        Command::Simulate(args) => simulate::simulate_command(&args),
        Command::Watch(args) => watch::watch_command(&args),
        Command::Runs(args) => runs::list_runs(&args, state),
        Command::Trend(args) => trend::trend_command(&args, state),
        Command::Schedule(args) => schedule::schedule_command(&args, state),
        Command::Arm(args) => schedule::arm_command(&args, state),
        Command::Disarm(args) => schedule::disarm_command(&args, state),
        Command::Compare(args) => compare::compare_stored_runs(&args, state),
        Command::Combine(args) => return combine::combine_command(&args, state),
        Command::Compensate(args) => return compensate::compensate_command(&args, state),
        Command::Repeatability(args) => repeatability::repeatability_command(&args, state),
        Command::Show(args) => runs::show_run(&args, state),
        Command::Predict(args) => predict::predict_command(&args),
        Command::Export(args) => runs::export_run(&args, state),
        Command::Backup(args) => backup::backup_command(&args, state),
        Command::Artefact(args) => artefact::artefact_command(&args, state),
        Command::Token(args) => token::token_command(&args, state),
        Command::Generate(args) => generate::generate_command(&args),
    };
    ended.map(|()| ExitStatus::Pass)
}

/// Prints to standard output. A closed pipe is no error; any other failed write ends the program.
fn print_to_stdout(text: std::fmt::Arguments<'_>) {
    use std::io::{ErrorKind, Write as _};
    match writeln!(std::io::stdout(), "{text}") {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => {
            errln!("error: standard output: {error}");
            std::process::exit(ExitStatus::Error as i32);
        }
        _ => {}
    }
}
