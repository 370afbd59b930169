//! Outputs: the delay and the overtravel that it causes.

use super::observe::ObservedTouches;
use crate::identification::{IdentificationOutputs, OutputCurve, OutputParameter};
use machine::record::estimate::{FunctionFigureKind, Unit};

/// Symbol of the latch delay of a contact.
const DELAY_SYMBOL: &str = "t_latch";
/// Symbol of the overtravel that the delay causes along a touch: a parameter at the measuring feed, and a curve over
/// the feed.
const LATCH_OVERTRAVEL_SYMBOL: &str = "E_latch";

/// Outputs of the solution `x`. `delay_slope`: derivative of the delay by the unknowns.
pub fn build_outputs(observed: &ObservedTouches, x: &[f64], delay_slope: &[f64]) -> IdentificationOutputs {
    let [slow, fast] = observed.speeds_mm_s();
    let overtravel = |speed: f64| {
        let slope = delay_slope.iter().map(|slope| slope * speed).collect();
        OutputParameter::from_coefficients(LATCH_OVERTRAVEL_SYMBOL, Unit::Um, slope, x)
    };
    let line = [0.0, slow, fast];
    let over_feed = OutputCurve {
        symbol: LATCH_OVERTRAVEL_SYMBOL.to_owned(),
        argument: "F",
        argument_unit: "mm/min",
        x: line.map(|speed| speed * 60.0).to_vec(),
        y: line.map(|speed| overtravel(speed).value).to_vec(),
        unit: Unit::Um,
        figure: FunctionFigureKind::Curve,
        slopes: line.into_iter().filter_map(|speed| overtravel(speed).linear_slope).collect(),
    };
    let parameters =
        vec![OutputParameter::from_coefficients(DELAY_SYMBOL, Unit::Ms, delay_slope.to_vec(), x), overtravel(slow)];
    IdentificationOutputs { linear_parameters: parameters, curves: vec![over_feed], nonlinear: None }
}
