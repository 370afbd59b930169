//! Comparison of two stored runs.

use serde::Serialize;

use crate::store::{Journal, RunFilter, RunId, RunState, RunSummary, StoreError, StoredRun};
use machine::record::estimate::Estimate;
use machine::record::plan::{Plan, Step, StepKind};
use methods::decision::function_difference::{FunctionDifference, function_differences};
use methods::decision::parameter_difference::{ParameterDifference, common_sources, parameter_differences};

#[derive(Debug, thiserror::Error)]
pub enum CompareError {
    #[error(transparent)]
    Store(#[from] StoreError),
    #[error("run {0} has no estimate")]
    NoEstimate(RunId),
    #[error("run {} by {} and run {} by {} have no parameter and no function in common",
        .0.id, .0.method, .1.id, .1.method)]
    NothingInCommon(Box<RunSummary>, Box<RunSummary>),
    /// No quantity that both estimates determine has the same unit. Where only some units differ, the comparison is
    /// made, and `other_differences` names the symbols.
    #[error("the common values of runs {first} and {second} have different units: {symbols}")]
    DifferentUnits { first: RunId, second: RunId, symbols: String },
}

impl CompareError {
    /// Remedy to show to the user.
    pub fn remedy(&self) -> &'static str {
        match self {
            Self::Store(error) => error.remedy(),
            Self::NoEstimate(_) => "choose a finished run",
            Self::NothingInCommon(..) => "choose two runs with common parameters, such as two runs of the same method",
            Self::DifferentUnits { .. } => {
                "compute new estimates of both runs with this version (`trued identify METHOD --run RUN`), \
                then compare them again"
            }
        }
    }
}

/// Differences between two stored runs.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RunComparison {
    /// First and second run; a difference is second minus first.
    pub runs: [RunSummary; 2],
    /// Parameters that both estimates identify, with the same unit; U takes account of `common_sources`.
    pub differences: Vec<ParameterDifference>,
    /// Functions of both estimates with the same units and a stated U, except histograms; U has the largest
    /// coverage factor of all parameters.
    pub functions: Vec<FunctionDifference>,
    /// Sources of uncertainty with the same value in both runs: they cancel in `differences`. Empty unless both runs
    /// have the same set-up.
    pub common_sources: Vec<String>,
    /// Sentences about other differences: machine, method, machine file, settings, artefact, conventions and heights
    /// of functions, combined estimates, different units.
    #[serde(rename = "besides")]
    pub other_differences: Vec<String>,
}

/// At most `limit` finished runs of the same machine and method before `run`, newest first.
///
/// # Errors
/// The journal cannot be read.
pub fn earlier_finished_runs(journal: &Journal, run: &RunSummary, limit: usize) -> Result<Vec<RunSummary>, StoreError> {
    let filter = RunFilter {
        older_than: Some(run.id),
        machine: Some(&run.machine),
        method: Some(&run.method),
        state: Some(RunState::Finished),
        ..RunFilter::default()
    };
    journal.list_runs(filter, limit)
}

/// Compares the last estimates of two runs. A source of uncertainty of both runs is common to them only if
/// machine, method, settings, probe and artefact are the same and no person mounts anything: in another plan
/// the same source has another effect.
///
/// # Errors
/// A run or an estimate does not exist, or the estimates have no quantity in common or only quantities in
/// different units.
pub fn compare_runs(journal: &Journal, first: RunId, second: RunId) -> Result<RunComparison, CompareError> {
    let [one, other] = [journal.load_run(first)?, journal.load_run(second)?];
    let last = |run: &StoredRun| {
        let last = run.estimates.last().map(|stored| stored.estimate.clone());
        last.ok_or(CompareError::NoEstimate(run.summary.id))
    };
    let (of_one, of_other) = (last(&one)?, last(&other)?);
    let common_sources = if is_same_setup(&one, &other) { common_sources(&of_one, &of_other) } else { Vec::new() };
    let differences = parameter_differences(&of_one, &of_other, &common_sources);
    let functions = function_differences(&of_one, &of_other, largest_coverage_factor([&of_one, &of_other]));
    let unit_differences = symbols_with_different_units(&of_one, &of_other);
    let mut other_differences = describe_setup_differences(&one, &other);
    let runs = [one.summary, other.summary];
    if differences.is_empty() && functions.is_empty() {
        return Err(not_comparable_error(runs, &unit_differences));
    }
    if !functions.is_empty() && of_one.gauge != of_other.gauge {
        let gauges = [(first, &of_one), (second, &of_other)];
        let line = |(run, of): (RunId, &Estimate)| format!("convention of run {run}: {}", of.gauge.join("; "));
        other_differences.extend(gauges.map(line));
    }
    other_differences.extend(describe_height_differences(&of_one, &of_other));
    other_differences.extend([(first, &of_one), (second, &of_other)].into_iter().filter_map(describe_combination));
    if !unit_differences.is_empty() {
        other_differences.push(format!("the two runs have different units for {}", unit_differences.join(", ")));
    }
    Ok(RunComparison { runs, differences, functions, common_sources, other_differences })
}

/// Sentence about an estimate that combines several runs.
fn describe_combination((run, estimate): (RunId, &Estimate)) -> Option<String> {
    let runs: Vec<String> = estimate.combined_runs().iter().map(i64::to_string).collect();
    (!runs.is_empty()).then(|| {
        format!("the estimate of run {run} combines the runs {}: it is not independent of them", runs.join(", "))
    })
}

/// Maximum difference of two heights that count as equal, mm.
const SAME_HEIGHT_TOLERANCE_MM: f64 = 0.5;

/// Whether both runs have the same method, machine, settings, probe and artefact, and neither a sensor nor a
/// prompt: what a person mounts, such as a sensor or sphere, has another offset each time.
fn is_same_setup(one: &StoredRun, other: &StoredRun) -> bool {
    let (a, b) = (&one.plan, &other.plan);
    let needs_mounting = |plan: &Plan| {
        let is_prompt = |step: &Step| step.kind == StepKind::Prompt;
        !plan.sensors.is_empty() || plan.steps.iter().any(is_prompt)
    };
    !needs_mounting(a)
        && (&a.method, &a.machine, &a.settings, &a.probe, &a.artefact)
            == (&b.method, &b.machine, &b.settings, &b.probe, &b.artefact)
}

/// Largest coverage factor of the parameters, as in the report: a function has no coverage factor of its own. 2 if no
/// parameter is identifiable.
fn largest_coverage_factor(estimates: [&Estimate; 2]) -> f64 {
    let parameters = estimates.into_iter().flat_map(|estimate| &estimate.parameters);
    let finite = parameters.filter(|p| p.identifiable && p.k.is_finite());
    finite.map(|parameter| parameter.k).reduce(f64::max).unwrap_or(2.0)
}

/// Symbols of parameters and functions of both estimates whose units differ.
fn symbols_with_different_units(one: &Estimate, other: &Estimate) -> Vec<String> {
    let parameters = one
        .parameters
        .iter()
        .filter(|p| other.parameters.iter().any(|of_other| of_other.symbol == p.symbol && of_other.unit != p.unit));
    let functions = one
        .functions
        .iter()
        .filter(|f| other.functions.iter().any(|of_other| of_other.symbol == f.symbol && of_other.unit != f.unit));
    parameters.map(|p| p.symbol.clone()).chain(functions.map(|f| f.symbol.clone())).collect()
}

/// Sentences about functions at different heights: displacements of a tilting axis depend on the height.
fn describe_height_differences(one: &Estimate, other: &Estimate) -> Vec<String> {
    let differing = one.functions.iter().filter_map(|function| {
        let same = other.functions.iter().find(|other| other.symbol == function.symbol)?;
        let [a, b] = [function, same].map(|function| function.at_mm.map(|at_mm| at_mm[2]));
        let is_same = match (a, b) {
            (Some(a), Some(b)) => (a - b).abs() <= SAME_HEIGHT_TOLERANCE_MM,
            (a, b) => a == b,
        };
        let height = |z: Option<f64>| z.map_or("point_mm".to_owned(), |z| format!("Z = {z:.1} mm"));
        let (symbol, a, b) = (&function.symbol, height(a), height(b));
        (!is_same).then(|| {
            format!(
                "{symbol} refers to {a} in one run and to {b} in the other: the values differ \
                if the axis tilts"
            )
        })
    });
    differing.collect()
}

/// `DifferentUnits` if the runs have common symbols with different units, otherwise `NothingInCommon`.
fn not_comparable_error([one, other]: [RunSummary; 2], unit_differences: &[String]) -> CompareError {
    if unit_differences.is_empty() {
        return CompareError::NothingInCommon(Box::new(one), Box::new(other));
    }
    let symbols = unit_differences.join(", ");
    CompareError::DifferentUnits { first: one.id, second: other.id, symbols }
}

/// Sentences about differences of machine, method, machine file, settings and artefact.
fn describe_setup_differences(one: &StoredRun, other: &StoredRun) -> Vec<String> {
    let differences = [
        (one.summary.machine != other.summary.machine, "the runs are from different machines"),
        (one.summary.method != other.summary.method, "the runs have different methods"),
        (one.machine_file_text != other.machine_file_text, "the machine file was changed between the runs"),
        (one.plan.settings != other.plan.settings, "the runs have different settings of the method"),
        (one.plan.artefact != other.plan.artefact, "the runs have different data of the artefact"),
    ];
    differences.into_iter().filter(|(differs, _)| *differs).map(|(_, text)| text.to_owned()).collect()
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn estimate_with_displacement_point(at_mm: Option<[f64; 3]>) -> Estimate {
        let estimate: Estimate = serde_json::from_value(json!({
            "trued_estimate": 1, "method": "r-test", "parameters": [], "gauge": [], "warnings": [],
            "functions": [{"symbol": "EXC", "argument": "C", "argument_unit": "deg", "x": [0.0], "unit": "um",
                           "y": [0.0], "u": [0.1]}],
            "covariance": {"symbols": [], "rows": []}, "not_identifiable": [], "rank": 0, "unknowns": 0,
            "condition": 1.0, "residual_rms_um": 0.0, "degrees_of_freedom": 0, "chi2_per_dof": 0.0,
            "verdict": "none", "priors": []
        }))
        .unwrap();
        at_mm.map_or(estimate.clone(), |at_mm| estimate.with_displacement_point(at_mm))
    }

    #[test]
    fn functions_at_different_heights_are_reported() {
        let [here, near, high] = [60.0, 60.3, 120.0].map(|z| estimate_with_displacement_point(Some([0.0, 0.0, z])));
        assert!(describe_height_differences(&here, &near).is_empty());
        assert!(
            describe_height_differences(
                &estimate_with_displacement_point(None),
                &estimate_with_displacement_point(None)
            )
            .is_empty()
        );
        let said = describe_height_differences(&here, &high);
        assert!(
            said[0].starts_with("EXC refers to Z = 60.0 mm in one run and to Z = 120.0 mm in the other"),
            "{said:?}"
        );
        assert!(describe_height_differences(&here, &estimate_with_displacement_point(None))[0].contains("point_mm"));
    }
}
