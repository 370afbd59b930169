//! Errors that standards define for a machine of this kind, but that this measurement does not give.

use super::confounding::{Confounding, MeasuringConditions};
use super::geometry_model::GeometryModel;
use super::parameters::implied_parameters;
use crate::ball_measurement::tilts_spindle;
use machine::Axis;
use machine::kinematics::{ErrorParameter, ErrorShape};

/// An error that is not identified.
pub struct OmittedError {
    pub error: ErrorParameter,
    /// Unknowns from which the error is inseparable. `None`: the error is separable, but was not selected.
    confounding: Option<Confounding>,
    /// Reason why the axis does not move. Empty: the axis moves, or no reason is known.
    reason: &'static str,
}

const SPINDLE_NOT_TURNED_REASON: &str = "the spindle was not turned";
const SPINDLE_UPRIGHT_REASON: &str = "balls are touched from above only, so the axis stays at 0";

/// Errors that are not identified: all gains, and all errors that would be separable if each rotary axis turned.
pub fn omitted_errors(model: &GeometryModel) -> Vec<OmittedError> {
    let (conditions, identified) = (model.measuring_conditions(), model.parameters());
    let chain = conditions.chain;
    let mut expected = implied_parameters(MeasuringConditions { fixed_axes: &[], ..conditions });
    let linear = chain.topology().axes().filter(|axis| axis.is_linear());
    let gains = linear.filter_map(|axis| ErrorParameter::new(axis, axis, ErrorShape::Gain).ok());
    let missing_gains: Vec<_> = gains.filter(|gain| !expected.contains(gain)).collect();
    expected.extend(missing_gains);
    expected.retain(|error| !identified.contains(error));
    let reason = |error: ErrorParameter| match error.axis() {
        axis if !conditions.fixed_axes.contains(&axis) => "",
        Axis::S => SPINDLE_NOT_TURNED_REASON,
        axis if tilts_spindle(chain, axis) => SPINDLE_UPRIGHT_REASON,
        _ => "",
    };
    let omitted = |error: ErrorParameter| OmittedError {
        error,
        confounding: conditions.confounding(error, identified),
        reason: reason(error),
    };
    expected.into_iter().map(omitted).collect()
}

impl OmittedError {
    /// Name of an error that is separable but was not selected. `None`: the error is inseparable.
    pub fn unrequested_name(&self) -> Option<String> {
        self.confounding.is_none().then(|| self.error.to_string())
    }
}

/// One line per inseparable error; separable errors that were not selected have none. Example: `EX0S: inseparable from
/// tool_x (the spindle was not turned), so tool_x is reported as tool_x + EX0S`.
pub fn describe_omitted_errors(all: &[OmittedError]) -> Vec<String> {
    let line = |omitted: &OmittedError| {
        let OmittedError { error, confounding, reason } = omitted;
        let Confounding { inseparable_names: names, reported_sums: sums } = confounding.as_ref()?;
        let effect = match names.as_slice() {
            [] => "has no effect on the measurements".to_owned(),
            [name] => format!("inseparable from {name}"),
            [others @ .., last] => format!("inseparable from {} and {last}", others.join(", ")),
        };
        let reason = if reason.is_empty() { String::new() } else { format!(" ({reason})") };
        let consequence = match sums.as_slice() {
            [] if names.len() < 2 => String::new(),
            [] => format!(": their values are valid if {error} is 0"),
            sums => format!(", so {}", sums.join(" and ")),
        };
        Some(format!("{error}: {effect}{reason}{consequence}"))
    };
    all.iter().filter_map(line).collect()
}
