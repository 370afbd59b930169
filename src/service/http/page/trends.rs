//! How the values of one method went, on a machine's page.

use jiff::Timestamp;
use minijinja::{Value, context};

use crate::archive::history::{Series, chart, what_changed};

/// What changed is asked for so long.
const DAYS: u32 = 7;

pub fn of_method(series: &[Series]) -> Value {
    let now = Timestamp::now();
    let rows = series.iter().filter_map(|series| {
        let newest = series.values.last()?;
        let limits = series.trend.individuals.map(|chart| chart.limits());
        Some(context! {
            symbol => series.symbol.as_str(),
            runs => series.values.len(),
            value => format!("{:.1}", newest.value),
            expanded => format!("{:.1}", newest.expanded),
            unit => series.unit.symbol(),
            limits => limits.map(|[lower, upper]| format!("{lower:.1} to {upper:.1}")),
            out => series.trend.is_out() == Some(true),
            chart => chart(series, now).map(Value::from_safe_string),
        })
    });
    context! {
        method => series.first().map(|series| series.method.as_str()),
        sentence => what_changed(series, DAYS),
        rows => rows.collect::<Vec<_>>(),
    }
}
