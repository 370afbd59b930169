//! Resume of a run by a person at the web page.

use axum::http::StatusCode;
use axum::response::Response;
use serde::Deserialize;
use utoipa::ToSchema;

use super::{ActionRequest, interlocks_confirmed_by_person, not_confirmed_problem, truncate_reason};
use crate::archive::run_story::resume_hint;
use crate::run::{ResumableRun, ResumeQuestion, ResumeRefusal, can_resume, resume_question};
use crate::service::http::machine_status::MachineStatus;
use crate::service::http::problem::Problem;
use crate::service::worker_command::Inspection;
use crate::store::RunId;

#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ResumeRequest {
    run: i64,
    who: String,
    #[serde(default)]
    why: String,
    /// This person confirms that the path is free (`free`), and that the probe or sensor is undamaged (`whole`).
    #[serde(rename = "free", default)]
    is_path_free: bool,
    #[serde(rename = "whole", default)]
    is_probe_undamaged: bool,
    /// Whether all axes are homed; required where the control may have lost its position.
    #[serde(default)]
    homed: bool,
}

/// Resume a held run. The caller confirms the state of the machine.
#[utoipa::path(post, path = "/api/v1/machines/{name}/resume", operation_id = "resume", params(("name" = String, Path)), request_body = ResumeRequest, responses((status = ACCEPTED, body = MachineStatus)))]
pub async fn resume_held_run(action: ActionRequest<ResumeRequest>) -> Result<Response, Problem> {
    let ResumeRequest { run, ref who, ref why, is_path_free, is_probe_undamaged, homed } = action.body;
    let (who, why, run) = (action.caller.audit_name(who)?, truncate_reason(why), RunId(run));
    let machine = &action.machine;
    let stored = action.app.read_journal(move |journal| journal.load_run(run)).await??;
    if stored.summary.machine != machine.name {
        return Err(Problem::not_found(format!("run {run} of {}", machine.name)));
    }
    let can_resume = can_resume(&stored.plan, &stored.readings);
    let resumable_run = ResumableRun::from_stored(stored)?;
    if !(is_path_free && is_probe_undamaged) {
        return Err(not_confirmed_problem(&format!(
            "the run can resume ({})",
            resume_question(&resumable_run.stored_run).question_text
        )));
    }
    resumable_run.acknowledgement_event(&who, homed)?;
    if !can_resume {
        return Err(Problem::new(
            StatusCode::CONFLICT,
            "no-references",
            resume_hint(run, can_resume, false),
            "acknowledge the held run, then start a new run",
        ));
    }
    let accepted = machine.gate.resume_run(
        run,
        Inspection { who: &who, why: &why, is_homed: homed },
        interlocks_confirmed_by_person(machine),
    );
    action.await_audit_and_respond(who, format!("resume of run {run}"), why, accepted).await
}

impl From<ResumeRefusal> for Problem {
    fn from(error: ResumeRefusal) -> Self {
        let (code, remedy) = match &error {
            ResumeRefusal::NotResumable { next_action, .. } => ("not-unfinished", next_action.clone()),
            ResumeRefusal::OperatorNameMissing(ResumeQuestion { question_text: confirmation, .. }) => {
                ("nameless", Some((*confirmation).to_owned()))
            }
            ResumeRefusal::HomingNotConfirmed(ResumeQuestion { question_text: confirmation, .. }) => {
                ("not-homed", Some((*confirmation).to_owned()))
            }
            ResumeRefusal::Setup(error) => ("setup", error.remedy()),
        };
        let remedy = remedy.unwrap_or_else(|| "start a new run".to_owned());
        Self::new(StatusCode::CONFLICT, code, error.to_string(), remedy)
    }
}
