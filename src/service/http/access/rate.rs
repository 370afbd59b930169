//! Rate limits: of changes by each client, of log lines about the holds of each client, and of invalid tokens from
//! each address.

use std::num::NonZeroU32;
use std::time::Duration;

use governor::clock::{Clock, DefaultClock};
use governor::state::keyed::HashMapStateStore;
use governor::{Quota, RateLimiter};

/// Limit of changes: burst size, and number per minute.
const CHANGES: NonZeroU32 = NonZeroU32::MIN.saturating_add(59);
const FAILURES: NonZeroU32 = NonZeroU32::MIN.saturating_add(9);
/// Limit of log lines about holds: burst size, and number per minute.
const HOLDS: NonZeroU32 = NonZeroU32::MIN.saturating_add(9);
/// Maximum number of clients that are counted separately; all further clients share one count.
const MOST: usize = 1000;

type Limiter = RateLimiter<String, HashMapStateStore<String>, DefaultClock>;

pub struct Rates {
    changes: Limiter,
    failures: Limiter,
    holds: Limiter,
}

/// The rate limit is exceeded; the value is the time to wait.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TooOften(pub Duration);

impl Default for Rates {
    fn default() -> Self {
        let limiter = |most| Limiter::hashmap(Quota::per_minute(most));
        let [changes, failures, holds] = [CHANGES, FAILURES, HOLDS].map(limiter);
        Self { changes, failures, holds }
    }
}

impl Rates {
    /// Counts a change by `caller`.
    pub fn change(&self, caller: &str) -> Result<(), TooOften> {
        count(&self.changes, caller)
    }

    /// Counts a hold by `caller`. The hold is executed in any case; an error means that it is not logged.
    pub fn hold(&self, caller: &str) -> Result<(), TooOften> {
        count(&self.holds, caller)
    }

    /// Counts an invalid token from `address`.
    pub fn failure(&self, address: &str) -> Result<(), TooOften> {
        count(&self.failures, address)
    }
}

fn count(limiter: &Limiter, who: &str) -> Result<(), TooOften> {
    if limiter.len() >= MOST {
        limiter.retain_recent();
    }
    let key = if limiter.len() >= MOST { "all others" } else { who };
    let judged = limiter.check_key(&key.to_owned());
    judged.map_err(|until| TooOften(until.wait_time_from(DefaultClock::default().now())))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_caller_has_a_count_of_its_own_and_all_others_one() {
        let rates = Rates::default();
        let refused = |who: &str| (0..11).filter(|_| rates.failure(who).is_err()).count();
        assert_eq!(refused("10.0.0.1"), 1);
        assert_eq!(refused("10.0.0.2"), 1);
        assert_eq!(rates.change("10.0.0.1"), Ok(()));
        let flood = (0..3 * MOST).filter(|n| rates.failure(&format!("flood {n}")).is_err()).count();
        assert!(flood > MOST, "{flood}");
        assert!(rates.failures.len() <= MOST + 1);
    }
}
