//! Detects other identifiers on the bus while no frame of the own identifier arrives. Without this check, a wrong
//! identifier cannot be distinguished from a silent sensor.

use std::time::{Duration, Instant};

use super::Id;

/// Silence of the own identifier after which the socket accepts other identifiers, and the time for which it does
/// so.
const OWN_ID_SILENCE: Duration = Duration::from_millis(300);
const ACCEPT_ALL_TIME: Duration = Duration::from_secs(1);
/// Maximum number of reported identifiers.
const MAX_REPORTED_IDS: usize = 8;

/// Which identifiers the socket accepts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum IdFilterState {
    /// Only the own identifier.
    Own,
    All,
    /// Other identifiers have been accepted since the last own frame.
    CanEvent,
}

pub(super) struct ForeignIdDetector {
    ears: IdFilterState,
    /// Time of the last own frame, or the time at which the socket began to accept other identifiers.
    since: Instant,
    told: Vec<Id>,
}

/// Filter that the socket must use from now on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum IdFilterChange {
    All,
    Own,
}

impl ForeignIdDetector {
    pub fn new(now: Instant) -> Self {
        Self { ears: IdFilterState::Own, since: now, told: Vec::new() }
    }

    /// Records a frame of the own identifier.
    pub fn own(&mut self, now: Instant) -> Option<IdFilterChange> {
        let was = self.ears;
        *self = Self::new(now);
        (was == IdFilterState::All).then_some(IdFilterChange::Own)
    }

    /// Returns the filter that must be set because of the elapsed time; `None` if it stays.
    pub fn passed(&mut self, now: Instant) -> Option<IdFilterChange> {
        match self.ears {
            IdFilterState::Own if now - self.since >= OWN_ID_SILENCE => {
                (self.ears, self.since) = (IdFilterState::All, now);
                Some(IdFilterChange::All)
            }
            IdFilterState::All
                if now - self.since >= ACCEPT_ALL_TIME || self.told.len() == MAX_REPORTED_IDS =>
            {
                self.ears = IdFilterState::CanEvent;
                Some(IdFilterChange::Own)
            }
            _ => None,
        }
    }

    /// Records a frame of another identifier. Returns whether it must be reported.
    pub fn is_news(&mut self, id: Id) -> bool {
        let news = self.ears == IdFilterState::All
            && self.told.len() < MAX_REPORTED_IDS
            && !self.told.contains(&id);
        if news {
            self.told.push(id);
        }
        news
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn others_are_listened_to_once_after_each_silence() {
        let begun = Instant::now();
        let at = |ms| begun + Duration::from_millis(ms);
        let id = |raw| Id::new(raw, false).unwrap();
        let mut others = ForeignIdDetector::new(begun);
        assert_eq!(others.passed(at(299)), None);
        assert!(!others.is_news(id(7)), "what the filter let through before it was set");
        assert_eq!(others.passed(at(300)), Some(IdFilterChange::All));
        assert!(others.is_news(id(7)) && !others.is_news(id(7)) && others.is_news(id(8)));
        assert_eq!(others.passed(at(1299)), None);
        assert_eq!(others.passed(at(1300)), Some(IdFilterChange::Own));
        assert_eq!(others.passed(at(9000)), None, "not again and again");
        assert_eq!(others.own(at(9000)), None);
        assert_eq!(others.passed(at(9300)), Some(IdFilterChange::All));
        assert_eq!(others.own(at(9301)), Some(IdFilterChange::Own), "at once");
        // On a busy bus, the socket accepts other identifiers only until enough are found.
        assert_eq!(others.passed(at(9601)), Some(IdFilterChange::All));
        assert_eq!((0..20).filter(|raw| others.is_news(id(*raw))).count(), MAX_REPORTED_IDS);
        assert_eq!(others.passed(at(9602)), Some(IdFilterChange::Own));
    }
}
