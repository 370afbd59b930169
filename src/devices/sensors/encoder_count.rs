//! Count of a rotary encoder that comes with each sample: an encoder-triggered amplifier sends it together
//! with the value. A counter restarts after `modulus` counts; the count is kept as the remainder, and only
//! differences of counts are used. A signed count has the same remainders.

/// Largest modulus: the count of a wider or unlimited counter is read modulo this value.
pub(super) const COUNT_MODULUS_CAP: u64 = 1 << 32;

/// Number of counts after which the counter of the table `key` restarts: `declared_modulus`, or, if it is `None`, the
/// capacity of `bits`, at most [`COUNT_MODULUS_CAP`].
///
/// # Errors
/// `declared_modulus` is below 2, or more than that capacity.
pub(super) fn resolve_modulus(key: &str, declared_modulus: Option<u64>, bits: u16) -> Result<u64, String> {
    let max_modulus = 1_u64.checked_shl(u32::from(bits)).unwrap_or(COUNT_MODULUS_CAP).min(COUNT_MODULUS_CAP);
    match declared_modulus {
        None => Ok(max_modulus),
        Some(modulus) if (2..=max_modulus).contains(&modulus) => Ok(modulus),
        Some(modulus) => {
            Err(format!("`{key}.round` is {modulus}; permitted: 2 to {max_modulus} (counts until the count restarts)"))
        }
    }
}

/// Returns the remainder of `number` divided by `modulus`, from 0 to `modulus` - 1.
pub(super) fn wrap_count(number: i128, modulus: u64) -> u32 {
    // The conversion is exact: `modulus` is at most 2^32.
    number.rem_euclid(i128::from(modulus)) as u32
}
