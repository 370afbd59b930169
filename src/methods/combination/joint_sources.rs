//! Sources of uncertainty that several runs may share, and which of their draws are the same quantities.

use nalgebra::DMatrix;

use super::MeasuredRun;
use super::parameter_rows::ParameterRows;
use crate::decision::parameter_difference::{SourceOwner, source_owner};
use machine::record::plan::{Plan, StepKind};

/// Maximum relative difference between the effects of a machine source in two runs, up to which its draws count as the
/// same quantities. At other points the draws are other quantities.
const SAME_EFFECT_TOLERANCE: f64 = 0.01;

/// A source that one or several runs contain.
pub struct JointSource {
    pub name: String,
    /// Runs with the source, ascending.
    pub run_indices: Vec<usize>,
    /// Whether each draw is known to be the same quantity in all these runs.
    pub has_matched_draws: bool,
    /// Change of each row by each independent draw. If the correlation is not known, each of the n runs has its own
    /// draws, multiplied by √n: this covers every correlation, since (Σaᵢ)(Σaᵢ)ᵀ ≤ n·Σaᵢaᵢᵀ.
    pub changes: DMatrix<f64>,
}

/// All sources that the runs may share. A statement that differs between the runs does not make a source independent:
/// the same probe may be stated with another feed, the same bar with another temperature.
pub fn joint_sources(rows: &ParameterRows, runs: &[MeasuredRun<'_>]) -> Vec<JointSource> {
    let mut names: Vec<&str> = Vec::new();
    for effect in runs.iter().flat_map(|run| run.source_effects) {
        if !names.contains(&effect.source.as_str()) {
            names.push(&effect.source);
        }
    }
    let of_name = |name: &str| join_effects(rows, runs, name, effects_of_runs(rows, runs, name));
    names.into_iter().map(of_name).filter(|source| !source.run_indices.is_empty()).collect()
}

/// Effect of a source of one run.
struct RunEffect {
    run_index: usize,
    /// All rows × draws.
    changes: DMatrix<f64>,
}

fn effects_of_runs(rows: &ParameterRows, runs: &[MeasuredRun<'_>], source: &str) -> Vec<RunEffect> {
    let of_run = |(run_index, run): (usize, &MeasuredRun<'_>)| {
        let changes = rows.changes_by_source(run, run_index, source)?;
        (changes.amax() > 0.0).then_some(RunEffect { run_index, changes })
    };
    runs.iter().enumerate().filter_map(of_run).collect()
}

/// The source of all runs that contain it.
fn join_effects(rows: &ParameterRows, runs: &[MeasuredRun<'_>], name: &str, effects: Vec<RunEffect>) -> JointSource {
    let plan = |effect: &RunEffect| runs[effect.run_index].plan;
    let is_stated_alike = effects.windows(2).all(|pair| is_stated_alike(name, plan(&pair[0]), plan(&pair[1])));
    let is_matched = |pair: &[RunEffect]| {
        pair[0].changes.ncols() == pair[1].changes.ncols()
            && (source_owner(name) != Some(SourceOwner::Machine) || has_same_effect(rows, &pair[0], &pair[1]))
    };
    let has_matched_draws = is_stated_alike && effects.windows(2).all(is_matched);
    let factor = if has_matched_draws { 1.0 } else { (effects.len() as f64).sqrt() };
    let widths = effects.iter().map(|effect| effect.changes.ncols());
    let draw_count = if has_matched_draws { widths.max().unwrap_or_default() } else { widths.sum() };
    let mut changes = DMatrix::zeros(rows.count(), draw_count);
    let mut first_draw = 0;
    for effect in &effects {
        let mut columns = changes.columns_mut(first_draw, effect.changes.ncols());
        columns += &effect.changes * factor;
        first_draw += if has_matched_draws { 0 } else { effect.changes.ncols() };
    }
    let run_indices = effects.iter().map(|effect| effect.run_index).collect();
    JointSource { name: name.to_owned(), run_indices, has_matched_draws, changes }
}

/// Whether a source has the same effect on the common parameters of two runs.
fn has_same_effect(rows: &ParameterRows, one: &RunEffect, other: &RunEffect) -> bool {
    let [mut difference, mut size] = [0.0, 0.0];
    for unknown in 0..rows.unknowns.len() {
        let [a, b] = [one, other].map(|effect| rows.row_index(effect.run_index, unknown));
        let Some((a, b)) = a.zip(b) else { continue };
        difference += (one.changes.row(a) - other.changes.row(b)).norm_squared();
        size += one.changes.row(a).norm_squared();
    }
    difference <= SAME_EFFECT_TOLERANCE.powi(2) * size
}

/// Whether the draws of the source are the same quantities in two runs: both state the same probe, machine or artefact,
/// and a probe source requires that neither run mounts a sphere or sensor, since its offset changes with each mounting.
fn is_stated_alike(source: &str, one: &Plan, other: &Plan) -> bool {
    let needs_mounting =
        |plan: &Plan| !plan.sensors.is_empty() || plan.steps.iter().any(|step| step.kind == StepKind::Prompt);
    match source_owner(source) {
        Some(SourceOwner::Probe) => {
            (&one.probe, &one.priors) == (&other.probe, &other.priors) && !needs_mounting(one) && !needs_mounting(other)
        }
        Some(SourceOwner::Machine) => one.machine == other.machine,
        Some(SourceOwner::Artefact) => one.artefact == other.artefact,
        None => false,
    }
}
