//! The two files that `trued` and LinuxCNC share.

use std::io::Error;
use std::path::Path;

use super::not_ready::not_ready;
use super::result::Log;
use crate::controllers::ControllerError;
use link::Folder;

/// Maximum length of the program's name: linuxcncrsh cuts off lines of 250 characters, `set open` included.
const LONGEST_NAME: usize = 230;
const PROGRAM: &str = "trued.ngc";
const LOG: &str = "trued.log";

pub(super) struct Files(Folder);

/// Name of the file in `directory` that receives the results.
pub fn log_name(directory: &Path) -> String {
    directory.join(LOG).to_string_lossy().into_owned()
}

impl Files {
    /// # Errors
    /// LinuxCNC cannot use the directory's name, or the directory cannot be created.
    pub fn within(directory: &Path) -> Result<Self, ControllerError> {
        let name = directory.join(PROGRAM).to_string_lossy().into_owned();
        if !directory.is_absolute() || name.len() > LONGEST_NAME || name.contains(['(', ')', ' ']) {
            return Err(not_ready(
                &format!("LinuxCNC cannot open {name}"),
                "give [controller] program_dir a short absolute name without blanks and brackets",
            ));
        }
        Folder::open(directory).map(Self).map_err(|error| unusable(directory, &error))
    }

    pub fn program_name(&self) -> String {
        self.0.at(PROGRAM).to_string_lossy().into_owned()
    }

    pub fn log_name(&self) -> String {
        self.0.at(LOG).to_string_lossy().into_owned()
    }

    /// Replaces the whole program, and removes the last log.
    pub fn write(&self, text: &str) -> Result<(), ControllerError> {
        self.0.write(PROGRAM, text).map_err(|error| self.unusable(PROGRAM, &error))?;
        self.0.remove(LOG).map_err(|error| self.unusable(LOG, &error))
    }

    /// Returns what the program of `step` has written so far.
    pub fn log(&self, step: u32) -> Result<Log, ControllerError> {
        match self.0.read(LOG) {
            Ok(Some(text)) => Log::parse(&text, step),
            Ok(None) => Ok(Log::default()),
            Err(error) => Err(self.unusable(LOG, &error)),
        }
    }

    /// Checks that the log exists, after a program that should have opened it.
    pub fn expect_log(&self) -> Result<(), ControllerError> {
        match self.0.read(LOG) {
            Ok(Some(_)) => Ok(()),
            Ok(None) => Err(not_ready(
                &format!("LinuxCNC has run a program and not written {}", self.0.at(LOG).display()),
                "the user of LinuxCNC must see this folder under the same name and be allowed to write to \
                 it ([controller] program_dir); on another computer it may be late",
            )),
            Err(error) => Err(self.unusable(LOG, &error)),
        }
    }

    fn unusable(&self, name: &str, error: &Error) -> ControllerError {
        unusable(&self.0.at(name), error)
    }
}

fn unusable(path: &Path, error: &Error) -> ControllerError {
    not_ready(
        &format!("trued cannot use {}: {error}", path.display()),
        "give trued and LinuxCNC a folder to which both users may write ([controller] program_dir)",
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_log_that_linuxcnc_has_not_written_names_the_key_and_the_side() {
        let directory = tempfile::tempdir().unwrap();
        let error = Files::within(directory.path()).unwrap().expect_log().unwrap_err();
        let ControllerError::NotReady { state, remedy } = error else { panic!("{error}") };
        assert!(state.contains("LinuxCNC has") && state.contains("trued.log"), "{state}");
        assert!(remedy.contains("[controller] program_dir"), "{remedy}");
    }
}
