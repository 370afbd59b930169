//! Part 6: does the control itself keep the position of a contact?

use super::{Check, Ended, Part};

pub(super) async fn look(check: &mut Check<'_>) -> Result<(), Ended> {
    if check.strays || check.stands.is_none() {
        check.not_looked_at(Part::Latch, "the machine is not fit to touch, as told above");
        return Ok(());
    }
    check.not_looked_at(Part::Latch, "this version cannot");
    Ok(())
}
