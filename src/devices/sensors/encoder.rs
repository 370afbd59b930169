//! Count of a rotary encoder that comes with each sample: an encoder-triggered amplifier sends it together
//! with the value. A counter restarts after `modulus` counts; the count is kept as the remainder, and only
//! differences of counts are used. A signed count has the same remainders.

/// Largest `modulus`. An unlimited counter is read modulo this value.
pub(super) const MAX_MODULUS: u64 = 1 << 32;

/// Number of counts after which the count of `key` restarts: as stated, or else the capacity of `bits`.
///
/// # Errors
/// No counter of so many bits has the stated `modulus`.
pub(super) fn count_modulus(key: &str, declared: Option<u64>, bits: u16) -> Result<u64, String> {
    let max_modulus = 1_u64.checked_shl(u32::from(bits)).unwrap_or(MAX_MODULUS).min(MAX_MODULUS);
    match declared {
        None => Ok(max_modulus),
        Some(modulus) if (2..=max_modulus).contains(&modulus) => Ok(modulus),
        Some(modulus) => {
            Err(format!("`{key}.round` is {modulus}; permitted: 2 to {max_modulus} (counts until the count restarts)"))
        }
    }
}

/// Returns the remainder of `number`, from 0 to `modulus` - 1.
pub(super) fn count_remainder(number: i128, modulus: u64) -> u32 {
    // The conversion is exact: `modulus` is at most 2^32.
    number.rem_euclid(i128::from(modulus)) as u32
}
