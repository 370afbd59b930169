//! Checksum of each row: CRC-32C over the row's other columns, in their order. Each value contributes its type
//! as one byte (0 NULL, 1 integer, 2 real, 3 text, 4 blob), followed by the eight bytes of an integer or a real
//! (IEEE 754), little-endian, or by the length in eight bytes and the bytes of a text or a blob.
//!
//! SQL triggers of the writing connection compute it from the stored row, for each row that is inserted or
//! changed. The triggers are temporary: other programs can read and write the file, but rows that they change
//! have a wrong checksum.

use crc::{CRC_32_ISCSI, Crc, Table};
use rusqlite::functions::{Context, FunctionFlags};
use rusqlite::types::ValueRef;
use rusqlite::{Connection, Row};

use super::columns::select_rows;
use super::{RunId, StoreFault};

static CRC_32C: Crc<u32, Table<16>> = Crc::<u32, Table<16>>::new(&CRC_32_ISCSI);

/// Tables with the plan, the readings and the results of runs, which are verified with their run; their column `run`
/// contains its number. The heads of runs and the tables of the service are not among them.
const RUN_DATA_TABLES: [&str; 6] = ["steps", "stages", "readings", "events", "estimates", "signatures"];

/// A table whose rows have a checksum.
struct ChecksummedTable {
    name: String,
    /// Names of all columns except `checksum`, in their order, separated by commas.
    checksummed_columns: String,
}

impl ChecksummedTable {
    /// SQL expression that computes the checksum of a row of this table.
    fn checksum_sql(&self) -> String {
        format!("row_checksum({})", self.checksummed_columns)
    }
}

/// Adds the SQL function `row_checksum` to `connection`.
pub(super) fn add_checksum_function(connection: &Connection) -> Result<(), StoreFault> {
    let flags = FunctionFlags::SQLITE_UTF8 | FunctionFlags::SQLITE_DETERMINISTIC;
    Ok(connection.create_scalar_function("row_checksum", -1, flags, |row| Ok(row_crc(row)))?)
}

/// CRC-32C of the values, most significant byte first.
fn row_crc(values: &Context<'_>) -> [u8; 4] {
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

/// Adds triggers to `connection` that set the checksum of each row that this connection inserts or changes.
pub(super) fn add_checksum_triggers(connection: &Connection) -> Result<(), StoreFault> {
    // Without this setting, temporary triggers would need a file of their own.
    connection.pragma_update(None, "temp_store", "MEMORY")?;
    for table in checksummed_tables(connection)? {
        let ChecksummedTable { name, checksummed_columns: columns } = &table;
        let set = format!("UPDATE {name} SET checksum = {} WHERE rowid = new.rowid; END;", table.checksum_sql());
        connection.execute_batch(&format!(
            "CREATE TEMP TRIGGER {name}_inserted AFTER INSERT ON main.{name} BEGIN {set}
             CREATE TEMP TRIGGER {name}_changed AFTER UPDATE OF {columns} ON main.{name} BEGIN {set}"
        ))?;
    }
    Ok(())
}

/// Computes and stores the checksum of every row anew, without verifying the old one; for a migration.
pub(super) fn compute_all_checksums(connection: &Connection) -> Result<(), StoreFault> {
    for table in checksummed_tables(connection)? {
        let set = format!("UPDATE {} SET checksum = {}", table.name, table.checksum_sql());
        connection.execute(&set, [])?;
    }
    Ok(())
}

/// Verifies all rows of the journal.
pub(super) fn verify_all_rows(connection: &Connection) -> Result<(), StoreFault> {
    verify_rows(connection, |_| Some("true".to_owned()))
}

/// Verifies the heads of runs and the tables that no run owns: audit log, armings, slots, schedules, compensations
/// and their states.
pub(super) fn verify_run_heads_and_service_tables(connection: &Connection) -> Result<(), StoreFault> {
    verify_rows(connection, |table| (!RUN_DATA_TABLES.contains(&table)).then(|| "true".to_owned()))
}

/// Verifies the head of `run` and its rows in `RUN_DATA_TABLES`.
pub(super) fn verify_run(connection: &Connection, run: RunId) -> Result<(), StoreFault> {
    verify_rows(connection, |table| match table {
        "runs" => Some(format!("id = {run}")),
        table => RUN_DATA_TABLES.contains(&table).then(|| format!("run = {run}")),
    })
}

/// Verifies the estimates of `runs`.
pub(super) fn verify_estimates(connection: &Connection, runs: &[i64]) -> Result<(), StoreFault> {
    let runs = runs.iter().map(i64::to_string).collect::<Vec<_>>().join(", ");
    verify_rows(connection, |table| (table == "estimates").then(|| format!("run IN ({runs})")))
}

/// Verifies rows. `row_condition` returns the SQL condition of the rows of a table, or `None` for no row.
fn verify_rows(connection: &Connection, row_condition: impl Fn(&str) -> Option<String>) -> Result<(), StoreFault> {
    for table in checksummed_tables(connection)? {
        let Some(rows) = row_condition(&table.name) else { continue };
        let mut damaged = connection.prepare(&format!(
            "SELECT rowid FROM {} WHERE {rows} AND checksum IS NOT {} LIMIT 1",
            table.name,
            table.checksum_sql()
        ))?;
        if let Some(row) = damaged.query([])?.next()? {
            let row: i64 = row.get(0)?;
            let what = format!("row {row} of table {} has a wrong checksum", table.name);
            return Err(StoreFault::Damaged(what));
        }
    }
    Ok(())
}

/// All tables with a column `checksum`.
fn checksummed_tables(connection: &Connection) -> Result<Vec<ChecksummedTable>, StoreFault> {
    let select = "SELECT tables.name,
                group_concat(columns.name, ', ' ORDER BY cid) FILTER (WHERE columns.name <> 'checksum')
         FROM main.sqlite_schema AS tables JOIN pragma_table_info(tables.name, 'main') AS columns
         WHERE tables.type = 'table' GROUP BY tables.name HAVING max(columns.name = 'checksum')";
    let read = |row: &Row<'_>| Ok(ChecksummedTable { name: row.get(0)?, checksummed_columns: row.get(1)? });
    select_rows(connection, select, [], read)
}
