//! The axis position by ISO 230-7: the least-squares circle through the positions of E_total, in addition to the
//! mean, which is the default.

use super::identify::SolvedRun;
use super::model::UnknownsLayout;
use crate::identification::{central_differences, parameter_with_budget};
use estimation::circle::fit_circle;
use machine::record::estimate::{CircleFigure, Estimate, Unit};

/// Half width of the numerical derivative of the circle's centre, mm.
const DERIVATIVE_STEP_MM: f64 = 1e-6;

/// Adds the centre and the figure of the circle. Adds nothing if no circle can be fitted: an axis without offset
/// leaves only scatter.
pub fn add_axis_circle(parts: &SolvedRun<'_>, estimate: &mut Estimate) {
    let (layout, x, axis) = (&parts.fit.layout, &parts.fit.x, parts.setup.axis.axis);
    let Ok(circle) = fit_circle(&total_displacements_mm(layout, x)) else { return };
    let centre = |x: &[f64]| fit_circle(&total_displacements_mm(layout, x)).ok().map(|circle| circle.centre.to_vec());
    let Some(slopes) = central_differences(x, DERIVATIVE_STEP_MM, centre) else { return };
    let own = [0, 1].map(|i| parts.identification.propagation.output_uncertainty(&slopes[i]));
    let centre_expanded = own.each_ref().map(|own| own.expanded() * 1e3);
    for ((symbol, value), own) in ["X", "Y"].into_iter().zip(circle.centre).zip(own) {
        let symbol = format!("E{symbol}0{axis}_lsc");
        estimate.parameters.push(parameter_with_budget(&symbol, Unit::Um, value, own));
    }
    let um = |i: usize| total_displacements_mm(layout, x).iter().map(|point| point[i] * 1e3).collect();
    estimate.circles.push(CircleFigure {
        symbol: format!("axis of {axis}"),
        unit: Unit::Um,
        x: um(0),
        y: um(1),
        centre: circle.centre.map(|mm| mm * 1e3),
        radius: circle.radius * 1e3,
        centre_expanded,
    });
}

/// E_total at each angle of the axis at the first height, mm.
fn total_displacements_mm(layout: &UnknownsLayout, x: &[f64]) -> Vec<[f64; 2]> {
    (0..layout.design.angle_count).map(|i| [x[layout.ex_index(0, i)], x[layout.ey_index(0, i)]]).collect()
}
