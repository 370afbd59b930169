//! Reads the journal.

use rusqlite::{Connection, OptionalExtension, Row, params};
use serde::Deserialize;

use super::columns::{
    damaged_column_error, parse_json_column, parse_name_column, parse_text_column, select_rows, select_rows_of_run,
};
use super::{
    EstimateSelection, FinishedRunResult, Journal, RunId, RunProgress, RunState, RunSummary, StoreError, StoreFault,
    StoredEstimate, StoredRun,
};
use super::{checksum, scan, signature};
use machine::Axis;
use machine::record::estimate::{Parameter, Provenance, Verdict};
use machine::record::event::RunEvent;
use machine::record::plan::Plan;
use machine::record::reading::Reading;

/// Index in `SELECT_READINGS` of the column with a scan's samples.
const SAMPLES_COLUMN_INDEX: usize = 14;
/// Columns for `run_summary_from_row`, of all runs; column 9 is the text of the machine file.
pub(super) const SELECT_RUN_SUMMARY: &str = "SELECT id, started, ended, method, machine,
                              CASE WHEN state = 'finished' AND NOT EXISTS
                                       (SELECT 1 FROM estimates WHERE run = runs.id)
                                   THEN 'not identified' ELSE state END AS run_state,
                              program_version,
                              config_sha256, plan_sha256, config,
                              (SELECT who FROM signatures
                               WHERE run = runs.id AND estimate_sha256 =
                                   (SELECT sha256 FROM estimates WHERE run = runs.id
                                    ORDER BY seq DESC LIMIT 1)
                               ORDER BY seq DESC LIMIT 1),
                              (SELECT json_extract(estimate, '$.verdict') FROM estimates
                               WHERE run = runs.id ORDER BY seq DESC LIMIT 1) AS verdict,
                              CASE WHEN state IN ('held', 'failed', 'closed') THEN
                                  (SELECT coalesce(json_extract(event, '$.what'), json_extract(event, '$.reason'))
                                   FROM events
                                   WHERE run = runs.id AND json_extract(event, '$.event') IN ('held', 'faulted')
                                   ORDER BY seq DESC LIMIT 1) END
                              FROM runs";

/// Last estimate of the readings of one run alone, without combinations of runs.
const SELECT_OWN_RESULT: &str =
    "SELECT runs.id, started, method, estimate, coalesce(temperatures_c, '{}'), coalesce(ended, started)
            FROM runs JOIN estimates ON run = runs.id
            WHERE runs.id = ?1 AND json_extract(estimate, '$.provenance.combined_runs') IS NULL
            ORDER BY estimates.seq DESC LIMIT 1";

/// Last estimate of one run, for [`finished_run_result_from_row`].
pub(super) const SELECT_FINISHED_RUN_RESULT: &str =
    "SELECT runs.id, started, method, estimate, coalesce(temperatures_c, '{}'), coalesce(ended, started)
            FROM runs JOIN estimates ON run = runs.id
            WHERE runs.id = ?1 ORDER BY estimates.seq DESC LIMIT 1";

/// Columns for `readings_from_row`.
pub(super) const SELECT_READINGS: &str = "SELECT step, repeat, value_mm, sensor, t_s, flag, temperatures_c,
            x_mm, y_mm, z_mm, a_rad, b_rad, c_rad, s_rad, samples FROM readings";

impl Journal {
    /// All runs, oldest first.
    pub fn runs(&self) -> Result<Vec<RunSummary>, StoreError> {
        self.query(|connection| select_all_runs(connection))
    }

    /// The newest run of `method` on `machine` that is finished and has an estimate.
    pub fn newest_run_with_estimate(&self, machine: &str, method: &str) -> Result<Option<RunId>, StoreError> {
        let select = "SELECT max(id) FROM runs WHERE machine = ?1 AND method = ?2 AND state = ?3
                AND EXISTS (SELECT 1 FROM estimates WHERE run = runs.id)";
        let of = params![machine, method, RunState::Finished.as_str()];
        let id: Option<i64> = self.query(|connection| Ok(connection.query_row(select, of, |row| row.get(0))?))?;
        Ok(id.map(RunId))
    }

    /// Calls `visit` with the selected estimate of each of the newest `runs_per_method` finished runs with an
    /// estimate of each method on `machine`, in the order of their numbers, oldest first. Only one estimate is in
    /// memory at a time, as the journal covers years.
    ///
    /// # Errors
    /// The journal cannot be read, or a run has combined estimates only and `selection` is `LastOwn`.
    pub fn visit_finished_run_results(
        &self,
        machine: &str,
        runs_per_method: u32,
        selection: EstimateSelection,
        mut visit: impl FnMut(FinishedRunResult),
    ) -> Result<(), StoreError> {
        let newest_of_each_method =
            "SELECT id FROM (SELECT id, row_number() OVER (PARTITION BY method ORDER BY id DESC) AS age
                         FROM runs WHERE machine = ?1 AND state = ?2
                         AND EXISTS (SELECT 1 FROM estimates WHERE run = runs.id))
         WHERE age <= ?3 ORDER BY id";
        let select_result = match selection {
            EstimateSelection::Last => SELECT_FINISHED_RUN_RESULT,
            EstimateSelection::LastOwn => SELECT_OWN_RESULT,
        };
        let of = params![machine, RunState::Finished.as_str(), runs_per_method];
        self.query(|connection| {
            let ids: Vec<i64> = select_rows(connection, newest_of_each_method, of, |row| row.get(0))?;
            checksum::verify_estimates(connection, &ids)?;
            // One query for each run: a single sorted query would hold all estimates in memory.
            let mut one = connection.prepare(select_result)?;
            for id in ids {
                visit(one.query_row([id], finished_run_result_from_row)?);
            }
            Ok(())
        })
    }

    /// All data of one run, as of one instant, with its checksums verified.
    pub fn load_run(&self, run: RunId) -> Result<StoredRun, StoreError> {
        self.query(|connection| load_run(connection, run))
    }

    /// Progress of a run, without its readings except the last; checksums are not verified.
    pub fn load_run_progress(&self, run: RunId) -> Result<RunProgress, StoreError> {
        self.query(|connection| load_progress(connection, run))
    }
}

pub(super) fn select_all_runs(connection: &Connection) -> Result<Vec<RunSummary>, StoreFault> {
    select_rows(connection, &format!("{SELECT_RUN_SUMMARY} ORDER BY id"), [], run_summary_from_row)
}

pub(super) fn finished_run_result_from_row(row: &Row<'_>) -> rusqlite::Result<FinishedRunResult> {
    /// The needed fields of the estimate's JSON.
    #[derive(Deserialize)]
    struct EstimateValues {
        verdict: Verdict,
        parameters: Vec<Parameter>,
        provenance: Option<Provenance>,
    }
    let EstimateValues { verdict, parameters, provenance } = parse_json_column(row, 3)?;
    Ok(FinishedRunResult {
        run: RunId(row.get(0)?),
        started: parse_text_column(row, 1)?,
        ended: parse_text_column(row, 5)?,
        method: row.get(2)?,
        verdict,
        parameters,
        first_to_last_reading_s: provenance.map(|provenance| provenance.duration_s),
        temperatures_c: parse_json_column(row, 4)?,
    })
}

/// All data of one run, verified, in one transaction: another process may be writing to it.
fn load_run(connection: &mut Connection, run: RunId) -> Result<StoredRun, StoreFault> {
    let snapshot = connection.transaction()?;
    checksum::verify_run(&snapshot, run)?;
    let (summary, config) = snapshot
        .query_row(&format!("{SELECT_RUN_SUMMARY} WHERE id = ?1"), [run.0], |row| {
            Ok((run_summary_from_row(row)?, row.get(9)?))
        })
        .optional()?
        .ok_or(StoreFault::RunNotFound(run))?;
    Ok(StoredRun {
        summary,
        machine_file_text: config,
        plan: load_plan(&snapshot, run)?,
        stages: select_rows_of_run(&snapshot, "SELECT stage FROM stages", run, |row| parse_json_column(row, 0))?,
        readings: select_rows_of_run(&snapshot, SELECT_READINGS, run, readings_from_row)?.concat(),
        last_reading_stored_at: snapshot
            .query_row(
                "SELECT kept FROM readings WHERE run = ?1 AND kept IS NOT NULL
                 ORDER BY seq DESC LIMIT 1",
                [run.0],
                |row| parse_text_column(row, 0),
            )
            .optional()?,
        events: select_rows_of_run(&snapshot, "SELECT at, event FROM events", run, |row| {
            Ok((parse_text_column(row, 0)?, parse_json_column(row, 1)?))
        })?,
        estimates: select_rows_of_run(
            &snapshot,
            "SELECT made, estimate, sha256, program_version FROM estimates",
            run,
            estimate_from_row,
        )?,
        signatures: signature::load_run_signatures(&snapshot, run)?,
    })
}

fn load_progress(connection: &mut Connection, run: RunId) -> Result<RunProgress, StoreFault> {
    let snapshot = connection.transaction()?;
    Ok(RunProgress {
        plan: load_plan_without_interruptions(&snapshot, run)?,
        stages: select_rows_of_run(&snapshot, "SELECT stage FROM stages", run, |row| parse_json_column(row, 0))?,
        stored_steps_and_repeats: select_rows_of_run(&snapshot, "SELECT step, repeat FROM readings", run, |row| {
            Ok((row.get(0)?, row.get(1)?))
        })?,
        last_reading: last_reading(&snapshot, run)?,
    })
}

/// The plan so far, with the interruptions so far.
pub(super) fn load_plan(connection: &Connection, run: RunId) -> Result<Plan, StoreFault> {
    Ok(Plan {
        interruption_times_s: interruption_times_s(connection, run)?,
        ..load_plan_without_interruptions(connection, run)?
    })
}

/// The plan with the steps so far; its list of interruptions is that of the start.
fn load_plan_without_interruptions(connection: &Connection, run: RunId) -> Result<Plan, StoreFault> {
    let mut plan: Plan = connection
        .query_row("SELECT plan_head FROM runs WHERE id = ?1", [run.0], |row| parse_json_column(row, 0))
        .optional()?
        .ok_or(StoreFault::RunNotFound(run))?;
    let select_steps = "SELECT step FROM steps WHERE run = ?1 ORDER BY id";
    plan.steps = select_rows(connection, select_steps, [run.0], |row| parse_json_column(row, 0))?;
    Ok(plan)
}

/// Times of the run's interruptions on the readings' clock, each once.
fn interruption_times_s(connection: &Connection, run: RunId) -> Result<Vec<f64>, StoreFault> {
    let events =
        select_rows_of_run(connection, "SELECT event FROM events", run, |row| parse_json_column::<RunEvent>(row, 0))?;
    let mut gaps: Vec<f64> = events
        .into_iter()
        .filter_map(|event| match event {
            RunEvent::Resumed { gap_s } => Some(gap_s),
            _ => None,
        })
        .collect();
    gaps.dedup();
    Ok(gaps)
}

pub(super) fn run_summary_from_row(row: &Row<'_>) -> rusqlite::Result<RunSummary> {
    Ok(RunSummary {
        id: RunId(row.get(0)?),
        started: parse_text_column(row, 1)?,
        ended: row.get::<_, Option<String>>(2)?.map(|_| parse_text_column(row, 2)).transpose()?,
        method: row.get(3)?,
        machine: row.get(4)?,
        state: parse_name_column(row, 5, "state")?,
        program_version: row.get(6)?,
        config_sha256: row.get(7)?,
        plan_sha256: row.get(8)?,
        signed: row.get(10)?,
        verdict: row.get::<_, Option<String>>(11)?.map(|text| parse_verdict(11, text)).transpose()?,
        end_reason: row.get(12)?,
    })
}

/// The reading that was stored last; of a scan its last sample.
fn last_reading(connection: &Connection, run: RunId) -> Result<Option<Reading>, StoreFault> {
    let text = format!("{SELECT_READINGS} WHERE run = ?1 ORDER BY seq DESC LIMIT 1");
    let found = connection.query_row(&text, [run.0], readings_from_row).optional()?;
    Ok(found.and_then(|readings| readings.into_iter().next_back()))
}

fn parse_verdict(column: usize, text: String) -> rusqlite::Result<Verdict> {
    serde_json::from_value(text.into()).map_err(|error| damaged_column_error(column, error.into()))
}

/// The readings of a row: a touch, or all samples of a scan.
pub(super) fn readings_from_row(row: &Row<'_>) -> rusqlite::Result<Vec<Reading>> {
    let (head, samples) = (reading_from_row(row)?, row.get::<_, Option<String>>(SAMPLES_COLUMN_INDEX)?);
    match samples {
        None => Ok(vec![head]),
        Some(text) => {
            scan::parse_samples(&head, &text).map_err(|error| damaged_column_error(SAMPLES_COLUMN_INDEX, error.into()))
        }
    }
}

fn reading_from_row(row: &Row<'_>) -> rusqlite::Result<Reading> {
    let mut reading = Reading {
        step: row.get(0)?,
        repeat: row.get(1)?,
        position: Default::default(),
        value_mm: row.get(2)?,
        sensor: row.get(3)?,
        t_s: row.get(4)?,
        flag: parse_text_column(row, 5)?,
        temperatures_c: parse_json_column(row, 6)?,
    };
    for (column, axis) in (7..).zip(Axis::ALL) {
        if let Some(value) = row.get(column)? {
            reading.position.set(axis, value);
        }
    }
    Ok(reading)
}

fn estimate_from_row(row: &Row<'_>) -> rusqlite::Result<StoredEstimate> {
    Ok(StoredEstimate {
        created: parse_text_column(row, 0)?,
        estimate: parse_json_column(row, 1)?,
        sha256: row.get(2)?,
        program_version: row.get(3)?,
    })
}
