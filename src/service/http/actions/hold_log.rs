//! A hold is never refused, and repeated holds must not fill the audit log. A hold that stops a run has its own
//! line. Of the other holds, each client has ten lines a minute; further ones are counted, with one line every ten
//! seconds that states their number.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use crate::service::http::AppState;
use crate::service::http::access::Caller;
use crate::service::lock;
use crate::service::worker_command::HoldEffect;
use crate::store::AuditEntry;

/// Time over which the holds without their own line are counted, from the first of them.
const HOLD_COUNT_PERIOD: Duration = Duration::from_secs(10);
/// Time within which all holds of one run share one line.
const SAME_RUN_HOLD_WINDOW: Duration = Duration::from_secs(1);

/// Rate-limit key of the client (name of its token, or address), and name of the machine.
type ClientAndMachine = (String, String);

#[derive(Default)]
struct HoldLogState {
    /// By machine: number of the last run whose hold has a line, and the time of that hold.
    last_logged_hold_by_machine: BTreeMap<String, (i64, Instant)>,
    /// Number of holds that have no audit line yet, by client and machine.
    unlogged_hold_counts: BTreeMap<ClientAndMachine, u64>,
}

/// Decides which holds get their own line in the audit log; all requests share one instance.
#[derive(Clone, Default)]
pub struct HoldLog(Arc<Mutex<HoldLogState>>);

impl HoldLog {
    /// Whether a hold of `run` is the first within [`SAME_RUN_HOLD_WINDOW`]; such a hold is remembered as the last one
    /// with a line. `None`: no run was in progress, and the result is `false`.
    fn is_first_hold_of_run(&self, machine: &str, run: Option<i64>, now: Instant) -> bool {
        let Some(run) = run else { return false };
        let mut inner = lock(&self.0);
        let last = inner.last_logged_hold_by_machine.get(machine);
        let is_repeated = last.is_some_and(|(held, at)| *held == run && now < *at + SAME_RUN_HOLD_WINDOW);
        if !is_repeated {
            inner.last_logged_hold_by_machine.insert(machine.to_owned(), (run, now));
        }
        !is_repeated
    }

    /// Counts a hold without an audit line; returns whether the count was 0 before.
    fn count_unlogged_hold(&self, key: &ClientAndMachine) -> bool {
        let mut inner = lock(&self.0);
        let count = inner.unlogged_hold_counts.entry(key.clone()).or_insert(0);
        *count += 1;
        *count == 1
    }

    /// Returns the count and resets it to 0.
    fn take_unlogged_count(&self, key: &ClientAndMachine) -> u64 {
        lock(&self.0).unlogged_hold_counts.remove(key).unwrap_or(0)
    }
}

/// Whether the hold `audit` gets its own line: it is the first hold of a run within `SAME_RUN_HOLD_WINDOW`, or within
/// the rate limit of the client. Otherwise it is counted, and a task writes one line with the count after
/// [`HOLD_COUNT_PERIOD`].
pub fn gets_own_audit_line(app: &AppState, caller: &Caller, audit: &AuditEntry, effect: HoldEffect) -> bool {
    let run = (effect == HoldEffect::RunHeld).then_some(audit.run);
    if app.hold_log.is_first_hold_of_run(&audit.machine, run, Instant::now())
        || !caller.has_exceeded_log_rate_with_this_hold()
    {
        return true;
    }
    let key = (caller.rate_limit_key.clone(), audit.machine.clone());
    if app.hold_log.count_unlogged_hold(&key) {
        let (app, audit) = (app.clone(), audit.clone());
        tokio::spawn(async move {
            tokio::time::sleep(HOLD_COUNT_PERIOD).await;
            let more = app.hold_log.take_unlogged_count(&key);
            let outcome = format!("{}, {more} times within {} s", audit.outcome, HOLD_COUNT_PERIOD.as_secs());
            // The client does not wait for this line.
            drop(app.journal.add_audit_entry(&AuditEntry { outcome, ..audit }));
        });
    }
    false
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_held_run_has_a_line_and_further_holds_are_counted() {
        let (holds, now) = (HoldLog::default(), Instant::now());
        assert!(!holds.is_first_hold_of_run("mill", None, now));
        assert!(holds.is_first_hold_of_run("mill", Some(1), now));
        assert!(!holds.is_first_hold_of_run("mill", Some(1), now));
        assert!(holds.is_first_hold_of_run("lathe", Some(1), now));
        assert!(holds.is_first_hold_of_run("mill", Some(2), now));
        // The run was resumed meanwhile.
        assert!(holds.is_first_hold_of_run("mill", Some(2), now + SAME_RUN_HOLD_WINDOW));
        let key = |who: &str| (who.to_owned(), "mill".to_owned());
        assert_eq!([(); 3].map(|()| holds.count_unlogged_hold(&key("Ada"))), [true, false, false]);
        assert!(holds.count_unlogged_hold(&key("Eve")));
        assert_eq!((holds.take_unlogged_count(&key("Ada")), holds.take_unlogged_count(&key("Ada"))), (3, 0));
        assert!(holds.count_unlogged_hold(&key("Ada")));
    }
}
