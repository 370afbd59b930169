//! The machine as a SAMBA run has found it.

use crate::Refused;
use machine::Axis;
use machine::kinematics::{Chain, ErrorParameter, ErrorTerm};
use machine::record::estimate::Estimate;
use machine::record::plan::Plan;

/// Errors of the machine with the estimate that they come from.
pub struct KnownMachine<'a> {
    pub estimate: &'a Estimate,
    /// In the order of the estimate; mm, rad, mm/mm.
    pub errors: Vec<ErrorTerm>,
    pub symbols: Vec<&'a str>,
}

impl<'a> KnownMachine<'a> {
    /// `None`: the plan has no prior.
    ///
    /// # Errors
    /// More than one estimate; one without errors of this machine or without their covariance.
    pub fn of(plan: &'a Plan) -> Result<Option<Self>, Refused> {
        let estimate = match plan.priors.as_slice() {
            [] => return Ok(None),
            [only] => only,
            _ => {
                let why = "ball-dome takes one estimate of the machine";
                return Err(Refused::new(why, "give one --with"));
            }
        };
        let chain = Chain::new(&plan.machine)?;
        let of_machine = estimate.parameters.iter().filter_map(|parameter| {
            let error: ErrorParameter = parameter.symbol.parse().ok()?;
            chain.check(error).ok()?;
            let value = parameter.value / parameter.unit.from_internal(1.0);
            Some((ErrorTerm { parameter: error, value }, parameter.symbol.as_str()))
        });
        let (errors, symbols): (Vec<ErrorTerm>, Vec<&str>) = of_machine.unzip();
        let has_covariance =
            |symbol: &&str| estimate.covariance.symbols.iter().any(|own| own == symbol);
        Refused::unless(
            !errors.is_empty() && symbols.iter().all(has_covariance),
            format!(
                "the estimate of {} holds no errors of this machine's axes with their covariance",
                estimate.method
            ),
            "give an estimate of samba of this machine by --with, as `trued run samba --json` prints it",
        )?;
        Ok(Some(Self { estimate, errors, symbols }))
    }

    /// Whether the error is of the spindle: inseparable from the stylus where the spindle stands still.
    pub fn is_of_spindle(error: &ErrorTerm) -> bool {
        error.parameter.axis() == Axis::S
    }
}
