//! Who asked the service for what, and what came of it.

use jiff::Timestamp;
use rusqlite::{Connection, params};
use serde::Serialize;

use super::{Fault, Journal, Pending, StoreError, read, write};

/// A call that changes something.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Audit {
    pub who: String,
    pub what: String,
    pub why: String,
    pub machine: String,
    /// The run that was on, 0 for none.
    pub run: i64,
    pub outcome: String,
}

impl Journal {
    /// Add it for good.
    pub fn audit(&self, audit: &Audit) -> Pending<()> {
        let audit = audit.clone();
        self.submit(move |connection| add(connection, &audit))
    }

    /// All of them, oldest first.
    ///
    /// # Errors
    /// The journal cannot be read.
    pub fn audits(&self) -> Result<Vec<(Timestamp, Audit)>, StoreError> {
        self.look(|connection| all(connection))
    }
}

pub(super) fn add(connection: &Connection, audit: &Audit) -> Result<(), Fault> {
    let Audit { who, what, why, machine, run, outcome } = audit;
    connection.execute(
        "INSERT INTO audit (at, who, what, why, machine, run, outcome)
         VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7)",
        params![write::now(), who, what, why, machine, run, outcome],
    )?;
    Ok(())
}

fn all(connection: &Connection) -> Result<Vec<(Timestamp, Audit)>, Fault> {
    let mut statement = connection
        .prepare("SELECT at, who, what, why, machine, run, outcome FROM audit ORDER BY seq")?;
    let rows = statement.query_map([], |row| {
        let audit = Audit {
            who: row.get(1)?,
            what: row.get(2)?,
            why: row.get(3)?,
            machine: row.get(4)?,
            run: row.get(5)?,
            outcome: row.get(6)?,
        };
        Ok((read::parsed(row, 0)?, audit))
    })?;
    Ok(rows.collect::<Result<_, _>>()?)
}
