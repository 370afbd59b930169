//! The estimate in the terms and units of the Estimate JSON.

use super::bench::QualificationSetup;
use super::fit::Fitted;
use super::observe::Observed;
use super::sources::Scatter;
use crate::identification::probe_map::symbols;
use crate::identification::{MisfitAdvice, reported_parameter};
use estimation::coverage::chi_square_bounds;
use machine::record::estimate::{Estimate, FigureKind, Function, Parameter, Unit};

/// Symbol of the standard deviation of one touch, from its repeats.
const REPEATABILITY: &str = "s_touch";

const MISFIT_ADVICE: MisfitAdvice = MisfitAdvice {
    causes: "a loose stylus or ball, dirt, lobes of a higher order than the map has",
    declared_by: "form_um of the method or error_motion_um of the axes",
};

pub fn estimate(bench: &QualificationSetup<'_>, observed: &Observed, fitted: &Fitted) -> Estimate {
    let Fitted { identified, layout, scatter, .. } = fitted;
    let mut estimate = identified.estimate(bench.plan.method.as_str());
    let carried: Vec<String> = layout
        .map
        .iter()
        .filter(|order| **order == 2 && !layout.separates(2))
        .flat_map(|order| symbols(*order))
        .collect();
    for parameter in &mut estimate.parameters {
        parameter.identifiable = !carried.contains(&parameter.symbol);
    }
    estimate.parameters.push(repeatability(*scatter));
    estimate.functions.push(by_direction(bench, observed, fitted));
    Estimate {
        gauge: vec![
            "E_probe: radial deviation of the stylus centre at contact, positive outward, over the azimuth of the contact \
             in the frame of the spindle; at other angles to the spindle it is multiplied by the sine of that angle"
                .to_owned(),
            "r_stylus: less the stated radii of ball and stylus ball; the certificate of the ball's diameter is not \
             in its uncertainty"
                .to_owned(),
            format!(
                "E_probe_fast and t_latch: of touches at {} mm/min against those at {} mm/min",
                bench.fast_mm_min(),
                bench.plan.probe.feed_mm_min
            ),
        ],
        not_identifiable: cannot_know(bench, fitted),
        warnings: warnings(bench, fitted),
        ..estimate
    }
}

fn repeatability(scatter: Scatter) -> Parameter {
    let [s_mm, u_mm] = scatter.without_rounding();
    reported_parameter(REPEATABILITY, Unit::Um, s_mm, u_mm, Some(scatter.dof as f64))
}

/// Standard deviation of one slow touch in each direction of the circle, pooled over the orientations.
fn by_direction(bench: &QualificationSetup<'_>, observed: &Observed, fitted: &Fitted) -> Function {
    let count = bench.settings.azimuths as usize;
    let pitch = 360.0 / count as f64;
    let mut groups = vec![Vec::new(); count];
    let (mut squares, mut touches) = (vec![0.0; count], vec![0.0; count]);
    for (touch, within_mm) in observed.touches.iter().zip(&fitted.within_mm) {
        let azimuth = touch.normal.y.atan2(touch.normal.x).to_degrees();
        let nearest = (azimuth / pitch).round();
        // The directions of the second circle are between those of the first.
        if touch.is_fast || (azimuth / pitch - nearest).abs() > 0.25 || touch.normal.z > 0.9 {
            continue;
        }
        let direction = (nearest as i64).rem_euclid(count as i64) as usize;
        squares[direction] += within_mm * within_mm;
        touches[direction] += 1.0;
        if !groups[direction].contains(&touch.group) {
            groups[direction].push(touch.group);
        }
    }
    let of_direction = |k: usize| {
        let dof = (touches[k] - groups[k].len() as f64).max(1.0);
        let scatter =
            Scatter { s_mm: (squares[k] / dof).sqrt(), dof: dof as usize, ..fitted.scatter };
        scatter.without_rounding().map(|mm| mm * 1e3)
    };
    let (y, u) = (0..count).map(of_direction).map(|[s, u]| (s, u)).unzip();
    Function {
        symbol: REPEATABILITY.to_owned(),
        argument: "azimuth".to_owned(),
        argument_unit: "deg".to_owned(),
        x: (0..count).map(|k| k as f64 * pitch).collect(),
        unit: Unit::Um,
        u,
        y,
        figure: FigureKind::Curve,
        at_mm: None,
    }
}

fn cannot_know(bench: &QualificationSetup<'_>, fitted: &Fitted) -> Vec<String> {
    let layout = &fitted.layout;
    let mut lines = Vec::new();
    if !layout.separates(1) {
        lines.push(
            "order 1 of the map and stylus offset: inseparable from the centre of the ball, as the spindle was not turned"
                .to_owned(),
        );
    }
    if !layout.separates(2) {
        lines.push(
            "order 2 of the map: inseparable from squareness, scale difference and backlash of X and Y. Later runs do not \
             take it off; its size is in their uncertainty"
                .to_owned(),
        );
    }
    let higher = layout.map.iter().filter(|order| **order > 2 && !layout.separates(**order));
    let higher: Vec<String> = higher.map(u32::to_string).collect();
    if !higher.is_empty() {
        let orders = higher.join(", ");
        lines.push(match bench.settings.form_um {
            Some(form_um) => format!(
                "map at order {orders}: inseparable from the form of the ball, which is certified to {form_um} µm"
            ),
            None => format!(
                "map at order {orders}: inseparable from the form of the ball, of which no form_um is certified; later runs \
                 do not take it off"
            ),
        });
    }
    let last = bench.last_order();
    lines.push(format!(
        "orders above {last}: order k is aliased with order {} - k",
        bench.settings.azimuths
    ));
    lines.extend(fitted.identified.checked.limits());
    lines
}

/// Probability that the scatter of correct touches is within its two-sided bounds. A warning needs the upper bound
/// to be exceeded.
const DECLARED: f64 = 0.998;

fn warnings(bench: &QualificationSetup<'_>, fitted: &Fitted) -> Vec<String> {
    let mut lines = Vec::new();
    let Scatter { s_mm, dof, step_mm } = fitted.scatter;
    if let Some(declared) = bench.plan.probe.repeatability_um {
        let expected = (declared * 1e-3).powi(2) + step_mm.powi(2) / 12.0;
        let chi2 = dof as f64 * s_mm.powi(2) / expected;
        let bounds = chi_square_bounds(dof as f64, DECLARED);
        lines.extend(bounds.filter(|(_, most)| chi2 > *most).map(|_| {
            format!(
                "touches repeat to {:.2} µm, worse than the declared repeatability_um = {declared}: declare what was \
                 measured, or check the stylus and the ball",
                fitted.scatter.without_rounding()[0] * 1e3
            )
        }));
    }
    lines.extend(fitted.identified.misfit_warning(&MISFIT_ADVICE));
    lines.extend(fitted.identified.checked.warnings.iter().cloned());
    lines
}
