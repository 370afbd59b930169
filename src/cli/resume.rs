//! `trued resume`: resumes a run after a person has checked the machine.

use std::path::Path;

use super::Exit;
use super::args::ResumeArgs;
use super::failure::Failure;
use super::files::state_folder;
use super::progress::Progress;
use super::run::{check_report_folder, connect, runtime, tell_result};
use super::signals::stop_on_signals;
use super::terminal::{by_enter, typed};
use super::wires::Wires;
use crate::run::{
    AgainError, CycleError, Question, ResumableRun, identify_stored, store_identification,
};
use crate::store::{Journal, MachineLock, RunId, RunState, StoredRun};
use machine::record::event::Event;

pub fn resume(args: &ResumeArgs, state: Option<&Path>) -> Result<Exit, Failure> {
    check_report_folder(&args.output)?;
    let folder = state_folder(state)?;
    let (journal, id) = (Journal::open(&folder)?, RunId(args.run));
    let stored = journal.load(id)?;
    if stored.summary.state == RunState::NotIdentified {
        return identify(args, &journal, state, stored);
    }
    let lock = MachineLock::acquire(&folder, &stored.summary.machine)?;
    journal.mark_interrupted(&lock).wait()?;
    let again = ResumableRun::of(journal.load(id)?)?;
    check_machine_file(args, again.stored())?;
    let (who, acknowledged) = acknowledge(args, &again)?;
    let wires = Wires::of(args.output.capture.as_deref(), None)?;
    journal.event(id, &acknowledged).wait()?;

    let name = again.stored().plan.method.clone();
    let mut progress = Progress::start(args.output.json);
    let answers = by_enter(who, progress.printer());
    let mut tell = |event: &Event| progress.tell(event);
    tell(&acknowledged);
    let found = runtime()?.block_on(async {
        let opening = connect(&again.machine, args.output.speed, again.past());
        let devices = wires.connect(opening).await?;
        stop_on_signals(devices.controller.halt())?;
        let found = again.run(&devices, &journal, answers, &mut tell).await;
        found.map_err(|error| Failure::of_cycle(&error, &name))
    });
    tell_result(&journal, state, wires.finish(found)?, &args.output, wires.keeps())
}

/// Identifies a run that was measured to its end; neither the machine nor an operator is needed.
fn identify(
    args: &ResumeArgs,
    journal: &Journal,
    state: Option<&Path>,
    stored: StoredRun,
) -> Result<Exit, Failure> {
    check_machine_file(args, &stored)?;
    let (run, method) = (stored.summary.id, stored.plan.method.clone());
    tell!("run {run} is measured: identifying from {} readings", stored.readings.len());
    let found = identify_stored(stored);
    let found = runtime()?.block_on(store_identification(journal, run, found));
    let of_cycle = |why| Failure::of_cycle(&CycleError::Identification { run, why }, &method);
    tell_result(journal, state, (run, found.map_err(of_cycle)?), &args.output, true)
}

impl From<AgainError> for Failure {
    fn from(error: AgainError) -> Self {
        let what = error.to_string();
        let (question, homed) = match error {
            AgainError::Setup(error) => return error.into(),
            AgainError::NotUnfinished { way_on, .. } => {
                return Self::new(what, way_on.unwrap_or_else(|| "start a new run".to_owned()));
            }
            AgainError::Nobody(question) => {
                let homed = if question.position_lost { " --homed" } else { "" };
                (question, homed)
            }
            AgainError::NotHomed(question) => (question, " --homed"),
        };
        let Question { run, ask, .. } = question;
        let remedy = format!(
            "look at the machine ({ask}), then `trued resume {run} --acknowledge YOUR_NAME{homed}`"
        );
        Self { exit: Exit::Usage, ..Self::new(what, remedy) }
    }
}

/// Checks that the machine file is the stored one: another machine file requires a new run.
fn check_machine_file(args: &ResumeArgs, stored: &StoredRun) -> Result<(), Failure> {
    let Some(file) = &args.machine else { return Ok(()) };
    let text = std::fs::read_to_string(file).map_err(|error| Failure::file(file, &error))?;
    if text == stored.config {
        return Ok(());
    }
    let pairs = text.lines().zip(stored.config.lines()).enumerate();
    let differs = pairs.into_iter().find(|(_, (now, then))| now != then);
    let what = differs.map_or("one is longer".to_owned(), |(i, (now, then))| {
        format!("line {} is `{now}` and was `{then}`", i + 1)
    });
    Err(Failure::new(
        format!(
            "{} is not the machine file that run {} began with: {what}",
            file.display(),
            stored.summary.id
        ),
        "another machine file is another run: resume without --machine, or start a new run",
    ))
}

/// The person's acknowledgement that the machine may move.
fn acknowledge(args: &ResumeArgs, again: &ResumableRun) -> Result<(String, Event), Failure> {
    let who = match &args.acknowledge {
        Some(name) => name.clone(),
        None => asked(&again.question())?,
    };
    // The question on the terminal includes the homing.
    let homed = args.homed || args.acknowledge.is_none();
    let acknowledged = again.acknowledged(&who, homed)?;
    Ok((who.trim().to_owned(), acknowledged))
}

/// Asks for the acknowledgement on the terminal.
fn asked(Question { ended, ask, .. }: &Question) -> Result<String, Failure> {
    typed(&format!(
        "{ended}\nlook at the machine: {ask} Z goes straight up first, then the references are touched.\n\
         type your name to go on, nothing to leave it as it is:"
    ))
    .map_err(Failure::plain)
}
