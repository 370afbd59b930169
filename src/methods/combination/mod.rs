//! Combination of several runs of one machine into one estimate, by generalized least squares with the full joint
//! covariance (JCGM 102; Aitken's estimator).
//!
//! The observations are the identified parameters of all runs, the unknowns are their symbols. A parameter of the
//! set-up, such as the position of a ball, differs between the runs: only the one of the newest run is used.
//!
//! Two runs are correlated by the uncertainty sources that they share. The identification gives the signed effect of
//! each draw of a source on each parameter ([`SourceEffect`]). `joint_sources.rs` decides which draws are the same in
//! several runs. The combination does not average out a shared source.
//!
//! [`Consistency`] compares the runs. If they contradict each other, no uncertainty of the combination is reliable: the
//! verdict is `undecided (model)`, and a warning names the run and the parameter.
//!
//! [`SourceEffect`]: machine::record::estimate::SourceEffect

mod compatibility;
mod consistency;
mod estimate;
mod joint_results;
mod joint_sources;
mod least_squares;
mod parameter_rows;
#[cfg(test)]
mod tests;

use std::collections::BTreeSet;

use serde::Serialize;

pub use self::compatibility::CombinationRefusal;
pub use self::consistency::{Consistency, Disagreement, RunDeviation};
use self::joint_results::JointResults;
use self::least_squares::solve_selected_runs;
use self::parameter_rows::CombinationUnknown;
use machine::record::estimate::{Estimate, SourceEffect, Unit};
use machine::record::plan::Plan;

/// A run with its own estimate.
#[derive(Debug, Clone, Copy)]
pub struct MeasuredRun<'a> {
    /// Number of the run.
    pub number: i64,
    pub plan: &'a Plan,
    pub estimate: &'a Estimate,
    /// Effects of the sources on the parameters of the covariance of `estimate`.
    pub source_effects: &'a [SourceEffect],
}

/// One parameter in all runs, in its unit.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CombinedParameter {
    pub symbol: String,
    pub unit: Unit,
    /// Value of each run, in the order of the runs. `None`: the run does not identify the parameter, or the parameter
    /// belongs to another set-up.
    pub values: Vec<Option<f64>>,
    /// Value by generalized least squares over all runs.
    pub combined: f64,
    /// Expanded uncertainty of `combined`.
    #[serde(rename = "U")]
    pub expanded: f64,
}

/// A source of uncertainty that several runs share.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SharedSource {
    pub source: String,
    /// Numbers of the runs with the source, ascending.
    pub runs: Vec<i64>,
    /// Whether the correlation is known. Otherwise the combination contains the largest possible effect.
    pub has_known_correlation: bool,
}

/// Result of a combination.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Combination {
    /// Numbers of the runs, oldest first.
    pub runs: Vec<i64>,
    /// All parameters, also those of one run only.
    pub parameters: Vec<CombinedParameter>,
    pub consistency: Consistency,
    pub shared_sources: Vec<SharedSource>,
    /// The estimate of the combination, without a verdict on tolerances.
    pub estimate: Estimate,
}

/// Combines `runs` in any order. For runs that contradict each other the verdict of the estimate is `undecided
/// (model)`.
///
/// # Errors
/// The runs cannot be combined.
pub fn combine_runs(runs: &[MeasuredRun<'_>]) -> Result<Combination, CombinationRefusal> {
    let mut runs = runs.to_vec();
    runs.sort_by_key(|run| run.number);
    compatibility::check_runs(&runs)?;
    let joint = JointResults::new(&runs);
    let is_selected = vec![true; runs.len()];
    let solution = solve_selected_runs(&joint, &is_selected).ok_or(CombinationRefusal::SingularCovariance)?;
    if solution.dof == 0 {
        return Err(CombinationRefusal::NoCommonParameter);
    }
    let consistency = Consistency::new(&joint, &solution)?;
    let estimate = estimate::combined_estimate(&runs, &joint, &solution, &consistency);
    Ok(Combination {
        runs: joint.runs.clone(),
        parameters: combined_parameters(&joint, &estimate),
        consistency,
        shared_sources: shared_sources(&joint),
        estimate,
    })
}

fn combined_parameters(joint: &JointResults, estimate: &Estimate) -> Vec<CombinedParameter> {
    let parameter = |(index, unknown): (usize, &CombinationUnknown)| {
        let own = &estimate.parameters[index];
        let value_of_run = |run: usize| {
            let row = joint.rows.row_index(run, index)?;
            Some(joint.rows.values[row] * unknown.scale)
        };
        CombinedParameter {
            symbol: unknown.symbol.clone(),
            unit: unknown.unit,
            values: (0..joint.runs.len()).map(value_of_run).collect(),
            combined: own.value,
            expanded: own.expanded,
        }
    };
    joint.rows.unknowns.iter().enumerate().map(parameter).collect()
}

fn shared_sources(joint: &JointResults) -> Vec<SharedSource> {
    let several = joint.sources.iter().filter(|source| source.run_indices.len() > 1);
    let shared = several.map(|source| SharedSource {
        source: source.name.clone(),
        runs: source.run_indices.iter().map(|run| joint.runs[*run]).collect::<BTreeSet<_>>().into_iter().collect(),
        has_known_correlation: source.has_matched_draws,
    });
    shared.collect()
}
