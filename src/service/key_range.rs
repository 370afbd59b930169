//! Range of a numeric key of the machine file.

use std::fmt::Display;

/// Checks that the value of `key` is at least `min` and at most `max`.
pub(super) fn check_key_range<T: PartialOrd + Display>(key: &str, value: T, min: T, max: T) -> Result<(), String> {
    match (&min..=&max).contains(&&value) {
        true => Ok(()),
        false => Err(format!("{key} is {value}; allowed: {min} to {max}")),
    }
}
