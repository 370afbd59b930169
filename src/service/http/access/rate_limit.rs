//! Rate limits: of changes by each client, of log lines about the holds of each client, and of invalid tokens from
//! each address.

use std::num::NonZeroU32;
use std::time::Duration;

use governor::clock::{Clock, DefaultClock};
use governor::state::keyed::HashMapStateStore;
use governor::{Quota, RateLimiter};

/// Limit of changes by one client: burst size, and number per minute.
const MAX_CHANGES_PER_MINUTE: NonZeroU32 = NonZeroU32::MIN.saturating_add(59);
/// Limit of invalid tokens from one address: burst size, and number per minute.
const MAX_INVALID_TOKENS_PER_MINUTE: NonZeroU32 = NonZeroU32::MIN.saturating_add(9);
/// Limit of log lines about holds: burst size, and number per minute.
const MAX_HOLD_LOG_LINES_PER_MINUTE: NonZeroU32 = NonZeroU32::MIN.saturating_add(9);
/// Maximum number of clients that are counted separately; all further clients share one count.
const MAX_SEPARATELY_COUNTED_CLIENTS: usize = 1000;

/// A rate limit that counts each client separately.
pub struct ClientRateLimit(RateLimiter<String, HashMapStateStore<String>, DefaultClock>);

/// Rate limits of the HTTP server; each counts its clients separately.
pub struct RateLimits {
    /// Changes by each client.
    pub change_limit: ClientRateLimit,
    /// Invalid tokens from each address.
    pub invalid_token_limit: ClientRateLimit,
    /// Holds by each client. Every hold is executed; beyond the limit, holds are counted, not logged one by one.
    pub hold_log_limit: ClientRateLimit,
}

/// The rate limit is exceeded; the value is the time to wait.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RateLimitExceeded(pub Duration);

impl Default for RateLimits {
    fn default() -> Self {
        let limit = |per_minute| ClientRateLimit(RateLimiter::hashmap(Quota::per_minute(per_minute)));
        let [change_limit, failure_limit, hold_log_limit] =
            [MAX_CHANGES_PER_MINUTE, MAX_INVALID_TOKENS_PER_MINUTE, MAX_HOLD_LOG_LINES_PER_MINUTE].map(limit);
        Self { change_limit, invalid_token_limit: failure_limit, hold_log_limit }
    }
}

impl ClientRateLimit {
    /// Counts an event of `client`. An error: the event exceeds the limit.
    pub fn count_event(&self, client: &str) -> Result<(), RateLimitExceeded> {
        let Self(limiter) = self;
        if limiter.len() >= MAX_SEPARATELY_COUNTED_CLIENTS {
            limiter.retain_recent();
        }
        let key = if limiter.len() >= MAX_SEPARATELY_COUNTED_CLIENTS { "all others" } else { client };
        let result = limiter.check_key(&key.to_owned());
        result.map_err(|until| RateLimitExceeded(until.wait_time_from(DefaultClock::default().now())))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_known_client_has_its_own_limit_and_others_share_one() {
        let rates = RateLimits::default();
        let refused = |who: &str| (0..11).filter(|_| rates.invalid_token_limit.count_event(who).is_err()).count();
        assert_eq!(refused("10.0.0.1"), 1);
        assert_eq!(refused("10.0.0.2"), 1);
        assert_eq!(rates.change_limit.count_event("10.0.0.1"), Ok(()));
        let flood = (0..3 * MAX_SEPARATELY_COUNTED_CLIENTS)
            .filter(|n| rates.invalid_token_limit.count_event(&format!("flood {n}")).is_err())
            .count();
        assert!(flood > MAX_SEPARATELY_COUNTED_CLIENTS, "{flood}");
        assert!(rates.invalid_token_limit.0.len() <= MAX_SEPARATELY_COUNTED_CLIENTS + 1);
    }
}
