//! Who else speaks on the bus, while nothing of one's own identifier comes: a wrong identifier looks like
//! a sensor that says nothing.

use std::time::{Duration, Instant};

use super::Id;

/// So long nothing of its own came before others are listened to; and so long they are.
const SILENCE: Duration = Duration::from_millis(300);
const LISTEN: Duration = Duration::from_secs(1);
/// So many are told.
const MOST: usize = 8;

/// Whether others are listened to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Ears {
    /// For its own frames alone.
    Own,
    All,
    /// Others were listened to since the last of its own.
    Heard,
}

pub(super) struct Others {
    ears: Ears,
    /// Of the last own frame, or when others began to be listened to.
    since: Instant,
    told: Vec<Id>,
}

/// What the socket is to let through from now on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Turn {
    All,
    Own,
}

impl Others {
    pub fn new(now: Instant) -> Self {
        Self { ears: Ears::Own, since: now, told: Vec::new() }
    }

    /// A frame of its own came.
    pub fn own(&mut self, now: Instant) -> Option<Turn> {
        let was = self.ears;
        *self = Self::new(now);
        (was == Ears::All).then_some(Turn::Own)
    }

    /// Time has passed.
    pub fn passed(&mut self, now: Instant) -> Option<Turn> {
        match self.ears {
            Ears::Own if now - self.since >= SILENCE => {
                (self.ears, self.since) = (Ears::All, now);
                Some(Turn::All)
            }
            Ears::All if now - self.since >= LISTEN || self.told.len() == MOST => {
                self.ears = Ears::Heard;
                Some(Turn::Own)
            }
            _ => None,
        }
    }

    /// Another's frame came; is it worth telling?
    pub fn is_news(&mut self, id: Id) -> bool {
        let news = self.ears == Ears::All && self.told.len() < MOST && !self.told.contains(&id);
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
        let mut others = Others::new(begun);
        assert_eq!(others.passed(at(299)), None);
        assert!(!others.is_news(id(7)), "what the filter let through before it was set");
        assert_eq!(others.passed(at(300)), Some(Turn::All));
        assert!(others.is_news(id(7)) && !others.is_news(id(7)) && others.is_news(id(8)));
        assert_eq!(others.passed(at(1299)), None);
        assert_eq!(others.passed(at(1300)), Some(Turn::Own));
        assert_eq!(others.passed(at(9000)), None, "not again and again");
        assert_eq!(others.own(at(9000)), None);
        assert_eq!(others.passed(at(9300)), Some(Turn::All));
        assert_eq!(others.own(at(9301)), Some(Turn::Own), "at once");
        // A busy bus is not read for longer than it takes.
        assert_eq!(others.passed(at(9601)), Some(Turn::All));
        assert_eq!((0..20).filter(|raw| others.is_news(id(*raw))).count(), MOST);
        assert_eq!(others.passed(at(9602)), Some(Turn::Own));
    }
}
