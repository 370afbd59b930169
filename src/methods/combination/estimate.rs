//! The estimate of a combination.

use std::collections::BTreeMap;

use estimation::coverage::coverage_factor;

use super::MeasuredRun;
use super::compatibility::convention_without_values;
use super::consistency::{Consistency, Disagreement};
use super::joint_results::{JointResults, VarianceAndDof};
use super::least_squares::JointSolution;
use crate::identification::rms;
use machine::Axis;
use machine::record::estimate::{
    BudgetLine, Estimate, EvaluationType, Parameter, ParameterCovariance, Provenance, Unit, Verdict,
};

/// Name of the budget line for all sources that are independent in each run.
const RUN_SPECIFIC_SOURCES_LINE_NAME: &str = "sources that differ from run to run";

/// The estimate. Its conventions and its provenance are those of the newest run. It has no functions and no figures,
/// because the runs store no covariance for them. Rank, degrees of freedom and χ² are those of the combination; the
/// residuals are those of the runs.
pub fn combined_estimate(
    runs: &[MeasuredRun<'_>],
    joint: &JointResults,
    solution: &JointSolution,
    consistency: &Consistency,
) -> Estimate {
    let newest = runs[runs.len() - 1].estimate;
    let provenance = newest.provenance.clone();
    let residuals: Vec<f64> = runs.iter().map(|run| run.estimate.residual_rms_um).collect();
    Estimate {
        provenance: provenance.map(|own| Provenance { combined_runs: joint.runs.clone(), ..own }),
        trials: None,
        parameters: (0..joint.rows.unknowns.len())
            .filter_map(|index| combined_parameter(joint, solution, index))
            .collect(),
        functions: Vec::new(),
        circles: Vec::new(),
        arrows: Vec::new(),
        covariance: combined_covariance(joint, solution),
        rank: joint.rows.unknowns.len(),
        unknowns: joint.rows.unknowns.len(),
        condition: runs.iter().map(|run| run.estimate.condition).fold(0.0, f64::max),
        weakest: None,
        gauge: describe_gauge(newest, &joint.runs),
        residual_rms_um: rms(&residuals),
        degrees_of_freedom: solution.dof,
        chi2_per_dof: solution.chi2 / solution.dof as f64,
        verdict: if consistency.is_consistent() { Verdict::None } else { Verdict::UndecidedModel },
        decision_rule: None,
        warnings: combination_warnings(runs, consistency),
        outliers: Vec::new(),
        measurement_checks: Vec::new(),
        prior_hashes: distinct_priors(runs),
        measured_ranges: measured_ranges(runs),
        source_effects: Vec::new(),
        ..newest.clone()
    }
}

fn combined_parameter(joint: &JointResults, solution: &JointSolution, unknown_index: usize) -> Option<Parameter> {
    let unknown = &joint.rows.unknowns[unknown_index];
    let position = solution.position(unknown_index)?;
    let coefficients = solution.gain.row(position).transpose();
    let VarianceAndDof { run_specific_variance: own, variance, dof } = joint.variance_and_dof(&coefficients);
    let (u, k) = (variance.sqrt() * unknown.scale, coverage_factor(dof));
    let mut budget = vec![BudgetLine {
        source: RUN_SPECIFIC_SOURCES_LINE_NAME.to_owned(),
        u: own.sqrt() * unknown.scale,
        dof: Some(dof * (own / variance).powi(2)).filter(|dof| dof.is_finite()),
        ..BudgetLine::default()
    }];
    for source in &joint.sources {
        let u = source.changes.tr_mul(&coefficients).norm() * unknown.scale;
        match budget.iter_mut().find(|line| line.source == source.name) {
            Some(line) => line.u = line.u.hypot(u),
            None => budget.push(BudgetLine {
                source: source.name.clone(),
                evaluation_type: Some(EvaluationType::B),
                u,
                ..BudgetLine::default()
            }),
        }
    }
    Some(Parameter {
        symbol: unknown.symbol.clone(),
        value: solution.values[position] * unknown.scale,
        unit: unknown.unit,
        u,
        expanded: k * u,
        k,
        dof: Some(dof).filter(|dof| dof.is_finite()),
        identifiable: true,
        u_monte_carlo: None,
        interval_monte_carlo: None,
        budget,
        judged: None,
    })
}

fn combined_covariance(joint: &JointResults, solution: &JointSolution) -> ParameterCovariance {
    let covariance = &solution.gain * &joint.covariance * solution.gain.transpose();
    let scale = |i: usize| joint.rows.unknowns[solution.unknown_indices[i]].scale;
    let row = |i: usize| (0..covariance.ncols()).map(|j| covariance[(i, j)] * scale(i) * scale(j)).collect();
    ParameterCovariance {
        symbols: solution.unknown_indices.iter().map(|index| joint.rows.unknowns[*index].symbol.clone()).collect(),
        rows: (0..covariance.nrows()).map(row).collect(),
    }
}

fn describe_gauge(newest: &Estimate, runs: &[i64]) -> Vec<String> {
    let conventions = newest.gauge.iter().map(|line| convention_without_values(line).to_owned());
    let combination = format!(
        "combination of the runs {}; parameters of the set-up (stylus, balls, sensors) are those of the newest run",
        list_runs(runs)
    );
    conventions.chain([combination]).collect()
}

fn list_runs(runs: &[i64]) -> String {
    runs.iter().map(i64::to_string).collect::<Vec<_>>().join(", ")
}

/// Warnings of the runs, and one for each run that contradicts others.
fn combination_warnings(runs: &[MeasuredRun<'_>], consistency: &Consistency) -> Vec<String> {
    let disagreeing = consistency.disagreeing_runs.iter().map(|one| describe_disagreement(one, consistency));
    let of_runs = runs
        .iter()
        .flat_map(|run| run.estimate.warnings.iter().map(move |warning| format!("run {}: {warning}", run.number)));
    disagreeing.chain(of_runs).collect()
}

fn describe_disagreement(one: &Disagreement, consistency: &Consistency) -> String {
    let deviation = &one.deviation;
    let runs = if one.others.len() == 1 { "run" } else { "the combination of the runs" };
    format!(
        "run {} contradicts {runs} {}: {} deviates by {} with U = {} (E_n = {:.2}; consistency of all runs: \
        χ² = {:.1} with {} degrees of freedom, p = {:.1e}); no uncertainty of the combination is reliable: find the \
        change of the machine, or leave the run out",
        deviation.run,
        list_runs(&one.others),
        deviation.symbol,
        format_with_unit(deviation.by, deviation.unit),
        format_with_unit(deviation.expanded, deviation.unit),
        deviation.normalized_error,
        consistency.chi2,
        consistency.degrees_of_freedom,
        consistency.p_value,
    )
}

/// The value with its unit. Lengths in mm are printed to 0.1 µm.
fn format_with_unit(value: f64, unit: Unit) -> String {
    let decimals = if unit == Unit::Mm { 4 } else { 2 };
    format!("{value:.decimals$} {}", unit.symbol())
}

fn distinct_priors(runs: &[MeasuredRun<'_>]) -> Vec<String> {
    let mut all: Vec<String> = Vec::new();
    for prior in runs.iter().flat_map(|run| &run.estimate.prior_hashes) {
        if !all.contains(prior) {
            all.push(prior.clone());
        }
    }
    all
}

/// Ranges within which at least one run measured, since one run determines the errors over its own ranges. If the
/// ranges of an axis do not overlap, only the range of the newest run: between two such ranges no run measured.
fn measured_ranges(runs: &[MeasuredRun<'_>]) -> BTreeMap<Axis, [f64; 2]> {
    let mut ranges: BTreeMap<Axis, [f64; 2]> = BTreeMap::new();
    for (axis, [low, high]) in runs.iter().rev().flat_map(|run| &run.estimate.measured_ranges) {
        let range = ranges.entry(*axis).or_insert([*low, *high]);
        if *low <= range[1] && *high >= range[0] {
            *range = [range[0].min(*low), range[1].max(*high)];
        }
    }
    ranges
}
