//! Signatures of results by name, bound to the estimate that was shown, and never changed.

use jiff::Timestamp;
use rusqlite::{Connection, params};
use serde::Serialize;

use super::{Fault, RunId, columns};

#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Signature {
    pub who: String,
    pub remark: String,
    /// Hash of the signed estimate, see [`super::sha256`].
    pub estimate_sha256: String,
}

pub(super) fn add(
    connection: &mut Connection,
    run: RunId,
    signature: &Signature,
) -> Result<(), Fault> {
    let Signature { who, remark, estimate_sha256 } = signature;
    connection
        .execute(
            "INSERT INTO signatures (run, at, who, remark, estimate_sha256)
             VALUES (?1, ?2, ?3, ?4, ?5)",
            params![run.0, columns::now(), who, remark, estimate_sha256],
        )
        .map_err(Fault::of_run(run))?;
    Ok(())
}

/// Signatures of `run`, oldest first.
pub(super) fn of_run(
    connection: &Connection,
    run: RunId,
) -> Result<Vec<(Timestamp, Signature)>, Fault> {
    let select = "SELECT at, who, remark, estimate_sha256 FROM signatures";
    columns::rows(connection, select, run, |row| {
        let (who, remark, estimate_sha256) = (row.get(1)?, row.get(2)?, row.get(3)?);
        Ok((columns::parsed(row, 0)?, Signature { who, remark, estimate_sha256 }))
    })
}
