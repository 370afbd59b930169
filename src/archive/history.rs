//! Identified parameters of a machine over its runs, with their trends and charts.

use std::collections::BTreeSet;

use jiff::tz::TimeZone;
use jiff::{SignedDuration, Timestamp};
use serde::Serialize;

use crate::report::{self, IndividualsChart};
use crate::store::{CompensationEvent, EstimateSelection, FinishedRunResult, Journal, RunId, StoreError};
use machine::record::estimate::{Parameter, ParameterTolerance, Unit};
use machine::record::reading::Temperatures;
use methods::decision::trend::{self, ChangeKind, NamedTrend, Trend, TrendPoint};

/// One parameter of one finished run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RunParameter {
    pub run: RunId,
    /// Start of the run.
    pub started: Timestamp,
    pub value: f64,
    /// Expanded uncertainty of `value`, in the unit of the series.
    #[serde(rename = "U")]
    pub expanded: f64,
    /// Mean of each thermometer over the run; thermometers without a value are left out.
    pub temperatures_c: Temperatures,
}

/// One parameter of one method over the finished runs that identified it, oldest first.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ParameterSeries {
    pub method: String,
    pub symbol: String,
    pub unit: Unit,
    /// Limit of |value| in the present machine file; `None`: the machine file states no limit.
    pub tolerance: Option<f64>,
    /// In the order of the run numbers, with the clock times of the journal; `trend.points` has the corrected times.
    pub values: Vec<RunParameter>,
    pub trend: Trend,
    /// All compensations of the machine that took effect or were undone, also those that do not change this
    /// parameter.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub compensations: Vec<CompensationEvent>,
}

/// Maximum number of runs of each method in a history: twice the number that is searched for changes.
const MAX_RUNS_PER_METHOD: u32 = 200;

/// All series of `machine` over the newest `MAX_RUNS_PER_METHOD` finished runs of each method, grouped by method, in
/// the order of their first value. The value of a run is from the last estimate of this run alone.
///
/// # Errors
/// The journal cannot be read.
pub fn machine_history(
    journal: &Journal,
    machine: &str,
    tolerances: &[ParameterTolerance],
) -> Result<Vec<ParameterSeries>, StoreError> {
    let mut all: Vec<ParameterValues> = Vec::new();
    journal.visit_finished_run_results(machine, MAX_RUNS_PER_METHOD, EstimateSelection::LastOwn, |measured| {
        add_run_values(&mut all, measured)
    })?;
    all.sort_by(|one, other| one.method.cmp(&other.method));
    let compensations = journal.compensation_history(machine)?;
    Ok(all.into_iter().map(|parameter| parameter.into_series(tolerances, &compensations)).collect())
}

/// Values of one parameter so far.
struct ParameterValues {
    method: String,
    symbol: String,
    unit: Unit,
    values: Vec<RunParameter>,
}

/// Adds the identifiable parameters of one run; a parameter that changes its unit begins a new series.
fn add_run_values(all: &mut Vec<ParameterValues>, measured: FinishedRunResult) {
    let FinishedRunResult { run, started, method, parameters, temperatures_c, .. } = measured;
    let known = |parameter: &Parameter| parameter.identifiable && parameter.value.is_finite();
    for parameter in parameters.into_iter().filter(known) {
        let Parameter { symbol, unit, value, expanded, .. } = parameter;
        let value = RunParameter { run, started, value, expanded, temperatures_c: temperatures_c.clone() };
        match all.iter_mut().find(|other| other.method == method && other.symbol == symbol && other.unit == unit) {
            Some(known) => known.values.push(value),
            None => all.push(ParameterValues { method: method.clone(), symbol, unit, values: vec![value] }),
        }
    }
}

impl ParameterValues {
    fn into_series(self, tolerances: &[ParameterTolerance], compensations: &[CompensationEvent]) -> ParameterSeries {
        let Self { method, symbol, unit, values } = self;
        let point = |value: &RunParameter| TrendPoint {
            measurement_time_s: value.started.as_duration().as_secs_f64(),
            value: value.value,
        };
        let trend = Trend::from_points(values.iter().map(point).collect());
        let limit = tolerances.iter().find(|limit| limit.symbol == symbol && limit.unit == unit);
        let (tolerance, compensations) = (limit.map(|limit| limit.limit), compensations.to_vec());
        ParameterSeries { method, symbol, unit, tolerance, values, trend, compensations }
    }
}

/// The changes of the last `days` times 24 h in one sentence, with dates in this computer's time zone.
pub fn describe_changes(all: &[ParameterSeries], days: u32) -> String {
    let trends = all.iter();
    let trends =
        trends.map(|ParameterSeries { symbol, unit, trend, .. }| NamedTrend { symbol, unit: unit.symbol(), trend });
    let since = Timestamp::now().as_duration() - SignedDuration::from_hours(24 * i64::from(days));
    trend::describe_changes(&trends.collect::<Vec<_>>(), since.as_secs_f64(), format_date)
}

/// Date in this computer's time zone, with the year if it is not the present one.
fn format_date(t_s: f64) -> String {
    let at = Timestamp::from_duration(SignedDuration::from_secs_f64(t_s)).unwrap_or_default();
    let [at, now] = [at, Timestamp::now()].map(|at| at.to_zoned(TimeZone::system()));
    let format = if at.year() == now.year() { "%-d %B" } else { "%-d %B %Y" };
    at.strftime(format).to_string()
}

/// Chart of a series as SVG, with the control limits since the last step; `None` without two finite values at
/// different times.
pub fn draw_series_chart(series: &ParameterSeries) -> Option<String> {
    let unix_s = |at: Timestamp| at.as_duration().as_secs_f64();
    let values = &values_with_corrected_times(series);
    let at = |index: usize| values.get(index).map(|value| unix_s(value.started));
    let steps = series.trend.changes.iter().filter(|change| change.kind == ChangeKind::Step);
    // Halfway between the last value before the step and the first one after it.
    let between = |first: usize| Some((at(first.checked_sub(1)?)? + at(first)?) / 2.0);
    let from = steps.clone().map(|step| step.first).max().unwrap_or(0);
    let figure = IndividualsChart {
        symbol: series.symbol.clone(),
        times_values_and_expanded_u: values.iter().map(|v| [unix_s(v.started), v.value, v.expanded]).collect(),
        control_limits_and_first_index: series.trend.individuals.map(|chart| {
            let [lower, upper] = chart.control_limits();
            ([lower, chart.centre, upper], from)
        }),
        level_change_times_s: steps.filter_map(|step| between(step.first)).collect(),
        compensation_times_s: series.compensations.iter().map(|event| unix_s(event.at)).collect(),
        tolerance: series.tolerance,
        temperatures: thermometer_series(values, unix_s),
    };
    figure.draw(series.unit)
}

/// Temperatures of each thermometer with a value in `values`.
fn thermometer_series(values: &[RunParameter], unix_s: impl Fn(Timestamp) -> f64) -> report::TemperatureCurves {
    let named = values.iter().flat_map(|value| value.temperatures_c.iter());
    let names: BTreeSet<&str> = named.map(|(name, _)| name).collect();
    let of = |name: &str| {
        let at = |value: &RunParameter| (unix_s(value.started), value.temperatures_c.get(name));
        (name.to_owned(), values.iter().map(at).collect())
    };
    names.into_iter().map(of).collect()
}

/// Values in the order of measurement, with wrong clock times replaced; see [`Trend::from_points`].
fn values_with_corrected_times(series: &ParameterSeries) -> Vec<RunParameter> {
    let at = |point: &TrendPoint| {
        Timestamp::from_duration(SignedDuration::from_secs_f64(point.measurement_time_s)).unwrap_or_default()
    };
    let both = series.values.iter().zip(&series.trend.points);
    both.map(|(value, point)| RunParameter { started: at(point), ..value.clone() }).collect()
}
