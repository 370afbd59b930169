//! Audit log: requests to the service and their outcomes.

use jiff::Timestamp;
use rusqlite::{Connection, Row, params};
use serde::Serialize;

use super::{AwaitableWrite, Journal, StoreError, StoreFault, columns};

/// A request that changes something, or an arming or disarming by a person or by the service.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AuditEntry {
    /// Name of the access token, name that the person typed, or both; `trued` for the service.
    pub who: String,
    /// The action in words, such as `signature under run 7`.
    pub what: String,
    /// Reason that was stated; may be empty.
    pub why: String,
    pub machine: String,
    /// Number of the run in progress or of the signed run, 0 for none.
    pub run: i64,
    /// `accepted` or `refused: ` with the reason, also with a count of further holds; `done` for an arming or
    /// disarming.
    pub outcome: String,
}

/// An entry of the audit log; a larger `seq` is a later entry, of any machine.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct StoredAuditEntry {
    pub seq: i64,
    /// Time at which the entry was made.
    pub at: Timestamp,
    #[serde(flatten)]
    pub entry: AuditEntry,
}

impl Journal {
    /// Adds an entry that is never changed or removed.
    pub fn add_audit_entry(&self, audit: &AuditEntry) -> AwaitableWrite<()> {
        let audit = audit.clone();
        self.submit_job(move |connection| insert_audit_entry(connection, &audit))
    }

    /// At most `limit` entries, newest first; with `before_seq`, only entries older than that one. Only these rows
    /// are read, as the log covers years.
    ///
    /// # Errors
    /// The journal cannot be read.
    pub fn audit_entries(&self, before_seq: Option<i64>, limit: usize) -> Result<Vec<StoredAuditEntry>, StoreError> {
        let select = "SELECT at, who, what, why, machine, run, outcome, seq FROM audit
         WHERE seq < ?1 ORDER BY seq DESC LIMIT ?2";
        let limit = i64::try_from(limit).unwrap_or(i64::MAX);
        let parameters = params![before_seq.unwrap_or(i64::MAX), limit];
        self.query(|connection| columns::select_rows(connection, select, parameters, audit_entry_from_row))
    }
}

pub(super) fn insert_audit_entry(connection: &Connection, audit: &AuditEntry) -> Result<(), StoreFault> {
    let AuditEntry { who, what, why, machine, run, outcome } = audit;
    connection.execute(
        "INSERT INTO audit (at, who, what, why, machine, run, outcome)
         VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7)",
        params![columns::now_text(), who, what, why, machine, run, outcome],
    )?;
    Ok(())
}

fn audit_entry_from_row(row: &Row<'_>) -> rusqlite::Result<StoredAuditEntry> {
    let entry = AuditEntry {
        who: row.get(1)?,
        what: row.get(2)?,
        why: row.get(3)?,
        machine: row.get(4)?,
        run: row.get(5)?,
        outcome: row.get(6)?,
    };
    Ok(StoredAuditEntry { seq: row.get(7)?, at: columns::parse_text_column(row, 0)?, entry })
}
