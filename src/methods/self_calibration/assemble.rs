//! The estimate in the words and units of the contract.

use faer::Mat;

use super::algebra::dot;
use super::axis_circle::{AxisCircle, axis_circle};
use super::model::DRIFTING;
use super::outputs;
use super::paper::PaperForm;
use super::parts::Parts;
use super::sense::Sense;
use super::settings::Spindle;
use estimation::coverage;
use machine::record::estimate::{
    BudgetLine, CircleFigure, Covariance, ESTIMATE_VERSION, Estimate, Function, Parameter, Unit,
    Verdict,
};

pub fn estimate(parts: &Parts<'_>) -> Estimate {
    let solution = &parts.fit.solution;
    let residuals = &parts.solved.residuals;
    let mean_square = residuals.iter().map(|r| r * r).sum::<f64>() / residuals.len().max(1) as f64;
    let mut parameters = reported_parameters(parts);
    let circle = axis_circle(parts);
    if let Some(circle) = &circle {
        parameters.extend(circle_parameters(parts, circle));
    }
    for parameter in &mut parameters {
        // Under the wrong sense of C these are answers to another question.
        parameter.identifiable = parts.sense != Sense::Contradicted;
    }
    Estimate {
        trued_estimate: ESTIMATE_VERSION,
        method: super::NAME.to_owned(),
        parameters,
        functions: reported_functions(parts),
        circles: circle.iter().map(|circle| circle_figure(parts, circle)).collect(),
        arrows: Vec::new(),
        weakest: None,
        covariance: covariance(parts),
        rank: solution.rank,
        unknowns: parts.fit.layout.unknowns() - parts.fit.layout.gauge().nrows(),
        condition: solution.condition,
        gauge: gauge(parts),
        not_identifiable: not_identifiable(parts),
        residual_rms_um: mean_square.sqrt() * 1e3,
        degrees_of_freedom: solution.dof,
        chi2_per_dof: if solution.dof > 0 { parts.chi2 / solution.dof as f64 } else { 0.0 },
        verdict: Verdict::None,
        warnings: warnings(parts),
        priors: Vec::new(),
    }
}

fn reported_parameters(parts: &Parts<'_>) -> Vec<Parameter> {
    parts
        .parameters
        .iter()
        .enumerate()
        .map(|(i, output)| {
            let value = dot(&output.coefficients, &parts.solved.x);
            let dof = parts.propagated.dof(i, parts.scale);
            let budget = parts
                .propagated
                .budget
                .iter()
                .map(|(source, u)| BudgetLine {
                    source: (*source).to_owned(),
                    u: output.unit.from_internal(u[i]),
                })
                .collect();
            Parameter {
                u_monte_carlo: Some(
                    output.unit.from_internal(parts.monte_carlo.standard_deviation[i]),
                ),
                budget,
                ..parameter(&output.symbol, output.unit, value, parts.propagated.u(i), dof)
            }
        })
        .collect()
}

/// The circle's centre, beside the mean.
fn circle_parameters(parts: &Parts<'_>, circle: &AxisCircle) -> Vec<Parameter> {
    ["EX0C_lsc", "EY0C_lsc"]
        .into_iter()
        .enumerate()
        .map(|(i, symbol)| {
            let dof = parts.propagated.dof(i, parts.scale);
            parameter(symbol, Unit::Um, circle.fitted.centre[i], circle.u[i], dof)
        })
        .collect()
}

fn circle_figure(parts: &Parts<'_>, circle: &AxisCircle) -> CircleFigure {
    let um = |i: usize| circle.points.iter().map(|point| point[i] * 1e3).collect();
    let k = |i| {
        coverage::coverage_factor(parts.propagated.dof(i, parts.scale).unwrap_or(f64::INFINITY))
    };
    CircleFigure {
        symbol: "axis of C".to_owned(),
        unit: Unit::Um,
        x: um(0),
        y: um(1),
        centre: circle.fitted.centre.map(|v| v * 1e3),
        radius: circle.fitted.radius * 1e3,
        centre_expanded: [0, 1].map(|i| k(i) * circle.u[i] * 1e3),
    }
}

/// A parameter from internal value and standard uncertainty.
fn parameter(symbol: &str, unit: Unit, value: f64, u: f64, dof: Option<f64>) -> Parameter {
    let k = coverage::coverage_factor(dof.unwrap_or(f64::INFINITY));
    Parameter {
        symbol: symbol.to_owned(),
        value: unit.from_internal(value),
        unit,
        u: unit.from_internal(u),
        expanded: unit.from_internal(k * u),
        k,
        dof,
        identifiable: true,
        u_monte_carlo: None,
        budget: Vec::new(),
    }
}

fn reported_functions(parts: &Parts<'_>) -> Vec<Function> {
    let design = &parts.fit.layout.design;
    let mut index = parts.parameters.len();
    parts
        .functions
        .iter()
        .map(|function| {
            let first = index;
            index += function.points.len();
            Function {
                symbol: function.symbol.clone(),
                argument: function.argument.to_owned(),
                argument_unit: "deg".to_owned(),
                x: (0..design.n).map(|i| round_deg(design.angle(i))).collect(),
                unit: Unit::Um,
                y: function.points.iter().map(|p| dot(p, &parts.solved.x) * 1e3).collect(),
                u: (first..index).map(|i| parts.propagated.u(i) * 1e3).collect(),
                figure: function.figure,
            }
        })
        .collect()
}

fn round_deg(angle: f64) -> f64 {
    (angle.to_degrees() * 1e9).round() / 1e9
}

fn covariance(parts: &Parts<'_>) -> Covariance {
    let factor: Vec<f64> = parts.parameters.iter().map(|p| p.unit.from_internal(1.0)).collect();
    let full: &Mat<f64> = &parts.propagated.covariance;
    let rows = (0..factor.len())
        .map(|i| (0..factor.len()).map(|j| full[(i, j)] * factor[i] * factor[j]).collect())
        .collect();
    Covariance { symbols: parts.parameters.iter().map(|p| p.symbol.clone()).collect(), rows }
}

fn gauge(parts: &Parts<'_>) -> Vec<String> {
    let mut lines = parts.fit.layout.gauge_in_words();
    let heights: Vec<String> = parts.heights.iter().map(|z| format!("{z:.3}")).collect();
    lines.push(match heights.len() {
        1 => format!("EX0C and EY0C hold at Z = {} mm only", heights[0]),
        _ => format!(
            "EX0C and EY0C hold at the mean of Z = {} mm; EA0C and EB0C are relative to the Z axis",
            heights.join(", ")
        ),
    });
    if parts.fit.layout.drift_order > 0 {
        lines.push(format!(
            "drift of X, Y and radius fitted (order {}) and removed; values hold at the middle of \
             the cycle{}",
            parts.fit.layout.drift_order,
            if parts.plan.gaps_s.is_empty() { "" } else { ", interruptions left out" }
        ));
    }
    lines
}

fn not_identifiable(parts: &Parts<'_>) -> Vec<String> {
    let mut lines = vec![
        "common scale of X and Y: inseparable from the radius R".to_owned(),
        "machine origin: fixed by the gauge".to_owned(),
        "co-rotating first harmonic of the error motion: inseparable from the part's set-up"
            .to_owned(),
    ];
    if parts.settings.spindle == Spindle::Fixed {
        lines.push(
            "stylus offset and odd lobes of the probe: inseparable from EX0C and EY0C with a fixed \
             spindle (they stand in the budget; spindle = \"follow\" removes them)"
                .to_owned(),
        );
    }
    if parts.fit.layout.heights == 1 {
        lines.push("EA0C and EB0C: need two heights (heights_mm)".to_owned());
    }
    lines
}

fn warnings(parts: &Parts<'_>) -> Vec<String> {
    let mut lines = Vec::new();
    match parts.sense {
        Sense::Confirmed => {}
        Sense::NotConfirmed => lines.push(
            "sense of C not confirmed by these readings: an eccentric or lobed part and a number of \
             positions divisible by 4 show it best"
                .to_owned(),
        ),
        Sense::Contradicted => lines.push(
            "the readings contradict the stated sense of C: check [axes.C] positive".to_owned(),
        ),
    }
    if parts.scale.dof.is_some() && parts.plan.probe.repeatability_um.is_some() {
        lines.push(format!(
            "the touches scatter {:.1} times more than declared; the uncertainty follows the \
             residuals",
            parts.scale.factor
        ));
    }
    let dof = parts.fit.solution.dof as f64;
    let least = coverage::chi_square_bounds(dof, 0.998).map_or(0.0, |(lower, _)| lower);
    if parts.plan.probe.repeatability_um.is_some() && parts.chi2 < least {
        lines.push(
            "the touches scatter less than declared: repeatability_um may be stated too large, and \
             the uncertainty with it"
                .to_owned(),
        );
    }
    if !parts.timed && parts.settings.drift_order > 0 {
        lines.push(
            "the readings carry no times: their order and the planned machine time served for the \
             drift"
                .to_owned(),
        );
    }
    lines.extend(steps(parts));
    lines.extend(disagreement(parts));
    lines.extend(paper_comparison(parts));
    lines
}

/// What the machine did in the interruptions, with U from the touches' scatter.
fn steps(parts: &Parts<'_>) -> Vec<String> {
    let layout = &parts.fit.layout;
    let k = coverage::coverage_factor(parts.scale.dof.unwrap_or(f64::INFINITY));
    let um = |gap: usize, what: usize| {
        let at = layout.step(what, gap);
        let u = parts.scale.factor * parts.fit.solution.covariance[(at, at)].max(0.0).sqrt();
        format!("{} {:+.2} ± {:.2}", DRIFTING[what], parts.solved.x[at] * 1e3, k * u * 1e3)
    };
    let mut lines: Vec<String> = (0..layout.gaps.len())
        .map(|gap| {
            let steps: Vec<String> = (0..DRIFTING.len()).map(|what| um(gap, what)).collect();
            format!("interrupted: a step was fitted and removed, {} µm", steps.join(", "))
        })
        .collect();
    if parts.left_out > 0 {
        lines.push(format!(
            "{} readings stand between interruptions without references and are left out",
            parts.left_out
        ));
    }
    lines
}

/// Where covariance and Monte Carlo differ.
fn disagreement(parts: &Parts<'_>) -> Vec<String> {
    parts
        .parameters
        .iter()
        .enumerate()
        .filter_map(|(i, output)| {
            let (first_order, trials) =
                (parts.propagated.u(i), parts.monte_carlo.standard_deviation[i]);
            parts.monte_carlo.contradicts(i, first_order).then(|| {
                format!(
                    "{}: u by covariance {:.3} and by Monte Carlo {:.3} {} disagree",
                    output.symbol,
                    output.unit.from_internal(first_order),
                    output.unit.from_internal(trials),
                    output.unit.symbol()
                )
            })
        })
        .collect()
}

/// The paper's own identification of the first pass beside ours, where it is far off: more than
/// four times the product's u.
fn paper_comparison(parts: &Parts<'_>) -> Vec<String> {
    let mut design = parts.fit.layout.design.clone();
    design.probes.truncate(2);
    let form = PaperForm::new(&design);
    let Some(paper) = form.axis_position(&parts.fit.observations) else { return Vec::new() };
    let (x, y) = outputs::axis_position(&parts.fit.layout, 0);
    let own = [dot(&x, &parts.solved.x), dot(&y, &parts.solved.x)];
    let far = (0..2).any(|i| (paper[i] - own[i]).abs() > 4.0 * parts.propagated.u(i));
    let told = format!(
        "the paper's form (differences, no drift, first order) gives EX0C {:.2}, EY0C {:.2} um",
        paper[0] * 1e3,
        paper[1] * 1e3
    );
    if far { vec![told] } else { Vec::new() }
}
