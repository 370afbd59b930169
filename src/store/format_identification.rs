//! Whether a file is a journal of this program, and in which format.

use std::collections::BTreeSet;

use rusqlite::Connection;

use super::{StoreFault, schema};

/// `PRAGMA application_id` of a journal, in the header of its file: "trud" in ASCII.
const APPLICATION_ID: i32 = i32::from_be_bytes(*b"trud");
/// First format with the application ID. Older journals are recognised by their tables.
pub(super) const FIRST_FORMAT_WITH_APPLICATION_ID: i64 = 8;

/// Format of the journal that is open in `connection`, 0 for an empty file. Does not write.
///
/// # Errors
/// [`StoreFault::NotAJournal`], [`StoreFault::NewerFormat`], or [`StoreFault::Damaged`] if a journal lacks a table or
/// a column.
pub(super) fn identify_format(connection: &Connection) -> Result<i64, StoreFault> {
    // One transaction, as another process may be creating the tables.
    let snapshot = connection.unchecked_transaction()?;
    let mark: i32 = snapshot.pragma_query_value(None, "application_id", |row| row.get(0))?;
    let format = schema::format_version(&snapshot)?;
    let found = schema_lines(&snapshot)?;
    match (mark, format) {
        (0, 0) if found.is_empty() => return Ok(0),
        (APPLICATION_ID, format) if format > schema::CURRENT_FORMAT => {
            return Err(StoreFault::NewerFormat { found: format, known: schema::CURRENT_FORMAT });
        }
        (APPLICATION_ID, FIRST_FORMAT_WITH_APPLICATION_ID..) | (0, 1..FIRST_FORMAT_WITH_APPLICATION_ID) => {}
        (APPLICATION_ID, _) => {
            return Err(StoreFault::Damaged(format!("the format number {format} is invalid")));
        }
        _ => return Err(StoreFault::NotAJournal { mark, format }),
    }
    let expected = schema_lines(&schema::empty_journal_in_memory(format)?)?;
    match expected.difference(&found).next() {
        None => Ok(format),
        Some(missing) if mark == APPLICATION_ID => Err(StoreFault::Damaged(format!("missing: {missing}"))),
        Some(_) => Err(StoreFault::NotAJournal { mark, format }),
    }
}

/// Marks the file as a journal of format `format`.
pub(super) fn write_application_id_and_format(connection: &Connection, format: i64) -> Result<(), StoreFault> {
    connection.pragma_update(None, "application_id", APPLICATION_ID)?;
    Ok(connection.pragma_update(None, "user_version", format)?)
}

/// Tables with their columns, indices and triggers, each as one line.
fn schema_lines(connection: &Connection) -> Result<BTreeSet<String>, StoreFault> {
    let mut statement = connection.prepare(
        "SELECT parts.type || ' ' || parts.name
                || coalesce(', column ' || columns.name || ' ' || columns.type, '')
         FROM main.sqlite_schema AS parts
         LEFT JOIN pragma_table_info(parts.name, 'main') AS columns ON parts.type = 'table'",
    )?;
    let lines = statement.query_map([], |row| row.get(0))?;
    Ok(lines.collect::<Result<_, _>>()?)
}
