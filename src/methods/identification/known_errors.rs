//! Errors of the axes from an earlier estimate: location errors and gains.

use faer::Mat;
use nalgebra::Vector3;

use super::uncertainty_source::{linear_combination, prior_covariance};
use crate::MethodRefusal;
use machine::Axis;
use machine::frame::Point;
use machine::kinematics::{ErrorParameter, ErrorShape, ErrorTerm, KinematicChain};
use machine::record::estimate::{Estimate, Parameter};

/// Errors of the axes and the estimate that gives them.
pub struct KnownErrors<'a> {
    pub estimate: &'a Estimate,
    /// Errors of the kinematic model, in the order of `symbols`; mm, rad, mm/mm.
    pub errors: Vec<ErrorTerm>,
    /// Symbols of the parameters in the estimate.
    pub symbols: Vec<&'a str>,
    /// Covariance in the units of the errors.
    pub covariance: Mat<f64>,
    /// Derivatives of `errors` (rows) by the parameters of the estimate: the identity, unless the estimate states its
    /// location errors at another point than the model.
    pub derivatives_by_parameters: Mat<f64>,
}

impl<'a> KnownErrors<'a> {
    /// The errors of `estimate` for the axes of this machine.
    ///
    /// # Errors
    /// The estimate has no such errors, or none with their covariance; it has errors of axes that this
    /// machine does not have, or errors that its readings do not determine.
    pub fn from_estimate(estimate: &'a Estimate, chain: &KinematicChain) -> Result<Self, MethodRefusal> {
        let of_axes = estimate.parameters.iter().filter_map(|parameter| {
            let error: ErrorParameter = parameter.symbol.parse().ok()?;
            Some((ErrorTerm { parameter: error, value: internal_value(parameter) }, parameter))
        });
        let (errors, parameters): (Vec<ErrorTerm>, Vec<&Parameter>) = of_axes.unzip();
        check_axes(estimate, chain, &errors)?;
        check_identifiable(estimate, &parameters)?;
        let symbols: Vec<&str> = parameters.iter().map(|parameter| parameter.symbol.as_str()).collect();
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
        let values: Vec<f64> = errors.iter().map(|error| error.value).collect();
        let (errors, signs): (Vec<ErrorTerm>, Vec<f64>) =
            errors.into_iter().map(|error| error_of_model(estimate, chain, error)).unzip();
        let derivatives_by_parameters = model_derivatives(estimate, chain, &errors, &signs)?;
        let row = |i: usize| (0..values.len()).map(|j| derivatives_by_parameters[(i, j)] * values[j]).sum::<f64>();
        let errors = errors.iter().enumerate().map(|(i, error)| ErrorTerm { value: row(i), ..*error }).collect();
        let covariance = &derivatives_by_parameters * covariance * derivatives_by_parameters.transpose();
        Ok(Self { estimate, errors, symbols, covariance, derivatives_by_parameters })
    }

    /// Error parameters of the kinematic model, in the order of `errors`; not the parameters of the estimate.
    pub fn parameters(&self) -> Vec<ErrorParameter> {
        self.errors.iter().map(|error| error.parameter).collect()
    }

    /// Derivatives by the parameters of the estimate, from derivatives by the errors. `columns`: one for each error.
    pub fn columns_by_parameters(&self, columns: &[Vec<f64>]) -> Vec<Vec<f64>> {
        let of_parameter = |j| linear_combination(columns, self.derivatives_by_parameters.col_as_slice(j));
        (0..self.errors.len()).map(of_parameter).collect()
    }

    pub fn has_error(&self, parameter: ErrorParameter) -> bool {
        self.errors.iter().any(|error| error.parameter == parameter)
    }
}

/// Value of the parameter in mm, rad, mm/mm or s.
pub fn internal_value(parameter: &Parameter) -> f64 {
    parameter.value / parameter.unit.to_reported_value(1.0)
}

fn check_axes(estimate: &Estimate, chain: &KinematicChain, errors: &[ErrorTerm]) -> Result<(), MethodRefusal> {
    let foreign = errors.iter().filter(|error| chain.check_parameter_axis(error.parameter).is_err());
    let foreign: Vec<String> = foreign.map(|error| error.parameter.to_string()).collect();
    MethodRefusal::require(
        foreign.is_empty(),
        format!(
            "the estimate of {} is of another machine: this machine has no {}",
            estimate.method,
            foreign.join(", ")
        ),
        "give an estimate of this machine, or the machine file of that estimate (--machine)",
    )
}

fn check_identifiable(estimate: &Estimate, parameters: &[&Parameter]) -> Result<(), MethodRefusal> {
    let lost = parameters.iter().filter(|parameter| !parameter.identifiable);
    let lost: Vec<&str> = lost.map(|parameter| parameter.symbol.as_str()).collect();
    MethodRefusal::require(
        lost.is_empty(),
        format!("the readings of the {} run do not determine {}", estimate.method, lost.join(", ")),
        "read the warnings of the estimate, remove the cause and measure again",
    )
}

/// The error of the kinematic model for an error of the estimate, and its sign. An estimate with `location_at_mm` has
/// the squareness of X and Y as EC0Y. Where Y carries X, EC0Y would also turn X: the model then has EC0X with the
/// opposite sign.
fn error_of_model(estimate: &Estimate, chain: &KinematicChain, error: ErrorTerm) -> (ErrorTerm, f64) {
    let location = |axis| ErrorParameter::new(Axis::C, axis, ErrorShape::Location);
    let is_squareness = location(Axis::Y) == Ok(error.parameter);
    match location(Axis::X) {
        Ok(parameter)
            if is_squareness
                && estimate.location_at_mm.is_some()
                && chain.topology().is_carried_by(Axis::X, Axis::Y) =>
        {
            (ErrorTerm { parameter, ..error }, -1.0)
        }
        _ => (error, 1.0),
    }
}

/// Derivatives of the errors of the kinematic model by the errors of the estimate. An estimate with `location_at_mm`
/// states the position of the rotary axis relative to the tip at that point: the location errors of the model along X
/// and Y are these positions plus the effect of the other errors at that point.
fn model_derivatives(
    estimate: &Estimate,
    chain: &KinematicChain,
    errors: &[ErrorTerm],
    signs: &[f64],
) -> Result<Mat<f64>, MethodRefusal> {
    let mut derivatives = Mat::from_fn(errors.len(), errors.len(), |i, j| if i == j { signs[i] } else { 0.0 });
    let Some(at_mm) = estimate.location_at_mm else { return Ok(derivatives) };
    // Errors of the linear axes without angular error motions move all points of the tool alike.
    let tip = Point::from_vec(Vector3::zeros());
    for (i, location) in errors.iter().enumerate() {
        let (component, axis) = (location.parameter.component(), location.parameter.axis());
        let is_location = location.parameter.shape() == ErrorShape::Location;
        if !is_location || axis.is_linear() || !matches!(component, Axis::X | Axis::Y) {
            continue;
        }
        for (j, other) in errors.iter().enumerate().filter(|(j, _)| *j != i) {
            let derivative = chain.axis_displacement_derivative(axis, at_mm.into(), tip, other.parameter)?;
            derivatives[(i, j)] = -signs[j] * derivative.dot(&component.nominal_direction());
        }
    }
    Ok(derivatives)
}
