//! Refusal of a control whose state prevents a measurement.

use crate::controllers::ControllerError;

/// Returns the refusal; `remedy` is what the operator must do before the next start.
pub(super) fn not_ready(state: &str, remedy: &str) -> ControllerError {
    ControllerError::NotReady { state: state.to_owned(), remedy: remedy.to_owned() }
}
