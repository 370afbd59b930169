//! The estimate in the terms and units of the Estimate JSON.

use super::fit::QualificationFit;
use super::observe::ObservedTouches;
use super::setup::QualificationSetup;
use super::sources::PooledScatter;
use crate::identification::probe_map::probe_map_symbols;
use crate::identification::{MisfitAdvice, parameter_without_budget};
use estimation::coverage::chi_square_bounds;
use machine::record::estimate::{Estimate, EstimatedFunction, FunctionFigureKind, Parameter, Unit};

/// Symbol of the standard deviation of one touch, from its repeats.
const REPEATABILITY_SYMBOL: &str = "s_touch";

const MISFIT_ADVICE: MisfitAdvice = MisfitAdvice {
    possible_causes: "a loose stylus or ball, dirt, lobes of an order above those of the map",
    declaring_settings: "form_um of the method or error_motion_um of the axes",
};

pub fn build_estimate(
    setup: &QualificationSetup<'_>,
    observed: &ObservedTouches,
    fitted: &QualificationFit,
) -> Estimate {
    let QualificationFit { identification, layout, scatter, .. } = fitted;
    let mut estimate = identification.estimate(setup.plan.method.as_str());
    let carried: Vec<String> = layout
        .map_orders
        .iter()
        .filter(|order| **order == 2 && !layout.is_order_separable(2))
        .flat_map(|order| probe_map_symbols(*order))
        .collect();
    for parameter in &mut estimate.parameters {
        parameter.identifiable = !carried.contains(&parameter.symbol);
    }
    estimate.parameters.push(repeatability_parameter(*scatter));
    estimate.functions.push(repeatability_by_direction(setup, observed, fitted));
    Estimate {
        gauge: vec![
            "E_probe: radial deviation of the stylus centre at contact, positive outward, over the azimuth \
            of the contact in the spindle frame, for contacts perpendicular to the spindle; for other \
            contacts multiply by the sine of the angle to the spindle"
                .to_owned(),
            "r_stylus: effective radius minus the configured radii of ball and stylus ball; U does not \
            include the uncertainty of the ball's diameter"
                .to_owned(),
            format!(
                "E_probe_fast and t_latch: difference between touches at {} mm/min and at {} mm/min",
                setup.fast_feed_mm_min(),
                setup.plan.probe.feed_mm_min
            ),
        ],
        not_identifiable: describe_not_identifiable(setup, fitted),
        warnings: estimate_warnings(setup, fitted),
        ..estimate
    }
}

fn repeatability_parameter(scatter: PooledScatter) -> Parameter {
    let [s_mm, u_mm] = scatter.std_dev_and_u_without_rounding_mm();
    parameter_without_budget(REPEATABILITY_SYMBOL, Unit::Um, s_mm, u_mm, Some(scatter.dof as f64))
}

/// Standard deviation of one slow touch in each direction of the circle, pooled over the orientations.
fn repeatability_by_direction(
    setup: &QualificationSetup<'_>,
    observed: &ObservedTouches,
    fitted: &QualificationFit,
) -> EstimatedFunction {
    let count = setup.settings.azimuths as usize;
    let pitch = 360.0 / count as f64;
    let mut groups = vec![Vec::new(); count];
    let (mut squares, mut touches) = (vec![0.0; count], vec![0.0; count]);
    for (touch, group_deviations_mm) in observed.touches.iter().zip(&fitted.deviations_from_group_mean_mm) {
        let azimuth = touch.normal_in_machine.y.atan2(touch.normal_in_machine.x).to_degrees();
        let nearest = (azimuth / pitch).round();
        // The directions of the second circle are between those of the first.
        if touch.is_fast || (azimuth / pitch - nearest).abs() > 0.25 || touch.normal_in_machine.z > 0.9 {
            continue;
        }
        let direction = (nearest as i64).rem_euclid(count as i64) as usize;
        squares[direction] += group_deviations_mm * group_deviations_mm;
        touches[direction] += 1.0;
        if !groups[direction].contains(&touch.group_index) {
            groups[direction].push(touch.group_index);
        }
    }
    let of_direction = |k: usize| {
        let dof = (touches[k] - groups[k].len() as f64).max(1.0);
        let scatter = PooledScatter { std_dev_mm: (squares[k] / dof).sqrt(), dof: dof as usize, ..fitted.scatter };
        scatter.std_dev_and_u_without_rounding_mm().map(|mm| mm * 1e3)
    };
    let (y, u) = (0..count).map(of_direction).map(|[s, u]| (s, u)).unzip();
    EstimatedFunction {
        symbol: REPEATABILITY_SYMBOL.to_owned(),
        argument: "azimuth".to_owned(),
        argument_unit: "deg".to_owned(),
        x: (0..count).map(|k| k as f64 * pitch).collect(),
        unit: Unit::Um,
        u,
        y,
        figure: FunctionFigureKind::Curve,
        at_mm: None,
    }
}

fn describe_not_identifiable(setup: &QualificationSetup<'_>, fitted: &QualificationFit) -> Vec<String> {
    let layout = &fitted.layout;
    let mut lines = Vec::new();
    if !layout.is_order_separable(1) {
        lines.push(
            "order 1 of the map and stylus offset: inseparable from the centre of the ball, because the \
            spindle was not turned"
                .to_owned(),
        );
    }
    if !layout.is_order_separable(2) {
        lines.push(
            "order 2 of the map: inseparable from squareness, scale difference and backlash of X and Y. \
            Later runs do not subtract order 2; they include it in U"
                .to_owned(),
        );
    }
    let higher = layout.map_orders.iter().filter(|order| **order > 2 && !layout.is_order_separable(**order));
    let higher: Vec<String> = higher.map(u32::to_string).collect();
    if !higher.is_empty() {
        let orders = higher.join(", ");
        lines.push(match setup.settings.certified_roundness_um {
            Some(form_um) => format!(
                "map at order {orders}: inseparable from the form of the ball, which is certified to {form_um} µm"
            ),
            None => format!(
                "map at order {orders}: inseparable from the form of the ball, because no form_um is \
                certified; later runs do not subtract these orders"
            ),
        });
    }
    let last = setup.highest_order();
    lines.push(format!("orders above {last}: order k is aliased with order {} - k", setup.settings.azimuths));
    lines.extend(fitted.identification.outlier_check.describe_detection_limits());
    lines
}

/// Probability that the scatter of correct touches is within its two-sided bounds. Only scatter above the upper bound
/// causes a warning.
const SCATTER_BOUNDS_PROBABILITY: f64 = 0.998;

fn estimate_warnings(setup: &QualificationSetup<'_>, fitted: &QualificationFit) -> Vec<String> {
    let mut lines = Vec::new();
    let PooledScatter { std_dev_mm: s_mm, dof, control_resolution_mm: display_step_mm } = fitted.scatter;
    if let Some(declared) = setup.plan.probe.repeatability_um {
        let expected = (declared * 1e-3).powi(2) + display_step_mm.powi(2) / 12.0;
        let chi2 = dof as f64 * s_mm.powi(2) / expected;
        let bounds = chi_square_bounds(dof as f64, SCATTER_BOUNDS_PROBABILITY);
        lines.extend(bounds.filter(|(_, most)| chi2 > *most).map(|_| {
            format!(
                "the repeatability of a touch is {:.2} µm, worse than the declared repeatability_um = \
                {declared}: declare the measured value, or check the stylus and the ball",
                fitted.scatter.std_dev_and_u_without_rounding_mm()[0] * 1e3
            )
        }));
    }
    lines.extend(fitted.identification.misfit_warning(&MISFIT_ADVICE));
    lines.extend(fitted.identification.outlier_check.warnings.iter().cloned());
    lines
}
