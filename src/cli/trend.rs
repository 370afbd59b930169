//! `trued trend`: prints the parameters of a machine over its runs, and their changes.

use std::path::Path;

use super::args::TrendArgs;
use super::failure::CommandFailure;
use super::files::state_folder;
use super::show;
use crate::archive::history::{ParameterSeries, describe_changes, machine_history};
use crate::report::number::{decimals_for_uncertainty, format_fixed, one_line_symbol, with_one_line_symbols};
use crate::report::result_row::format_plus_minus_limit;
use crate::setup::MachineFile;
use crate::store::{CompensationEvent, Journal};
use machine::record::estimate::ParameterTolerance;

pub fn trend_command(args: &TrendArgs, state: Option<&Path>) -> Result<(), CommandFailure> {
    let journal = Journal::open(&state_folder(state)?)?;
    let last = || Ok::<_, CommandFailure>(journal.runs()?.pop().map(|run| run.machine));
    let Some(machine) = args.machine.clone().map_or_else(last, |name| Ok(Some(name)))? else {
        outln!("no runs yet: start one with `trued run self-calibration`");
        return Ok(());
    };
    let all = machine_history(&journal, &machine, &tolerances_of_newest_run(&journal, &machine)?)?;
    if args.json {
        return show::print_json(&all);
    }
    if all.is_empty() {
        outln!("no finished run of {machine}: `trued runs` lists all runs");
        return Ok(());
    }
    for of_method in all.chunk_by(|one, other| one.method == other.method) {
        print_trend(&machine, of_method, args.days);
    }
    Ok(())
}

/// Tolerances in the machine file of the newest run; none if this version cannot read that file.
fn tolerances_of_newest_run(journal: &Journal, machine: &str) -> Result<Vec<ParameterTolerance>, CommandFailure> {
    let runs = journal.runs()?;
    let Some(newest) = runs.iter().rev().find(|run| run.machine == machine) else {
        return Ok(Vec::new());
    };
    let stored = journal.load_run(newest.id)?;
    let file = MachineFile::from_stored_run("machine file", stored.machine_file_text, &stored.plan.artefact);
    Ok(file.map(|file| file.tolerances).unwrap_or_default())
}

/// Prints the series of one method.
fn print_trend(machine: &str, all: &[ParameterSeries], days: u32) {
    outln!("{} on {machine}", all.first().map_or("", |series| series.method.as_str()));
    outln!(
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
        let decimals = decimals_for_uncertainty(newest.expanded);
        let number = |value: f64| format_fixed(value, decimals);
        let limits = series.trend.individuals.map(|chart| chart.control_limits());
        let limits = limits.map_or("too few runs".to_owned(), |ends| ends.map(number).join(" to "));
        let tolerance = series.tolerance.map_or("none".to_owned(), format_plus_minus_limit);
        let warmth = newest.temperatures_c.iter().map(|(name, mean)| format!("{name} {mean:.1}"));
        let warmth = warmth.collect::<Vec<_>>().join(", ");
        outln!(
            "{:<12} {:>5} {:>12} {:>9}  {:<5} {tolerance:>9}  {limits:<22} {warmth}",
            one_line_symbol(&series.symbol),
            series.values.len(),
            number(newest.value),
            number(newest.expanded),
            series.unit.symbol(),
        );
    }
    for CompensationEvent { id, target, run, is_undone, at } in
        all.iter().take(1).flat_map(|series| &series.compensations)
    {
        let what = if *is_undone { "undone" } else { "written" };
        outln!("compensation {id} ({target}) from run {run}: {what} {at:.0}");
    }
    outln!("{}\n", with_one_line_symbols(&describe_changes(all, days)));
}
