//! Trends of the values of one method, on a machine's page.

use minijinja::{Value, context};

use crate::archive::history::{self, ParameterSeries, describe_changes, draw_series_chart};
use crate::report::number::{decimals_for_uncertainty, format_fixed, split_into_base_and_index};
use crate::report::result_row::format_plus_minus_limit;
use machine::record::reading::Temperatures;
use methods::named_symbol::named_symbol;

/// Number of past days whose changes of the values are reported.
const CHANGE_REPORT_DAYS: u32 = 7;

/// Template values of the series of one method.
pub fn trend_values(series: &[ParameterSeries]) -> Value {
    let rows = series.iter().filter_map(|series| {
        let newest = series.values.last()?;
        let decimals = decimals_for_uncertainty(newest.expanded);
        let number = |value: f64| format_fixed(value, decimals);
        let (base, index) = split_into_base_and_index(&series.symbol);
        let name = named_symbol(&series.method, &series.symbol).map(|named| named.name);
        let limits = series.trend.individuals.map(|chart| chart.control_limits());
        Some(context! {
            base,
            index,
            name,
            runs => series.values.len(),
            many => series.values.len() > 1,
            value => number(newest.value),
            expanded => number(newest.expanded),
            unit => series.unit.symbol(),
            limits => limits.map(|ends| ends.map(number).join(" to ")),
            out => series.trend.is_newest_value_outside_limits() == Some(true),
            tolerance => series.tolerance.map(format_plus_minus_limit),
            warmth => temperature_text(&newest.temperatures_c),
            chart => draw_series_chart(series).map(Value::from_safe_string),
        })
    });
    context! {
        thermometers => series.iter().flat_map(|series| &series.values).any(has_temperature),
        method => series.first().map(|series| series.method.as_str()),
        sentence => describe_changes(series, CHANGE_REPORT_DAYS),
        rows => rows.collect::<Vec<_>>(),
    }
}

fn has_temperature(value: &history::RunParameter) -> bool {
    value.temperatures_c.iter().next().is_some()
}

/// Temperatures by thermometer, °C; empty without a reading.
fn temperature_text(all: &Temperatures) -> String {
    let each = all.iter().map(|(name, celsius)| format!("{name} {celsius:.1}"));
    each.collect::<Vec<_>>().join(", ")
}
