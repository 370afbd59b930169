//! `trued schedule`, `trued arm`, `trued disarm`: unattended starts.

use std::path::Path;

use jiff::Timestamp;
use serde::Serialize;

use super::args::{ArmArgs, DisarmArgs, ScheduleArgs};
use super::failure::Failure;
use super::files::state_folder;
use super::{Exit, show};
use crate::service::DaemonFile;
use crate::service::schedule::planned;
use crate::service::schedule_state::{Planned, arming};
use crate::setup::SetupError;
use crate::store::{Arming, Journal, Slot};

/// Number of past slots that are printed.
const MAX_PAST_SLOTS: usize = 20;

#[derive(Serialize)]
struct ScheduleReport {
    machine: String,
    /// Next slots; only if the machine file is given.
    planned: Vec<Planned>,
    armed: Vec<Arming>,
    last: Vec<Slot>,
}

pub fn schedule(args: &ScheduleArgs, state: Option<&Path>) -> Result<Exit, Failure> {
    let journal = Journal::open(&state_folder(state)?)?;
    let file = match (&args.config, &args.machine) {
        (Some(config), _) => Some(DaemonFile::read(config)),
        (None, Some(machine)) => Some(DaemonFile::of_machine(machine)),
        (None, None) => None,
    };
    let all = match (file.transpose().map_err(SetupError::from)?, &args.name) {
        (Some(file), _) => of_file(file),
        (None, Some(name)) => vec![(name.clone(), Vec::new())],
        (None, None) => journal.machines()?.into_iter().map(|name| (name, Vec::new())).collect(),
    };
    let told = all.into_iter().map(|(machine, planned)| {
        let (armed, last) = (journal.armings(&machine)?, journal.slots(&machine, MAX_PAST_SLOTS)?);
        Ok(ScheduleReport { machine, planned, armed, last })
    });
    let told = told.collect::<Result<Vec<_>, Failure>>()?;
    match args.json {
        true => show::print_json(&told)?,
        false => told.iter().for_each(print),
    }
    Ok(Exit::Pass)
}

fn of_file(file: DaemonFile) -> Vec<(String, Vec<Planned>)> {
    let now = Timestamp::now();
    let machines = file.machines.into_iter();
    machines
        .map(|(machine, config)| (machine.machine.name.clone(), planned(&config.schedule, now)))
        .collect()
}

fn print(told: &ScheduleReport) {
    let ScheduleReport { machine, planned, armed, last } = told;
    say!("{machine}");
    for Planned { name, cycle, at, zone, next, .. } in planned {
        let next: Vec<_> =
            next.iter().map(|next| next.strftime("%a %F %H:%M %Z").to_string()).collect();
        say!("  {name}: cycle {cycle}, {at} in {zone}; next {}", next.join(", "));
    }
    for Arming { cycle, who, until, ended, broken, .. } in armed {
        match (ended, broken) {
            (Some((when, why)), _) => say!("  cycle {cycle} was disarmed at {when}: {why}"),
            (None, Some(run)) => say!("  cycle {cycle} is not armed: run {run} did not end"),
            (None, None) => say!("  cycle {cycle} is armed by {who} until {until}"),
        }
    }
    for Slot { schedule, at, outcome, why, run, .. } in last {
        let run = if *run > 0 { format!(" (run {run})") } else { String::new() };
        say!("  {at} {schedule}: {}{run} {why}", outcome.as_str());
    }
}

pub fn arm(args: &ArmArgs, state: Option<&Path>) -> Result<Exit, Failure> {
    let journal = Journal::open(&state_folder(state)?)?;
    let ArmArgs { machine, cycle, who, until, why } = args;
    known(&journal, machine)?;
    let arming = arming((machine, *cycle), (nobody(who)?, why), until, Timestamp::now());
    let arming = arming.map_err(|why| {
        Failure::new(why, "say until when: --until 14d, or --until 2027-01-31T18:00:00+01:00")
    })?;
    journal.arm(&arming).wait()?;
    say!("cycle {cycle} of {machine} may start by the schedule until {}", arming.until);
    Ok(Exit::Pass)
}

pub fn disarm(args: &DisarmArgs, state: Option<&Path>) -> Result<Exit, Failure> {
    let journal = Journal::open(&state_folder(state)?)?;
    let DisarmArgs { machine, cycle, who, why } = args;
    known(&journal, machine)?;
    let ended = journal.disarm(machine, *cycle, nobody(who)?, why).wait()?;
    say!("{ended} armings of {machine} ended");
    Ok(Exit::Pass)
}

fn nobody(who: &str) -> Result<&str, Failure> {
    match who.trim() {
        "" => Err(Failure::new("nobody has given a name", "--who says who you are")),
        who => Ok(who),
    }
}

fn known(journal: &Journal, machine: &str) -> Result<(), Failure> {
    let all = journal.machines()?;
    if all.iter().any(|known| known == machine) {
        return Ok(());
    }
    let remedy = format!("those that it knows are: {}; start its service once", all.join(", "));
    Err(Failure::new(format!("the journal knows no machine `{machine}`"), remedy))
}
