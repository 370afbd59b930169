//! The errors of the machine from a SAMBA run.

use crate::MethodRefusal;
use crate::identification::KnownErrors;
use crate::identification::probe_map::priors_without_probe_maps;
use machine::Axis;
use machine::kinematics::{ErrorTerm, KinematicChain};
use machine::record::estimate::Estimate;
use machine::record::plan::Plan;

/// Errors of the machine from the prior of the plan. `None`: the plan has no prior, or only probe qualifications.
///
/// # Errors
/// The plan has more than one estimate; the estimate has no errors of this machine, or lacks their
/// covariance.
pub fn machine_errors_from_prior(plan: &Plan) -> Result<Option<KnownErrors<'_>>, MethodRefusal> {
    let priors: Vec<&Estimate> = priors_without_probe_maps(&plan.priors).collect();
    match priors.as_slice() {
        [] => Ok(None),
        [only] => KnownErrors::from_estimate(only, &KinematicChain::new(&plan.machine)?).map(Some),
        _ => Err(MethodRefusal::new(
            "two estimates of the machine are given, but ball-dome accepts only one",
            "give only one estimate with --with",
        )),
    }
}

/// Whether the error belongs to the spindle. It is inseparable from the stylus if the spindle does not turn.
pub fn is_spindle_error(error: &ErrorTerm) -> bool {
    error.parameter.axis() == Axis::S
}
