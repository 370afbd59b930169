//! The template environment. Every decimal number must pass the filter `num`; the formatter refuses it otherwise.

use minijinja::value::Value;
use minijinja::{Environment, Error, ErrorKind, Output, State, UndefinedBehavior};

use super::error::RenderError;

/// Environment that refuses undefined names; only the filter `num` can print a decimal number.
pub(super) fn template_environment() -> Environment<'static> {
    let mut environment = Environment::new();
    environment.set_undefined_behavior(UndefinedBehavior::Strict);
    environment.set_formatter(refuse_unformatted_decimal);
    environment.add_filter("num", format_decimal);
    environment
}

fn refuse_unformatted_decimal(out: &mut Output, state: &mut State, value: &Value) -> Result<(), Error> {
    if value.is_number() && !value.is_integer() {
        let reason = "the template prints a decimal number without the filter `num`";
        return Err(Error::new(ErrorKind::InvalidOperation, reason));
    }
    minijinja::escape_formatter(out, state, value)
}

/// Formats a number with a fixed number of decimals, without a minus before a zero; refuses a value that is not finite.
fn format_decimal(value: f64, decimals: usize) -> Result<String, Error> {
    if !value.is_finite() {
        return Err(Error::new(ErrorKind::InvalidOperation, "the number is not finite")
            .with_source(RenderError::ValueNotFinite(value)));
    }
    let text = format!("{value:.decimals$}");
    let is_zero = text.bytes().all(|byte| matches!(byte, b'-' | b'0' | b'.'));
    Ok(if is_zero { text.trim_start_matches('-').to_owned() } else { text })
}
