//! Part 1: is each device there?

use std::time::Instant;

use super::{Check, Ended, Part};

pub(super) async fn look(check: &mut Check<'_>) -> Result<(), Ended> {
    let since = Instant::now();
    match check.open(check.pace).await {
        Ok(()) => {
            check.well(Part::Links, since, "the control's link is open");
            Ok(())
        }
        Err(error) => {
            let remedy = error.remedy().unwrap_or_default();
            check.failed(Part::Links, since, error.to_string(), remedy);
            Err(Ended::Unsafe)
        }
    }
}
