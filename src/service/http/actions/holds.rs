//! A hold is never refused, and repeated holds must not fill the audit log. A hold that stops a run has its own
//! line. Of the other holds, each client has ten lines a minute; further ones are counted, with one line every ten
//! seconds that states their number.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use crate::service::http::AppState;
use crate::service::http::access::Caller;
use crate::service::worker_command::Stopped;
use crate::store::Audit;

/// Time over which the holds without their own line are counted.
const COUNTED: Duration = Duration::from_secs(10);
/// Time within which all holds of one run share one line.
const ONCE: Duration = Duration::from_secs(1);

/// Client and machine.
type Key = (String, String);

#[derive(Default)]
struct Inner {
    /// By machine: the last run whose hold has a line, and the time of that hold.
    held: BTreeMap<String, (i64, Instant)>,
    /// Number of holds that have no line yet.
    counted: BTreeMap<Key, u64>,
}

#[derive(Clone, Default)]
pub struct Holds(Arc<Mutex<Inner>>);

impl Holds {
    fn with<T>(&self, look: impl FnOnce(&mut Inner) -> T) -> T {
        look(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// Whether a hold of `run` is the first within [`ONCE`]. `None`: no run was in progress.
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

    /// Counts a hold without a line; returns whether it is the first of them.
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

/// Whether the hold `of` gets its own line; otherwise it is counted.
pub fn has_a_line(web: &AppState, caller: &Caller, of: &Audit, stopped: Stopped) -> bool {
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
            // The client does not wait for this line.
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
        // The run was resumed meanwhile.
        assert!(holds.is_first("mill", Some(2), now + ONCE));
        let key = |who: &str| (who.to_owned(), "mill".to_owned());
        assert_eq!([(); 3].map(|()| holds.count(&key("Ada"))), [true, false, false]);
        assert!(holds.count(&key("Eve")));
        assert_eq!((holds.taken(&key("Ada")), holds.taken(&key("Ada"))), (3, 0));
        assert!(holds.count(&key("Ada")));
    }
}
