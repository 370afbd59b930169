//! Ticks of a time axis at round local times.

use jiff::tz::TimeZone;
use jiff::{SignedDuration, Timestamp, Zoned};

/// A tick with its label.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct TimeTick {
    /// Unix time, s.
    pub t_s: f64,
    pub label: String,
}

/// Time between two ticks.
#[derive(Debug, Clone, Copy, PartialEq)]
enum TickStep {
    Seconds(i64),
    /// Calendar days, which a change to daylight saving time makes longer or shorter.
    Days(i64),
    Months(i64),
}

/// Maximum number of letters of all labels together; the space after a label counts as one letter.
const MAX_LABEL_LETTERS: usize = 42;

/// From fine to coarse; the first step whose labels have room is used.
const TICK_STEPS: [TickStep; 22] = [
    TickStep::Seconds(1),
    TickStep::Seconds(5),
    TickStep::Seconds(15),
    TickStep::Seconds(30),
    TickStep::Seconds(60),
    TickStep::Seconds(300),
    TickStep::Seconds(900),
    TickStep::Seconds(1800),
    TickStep::Seconds(3600),
    TickStep::Seconds(3 * 3600),
    TickStep::Seconds(6 * 3600),
    TickStep::Seconds(12 * 3600),
    TickStep::Days(1),
    TickStep::Days(2),
    TickStep::Days(7),
    TickStep::Days(14),
    TickStep::Months(1),
    TickStep::Months(3),
    TickStep::Months(6),
    TickStep::Months(12),
    TickStep::Months(5 * 12),
    TickStep::Months(20 * 12),
];

impl TickStep {
    fn label_format(self) -> &'static str {
        match self {
            Self::Seconds(..60) => "%H:%M:%S",
            Self::Seconds(_) => "%-d %b %H:%M",
            Self::Days(_) => "%-d %b",
            Self::Months(_) => "%b %Y",
        }
    }

    /// The tick after `at`; `None` beyond the calendar.
    fn next(self, at: &Zoned) -> Option<Zoned> {
        let span = match self {
            Self::Seconds(seconds) => return at.checked_add(SignedDuration::from_secs(seconds)).ok(),
            Self::Days(days) => jiff::Span::new().days(days),
            Self::Months(months) => jiff::Span::new().months(months),
        };
        at.checked_add(span).ok()
    }
}

/// Ticks from `first_s` to `last_s`, Unix time, in the local time of `zone`: as many as there is room for their labels,
/// at least one.
pub(super) fn time_ticks(first_s: f64, last_s: f64, zone: &TimeZone) -> Vec<TimeTick> {
    let with_step = |step| ticks_at_step(first_s, last_s, step, zone);
    let letters = |ticks: &[TimeTick]| ticks.iter().map(|tick| tick.label.chars().count() + 1).sum::<usize>();
    let mut finest_first = TICK_STEPS.into_iter().map(with_step);
    match finest_first.find(|ticks| letters(ticks) <= MAX_LABEL_LETTERS) {
        Some(ticks) if !ticks.is_empty() => ticks,
        _ => round_time_at_or_before(first_s, TickStep::Seconds(1), zone)
            .map(|at| TimeTick { t_s: first_s, label: at.strftime("%-d %b %Y %H:%M:%S").to_string() })
            .into_iter()
            .collect(),
    }
}

/// Ticks at every `step`, at most [`MAX_LABEL_LETTERS`] + 1.
fn ticks_at_step(first_s: f64, last_s: f64, step: TickStep, zone: &TimeZone) -> Vec<TimeTick> {
    let mut ticks = Vec::new();
    let mut next = round_time_at_or_before(first_s, step, zone);
    while let Some(at) = next.filter(|at| unix_seconds(at) <= last_s && ticks.len() <= MAX_LABEL_LETTERS) {
        if unix_seconds(&at) >= first_s {
            ticks.push(TimeTick { t_s: unix_seconds(&at), label: at.strftime(step.label_format()).to_string() });
        }
        next = step.next(&at);
    }
    ticks
}

/// A round time at or before `first_s`.
fn round_time_at_or_before(first_s: f64, step: TickStep, zone: &TimeZone) -> Option<Zoned> {
    let at = Timestamp::from_second(first_s.floor() as i64).ok()?.to_zoned(zone.clone());
    let midnight = at.start_of_day().ok()?;
    match step {
        TickStep::Seconds(seconds) => {
            let since = at.duration_since(&midnight).as_secs();
            midnight.checked_add(SignedDuration::from_secs(since - since % seconds)).ok()
        }
        TickStep::Days(1..=2) => Some(midnight),
        TickStep::Days(_) => {
            let since_monday = i64::from(midnight.weekday().to_monday_zero_offset());
            midnight.checked_sub(jiff::Span::new().days(since_monday)).ok()
        }
        TickStep::Months(_) => midnight.first_of_year().ok(),
    }
}

/// Name of `zone`, such as `Europe/Berlin`; if it has none, its abbreviation at the Unix time `t_s`.
pub(super) fn zone_name(zone: &TimeZone, t_s: f64) -> String {
    let abbreviation = || {
        let at = Timestamp::from_second(t_s as i64).unwrap_or_default();
        at.to_zoned(zone.clone()).strftime("%Z").to_string()
    };
    zone.iana_name().map_or_else(abbreviation, str::to_owned)
}

fn unix_seconds(at: &Zoned) -> f64 {
    at.timestamp().as_duration().as_secs_f64()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ticks(first: &str, last: &str, zone: &str) -> Vec<String> {
        let seconds = |text: &str| text.parse::<Timestamp>().unwrap().as_duration().as_secs_f64();
        let zone = TimeZone::get(zone).unwrap();
        time_ticks(seconds(first), seconds(last), &zone).into_iter().map(|tick| tick.label).collect()
    }

    #[test]
    fn ticks_are_at_round_local_times() {
        assert_eq!(
            ticks("2026-11-27T04:51:00Z", "2026-11-27T06:20:00Z", "Europe/Berlin"),
            ["27 Nov 06:00", "27 Nov 06:30", "27 Nov 07:00"]
        );
        // Daylight saving time ends on 25 October 2026: the ticks stay at midnight.
        assert_eq!(
            ticks("2026-10-22T12:00:00Z", "2026-10-27T12:00:00Z", "Europe/Berlin"),
            ["23 Oct", "24 Oct", "25 Oct", "26 Oct", "27 Oct"]
        );
        assert_eq!(
            ticks("2026-01-10T00:00:00Z", "2026-05-20T00:00:00Z", "UTC"),
            ["Feb 2026", "Mar 2026", "Apr 2026", "May 2026"]
        );
    }

    #[test]
    fn every_range_has_few_ticks() {
        for exponent in 0..10 {
            let last = 1.7e9 + 10f64.powi(exponent);
            let ticks = time_ticks(1.7e9, last, &TimeZone::UTC);
            let letters: usize = ticks.iter().map(|tick| tick.label.chars().count() + 1).sum();
            assert!(letters <= MAX_LABEL_LETTERS && !ticks.is_empty(), "{ticks:?}");
            assert!(ticks.iter().all(|tick| tick.t_s >= 1.7e9 && tick.t_s <= last), "{ticks:?}");
        }
    }
}
