//! What a look at the clock finds. The clock may have been set, and nobody may have looked for long.

use jiff::{SignedDuration, Timestamp};

use super::calendar::Calendar;

/// What is found later than this after its time was missed, although the service was there.
const IN_TIME: SignedDuration = SignedDuration::from_mins(1);
/// As many are told one by one.
const MOST: usize = 50;

#[derive(Debug, Default, PartialEq)]
pub struct Window {
    /// Oldest first; the newest of them, where there are `more`.
    pub missed: Vec<Timestamp>,
    pub more: bool,
    pub due: Option<Timestamp>,
}

/// `looked`: when this was asked before, `None` for the first time since the service began. `seen`: up to
/// which slot the journal knows.
///
/// What came while no service was there is missed, however short ago: nothing runs because the power
/// came back. A clock that was set back finds its slots once more: whoever asks knows which of them ran.
pub fn window(
    calendar: &Calendar,
    looked: Option<Timestamp>,
    seen: Timestamp,
    now: Timestamp,
) -> Window {
    let from = match looked {
        None => seen,
        // Step by step. What comes once more after the clock was set back is known by its slot.
        Some(last) if now.duration_since(last) <= IN_TIME => last,
        Some(last) => last.max(seen),
    };
    let (mut missed, more) = calendar.between(from, now, MOST);
    let in_time = |at: &Timestamp| now.duration_since(*at) <= IN_TIME;
    let due = missed.last().copied().filter(|at| looked.is_some() && in_time(at));
    if due.is_some() {
        missed.pop();
    }
    Window { missed, more, due }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SEEN: &str = "2026-11-23T04:30:00Z";

    /// Each day at 05:30 in Berlin, 04:30 UTC; that of the 23rd is seen to.
    fn found(looked: Option<&str>, now: &str) -> (Vec<String>, Option<String>) {
        let calendar = Calendar::new("30 5 * * *", "Europe/Berlin").unwrap();
        let at = |text: &str| text.parse::<Timestamp>().unwrap();
        let Window { missed, more, due } = window(&calendar, looked.map(at), at(SEEN), at(now));
        assert!(!more);
        let day = |at: &Timestamp| at.to_string()[8..16].to_owned();
        (missed.iter().map(day).collect(), due.as_ref().map(day))
    }

    fn none() -> (Vec<String>, Option<String>) {
        (Vec::new(), None)
    }

    #[test]
    fn a_slot_is_due_when_its_time_comes_and_once() {
        assert_eq!(found(Some("2026-11-24T04:29:58Z"), "2026-11-24T04:29:59.9Z"), none());
        let due = (Vec::new(), Some("24T04:30".to_owned()));
        assert_eq!(found(Some("2026-11-24T04:29:59.9Z"), "2026-11-24T04:30:00.9Z"), due);
        assert_eq!(found(Some("2026-11-24T04:29:59.9Z"), "2026-11-24T04:30:00Z"), due);
        assert_eq!(found(Some("2026-11-24T04:30:00Z"), "2026-11-24T04:30:01Z"), none());
    }

    #[test]
    fn what_came_while_nobody_was_there_is_missed() {
        let one = (vec!["24T04:30".to_owned()], None);
        assert_eq!(found(None, "2026-11-24T04:30:00Z"), one, "even if it is now");
        assert_eq!(found(None, "2026-11-24T04:40:00Z"), one);
        let two = (vec!["24T04:30".to_owned(), "25T04:30".to_owned()], None);
        assert_eq!(found(None, "2026-11-26T00:00:00Z"), two);
        assert_eq!(found(None, "2026-11-24T00:00:00Z"), none());
    }

    #[test]
    fn a_clock_that_goes_forward_or_a_service_that_stood_still_has_missed_it() {
        let one = (vec!["24T04:30".to_owned()], None);
        assert_eq!(found(Some("2026-11-24T04:00:00Z"), "2026-11-24T04:31:01Z"), one);
        let both = (vec!["24T04:30".to_owned()], Some("25T04:30".to_owned()));
        assert_eq!(found(Some("2026-11-24T04:00:00Z"), "2026-11-25T04:30:59Z"), both);
    }

    #[test]
    fn a_clock_that_is_set_back_finds_nothing_at_once_and_its_slot_again_in_time() {
        assert_eq!(found(Some("2026-11-23T04:40:00Z"), "2026-11-23T04:10:00Z"), none());
        let again = (Vec::new(), Some("23T04:30".to_owned()));
        assert_eq!(found(Some("2026-11-23T04:29:59Z"), "2026-11-23T04:30:00Z"), again);
        assert_eq!(found(Some("2026-11-23T04:29:59.7Z"), "2026-11-23T04:30:00.7Z"), again);
        assert_eq!(found(Some("2026-11-23T04:00:00Z"), "2026-11-23T04:40:00Z"), none());
        // From far back forward over what is seen to: that is not missed.
        assert_eq!(found(Some("1970-01-01T00:00:00Z"), "2026-11-23T05:00:00Z"), none());
        assert_eq!(found(None, "1970-01-01T00:00:00Z"), none());
    }
}
