//! Count of a rotary encoder that comes with each sample: an encoder-triggered amplifier sends it together
//! with the value. A counter restarts after `round` counts; the count is kept as the remainder, and only
//! differences of counts are used. A signed count has the same remainders.

/// Largest `round`. An unlimited counter is read modulo this value.
pub(super) const MAX_ROUND: u64 = 1 << 32;

/// Number of counts after which the count restarts: `round` if it is stated, otherwise the capacity of
/// `bits`.
///
/// # Errors
/// No counter of so many bits has the stated `round`.
pub(super) fn round(stated: Option<u64>, bits: u16) -> Result<u64, String> {
    let most = 1_u64.checked_shl(u32::from(bits)).unwrap_or(MAX_ROUND).min(MAX_ROUND);
    match stated {
        None => Ok(most),
        Some(round) if (2..=most).contains(&round) => Ok(round),
        Some(round) => Err(format!(
            "`encoder_count.round` is {round}; it is after how many counts the count begins anew, 2 to {most}"
        )),
    }
}

/// Returns the remainder of `number`, from 0 to `round` - 1.
pub(super) fn wrapped(number: i128, round: u64) -> u32 {
    // The conversion is exact: `round` is at most 2^32.
    number.rem_euclid(i128::from(round)) as u32
}
