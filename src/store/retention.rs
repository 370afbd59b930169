//! What may go after a time: the samples of scans, which are large, once their run has its estimate.
//! Touches, events, estimates and the audit log stay for good.

use jiff::Timestamp;
use rusqlite::{Connection, params};

use super::{Fault, Journal, RunId, RunState, StoreError, read};
use machine::record::event::Event;

impl Journal {
    /// Runs that came to their end before `before` and have an estimate: what was sampled in them may
    /// be forgotten. Oldest first.
    ///
    /// # Errors
    /// The journal cannot be read.
    pub fn outlived(&self, before: Timestamp) -> Result<Vec<RunId>, StoreError> {
        self.look(|connection| outlived(connection, before))
    }

    /// Remove the samples of `run`'s scans, a scan at a time: whoever writes a touch waits for one of
    /// them at most. The run's own story says so. Blocks this thread; answers with the number of scans.
    ///
    /// # Errors
    /// The journal cannot be written.
    pub fn forget_scans(&self, run: RunId) -> Result<u32, StoreError> {
        let scans = self.look(|connection| scans(connection, run))?;
        if scans == 0 {
            return Ok(0);
        }
        self.event(run, &Event::SamplesRemoved { scans }).wait()?;
        while self.submit(move |connection| forget_one(connection, run)).wait()? {}
        Ok(scans)
    }
}

fn outlived(connection: &Connection, before: Timestamp) -> Result<Vec<RunId>, Fault> {
    let runs = read::runs(connection)?.into_iter();
    let old = runs.filter(|run| {
        run.state == RunState::Finished && run.ended.is_some_and(|ended| ended < before)
    });
    Ok(old.map(|run| run.id).collect())
}

fn scans(connection: &Connection, run: RunId) -> Result<u32, Fault> {
    let count = "SELECT count(*) FROM readings WHERE run = ?1 AND samples IS NOT NULL";
    Ok(connection.query_row(count, [run.0], |row| row.get(0))?)
}

/// Whether there was one.
fn forget_one(connection: &mut Connection, run: RunId) -> Result<bool, Fault> {
    let removed = connection.execute(
        "DELETE FROM readings WHERE seq =
             (SELECT seq FROM readings WHERE run = ?1 AND samples IS NOT NULL LIMIT 1)",
        params![run.0],
    )?;
    Ok(removed == 1)
}
