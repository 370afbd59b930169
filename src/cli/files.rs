//! Location of stored files, and reading of estimates.

use std::path::{Path, PathBuf};

use super::failure::CommandFailure;
use crate::store::state_dir;
use machine::record::estimate::Estimate;

/// Directory of the journal and the locks.
pub fn state_folder(given: Option<&Path>) -> Result<std::path::PathBuf, CommandFailure> {
    state_dir(given)
        .ok_or_else(|| CommandFailure::new("the directory of the journal is not known", "add the option --state DIR"))
}

pub fn read_estimates(files: &[PathBuf]) -> Result<Vec<Estimate>, CommandFailure> {
    files.iter().map(|file| read_estimate(file)).collect()
}

pub fn read_estimate(file: &Path) -> Result<Estimate, CommandFailure> {
    let text = std::fs::read_to_string(file).map_err(|error| CommandFailure::from_file_error(file, &error))?;
    serde_json::from_str(&text).map_err(|error| {
        CommandFailure::new(
            format!("{}: {error}", file.display()),
            "use an estimate in the format of `trued run --json`",
        )
    })
}
