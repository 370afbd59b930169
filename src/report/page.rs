//! Self-contained HTML page of a result: no script, no external resource, readable in print and in dark mode.

use minijinja::{AutoEscape, Environment, UndefinedBehavior, Value, context};

use super::captions::{figure_values, svg_value, symbol_value};
use super::rows::NameTextRows;
use super::{ErrorMap, clearance, correlation, figure, number, plan_summary, vectors};
use machine::record::estimate::{BudgetLine, Distribution, Estimate, EvaluationType, LimitVerdict, Parameter, Verdict};
use machine::record::plan::Plan;
use machine::record::stage_proof::StageProof;

const PAGE_TEMPLATE: &str = include_str!("page.html");
/// Minimum number of results in large type at the top. A method lists its main results first.
const MIN_HEADLINE_RESULTS: usize = 2;

/// Data of the run besides plan and estimate. Empty fields are left out.
#[derive(Debug, Clone, Default)]
pub struct ReportFacts {
    pub run_id: String,
    pub start_time: String,
    pub run_state: String,
    /// Time and text of stops, faults and acknowledgements.
    pub events_with_times: Vec<(String, String)>,
    /// Signatures of the result; `None` if it cannot be signed.
    pub signatures: Option<Vec<String>>,
    pub reading_count: usize,
    /// Temperatures of each thermometer.
    pub temperature_rows: NameTextRows,
    pub program_version: String,
    /// Name of each hashed item (machine file, plan, ..) and its SHA-256.
    pub sha256_by_item: Vec<(String, String)>,
    /// Proof of each stage, in order.
    pub stage_proofs: Vec<StageProof>,
    /// Position error of the tool over the volume, in sentences and as maps.
    pub volume_texts_and_maps: Option<(Vec<String>, Vec<ErrorMap>)>,
}

/// Renders the report of `estimate`.
///
/// # Errors
/// The template is invalid.
pub fn render_result_page(plan: &Plan, estimate: &Estimate, facts: &ReportFacts) -> Result<String, minijinja::Error> {
    let mut environment = Environment::new();
    environment.set_undefined_behavior(UndefinedBehavior::Strict);
    environment.set_auto_escape_callback(|_| AutoEscape::Html);
    environment.render_str(
        PAGE_TEMPLATE,
        context! {
            method => plan.method.as_str(),
            machine => plan.machine.name.as_str(),
            verdict => verdict_value(estimate),
            is_judged => estimate.parameters.iter().any(|p| p.judged.is_some()),
            decision_rule => estimate.decision_rule.as_deref(),
            coverage => estimate.coverage_percent,
            trials => estimate.trials,
            parameters => estimate.parameters.iter().map(parameter_value).collect::<Vec<_>>(),
            key_results => headline_result_count(&estimate.parameters),
            figures => figure_values(estimate),
            related => correlation::correlation_values(&estimate.covariance),
            vectors => estimate.arrows.iter().map(vectors::vector_figure_value).collect::<Vec<_>>(),
            volume => facts.volume_texts_and_maps.as_ref().map(|(lines, maps)| volume_value(lines, maps)),
            warmth => facts.temperature_rows.clone(),
            budget => budget_value(&estimate.parameters),
            warnings => estimate.warnings.clone(),
            gauge => estimate.gauge.clone(),
            not_identifiable => estimate.not_identifiable.clone(),
            quality => fit_quality_rows(estimate),
            plan => plan_summary::plan_rows(plan),
            proof => proof_value(plan, &facts.stage_proofs),
            facts => fact_rows(facts, &estimate.priors),
            story => facts.events_with_times.clone(),
            signed => facts.signatures.clone(),
            program_version => facts.program_version.as_str(),
        },
    )
}

/// Number of results at the top: the first two, or all leading parameters of one quantity, such as `EXC_range`
/// to `ECC_range`.
fn headline_result_count(parameters: &[Parameter]) -> usize {
    let quantity = |parameter: &Parameter| parameter.symbol.split_once('_').map(|(_, quantity)| quantity.to_owned());
    let first = parameters.first().and_then(quantity);
    let of_first = |parameter: &&Parameter| first.is_some() && quantity(parameter) == first;
    parameters.iter().take_while(of_first).count().max(MIN_HEADLINE_RESULTS)
}

/// CSS class of the badge and its text.
fn verdict_value(estimate: &Estimate) -> Value {
    let (class, text) = match estimate.verdict {
        Verdict::Pass => ("pass", "Pass: in tolerance, with the uncertainty included"),
        Verdict::Fail => ("fail", "Fail: out of tolerance by more than the uncertainty"),
        Verdict::Undecided => ("undecided", "Undecided: the limit is inside the uncertainty interval"),
        Verdict::UndecidedModel => {
            ("undecided", "Undecided: the readings contradict the model or the declared data; each U is a lower bound")
        }
        Verdict::None => ("none", "No verdict: no tolerance in the machine file"),
    };
    let names = match estimate.verdict {
        Verdict::UndecidedModel => String::new(),
        verdict => estimate.symbols_with_verdict(verdict).join(", "),
    };
    context! { class, text, names }
}

fn parameter_value(parameter: &Parameter) -> Value {
    let decimals = number::decimals_for_uncertainty(parameter.expanded);
    context! {
        symbol => symbol_value(&parameter.symbol),
        value => number::format_fixed(parameter.value, decimals),
        unit => number::unit_symbol(parameter.unit),
        u => number::format_fixed(parameter.u, decimals),
        expanded => number::format_fixed(parameter.expanded, decimals),
        k => number::format_fixed(parameter.k, 2),
        dof => degrees_of_freedom(parameter.dof),
        interval => parameter.interval_monte_carlo.map_or("—".to_owned(), |ends| {
            ends.map(|end| number::format_fixed(end, decimals)).join(" to ")
        }),
        identifiable => parameter.identifiable,
        judged => parameter.judged.map(limit_verdict_value),
    }
}

fn degrees_of_freedom(dof: Option<f64>) -> String {
    dof.map_or("∞".to_owned(), |dof| number::format_fixed(dof, 1))
}

fn limit_verdict_value(LimitVerdict { limit, verdict, conformance }: LimitVerdict) -> Value {
    context! {
        limit => number::format_fixed(limit, 1),
        verdict => verdict.to_string(),
        conformance => conformance.map_or("—".to_owned(), |p| format!("{} %", number::format_fixed(100.0 * p, 1))),
    }
}

fn volume_value(lines: &[String], maps: &[ErrorMap]) -> Value {
    let largest = maps.iter().map(ErrorMap::max_value).fold(0.0, f64::max);
    let drawn = maps.iter().map(|map| {
        context! { title => map.title.as_str(), panels => map.draw(largest).map(svg_value).to_vec() }
    });
    context! { lines => lines.to_vec(), maps => drawn.collect::<Vec<_>>() }
}

/// Proof of the motions, made before any motion.
fn proof_value(plan: &Plan, proofs: &[StageProof]) -> Value {
    context! {
        rows => clearance::clearance_rows(plan, proofs),
        svg => svg_value(clearance::clearance_of_each_step(proofs).and_then(|f| figure::draw_function(&f, 1.0))),
        not_looked_at => clearance::unchecked_aspects(proofs),
    }
}

/// The uncertainty budget: a row per parameter, a column per source.
fn budget_value(parameters: &[Parameter]) -> Value {
    let mut sources: Vec<&BudgetLine> = Vec::new();
    for line in parameters.iter().flat_map(|parameter| &parameter.budget) {
        if sources.iter().all(|known| known.source != line.source) {
            sources.push(line);
        }
    }
    let rows = parameters.iter().filter(|row| row.identifiable && !row.budget.is_empty());
    let rows: Vec<Value> = rows
        .map(|parameter| {
            let decimals = number::decimals_for_uncertainty(parameter.u);
            let share = |source: &&BudgetLine| {
                let line = parameter.budget.iter().find(|line| line.source == source.source);
                line.map_or(String::new(), |line| number::format_fixed(line.u, decimals))
            };
            context! {
                symbol => symbol_value(&parameter.symbol),
                unit => number::unit_symbol(parameter.unit),
                shares => sources.iter().map(share).collect::<Vec<_>>(),
                u => number::format_fixed(parameter.u, decimals),
            }
        })
        .collect();
    let title = |line: &&BudgetLine| format!("{}{}", line.source, if line.assumed { " (assumed)" } else { "" });
    context! {
        sources => sources.iter().map(title).collect::<Vec<_>>(),
        head => evaluation_rows(&sources),
        rows,
        assumed => sources.iter().any(|line| line.assumed),
    }
}

/// Evaluation of the sources: a row per property, a column per source.
fn evaluation_rows(sources: &[&BudgetLine]) -> Vec<Value> {
    let row = |name: &str, text: &dyn Fn(&BudgetLine) -> String| {
        let texts: Vec<String> = sources.iter().map(|line| text(line)).collect();
        context! { name, texts }
    };
    let or_nothing = |text: Option<&str>| text.unwrap_or_default().to_owned();
    vec![
        row("Type", &|line| or_nothing(line.evaluation_type.map(EvaluationType::as_str))),
        row("Distribution", &|line| or_nothing(line.distribution.map(Distribution::as_str))),
        row("Degrees of freedom", &|line| degrees_of_freedom(line.dof)),
    ]
}

fn fit_quality_rows(estimate: &Estimate) -> NameTextRows {
    let mut rows = vec![
        ("Rank", format!("{} of {} unknowns", estimate.rank, estimate.unknowns)),
        ("Scaled condition number", number::format_fixed(estimate.condition, 2)),
        ("Weakest combination of parameters", estimate.weakest.clone().unwrap_or_default()),
        ("Residuals (rms)", format!("{} µm", number::format_fixed(estimate.residual_rms_um, 3))),
        ("Degrees of freedom", estimate.degrees_of_freedom.to_string()),
        ("χ² divided by its expected value", number::format_fixed(estimate.chi2_per_dof, 2)),
    ];
    rows.retain(|(_, text)| !text.is_empty());
    rows.into_iter().map(|(name, text)| (name.to_owned(), text)).collect()
}

fn fact_rows(facts: &ReportFacts, priors: &[String]) -> NameTextRows {
    let text = |name: &str, value: &str| (name.to_owned(), value.to_owned());
    let mut rows = vec![
        text("Run", &facts.run_id),
        text("Started", &facts.start_time),
        text("State", &facts.run_state),
        text("Readings", &facts.reading_count.to_string()),
        text("trued", &facts.program_version),
    ];
    rows.extend(facts.sha256_by_item.iter().map(|(what, hash)| (format!("SHA-256 of the {what}"), hash.clone())));
    rows.extend(priors.iter().map(|hash| text("Earlier estimate used as known (SHA-256)", hash)));
    rows.retain(|(_, value)| !value.is_empty());
    rows
}
