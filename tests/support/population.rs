//! Sizes of statistical populations, sweeps and fault schedules.

/// `full`, where `TRUED_FULL=1` is set (`.ci/long`), otherwise a tenth of it. Bounds are derived from the
/// returned size.
pub fn population(full: u64) -> u64 {
    let size = if is_full() { full } else { full.div_ceil(10) };
    println!("population: {size} of {full}");
    size
}

pub fn is_full() -> bool {
    std::env::var("TRUED_FULL").is_ok_and(|value| value == "1")
}
