//! The checksums of a journal's rows, computed independently of the program, by the definition in
//! `src/store/checksum.rs`.

use std::path::Path;

use rusqlite::Connection;
use rusqlite::types::ValueRef;

/// CRC-32C bit by bit (RFC 3720, 12.1; reflected polynomial 0x82F63B78).
fn crc32c(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(u32::MAX, |crc, byte| {
        (0..8).fold(crc ^ u32::from(*byte), |crc, _| (crc >> 1) ^ if crc & 1 == 1 { 0x82f6_3b78 } else { 0 })
    })
}

fn checksummed_value_bytes(value: ValueRef<'_>) -> Vec<u8> {
    let long = |kind: u8, bytes: &[u8]| [&[kind], &(bytes.len() as u64).to_le_bytes()[..], bytes].concat();
    match value {
        ValueRef::Null => vec![0],
        ValueRef::Integer(value) => [&[1], &value.to_le_bytes()[..]].concat(),
        ValueRef::Real(value) => [&[2], &value.to_le_bytes()[..]].concat(),
        ValueRef::Text(text) => long(3, text),
        ValueRef::Blob(blob) => long(4, blob),
    }
}

/// The rows of `table` whose checksum is wrong, with the correct one.
fn rows_with_wrong_checksum(database: &Connection, table: &str) -> Vec<(i64, [u8; 4])> {
    let mut select = database.prepare(&format!("SELECT rowid, * FROM {table}")).unwrap();
    let names: Vec<String> = select.column_names().map(str::to_owned).collect();
    let mut rows = select.query([]).unwrap();
    let mut wrong = Vec::new();
    while let Some(row) = rows.next().unwrap() {
        let (mut bytes, mut stored) = (Vec::new(), Vec::new());
        for (index, name) in names.iter().enumerate().skip(1) {
            let value = checksummed_value_bytes(row.get_ref(index).unwrap());
            match name.as_str() {
                "checksum" => stored = value,
                _ => bytes.extend(value),
            }
        }
        let right = crc32c(&bytes).to_be_bytes();
        if stored != checksummed_value_bytes(ValueRef::Blob(&right)) {
            wrong.push((row.get(0).unwrap(), right));
        }
    }
    wrong
}

fn table_names(database: &Connection) -> Vec<String> {
    let all = "SELECT name FROM sqlite_schema WHERE type = 'table' AND name NOT LIKE 'sqlite_%'";
    let mut statement = database.prepare(all).unwrap();
    statement.query_map([], |row| row.get(0)).unwrap().map(Result::unwrap).collect()
}

/// Asserts that every row has its checksum.
pub fn assert_checksums(database: &Connection) {
    assert_eq!(crc32c(b"123456789"), 0xe306_9283);
    for table in table_names(database) {
        assert_eq!(rows_with_wrong_checksum(database, &table), [], "{table}");
    }
}

/// Changes the journal in `state` by SQL and updates the checksums of the changed rows.
pub fn execute_sql_and_update_checksums(state: &Path, statement: &str) {
    let database = Connection::open(state.join("journal.sqlite")).unwrap();
    database.execute_batch(statement).unwrap();
    for table in table_names(&database) {
        for (row, right) in rows_with_wrong_checksum(&database, &table) {
            let set = format!("UPDATE {table} SET checksum = ?2 WHERE rowid = ?1");
            database.execute(&set, (row, right)).unwrap();
        }
    }
}
