//! The two files that trued and LinuxCNC share.

use std::io::{Error, ErrorKind};
use std::path::{Path, PathBuf};

use super::prepare::not_ready;
use super::result::Log;
use crate::controllers::ControllerError;

/// linuxcncrsh cuts off lines of 250 characters, `set open` included.
const LONGEST_NAME: usize = 230;

pub(super) struct Files {
    program: PathBuf,
    log: PathBuf,
}

impl Files {
    /// # Errors
    /// A directory whose name LinuxCNC cannot take, or that cannot be made.
    pub fn within(directory: &Path) -> Result<Self, ControllerError> {
        let files = Self { program: directory.join("trued.ngc"), log: directory.join("trued.log") };
        let name = files.program_name();
        if !directory.is_absolute() || name.len() > LONGEST_NAME || name.contains(['(', ')', ' ']) {
            return Err(not_ready(
                &format!("LinuxCNC cannot open {name}"),
                "give [controller] a directory with a short absolute name without blanks and brackets",
            ));
        }
        std::fs::create_dir_all(directory).map_err(|error| unusable(directory, &error))?;
        Ok(files)
    }

    pub fn program_name(&self) -> String {
        self.program.to_string_lossy().into_owned()
    }

    pub fn log_name(&self) -> String {
        self.log.to_string_lossy().into_owned()
    }

    /// Replace the program whole, and take away the last log.
    pub fn write(&self, text: &str) -> Result<(), ControllerError> {
        let fresh = self.program.with_extension("new");
        std::fs::write(&fresh, text)
            .and_then(|()| std::fs::rename(&fresh, &self.program))
            .map_err(|error| unusable(&self.program, &error))?;
        match std::fs::remove_file(&self.log) {
            Err(error) if error.kind() != ErrorKind::NotFound => Err(unusable(&self.log, &error)),
            _ => Ok(()),
        }
    }

    /// What the program of `step` has written so far.
    pub fn log(&self, step: u32) -> Result<Log, ControllerError> {
        match std::fs::read_to_string(&self.log) {
            Ok(text) => Log::parse(&text, step),
            Err(error) if error.kind() == ErrorKind::NotFound => Ok(Log::default()),
            Err(error) => Err(unusable(&self.log, &error)),
        }
    }

    /// After a program that should have opened its log.
    pub fn expect_log(&self) -> Result<(), ControllerError> {
        if self.log.exists() {
            return Ok(());
        }
        Err(unusable(&self.log, &ErrorKind::NotFound.into()))
    }
}

fn unusable(path: &Path, error: &Error) -> ControllerError {
    not_ready(
        &format!("{} cannot be used: {error}", path.display()),
        "give trued and LinuxCNC a directory that both may write ([controller] directory)",
    )
}
