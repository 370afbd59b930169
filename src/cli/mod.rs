//! The commands. They read files, build the parts, show progress and choose the exit code; they compute
//! nothing.

/// Prints a line on standard output.
macro_rules! say {
    ($($words:tt)*) => { $crate::cli::print(format_args!($($words)*)) };
}

/// Prints a line on standard error.
macro_rules! tell {
    ($($words:tt)*) => { $crate::cli::tell(format_args!($($words)*)) };
}

mod args;
mod backup;
mod check;
mod compare;
mod daemon;
mod failure;
mod files;
mod identify;
mod init;
mod live_values;
mod method_list;
mod plan;
mod predict;
mod progress;
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
mod wires;

use std::io::Write;
use std::path::Path;
use std::process::ExitCode;

use clap::Parser;

use self::args::{Cli, Command};
use self::failure::Failure;
use machine::record::estimate::Verdict;

/// Exit code of a command (DESIGN, contracts).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Exit {
    Pass = 0,
    Error = 1,
    Usage = 2,
    Fail = 3,
    Undecided = 4,
    Stopped = 5,
}

impl From<Verdict> for Exit {
    fn from(verdict: Verdict) -> Self {
        match verdict {
            Verdict::Pass | Verdict::None => Exit::Pass,
            Verdict::Fail => Exit::Fail,
            Verdict::Undecided | Verdict::UndecidedModel => Exit::Undecided,
        }
    }
}

/// Runs the program with the arguments of this process. Usage errors end it with code 2.
pub fn main() -> ExitCode {
    let cli = Cli::parse();
    let state = cli.state.clone();
    match dispatch(cli) {
        Ok(exit) => ExitCode::from(exit as u8),
        Err(failure) => {
            let remedy = failure.remedy.map(|remedy| with_state(&remedy, state.as_deref()));
            let remedy = remedy.map(|remedy| format!("\n  → {remedy}"));
            tell!("error: {}{}", failure.what, remedy.unwrap_or_default());
            ExitCode::from(failure.exit as u8)
        }
    }
}

/// Adds `--state` to the commands in `advice`, so that pasted commands find the journal of this command.
fn with_state(advice: &str, state: Option<&Path>) -> String {
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
fn tell(text: std::fmt::Arguments<'_>) {
    let _ = writeln!(std::io::stderr(), "{text}");
}

fn dispatch(cli: Cli) -> Result<Exit, Failure> {
    let state = cli.state.as_deref();
    match cli.command {
        Command::Run(args) => run::run(&args, state),
        Command::Check(args) => check::check(&args, state),
        Command::Serve(args) => serve::serve(&args, state),
        Command::Resume(args) => resume::resume(&args, state),
        Command::Plan(args) => plan::plan(&args),
        Command::Identify(args) => identify::identify(&args, state),
        Command::Init(args) => init::init(&args),
        Command::Simulate(args) => simulate::simulate(&args),
        Command::Watch(args) => watch::watch(&args),
        Command::Runs(args) => runs::list(&args, state),
        Command::Trend(args) => trend::trend(&args, state),
        Command::Schedule(args) => schedule::schedule(&args, state),
        Command::Arm(args) => schedule::arm(&args, state),
        Command::Disarm(args) => schedule::disarm(&args, state),
        Command::Compare(args) => compare::compare_runs(&args, state),
        Command::Show(args) => runs::show(&args, state),
        Command::Predict(args) => predict::predict(&args),
        Command::Export(args) => runs::export(&args, state),
        Command::Backup(args) => backup::backup(&args, state),
        Command::Token(args) => token::token(&args, state),
    }
}

/// Prints to standard output. A closed pipe is no error; any other failed write ends the program.
fn print(words: std::fmt::Arguments<'_>) {
    use std::io::{ErrorKind, Write as _};
    match writeln!(std::io::stdout(), "{words}") {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => {
            tell!("error: standard output: {error}");
            std::process::exit(Exit::Error as i32);
        }
        _ => {}
    }
}
