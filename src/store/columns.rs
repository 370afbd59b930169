//! Conversion of values to and from the journal's columns: JSON, times, numbers.

use std::str::FromStr;

use jiff::Timestamp;
use rusqlite::types::Type;
use rusqlite::{Connection, Params, Row};
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::{RunId, StoreFault};
use machine::record::reading::Reading;

/// Present time (UTC) as the journal stores it.
pub(super) fn now_text() -> String {
    Timestamp::now().to_string()
}

/// JSON that can be read back. A number that is not finite becomes `null`, which cannot be read as a number.
pub(super) fn to_json_with_finite_numbers<T: Serialize + DeserializeOwned>(
    what: &str,
    value: &T,
) -> Result<String, StoreFault> {
    let not_finite = |_| StoreFault::NotFinite { what: what.to_owned() };
    let text = serde_json::to_string(value).map_err(not_finite)?;
    serde_json::from_str::<T>(&text).map_err(not_finite)?;
    Ok(text)
}

/// Whether position, value and time of `reading` are finite: SQLite would store a NaN as NULL. Temperatures are not
/// checked here.
pub(super) fn has_only_finite_numbers(reading: &Reading) -> bool {
    let numbers = reading.position.iter().map(|(_, value)| value).chain(reading.value_mm);
    numbers.chain([reading.t_s]).all(f64::is_finite)
}

/// All rows that `select` returns, in their order.
pub(super) fn select_rows<T>(
    connection: &Connection,
    select: &str,
    parameters: impl Params,
    read: impl FnMut(&Row<'_>) -> rusqlite::Result<T>,
) -> Result<Vec<T>, StoreFault> {
    let mut statement = connection.prepare(select)?;
    let rows = statement.query_map(parameters, read)?.collect::<Result<Vec<_>, _>>()?;
    Ok(rows)
}

/// Rows of `run` that `select` returns, by their `seq`. `select` has no `WHERE` of its own.
pub(super) fn select_rows_of_run<T>(
    connection: &Connection,
    select: &str,
    run: RunId,
    read: impl FnMut(&Row<'_>) -> rusqlite::Result<T>,
) -> Result<Vec<T>, StoreFault> {
    select_rows(connection, &format!("{select} WHERE run = ?1 ORDER BY seq"), [run.0], read)
}

pub(super) fn parse_json_column<T: DeserializeOwned>(row: &Row<'_>, column: usize) -> rusqlite::Result<T> {
    let text: String = row.get(column)?;
    serde_json::from_str(&text).map_err(|error| damaged_column_error(column, error.into()))
}

pub(super) fn parse_text_column<T: FromStr<Err: std::error::Error + Send + Sync + 'static>>(
    row: &Row<'_>,
    column: usize,
) -> rusqlite::Result<T> {
    let text: String = row.get(column)?;
    text.parse().map_err(|error: T::Err| damaged_column_error(column, error.into()))
}

/// Value of an enum that is stored by its name. `kind`: kind of the value, for the error message.
pub(super) fn parse_name_column<T: DeserializeOwned>(row: &Row<'_>, column: usize, kind: &str) -> rusqlite::Result<T> {
    let name: String = row.get(column)?;
    let unknown = |_| damaged_column_error(column, format!("unknown {kind} `{name}`").into());
    serde_json::from_value(name.clone().into()).map_err(unknown)
}

/// Error that becomes [`StoreFault::Damaged`].
pub(super) fn damaged_column_error(column: usize, why: Box<dyn std::error::Error + Send + Sync>) -> rusqlite::Error {
    rusqlite::Error::FromSqlConversionFailure(column, Type::Text, why)
}
