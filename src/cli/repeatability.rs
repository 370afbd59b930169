//! `trued repeatability`: scatter and drift of repeated measurements.

use std::path::Path;

use super::failure::CommandFailure;
use super::files::state_folder;
use super::result_args::RepeatabilityArgs;
use super::show;
use crate::report::number::{decimals_for_uncertainty, format_fixed, one_line_symbol};
use crate::run::{RepeatabilityError, RepeatabilityTable, RepetitionKind, repeatability_of_runs};
use crate::store::{Journal, RunId};
use methods::decision::repeatability::{Repeatability, Slope};

impl From<RepeatabilityError> for CommandFailure {
    fn from(error: RepeatabilityError) -> Self {
        match error.remedy() {
            Some(remedy) => Self::new(&error, remedy),
            None => Self::without_remedy(error),
        }
    }
}

pub fn repeatability_command(args: &RepeatabilityArgs, state: Option<&Path>) -> Result<(), CommandFailure> {
    let journal = Journal::open(&state_folder(state)?)?;
    let runs: Vec<RunId> = args.runs.iter().map(|run| RunId(*run)).collect();
    let table = repeatability_of_runs(&journal, &runs)?;
    match args.json {
        true => show::print_json(&table)?,
        false => print_repeatability(&table),
    }
    Ok(())
}

pub fn print_repeatability(table: &RepeatabilityTable) {
    let count = table.parameters.first().map_or(0, |first| first.repetitions);
    let repeated = match table.repeated {
        RepetitionKind::Passes => "passes of the cycle, each identified alone",
        RepetitionKind::Runs => "runs",
    };
    outln!("repeatability of {} on {}: {count} {repeated}", table.method, table.machine);
    outln!(
        "{:<12} {:>12} {:>9} {:>9} {:>7}  {:<5} {:>20}  change per K",
        "parameter",
        "mean",
        "u within",
        "s between",
        "s/u",
        "unit",
        "drift per hour"
    );
    table.parameters.iter().for_each(print_parameter);
    let term = match table.repeated {
        RepetitionKind::Passes => " (repeatability standard deviation s_r of ISO 5725)",
        RepetitionKind::Runs => "",
    };
    outln!("u within: root mean square of the stated standard uncertainties");
    outln!(
        "s between: standard deviation of the values{term}; below u where u contains errors that all repetitions share"
    );
    outln!("!: s is larger than u explains (χ², one-sided 97.5 %): u is too small, or the machine drifts");
    outln!("slopes with U; *: larger than U");
}

fn print_parameter(parameter: &Repeatability) {
    let Repeatability { symbol, unit, mean, within, between, ratio, .. } = parameter;
    let decimals = decimals_for_uncertainty(*within);
    let [mean, within, between] = [mean, within, between].map(|value| format_fixed(*value, decimals));
    let drift = parameter.per_hour.as_ref().map_or("none".to_owned(), slope_text);
    let thermometers = parameter.per_kelvin.iter();
    let thermometers = thermometers.map(|one| format!("{} {}", one.thermometer, slope_text(&one.slope)));
    let thermometers = thermometers.collect::<Vec<_>>().join(", ");
    let mark = if parameter.exceeds_u { "!" } else { " " };
    outln!(
        "{:<12} {mean:>12} {within:>9} {between:>9} {ratio:>6.2}{mark}  {:<5} {drift:>20}  {thermometers}",
        one_line_symbol(symbol),
        unit.symbol()
    );
}

fn slope_text(slope: &Slope) -> String {
    let mark = if slope.is_significant() { "*" } else { "" };
    let decimals = decimals_for_uncertainty(slope.expanded);
    format!("{} ± {}{mark}", format_fixed(slope.slope, decimals), format_fixed(slope.expanded, decimals))
}
