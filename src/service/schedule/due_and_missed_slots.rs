//! Slots between two checks of the clock. The clock may have been set, and the checks may have paused for long.

use jiff::{SignedDuration, Timestamp};

use super::calendar::Calendar;

/// Maximum delay of a check after a slot's time, inclusive; beyond it, the slot is missed, although the service was
/// running.
const MAX_SLOT_CHECK_DELAY: SignedDuration = SignedDuration::from_mins(1);
/// Maximum number of missed slots that are reported one by one.
const MAX_REPORTED_MISSED_SLOTS: usize = 50;

/// Slots of one schedule between two checks of the clock.
#[derive(Debug, Default, PartialEq)]
pub struct DueAndMissedSlots {
    /// Missed slots, oldest first; only the newest of them if `has_more_missed` is set.
    pub missed: Vec<Timestamp>,
    /// Whether slots before those in `missed` were missed too.
    pub has_more_missed: bool,
    /// The newest slot, if a check found it in time; earlier slots are never due.
    pub due: Option<Timestamp>,
}

/// Slots since the last check. `last_check`: time of the last check, `None` for the first since the service began.
/// `last_recorded`: last slot that the journal has recorded.
///
/// A slot whose time came while no service was running is missed, even by one second: the return of power must not
/// start a cycle. After the clock was set back, slots are found again; the caller checks which of them have run.
pub fn find_due_and_missed_slots(
    calendar: &Calendar,
    last_check: Option<Timestamp>,
    last_recorded: Timestamp,
    now: Timestamp,
) -> DueAndMissedSlots {
    let from = match last_check {
        None => last_recorded,
        // The checks were at most one minute apart. The caller detects slots repeated by a clock set back.
        Some(last) if now.duration_since(last) <= MAX_SLOT_CHECK_DELAY => last,
        Some(last) => last.max(last_recorded),
    };
    let (mut missed, has_more_missed) = calendar.newest_due_times_between(from, now, MAX_REPORTED_MISSED_SLOTS);
    let is_due = |at: &mut Timestamp| last_check.is_some() && now.duration_since(*at) <= MAX_SLOT_CHECK_DELAY;
    let due = missed.pop_if(is_due);
    DueAndMissedSlots { missed, has_more_missed, due }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LAST_RECORDED_SLOT: &str = "2026-11-23T04:30:00Z";

    /// Schedule: each day at 05:30 in Berlin, 04:30 UTC; the slot of the 23rd is recorded.
    fn missed_and_due_slots(last_check: Option<&str>, now: &str) -> (Vec<String>, Option<String>) {
        let calendar = Calendar::new("30 5 * * *", "Europe/Berlin").unwrap();
        let at = |text: &str| text.parse::<Timestamp>().unwrap();
        let DueAndMissedSlots { missed, has_more_missed, due } =
            find_due_and_missed_slots(&calendar, last_check.map(at), at(LAST_RECORDED_SLOT), at(now));
        assert!(!has_more_missed);
        let day = |at: &Timestamp| at.to_string()[8..16].to_owned();
        (missed.iter().map(day).collect(), due.as_ref().map(day))
    }

    fn no_slots() -> (Vec<String>, Option<String>) {
        (Vec::new(), None)
    }

    #[test]
    fn slot_is_due_once_at_its_time() {
        assert_eq!(missed_and_due_slots(Some("2026-11-24T04:29:58Z"), "2026-11-24T04:29:59.9Z"), no_slots());
        let due = (Vec::new(), Some("24T04:30".to_owned()));
        assert_eq!(missed_and_due_slots(Some("2026-11-24T04:29:59.9Z"), "2026-11-24T04:30:00.9Z"), due);
        assert_eq!(missed_and_due_slots(Some("2026-11-24T04:29:59.9Z"), "2026-11-24T04:30:00Z"), due);
        assert_eq!(missed_and_due_slots(Some("2026-11-24T04:30:00Z"), "2026-11-24T04:30:01Z"), no_slots());
    }

    #[test]
    fn slot_during_a_downtime_is_missed() {
        let one = (vec!["24T04:30".to_owned()], None);
        assert_eq!(
            missed_and_due_slots(None, "2026-11-24T04:30:00Z"),
            one,
            "a slot before the first check is missed, even if its time is now"
        );
        assert_eq!(missed_and_due_slots(None, "2026-11-24T04:40:00Z"), one);
        let two = (vec!["24T04:30".to_owned(), "25T04:30".to_owned()], None);
        assert_eq!(missed_and_due_slots(None, "2026-11-26T00:00:00Z"), two);
        assert_eq!(missed_and_due_slots(None, "2026-11-24T00:00:00Z"), no_slots());
    }

    #[test]
    fn slot_skipped_by_a_clock_jump_or_a_pause_is_missed() {
        let one = (vec!["24T04:30".to_owned()], None);
        assert_eq!(missed_and_due_slots(Some("2026-11-24T04:00:00Z"), "2026-11-24T04:31:01Z"), one);
        let both = (vec!["24T04:30".to_owned()], Some("25T04:30".to_owned()));
        assert_eq!(missed_and_due_slots(Some("2026-11-24T04:00:00Z"), "2026-11-25T04:30:59Z"), both);
    }

    #[test]
    fn recorded_slot_is_due_again_after_clock_set_back_but_never_missed() {
        assert_eq!(missed_and_due_slots(Some("2026-11-23T04:40:00Z"), "2026-11-23T04:10:00Z"), no_slots());
        let again = (Vec::new(), Some("23T04:30".to_owned()));
        assert_eq!(missed_and_due_slots(Some("2026-11-23T04:29:59Z"), "2026-11-23T04:30:00Z"), again);
        assert_eq!(missed_and_due_slots(Some("2026-11-23T04:29:59.7Z"), "2026-11-23T04:30:00.7Z"), again);
        assert_eq!(missed_and_due_slots(Some("2026-11-23T04:00:00Z"), "2026-11-23T04:40:00Z"), no_slots());
        // The clock goes from far back forward over a recorded slot: that slot is not missed.
        assert_eq!(missed_and_due_slots(Some("1970-01-01T00:00:00Z"), "2026-11-23T05:00:00Z"), no_slots());
        assert_eq!(missed_and_due_slots(None, "1970-01-01T00:00:00Z"), no_slots());
    }
}
