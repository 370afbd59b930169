//! What the journal says of the machine's last run: whether a person is waited for.

use crate::record::event::Event;
use crate::store::{Journal, RunId, StoreError};

/// A run that waits for a person.
pub struct Unfinished {
    pub run: RunId,
    /// The axes must be homed first: a button cannot say so.
    pub position_lost: bool,
}

/// The last run of `machine`, if it is unfinished and nobody has acknowledged it since.
pub fn unfinished(journal: &Journal, machine: &str) -> Result<Option<Unfinished>, StoreError> {
    let runs = journal.runs()?;
    let last = runs.iter().rev().find(|run| run.machine == machine);
    let Some(last) = last.filter(|run| run.state.is_resumable()) else { return Ok(None) };
    let events = journal.load(last.id)?.events;
    let mut back = events.iter().rev().map(|(_, event)| event);
    if matches!(back.clone().next(), Some(Event::Acknowledged { .. })) {
        return Ok(None);
    }
    let lost = |event: &Event| matches!(event, Event::Faulted { position_lost: true, .. });
    let position_lost =
        back.by_ref().take_while(|event| !matches!(event, Event::Resumed { .. })).any(lost);
    Ok(Some(Unfinished { run: last.id, position_lost }))
}
