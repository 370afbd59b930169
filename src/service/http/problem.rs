//! Error response: a code for programs, a message and a remedy for people.

use axum::Json;
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use utoipa::ToSchema;

use crate::archive::report::ReportError;
use crate::service::machine_state::Refusal;
use crate::store::{StoreError, StoreFault};

#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Problem {
    #[serde(skip)]
    pub status: StatusCode,
    pub code: &'static str,
    pub message: String,
    pub remedy: String,
}

impl Problem {
    pub fn new(status: StatusCode, code: &'static str, message: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self { status, code, message: message.into(), remedy: remedy.into() }
    }

    pub fn not_found(what: impl std::fmt::Display) -> Self {
        let remedy = "choose an entry of the pages of machines and runs, or of /api/v1/machines and \
                      /api/v1/runs";
        Self::new(StatusCode::NOT_FOUND, "not-found", format!("there is no {what}"), remedy)
    }
}

impl IntoResponse for Problem {
    fn into_response(self) -> Response {
        (self.status, Json(self)).into_response()
    }
}

impl From<StoreError> for Problem {
    fn from(error: StoreError) -> Self {
        match &error.fault {
            // The client does not need the journal's path.
            StoreFault::RunNotFound(run) => Self::not_found(format!("run {run}")),
            _ => Self::new(StatusCode::INTERNAL_SERVER_ERROR, "journal", error.to_string(), error.remedy()),
        }
    }
}

impl From<ReportError> for Problem {
    fn from(error: ReportError) -> Self {
        let (status, code) = match error {
            ReportError::Store(error) => return error.into(),
            ReportError::NoEstimate(_) => (StatusCode::NOT_FOUND, "no-estimate"),
            ReportError::Template(_) => (StatusCode::INTERNAL_SERVER_ERROR, "template"),
        };
        Self::new(status, code, error.to_string(), error.remedy())
    }
}

impl From<minijinja::Error> for Problem {
    fn from(error: minijinja::Error) -> Self {
        ReportError::from(error).into()
    }
}

impl From<Refusal> for Problem {
    fn from(why: Refusal) -> Self {
        let remedy = match why {
            Refusal::Busy => "wait for the end of the run, or hold the run",
            Refusal::Held | Refusal::PositionLost => "inspect the machine, then acknowledge, or resume the run",
            Refusal::Failed => "read the reason in the log, then acknowledge",
            Refusal::NoSuchCycle => "start one of the cycles of [serve] in the machine file",
            Refusal::TooSoon => "wait for min_interval_s of [serve]",
            Refusal::UsedByOtherProgram => "end the other program that uses the machine",
            Refusal::NothingToAcknowledge => "no acknowledgement is needed",
            Refusal::PlanHasPrompts => "start the cycle on the page or with `trued run`, and answer its prompts there",
            Refusal::PromptNotOpen => "read on the page which prompt is open",
            Refusal::ArtefactRefused => {
                "read the reason and the remedy in the log, for example a new certificate with `trued artefact add`"
            }
            Refusal::NotReady => "wait until the service is ready",
            _ => "correct the condition at the machine, then repeat the request",
        };
        Self::new(StatusCode::CONFLICT, "refused", why.to_string(), remedy)
    }
}
