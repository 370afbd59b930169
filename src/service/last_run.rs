//! State of the machine's last run in the journal: whether it waits for a person.

use super::machine_state::RunFailure;
use crate::archive::run_story::{describe_run_end, is_abandoned, may_have_lost_position};
use crate::store::{Journal, RunFilter, RunId, RunSummary, StoreError};

/// An unfinished run that waits for a person.
pub struct RunAwaitingInspection {
    pub run: RunId,
    /// Whether the axes must be homed first; a physical button cannot confirm that.
    pub may_have_lost_position: bool,
    /// How the run ended, as a message for the person.
    pub failure: RunFailure,
}

/// The newest run of `machine`.
pub fn last_run(journal: &Journal, machine: &str) -> Result<Option<RunSummary>, StoreError> {
    let wanted = RunFilter { machine: Some(machine), ..RunFilter::default() };
    Ok(journal.list_runs(wanted, 1)?.pop())
}

/// The last run of `machine`, if it is unfinished and no person has acknowledged that it stays unfinished.
pub fn last_run_awaiting_inspection(
    journal: &Journal,
    machine: &str,
) -> Result<Option<RunAwaitingInspection>, StoreError> {
    let Some(last) = last_run(journal, machine)?.filter(|run| run.state.is_resumable()) else {
        return Ok(None);
    };
    let stored = journal.load_run(last.id)?;
    if is_abandoned(&stored) {
        return Ok(None);
    }
    let (position_lost, what) = (may_have_lost_position(&stored), describe_run_end(&stored));
    let failure = RunFailure { what, remedy: Some("inspect the machine".to_owned()) };
    Ok(Some(RunAwaitingInspection { run: last.id, may_have_lost_position: position_lost, failure }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::{NewRun, RunState};
    use machine::record::event::RunEvent;

    /// An acknowledgement for a resume does not close the run: a service that starts after a power cut still waits
    /// for a person.
    #[test]
    fn only_an_acknowledgement_that_abandons_the_run_closes_it() {
        let dir = tempfile::tempdir().unwrap();
        let journal = Journal::open(dir.path()).unwrap();
        let new = NewRun { machine_file_text: String::new(), plan: crate::archive::plan_for_tests("samba", "mill") };
        let run = journal.begin_run(&new).wait().unwrap();
        journal.set_state(run, RunState::Held).wait().unwrap();
        let waits = |event: RunEvent| {
            journal.add_event(run, &event).wait().unwrap();
            last_run_awaiting_inspection(&journal, "mill").unwrap().map(|before| before.may_have_lost_position)
        };
        let word = |leaves| RunEvent::Acknowledged { who: "Ada".to_owned(), what: "seen".to_owned(), leaves };
        let said = || RunEvent::OperatorMessage { text: "as ever".to_owned() };
        assert_eq!(waits(RunEvent::Held { reason: "a stop".to_owned() }), Some(false));
        assert_eq!(waits(word(false)), Some(false));
        assert_eq!(waits(said()), Some(false));
        assert_eq!(waits(word(true)), None);
        assert_eq!(waits(said()), None);
        assert_eq!(waits(RunEvent::SamplesRemoved { scans: 2 }), None);
        assert_eq!(waits(word(false)), Some(false));
        assert_eq!(waits(RunEvent::Resumed { gap_s: 1.0 }), Some(false));
        let (what, remedy) = ("reset".to_owned(), "home".to_owned());
        assert_eq!(waits(RunEvent::Faulted { what, remedy, position_lost: true }), Some(true));
        assert_eq!(waits(word(false)), Some(true));
    }
}
