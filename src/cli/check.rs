//! `trued check`: compares the machine with its machine file.

use std::io::IsTerminal as _;
use std::path::Path;

use super::args::CheckArgs;
use super::failure::Failure;
use super::files::state_folder;
use super::run::runtime;
use super::signals::stop_on_signals;
use super::terminal::Terminal;
use super::{Exit, show};
use crate::commissioning::{Check, Finding, Nobody, Person, Stop, Summary, Verdict};
use crate::setup::{self, Site};
use crate::store::{Journal, MachineLock};

/// Name of a method for loading the machine file; any method would do.
const METHOD: &str = "self-calibration";

pub fn check(args: &CheckArgs, state: Option<&Path>) -> Result<Exit, Failure> {
    let machine = setup::load(args.machine.as_deref(), METHOD)?;
    let folder = state_folder(state)?;
    let lock = MachineLock::acquire(&folder, &machine.machine.name)?;
    let journal = Journal::open(&folder)?;
    journal.mark_interrupted(&lock).wait()?;
    let site = Site::new(&machine)?;
    let stop = Stop::default();
    stop_on_signals(stop.halt())?;
    let mut person = person(&site, &stop);
    let mut tell = |finding: &Finding| {
        if args.json { tell!("{finding}") } else { say!("{finding}") }
    };
    let at = (&machine, &site, args.speed.into());
    let check = Check::new(at, &journal, person.as_mut(), stop, &mut tell);
    let summary = runtime()?.block_on(check.through());
    report(&summary, args.json)?;
    Ok(exit(&summary))
}

/// The simulated operator of a simulated machine, the person at the terminal, or nobody.
fn person(site: &Site<'_>, stop: &Stop) -> Box<dyn Person> {
    match site.bystander() {
        Some(bystander) => Box::new(bystander),
        None if std::io::stdin().is_terminal() => Box::new(Terminal::new(stop.clone())),
        None => {
            tell!("nobody is at a terminal: what a person must allow or see is not looked at");
            Box::new(Nobody)
        }
    }
}

fn report(summary: &Summary, json: bool) -> Result<(), Failure> {
    if json {
        return show::print_json(summary);
    }
    say!("\nto paste into a support request:\n\n{summary}");
    Ok(())
}

fn exit(summary: &Summary) -> Exit {
    match summary {
        _ if summary.stopped => Exit::Stopped,
        _ if summary.count(Verdict::Failed) > 0 => Exit::Error,
        _ => Exit::Pass,
    }
}
