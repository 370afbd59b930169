//! Report of a stored run.

use super::compare::{compare_runs, earlier_finished_runs};
use super::run_story::{
    describe_events_with_times, describe_record_warnings, describe_signatures, in_local_time, is_certificate_expired,
};
use super::volumetric_error::volumetric_error_maps;
use crate::report::difference::PreviousRun;
use crate::report::time::format_local_time;
use crate::report::{page, residuals, temperature};
use crate::store::{Journal, RunId, StoreError, StoredRun};
use machine::record::event::RunEvent;
use machine::record::stage_proof::StageProof;

#[derive(Debug, thiserror::Error)]
pub enum ReportError {
    #[error(transparent)]
    Store(#[from] StoreError),
    #[error("run {0} has no estimate")]
    NoEstimate(RunId),
    #[error("the report cannot be written: {0}")]
    Template(#[from] minijinja::Error),
}

impl ReportError {
    /// Remedy to show to the user.
    pub fn remedy(&self) -> &'static str {
        match self {
            Self::Store(error) => error.remedy(),
            Self::NoEstimate(_) => "export the readings of the run and use `trued identify`",
            Self::Template(_) => "report this fault of the program to the developers",
        }
    }
}

/// HTML report of the last estimate of `run`.
///
/// # Errors
/// The run does not exist, or it has no estimate yet.
pub fn render_report(journal: &Journal, run: RunId) -> Result<String, ReportError> {
    let stored = journal.load_run(run)?;
    let last = stored.estimates.last().ok_or(ReportError::NoEstimate(run))?;
    let facts = page::ReportFacts {
        run_id: run.to_string(),
        start_time: format_local_time(stored.summary.started),
        end_time: stored.summary.ended.map_or(String::new(), format_local_time),
        operators: operators_of_run(&stored),
        control: control_identity(&stored),
        is_certificate_expired: is_certificate_expired(&stored),
        certificate_warnings: describe_record_warnings(&stored),
        previous_run: differences_from_previous_run(journal, &stored)?,
        program_version: last.program_version.clone(),
        sha256_by_item: vec![
            ("machine file".to_owned(), stored.summary.config_sha256.clone()),
            ("plan".to_owned(), stored.summary.plan_sha256.clone()),
            ("estimate".to_owned(), last.sha256.clone()),
        ],
        reading_count: stored.readings.len(),
        temperature_rows: temperature::temperature_rows(&stored.readings),
        temperature_curves: temperature::temperature_curves(&stored.readings),
        residual_figures: residuals::residual_figures(&stored.readings, &last.estimate),
        run_state: stored.summary.state.as_str().to_owned(),
        events_with_times: in_local_time(describe_events_with_times(&stored)),
        signatures: Some(describe_signatures(&stored)),
        volume_texts_and_maps: volumetric_error_maps(&stored.plan, &last.estimate),
        stage_proofs: stored.events.iter().filter_map(|(_, event)| stage_proof(event)).collect(),
    };
    Ok(page::render_result_page(&stored.plan, &last.estimate, &facts)?)
}

/// Firmware and version of the control, as it reported them when the run last started to move. Empty without such a
/// report.
fn control_identity(stored: &StoredRun) -> String {
    let identity = stored.events.iter().rev().find_map(|(_, event)| match event {
        RunEvent::ControlPrepared { identity } => Some(identity.clone()),
        _ => None,
    });
    identity.unwrap_or_default()
}

/// Persons who answered prompts or acknowledged stops, each once.
fn operators_of_run(stored: &StoredRun) -> Vec<String> {
    let mut names: Vec<String> = Vec::new();
    for (_, event) in &stored.events {
        if let RunEvent::Acknowledged { who, .. } | RunEvent::PromptConfirmed { who, .. } = event
            && !names.contains(who)
        {
            names.push(who.clone());
        }
    }
    names
}

/// Differences from the previous finished run of the same machine and method; `None` without such a run, or if the
/// two runs cannot be compared.
fn differences_from_previous_run(journal: &Journal, stored: &StoredRun) -> Result<Option<PreviousRun>, StoreError> {
    let summary = &stored.summary;
    let Some(previous) = earlier_finished_runs(journal, summary, 1)?.pop() else { return Ok(None) };
    // A damaged earlier run does not prevent the report of this one.
    let Ok(comparison) = compare_runs(journal, previous.id, summary.id) else { return Ok(None) };
    Ok(Some(PreviousRun {
        title: format!("run {} of {}", previous.id, format_local_time(previous.started)),
        differences: comparison.differences,
        common_sources: comparison.common_sources,
        other_differences: comparison.other_differences,
    }))
}

fn stage_proof(event: &RunEvent) -> Option<StageProof> {
    match event {
        RunEvent::StageProven { proof, .. } => Some(proof.clone()),
        _ => None,
    }
}
