//! `trued schedule`, `trued arm`, `trued disarm`: unattended starts.

use std::path::Path;

use jiff::Timestamp;
use serde::Serialize;

use super::daemon_args::{ArmArgs, DisarmArgs, ScheduleArgs};
use super::failure::CommandFailure;
use super::files::state_folder;
use super::show;
use crate::service::DaemonFile;
use crate::service::machine_state::PlannedSchedule;
use crate::service::schedule::planned_schedules;
use crate::service::schedule_state::new_arming;
use crate::setup::SetupError;
use crate::store::{Arming, Journal, ScheduleSlot};

/// Maximum number of past scheduled starts that are listed for each machine.
const MAX_LISTED_PAST_SLOTS: usize = 20;

#[derive(Serialize)]
struct ScheduleReport {
    machine: String,
    /// Schedules with their next starts; empty if no machine file is given.
    planned: Vec<PlannedSchedule>,
    /// Last arming of each cycle, also if it has ended or an incomplete run has broken it.
    armed: Vec<Arming>,
    /// Past scheduled starts, newest first; at most `MAX_LISTED_PAST_SLOTS`.
    last: Vec<ScheduleSlot>,
}

pub fn schedule_command(args: &ScheduleArgs, state: Option<&Path>) -> Result<(), CommandFailure> {
    let journal = Journal::open(&state_folder(state)?)?;
    let file = match (&args.config, &args.machine) {
        (Some(config), _) => Some(DaemonFile::read(config)),
        (None, Some(machine)) => Some(DaemonFile::for_machine_file(machine)),
        (None, None) => None,
    };
    let all = match (file.transpose().map_err(SetupError::from)?, &args.name) {
        (Some(file), _) => schedules_of_file(file),
        (None, Some(name)) => vec![(name.clone(), Vec::new())],
        (None, None) => journal.machine_names()?.into_iter().map(|name| (name, Vec::new())).collect(),
    };
    let reports = all.into_iter().map(|(machine, planned)| {
        let (armed, last) =
            (journal.last_arming_of_each_cycle(&machine)?, journal.newest_slots(&machine, MAX_LISTED_PAST_SLOTS)?);
        Ok(ScheduleReport { machine, planned, armed, last })
    });
    let reports = reports.collect::<Result<Vec<_>, CommandFailure>>()?;
    match args.json {
        true => show::print_json(&reports)?,
        false => reports.iter().for_each(print_schedule),
    }
    Ok(())
}

/// Name of each machine of the file, with its schedules and their next starts.
fn schedules_of_file(file: DaemonFile) -> Vec<(String, Vec<PlannedSchedule>)> {
    let now = Timestamp::now();
    let machines = file.machines.into_iter();
    machines
        .map(|(machine, config)| (machine.machine.name.clone(), planned_schedules(&config.schedules, now)))
        .collect()
}

fn print_schedule(report: &ScheduleReport) {
    let ScheduleReport { machine, planned, armed, last } = report;
    outln!("{machine}");
    for PlannedSchedule { name, cycle, at, zone, next, .. } in planned {
        let next: Vec<_> = next.iter().map(|next| next.strftime("%a %F %H:%M %Z").to_string()).collect();
        outln!("  {name}: cycle {cycle}, {at} in {zone}; next {}", next.join(", "));
    }
    for Arming { cycle, who, until, ended, broken_by_run: broken, .. } in armed {
        match (ended, broken) {
            (Some((when, why)), _) => outln!("  cycle {cycle} was disarmed at {when}: {why}"),
            (None, Some(run)) => outln!("  cycle {cycle} is not armed: run {run} was not completed"),
            (None, None) => outln!("  cycle {cycle} is armed by {who} until {until}"),
        }
    }
    for ScheduleSlot { schedule, at, outcome, why, run, .. } in last {
        let run = if *run > 0 { format!(" (run {run})") } else { String::new() };
        outln!("  {at} {schedule}: {}{run} {why}", outcome.as_str());
    }
}

pub fn arm_command(args: &ArmArgs, state: Option<&Path>) -> Result<(), CommandFailure> {
    let journal = Journal::open(&state_folder(state)?)?;
    let ArmArgs { machine, cycle, who, until, why } = args;
    check_machine_known(&journal, machine)?;
    let arming = new_arming(machine, *cycle, require_operator_name(who)?, why, until, Timestamp::now());
    let arming = arming.map_err(|why| {
        CommandFailure::new(why, "write the end of the arming as --until 14d or --until 2027-01-31T18:00:00+01:00")
    })?;
    journal.arm_cycle(&arming).wait()?;
    outln!("the schedule may start cycle {cycle} of {machine} until {}", arming.until);
    Ok(())
}

pub fn disarm_command(args: &DisarmArgs, state: Option<&Path>) -> Result<(), CommandFailure> {
    let journal = Journal::open(&state_folder(state)?)?;
    let DisarmArgs { machine, cycle, who, why } = args;
    check_machine_known(&journal, machine)?;
    let ended = journal.disarm_cycles(machine, *cycle, require_operator_name(who)?, why).wait()?;
    outln!("{ended} armed cycles of {machine} were disarmed");
    Ok(())
}

fn require_operator_name(who: &str) -> Result<&str, CommandFailure> {
    match who.trim() {
        "" => Err(CommandFailure::new("the name of the operator is missing", "add your name with --who NAME")),
        who => Ok(who),
    }
}

/// An error if the journal has neither a run nor a schedule nor an arming of `machine`.
fn check_machine_known(journal: &Journal, machine: &str) -> Result<(), CommandFailure> {
    let all = journal.machine_names()?;
    if all.iter().any(|known| known == machine) {
        return Ok(());
    }
    let remedy =
        format!("the journal contains: {}. A new machine is added when `trued serve` starts with it", all.join(", "));
    Err(CommandFailure::new(format!("the journal contains no machine `{machine}`"), remedy))
}
