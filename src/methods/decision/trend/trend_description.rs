//! Text on the changes of the values, as one sentence.

use super::change_detection::MIN_CHANGE_DETECTION_VALUES;
use super::{Change, ChangeKind, Trend};

/// Trend of a value with its symbol and unit.
#[derive(Debug, Clone, Copy)]
pub struct NamedTrend<'a> {
    pub symbol: &'a str,
    pub unit: &'a str,
    pub trend: &'a Trend,
}

/// Changes since `since_s`, in one sentence; `format_day` formats a time as a day. A change counts if it may have
/// happened since then; a drift counts as long as it continues. A value that was not measured since then is
/// reported as not measured, not as unchanged.
pub fn describe_changes(all: &[NamedTrend<'_>], since_s: f64, format_day: impl Fn(f64) -> String) -> String {
    let (named, short): (Vec<&NamedTrend<'_>>, Vec<&NamedTrend<'_>>) =
        all.iter().partition(|named| named.trend.points.len() >= MIN_CHANGE_DETECTION_VALUES);
    let mut parts: Vec<String> = describe_values_not_measured_since(since_s, all, &format_day).into_iter().collect();
    let (mut same, mut changed) = (0, 0);
    for named in &named {
        let recent = named.trend.changes.iter().filter(|change| named.is_recent_change(change, since_s));
        let changes = recent.map(|change| named.describe_change(change, &format_day));
        let news: Vec<String> = changes.chain(named.describe_outlier()).collect();
        same += usize::from(news.is_empty() && named.is_measured_since(since_s));
        changed += news.len();
        parts.extend(news);
    }
    let rest = match (same, changed) {
        (0, _) => None,
        (_, 0) => Some("no change beyond the scatter".to_owned()),
        (1, _) => Some("the other value did not change".to_owned()),
        (count, _) => Some(format!("the other {count} values did not change")),
    };
    parts.extend(rest);
    if !short.is_empty() {
        let symbols = join_symbols(&short);
        parts.push(format!("fewer than {MIN_CHANGE_DETECTION_VALUES} runs of {symbols}, too few for a trend"));
    }
    format!("Since {}: {}.", format_day(since_s), parts.join("; "))
}

/// Text about the values that were not measured since `since_s`, with the day of the newest of them.
fn describe_values_not_measured_since(
    since_s: f64,
    all: &[NamedTrend<'_>],
    format_day: &impl Fn(f64) -> String,
) -> Option<String> {
    let old: Vec<&NamedTrend<'_>> = all.iter().filter(|named| !named.is_measured_since(since_s)).collect();
    let newest_s = old.iter().map(|named| named.newest_time_s()).reduce(f64::max);
    let newest = newest_s.filter(|newest_s| newest_s.is_finite()).map(format_day);
    newest.map(|newest| match old.len() == all.len() {
        true => format!("no run; the newest values are from {newest}"),
        false => format!("no new value of {}, the newest value is from {newest}", join_symbols(&old)),
    })
}

fn join_symbols(of: &[&NamedTrend<'_>]) -> String {
    of.iter().map(|named| named.symbol).collect::<Vec<_>>().join(", ")
}

impl NamedTrend<'_> {
    fn point_time_s(&self, index: usize) -> f64 {
        self.trend.points.get(index).map_or(f64::INFINITY, |point| point.measurement_time_s)
    }

    fn newest_time_s(&self) -> f64 {
        self.trend.points.last().map_or(f64::NEG_INFINITY, |point| point.measurement_time_s)
    }

    fn is_measured_since(&self, since_s: f64) -> bool {
        self.newest_time_s() >= since_s
    }

    /// Whether the change is a drift, or a step that may have happened after `since_s`.
    fn is_recent_change(&self, change: &Change, since_s: f64) -> bool {
        change.kind == ChangeKind::Drift || self.point_time_s(change.between[1]) > since_s
    }

    fn describe_change(&self, change: &Change, format_day: &impl Fn(f64) -> String) -> String {
        let Change { by, expanded, between, .. } = change;
        let [before, after] = between.map(|index| format_day(self.point_time_s(index)));
        let when = match before == after {
            true => format!("on {before}"),
            false => format!("between {before} and {after}"),
        };
        let begun = match change.first {
            0 => "since the first run".to_owned(),
            _ => format!("started {when}"),
        };
        let (symbol, unit) = (self.symbol, self.unit);
        match change.kind {
            ChangeKind::Step => {
                format!("{symbol} changed by {by:+.1} {unit} (U {expanded:.1} {unit}), {when}")
            }
            ChangeKind::Drift => format!("{symbol} drifts by {by:+.2} {unit} a day (U {expanded:.2} {unit}), {begun}"),
        }
    }

    /// Sentence about a newest value outside the limits, unless a drift explains it.
    fn describe_outlier(&self) -> Option<String> {
        let trend = self.trend;
        let newest = trend.points.last()?;
        let drifts = trend.changes.last().is_some_and(|change| change.kind == ChangeKind::Drift);
        let is_reported = trend.is_newest_value_outside_limits() == Some(true) && !drifts;
        is_reported.then(|| {
            let (symbol, unit, value) = (self.symbol, self.unit, newest.value);
            format!("the newest {symbol}, {value:.1} {unit}, is outside the control limits")
        })
    }
}
