//! The refusal of a control whose state hinders a measurement.

use crate::controllers::ControllerError;

/// `remedy`: what the operator does before the next start.
pub(super) fn not_ready(state: &str, remedy: &str) -> ControllerError {
    ControllerError::NotReady { state: state.to_owned(), remedy: remedy.to_owned() }
}
