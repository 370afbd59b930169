//! Possible disk contents after a power cut, from the shim's log: everything that was synced, and any part of the
//! rest, in any order, torn at sector boundaries. A name is synced with its folder, never with its file.

use std::collections::BTreeMap;
use std::io::Read;
use std::path::{Path, PathBuf};

use rand::RngExt;
use rand::seq::SliceRandom;

const SECTOR_BYTES: usize = 512;

#[derive(Debug, Clone)]
pub enum DiskEvent {
    /// An existing file was opened or a new one created; it has this number from now on.
    Open {
        id: u32,
        path: PathBuf,
        new: bool,
    },
    CreateFolder {
        path: PathBuf,
    },
    Unlink {
        path: PathBuf,
    },
    Rename {
        from: PathBuf,
        to: PathBuf,
    },
    Write {
        id: u32,
        at: usize,
        data: Vec<u8>,
    },
    Resize {
        id: u32,
        length: usize,
    },
    SyncFile {
        id: u32,
    },
    SyncFolder {
        path: PathBuf,
    },
    /// Bytes that the program sent on a socket.
    SendToSocket {
        data: Vec<u8>,
    },
    /// Bytes on standard output.
    PrintToStdout,
}

/// Reads the shim's log.
pub fn parse_events(log: &Path) -> Vec<DiskEvent> {
    let bytes = std::fs::read(log).unwrap();
    let mut rest = bytes.as_slice();
    let mut events = Vec::new();
    while let Some(end) = rest.iter().position(|byte| *byte == b'\n') {
        let head = std::str::from_utf8(&rest[..end]).unwrap();
        rest = &rest[end + 1..];
        let (kind, words) = head.split_once(' ').unwrap();
        let number = |i: usize| words.split(' ').nth(i).unwrap().parse::<usize>().unwrap();
        let id = || number(0) as u32;
        let path = PathBuf::from(words);
        let mut data = |length: usize| {
            let mut data = vec![0; length];
            rest.read_exact(&mut data).unwrap();
            data
        };
        events.push(match kind {
            "E" | "C" => {
                let path = words.split_once(' ').unwrap().1.into();
                DiskEvent::Open { id: id(), path, new: kind == "C" }
            }
            "M" => DiskEvent::CreateFolder { path },
            "U" => DiskEvent::Unlink { path },
            "R" => {
                let (from, to) = words.split_once('\t').unwrap();
                DiskEvent::Rename { from: from.into(), to: to.into() }
            }
            "W" => DiskEvent::Write { id: id(), at: number(1), data: data(number(2)) },
            "T" => DiskEvent::Resize { id: id(), length: number(1) },
            "S" => DiskEvent::SyncFile { id: id() },
            "D" => DiskEvent::SyncFolder { path },
            "N" => DiskEvent::SendToSocket { data: data(number(0)) },
            "P" => DiskEvent::PrintToStdout,
            other => panic!("{other}"),
        });
    }
    events
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum DirectoryEntry {
    Folder,
    File(u32),
}

/// A name with its new entry, or `None` if the name was removed.
type EntryChange = (PathBuf, Option<DirectoryEntry>);

/// The part of a write in one sector, or a new length.
#[derive(Debug, Clone)]
enum UnsyncedWrite {
    Data { at: usize, data: Vec<u8> },
    NewLength(usize),
}

#[derive(Debug, Default)]
struct DiskFile {
    synced_content: Vec<u8>,
    unsynced_writes: Vec<UnsyncedWrite>,
}

/// The disk below `root`.
pub struct DiskImage {
    logged_root: PathBuf,
    files_by_id: BTreeMap<u32, DiskFile>,
    synced_entries: BTreeMap<PathBuf, DirectoryEntry>,
    unsynced_entry_changes: Vec<EntryChange>,
    /// Contents of the files of the start that no event has opened or removed yet.
    untouched_initial_files: BTreeMap<PathBuf, Vec<u8>>,
}

impl DiskImage {
    /// The content of `folder`, all of it synced; `root` is its path in the log.
    pub fn read_folder(folder: &Path, root: &Path) -> Self {
        let mut disk = Self {
            logged_root: root.to_owned(),
            files_by_id: BTreeMap::new(),
            synced_entries: BTreeMap::from([(root.to_owned(), DirectoryEntry::Folder)]),
            unsynced_entry_changes: Vec::new(),
            untouched_initial_files: BTreeMap::new(),
        };
        disk.scan_folder(folder, root);
        disk
    }

    fn scan_folder(&mut self, folder: &Path, logged_path: &Path) {
        for entry in std::fs::read_dir(folder).unwrap() {
            let entry = entry.unwrap();
            let (path, logged_path) = (entry.path(), logged_path.join(entry.file_name()));
            if path.is_dir() {
                self.synced_entries.insert(logged_path.clone(), DirectoryEntry::Folder);
                self.scan_folder(&path, &logged_path);
            } else {
                self.untouched_initial_files.insert(logged_path, std::fs::read(&path).unwrap());
            }
        }
    }

    pub fn apply_event(&mut self, event: &DiskEvent) {
        match event {
            DiskEvent::Open { id, path, new: false } => {
                let synced = self.untouched_initial_files.remove(path).unwrap_or_default();
                self.files_by_id.insert(*id, DiskFile { synced_content: synced, unsynced_writes: Vec::new() });
                self.synced_entries.insert(path.clone(), DirectoryEntry::File(*id));
            }
            DiskEvent::Open { id, path, new: true } => {
                self.files_by_id.insert(*id, DiskFile::default());
                self.unsynced_entry_changes.push((path.clone(), Some(DirectoryEntry::File(*id))));
            }
            DiskEvent::CreateFolder { path } => {
                self.unsynced_entry_changes.push((path.clone(), Some(DirectoryEntry::Folder)))
            }
            DiskEvent::Unlink { path } => {
                self.untouched_initial_files.remove(path);
                self.unsynced_entry_changes.push((path.clone(), None));
            }
            DiskEvent::Rename { from, to } => {
                let names = self.unsynced_entry_changes.iter().rev().find(|(path, _)| path == from);
                let node = names.map_or_else(|| self.synced_entries.get(from).copied(), |(_, node)| *node);
                self.unsynced_entry_changes.push((to.clone(), node));
                self.unsynced_entry_changes.push((from.clone(), None));
            }
            DiskEvent::Write { id, at, data } => {
                let unsynced = &mut self.files_by_id.get_mut(id).unwrap().unsynced_writes;
                let (mut at, mut rest) = (*at, data.as_slice());
                while !rest.is_empty() {
                    let fits = (SECTOR_BYTES - at % SECTOR_BYTES).min(rest.len());
                    unsynced.push(UnsyncedWrite::Data { at, data: rest[..fits].to_vec() });
                    (at, rest) = (at + fits, &rest[fits..]);
                }
            }
            DiskEvent::Resize { id, length } => {
                self.files_by_id.get_mut(id).unwrap().unsynced_writes.push(UnsyncedWrite::NewLength(*length));
            }
            DiskEvent::SyncFile { id } => {
                let DiskFile { synced_content: synced, unsynced_writes: unsynced } =
                    self.files_by_id.get_mut(id).unwrap();
                unsynced.drain(..).for_each(|piece| apply_write(piece, synced));
            }
            DiskEvent::SyncFolder { path } => self.sync_folder(path),
            DiskEvent::SendToSocket { .. } | DiskEvent::PrintToStdout => {}
        }
    }

    fn sync_folder(&mut self, folder: &Path) {
        let (synced, unsynced): (Vec<EntryChange>, _) =
            self.unsynced_entry_changes.drain(..).partition(|(path, _)| path.parent() == Some(folder));
        self.unsynced_entry_changes = unsynced;
        synced.into_iter().for_each(|change| apply_entry_change(change, &mut self.synced_entries));
    }

    /// Writes to `folder` what remains if the power fails now.
    pub fn write_after_power_cut(&self, random: &mut impl RngExt, folder: &Path) {
        let mut names = self.synced_entries.clone();
        // A journalling file system keeps the order of name changes.
        let done = random.random_range(0..=self.unsynced_entry_changes.len());
        let chance = [0.0, 0.5, 1.0][random.random_range(0..3)];
        self.unsynced_entry_changes[..done].iter().cloned().for_each(|change| apply_entry_change(change, &mut names));
        let place = |path: &Path| folder.join(path.strip_prefix(&self.logged_root).unwrap());
        // Parents come before their children.
        for (path, node) in &names {
            let place = place(path);
            if path != &self.logged_root && !place.parent().unwrap().is_dir() {
                continue;
            }
            match node {
                DirectoryEntry::Folder => std::fs::create_dir_all(place).unwrap(),
                DirectoryEntry::File(id) => {
                    std::fs::write(place, self.files_by_id[id].torn_content(chance, random)).unwrap();
                }
            }
        }
        for (path, content) in &self.untouched_initial_files {
            std::fs::write(place(path), content).unwrap();
        }
    }
}

impl DiskFile {
    fn torn_content(&self, chance: f64, random: &mut impl RngExt) -> Vec<u8> {
        let mut content = self.synced_content.clone();
        let mut pieces = self.unsynced_writes.clone();
        if random.random_bool(0.5) {
            pieces.shuffle(random);
        }
        for piece in pieces {
            if random.random_bool(chance) {
                apply_write(piece, &mut content);
            }
        }
        content
    }
}

fn apply_entry_change((path, node): EntryChange, names: &mut BTreeMap<PathBuf, DirectoryEntry>) {
    match node {
        Some(node) => drop(names.insert(path, node)),
        None => drop(names.remove(&path)),
    }
}

fn apply_write(piece: UnsyncedWrite, content: &mut Vec<u8>) {
    match piece {
        UnsyncedWrite::NewLength(length) => content.resize(length, 0),
        UnsyncedWrite::Data { at, data } => {
            let end = at + data.len();
            content.resize(content.len().max(end), 0);
            content[at..end].copy_from_slice(&data);
        }
    }
}
