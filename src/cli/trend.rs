//! `trued trend`: how a machine's values went.

use std::path::Path;

use jiff::tz::TimeZone;
use jiff::{SignedDuration, Timestamp};

use super::args::TrendArgs;
use super::failure::Failure;
use super::files::state_folder;
use super::{Exit, show};
use crate::archive::history::{Series, history};
use crate::decision::trend::{Told, what_changed};
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
    let since =
        Timestamp::now().as_duration() - SignedDuration::from_hours(24 * i64::from(args.days));
    for of_method in all.chunk_by(|one, other| one.method == other.method) {
        print(&machine, of_method, since.as_secs_f64());
    }
    Ok(Exit::Pass)
}

fn print(machine: &str, all: &[Series], since_s: f64) {
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
    let told: Vec<Told<'_>> = all.iter().map(told).collect();
    say!("{}\n", what_changed(&told, since_s, day));
}

fn told(series: &Series) -> Told<'_> {
    Told { symbol: &series.symbol, unit: series.unit.symbol(), trend: &series.trend }
}

/// Here, by this computer's time zone.
fn day(t_s: f64) -> String {
    let at = Timestamp::from_duration(SignedDuration::from_secs_f64(t_s)).unwrap_or_default();
    at.to_zoned(TimeZone::system()).strftime("%-d %B").to_string()
}
