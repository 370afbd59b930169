//! Trends of the values of one method, on a machine's page.

use jiff::Timestamp;
use minijinja::{Value, context};

use crate::archive::history::{self, ParameterSeries, describe_changes, draw_series_chart};
use machine::record::reading::Temperatures;

/// Number of days over which changes are reported.
const CHANGE_REPORT_DAYS: u32 = 7;

pub fn trend_values(series: &[ParameterSeries]) -> Value {
    let now = Timestamp::now();
    let rows = series.iter().filter_map(|series| {
        let newest = series.values.last()?;
        let limits = series.trend.individuals.map(|chart| chart.control_limits());
        Some(context! {
            symbol => series.symbol.as_str(),
            runs => series.values.len(),
            value => format!("{:.1}", newest.value),
            expanded => format!("{:.1}", newest.expanded),
            unit => series.unit.symbol(),
            limits => limits.map(|[lower, upper]| format!("{lower:.1} to {upper:.1}")),
            out => series.trend.is_newest_value_outside_limits() == Some(true),
            tolerance => series.tolerance.map(|limit| format!("±{limit}")),
            warmth => temperature_text(&newest.temperatures_c),
            chart => draw_series_chart(series, now).map(Value::from_safe_string),
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
