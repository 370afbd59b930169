//! A hold is never refused, and held down it must not fill the audit log: what holds something has a line of its
//! own, the rest ten a minute for each caller, and then one line every ten seconds that says how many they were.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use crate::service::ask::Stopped;
use crate::service::http::Web;
use crate::service::http::access::Caller;
use crate::store::Audit;

/// How long they are counted.
const COUNTED: Duration = Duration::from_secs(10);
/// Of one run, the holds within this time have one line.
const ONCE: Duration = Duration::from_secs(1);

/// Caller and machine.
type Key = (String, String);

#[derive(Default)]
struct Inner {
    /// Of each machine: the last run whose hold has a line, and when.
    held: BTreeMap<String, (i64, Instant)>,
    /// Without a line so far.
    counted: BTreeMap<Key, u64>,
}

#[derive(Clone, Default)]
pub struct Holds(Arc<Mutex<Inner>>);

impl Holds {
    fn with<T>(&self, look: impl FnOnce(&mut Inner) -> T) -> T {
        look(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// Whether a hold of `run` (`None`: nothing was there to be held) is the first for a while.
    fn is_first(&self, machine: &str, run: Option<i64>, now: Instant) -> bool {
        let Some(run) = run else { return false };
        self.with(|inner| {
            let last = inner.held.get(machine);
            let again = last.is_some_and(|(held, at)| *held == run && now < *at + ONCE);
            if !again {
                inner.held.insert(machine.to_owned(), (run, now));
            }
            !again
        })
    }

    /// One more without a line; whether it is the first of them.
    fn count(&self, key: &Key) -> bool {
        self.with(|inner| {
            let count = inner.counted.entry(key.clone()).or_insert(0);
            *count += 1;
            *count == 1
        })
    }

    fn taken(&self, key: &Key) -> u64 {
        self.with(|inner| inner.counted.remove(key)).unwrap_or(0)
    }
}

/// Whether the hold `of` is to have a line of its own; otherwise it is counted.
pub fn has_a_line(web: &Web, caller: &Caller, of: &Audit, stopped: Stopped) -> bool {
    let run = (stopped == Stopped::Run).then_some(of.run);
    if web.holds.is_first(&of.machine, run, Instant::now()) || !caller.holds_often() {
        return true;
    }
    let key = (caller.counts_as().to_owned(), of.machine.clone());
    if web.holds.count(&key) {
        let (web, of) = (web.clone(), of.clone());
        tokio::spawn(async move {
            tokio::time::sleep(COUNTED).await;
            let more = web.holds.taken(&key);
            let outcome = format!("{}, {more} times within {} s", of.outcome, COUNTED.as_secs());
            // Nobody waits for it any more.
            drop(web.journal.audit(&Audit { outcome, ..of }));
        });
    }
    false
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_run_that_is_held_has_a_line_and_the_rest_is_counted() {
        let (holds, now) = (Holds::default(), Instant::now());
        assert!(!holds.is_first("mill", None, now));
        assert!(holds.is_first("mill", Some(1), now));
        assert!(!holds.is_first("mill", Some(1), now));
        assert!(holds.is_first("lathe", Some(1), now));
        assert!(holds.is_first("mill", Some(2), now));
        // It went on meanwhile.
        assert!(holds.is_first("mill", Some(2), now + ONCE));
        let key = |who: &str| (who.to_owned(), "mill".to_owned());
        assert_eq!([(); 3].map(|()| holds.count(&key("Ada"))), [true, false, false]);
        assert!(holds.count(&key("Eve")));
        assert_eq!((holds.taken(&key("Ada")), holds.taken(&key("Ada"))), (3, 0));
        assert!(holds.count(&key("Ada")));
    }
}
