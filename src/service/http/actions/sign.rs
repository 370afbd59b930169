//! Signature of a person under a result.

use axum::Json;
use axum::extract::{Extension, Path, State};
use axum::http::StatusCode;
use axum::response::{IntoResponse, Redirect, Response};
use serde::Deserialize;
use utoipa::ToSchema;

use super::to_the_end;
use super::words::{JsonOrForm, truncate_reason};
use crate::archive::report::ReportError;
use crate::service::http::AppState;
use crate::service::http::access::Caller;
use crate::service::http::journal::read_journal;
use crate::service::http::openapi::views::SignatureView;
use crate::service::http::problem::Problem;
use crate::store::{Audit, RunId, Signature};

#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Sign {
    who: String,
    /// Remark.
    #[serde(default)]
    why: String,
    /// SHA-256 of the estimate that this person has read.
    estimate: String,
}

/// Sign a result.
#[utoipa::path(post, path = "/api/v1/runs/{run}/sign", params(("run" = i64, Path)), request_body = Sign, responses((status = CREATED, body = SignatureView)))]
pub async fn sign(
    State(web): State<AppState>,
    Path(run): Path<i64>,
    Extension(caller): Extension<Caller>,
    words: JsonOrForm<Sign>,
) -> Result<Response, Problem> {
    let (Sign { who, why, estimate }, to_page) = words.split();
    let (run, who) = (RunId(run), caller.signs(&who)?);
    let stored = read_journal(&web, move |journal| journal.load(run)).await??;
    let last = stored.estimates.last().ok_or(ReportError::NoEstimate(run))?;
    if last.sha256 != estimate {
        return Err(Problem::new(
            StatusCode::CONFLICT,
            "other-estimate",
            format!("run {run} has been identified again since: its estimate is another one"),
            "read it, then sign that one",
        ));
    }
    let remark = truncate_reason(&why);
    let signature = Signature { who, remark, estimate_sha256: estimate };
    let signature = to_the_end(signed(web, run, stored.summary.machine, signature)).await?;
    Ok(match to_page {
        true => Redirect::to(&format!("/runs/{run}")).into_response(),
        false => (StatusCode::CREATED, Json(signature)).into_response(),
    })
}

async fn signed(
    web: AppState,
    run: RunId,
    machine: String,
    signature: Signature,
) -> Result<Signature, Problem> {
    web.journal.sign(run, &signature).await?;
    let (who, why) = (signature.who.clone(), signature.remark.clone());
    let (what, outcome) = (format!("signature under run {run}"), "accepted".to_owned());
    web.journal.audit(&Audit { who, what, why, machine, run: run.0, outcome }).await?;
    Ok(signature)
}
