//! Part.

use super::{Check, Ended, Part};

pub(super) async fn look(check: &mut Check<'_>) -> Result<(), Ended> {
    check.not_looked_at(Part::Probe, "this version cannot");
    Ok(())
}
