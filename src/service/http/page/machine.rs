//! Page of one machine: its state, the actions, the trends of its values.

use std::sync::Arc;

use axum::body::Bytes;
use axum::extract::State;
use axum::response::Html;
use jiff::Timestamp;
use minijinja::value::Serde;
use minijinja::{Value, context};

use super::{compensation, run_drawings, schedule, sensors, trends};
use super::{machine_page_path, render_page, render_template, row_of_run_on};
use crate::archive::history::machine_history;
use crate::report::result_row::{ResultRow, RunContext, headline_rows, result_rows, verdict_class};
use crate::report::time::format_local_time;
use crate::run::{can_resume, resume_question};
use crate::service::config::StartInterlock;
use crate::service::http::machine_status::MachineStatus;
use crate::service::http::newest_result::NewestResult;
use crate::service::http::problem::Problem;
use crate::service::http::{AppState, ServedMachine};
use crate::service::schedule_state::load_agenda;
use crate::store::{FinishedRunResult, Journal, RunFilter, RunId, StoredRun};
use machine::record::estimate::Verdict;

/// Maximum number of runs on a machine's page.
const MAX_SHOWN_RUNS: usize = 10;

pub async fn machine_page(State(app): State<AppState>, machine: ServedMachine) -> Result<Html<String>, Problem> {
    let tokens = app.access.requires_tokens;
    // The charts are drawn outside the thread that receives holds.
    app.read_journal(move |journal| render_page("machine.html", tokens, machine_values(journal, &machine)?)).await?
}

fn machine_values(journal: &Journal, machine: &ServedMachine) -> Result<Value, Problem> {
    let ServedMachine { name, gate, machine_file, .. } = machine;
    // The state is read before the journal, because the journal shows a held run first. If the state changes between
    // the two reads, the page is notified and reloads.
    let status = status_values(machine);
    let (all, (runs, waits)) =
        (machine_history(journal, name, &machine_file.tolerances)?, run_rows_and_resume_values(journal, machine)?);
    let views = run_drawings::views_of_run(journal, RunId(gate.machine_state().run.into()))?;
    gate.refresh_newest_runs(journal, name)?;
    Ok(context! {
        machine => status,
        views,
        waits,
        vouch => gate.config.required_interlocks.iter().map(confirmation_values).collect::<Vec<_>>(),
        trends => all.chunk_by(|one, other| one.method == other.method).map(trends::trend_values).collect::<Vec<_>>(),
        runs,
        compensations => compensation::last_compensation_values(journal, machine_file)?,
        schedule => schedule::schedule_values(&load_agenda(journal, gate.machine_state().planned_schedules, name)?),
    })
}

/// Live part of a machine's page; the script requests it at each change.
pub async fn live_part(State(app): State<AppState>, machine: ServedMachine) -> Result<Html<Bytes>, Problem> {
    let shared = Arc::clone(&machine.live_part_cache);
    // The counter is read first: a change during the rendering causes a new rendering.
    let change = *machine.gate.subscribe_changes().borrow();
    let render = move |journal: &Journal| {
        machine.gate.refresh_newest_runs(journal, &machine.name)?;
        let views = run_drawings::views_of_run(journal, RunId(machine.gate.machine_state().run.into()))?;
        render_template("live.html", context! { machine => status_values(&machine), views })
    };
    shared.get_or_render(change, async { app.read_journal(render).await? }).await
}

/// Template rows of the newest runs and, if the last run is resumable, the template values for its resume.
fn run_rows_and_resume_values(
    journal: &Journal,
    machine: &ServedMachine,
) -> Result<(Vec<Value>, Option<Value>), Problem> {
    let wanted = RunFilter { machine: Some(&machine.name), ..RunFilter::default() };
    let runs = journal.list_runs(wanted, MAX_SHOWN_RUNS)?;
    let last = runs.first().filter(|run| run.state.is_resumable());
    let waits = last.map(|last| journal.load_run(last.id)).transpose()?;
    let row = |run| row_of_run_on(Some(machine), run);
    Ok((runs.iter().map(row).collect(), waits.as_ref().map(resume_values)))
}

/// Template values of the form that resumes the run `stored`.
fn resume_values(stored: &StoredRun) -> Value {
    let asked = resume_question(stored);
    context! {
        run => asked.run.0,
        ended => asked.end_reason,
        position_lost => asked.may_have_lost_position,
        can_resume => can_resume(&stored.plan, &stored.readings),
    }
}

/// Template values of the machine's current state. The parameters are those of the newest result, and only while it
/// is valid and the machine neither measures nor is held.
pub fn status_values(machine: &ServedMachine) -> Value {
    let mut status = MachineStatus::from_machine(machine);
    // The page shows the parameters of the newest result instead.
    status.parameters.clear();
    let result = status.result.as_ref();
    let (class, glance) = state_class_and_text(&status, result);
    // Outdated values are shown only on the page of their run.
    let shows_values = !matches!(class, "busy" | "held") && result.is_some_and(|r| !r.outdated);
    let newest = machine.gate.machine_state().newest_runs;
    let rows = newest.newest_result.as_ref().filter(|_| shows_values).map(rows_of_newest_result).unwrap_or_default();
    let parameters = headline_rows(&rows);
    context! {
        result => result.map(|newest| context! { run => newest.run, at => format_local_time(newest.measured) }),
        asked => status.open_prompt.as_ref().map(|asked| context! {
            step => asked.step,
            repeat => asked.repeat,
            text => asked.text.as_str(),
            live => asked.live.as_ref().map(sensors::live_values),
        }),
        class,
        glance,
        address => machine_page_path(&machine.name),
        worst => worst_sentences(&parameters),
        parameters => Serde(&parameters),
        remaining => status.remaining_s.map(format_minutes_and_seconds),
        now => format_local_time(Timestamp::now()),
        ..Serde(&status)
    }
}

/// Sentences for the banner: the results that have not passed, or the one that is nearest to its limit. `rows` must
/// have the results that are farthest from passing first.
fn worst_sentences(rows: &[&ResultRow]) -> Vec<String> {
    let judged: Vec<&&ResultRow> = rows.iter().filter(|row| row.verdict.is_some()).collect();
    let failed = judged.iter().filter(|row| row.verdict != Some(Verdict::Pass)).count();
    judged.into_iter().take(failed.max(1)).map(|row| row.sentence.clone()).collect()
}

fn rows_of_newest_result(newest: &FinishedRunResult) -> Vec<ResultRow> {
    let FinishedRunResult { method, first_to_last_reading_s, parameters, .. } = newest;
    result_rows(RunContext { method, first_to_last_reading_s: *first_to_last_reading_s }, parameters)
}

/// CSS class and text of the state that must be readable from a distance.
fn state_class_and_text(status: &MachineStatus, result: Option<&NewestResult>) -> (&'static str, &'static str) {
    match (status.state, result) {
        _ if status.is_worker_late => ("none", "unknown: the service makes no progress"),
        ("held", _) if status.is_locked_by_other_process => ("held", "held: another program uses the machine"),
        ("starting", _) => ("none", "unknown: the service is starting"),
        ("ending", _) => ("none", "unknown: the service is ending"),
        ("running", _) if status.open_prompt.is_some() => ("held", "waiting: a prompt is open"),
        ("running", _) => ("busy", "measuring"),
        ("held", _) => ("held", "held: inspect the machine"),
        (_, _) if status.not_identified.is_some() => ("none", "unknown: the newest run is not identified"),
        ("failed", _) => ("none", "not measured: the last cycle failed"),
        (_, Some(NewestResult { outdated: true, .. })) => ("none", "unknown: the last result is out of date"),
        (_, Some(newest)) => verdict_class_and_text(newest.verdict),
        (_, None) => ("none", "unknown: no result yet"),
    }
}

pub fn verdict_class_and_text(verdict: Verdict) -> (&'static str, &'static str) {
    let text = match verdict {
        Verdict::Pass => "in tolerance",
        Verdict::Fail => "out of tolerance",
        Verdict::Undecided => "undecided",
        Verdict::UndecidedModel => "undecided: the readings contradict the model",
        Verdict::None => "measured, no tolerance stated",
    };
    (verdict_class(verdict), text)
}

/// Field name and text of the check box with which a person confirms the interlock.
fn confirmation_values(interlock: &StartInterlock) -> Value {
    let (name, words) = match interlock {
        StartInterlock::Enable => ("enable", "the machine may move; the probe or sensor is fitted and undamaged"),
        StartInterlock::Auto => ("auto", "the control is in automatic mode"),
        StartInterlock::Door => ("door", "the guards are closed"),
    };
    context! { name, words }
}

fn format_minutes_and_seconds(seconds: f64) -> String {
    let whole = seconds.max(0.0).round() as u64;
    format!("{}:{:02}", whole / 60, whole % 60)
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;
    use crate::service::command_gate::CommandGate;
    use crate::service::machine_state::ServiceState;
    use crate::setup::MachineFile;

    /// The last state reported by a hung worker is not shown as the current one.
    #[test]
    fn page_of_a_hung_worker_shows_state_unknown_and_no_run_values() {
        let (gate, _asks) = CommandGate::for_tests();
        let machine_file = Arc::new(MachineFile::built_in_for_method("self-calibration").unwrap());
        let machine = ServedMachine { name: "mill".to_owned(), machine_file, gate, live_part_cache: Arc::default() };
        machine.gate.update_machine_state(|machine_state| {
            (machine_state.state, machine_state.run, machine_state.stored_touch_and_scan_count) =
                (ServiceState::Running, 3, 17);
            "touch 18".clone_into(&mut machine_state.step_label);
        });
        let page = || {
            let values = context! { machine => status_values(&machine), views => () };
            (MachineStatus::from_machine(&machine).is_worker_late, render_template("live.html", values).ok().unwrap().0)
        };
        let (late, lives) = page();
        assert!(!late && lives.contains("touch 18") && lives.contains("time left"), "{lives}");
        assert!(lives.contains("unknown") && !lives.contains("0:00"), "{lives}");
        machine.gate.report_progress(Duration::ZERO);
        std::thread::sleep(Duration::from_millis(1));
        let (late, hangs) = page();
        assert!(late && hangs.contains("unknown: the service makes no progress"), "{hangs}");
        for words in ["touch 18", "time left", ">17<", "measuring"] {
            assert!(!hangs.contains(words), "{words}: {hangs}");
        }
    }
}
