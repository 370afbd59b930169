//! Audit log: requests to the service and their outcomes.

use jiff::Timestamp;
use rusqlite::{Connection, params};
use serde::Serialize;

use super::{Fault, Journal, Pending, StoreError, columns};

/// A request that changes something.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Audit {
    pub who: String,
    pub what: String,
    pub why: String,
    pub machine: String,
    /// Number of the run in progress, 0 for none.
    pub run: i64,
    pub outcome: String,
}

/// An entry of the audit log; `seq` counts up.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Audited {
    pub seq: i64,
    pub at: Timestamp,
    #[serde(flatten)]
    pub audit: Audit,
}

impl Journal {
    /// Adds an entry that is never changed or removed.
    pub fn audit(&self, audit: &Audit) -> Pending<()> {
        let audit = audit.clone();
        self.submit(move |connection| add(connection, &audit))
    }

    /// At most `most` entries, newest first; with `before`, only entries older than that one. Only these rows
    /// are read, as the log covers years.
    ///
    /// # Errors
    /// The journal cannot be read.
    pub fn audits(&self, before: Option<i64>, most: usize) -> Result<Vec<Audited>, StoreError> {
        self.look(|connection| newest(connection, before, most))
    }
}

pub(super) fn add(connection: &Connection, audit: &Audit) -> Result<(), Fault> {
    let Audit { who, what, why, machine, run, outcome } = audit;
    connection.execute(
        "INSERT INTO audit (at, who, what, why, machine, run, outcome)
         VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7)",
        params![columns::now(), who, what, why, machine, run, outcome],
    )?;
    Ok(())
}

fn newest(
    connection: &Connection,
    before: Option<i64>,
    most: usize,
) -> Result<Vec<Audited>, Fault> {
    let mut statement = connection.prepare(
        "SELECT at, who, what, why, machine, run, outcome, seq FROM audit
         WHERE seq < ?1 ORDER BY seq DESC LIMIT ?2",
    )?;
    let most = i64::try_from(most).unwrap_or(i64::MAX);
    let rows = statement.query_map(params![before.unwrap_or(i64::MAX), most], |row| {
        let audit = Audit {
            who: row.get(1)?,
            what: row.get(2)?,
            why: row.get(3)?,
            machine: row.get(4)?,
            run: row.get(5)?,
            outcome: row.get(6)?,
        };
        Ok(Audited { seq: row.get(7)?, at: columns::parsed(row, 0)?, audit })
    })?;
    Ok(rows.collect::<Result<_, _>>()?)
}
