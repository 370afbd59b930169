//! Self-contained HTML report of a result: no script, no external resource, readable in print and in dark mode.

use minijinja::value::Serde;
use minijinja::{AutoEscape, Environment, UndefinedBehavior, Value, context};

use super::captions::{figure_values, sketch_values, svg_value};
use super::difference::PreviousRun;
use super::number::with_one_line_symbols;
use super::residuals::{ResidualFigure, residual_figure_values};
use super::result_row::{
    ResultRow, RunContext, headline_rows, result_rows, rows_not_passed, verdict_class, verdict_sentence, verdict_word,
};
use super::rows::NameTextRows;
use super::{
    BASE_CSS, ErrorMap, TemperatureCurves, budget, clearance, correlation, difference, figure, number, plan_summary,
    vectors,
};
use machine::record::estimate::Estimate;
use machine::record::plan::Plan;
use machine::record::stage_proof::StageProof;
use methods::symbol_names::ResultGroup;

const PAGE_TEMPLATE: &str = include_str!("page.html");
const NOT_STATED: &str = "not stated";

/// Data of the run besides plan and estimate. Empty fields are left out, or printed as not stated.
#[derive(Debug, Clone, Default)]
pub struct ReportFacts {
    pub run_id: String,
    pub start_time: String,
    /// Time at which the run reached its state.
    pub end_time: String,
    pub run_state: String,
    /// Persons who answered prompts or acknowledged stops.
    pub operators: Vec<String>,
    /// Firmware and version of the control.
    pub control: String,
    /// Whether the certificate of the artefact had expired when the run started.
    pub is_certificate_expired: bool,
    /// Warning that the certificate of the artefact had expired; in addition to the warnings of the estimate.
    pub certificate_warnings: Vec<String>,
    /// Time and text of stops, faults and acknowledgements.
    pub events_with_times: Vec<(String, String)>,
    /// Signatures of the result; `None` if it cannot be signed, empty if it is not signed yet.
    pub signatures: Option<Vec<String>>,
    /// Each sample of a scan counts.
    pub reading_count: usize,
    /// Temperatures of each thermometer.
    pub temperature_rows: NameTextRows,
    pub temperature_curves: TemperatureCurves,
    pub residual_figures: Vec<ResidualFigure>,
    pub program_version: String,
    /// Name of each hashed item (machine file, plan, ..) and its SHA-256.
    pub sha256_by_item: Vec<(String, String)>,
    /// Proof of each stage, in order.
    pub stage_proofs: Vec<StageProof>,
    /// Position error of the tool over the volume, in sentences and as maps.
    pub volume_texts_and_maps: Option<(Vec<String>, Vec<ErrorMap>)>,
    pub previous_run: Option<PreviousRun>,
}

/// Renders the report of `estimate`.
///
/// # Errors
/// The template is invalid.
pub fn render_result_page(plan: &Plan, estimate: &Estimate, facts: &ReportFacts) -> Result<String, minijinja::Error> {
    let rows = result_rows(RunContext::from_estimate(estimate), &estimate.parameters);
    let values = context! {
        ..result_values(estimate, &rows),
        ..figure_sections(estimate, facts),
        ..record_sections(plan, estimate, facts)
    };
    html_environment().render_str(PAGE_TEMPLATE, values)
}

/// Template environment of whole pages: undefined values are errors, and HTML is escaped.
pub(super) fn html_environment() -> Environment<'static> {
    let mut environment = Environment::new();
    environment.set_undefined_behavior(UndefinedBehavior::Strict);
    environment.set_auto_escape_callback(|_| AutoEscape::Html);
    environment.add_filter("one_line_symbols", with_one_line_symbols);
    environment.add_global("base_css", Value::from_safe_string(BASE_CSS.to_owned()));
    environment
}

/// Template values of the figures.
fn figure_sections(estimate: &Estimate, facts: &ReportFacts) -> Value {
    context! {
        figures => [figure_values(estimate), residual_figure_values(&facts.residual_figures)].concat(),
        sketches => sketch_values(estimate),
        temperatures => svg_value(figure::draw_run_temperatures(&facts.temperature_curves)),
        related => correlation::correlation_values(&estimate.covariance),
        vectors => estimate.arrows.iter().map(vectors::vector_figure_value).collect::<Vec<_>>(),
        volume => facts.volume_texts_and_maps.as_ref().map(|(lines, maps)| volume_value(lines, maps)),
    }
}

/// Template values of what was measured, how, by whom and with which instruments.
fn record_sections(plan: &Plan, estimate: &Estimate, facts: &ReportFacts) -> Value {
    context! {
        method => plan.method.as_str(),
        machine => plan.machine.name.as_str(),
        run => facts.run_id.as_str(),
        subject => subject_rows(plan, facts),
        conditions => condition_rows(plan, estimate, facts),
        warnings => [facts.certificate_warnings.as_slice(), &estimate.warnings].concat(),
        previous => facts.previous_run.as_ref().map(|run| difference::previous_run_values(&plan.method, run)),
        plan => plan_summary::plan_rows(plan),
        proof => proof_value(plan, &facts.stage_proofs),
        record => record_rows(facts, &estimate.prior_hashes),
        events => facts.events_with_times.clone(),
        signed => facts.signatures.clone(),
    }
}

fn result_values(estimate: &Estimate, rows: &[ResultRow]) -> Value {
    let of_group = |group| rows.iter().filter(move |row| row.group == group).collect::<Vec<_>>();
    let budget = |is_in_table: fn(&ResultRow) -> bool| budget::budget_value(&estimate.parameters, rows, is_in_table);
    context! {
        verdict => context! {
            class => verdict_class(estimate.verdict),
            word => verdict_word(estimate.verdict),
            sentence => verdict_sentence(estimate.verdict),
        },
        not_passed => Serde(&rows_not_passed(rows)),
        headline => Serde(&headline_rows(rows)),
        is_judged => rows.iter().any(|row| row.verdict.is_some()),
        same_k => same_coverage(rows),
        main => Serde(&of_group(ResultGroup::Main)),
        harmonics => Serde(&of_group(ResultGroup::Harmonics)),
        setup => Serde(&of_group(ResultGroup::Setup)),
        budget => budget(|row| row.group == ResultGroup::Main),
        more_budget => budget(|row| row.group == ResultGroup::Setup),
        coverage => estimate.coverage_percent,
        trials => estimate.trials,
        decision_rule => estimate.decision_rule.as_deref(),
        gauge => estimate.gauge.clone(),
        not_identifiable => estimate.not_identifiable.clone(),
        quality => fit_quality_rows(estimate),
    }
}

/// k and degrees of freedom, if they are the same for all identifiable results: then the table has no column for them.
fn same_coverage(rows: &[ResultRow]) -> Option<Value> {
    let mut identified = rows.iter().filter(|row| row.identifiable);
    let first = identified.next()?;
    let is_same = identified.all(|row| (&row.k, &row.dof) == (&first.k, &first.dof));
    is_same.then(|| context! { k => first.k.as_str(), dof => first.dof.as_str() })
}

/// A row of a table; an empty text is replaced by [`NOT_STATED`].
fn stated_row(name: &str, text: &str) -> (String, String) {
    (name.to_owned(), if text.is_empty() { NOT_STATED } else { text }.to_owned())
}

/// The machine and the instruments as the machine file states them, the control and the active compensations.
fn subject_rows(plan: &Plan, facts: &ReportFacts) -> NameTextRows {
    let mut rows = vec![stated_row("Machine", &plan.machine.name)];
    let has_stylus = plan.sensors.is_empty();
    for field in plan.report.fields().into_iter().filter(|field| has_stylus || field.key != "stylus") {
        let expired = field.key == "certificate_due" && facts.is_certificate_expired;
        let mark = if expired { ": expired before this measurement" } else { "" };
        rows.push(stated_row(field.title, &format!("{}{mark}", field.text.unwrap_or(NOT_STATED))));
    }
    rows.push(stated_row("Control and firmware", &facts.control));
    let active = match plan.compensations_active.as_slice() {
        [] => "none stated".to_owned(),
        some => some.join(", "),
    };
    rows.push(stated_row("Active compensations", &active));
    rows
}

/// Rows for method, times, duration, operators and temperatures.
fn condition_rows(plan: &Plan, estimate: &Estimate, facts: &ReportFacts) -> NameTextRows {
    let description = methods::method_description(&plan.method);
    let mut rows = vec![
        stated_row("Method", &plan.method),
        stated_row("Source of the method", description.map_or("", |description| description.source)),
        stated_row("Begin", &facts.start_time),
        stated_row("End", &facts.end_time),
        stated_row("Duration on the clock of the readings", &measured_duration_text(estimate)),
        stated_row("Operator", &facts.operators.join(", ")),
    ];
    if facts.temperature_rows.is_empty() {
        rows.push(stated_row("Temperature", ""));
    }
    rows.extend(facts.temperature_rows.iter().map(|(name, value)| (format!("Temperature: {name}"), value.clone())));
    rows
}

/// Time from the first to the last reading; a simulated machine has a clock of its own.
fn measured_duration_text(estimate: &Estimate) -> String {
    let minutes = estimate.provenance.as_ref().map(|provenance| provenance.duration_s / 60.0);
    minutes.map_or(String::new(), |minutes| format!("{} min", number::format_fixed(minutes, 1)))
}

fn volume_value(lines: &[String], maps: &[ErrorMap]) -> Value {
    let largest = maps.iter().map(ErrorMap::max_value).fold(0.0, f64::max);
    let drawn = maps.iter().map(|map| {
        context! { title => map.title.as_str(), panels => map.draw(largest).map(svg_value).to_vec() }
    });
    context! { lines => lines.to_vec(), maps => drawn.collect::<Vec<_>>() }
}

/// Template values of the collision proof, which is made before any motion.
fn proof_value(plan: &Plan, proofs: &[StageProof]) -> Value {
    context! {
        rows => clearance::clearance_rows(plan, proofs),
        svg => svg_value(clearance::clearance_of_each_step(proofs).and_then(|f| figure::draw_function(&f, 1.0))),
        not_looked_at => clearance::unchecked_aspects(proofs),
    }
}

fn fit_quality_rows(estimate: &Estimate) -> NameTextRows {
    let mut rows = vec![
        ("Rank", format!("{} of {} unknowns", estimate.rank, estimate.unknowns)),
        ("Scaled condition number", number::format_fixed(estimate.condition, 2)),
        ("Weakest combination of parameters", with_one_line_symbols(estimate.weakest.as_deref().unwrap_or_default())),
        ("Residuals (rms)", format!("{} µm", number::format_fixed(estimate.residual_rms_um, 3))),
        ("Degrees of freedom", estimate.degrees_of_freedom.to_string()),
        ("χ² divided by its expected value", number::format_fixed(estimate.chi2_per_dof, 2)),
    ];
    rows.retain(|(_, text)| !text.is_empty());
    rows.into_iter().map(|(name, text)| (name.to_owned(), text)).collect()
}

fn record_rows(facts: &ReportFacts, priors: &[String]) -> NameTextRows {
    let text = |name: &str, value: &str| (name.to_owned(), value.to_owned());
    let mut rows = vec![
        text("Run", &facts.run_id),
        text("State", &facts.run_state),
        text("Readings", &facts.reading_count.to_string()),
        text("trued", &facts.program_version),
    ];
    rows.extend(facts.sha256_by_item.iter().map(|(what, hash)| (format!("SHA-256 of the {what}"), hash.clone())));
    rows.extend(priors.iter().map(|hash| text("Earlier estimate used as known (SHA-256)", hash)));
    rows.retain(|(_, value)| !value.is_empty());
    rows
}
