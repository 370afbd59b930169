//! The estimate in the words and units of the contract.

use super::bench::Bench;
use super::fit::Fitted;
use super::observe::Observed;
use super::sources::Scatter;
use crate::identification::probe_map::symbols;
use crate::identification::{MisfitAdvice, reported_parameter};
use machine::record::estimate::{Estimate, FigureKind, Function, Parameter, Unit};

/// Of one touch, from its repeats.
const REPEATABILITY: &str = "s_touch";

const MISFIT_ADVICE: MisfitAdvice = MisfitAdvice {
    causes: "a loose stylus or ball, dirt, lobes of a higher order than the map has",
    declared_by: "form_um of the method or error_motion_um of the axes",
};

pub fn estimate(bench: &Bench<'_>, observed: &Observed, fitted: &Fitted) -> Estimate {
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
            "map: how much farther out than the mean the stylus centre stands in contact, over the azimuth of the \
             contact in the frame of the spindle, at right angles to the spindle; it fades with the sine of the angle \
             to the spindle"
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

fn repeatability(Scatter { s_mm, dof }: Scatter) -> Parameter {
    // GUM E.4.3.
    let u_mm = s_mm / (2.0 * dof as f64).sqrt();
    reported_parameter(REPEATABILITY, Unit::Um, s_mm, u_mm, Some(dof as f64))
}

/// Standard deviation of one slow touch in each direction of the circle, pooled over the orientations.
fn by_direction(bench: &Bench<'_>, observed: &Observed, fitted: &Fitted) -> Function {
    let count = bench.settings.azimuths as usize;
    let pitch = 360.0 / count as f64;
    let mut groups = vec![Vec::new(); count];
    let (mut squares, mut touches) = (vec![0.0; count], vec![0.0; count]);
    for (touch, within_mm) in observed.touches.iter().zip(&fitted.within_mm) {
        let azimuth = touch.normal.y.atan2(touch.normal.x).to_degrees();
        let nearest = (azimuth / pitch).round();
        // Those of the second circle lie between.
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
    let dof = |k: usize| (touches[k] - groups[k].len() as f64).max(1.0);
    let s_um: Vec<f64> = (0..count).map(|k| (squares[k] / dof(k)).sqrt() * 1e3).collect();
    Function {
        symbol: REPEATABILITY.to_owned(),
        argument: "azimuth".to_owned(),
        argument_unit: "deg".to_owned(),
        x: (0..count).map(|k| k as f64 * pitch).collect(),
        unit: Unit::Um,
        u: s_um.iter().enumerate().map(|(k, s)| s / (2.0 * dof(k)).sqrt()).collect(),
        y: s_um,
        figure: FigureKind::Curve,
        at_mm: None,
    }
}

fn cannot_know(bench: &Bench<'_>, fitted: &Fitted) -> Vec<String> {
    let layout = &fitted.layout;
    let mut lines = Vec::new();
    if !layout.separates(1) {
        lines.push(
            "first order of the map and stylus offset: they are the centre of the ball, as the spindle was not turned"
                .to_owned(),
        );
    }
    if !layout.separates(2) {
        lines.push(
            "second order of the map: squareness and scale difference of X and Y, and their backlash, look alike. It is \
             carried as an uncertainty of later runs, not taken off"
                .to_owned(),
        );
    }
    let higher = layout.map.iter().filter(|order| **order > 2 && !layout.separates(**order));
    let higher: Vec<String> = higher.map(u32::to_string).collect();
    if !higher.is_empty() {
        let orders = higher.join(", ");
        lines.push(match bench.settings.form_um {
            Some(form_um) => format!(
                "orders {orders} of the map and the form of the ball: told apart to its certified {form_um} µm alone"
            ),
            None => format!(
                "orders {orders} of the map and the form of the ball look alike, and no form_um is certified: later runs \
                 do not take these orders off"
            ),
        });
    }
    let last = bench.last_order();
    lines.push(format!(
        "orders above {last}: order k is not told from {} - k",
        bench.settings.azimuths
    ));
    lines.extend(fitted.identified.checked.limits());
    lines
}

/// Scatter beyond so many times the declared one is told.
const MORE_THAN_DECLARED: f64 = 1.5;

fn warnings(bench: &Bench<'_>, fitted: &Fitted) -> Vec<String> {
    let mut lines = Vec::new();
    let s_um = fitted.scatter.s_mm * 1e3;
    let declared = bench.plan.probe.repeatability_um;
    if let Some(declared) = declared.filter(|um| s_um > MORE_THAN_DECLARED * um) {
        lines.push(format!(
            "touches repeat to {s_um:.2} µm, worse than the declared repeatability_um = {declared}: state what was \
             measured, or look for a loose stylus"
        ));
    }
    lines.extend(fitted.identified.misfit_warning(&MISFIT_ADVICE));
    lines.extend(fitted.identified.checked.warnings.iter().cloned());
    lines
}
