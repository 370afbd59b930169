//! The errors of the machine from a SAMBA run.

use crate::Refused;
use crate::identification::KnownErrors;
use crate::identification::probe_map::others;
use machine::Axis;
use machine::kinematics::{Chain, ErrorTerm};
use machine::record::estimate::Estimate;
use machine::record::plan::Plan;

/// Errors of the machine from the prior of the plan. `None`: the plan has no prior.
///
/// # Errors
/// The plan has more than one estimate; the estimate has no errors of this machine, or lacks their
/// covariance.
pub fn known_machine(plan: &Plan) -> Result<Option<KnownErrors<'_>>, Refused> {
    let priors: Vec<&Estimate> = others(&plan.priors).collect();
    match priors.as_slice() {
        [] => Ok(None),
        [only] => KnownErrors::of(only, &Chain::new(&plan.machine)?).map(Some),
        _ => Err(Refused::new("ball-dome takes one estimate of the machine", "give one --with")),
    }
}

/// Whether the error belongs to the spindle. It is inseparable from the stylus if the spindle does not turn.
pub fn is_of_spindle(error: &ErrorTerm) -> bool {
    error.parameter.axis() == Axis::S
}
