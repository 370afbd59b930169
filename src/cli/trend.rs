//! `trued trend`: values of a machine over its runs.

use std::path::Path;

use super::args::TrendArgs;
use super::failure::Failure;
use super::files::state_folder;
use super::{Exit, show};
use crate::archive::history::{Series, history, what_changed};
use crate::setup::MachineFile;
use crate::store::Journal;
use machine::record::estimate::Limit;

pub fn trend(args: &TrendArgs, state: Option<&Path>) -> Result<Exit, Failure> {
    let journal = Journal::open(&state_folder(state)?)?;
    let last = || Ok::<_, Failure>(journal.runs()?.pop().map(|run| run.machine));
    let Some(machine) = args.machine.clone().map_or_else(last, |name| Ok(Some(name)))? else {
        say!("no runs yet: `trued run self-calibration` makes one");
        return Ok(Exit::Pass);
    };
    let all = history(&journal, &machine, &tolerance(&journal, &machine)?)?;
    if args.json {
        show::print_json(&all)?;
        return Ok(Exit::Pass);
    }
    if all.is_empty() {
        say!("no finished run of {machine}: `trued runs` lists what there is");
        return Ok(Exit::Pass);
    }
    for of_method in all.chunk_by(|one, other| one.method == other.method) {
        print(&machine, of_method, args.days);
    }
    Ok(Exit::Pass)
}

/// Tolerances in the machine file of the newest run; none if this version cannot read that file.
fn tolerance(journal: &Journal, machine: &str) -> Result<Vec<Limit>, Failure> {
    let runs = journal.runs()?;
    let Some(newest) = runs.iter().rev().find(|run| run.machine == machine) else {
        return Ok(Vec::new());
    };
    let stored = journal.load(newest.id)?;
    let file = MachineFile::stored("machine file", stored.config, &stored.plan.artefact);
    Ok(file.map(|file| file.tolerance).unwrap_or_default())
}

fn print(machine: &str, all: &[Series], days: u32) {
    say!("{} on {machine}", all.first().map_or("", |series| series.method.as_str()));
    say!(
        "{:<12} {:>5} {:>12} {:>9}  {:<5} {:>9}  {:<22} °C",
        "parameter",
        "runs",
        "newest",
        "U",
        "unit",
        "tolerance",
        "control limits"
    );
    for series in all {
        let Some(newest) = series.values.last() else { continue };
        let limits = series.trend.individuals.map(|chart| chart.limits());
        let limits = limits.map_or("too few runs".to_owned(), |[lower, upper]| {
            format!("{lower:.3} to {upper:.3}")
        });
        let tolerance = series.tolerance.map_or("none".to_owned(), |limit| format!("±{limit}"));
        let warmth = newest.temperatures_c.iter().map(|(name, mean)| format!("{name} {mean:.1}"));
        let warmth = warmth.collect::<Vec<_>>().join(", ");
        say!(
            "{:<12} {:>5} {:>12.3} {:>9.3}  {:<5} {tolerance:>9}  {limits:<22} {warmth}",
            series.symbol,
            series.values.len(),
            newest.value,
            newest.expanded,
            series.unit.symbol(),
        );
    }
    say!("{}\n", what_changed(all, days));
}
