//! The machine as a SAMBA run has found it.

use crate::Refused;
use crate::identification::KnownErrors;
use crate::identification::probe_map::others;
use machine::Axis;
use machine::kinematics::{Chain, ErrorTerm};
use machine::record::estimate::Estimate;
use machine::record::plan::Plan;

/// `None`: the plan has no prior.
///
/// # Errors
/// More than one estimate; one without errors of this machine or without their covariance.
pub fn known_machine(plan: &Plan) -> Result<Option<KnownErrors<'_>>, Refused> {
    let priors: Vec<&Estimate> = others(&plan.priors).collect();
    match priors.as_slice() {
        [] => Ok(None),
        [only] => KnownErrors::of(only, &Chain::new(&plan.machine)?).map(Some),
        _ => Err(Refused::new("ball-dome takes one estimate of the machine", "give one --with")),
    }
}

/// Whether the error is of the spindle: inseparable from the stylus where the spindle stands still.
pub fn is_of_spindle(error: &ErrorTerm) -> bool {
    error.parameter.axis() == Axis::S
}
