//! Times at which a schedule is due: a cron pattern in local time, with daylight saving time.

use croner::Cron;
use croner::parser::{CronParser, Seconds, Year};
use jiff::tz::TimeZone;
use jiff::{Timestamp, Zoned};

/// A cron pattern and a time zone, for example `30 5 * * 1-5` in `Europe/Berlin`.
///
/// A fixed time that does not exist in spring, because the clock skips it, is due once, at the first instant after
/// the gap. A fixed time that occurs twice in autumn is due once, at its first occurrence. A pattern with `*` or
/// steps in its minutes or hours follows local time: it is not due in the gap, and it is due in both repeated hours.
#[derive(Debug, Clone)]
pub struct Calendar {
    cron: Cron,
    zone: TimeZone,
}

impl Calendar {
    /// Parses a pattern of five fields (minute, hour, day, month, weekday) and the name of a time zone. An error, as
    /// a message for the user, also if the pattern is never due.
    pub fn new(pattern: &str, zone: &str) -> Result<Self, String> {
        let parser = CronParser::builder().seconds(Seconds::Disallowed).year(Year::Disallowed).build();
        let cron = parser.parse(pattern).map_err(|error| {
            format!(
                "at = \"{pattern}\" is not a pattern of minute, hour, day, month and weekday ({error}): for example, \
                 \"30 5 * * 1-5\" means 05:30 from Monday to Friday"
            )
        })?;
        let zone = TimeZone::get(zone).map_err(|_| {
            format!("zone = \"{zone}\" is not a known time zone: use a name such as \"Europe/Berlin\" or \"UTC\"")
        })?;
        let calendar = Self { cron, zone };
        let never = calendar.due_times_after(Timestamp::now()).next().is_none();
        match never {
            true => Err(format!("at = \"{pattern}\" is never due: the calendar has no such day")),
            false => Ok(calendar),
        }
    }

    /// Due times after `instant`, without end.
    pub fn due_times_after(&self, instant: Timestamp) -> impl Iterator<Item = Zoned> {
        let first = Some(self.to_local(instant));
        let next = |last: &Zoned| self.cron.find_next_occurrence(last, false).ok();
        std::iter::successors(first, next).skip(1)
    }

    /// Due times after `from` and until `to`, oldest first: only the newest `max_count` of them, and whether there were
    /// more.
    pub fn newest_due_times_between(&self, from: Timestamp, to: Timestamp, max_count: usize) -> (Vec<Timestamp>, bool) {
        if to <= from {
            return (Vec::new(), false);
        }
        // Backwards from the end, so that a window of years costs no more than the requested times.
        let mut inclusive = true;
        let mut last = self.to_local(to);
        let mut times = Vec::new();
        while let Ok(before) = self.cron.find_previous_occurrence(&last, inclusive) {
            let at = before.timestamp();
            if at <= from || times.len() > max_count {
                break;
            }
            times.push(at);
            (last, inclusive) = (before, false);
        }
        let more = times.len() > max_count;
        times.truncate(max_count);
        times.reverse();
        (times, more)
    }

    fn to_local(&self, instant: Timestamp) -> Zoned {
        instant.to_zoned(self.zone.clone())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse_timestamp(text: &str) -> Timestamp {
        text.parse().unwrap()
    }

    fn due_times(pattern: &str, zone: &str, from: &str, to: &str) -> Vec<String> {
        let calendar = Calendar::new(pattern, zone).unwrap();
        let (back, more) = calendar.newest_due_times_between(parse_timestamp(from), parse_timestamp(to), 100);
        assert!(!more);
        let forth = calendar.due_times_after(parse_timestamp(from)).map(|next| next.timestamp());
        let forth: Vec<Timestamp> = forth.take_while(|next| *next <= parse_timestamp(to)).collect();
        assert_eq!(back, forth, "forward and backward search must find the same times");
        back.iter().map(Timestamp::to_string).collect()
    }

    // The expected times are those of Python's zoneinfo, `datetime(2027, 3, 27, 2, 30,
    // tzinfo=ZoneInfo("Europe/Berlin")).astimezone(timezone.utc)`, with fold=0 where a time occurs twice. Those of
    // Berlin also agree with `date -d`, which takes the later of two.

    #[test]
    fn time_skipped_by_daylight_saving_is_due_once_after_the_gap() {
        let times = due_times("30 2 * * *", "Europe/Berlin", "2027-03-26T12:00:00Z", "2027-03-29T12:00:00Z");
        let expected = ["2027-03-27T01:30:00Z", "2027-03-28T01:00:00Z", "2027-03-29T00:30:00Z"];
        assert_eq!(times, expected);
    }

    #[test]
    fn time_repeated_by_daylight_saving_is_due_once() {
        let times = due_times("30 2 * * *", "Europe/Berlin", "2027-10-29T12:00:00Z", "2027-11-01T12:00:00Z");
        let expected = ["2027-10-30T00:30:00Z", "2027-10-31T00:30:00Z", "2027-11-01T01:30:00Z"];
        assert_eq!(times, expected);
    }

    #[test]
    fn local_hour_stays_through_both_daylight_saving_changes() {
        let spring = due_times("30 5 * * *", "Europe/Berlin", "2027-03-26T12:00:00Z", "2027-03-28T12:00:00Z");
        assert_eq!(spring, ["2027-03-27T04:30:00Z", "2027-03-28T03:30:00Z"]);
        let autumn = due_times("30 5 * * *", "Europe/Berlin", "2027-10-29T12:00:00Z", "2027-10-31T12:00:00Z");
        assert_eq!(autumn, ["2027-10-30T03:30:00Z", "2027-10-31T04:30:00Z"]);
        // A zone with a change of half an hour, in the southern hemisphere.
        let lord_howe = due_times("15 2 * * *", "Australia/Lord_Howe", "2027-10-01T12:00:00Z", "2027-10-04T00:00:00Z");
        assert_eq!(lord_howe, ["2027-10-01T15:45:00Z", "2027-10-02T15:30:00Z", "2027-10-03T15:15:00Z"]);
    }

    #[test]
    fn half_hour_pattern_follows_local_time_through_both_changes() {
        let spring = due_times("*/30 * * * *", "Europe/Berlin", "2027-03-28T00:00:00Z", "2027-03-28T02:00:00Z");
        let expected = ["2027-03-28T00:30:00Z", "2027-03-28T01:00:00Z", "2027-03-28T01:30:00Z", "2027-03-28T02:00:00Z"];
        assert_eq!(spring, expected);
        let autumn = due_times("*/30 2 * * *", "Europe/Berlin", "2027-10-30T23:00:00Z", "2027-10-31T03:00:00Z");
        let expected = ["2027-10-31T00:00:00Z", "2027-10-31T00:30:00Z", "2027-10-31T01:00:00Z", "2027-10-31T01:30:00Z"];
        assert_eq!(autumn, expected);
    }

    #[test]
    fn only_the_newest_due_times_of_a_long_period_are_returned() {
        let calendar = Calendar::new("* * * * *", "UTC").unwrap();
        let (times, more) = calendar.newest_due_times_between(
            parse_timestamp("1970-01-01T00:00:00Z"),
            parse_timestamp("2027-01-01T00:00:30Z"),
            3,
        );
        let expected = ["2026-12-31T23:58:00Z", "2026-12-31T23:59:00Z", "2027-01-01T00:00:00Z"];
        assert_eq!((times, more), (expected.map(parse_timestamp).to_vec(), true));
        assert_eq!(
            calendar.newest_due_times_between(
                parse_timestamp("2027-01-01T00:00:00Z"),
                parse_timestamp("2027-01-01T00:00:59Z"),
                3
            ),
            (vec![], false)
        );
    }

    #[test]
    fn invalid_patterns_and_zones_are_refused_with_a_hint() {
        for (pattern, zone, words) in [
            ("30 5 * *", "UTC", "30 5 * * 1-5"),
            ("0 30 5 * * *", "UTC", "30 5 * * 1-5"),
            ("61 5 * * *", "UTC", "30 5 * * 1-5"),
            ("30 5 * * *", "Europe/Berlim", "Europe/Berlin"),
            ("30 5 30 2 *", "UTC", "no such day"),
        ] {
            let error = Calendar::new(pattern, zone).unwrap_err();
            assert!(error.contains(words), "{error}");
        }
    }
}
