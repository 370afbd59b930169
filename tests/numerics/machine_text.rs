//! Changes values in the text of machine files.

use toml::{Table, Value};
use trued::setup::MachineFile;

/// Sets the value at `path`, keys joined by dots; missing tables are created.
pub fn set_key(table: &mut Table, path: &str, value: Value) {
    let (tables, key) = path.rsplit_once('.').unwrap();
    let inner = tables
        .split('.')
        .fold(table, |table, key| table.entry(key).or_insert_with(|| Table::new().into()).as_table_mut().unwrap());
    inner.insert(key.to_owned(), value);
}

/// The machine file `text` with other values.
pub fn changed_machine_file<'c>(text: &str, changes: impl IntoIterator<Item = &'c (&'c str, Value)>) -> MachineFile {
    let mut table: Table = text.parse().unwrap();
    changes.into_iter().for_each(|(path, value)| set_key(&mut table, path, value.clone()));
    parse_machine_file(&table)
}

pub fn parse_machine_file(table: &Table) -> MachineFile {
    MachineFile::parse("world.toml", toml::to_string(table).unwrap()).unwrap()
}
