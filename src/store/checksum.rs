//! The checksum of each row: CRC-32C over the row's other columns, in their order. Of a value: its type as one byte
//! (0 NULL, 1 integer, 2 real, 3 text, 4 blob), then eight bytes of an integer or a real (IEEE 754), little-endian,
//! or the length in eight bytes and the bytes of a text or a blob.
//!
//! SQL triggers of the writing connection compute it, from the row as it is stored, for each row that is inserted
//! or changed. The triggers are temporary: other programs can read and write the file, and what they change has a
//! wrong checksum.

use crc::{CRC_32_ISCSI, Crc, Table};
use rusqlite::Connection;
use rusqlite::functions::{Context, FunctionFlags};
use rusqlite::types::ValueRef;

use super::{Fault, RunId};

static CRC_32C: Crc<u32, Table<16>> = Crc::<u32, Table<16>>::new(&CRC_32_ISCSI);

/// Tables of what is planned, measured and found in a run: large. Their column `run` names the run.
const OF_A_RUN: [&str; 6] = ["steps", "stages", "readings", "events", "estimates", "signatures"];

/// A table whose rows have a checksum.
struct SealedTable {
    name: String,
    /// The names of its other columns, in their order, separated by commas.
    columns: String,
}

impl SealedTable {
    fn expected(&self) -> String {
        format!("row_checksum({})", self.columns)
    }
}

/// Makes the SQL function `row_checksum` known to `connection`.
pub(super) fn add_function(connection: &Connection) -> Result<(), Fault> {
    let flags = FunctionFlags::SQLITE_UTF8 | FunctionFlags::SQLITE_DETERMINISTIC;
    Ok(connection.create_scalar_function("row_checksum", -1, flags, |row| Ok(of_values(row)))?)
}

fn of_values(values: &Context<'_>) -> [u8; 4] {
    let mut digest = CRC_32C.digest();
    let mut add = |kind: u8, parts: [&[u8]; 2]| {
        digest.update(&[kind]);
        parts.into_iter().for_each(|part| digest.update(part));
    };
    for index in 0..values.len() {
        match values.get_raw(index) {
            ValueRef::Null => add(0, [&[], &[]]),
            ValueRef::Integer(value) => add(1, [&value.to_le_bytes(), &[]]),
            ValueRef::Real(value) => add(2, [&value.to_le_bytes(), &[]]),
            ValueRef::Text(text) => add(3, [&(text.len() as u64).to_le_bytes(), text]),
            ValueRef::Blob(blob) => add(4, [&(blob.len() as u64).to_le_bytes(), blob]),
        }
    }
    digest.finalize().to_be_bytes()
}

/// From here on `connection` gives each row that it inserts or changes its checksum.
pub(super) fn add_triggers(connection: &Connection) -> Result<(), Fault> {
    // They need no file of their own.
    connection.pragma_update(None, "temp_store", "MEMORY")?;
    for table in sealed_tables(connection)? {
        let SealedTable { name, columns } = &table;
        let set = format!(
            "UPDATE {name} SET checksum = {} WHERE rowid = new.rowid; END;",
            table.expected()
        );
        connection.execute_batch(&format!(
            "CREATE TEMP TRIGGER {name}_inserted AFTER INSERT ON main.{name} BEGIN {set}
             CREATE TEMP TRIGGER {name}_changed AFTER UPDATE OF {columns} ON main.{name} BEGIN {set}"
        ))?;
    }
    Ok(())
}

/// Gives every row its checksum, whatever it holds.
pub(super) fn compute_all(connection: &Connection) -> Result<(), Fault> {
    for table in sealed_tables(connection)? {
        let set = format!("UPDATE {} SET checksum = {}", table.name, table.expected());
        connection.execute(&set, [])?;
    }
    Ok(())
}

/// All rows of the journal.
pub(super) fn verify_all(connection: &Connection) -> Result<(), Fault> {
    verify(connection, |_| Some("true".to_owned()))
}

/// The heads of runs, and what belongs to no run: the audit log, armings and schedules.
pub(super) fn verify_heads(connection: &Connection) -> Result<(), Fault> {
    verify(connection, |table| (!OF_A_RUN.contains(&table)).then(|| "true".to_owned()))
}

/// All rows of `run`.
pub(super) fn verify_run(connection: &Connection, run: RunId) -> Result<(), Fault> {
    verify(connection, |table| match table {
        "runs" => Some(format!("id = {run}")),
        table => OF_A_RUN.contains(&table).then(|| format!("run = {run}")),
    })
}

/// The estimates of `runs`.
pub(super) fn verify_estimates(connection: &Connection, runs: &[i64]) -> Result<(), Fault> {
    let runs = runs.iter().map(i64::to_string).collect::<Vec<_>>().join(", ");
    verify(connection, |table| (table == "estimates").then(|| format!("run IN ({runs})")))
}

/// `rows`: for the name of a table the SQL condition of the rows to verify, `None` for no row of it.
fn verify(connection: &Connection, rows: impl Fn(&str) -> Option<String>) -> Result<(), Fault> {
    for table in sealed_tables(connection)? {
        let Some(rows) = rows(&table.name) else { continue };
        let mut damaged = connection.prepare(&format!(
            "SELECT rowid FROM {} WHERE {rows} AND checksum IS NOT {} LIMIT 1",
            table.name,
            table.expected()
        ))?;
        if let Some(row) = damaged.query([])?.next()? {
            let row: i64 = row.get(0)?;
            let what = format!("row {row} of table {} has a wrong checksum", table.name);
            return Err(Fault::Damaged(what));
        }
    }
    Ok(())
}

fn sealed_tables(connection: &Connection) -> Result<Vec<SealedTable>, Fault> {
    let mut statement = connection.prepare(
        "SELECT tables.name,
                group_concat(columns.name, ', ' ORDER BY cid) FILTER (WHERE columns.name <> 'checksum')
         FROM main.sqlite_schema AS tables JOIN pragma_table_info(tables.name, 'main') AS columns
         WHERE tables.type = 'table' GROUP BY tables.name HAVING max(columns.name = 'checksum')",
    )?;
    let tables = statement
        .query_map([], |row| Ok(SealedTable { name: row.get(0)?, columns: row.get(1)? }))?;
    Ok(tables.collect::<Result<_, _>>()?)
}
