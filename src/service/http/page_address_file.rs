//! Address of a daemon's page, for commands on the same computer: a small file beside the journal.

use std::collections::BTreeMap;
use std::io;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

/// Content of the file `page.json`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct PageAddressFile {
    /// Process ID of the daemon; a file that another process has left is ignored.
    pub pid: u32,
    /// Address and port of the page.
    pub page: SocketAddr,
    /// By machine: SHA-256 of its machine file.
    #[serde(rename = "machine_files")]
    pub machine_file_sha256_by_machine: BTreeMap<String, String>,
}

impl PageAddressFile {
    fn path(folder: &Path) -> PathBuf {
        folder.join("page.json")
    }

    /// Writes the file to `folder`, the folder of the journal. A concurrent reader gets the old or the new file.
    pub fn write(&self, folder: &Path) -> io::Result<()> {
        let (file, new_file) = (Self::path(folder), folder.join("page.json.new"));
        std::fs::write(&new_file, serde_json::to_vec(self)?)?;
        std::fs::rename(new_file, file)
    }

    /// The file of the daemon `pid`; `None` if that daemon has no page, or the file cannot be read.
    pub fn read(pid: u32, folder: &Path) -> Option<Self> {
        let text = std::fs::read(Self::path(folder)).ok()?;
        serde_json::from_slice(&text).ok().filter(|known: &Self| known.pid == pid)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn address_file_of_another_daemon_is_ignored() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(PageAddressFile::read(7, folder.path()), None);
        let here = PageAddressFile {
            pid: 7,
            page: ([127, 0, 0, 1], 8137).into(),
            machine_file_sha256_by_machine: BTreeMap::new(),
        };
        here.write(folder.path()).unwrap();
        assert_eq!(PageAddressFile::read(7, folder.path()), Some(here));
        assert_eq!(PageAddressFile::read(8, folder.path()), None);
        std::fs::write(PageAddressFile::path(folder.path()), "{").unwrap();
        assert_eq!(PageAddressFile::read(7, folder.path()), None);
    }
}
