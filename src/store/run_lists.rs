//! Pages of long lists: a journal contains years of runs, and a run thousands of readings.

use rusqlite::{Connection, OptionalExtension, params};

use super::columns::{select_rows, select_rows_of_run};
use super::{FinishedRunResult, Journal, RunId, RunState, RunSummary, StoreError, StoreFault, checksum, read};
use machine::record::estimate::Verdict;
use machine::record::reading::Reading;

/// Filter of a list of runs. Without a bound the list begins with the newest run.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct RunFilter<'a> {
    /// Only runs older than this one.
    pub older_than: Option<RunId>,
    /// Only runs newer than this one; without `older_than` the runs that follow it directly.
    pub newer_than: Option<RunId>,
    pub machine: Option<&'a str>,
    pub method: Option<&'a str>,
    /// Only runs in this state; `Finished` excludes `NotIdentified`.
    pub state: Option<RunState>,
    /// Only runs whose last estimate has this verdict.
    pub verdict: Option<Verdict>,
}

/// The newest runs of a machine that were measured to their end.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct NewestMeasuredRuns {
    /// Result of the newest run with an estimate, from its last estimate.
    pub newest_result: Option<FinishedRunResult>,
    /// The newest run without an estimate, if it is newer than the run of `newest_result`.
    pub newer_run_without_estimate: Option<RunId>,
}

impl Journal {
    /// At most `limit` runs, newest first.
    ///
    /// # Errors
    /// The journal cannot be read.
    pub fn list_runs(&self, filter: RunFilter<'_>, limit: usize) -> Result<Vec<RunSummary>, StoreError> {
        let RunFilter { older_than: before, newer_than: after, machine, method, state, verdict } = filter;
        let is_ascending = after.is_some() && before.is_none();
        let order = if is_ascending { "ASC" } else { "DESC" };
        let select = format!(
            "{} WHERE (?1 IS NULL OR id < ?1) AND (?2 IS NULL OR id > ?2)
            AND (?3 IS NULL OR machine = ?3) AND (?4 IS NULL OR method = ?4)
            AND (?5 IS NULL OR run_state = ?5) AND (?6 IS NULL OR verdict = ?6) ORDER BY id {order} LIMIT ?7",
            read::SELECT_RUN_SUMMARY
        );
        let [before, after] = [before, after].map(|run| run.map(|run| run.0));
        let limit = i64::try_from(limit).unwrap_or(i64::MAX);
        let verdict = verdict.map(|verdict| verdict.to_string());
        let filter = params![before, after, machine, method, state.map(RunState::as_str), verdict, limit];
        let mut runs = self.query(|connection| select_rows(connection, &select, filter, read::run_summary_from_row))?;
        if is_ascending {
            runs.reverse();
        }
        Ok(runs)
    }

    /// Number of all readings of a run (each sample of a scan is one), and at most `limit` of them after the first
    /// `skipped_count`.
    ///
    /// # Errors
    /// The run does not exist, or the journal cannot be read.
    pub fn count_and_list_readings(
        &self,
        run: RunId,
        skipped_count: usize,
        limit: usize,
    ) -> Result<(usize, Vec<Reading>), StoreError> {
        let end = skipped_count.saturating_add(limit);
        self.query(|connection| {
            let snapshot = connection.transaction()?;
            let there = snapshot.query_row("SELECT 1 FROM runs WHERE id = ?1", [run.0], |_| Ok(()));
            there.optional()?.ok_or(StoreFault::RunNotFound(run))?;
            // A scan is one row with many readings: the readings of each row are counted, then only the requested rows
            // are read.
            let count = "SELECT seq, coalesce(json_array_length(samples), 1) FROM readings";
            let counts: Vec<(i64, u32)> =
                select_rows_of_run(&snapshot, count, run, |row| Ok((row.get(0)?, row.get(1)?)))?;
            let mut one = snapshot.prepare(&format!("{} WHERE run = ?1 AND seq = ?2", read::SELECT_READINGS))?;
            let (mut all, mut some) = (0, Vec::new());
            for (seq, count) in counts.into_iter().map(|(seq, count)| (seq, count as usize)) {
                if all < end && all + count > skipped_count {
                    let row = one.query_row(params![run.0, seq], read::readings_from_row)?;
                    let skipped_in_row = skipped_count.saturating_sub(all);
                    some.extend(row.into_iter().skip(skipped_in_row).take(end - all.max(skipped_count)));
                }
                all += count;
            }
            Ok((all, some))
        })
    }

    /// The newest runs of `machine` that were measured to their end, as of one instant.
    ///
    /// # Errors
    /// The journal cannot be read.
    pub fn newest_measured_runs(&self, machine: &str) -> Result<NewestMeasuredRuns, StoreError> {
        self.query(|connection| {
            let snapshot = connection.transaction()?;
            let result = newest_result(&snapshot, machine)?;
            let newer = select_measured_runs_without_estimate(&snapshot, machine, result.as_ref().map(|it| it.run))?;
            Ok(NewestMeasuredRuns { newest_result: result, newer_run_without_estimate: newer.last().copied() })
        })
    }

    /// All runs of `machine` that were measured to their end and have no estimate, oldest first.
    ///
    /// # Errors
    /// The journal cannot be read.
    pub fn measured_runs_without_estimate(&self, machine: &str) -> Result<Vec<RunId>, StoreError> {
        self.query(|connection| select_measured_runs_without_estimate(connection, machine, None))
    }
}

fn newest_result(connection: &Connection, machine: &str) -> Result<Option<FinishedRunResult>, StoreFault> {
    let newest: Option<i64> = connection.query_row(
        "SELECT max(id) FROM runs WHERE machine = ?1 AND state = ?2
         AND EXISTS (SELECT 1 FROM estimates WHERE run = runs.id)",
        params![machine, RunState::Finished.as_str()],
        |row| row.get(0),
    )?;
    let Some(newest) = newest else { return Ok(None) };
    checksum::verify_estimates(connection, &[newest])?;
    let row = connection.query_row(read::SELECT_FINISHED_RUN_RESULT, [newest], read::finished_run_result_from_row);
    Ok(Some(row?))
}

/// Runs of `machine` that were measured to their end and have no estimate, oldest first; only those after
/// `newer_than`.
fn select_measured_runs_without_estimate(
    connection: &Connection,
    machine: &str,
    newer_than: Option<RunId>,
) -> Result<Vec<RunId>, StoreFault> {
    let select = "SELECT id FROM runs WHERE id > ?1 AND machine = ?2 AND state = ?3
         AND NOT EXISTS (SELECT 1 FROM estimates WHERE run = runs.id) ORDER BY id";
    let of = params![newer_than.map_or(0, |run| run.0), machine, RunState::Finished.as_str()];
    select_rows(connection, select, of, |row| row.get(0).map(RunId))
}
