//! Whether a file is a journal of this program, and in which format.

use std::collections::BTreeSet;

use rusqlite::Connection;

use super::{Fault, schema};

/// `PRAGMA application_id` of a journal, in the header of its file: "trud" in ASCII.
const APPLICATION_ID: i32 = i32::from_be_bytes(*b"trud");
/// First format with the application ID. Older journals are recognised by their tables.
pub(super) const FIRST_MARKED: i64 = 8;

/// Format of the journal that is open in `connection`, 0 for an empty file. Only reads.
///
/// # Errors
/// [`Fault::Foreign`], [`Fault::Newer`], or [`Fault::Damaged`] if a journal lacks a table or a column.
pub(super) fn identify(connection: &Connection) -> Result<i64, Fault> {
    // One transaction, as another process may be creating the tables.
    let snapshot = connection.unchecked_transaction()?;
    let mark: i32 = snapshot.pragma_query_value(None, "application_id", |row| row.get(0))?;
    let format = schema::version(&snapshot)?;
    let found = tables(&snapshot)?;
    match (mark, format) {
        (0, 0) if found.is_empty() => return Ok(0),
        (APPLICATION_ID, format) if format > schema::KNOWN => {
            return Err(Fault::Newer { found: format, known: schema::KNOWN });
        }
        (APPLICATION_ID, FIRST_MARKED..) | (0, 1..FIRST_MARKED) => {}
        (APPLICATION_ID, _) => return Err(Fault::Damaged(format!("it has format {format}"))),
        _ => return Err(Fault::Foreign { mark, format }),
    }
    let expected = tables(&schema::example(format)?)?;
    match expected.difference(&found).next() {
        None => Ok(format),
        Some(missing) if mark == APPLICATION_ID => {
            Err(Fault::Damaged(format!("there is no {missing}")))
        }
        Some(_) => Err(Fault::Foreign { mark, format }),
    }
}

/// Marks the file as a journal of format `format`.
pub(super) fn mark(connection: &Connection, format: i64) -> Result<(), Fault> {
    connection.pragma_update(None, "application_id", APPLICATION_ID)?;
    Ok(connection.pragma_update(None, "user_version", format)?)
}

/// Tables with their columns, indices and triggers, each as one line.
fn tables(connection: &Connection) -> Result<BTreeSet<String>, Fault> {
    let mut statement = connection.prepare(
        "SELECT parts.type || ' ' || parts.name
                || coalesce(', column ' || columns.name || ' ' || columns.type, '')
         FROM main.sqlite_schema AS parts
         LEFT JOIN pragma_table_info(parts.name, 'main') AS columns ON parts.type = 'table'",
    )?;
    let lines = statement.query_map([], |row| row.get(0))?;
    Ok(lines.collect::<Result<_, _>>()?)
}
