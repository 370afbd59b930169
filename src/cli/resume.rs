//! `trued resume`: a person has looked at the machine; the run goes on.

use std::io::{BufRead as _, IsTerminal as _};
use std::path::Path;
use std::sync::Arc;

use jiff::Timestamp;

use super::args::ResumeArgs;
use super::failure::Failure;
use super::files::state_folder;
use super::progress::Progress;
use super::run::{check_report_folder, connect, runtime, tell_result};
use super::signals::stop_on_signals;
use super::wires::Wires;
use super::{Exit, runs};
use crate::archive::story;
use crate::methods::{self, Method};
use crate::record::event::Event;
use crate::run::{Interrupted, Run, conclude};
use crate::setup::{MachineFile, Past, SetupError};
use crate::store::{Journal, MachineLock, RunId, RunState, StoredRun};

pub fn resume(args: &ResumeArgs, state: Option<&Path>) -> Result<Exit, Failure> {
    check_report_folder(&args.output)?;
    let folder = state_folder(state)?;
    let (journal, id) = (Journal::open(&folder)?, RunId(args.run));
    let lock = MachineLock::acquire(&folder, &journal.load(id)?.summary.machine)?;
    journal.mark_interrupted(&lock).wait()?;
    let stored = journal.load(id)?;
    check_state(&stored)?;
    check_machine_file(args, &stored)?;
    let file = format!("machine file of run {id}");
    let machine = MachineFile::stored(&file, stored.config.clone(), &stored.plan.artefact)
        .map_err(SetupError::from)?;
    let name = stored.plan.method.clone();
    let method: Arc<dyn Method> =
        methods::configure(&name, stored.plan.settings.clone()).map_err(Failure::plain)?.into();
    let acknowledged = acknowledge(args, &stored)?;
    let wires = Wires::of(args.output.capture.as_deref(), None)?;
    journal.event(id, &acknowledged).wait()?;

    let mut progress = Progress::start(args.output.json);
    let mut tell = |event: &Event| progress.tell(event);
    tell(&acknowledged);
    let found = runtime()?.block_on(async {
        let elapsed_s = elapsed_s(&stored);
        let past = Past { readings: &stored.readings, elapsed_s };
        let opening = connect(&machine, args.output.speed, past);
        let devices = wires.connect(opening).await?;
        stop_on_signals(devices.controller.halt())?;
        let StoredRun { plan, stages, readings, .. } = stored;
        let mut run = Run::new(id, method.as_ref(), &devices, &journal, plan, &mut tell);
        let ended = run.resume(Interrupted { stages, readings, elapsed_s }).await;
        let found = conclude(run, ended, &method, Vec::new(), &machine.tolerance).await;
        found.map_err(|error| Failure::of_cycle(&error, &name))
    });
    tell_result(&journal, (id, wires.finish(found)?), &args.output, wires.keeps())
}

fn check_state(stored: &StoredRun) -> Result<(), Failure> {
    let (id, state) = (stored.summary.id, stored.summary.state);
    if state.is_resumable() {
        return Ok(());
    }
    let why = match state {
        RunState::Finished => "has come to its end",
        RunState::Failed => "was refused before anything moved",
        RunState::Closed => "is closed",
        _ => "is under way",
    };
    let way_on = runs::way_on(stored);
    Err(Failure::new(
        format!("run {id} {why}: there is nothing to resume"),
        way_on.unwrap_or_else(|| "start a new run".to_owned()),
    ))
}

/// Another machine file is another run.
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

/// A person's word that the machine may move.
fn acknowledge(args: &ResumeArgs, stored: &StoredRun) -> Result<Event, Failure> {
    let ended = story::how_it_ended(stored);
    let lost = story::position_lost(stored);
    let ask = match lost {
        true => {
            "are all axes homed, for the control may have lost its position? is the way free, what sits in the spindle whole?"
        }
        false => "is the way free, what sits in the spindle whole?",
    };
    let who = match &args.acknowledge {
        Some(name) => name.trim().to_owned(),
        None if std::io::stdin().is_terminal() => asked(&ended, ask)?,
        None => String::new(),
    };
    let told = args.homed || args.acknowledge.is_none();
    if !who.is_empty() && (told || !lost) {
        return Ok(Event::Acknowledged { who, what: format!("{ended}; asked: {ask}") });
    }
    let what = match who.is_empty() {
        true => format!("{ended}\nnobody has acknowledged it; nothing has moved"),
        false => format!("{ended}\nnobody has said that all axes are homed; nothing has moved"),
    };
    let remedy = format!(
        "look at the machine ({ask}), then `trued resume {} --acknowledge YOUR_NAME{}`",
        stored.summary.id,
        if lost { " --homed" } else { "" }
    );
    Err(Failure { exit: Exit::Usage, ..Failure::new(what, remedy) })
}

/// On a terminal.
fn asked(ended: &str, ask: &str) -> Result<String, Failure> {
    tell!("{ended}");
    tell!(
        "look at the machine: {ask} Z goes straight up first, then the references are touched.\n\
         type your name to go on, nothing to leave it as it is:"
    );
    let mut line = String::new();
    std::io::stdin().lock().read_line(&mut line).map_err(Failure::plain)?;
    Ok(line.trim().to_owned())
}

/// Wall time since the last reading, s.
fn elapsed_s(stored: &StoredRun) -> f64 {
    let since = stored.measured_until.or(stored.summary.ended);
    since.map_or(0.0, |since| Timestamp::now().duration_since(since).as_secs_f64())
}
