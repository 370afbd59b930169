//! Outputs: the delay and the overtravel that it causes.

use super::observe::Observed;
use crate::identification::{Curve, Output, Outputs};
use machine::record::estimate::{FigureKind, Unit};

/// Symbol of the latch delay of a contact.
const DELAY: &str = "t_latch";
/// Symbol of the overtravel: distance along a touch at the measuring feed that the delay causes.
const OVERTRAVEL: &str = "E_latch";

/// Outputs of the solution `x`. `delay`: derivative of the delay by the unknowns.
pub fn outputs(observed: &Observed, x: &[f64], delay: &[f64]) -> Outputs {
    let [slow, fast] = observed.speeds();
    let at = |speed: f64| {
        let slope = delay.iter().map(|slope| slope * speed).collect();
        Output::linear(OVERTRAVEL, Unit::Um, slope, x)
    };
    let line = [0.0, slow, fast];
    let over_feed = Curve {
        symbol: OVERTRAVEL.to_owned(),
        argument: "F",
        argument_unit: "mm/min",
        x: line.map(|speed| speed * 60.0).to_vec(),
        y: line.map(|speed| at(speed).value).to_vec(),
        unit: Unit::Um,
        figure: FigureKind::Curve,
        slopes: line.into_iter().filter_map(|speed| at(speed).slope).collect(),
    };
    let parameters = vec![Output::linear(DELAY, Unit::Ms, delay.to_vec(), x), at(slow)];
    Outputs { parameters, curves: vec![over_feed], nonlinear: None }
}
