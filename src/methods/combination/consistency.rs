//! Whether the runs agree with each other.

use estimation::coverage::{chi_square_tail, coverage_factor, two_sided_t_factor};
use nalgebra::DVector;
use serde::Serialize;

use super::CombinationRefusal;
use super::joint_results::{JointResults, VarianceAndDof};
use super::least_squares::{JointSolution, solve_selected_runs};
use crate::decision::parameter_difference::normalized_error;
use machine::record::estimate::Unit;

/// Probability that each of the two tests, χ² and the largest deviation, rejects runs that agree: together 1 %
/// (METHODS section 6).
const REJECTION_PROBABILITY: f64 = 0.005;

/// Deviation of one parameter of a run from the combination of all other runs.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RunDeviation {
    /// Number of the run.
    pub run: i64,
    pub symbol: String,
    pub unit: Unit,
    /// Run minus combination of the other selected runs, in `unit`.
    pub by: f64,
    /// Expanded uncertainty of `by`, coverage probability 95.45 %, with the correlation by shared sources.
    #[serde(rename = "U")]
    pub expanded: f64,
    /// Normalized error |by|/U (ISO 13528).
    #[serde(rename = "E_n")]
    pub normalized_error: f64,
    /// Whether |by| exceeds its limit. If the runs agree, the probability that any of the deviations exceeds its
    /// limit is at most 0.5 % (Bonferroni). The limit is not U.
    pub disagrees: bool,
}

/// A run that contradicts others.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Disagreement {
    /// Deviation of the run with the largest normalized error, from the combination of `others`.
    pub deviation: RunDeviation,
    /// Numbers of the runs with whose combination the run is compared.
    pub others: Vec<i64>,
}

/// Result of the consistency test.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Consistency {
    /// χ² of the residuals of the combination of all runs.
    pub chi2: f64,
    /// Degrees of freedom of `chi2`.
    pub degrees_of_freedom: usize,
    /// Probability of a larger χ² if the runs agree.
    pub p_value: f64,
    /// All deviations, by run, each from the combination of all other runs.
    pub deviations: Vec<RunDeviation>,
    /// Runs to leave out until the others agree, the worst first. If the last two runs contradict each other, the last
    /// entry names both. Empty: the runs agree.
    pub disagreeing_runs: Vec<Disagreement>,
}

impl Consistency {
    /// `solution`: the combination of all runs.
    pub fn new(joint: &JointResults, solution: &JointSolution) -> Result<Self, CombinationRefusal> {
        let mut is_selected = vec![true; joint.runs.len()];
        let deviations = deviations_of_runs(joint, &is_selected)?;
        let mut disagreeing_runs = Vec::new();
        loop {
            let selected = solve_selected_runs(joint, &is_selected).ok_or(CombinationRefusal::SingularCovariance)?;
            let own = deviations_of_runs(joint, &is_selected)?;
            let is_rejected = p_value(&selected) < REJECTION_PROBABILITY || own.iter().any(|one| one.disagrees);
            let Some(worst) = largest_deviation(&own).filter(|_| is_rejected) else { break };
            let selected_count = is_selected.iter().filter(|is| **is).count();
            disagreeing_runs.push(disagreement(joint, &is_selected, worst));
            // Of two runs neither is known to be the wrong one.
            if selected_count == 2 {
                break;
            }
            is_selected.iter_mut().zip(&joint.runs).for_each(|(is, run)| *is &= *run != worst.run);
        }
        Ok(Self {
            chi2: solution.chi2,
            degrees_of_freedom: solution.dof,
            p_value: p_value(solution),
            deviations,
            disagreeing_runs,
        })
    }

    /// Whether all runs agree: χ² has a probability of at least 0.5 %, and no deviation exceeds its limit.
    pub fn is_consistent(&self) -> bool {
        self.disagreeing_runs.is_empty()
    }

    /// Deviation of a parameter with the largest normalized error over the runs.
    pub fn largest_deviation_of(&self, symbol: &str) -> Option<&RunDeviation> {
        largest_deviation(self.deviations.iter().filter(|one| one.symbol == symbol))
    }
}

/// Probability of a larger χ²; 1 without degrees of freedom.
fn p_value(solution: &JointSolution) -> f64 {
    if solution.dof == 0 { 1.0 } else { chi_square_tail(solution.chi2, solution.dof as f64) }
}

/// The deviation with the largest normalized error.
fn largest_deviation<'a>(deviations: impl IntoIterator<Item = &'a RunDeviation>) -> Option<&'a RunDeviation> {
    deviations.into_iter().max_by(|one, other| one.normalized_error.total_cmp(&other.normalized_error))
}

fn disagreement(joint: &JointResults, is_selected: &[bool], worst: &RunDeviation) -> Disagreement {
    let selected = joint.runs.iter().zip(is_selected).filter(|(_, is)| **is).map(|(run, _)| *run);
    Disagreement { deviation: worst.clone(), others: selected.filter(|run| *run != worst.run).collect() }
}

/// Deviations of each selected run from the combination of the other selected runs.
fn deviations_of_runs(joint: &JointResults, is_selected: &[bool]) -> Result<Vec<RunDeviation>, CombinationRefusal> {
    let mut contrasts = Vec::new();
    for run in (0..joint.runs.len()).filter(|run| is_selected[*run]) {
        let mut is_other = is_selected.to_vec();
        is_other[run] = false;
        if !is_other.contains(&true) {
            continue;
        }
        let others = solve_selected_runs(joint, &is_other).ok_or(CombinationRefusal::SingularCovariance)?;
        contrasts.extend((0..joint.rows.unknowns.len()).filter_map(|unknown| contrast(joint, &others, run, unknown)));
    }
    let count = contrasts.len();
    Ok(contrasts.iter().map(|contrast| deviation(joint, contrast, count)).collect())
}

/// A parameter of one run minus that of the combination of others.
struct Contrast {
    run_index: usize,
    unknown_index: usize,
    /// Coefficient of each row of the joint results.
    coefficients: DVector<f64>,
}

/// The parameter of a run minus that of `others`. `None`: the run or the others do not contain the parameter.
fn contrast(joint: &JointResults, others: &JointSolution, run_index: usize, unknown_index: usize) -> Option<Contrast> {
    let row = joint.rows.row_index(run_index, unknown_index)?;
    let mut coefficients = -others.gain.row(others.position(unknown_index)?).transpose();
    coefficients[row] += 1.0;
    Some(Contrast { run_index, unknown_index, coefficients })
}

/// The deviation that `contrast` describes. `count`: number of deviations that are judged together (Bonferroni).
fn deviation(joint: &JointResults, contrast: &Contrast, count: usize) -> RunDeviation {
    let unknown = &joint.rows.unknowns[contrast.unknown_index];
    let by = contrast.coefficients.dot(&joint.rows.values);
    let VarianceAndDof { variance, dof, .. } = joint.variance_and_dof(&contrast.coefficients);
    let u = variance.sqrt();
    let bound = two_sided_t_factor(1.0 - REJECTION_PROBABILITY / count as f64, dof);
    let expanded = coverage_factor(dof) * u;
    RunDeviation {
        run: joint.runs[contrast.run_index],
        symbol: unknown.symbol.clone(),
        unit: unknown.unit,
        by: by * unknown.scale,
        expanded: expanded * unknown.scale,
        normalized_error: normalized_error(by, expanded),
        disagrees: by.abs() > bound * u,
    }
}
