//! Page of the values that are proposed from a run for the control.

use axum::extract::{Extension, Path, Query, State};
use axum::response::Html;
use minijinja::value::Serde;
use minijinja::{Value, context};

use super::{machine_page_path, render_page};
use crate::compensation::{
    CompensationError, MachineCompensation, ProposalTable, VerificationTable, render_correction_sheet,
};
use crate::report::time::format_local_time;
use crate::service::http::AppState;
use crate::service::http::access::Caller;
use crate::service::http::compensation::{ProposalQuery, TargetQuery};
use crate::service::http::problem::Problem;
use crate::setup::{CompensationConfig, MachineFile};
use crate::store::{CompensationState, Journal, RunId, StoreError, StoredCompensation};

pub async fn proposal_page(
    State(app): State<AppState>,
    Extension(caller): Extension<Caller>,
    Path(run): Path<i64>,
    Query(query): Query<ProposalQuery>,
) -> Result<Html<String>, Problem> {
    let machine = app.machine_of_run(run).await?;
    let (source, target) = (query.source(run), query.target.clone());
    let hashed = app.read_control(&caller, &machine, target, move |compensation| compensation.propose(source)).await?;
    let table = ProposalTable::new(&hashed.proposal);
    render_page(
        "compensation.html",
        app.access.requires_tokens,
        context! {
            run,
            machine => machine.name.as_str(),
            machine_path => machine_page_path(&machine.name),
            control => hashed.proposal.control.as_str(),
            measured => format_local_time(hashed.proposal.measured_at),
            sha256 => hashed.sha256.as_str(),
            has_changes => table.values.iter().any(|value| value.is_changed),
            table => Serde(table),
            query => Serde(query),
        },
    )
}

pub async fn verification_page(
    State(app): State<AppState>,
    Extension(caller): Extension<Caller>,
    Path(run): Path<i64>,
    Query(TargetQuery { target }): Query<TargetQuery>,
) -> Result<Html<String>, Problem> {
    let machine = app.machine_of_run(run).await?;
    let compare = move |compensation: &MachineCompensation<'_>| compensation.compare_with_prediction(RunId(run));
    let verification = app.read_control(&caller, &machine, target.clone(), compare).await?;
    render_page(
        "verification.html",
        app.access.requires_tokens,
        context! {
            run,
            target,
            machine => machine.name.as_str(),
            machine_path => machine_page_path(&machine.name),
            compensation => verification.compensation,
            first_run => verification.first_run.0,
            table => Serde(VerificationTable::new(&verification)),
        },
    )
}

/// The sheet of the measured errors, as a page of its own.
pub async fn sheet_page(State(app): State<AppState>, Path(run): Path<i64>) -> Result<Html<String>, Problem> {
    let sheet = app.read_journal(move |journal| render_correction_sheet(journal, RunId(run))).await?;
    Ok(Html(sheet.map_err(CompensationError::from)?.html))
}

/// Kinds of values of the machine whose last compensation `run` may verify: its values are in the control and in use,
/// and `run` is newer than its run and not older than the run of its last verification.
pub fn verifiable_targets(
    journal: &Journal,
    machine: &MachineFile,
    run: RunId,
) -> Result<Vec<&'static str>, StoreError> {
    let stored = journal.compensations(&machine.machine.name)?;
    let is_verifiable = |kind: &&str| {
        let last = stored.iter().find(|own| own.target == *kind);
        last.is_some_and(|last| last.can_be_verified_by(run))
    };
    Ok(machine.compensation.iter().map(CompensationConfig::kind).filter(is_verifiable).collect())
}

/// The last compensation of each kind of values of the machine, for its page; a kind whose last compensation is undone
/// is left out.
pub fn last_compensation_values(journal: &Journal, machine: &MachineFile) -> Result<Vec<Value>, StoreError> {
    let stored = journal.compensations(&machine.machine.name)?;
    let last = machine.compensation.iter().filter_map(|own| stored.iter().find(|stored| stored.target == own.kind()));
    let shown = last.filter(|last| last.state != CompensationState::Undone);
    Ok(shown.map(compensation_values).collect())
}

fn compensation_values(last: &StoredCompensation) -> Value {
    context! {
        id => last.id,
        target => last.target.as_str(),
        run => last.run.0,
        who => last.who.as_str(),
        at => format_local_time(last.at),
        verified_by => last.verified_by.map(|run| run.0),
        is_verified => last.state == CompensationState::Verified,
        unfinished => last.unfinished().map(|unfinished| unfinished.to_string()),
        is_undone => last.state.is_undone(),
        awaits_restart => last.state.awaits_restart(),
    }
}
