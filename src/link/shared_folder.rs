//! Folder of text files that a device and the daemon share. A capture records writes and reads; a replay returns
//! them.

use std::collections::BTreeMap;
use std::fs;
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use super::capture::LinkProtocol;
use super::link_mode::{LinkBackend, LinkMode};

/// Folder of text files that the device and the daemon can access.
pub struct SharedFolder {
    path: PathBuf,
    backend: LinkBackend,
    /// Text of each file at the last read, while a capture is recorded (`None`: the file was missing): only changes
    /// are recorded.
    last_read_texts: Mutex<BTreeMap<String, Option<String>>>,
}

impl SharedFolder {
    /// Opens the folder at `path`; creates it if it is missing, except in a replay.
    ///
    /// # Errors
    /// The folder cannot be created.
    pub fn open(path: &Path) -> io::Result<Self> {
        let backend = LinkMode::current().backend_for_link(&path.display().to_string(), LinkProtocol::SharedFiles);
        if !backend.is_replayed() {
            fs::create_dir_all(path)?;
            backend.record_opening();
        }
        Ok(Self { path: path.to_owned(), backend, last_read_texts: Mutex::default() })
    }

    /// Path of the file `name`.
    pub fn file_path(&self, name: &str) -> PathBuf {
        self.path.join(name)
    }

    /// Replaces the file `name` atomically: no reader sees a part of it.
    ///
    /// # Errors
    /// The file cannot be written, or the replayed capture holds another text here.
    pub fn write_file(&self, name: &str, text: &str) -> io::Result<()> {
        let entry = format!("{name}\n{text}");
        if let LinkBackend::Replayed(replay) = &self.backend {
            return replay.exchange(entry.as_bytes()).map(drop);
        }
        self.backend.record_bytes('>', entry.as_bytes());
        let temporary = self.file_path(&format!("{name}.new"));
        fs::write(&temporary, text)?;
        fs::rename(&temporary, self.file_path(name))
    }

    /// Removes the file `name`, if it exists. A capture does not record the removal, and a replay does nothing.
    ///
    /// # Errors
    /// The file cannot be removed.
    pub fn remove_file(&self, name: &str) -> io::Result<()> {
        if self.backend.is_replayed() {
            return Ok(());
        }
        match fs::remove_file(self.file_path(name)) {
            Err(error) if error.kind() != ErrorKind::NotFound => Err(error),
            _ => Ok(()),
        }
    }

    /// Text of the file `name`; `None` if the file does not exist.
    ///
    /// # Errors
    /// The file cannot be read, or is not text.
    pub fn read_file(&self, name: &str) -> io::Result<Option<String>> {
        if let LinkBackend::Replayed(replay) = &self.backend {
            let reply = String::from_utf8(replay.exchange(name.as_bytes())?).map_err(io::Error::other)?;
            return Ok(reply.split_once('\n').map(|(_, text)| text.to_owned()));
        }
        let text = match fs::read_to_string(self.file_path(name)) {
            Ok(text) => Some(text),
            Err(error) if error.kind() == ErrorKind::NotFound => None,
            Err(error) => return Err(error),
        };
        if let LinkBackend::Recorded(recorder) = &self.backend {
            let mut last_texts = self.last_read_texts.lock().unwrap_or_else(PoisonError::into_inner);
            if last_texts.get(name) != Some(&text) {
                let entry = text.as_ref().map_or(name.to_owned(), |text| format!("{name}\n{text}"));
                recorder.record_bytes('<', entry.as_bytes());
                last_texts.insert(name.to_owned(), text.clone());
            }
        }
        Ok(text)
    }
}
