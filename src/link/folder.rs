//! Folder of text files that a device and the daemon share, as a port. A capture records writes and reads; a replay
//! returns them.

use std::collections::BTreeMap;
use std::fs;
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use super::capture::LinkProtocol;
use super::wiring::{Wired, Wiring};

/// Folder that both sides can access.
pub struct Folder {
    path: PathBuf,
    wired: Wired,
    /// Text of each file at the last read: a capture records changes only.
    seen: Mutex<BTreeMap<String, Option<String>>>,
}

impl Folder {
    /// Opens the folder at `path`; creates it if it is missing.
    ///
    /// # Errors
    /// The folder cannot be created.
    pub fn open(path: &Path) -> io::Result<Self> {
        let wired = Wiring::current().of(&path.display().to_string(), LinkProtocol::Files);
        match &wired {
            Wired::Played(_) => {}
            Wired::Plain => fs::create_dir_all(path)?,
            Wired::RecordedStream(tap) => {
                fs::create_dir_all(path)?;
                tap.opened();
            }
        }
        Ok(Self { path: path.to_owned(), wired, seen: Mutex::default() })
    }

    /// Path of the file `name`.
    pub fn at(&self, name: &str) -> PathBuf {
        self.path.join(name)
    }

    /// Replaces the file `name` atomically: no reader sees a part of it.
    ///
    /// # Errors
    /// The file cannot be written, or the replayed capture holds another text here.
    pub fn write(&self, name: &str, text: &str) -> io::Result<()> {
        let told = format!("{name}\n{text}");
        match &self.wired {
            Wired::Played(player) => return player.ask(told.as_bytes()).map(drop),
            Wired::RecordedStream(tap) => tap.note('>', told.as_bytes()),
            Wired::Plain => {}
        }
        let fresh = self.at(&format!("{name}.new"));
        fs::write(&fresh, text)?;
        fs::rename(&fresh, self.at(name))
    }

    /// Removes the file `name`, if it exists.
    ///
    /// # Errors
    /// The file cannot be removed.
    pub fn remove(&self, name: &str) -> io::Result<()> {
        if matches!(self.wired, Wired::Played(_)) {
            return Ok(());
        }
        match fs::remove_file(self.at(name)) {
            Err(error) if error.kind() != ErrorKind::NotFound => Err(error),
            _ => Ok(()),
        }
    }

    /// Text of the file `name`; `None` if the file does not exist.
    ///
    /// # Errors
    /// The file cannot be read, or is not text.
    pub fn read(&self, name: &str) -> io::Result<Option<String>> {
        if let Wired::Played(player) = &self.wired {
            let said = String::from_utf8(player.ask(name.as_bytes())?).map_err(io::Error::other)?;
            return Ok(said.split_once('\n').map(|(_, text)| text.to_owned()));
        }
        let text = match fs::read_to_string(self.at(name)) {
            Ok(text) => Some(text),
            Err(error) if error.kind() == ErrorKind::NotFound => None,
            Err(error) => return Err(error),
        };
        if let Wired::RecordedStream(tap) = &self.wired {
            let mut seen = self.seen.lock().unwrap_or_else(PoisonError::into_inner);
            if seen.get(name) != Some(&text) {
                let told = text.as_ref().map_or(name.to_owned(), |text| format!("{name}\n{text}"));
                tap.note('<', told.as_bytes());
                seen.insert(name.to_owned(), text.clone());
            }
        }
        Ok(text)
    }
}
