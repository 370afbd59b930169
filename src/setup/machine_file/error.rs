//! Errors in a file that a person writes: file, line, section, key, and the remedy.

use std::fmt;
use std::io;

use super::key_hint;

#[derive(Debug, thiserror::Error)]
pub enum MachineFileError {
    #[error("{file} cannot be read: {source}; check the path")]
    UnreadableFile { file: String, source: io::Error },
    #[error(
        "{file} cannot be read: {source}; check `file` in [artefact]: the path is relative to the folder of \
        the machine file"
    )]
    UnreadableBallTable { file: String, source: io::Error },
    #[error("{place}: {problem}")]
    InvalidContent { place: FileLocation, problem: MachineFileProblem },
}

/// File name, and the line (from 1) if it is known.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FileLocation {
    pub file: String,
    pub line: Option<usize>,
}

impl fmt::Display for FileLocation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.line {
            Some(line) => write!(f, "{}:{line}", self.file),
            None => write!(f, "{}", self.file),
        }
    }
}

/// `section`: a TOML table, written as in the file, without brackets: `axes.X`. `why` continues a sentence that begins
/// with the key, column or section.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum MachineFileProblem {
    #[error("the file is not valid TOML: {0}")]
    InvalidToml(String),
    #[error("unknown section [{section}]; {}", key_hint::unknown_key_hint(section, known))]
    UnknownSection { section: String, known: Vec<String> },
    #[error("unknown key `{key}` in [{section}]; {}", key_hint::unknown_key_hint(key, known))]
    UnknownKey { section: String, key: String, known: Vec<String> },
    #[error("the key `{key}` is missing in [{section}]; add it")]
    MissingKey { section: String, key: String },
    #[error("the section [{section}] is missing; add it")]
    MissingSection { section: String },
    #[error("`{key}` in [{section}] {why}")]
    InvalidValue { section: String, key: String, why: String },
    #[error("the file is not a valid table of comma-separated values: {0}")]
    InvalidCsv(String),
    /// Fault in a column of the table of balls, or in one of its cells.
    #[error("column `{column}` {why}")]
    InvalidColumn { column: String, why: String },
    #[error("[{section}] {why}")]
    InvalidSection { section: String, why: String },
}
