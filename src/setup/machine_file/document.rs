//! Text of a TOML file that a person writes: finds sections and lines, and adds the location to errors.
//!
//! The text is parsed again for each query. This is fast, because the text has only a few kilobytes, and no value needs
//! to borrow from the text for longer than one call.

use std::path::Path;

use serde::Deserialize;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::error::{FileLocation, MachineFileError, MachineFileProblem};
use super::located_value::{LocatedValue, ValueFault, ValueFaultKind, deserialize_with_location};

/// Text of a file that is valid TOML, and the name of the file for errors.
#[derive(Debug, Clone)]
pub struct TomlDocument {
    file_name: String,
    text: String,
}

impl TomlDocument {
    /// Checks that `text` is valid TOML; `file` is the name in errors.
    pub fn parse(file: &str, text: String) -> Result<Self, MachineFileError> {
        let document = Self { file_name: file.to_owned(), text };
        document.parse_root()?;
        Ok(document)
    }

    pub fn read(path: &Path) -> Result<Self, MachineFileError> {
        let file = path.display().to_string();
        let text = std::fs::read_to_string(path)
            .map_err(|source| MachineFileError::UnreadableFile { file: file.clone(), source })?;
        Self::parse(&file, text)
    }

    /// Text as it was read.
    pub fn text(&self) -> &str {
        &self.text
    }

    fn parse_root(&self) -> Result<DeTable<'_>, MachineFileError> {
        DeTable::parse(&self.text).map(Spanned::into_inner).map_err(|error| {
            let offset = error.span().map(|span| span.start);
            self.error_at_offset(offset, MachineFileProblem::InvalidToml(error.message().to_owned()))
        })
    }

    /// Names directly below `path`, in the order of the text. Empty if `path` is not a table.
    pub fn key_names(&self, path: &[&str]) -> Result<Vec<String>, MachineFileError> {
        let Some(table) = find_table(self.parse_root()?, path) else { return Ok(Vec::new()) };
        let mut names: Vec<_> = table.keys().map(|key| (key.span().start, key.get_ref().to_string())).collect();
        names.sort();
        Ok(names.into_iter().map(|(_, name)| name).collect())
    }

    /// Checks that every name directly below `path` is one of `known`.
    pub fn check_keys_are_known(&self, path: &[&str], known: &[&str]) -> Result<(), MachineFileError> {
        for name in self.key_names(path)? {
            if !known.contains(&name.as_str()) {
                let full = [path, &[name.as_str()]].concat();
                let prefix = |name: &str| [path, &[name]].concat().join(".");
                let problem = MachineFileProblem::UnknownSection {
                    section: prefix(&name),
                    known: known.iter().map(|name| prefix(name)).collect(),
                };
                return Err(self.error_at_key(&full, problem));
            }
        }
        Ok(())
    }

    /// Passes the value at `path` to `read`; `None` if the file does not contain it.
    pub fn read_section<'t, R>(
        &'t self,
        path: &[&str],
        read: impl FnOnce(LocatedValue<'t>) -> Result<R, ValueFault>,
    ) -> Result<Option<R>, MachineFileError> {
        let found = find_offset_and_value(self.parse_root()?, path);
        let section = found.map(|(_, value)| deserialize_with_location(value, read)).transpose();
        section.map_err(|fault| self.to_file_error(path, fault))
    }

    /// Passes an empty table to `read`, for a section that the file does not contain.
    pub fn read_from_empty_table<R>(
        &self,
        path: &[&str],
        read: impl FnOnce(LocatedValue<'_>) -> Result<R, ValueFault>,
    ) -> Result<R, MachineFileError> {
        let nothing = Spanned::new(0..0, DeValue::Table(DeTable::default()));
        read(LocatedValue(nothing)).map_err(|fault| self.to_file_error(path, ValueFault { byte_offset: None, ..fault }))
    }

    /// Reads a required section.
    pub fn deserialize_required_section<'t, T: Deserialize<'t>>(
        &'t self,
        path: &[&str],
    ) -> Result<T, MachineFileError> {
        self.read_required_section(path, T::deserialize)
    }

    /// As [`Self::read_section`], for a required section.
    pub fn read_required_section<'t, R>(
        &'t self,
        path: &[&str],
        read: impl FnOnce(LocatedValue<'t>) -> Result<R, ValueFault>,
    ) -> Result<R, MachineFileError> {
        self.read_section(path, read)?
            .ok_or_else(|| self.error_at_offset(None, MachineFileProblem::MissingSection { section: path.join(".") }))
    }

    /// Reads an optional list `[[name]]`.
    pub fn read_list<'t, T: Deserialize<'t>>(&'t self, name: &str) -> Result<Vec<T>, MachineFileError> {
        Ok(self.read_section(&[name], Deserialize::deserialize)?.unwrap_or_default())
    }

    /// Error at the key `path`, or at its nearest parent in the file.
    pub fn error_at_key(&self, path: &[&str], problem: MachineFileProblem) -> MachineFileError {
        let offset = (1..=path.len()).rev().find_map(|depth| {
            let (offset, _) = find_offset_and_value(self.parse_root().ok()?, &path[..depth])?;
            Some(offset)
        });
        self.error_at_offset(offset, problem)
    }

    /// Error for the value at the key `path`.
    pub fn value_error(&self, path: &[&str], why: impl Into<String>) -> MachineFileError {
        self.error_at_key(path, value_problem(path, why.into()))
    }

    /// Error for the value at `key` of entry `index` of the list `[[path]]`.
    pub fn entry_value_error(
        &self,
        path: &[&str],
        index: usize,
        key: &str,
        why: impl Into<String>,
    ) -> MachineFileError {
        let problem = value_problem(&[path, &[key]].concat(), why.into());
        self.error_at_entry(path, index, key, problem)
    }

    /// Error for entry `index` of the list `[[name]]`, at the line of the entry's key `name`.
    pub fn entry_error(&self, name: &str, index: usize, why: impl Into<String>) -> MachineFileError {
        self.error_at_entry(&[name], index, "name", value_problem(&[name], why.into()))
    }

    /// Error at `key` of entry `index` of the list `[[path]]`, or at the head of the entry if the key is
    /// missing.
    pub fn error_at_entry(
        &self,
        path: &[&str],
        index: usize,
        key: &str,
        problem: MachineFileProblem,
    ) -> MachineFileError {
        let list = self.parse_root().ok().and_then(|root| find_offset_and_value(root, path));
        let offset = list.and_then(|(_, list)| {
            let entry = list.get_ref().get(index)?;
            let key_and_value = entry.get_ref().as_table().and_then(|table| table.get_key_value(key));
            Some(key_and_value.map_or(entry.span().start, |(key, _)| key.span().start))
        });
        self.error_at_offset(offset, problem)
    }

    /// Error for a fault in the value at `path`.
    fn to_file_error(&self, path: &[&str], fault: ValueFault) -> MachineFileError {
        let mut keys: Vec<&str> = path.to_vec();
        keys.extend(fault.key_path.iter().map(String::as_str));
        let section = keys.join(".");
        let problem = match fault.kind {
            ValueFaultKind::UnknownKey { key, known } => MachineFileProblem::UnknownKey {
                section,
                key,
                known: known.iter().map(|&name| name.to_owned()).collect(),
            },
            ValueFaultKind::MissingKey { key } => MachineFileProblem::MissingKey { section, key: key.to_owned() },
            ValueFaultKind::UnknownValue { value, known } => {
                value_problem(&keys, format!("is `{value}`; known: {}", known.join(", ")))
            }
            ValueFaultKind::InvalidValue(why) => value_problem(&keys, why),
        };
        self.error_at_offset(fault.byte_offset, problem)
    }

    /// Error at the line of the byte `offset`; `None`: without a line.
    fn error_at_offset(&self, offset: Option<usize>, problem: MachineFileProblem) -> MachineFileError {
        let line = offset.and_then(|offset| self.text.get(..offset)).map(|head| head.matches('\n').count() + 1);
        MachineFileError::InvalidContent { place: FileLocation { file: self.file_name.clone(), line }, problem }
    }
}

/// The problem for the last key of `keys`, or for the whole section if there is only one key.
fn value_problem(keys: &[&str], why: String) -> MachineFileProblem {
    match keys {
        [section @ .., key] if !section.is_empty() => {
            MachineFileProblem::InvalidValue { section: section.join("."), key: (*key).to_owned(), why }
        }
        _ => MachineFileProblem::InvalidSection { section: keys.join("."), why },
    }
}

/// Byte offset of the last key of `path`, and its value.
fn find_offset_and_value<'i>(root: DeTable<'i>, path: &[&str]) -> Option<(usize, Spanned<DeValue<'i>>)> {
    let (last, parents) = path.split_last()?;
    let (key, value) = find_table(root, parents)?.remove_entry(*last)?;
    Some((key.span().start, value))
}

/// The table at `path`; `None` if a key is missing or its value is not a table.
fn find_table<'i>(root: DeTable<'i>, path: &[&str]) -> Option<DeTable<'i>> {
    path.iter().try_fold(root, |mut table, key| match table.remove(*key)?.into_inner() {
        DeValue::Table(inner) => Some(inner),
        _ => None,
    })
}
