//! Files of a stored run, as `trued export` writes them and as the HTTP interface returns them.

use std::io;

use crate::report::{readings_csv, results_csv};
use crate::store::{RunId, StoredRun};

/// Name of the file with the readings of a run.
pub fn readings_file_name(run: RunId) -> String {
    format!("run-{run}-readings.csv")
}

/// Name of the file with the last estimate of a run.
pub fn estimate_file_name(run: RunId) -> String {
    format!("run-{run}-estimate.json")
}

/// All readings of the run as CSV.
///
/// # Errors
/// A number is not finite (`InvalidData`).
pub fn readings_file(stored: &StoredRun) -> io::Result<Vec<u8>> {
    let mut csv = Vec::new();
    let comments = [format!("run {}: {} on {}", stored.summary.id, stored.plan.method, stored.plan.machine.name)];
    readings_csv::write_readings(&stored.readings, &comments, &mut csv)?;
    Ok(csv)
}

/// The last estimate of the run as formatted JSON; `None`: the run has no estimate.
///
/// # Errors
/// The estimate cannot be written as JSON.
pub fn estimate_file(stored: &StoredRun) -> serde_json::Result<Option<String>> {
    stored.estimates.last().map(|last| serde_json::to_string_pretty(&last.estimate)).transpose()
}

/// Name of the file with the results of a run.
pub fn results_file_name(run: RunId) -> String {
    format!("run-{run}-results.csv")
}

/// The results of the last estimate as CSV; `None`: the run has no estimate.
///
/// # Errors
/// The table cannot be written.
pub fn results_file(stored: &StoredRun) -> io::Result<Option<Vec<u8>>> {
    let Some(last) = stored.estimates.last() else { return Ok(None) };
    let mut table = Vec::new();
    results_csv::write_results(&last.estimate, &mut table)?;
    Ok(Some(table))
}
