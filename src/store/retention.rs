//! Removal of old scan samples, which are large, once their run has an estimate. Touches, events, estimates and
//! the audit log are never removed.

use jiff::Timestamp;
use rusqlite::{Connection, params};

use super::{Journal, RunId, RunState, StoreError, StoreFault, read};
use machine::record::event::RunEvent;

impl Journal {
    /// Runs that ended before `before` and have an estimate, so that their samples may be removed. Oldest
    /// first.
    ///
    /// # Errors
    /// The journal cannot be read.
    pub fn finished_runs_ended_before(&self, before: Timestamp) -> Result<Vec<RunId>, StoreError> {
        self.query(|connection| finished_runs_ended_before(connection, before))
    }

    /// Removes the scans of `run` with all their samples, one scan per transaction, so that a touch waits for one
    /// removal at most. An event of the run records the removal. Blocks this thread; returns the number of scans.
    ///
    /// # Errors
    /// The journal cannot be written.
    pub fn remove_scans(&self, run: RunId) -> Result<u32, StoreError> {
        let scans = self.query(|connection| count_scans(connection, run))?;
        if scans == 0 {
            return Ok(0);
        }
        self.add_event(run, &RunEvent::SamplesRemoved { scans }).wait()?;
        while self.submit_job(move |connection| delete_next_stored_scan(connection, run)).wait()? {}
        Ok(scans)
    }
}

fn finished_runs_ended_before(connection: &Connection, before: Timestamp) -> Result<Vec<RunId>, StoreFault> {
    let runs = read::select_all_runs(connection)?.into_iter();
    let old = runs.filter(|run| run.state == RunState::Finished && run.ended.is_some_and(|ended| ended < before));
    Ok(old.map(|run| run.id).collect())
}

fn count_scans(connection: &Connection, run: RunId) -> Result<u32, StoreFault> {
    let count = "SELECT count(*) FROM readings WHERE run = ?1 AND samples IS NOT NULL";
    Ok(connection.query_row(count, [run.0], |row| row.get(0))?)
}

/// Removes one scan; returns whether a scan was removed.
fn delete_next_stored_scan(connection: &mut Connection, run: RunId) -> Result<bool, StoreFault> {
    let removed = connection.execute(
        "DELETE FROM readings WHERE seq =
             (SELECT seq FROM readings WHERE run = ?1 AND samples IS NOT NULL LIMIT 1)",
        params![run.0],
    )?;
    Ok(removed == 1)
}
