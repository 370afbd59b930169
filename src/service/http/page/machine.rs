//! Page of one machine: its state, the actions, the trends of its values.

use axum::body::Bytes;
use axum::extract::{Path, State};
use axum::response::Html;
use jiff::Timestamp;
use minijinja::{Value, context};

use super::{address, moment, render, row, schedule, sensors, trends, views, whole};
use crate::archive::history::history;
use crate::run::{can_resume, question};
use crate::service::config::Demand;
use crate::service::http::journal::read_journal;
use crate::service::http::problem::Problem;
use crate::service::http::results::NewestResult;
use crate::service::http::status::MachineStatus;
use crate::service::http::{AppState, ServedMachine};
use crate::service::machine_state::Failure;
use crate::service::schedule_state::agenda;
use crate::store::{Journal, RunId, StoredRun, Wanted};
use machine::record::estimate::Verdict;

/// Number of runs on a machine's page.
const NEWEST: usize = 10;

pub async fn page(
    State(web): State<AppState>,
    Path(name): Path<String>,
) -> Result<Html<String>, Problem> {
    let machine = web.machine(&name).ok_or_else(|| Problem::not_found(&name))?.clone();
    let tokens = web.access.demanded();
    // The charts are drawn outside the thread that receives holds.
    read_journal(&web, move |journal| whole("machine.html", tokens, values(journal, &machine)?))
        .await?
}

fn values(journal: &Journal, machine: &ServedMachine) -> Result<Value, Problem> {
    let ServedMachine { name, gate, tolerance, .. } = machine;
    // Before the journal, in which a held run appears first. If a change comes between the two reads, the page is
    // notified and reloads.
    let standing = standing(machine);
    let (all, (runs, waits)) = (history(journal, name, tolerance)?, newest(journal, name)?);
    let views = views::of_run(journal, RunId(gate.machine_state().run.into()))?;
    gate.query_newest(journal, name)?;
    Ok(context! {
        machine => standing,
        views,
        waits,
        vouch => machine.demand.iter().map(vouch).collect::<Vec<_>>(),
        trends => all.chunk_by(|one, other| one.method == other.method).map(trends::of_method).collect::<Vec<_>>(),
        runs,
        schedule => schedule::panel(&agenda(journal, gate.machine_state().planned, name)?),
    })
}

/// Live part of the page, for the script.
pub async fn live(
    State(web): State<AppState>,
    Path(name): Path<String>,
) -> Result<Html<Bytes>, Problem> {
    let (machine, shared) =
        web.machine(&name).zip(web.live.get(&name)).ok_or_else(|| Problem::not_found(&name))?;
    // Read first: a change while the part is rendered causes a new rendering.
    let change = *machine.gate.changes().borrow();
    let make = async {
        let machine = machine.clone();
        let made = read_journal(&web, move |journal| {
            machine.gate.query_newest(journal, &machine.name)?;
            let views = views::of_run(journal, RunId(machine.gate.machine_state().run.into()))?;
            render("live.html", context! { machine => standing(&machine), views })
        });
        made.await?
    };
    shared.at(change, make).await
}

/// The newest runs, and the last one if it waits for a person, with the question before its resume.
fn newest(journal: &Journal, machine: &str) -> Result<(Vec<Value>, Option<Value>), Problem> {
    let wanted = Wanted { machine: Some(machine), ..Wanted::default() };
    let runs = journal.some_runs(wanted, NEWEST)?;
    let last = runs.first().filter(|run| run.state.is_resumable());
    let waits = last.map(|last| journal.load(last.id)).transpose()?;
    Ok((runs.iter().map(row).collect(), waits.as_ref().map(waiting)))
}

fn waiting(stored: &StoredRun) -> Value {
    let asked = question(stored);
    context! {
        run => asked.run.0,
        ended => asked.ended,
        position_lost => asked.position_lost,
        can_resume => can_resume(&stored.plan, &stored.readings),
    }
}

pub fn standing(machine: &ServedMachine) -> Value {
    let standing = MachineStatus::of(machine);
    let result = standing.result.clone();
    let (class, glance) = glance(&standing, result.as_ref());
    // Values that no longer describe the machine are shown only with their run.
    let says =
        !matches!(class, "measuring" | "held") && result.as_ref().is_some_and(|r| !r.outdated);
    let newest = machine.gate.machine_state().newest;
    let parameters = newest.result.iter().filter(|_| says).flat_map(|newest| &newest.parameters);
    let parameters = parameters.map(|p| {
        context! {
            symbol => p.symbol.as_str(),
            value => format!("{:.1}", p.value),
            expanded => format!("{:.1}", p.expanded),
            unit => p.unit.symbol(),
            judged => p.judged.map(|judged| context! {
                limit => format!("{:.1}", judged.limit),
                verdict => judged.verdict.to_string(),
            }),
        }
    });
    let cycles = standing.cycles.iter();
    let cycles = cycles.map(|c| context! { number => c.number, method => c.method.as_str() });
    context! {
        name => standing.name.as_str(),
        state => standing.state,
        run => standing.run,
        late => standing.late,
        not_identified => standing.not_identified,
        result => result.map(|told| context! { run => told.run, at => moment(told.measured) }),
        stage => standing.stage.as_str(),
        step => standing.step.as_str(),
        progress_percent => standing.progress_percent,
        measured => standing.measured,
        refusal => standing.refusal.as_deref(),
        failure => standing.failure.as_ref().map(|Failure { what, remedy }| context! { what, remedy }),
        asked => standing.asked.as_ref().map(|asked| context! {
            step => asked.step,
            repeat => asked.repeat,
            text => asked.text.as_str(),
            live => asked.live.as_ref().map(sensors::values),
        }),
        cycles => cycles.collect::<Vec<_>>(),
        class,
        glance,
        address => address(&machine.name),
        parameters => parameters.collect::<Vec<_>>(),
        remaining => standing.remaining_s.map(minutes),
        now => moment(Timestamp::now()),
    }
}

/// CSS class and text of the state that must be readable from a distance.
fn glance(standing: &MachineStatus, result: Option<&NewestResult>) -> (&'static str, &'static str) {
    match (standing.state, result) {
        _ if standing.late => ("unknown", "unknown: the service hangs"),
        ("held", _) if standing.elsewhere => ("held", "held: another program has the machine"),
        ("running", _) if standing.asked.is_some() => ("held", "waits: a person is asked"),
        ("running", _) => ("measuring", "measuring"),
        ("held", _) => ("held", "held: look at the machine"),
        (_, _) if standing.not_identified.is_some() => {
            ("unknown", "unknown: the newest run is not identified")
        }
        ("failed", _) => ("unknown", "not measured: the last cycle failed"),
        (_, Some(NewestResult { outdated: true, .. })) => {
            ("unknown", "unknown: measured too long ago")
        }
        (_, Some(told)) => of_verdict(told.verdict),
        (_, None) => ("unknown", "unknown: no result yet"),
    }
}

pub fn of_verdict(verdict: Verdict) -> (&'static str, &'static str) {
    match verdict {
        Verdict::Pass => ("true", "true"),
        Verdict::Fail => ("untrue", "not true"),
        Verdict::Undecided => ("unknown", "undecided"),
        Verdict::UndecidedModel => ("unknown", "undecided: the readings contradict the model"),
        Verdict::None => ("unknown", "measured, no tolerance stated"),
    }
}

fn vouch(demand: &Demand) -> Value {
    let (name, words) = match demand {
        Demand::Enable => ("enable", "the machine is free to be moved, what sits in it is whole"),
        Demand::Auto => ("auto", "the control is in its automatic mode"),
        Demand::Door => ("door", "the guards are closed"),
    };
    context! { name, words }
}

fn minutes(seconds: f64) -> String {
    let whole = seconds.max(0.0).round() as u64;
    format!("{}:{:02}", whole / 60, whole % 60)
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;
    use crate::service::command_gate::CommandGate;
    use crate::service::machine_state::State;

    /// The last state reported by a hung worker is not shown as the current one.
    #[test]
    fn without_a_sign_of_life_nothing_is_known() {
        let ((gate, _asks), verdict_validity) =
            (CommandGate::for_tests(), Duration::from_secs(3600));
        let (name, cycles, demand) = ("mill".to_owned(), Vec::new(), Vec::new());
        let (file_sha256, tolerance) = (String::new(), Vec::new());
        let machine =
            ServedMachine { name, file_sha256, gate, cycles, demand, tolerance, verdict_validity };
        machine.gate.update(|machine_state| {
            (machine_state.state, machine_state.run, machine_state.measured) =
                (State::Running, 3, 17);
            "touch 18".clone_into(&mut machine_state.step);
        });
        let page = || {
            let values = context! { machine => standing(&machine), views => () };
            (MachineStatus::of(&machine).late, render("live.html", values).ok().unwrap().0)
        };
        let (late, lives) = page();
        assert!(!late && lives.contains("touch 18") && lives.contains("time left"), "{lives}");
        assert!(lives.contains("not known yet") && !lives.contains("0:00"), "{lives}");
        machine.gate.report_progress(Duration::ZERO);
        std::thread::sleep(Duration::from_millis(1));
        let (late, hangs) = page();
        assert!(late && hangs.contains("unknown: the service hangs"), "{hangs}");
        for words in ["touch 18", "time left", ">17<", "measuring"] {
            assert!(!hangs.contains(words), "{words}: {hangs}");
        }
    }
}
