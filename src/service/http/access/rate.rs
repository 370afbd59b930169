//! How often is too often: of each caller that changes something, of the lines about one who holds, and of
//! each address that shows a token which is none.

use std::num::NonZeroU32;
use std::time::Duration;

use governor::clock::{Clock, DefaultClock};
use governor::state::keyed::HashMapStateStore;
use governor::{Quota, RateLimiter};

/// At once, and so many a minute.
const CHANGES: NonZeroU32 = NonZeroU32::MIN.saturating_add(59);
const FAILURES: NonZeroU32 = NonZeroU32::MIN.saturating_add(9);
/// Lines about holds.
const HOLDS: NonZeroU32 = NonZeroU32::MIN.saturating_add(9);
/// Callers that are told apart; more count as one.
const MOST: usize = 1000;

type Limiter = RateLimiter<String, HashMapStateStore<String>, DefaultClock>;

pub struct Rates {
    changes: Limiter,
    failures: Limiter,
    holds: Limiter,
}

/// Too often; how long to wait.
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
    /// `caller` changes something.
    pub fn change(&self, caller: &str) -> Result<(), TooOften> {
        count(&self.changes, caller)
    }

    /// `caller` holds: that is done, and may be too often to be written down each time.
    pub fn hold(&self, caller: &str) -> Result<(), TooOften> {
        count(&self.holds, caller)
    }

    /// Somebody at `address` has shown what is no token.
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
