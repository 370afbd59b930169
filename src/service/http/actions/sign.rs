//! Signature of a result by a person.

use axum::Json;
use axum::extract::{Extension, Path, State};
use axum::http::StatusCode;
use axum::response::{IntoResponse, Redirect, Response};
use serde::Deserialize;
use utoipa::ToSchema;

use super::body::{JsonOrFormBody, truncate_reason};
use super::run_to_completion;
use crate::archive::report::ReportError;
use crate::service::http::AppState;
use crate::service::http::access::Caller;
use crate::service::http::openapi::schemas::SignatureSchema;
use crate::service::http::problem::Problem;
use crate::store::{AuditEntry, EstimateSignature, RunId};

#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct SignRequest {
    who: String,
    /// Remark.
    #[serde(default)]
    why: String,
    /// SHA-256 of the estimate that this person has read.
    estimate: String,
}

/// Sign a result.
#[utoipa::path(post, path = "/api/v1/runs/{run}/sign", operation_id = "sign", params(("run" = i64, Path)), request_body = SignRequest, responses((status = CREATED, body = SignatureSchema)))]
pub async fn sign_result(
    State(app): State<AppState>,
    Path(run): Path<i64>,
    Extension(caller): Extension<Caller>,
    JsonOrFormBody { body: SignRequest { who, why, estimate }, is_form }: JsonOrFormBody<SignRequest>,
) -> Result<Response, Problem> {
    let (run, who) = (RunId(run), caller.audit_name(&who)?);
    let stored = app.read_journal(move |journal| journal.load_run(run)).await??;
    let last = stored.estimates.last().ok_or(ReportError::NoEstimate(run))?;
    if last.sha256 != estimate {
        return Err(Problem::new(
            StatusCode::CONFLICT,
            "other-estimate",
            format!("run {run} has been identified again, and its estimate has changed"),
            "read the new estimate, then sign it",
        ));
    }
    let remark = truncate_reason(&why);
    let signature = EstimateSignature { who, remark, estimate_sha256: estimate };
    let signature = run_to_completion(store_signature(app, run, stored.summary.machine, signature)).await?;
    Ok(match is_form {
        true => Redirect::to(&format!("/runs/{run}")).into_response(),
        false => (StatusCode::CREATED, Json(signature)).into_response(),
    })
}

/// Stores the signature, then its entry in the audit log; returns the signature.
async fn store_signature(
    app: AppState,
    run: RunId,
    machine: String,
    signature: EstimateSignature,
) -> Result<EstimateSignature, Problem> {
    app.journal.add_signature(run, &signature).await?;
    let (who, why) = (signature.who.clone(), signature.remark.clone());
    let (what, outcome) = (format!("signature under run {run}"), "accepted".to_owned());
    app.journal.add_audit_entry(&AuditEntry { who, what, why, machine, run: run.0, outcome }).await?;
    Ok(signature)
}
