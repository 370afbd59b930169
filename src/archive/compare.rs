//! Comparison of two stored runs.

use serde::Serialize;

use crate::store::{Journal, RunId, RunSummary, StoreError, StoredRun};
use machine::record::estimate::Estimate;
use machine::record::plan::{Plan, Step, StepKind};
use methods::decision::difference::{Difference, common_sources, differences};
use methods::decision::function_difference::{FunctionDifference, function_differences};

#[derive(Debug, thiserror::Error)]
pub enum CompareError {
    #[error(transparent)]
    Store(#[from] StoreError),
    #[error("run {0} has no estimate")]
    NoEstimate(RunId),
    #[error("run {} by {} and run {} by {} have no parameter and no function in common",
        .0.id, .0.method, .1.id, .1.method)]
    NothingInCommon(Box<RunSummary>, Box<RunSummary>),
    #[error("the common values of runs {first} and {second} have different units: {symbols}")]
    Units { first: RunId, second: RunId, symbols: String },
}

impl CompareError {
    /// Remedy to show to the user.
    pub fn remedy(&self) -> &'static str {
        match self {
            Self::Store(error) => error.remedy(),
            Self::NoEstimate(_) => "take a run that has come to its end",
            Self::NothingInCommon(..) => {
                "take two runs that identify the same quantities, such as two of one method"
            }
            Self::Units { .. } => {
                "identify both runs by this version, `trued identify METHOD --run RUN`, then compare again"
            }
        }
    }
}

#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Comparison {
    pub runs: [RunSummary; 2],
    pub differences: Vec<Difference>,
    pub functions: Vec<FunctionDifference>,
    /// Sources of uncertainty with the same value in both runs: they cancel in `differences`.
    pub common_sources: Vec<String>,
    /// Other differences between the runs, in words.
    pub besides: Vec<String>,
}

/// Compares the last estimates of two runs. A source of uncertainty of both runs is common to them only if
/// machine, method, settings, probe and artefact are the same and no person mounts anything: in another plan
/// the same source has another effect.
///
/// # Errors
/// A run or an estimate does not exist, or the estimates have no quantity in common or only quantities in
/// different units.
pub fn compare(journal: &Journal, first: RunId, second: RunId) -> Result<Comparison, CompareError> {
    let [one, other] = [journal.load(first)?, journal.load(second)?];
    let last = |run: &StoredRun| {
        let last = run.estimates.last().map(|stored| stored.estimate.clone());
        last.ok_or(CompareError::NoEstimate(run.summary.id))
    };
    let (of_one, of_other) = (last(&one)?, last(&other)?);
    let common_sources =
        if is_same_setup(&one, &other) { common_sources(&of_one, &of_other) } else { Vec::new() };
    let differences = differences(&of_one, &of_other, &common_sources);
    let functions = function_differences(&of_one, &of_other, largest_k([&of_one, &of_other]));
    let in_other_units = in_other_units(&of_one, &of_other);
    let mut besides = besides(&one, &other);
    let runs = [one.summary, other.summary];
    if differences.is_empty() && functions.is_empty() {
        return Err(incomparable(runs, &in_other_units));
    }
    if !functions.is_empty() && of_one.gauge != of_other.gauge {
        let gauges = [(first, &of_one), (second, &of_other)];
        let line = |(run, of): (RunId, &Estimate)| {
            format!("convention of run {run}: {}", of.gauge.join("; "))
        };
        besides.extend(gauges.map(line));
    }
    besides.extend(other_heights(&of_one, &of_other));
    if !in_other_units.is_empty() {
        besides.push(format!("the units differ of {}", in_other_units.join(", ")));
    }
    Ok(Comparison { runs, differences, functions, common_sources, besides })
}

/// Maximum difference of equal heights, mm.
const SAME_HEIGHT_MM: f64 = 0.5;

/// Whether both runs have the same set-up. A sensor or sphere that a person mounts has another offset each
/// time.
fn is_same_setup(one: &StoredRun, other: &StoredRun) -> bool {
    let (a, b) = (&one.plan, &other.plan);
    let is_mounted = |plan: &Plan| {
        let is_prompt = |step: &Step| step.kind == StepKind::Prompt;
        !plan.sensors.is_empty() || plan.steps.iter().any(is_prompt)
    };
    !is_mounted(a)
        && (&a.method, &a.machine, &a.settings, &a.probe, &a.artefact)
            == (&b.method, &b.machine, &b.settings, &b.probe, &b.artefact)
}

/// Largest coverage factor of the parameters, as in the report: functions state u alone.
fn largest_k(estimates: [&Estimate; 2]) -> f64 {
    let parameters = estimates.into_iter().flat_map(|estimate| &estimate.parameters);
    let finite = parameters.filter(|p| p.identifiable && p.k.is_finite());
    finite.map(|parameter| parameter.k).reduce(f64::max).unwrap_or(2.0)
}

/// Symbols of parameters and functions of both estimates whose units differ.
fn in_other_units(one: &Estimate, other: &Estimate) -> Vec<String> {
    let parameters = |of: &Estimate| -> Vec<_> {
        of.parameters.iter().map(|p| (p.symbol.clone(), p.unit)).collect()
    };
    let functions = |of: &Estimate| -> Vec<_> {
        of.functions.iter().map(|f| (f.symbol.clone(), f.unit)).collect()
    };
    let pairs = [(parameters(one), parameters(other)), (functions(one), functions(other))];
    let differing = pairs.into_iter().flat_map(|(first, second)| {
        first.into_iter().filter(move |(symbol, unit)| {
            second.iter().any(|(other, of_other)| other == symbol && of_other != unit)
        })
    });
    differing.map(|(symbol, _)| symbol).collect()
}

/// Functions at different heights: displacements of a tilting axis depend on the height.
fn other_heights(one: &Estimate, other: &Estimate) -> Vec<String> {
    let differing = one.functions.iter().filter_map(|function| {
        let same = other.functions.iter().find(|other| other.symbol == function.symbol)?;
        let [a, b] = [function, same].map(|function| function.at_mm.map(|at_mm| at_mm[2]));
        let is_same = match (a, b) {
            (Some(a), Some(b)) => (a - b).abs() <= SAME_HEIGHT_MM,
            (a, b) => a == b,
        };
        let height = |z: Option<f64>| z.map_or("point_mm".to_owned(), |z| format!("Z = {z:.1} mm"));
        let (symbol, a, b) = (&function.symbol, height(a), height(b));
        (!is_same)
            .then(|| format!("{symbol} holds at {a} and at {b}: they differ where the axis tilts"))
    });
    differing.collect()
}

fn incomparable([one, other]: [RunSummary; 2], in_other_units: &[String]) -> CompareError {
    if in_other_units.is_empty() {
        return CompareError::NothingInCommon(Box::new(one), Box::new(other));
    }
    let symbols = in_other_units.join(", ");
    CompareError::Units { first: one.id, second: other.id, symbols }
}

fn besides(one: &StoredRun, other: &StoredRun) -> Vec<String> {
    let said = [
        (one.summary.machine != other.summary.machine, "they are of two machines"),
        (one.summary.method != other.summary.method, "they are of two methods"),
        (one.config != other.config, "the machine file was changed between them"),
        (one.plan.settings != other.plan.settings, "the settings of the method differ"),
        (one.plan.artefact != other.plan.artefact, "the artefact is stated differently"),
    ];
    said.into_iter().filter(|(differs, _)| *differs).map(|(_, words)| words.to_owned()).collect()
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn estimate(at_mm: Option<[f64; 3]>) -> Estimate {
        let estimate: Estimate = serde_json::from_value(json!({
            "trued_estimate": 1, "method": "r-test", "parameters": [], "gauge": [], "warnings": [],
            "functions": [{"symbol": "EXC", "argument": "C", "argument_unit": "deg", "x": [0.0], "unit": "um",
                           "y": [0.0], "u": [0.1]}],
            "covariance": {"symbols": [], "rows": []}, "not_identifiable": [], "rank": 0, "unknowns": 0,
            "condition": 1.0, "residual_rms_um": 0.0, "degrees_of_freedom": 0, "chi2_per_dof": 0.0,
            "verdict": "none", "priors": []
        }))
        .unwrap();
        at_mm.map_or(estimate.clone(), |at_mm| estimate.displaced_at(at_mm))
    }

    #[test]
    fn other_heights_are_named() {
        let [here, near, high] = [60.0, 60.3, 120.0].map(|z| estimate(Some([0.0, 0.0, z])));
        assert!(other_heights(&here, &near).is_empty());
        assert!(other_heights(&estimate(None), &estimate(None)).is_empty());
        let said = other_heights(&here, &high);
        assert!(said[0].starts_with("EXC holds at Z = 60.0 mm and at Z = 120.0 mm"), "{said:?}");
        assert!(other_heights(&here, &estimate(None))[0].contains("point_mm"));
    }
}
