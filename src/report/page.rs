//! One self-contained HTML page of a result: no script, nothing fetched, readable in print and on
//! a dark screen.

use minijinja::{AutoEscape, Environment, UndefinedBehavior, Value, context};

use super::rows::Rows;
use super::{figure, number, planned, proven, related, vectors};
use machine::record::estimate::{CircleFigure, Estimate, FigureKind, Function, Parameter, Verdict};
use machine::record::plan::Plan;
use machine::record::proof::Proof;

const TEMPLATE: &str = include_str!("page.html");
/// So many results stand in large figures at the top: a method lists its most wanted first.
const KEY_RESULTS: usize = 2;

/// What is known of the run beside plan and estimate. Empty fields are left out.
#[derive(Debug, Clone, Default)]
pub struct Facts {
    pub run: String,
    pub started: String,
    pub state: String,
    /// Stops, faults and acknowledgements: when, and in words.
    pub story: Vec<(String, String)>,
    /// Who answers for the result, if somebody could.
    pub signed: Option<Vec<String>>,
    pub readings: usize,
    /// Of each thermometer.
    pub warmth: Rows,
    pub program_version: String,
    /// What is hashed (machine file, plan, ..) and its SHA-256.
    pub hashes: Vec<(String, String)>,
    /// Of each stage, in order.
    pub proofs: Vec<Proof>,
}

/// Render the page of `estimate`.
///
/// # Errors
/// Only if the template itself is at fault.
pub fn render(plan: &Plan, estimate: &Estimate, facts: &Facts) -> Result<String, minijinja::Error> {
    let mut environment = Environment::new();
    environment.set_undefined_behavior(UndefinedBehavior::Strict);
    environment.set_auto_escape_callback(|_| AutoEscape::Html);
    environment.render_str(
        TEMPLATE,
        context! {
            method => plan.method.as_str(),
            machine => plan.machine.name.as_str(),
            verdict => verdict(estimate.verdict),
            parameters => estimate.parameters.iter().map(parameter).collect::<Vec<_>>(),
            key_results => KEY_RESULTS,
            figures => figures(estimate),
            related => related::related(&estimate.covariance),
            vectors => estimate.arrows.iter().map(vectors::vectors).collect::<Vec<_>>(),
            warmth => facts.warmth.clone(),
            budget => budget(&estimate.parameters),
            warnings => estimate.warnings.clone(),
            gauge => estimate.gauge.clone(),
            not_identifiable => estimate.not_identifiable.clone(),
            quality => quality(estimate),
            plan => planned::rows(plan),
            proof => proof(plan, &facts.proofs),
            facts => fact_rows(facts, &estimate.priors),
            story => facts.story.clone(),
            signed => facts.signed.clone(),
            program_version => facts.program_version.as_str(),
        },
    )
}

/// Class of the badge and its words.
fn verdict(verdict: Verdict) -> Value {
    let (class, text) = match verdict {
        Verdict::Pass => ("pass", "Pass: within tolerance, uncertainty included"),
        Verdict::Fail => ("fail", "Fail: out of tolerance, uncertainty included"),
        Verdict::Undecided => ("undecided", "Undecided: the uncertainty reaches over the limit"),
        Verdict::None => ("none", "No verdict: no tolerance was given"),
    };
    context! { class, text }
}

fn symbol(symbol: &str) -> Value {
    let (base, index) = number::split_symbol(symbol);
    context! { plain => symbol, base, index }
}

fn parameter(parameter: &Parameter) -> Value {
    let decimals = number::decimals(parameter.expanded);
    context! {
        symbol => symbol(&parameter.symbol),
        value => number::fixed(parameter.value, decimals),
        unit => number::unit(parameter.unit),
        u => number::fixed(parameter.u, decimals),
        expanded => number::fixed(parameter.expanded, decimals),
        k => number::fixed(parameter.k, 2),
        dof => parameter.dof.map_or("∞".to_owned(), |dof| number::fixed(dof, 1)),
        identifiable => parameter.identifiable,
    }
}

fn figures(estimate: &Estimate) -> Vec<Value> {
    // Functions state u alone; the largest k of the table covers the fewest degrees of freedom.
    let identified = estimate.parameters.iter().filter(|parameter| parameter.identifiable);
    let k = identified.map(|parameter| parameter.k).reduce(f64::max).unwrap_or(2.0);
    let k = if k.is_finite() { k } else { 2.0 };
    let functions = estimate.functions.iter().map(|function| function_figure(function, k));
    functions.chain(estimate.circles.iter().map(circle_figure)).collect()
}

fn function_figure(function: &Function, k: f64) -> Value {
    context! {
        symbol => symbol(&function.symbol),
        caption => caption(function, k),
        square => function.figure == FigureKind::Polar,
        svg => drawing(figure::function(function, k)),
    }
}

fn caption(function: &Function, k: f64) -> String {
    let stated = function.u.iter().any(|u| *u > 0.0);
    match function.figure {
        FigureKind::Histogram => {
            format!("{} values, and the normal distribution that scatters so", function.y.len())
        }
        FigureKind::Points if !stated => format!("over {}", function.argument),
        _ => format!("over {}, with ±U (k = {})", function.argument, number::fixed(k, 2)),
    }
}

fn circle_figure(circle: &CircleFigure) -> Value {
    let [ux, uy] = circle.centre_expanded;
    let decimals = number::decimals(ux.min(uy));
    let [x, y] = circle.centre.map(|value| number::fixed(value, decimals));
    let [ux, uy] = [ux, uy].map(|value| number::fixed(value, decimals));
    let radius = number::fixed(circle.radius, decimals);
    let unit = number::unit(circle.unit);
    context! {
        symbol => symbol(&circle.symbol),
        caption => format!(
            "points in their order and fitted circle, radius {radius} {unit}; centre with ±U: \
             x = ({x} ± {ux}) {unit}, y = ({y} ± {uy}) {unit}"
        ),
        square => true,
        svg => drawing(figure::circle(circle)),
    }
}

/// What was proven before anything moved.
fn proof(plan: &Plan, proofs: &[Proof]) -> Value {
    context! {
        rows => proven::rows(plan, proofs),
        svg => drawing(proven::function(proofs).and_then(|f| figure::function(&f, 1.0))),
        not_looked_at => proven::not_looked_at(proofs),
    }
}

fn drawing(svg: Option<String>) -> Value {
    svg.map_or(Value::from(()), Value::from_safe_string)
}

/// The uncertainty budget: a row per parameter, a column per source.
fn budget(parameters: &[Parameter]) -> Value {
    let mut sources: Vec<String> = Vec::new();
    for line in parameters.iter().flat_map(|parameter| &parameter.budget) {
        if !sources.contains(&line.source) {
            sources.push(line.source.clone());
        }
    }
    let rows = parameters.iter().filter(|row| row.identifiable && !row.budget.is_empty());
    let rows: Vec<Value> = rows
        .map(|parameter| {
            let decimals = number::decimals(parameter.u);
            let share = |source: &String| {
                let line = parameter.budget.iter().find(|line| line.source == *source);
                line.map_or(String::new(), |line| number::fixed(line.u, decimals))
            };
            context! {
                symbol => symbol(&parameter.symbol),
                unit => number::unit(parameter.unit),
                shares => sources.iter().map(share).collect::<Vec<_>>(),
                u => number::fixed(parameter.u, decimals),
            }
        })
        .collect();
    context! { sources, rows }
}

fn quality(estimate: &Estimate) -> Rows {
    let mut rows = vec![
        ("Rank", format!("{} of {} unknowns", estimate.rank, estimate.unknowns)),
        ("Scaled condition number", number::fixed(estimate.condition, 2)),
        ("What limits it", estimate.weakest.clone().unwrap_or_default()),
        ("Residuals (rms)", format!("{} µm", number::fixed(estimate.residual_rms_um, 3))),
        ("Degrees of freedom", estimate.degrees_of_freedom.to_string()),
        ("χ² over what is expected", number::fixed(estimate.chi2_per_dof, 2)),
    ];
    rows.retain(|(_, text)| !text.is_empty());
    rows.into_iter().map(|(name, text)| (name.to_owned(), text)).collect()
}

fn fact_rows(facts: &Facts, priors: &[String]) -> Rows {
    let text = |name: &str, value: &str| (name.to_owned(), value.to_owned());
    let mut rows = vec![
        text("Run", &facts.run),
        text("Started", &facts.started),
        text("State", &facts.state),
        text("Readings", &facts.readings.to_string()),
        text("trued", &facts.program_version),
    ];
    rows.extend(
        facts.hashes.iter().map(|(what, hash)| (format!("SHA-256 of the {what}"), hash.clone())),
    );
    rows.extend(priors.iter().map(|hash| text("Taken as known (SHA-256)", hash)));
    rows.retain(|(_, value)| !value.is_empty());
    rows
}
