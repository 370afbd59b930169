//! Part 2: who is there, and does it say of itself what the machine file says of it?

use std::time::Instant;

use super::{Check, Ended, Part};
use crate::controllers::ControllerError;

pub(super) async fn look(check: &mut Check<'_>) -> Result<(), Ended> {
    let since = Instant::now();
    match check.controller()?.prepare().await {
        Ok(prepared) => {
            let what = format!("{}; {}", prepared.identity, prepared.stop);
            check.summary.control = Some(prepared.identity);
            check.stands = Some(prepared.stands);
            check.well(Part::Control, since, what);
            Ok(())
        }
        // The next part tells what is wrong with the probe.
        Err(ControllerError::ProbeClosed) => Ok(()),
        Err(error) => {
            check.failed(Part::Control, since, error.to_string(), error.remedy());
            Err(Ended::Unsafe)
        }
    }
}
