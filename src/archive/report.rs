//! Report of a stored run.

use super::run_story::{describe_events_with_times, describe_signatures};
use super::volumetric_error::volumetric_error_maps;
use crate::report::{page, temperature};
use crate::store::{Journal, RunId, StoreError};
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
        start_time: stored.summary.started.to_string(),
        program_version: last.program_version.clone(),
        sha256_by_item: vec![
            ("machine file".to_owned(), stored.summary.config_sha256.clone()),
            ("plan".to_owned(), stored.summary.plan_sha256.clone()),
            ("estimate".to_owned(), last.sha256.clone()),
        ],
        reading_count: stored.readings.len(),
        temperature_rows: temperature::temperature_rows(&stored.readings),
        run_state: stored.summary.state.as_str().to_owned(),
        events_with_times: describe_events_with_times(&stored),
        signatures: Some(describe_signatures(&stored)),
        volume_texts_and_maps: volumetric_error_maps(&stored.plan.machine, &last.estimate),
        stage_proofs: stored.events.iter().filter_map(|(_, event)| stage_proof(event)).collect(),
    };
    Ok(page::render_result_page(&stored.plan, &last.estimate, &facts)?)
}

fn stage_proof(event: &RunEvent) -> Option<StageProof> {
    match event {
        RunEvent::StageProven { proof, .. } => Some(proof.clone()),
        _ => None,
    }
}
