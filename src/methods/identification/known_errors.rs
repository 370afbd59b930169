//! Errors of the axes from an earlier estimate: location errors and gains.

use faer::Mat;

use super::uncertainty_source::prior_covariance;
use crate::MethodRefusal;
use machine::kinematics::{ErrorParameter, ErrorTerm, KinematicChain};
use machine::record::estimate::Estimate;

/// Errors of the axes and the estimate that gives them.
pub struct KnownErrors<'a> {
    pub estimate: &'a Estimate,
    /// Errors in the order of the estimate; mm, rad, mm/mm.
    pub errors: Vec<ErrorTerm>,
    pub symbols: Vec<&'a str>,
    /// Covariance in the units of the errors.
    pub covariance: Mat<f64>,
}

impl<'a> KnownErrors<'a> {
    /// The errors of `estimate` for the axes of this machine.
    ///
    /// # Errors
    /// The estimate has no such errors, or none with their covariance; it has errors of axes that this
    /// machine does not have.
    pub fn from_estimate(estimate: &'a Estimate, chain: &KinematicChain) -> Result<Self, MethodRefusal> {
        let of_axes = estimate.parameters.iter().filter_map(|parameter| {
            let error: ErrorParameter = parameter.symbol.parse().ok()?;
            let value = parameter.value / parameter.unit.to_reported_value(1.0);
            Some((ErrorTerm { parameter: error, value }, parameter.symbol.as_str()))
        });
        let (errors, symbols): (Vec<ErrorTerm>, Vec<&str>) = of_axes.unzip();
        let pairs = errors.iter().zip(&symbols);
        let foreign: Vec<&str> = pairs
            .filter(|(error, _)| chain.check_parameter_axis(error.parameter).is_err())
            .map(|(_, symbol)| *symbol)
            .collect();
        MethodRefusal::require(
            foreign.is_empty(),
            format!(
                "the estimate of {} is of another machine: this machine has no {}",
                estimate.method,
                foreign.join(", ")
            ),
            "give an estimate of this machine, or the machine file of that estimate (--machine)",
        )?;
        let covariance = prior_covariance(estimate, &symbols).filter(|_| !errors.is_empty());
        let covariance = covariance.ok_or_else(|| {
            MethodRefusal::new(
                format!(
                    "the estimate of {} has no errors of this machine's axes with their covariance",
                    estimate.method
                ),
                "give an estimate of this machine by samba, laser-r-test or self-calibration, as printed by \
                --json",
            )
        })?;
        Ok(Self { estimate, errors, symbols, covariance })
    }

    pub fn parameters(&self) -> Vec<ErrorParameter> {
        self.errors.iter().map(|error| error.parameter).collect()
    }
}
