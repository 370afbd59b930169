//! Resume of a run by a person at the page.

use axum::extract::{Extension, Path, State};
use axum::http::StatusCode;
use axum::response::Response;
use serde::Deserialize;
use utoipa::ToSchema;

use super::words::{JsonOrForm, truncate_reason};
use super::{not_vouched, said, settled};
use crate::archive::story::resume_hint;
use crate::run::{AgainError, Question, ResumableRun, can_resume};
use crate::service::http::AppState;
use crate::service::http::access::Caller;
use crate::service::http::journal::read_journal;
use crate::service::http::problem::Problem;
use crate::service::http::status::MachineStatus;
use crate::service::worker_command::Inspection;
use crate::store::RunId;

#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct GoOn {
    run: i64,
    who: String,
    #[serde(default)]
    why: String,
    /// Conditions that this person has checked at the machine: the path is free, the spindle's content is undamaged.
    #[serde(default)]
    free: bool,
    #[serde(default)]
    whole: bool,
    /// Whether all axes are homed; required where the control may have lost its position.
    #[serde(default)]
    homed: bool,
}

/// Resume a held run. The caller confirms the state of the machine.
#[utoipa::path(post, path = "/api/v1/machines/{name}/resume", params(("name" = String, Path)), request_body = GoOn, responses((status = ACCEPTED, body = MachineStatus)))]
pub async fn resume(
    State(web): State<AppState>,
    Path(name): Path<String>,
    Extension(caller): Extension<Caller>,
    words: JsonOrForm<GoOn>,
) -> Result<Response, Problem> {
    let machine = web.machine(&name).ok_or_else(|| Problem::not_found(&name))?.clone();
    let (GoOn { run, who, why, free, whole, homed }, to_page) = words.split();
    let (who, why) = (caller.signs(&who)?, truncate_reason(&why));
    let run = RunId(run);
    let stored = read_journal(&web, move |journal| journal.load(run)).await??;
    if stored.summary.machine != name {
        return Err(Problem::not_found(format!("run {run} of {name}")));
    }
    let can_resume = can_resume(&stored.plan, &stored.readings);
    let again = ResumableRun::of(stored)?;
    if !(free && whole) {
        return Err(not_vouched(&format!("that it can go on ({})", again.question().ask)));
    }
    again.acknowledged(&who, homed)?;
    if !can_resume {
        return Err(Problem::new(
            StatusCode::CONFLICT,
            "no-references",
            resume_hint(run, can_resume, false),
            "acknowledge it, then start a new run",
        ));
    }
    let accepted =
        machine.gate.resume(run, Inspection { who: &who, why: &why, homed }, said(&machine));
    let what = format!("resume of run {run}");
    settled(web, machine, (who, what, why), accepted, to_page).await
}

impl From<AgainError> for Problem {
    fn from(error: AgainError) -> Self {
        let (code, remedy) = match &error {
            AgainError::NotUnfinished { way_on, .. } => ("not-unfinished", way_on.clone()),
            AgainError::Nobody(Question { ask, .. }) => ("nameless", Some((*ask).to_owned())),
            AgainError::NotHomed(Question { ask, .. }) => ("not-homed", Some((*ask).to_owned())),
            AgainError::Setup(error) => ("setup", error.remedy()),
        };
        let remedy = remedy.unwrap_or_else(|| "start a new run".to_owned());
        Self::new(StatusCode::CONFLICT, code, error.to_string(), remedy)
    }
}
