//! Signatures of results by name, bound to the estimate that was shown, and never changed.

use jiff::Timestamp;
use rusqlite::{Connection, params};
use serde::Serialize;

use super::{AwaitableWrite, Journal, RunId, StoreFault, columns};

/// Signature of a person, by name, under an estimate.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct EstimateSignature {
    pub who: String,
    pub remark: String,
    /// Hash of the signed estimate, see [`super::sha256_of_json`].
    pub estimate_sha256: String,
}

impl Journal {
    /// Adds a signature that is never changed or removed.
    pub fn add_signature(&self, run: RunId, signature: &EstimateSignature) -> AwaitableWrite<()> {
        let EstimateSignature { who, remark, estimate_sha256 } = signature.clone();
        self.submit_job(move |connection| {
            let insert = "INSERT INTO signatures (run, at, who, remark, estimate_sha256)
             VALUES (?1, ?2, ?3, ?4, ?5)";
            let values = params![run.0, columns::now_text(), who, remark, estimate_sha256];
            connection.execute(insert, values).map(drop).map_err(StoreFault::from_run_error(run))
        })
    }
}

/// Signatures of `run`, oldest first.
pub(super) fn load_run_signatures(
    connection: &Connection,
    run: RunId,
) -> Result<Vec<(Timestamp, EstimateSignature)>, StoreFault> {
    let select = "SELECT at, who, remark, estimate_sha256 FROM signatures";
    columns::select_rows_of_run(connection, select, run, |row| {
        let (who, remark, estimate_sha256) = (row.get(1)?, row.get(2)?, row.get(3)?);
        Ok((columns::parse_text_column(row, 0)?, EstimateSignature { who, remark, estimate_sha256 }))
    })
}
