//! Sizes of statistical populations, sweeps and fault schedules, and bounds that follow from the size.

use std::ops::RangeInclusive;

use statrs::distribution::{Binomial, ChiSquared, ContinuousCDF, DiscreteCDF};

/// Smallest population; a smaller one proves next to nothing.
const MIN_POPULATION_SIZE: u64 = 5;

/// `full` where `TRUED_FULL=1` is set (`.ci/long`), otherwise a twentieth of it. The size is printed.
pub fn population_size(full: u64) -> u64 {
    size_or_share(full, 20)
}

/// Like [`population_size`], but at least a tenth: for the motion proof, whose wrong acceptance means a collision.
pub fn proof_population_size(full: u64) -> u64 {
    size_or_share(full, 10)
}

fn size_or_share(full: u64, divisor: u64) -> u64 {
    let share = full.div_ceil(divisor).max(MIN_POPULATION_SIZE.min(full));
    let size = if is_full_test_run() { full } else { share };
    println!("population: {size} of {full}");
    size
}

/// Number of seeds for a test of coverage, and allowed shares of intervals that hold the truth where 95.45 % is stated
/// (METHODS section 6, coverage standard).
pub fn coverage_seeds_and_share_limits() -> (u64, RangeInclusive<f64>) {
    let (seeds, shares) = if is_full_test_run() { (1000, 0.93..=0.975) } else { (60, 0.86..=1.0) };
    println!("coverage: {seeds} seeds");
    (seeds, shares)
}

/// Whether the populations have their full size: `TRUED_FULL=1`, as in `.ci/long`.
pub fn is_full_test_run() -> bool {
    std::env::var("TRUED_FULL").is_ok_and(|value| value == "1")
}

/// Bounds of the ratio of observed to stated standard deviation for `size` independent values. Each tail has the
/// same probability as with `full` values and the given bounds (METHODS section 6).
pub fn sd_ratio_bounds(size: u64, full: u64, (low, high): (f64, f64)) -> (f64, f64) {
    let [of_size, of_full] = [size, full].map(|count| ChiSquared::new(count as f64).unwrap());
    let at_size = |bound: f64| {
        let tail = of_full.cdf(full as f64 * bound * bound);
        (of_size.inverse_cdf(tail) / size as f64).sqrt()
    };
    if size == full { (low, high) } else { (at_size(low), at_size(high)) }
}

/// Upper bound of the number of events among `size` trials, each with `probability`. It is exceeded as rarely as
/// `at_full` events among `full`.
pub fn event_count_limit(size: u64, full: u64, (probability, at_full): (f64, u64)) -> u64 {
    let [of_size, of_full] = [size, full].map(|count| Binomial::new(probability, count).unwrap());
    if size == full { at_full } else { of_size.inverse_cdf(of_full.cdf(at_full)) }
}
