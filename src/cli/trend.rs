//! `trued trend`: how a machine's values went.

use std::path::Path;

use super::args::TrendArgs;
use super::failure::Failure;
use super::files::state_folder;
use super::{Exit, show};
use crate::archive::history::{Series, history, what_changed};
use crate::store::Journal;

pub fn trend(args: &TrendArgs, state: Option<&Path>) -> Result<Exit, Failure> {
    let journal = Journal::open(&state_folder(state)?)?;
    let last = || Ok::<_, Failure>(journal.runs()?.pop().map(|run| run.machine));
    let Some(machine) = args.machine.clone().map_or_else(last, |name| Ok(Some(name)))? else {
        say!("no runs yet: `trued run self-calibration` makes one");
        return Ok(Exit::Pass);
    };
    let all = history(&journal, &machine)?;
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

fn print(machine: &str, all: &[Series], days: u32) {
    say!("{} on {machine}", all.first().map_or("", |series| series.method.as_str()));
    say!(
        "{:<12} {:>5} {:>12} {:>9}  {:<5} control limits",
        "parameter",
        "runs",
        "newest",
        "U",
        "unit"
    );
    for series in all {
        let Some(newest) = series.values.last() else { continue };
        let limits = series.trend.individuals.map(|chart| chart.limits());
        let limits = limits.map_or("too few runs".to_owned(), |[lower, upper]| {
            format!("{lower:.3} to {upper:.3}")
        });
        say!(
            "{:<12} {:>5} {:>12.3} {:>9.3}  {:<5} {limits}",
            series.symbol,
            series.values.len(),
            newest.value,
            newest.expanded,
            series.unit.symbol(),
        );
    }
    say!("{}\n", what_changed(all, days));
}
