//! `trued run`: measures, and stores a judged estimate.

use std::path::Path;
use std::sync::Arc;

use super::args::{OutputArgs, RunArgs, Speed};
use super::daemon::Daemon;
use super::failure::Failure;
use super::files::read_estimates;
use super::progress::Progress;
use super::signals::stop_on_signals;
use super::terminal::{by_enter, login};
use super::wires::Wires;
use super::{Exit, show, with_state};
use crate::run::{Cycle, PromptAnswers, check_probe};
use crate::setup::{self, Devices, MachineFile, Pace, RunHistory};
use crate::store::{Journal, MachineLock, RunId};
use machine::record::estimate::Estimate;
use machine::record::event::Event;
use methods::Method;

pub fn run(args: &RunArgs, state: Option<&Path>) -> Result<Exit, Failure> {
    let machine = setup::load(args.machine.as_deref(), &args.method)?;
    let (method, mut plan) = setup::header(&machine, &args.method, args.repeat)?;
    let method: Arc<dyn Method> = method.into();
    plan.priors = read_estimates(&args.with)?;
    method.check_priors(&plan)?;
    check_probe(&plan)?;
    check_report_folder(&args.output)?;
    let wires = Wires::of(args.output.capture.as_deref(), args.replay.as_deref())?;
    let folder = wires.folder(state)?;
    let lock = MachineLock::acquire(&folder, &machine.machine.name);
    let journal = Journal::open(&folder)?;
    let lock = match lock {
        Ok(lock) => lock,
        Err(error) => {
            let daemon = Daemon::that_has_it(&error, &folder).ok_or(error)?;
            let found = daemon.run(args, &machine, &journal)?;
            return tell_result(&journal, state, found, &args.output, true);
        }
    };
    journal.mark_interrupted(&lock).wait()?;

    let mut progress = Progress::start(args.output.json);
    let answers = answers(args, &progress);
    let mut tell = |event: &Event| progress.tell(event);
    let found = runtime()?.block_on(async {
        // The run begins after its machine is open.
        let opening = connect(&machine, args.output.speed, RunHistory::default());
        let devices = wires.connect(opening).await?;
        stop_on_signals(devices.controller.halt())?;
        let cycle = Cycle { machine: &machine, method, plan, answers };
        let ended = cycle.run(&devices, &journal, |_| (), &mut tell).await;
        ended.map_err(|error| Failure::of_cycle(&error, &args.method))
    });
    let found = wires.finish(found)?;
    tell_result(&journal, state, found, &args.output, wires.keeps())
}

/// Source of the answers: the person at the terminal, or, in a replay, an automatic answer.
fn answers(args: &RunArgs, progress: &Progress) -> PromptAnswers {
    let who = args.acknowledge.clone().unwrap_or_else(login);
    match args.replay {
        Some(_) => PromptAnswers::new(|_| Some("the replay".to_owned())),
        None => by_enter(who, progress.printer()),
    }
}

/// One thread for all tasks that wait.
pub fn runtime() -> Result<tokio::runtime::Runtime, Failure> {
    let mut builder = tokio::runtime::Builder::new_current_thread();
    builder.enable_all().build().map_err(Failure::plain)
}

/// Prints the result and the command that shows it; `keeps`: the journal outlives the program.
pub fn tell_result(
    journal: &Journal,
    state: Option<&Path>,
    (id, estimate): (RunId, Estimate),
    output: &OutputArgs,
    keeps: bool,
) -> Result<Exit, Failure> {
    if output.json {
        show::print_json(&estimate)?;
    } else {
        show::print_estimate(&estimate);
        match keeps {
            true => {
                let advice = format!("`trued show {id} --report report.html` draws it");
                say!("\nstored as run {id}: {}", with_state(&advice, state));
            }
            false => say!("\nreplayed: nothing was measured, nothing is stored"),
        }
    }
    if let Some(file) = &output.report {
        show::write_report(journal, id, file)?;
    }
    Ok(estimate.verdict.into())
}

/// Checks before the measurement that the report can be written.
pub fn check_report_folder(output: &OutputArgs) -> Result<(), Failure> {
    output.report.as_ref().map_or(Ok(()), |file| check_folder(file, "the report", "--report"))
}

/// Checks that the folder of `file` exists.
pub fn check_folder(file: &Path, what: &str, option: &str) -> Result<(), Failure> {
    let folder = file.parent().filter(|folder| !folder.as_os_str().is_empty());
    match folder {
        Some(folder) if !folder.is_dir() => Err(Failure::new(
            format!("{}: there is no such folder for {what}", folder.display()),
            format!("make it, or choose another place with {option}"),
        )),
        _ => Ok(()),
    }
}

pub async fn connect(
    machine: &MachineFile,
    speed: Option<Speed>,
    past: RunHistory<'_>,
) -> Result<Devices, Failure> {
    Ok(setup::devices(machine, speed.unwrap_or_default().into(), past).await?)
}

impl From<Speed> for Pace {
    fn from(speed: Speed) -> Self {
        match speed {
            Speed::Real => Self::Real,
            Speed::Fast => Self::Fast,
        }
    }
}
