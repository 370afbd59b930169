//! Where a daemon's page is, for commands on the same computer: a small file beside the journal.

use std::collections::BTreeMap;
use std::io;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Whereabouts {
    /// Of the daemon: what another has left behind is not believed.
    pub pid: u32,
    pub page: SocketAddr,
    /// Of each machine: SHA-256 of the file that it was read from.
    pub machine_files: BTreeMap<String, String>,
}

impl Whereabouts {
    fn file(folder: &Path) -> PathBuf {
        folder.join("page.json")
    }

    /// In `folder`, the journal's. Whoever reads it meanwhile finds the old or the new one.
    pub fn leave(&self, folder: &Path) -> io::Result<()> {
        let (file, half) = (Self::file(folder), folder.join("page.json.new"));
        std::fs::write(&half, serde_json::to_vec(self)?)?;
        std::fs::rename(half, file)
    }

    /// Of the daemon `pid`; `None` if it has no page.
    pub fn of(pid: u32, folder: &Path) -> Option<Self> {
        let text = std::fs::read(Self::file(folder)).ok()?;
        serde_json::from_slice(&text).ok().filter(|known: &Self| known.pid == pid)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_daemon_that_is_asked_for_is_believed() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(Whereabouts::of(7, folder.path()), None);
        let here = Whereabouts {
            pid: 7,
            page: ([127, 0, 0, 1], 8137).into(),
            machine_files: BTreeMap::new(),
        };
        here.leave(folder.path()).unwrap();
        assert_eq!(Whereabouts::of(7, folder.path()), Some(here));
        assert_eq!(Whereabouts::of(8, folder.path()), None);
        std::fs::write(Whereabouts::file(folder.path()), "{").unwrap();
        assert_eq!(Whereabouts::of(7, folder.path()), None);
    }
}
