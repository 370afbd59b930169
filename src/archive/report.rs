//! Report of a stored run.

use super::run_story::{describe_signatures, run_story};
use super::volume::volumetric_error_maps;
use crate::report::{page, temperature};
use crate::store::{Journal, RunId, StoreError};
use machine::record::event::Event;
use machine::record::proof::Proof;

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
        run: run.to_string(),
        started: stored.summary.started.to_string(),
        program_version: last.program_version.clone(),
        hashes: vec![
            ("machine file".to_owned(), stored.summary.config_sha256.clone()),
            ("plan".to_owned(), stored.summary.plan_sha256.clone()),
            ("estimate".to_owned(), last.sha256.clone()),
        ],
        readings: stored.readings.len(),
        temperatures: temperature::temperature_rows(&stored.readings),
        state: stored.summary.state.as_str().to_owned(),
        story: run_story(&stored),
        signed: Some(describe_signatures(&stored)),
        volume: volumetric_error_maps(&stored.plan.machine, &last.estimate),
        proofs: stored.events.iter().filter_map(|(_, event)| stage_proof(event)).collect(),
    };
    Ok(page::render(&stored.plan, &last.estimate, &facts)?)
}

fn stage_proof(event: &Event) -> Option<Proof> {
    match event {
        Event::StageProven { proof, .. } => Some(proof.clone()),
        _ => None,
    }
}
