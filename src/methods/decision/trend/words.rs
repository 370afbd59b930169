//! Changes of the values, in one sentence.

use super::change::MIN_SERIES_LENGTH;
use super::{Change, Kind, Trend};

/// Trend of a value with its symbol and unit.
#[derive(Debug, Clone, Copy)]
pub struct Told<'a> {
    pub symbol: &'a str,
    pub unit: &'a str,
    pub trend: &'a Trend,
}

/// Changes since `since_s`, in one sentence; `day` formats a time as a day. A change counts if it may have
/// happened since then; a drift counts as long as it continues. A value that was not measured since then is
/// reported as not measured, not as unchanged.
pub fn what_changed(all: &[Told<'_>], since_s: f64, day: impl Fn(f64) -> String) -> String {
    let (told, short): (Vec<&Told<'_>>, Vec<&Told<'_>>) =
        all.iter().partition(|told| told.trend.points.len() >= MIN_SERIES_LENGTH);
    let mut parts: Vec<String> = not_measured(all, since_s, &day);
    let (mut same, mut changed) = (0, 0);
    for told in &told {
        let news: Vec<String> = told
            .trend
            .changes
            .iter()
            .filter(|change| told.counts(change, since_s))
            .map(|change| told.in_words(change, &day))
            .chain(told.out())
            .collect();
        same += usize::from(news.is_empty() && told.is_newer(since_s));
        changed += news.len();
        parts.extend(news);
    }
    let rest = match (same, changed) {
        (0, _) => None,
        (_, 0) => Some("nothing changed beyond the scatter".to_owned()),
        (1, _) => Some("the other value stayed as it was".to_owned()),
        (count, _) => Some(format!("the other {count} stayed as they were")),
    };
    parts.extend(rest);
    if !short.is_empty() {
        let symbols = symbols(&short);
        parts.push(format!(
            "of {symbols} there are fewer than {MIN_SERIES_LENGTH} runs, too few to tell"
        ));
    }
    format!("Since {}: {}.", day(since_s), parts.join("; "))
}

/// Sentence about values that were not measured since `since_s`: all of them, or some.
fn not_measured(all: &[Told<'_>], since_s: f64, day: &impl Fn(f64) -> String) -> Vec<String> {
    let old: Vec<&Told<'_>> = all.iter().filter(|told| !told.is_newer(since_s)).collect();
    let newest_s = old.iter().map(|told| told.newest_s()).reduce(f64::max);
    let newest = newest_s.filter(|newest_s| newest_s.is_finite()).map(day);
    let told = newest.map(|newest| match old.len() == all.len() {
        true => format!("nothing was measured, the newest values are of {newest}"),
        false => format!("{} was not measured, the newest is of {newest}", symbols(&old)),
    });
    told.into_iter().collect()
}

fn symbols(of: &[&Told<'_>]) -> String {
    of.iter().map(|told| told.symbol).collect::<Vec<_>>().join(", ")
}

impl Told<'_> {
    fn at_s(&self, index: usize) -> f64 {
        self.trend.points.get(index).map_or(f64::INFINITY, |point| point.t_s)
    }

    fn newest_s(&self) -> f64 {
        self.trend.points.last().map_or(f64::NEG_INFINITY, |point| point.t_s)
    }

    fn is_newer(&self, since_s: f64) -> bool {
        self.newest_s() >= since_s
    }

    fn counts(&self, change: &Change, since_s: f64) -> bool {
        change.kind == Kind::Drift || self.at_s(change.between[1]) > since_s
    }

    fn in_words(&self, change: &Change, day: &impl Fn(f64) -> String) -> String {
        let Change { by, expanded, between, .. } = change;
        let [before, after] = between.map(|index| day(self.at_s(index)));
        let when = match before == after {
            true => format!("on {before}"),
            false => format!("between {before} and {after}"),
        };
        let begun = match change.first {
            0 => "all along".to_owned(),
            _ => format!("begun {when}"),
        };
        let (symbol, unit) = (self.symbol, self.unit);
        match change.kind {
            Kind::Step => {
                format!("{symbol} changed by {by:+.1} {unit} (U {expanded:.1} {unit}), {when}")
            }
            Kind::Drift => format!(
                "{symbol} drifts by {by:+.2} {unit} a day (U {expanded:.2} {unit}), {begun}"
            ),
        }
    }

    /// Sentence about a newest value outside the limits, unless a drift explains it.
    fn out(&self) -> Option<String> {
        let trend = self.trend;
        let newest = trend.points.last()?;
        let drifts = trend.changes.last().is_some_and(|change| change.kind == Kind::Drift);
        let says = trend.is_out() == Some(true) && !drifts;
        says.then(|| {
            let (symbol, unit, value) = (self.symbol, self.unit, newest.value);
            format!("the newest {symbol}, {value:.1} {unit}, lies outside what its history allows")
        })
    }
}
