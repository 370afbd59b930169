//! Detects other identifiers on the bus while no frame of the own identifier (of the receiver) arrives. Without this
//! check, a wrong identifier cannot be distinguished from a silent sensor.

use std::time::{Duration, Instant};

use super::CanId;

/// Silence of the own identifier after which the socket accepts other identifiers, once until the next own frame.
const OWN_ID_SILENCE_BEFORE_SCAN: Duration = Duration::from_millis(300);
/// Maximum time for which the socket accepts other identifiers.
const MAX_ACCEPT_ALL_IDS_TIME: Duration = Duration::from_secs(1);
/// Maximum number of reported identifiers.
const MAX_REPORTED_FOREIGN_IDS: usize = 8;

/// Which identifiers the socket accepts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum IdFilterState {
    /// Only the own identifier.
    OwnId,
    AllIds,
    /// Only the own identifier; the socket has already accepted all identifiers once since the last own frame.
    OwnIdAfterScan,
}

/// Decides which identifiers the socket accepts, and which other identifiers are reported.
pub(super) struct ForeignIdDetector {
    filter_state: IdFilterState,
    /// Time of the last own frame, or the time at which the socket began to accept other identifiers.
    filter_timer_start: Instant,
    /// Other identifiers found since the last own frame, each once; at most `MAX_REPORTED_FOREIGN_IDS`.
    reported_ids: Vec<CanId>,
}

/// Filter that the socket must use from now on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum IdFilterChange {
    AllIds,
    OwnId,
}

impl ForeignIdDetector {
    pub fn new(now: Instant) -> Self {
        Self { filter_state: IdFilterState::OwnId, filter_timer_start: now, reported_ids: Vec::new() }
    }

    /// Records a frame of the own identifier. Returns the filter that must be set now; `None`: the filter stays.
    pub fn record_own_frame(&mut self, now: Instant) -> Option<IdFilterChange> {
        let previous = self.filter_state;
        *self = Self::new(now);
        (previous == IdFilterState::AllIds).then_some(IdFilterChange::OwnId)
    }

    /// Returns the filter that must be set now, because of the elapsed time or because enough other identifiers were
    /// found. `None`: the filter stays.
    pub fn due_filter_change(&mut self, now: Instant) -> Option<IdFilterChange> {
        match self.filter_state {
            IdFilterState::OwnId if now - self.filter_timer_start >= OWN_ID_SILENCE_BEFORE_SCAN => {
                (self.filter_state, self.filter_timer_start) = (IdFilterState::AllIds, now);
                Some(IdFilterChange::AllIds)
            }
            IdFilterState::AllIds
                if now - self.filter_timer_start >= MAX_ACCEPT_ALL_IDS_TIME
                    || self.reported_ids.len() == MAX_REPORTED_FOREIGN_IDS =>
            {
                self.filter_state = IdFilterState::OwnIdAfterScan;
                Some(IdFilterChange::OwnId)
            }
            _ => None,
        }
    }

    /// Records a frame of another identifier. Returns whether the frame must be reported: only the first frame of
    /// each identifier, and only while the filter accepts all identifiers and the maximum number is not reached.
    pub fn record_new_foreign_id(&mut self, id: CanId) -> bool {
        let is_new = self.filter_state == IdFilterState::AllIds
            && self.reported_ids.len() < MAX_REPORTED_FOREIGN_IDS
            && !self.reported_ids.contains(&id);
        if is_new {
            self.reported_ids.push(id);
        }
        is_new
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn foreign_ids_are_accepted_once_after_each_silence() {
        let start = Instant::now();
        let at = |ms| start + Duration::from_millis(ms);
        let id = |raw| CanId::new(raw, false).unwrap();
        let mut detector = ForeignIdDetector::new(start);
        assert_eq!(detector.due_filter_change(at(299)), None);
        assert!(!detector.record_new_foreign_id(id(7)), "what the filter let through before it was set");
        assert_eq!(detector.due_filter_change(at(300)), Some(IdFilterChange::AllIds));
        assert!(
            detector.record_new_foreign_id(id(7))
                && !detector.record_new_foreign_id(id(7))
                && detector.record_new_foreign_id(id(8))
        );
        assert_eq!(detector.due_filter_change(at(1299)), None);
        assert_eq!(detector.due_filter_change(at(1300)), Some(IdFilterChange::OwnId));
        assert_eq!(detector.due_filter_change(at(9000)), None, "not again and again");
        assert_eq!(detector.record_own_frame(at(9000)), None);
        assert_eq!(detector.due_filter_change(at(9300)), Some(IdFilterChange::AllIds));
        assert_eq!(detector.record_own_frame(at(9301)), Some(IdFilterChange::OwnId), "at once");
        // On a busy bus, the socket accepts other identifiers only until enough are found.
        assert_eq!(detector.due_filter_change(at(9601)), Some(IdFilterChange::AllIds));
        assert_eq!((0..20).filter(|raw| detector.record_new_foreign_id(id(*raw))).count(), MAX_REPORTED_FOREIGN_IDS);
        assert_eq!(detector.due_filter_change(at(9602)), Some(IdFilterChange::OwnId));
    }
}
