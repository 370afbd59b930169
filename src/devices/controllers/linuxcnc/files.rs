//! The two files that `trued` and LinuxCNC share.

use std::io::Error;
use std::path::Path;

use super::result_log::ResultLog;
use crate::controllers::ControllerError;
use link::SharedFolder;

/// Maximum length of the program's path: linuxcncrsh cuts off lines of 250 characters, `set open` included.
const MAX_PROGRAM_PATH_BYTES: usize = 230;
const PROGRAM_FILE_NAME: &str = "trued.ngc";
const LOG_FILE_NAME: &str = "trued.log";

/// Program file and result log in the shared directory.
pub(super) struct SharedFiles(SharedFolder);

/// Name of the file in `directory` that receives the results.
pub fn result_log_path(directory: &Path) -> String {
    directory.join(LOG_FILE_NAME).to_string_lossy().into_owned()
}

impl SharedFiles {
    /// Checks that LinuxCNC can open the path, and creates the directory.
    ///
    /// # Errors
    /// LinuxCNC cannot use the directory's name, or the directory cannot be created.
    pub fn open(directory: &Path) -> Result<Self, ControllerError> {
        let name = directory.join(PROGRAM_FILE_NAME).to_string_lossy().into_owned();
        if !directory.is_absolute() || name.len() > MAX_PROGRAM_PATH_BYTES || name.contains(['(', ')', ' ']) {
            return Err(ControllerError::not_ready(
                format!("LinuxCNC cannot open {name}"),
                "set [controller] program_dir to a short absolute path without spaces and brackets",
            ));
        }
        SharedFolder::open(directory).map(Self).map_err(|error| directory_error(directory, &error))
    }

    pub fn program_path(&self) -> String {
        self.0.file_path(PROGRAM_FILE_NAME).to_string_lossy().into_owned()
    }

    pub fn result_log_path(&self) -> String {
        self.0.file_path(LOG_FILE_NAME).to_string_lossy().into_owned()
    }

    /// Replaces the whole program, and removes the last log.
    pub fn write_program_and_remove_log(&self, text: &str) -> Result<(), ControllerError> {
        self.0.write_file(PROGRAM_FILE_NAME, text).map_err(|error| self.directory_error(PROGRAM_FILE_NAME, &error))?;
        self.0.remove_file(LOG_FILE_NAME).map_err(|error| self.directory_error(LOG_FILE_NAME, &error))
    }

    /// Returns what the program of `step` has written so far; empty without a log file.
    pub fn read_log(&self, step: u32) -> Result<ResultLog, ControllerError> {
        ResultLog::parse(&self.read_log_text()?.unwrap_or_default(), step)
    }

    /// Checks that the log exists, after a program that should have opened it.
    pub fn require_log(&self) -> Result<(), ControllerError> {
        if self.read_log_text()?.is_some() {
            return Ok(());
        }
        Err(ControllerError::not_ready(
            format!("LinuxCNC has run a program but has not written {}", self.result_log_path()),
            "check [controller] program_dir: the user of LinuxCNC needs this folder under the same path, with \
             write permission; a network folder may update late",
        ))
    }

    /// Returns the text of the log; `None` if there is no log.
    fn read_log_text(&self) -> Result<Option<String>, ControllerError> {
        self.0.read_file(LOG_FILE_NAME).map_err(|error| self.directory_error(LOG_FILE_NAME, &error))
    }

    fn directory_error(&self, name: &str, error: &Error) -> ControllerError {
        directory_error(&self.0.file_path(name), error)
    }
}

fn directory_error(path: &Path, error: &Error) -> ControllerError {
    ControllerError::not_ready(
        format!("trued cannot use {}: {error}", path.display()),
        "set [controller] program_dir to a folder to which the users of trued and of LinuxCNC can write",
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn missing_result_log_error_names_linuxcnc_and_the_key() {
        let directory = tempfile::tempdir().unwrap();
        let error = SharedFiles::open(directory.path()).unwrap().require_log().unwrap_err();
        let ControllerError::NotReady { state, remedy } = error else { panic!("{error}") };
        assert!(state.contains("LinuxCNC has") && state.contains("trued.log"), "{state}");
        assert!(remedy.contains("[controller] program_dir"), "{remedy}");
    }
}
