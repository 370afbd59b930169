//! Programs of LinuxCNC that contain the word of a work offset.

use std::fs::File;
use std::io::{self, Read as _};
use std::path::{Path, PathBuf};

use crate::controllers::WorkOffsetSlot;
use crate::controllers::linuxcnc::IniFile;

/// Maximum number of programs that are searched; further programs count as not searched.
const MAX_PROGRAMS: usize = 1000;
/// Of a longer program only the beginning is searched.
const MAX_PROGRAM_BYTES: u64 = 4_000_000;

/// Programs in a folder, by their names in alphabetical order.
#[derive(Debug, Clone, PartialEq)]
pub struct ProgramSearch {
    pub folder: PathBuf,
    /// Names of those that select the work offset.
    pub found: Vec<String>,
    /// Number of those that were not searched to their end, or not at all. A program in `found` may count as well.
    pub unsearched_count: usize,
}

/// Searches the `.ngc` files of `[DISPLAY]PROGRAM_PREFIX`, without its subfolders. `None`: the INI file names no
/// folder that can be read.
pub fn programs_with_slot(ini: &Path, slot: WorkOffsetSlot) -> Option<ProgramSearch> {
    let prefix = IniFile::read(ini).ok()?.value("DISPLAY", "PROGRAM_PREFIX")?.to_owned();
    let folder = match prefix.strip_prefix("~/") {
        Some(rest) => PathBuf::from(std::env::var_os("HOME")?).join(rest),
        // A relative path is that from the folder of the INI file.
        None => ini.parent()?.join(prefix),
    };
    let mut names: Vec<PathBuf> = std::fs::read_dir(&folder).ok()?.flatten().map(|entry| entry.path()).collect();
    // Another kind of file, such as a pipe, might never end.
    names.retain(|path| path.is_file());
    names.retain(|path| path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("ngc")));
    names.sort();
    let mut search =
        ProgramSearch { folder, found: Vec::new(), unsearched_count: names.len().saturating_sub(MAX_PROGRAMS) };
    for path in names.iter().take(MAX_PROGRAMS) {
        match read_beginning(path) {
            Ok((text, is_whole)) if has_slot_word(&text, slot) => {
                search.found.extend(path.file_name().map(|name| name.to_string_lossy().into_owned()));
                search.unsearched_count += usize::from(!is_whole);
            }
            Ok((_, true)) => {}
            Ok((_, false)) | Err(_) => search.unsearched_count += 1,
        }
    }
    Some(search)
}

/// Text of a program, and whether it is the whole text.
fn read_beginning(path: &Path) -> io::Result<(String, bool)> {
    let mut bytes = Vec::new();
    File::open(path)?.take(MAX_PROGRAM_BYTES).read_to_end(&mut bytes)?;
    let is_whole = std::fs::metadata(path)?.len() <= MAX_PROGRAM_BYTES;
    Ok((String::from_utf8_lossy(&bytes).into_owned(), is_whole))
}

/// Whether a line selects the slot, outside comments. LinuxCNC ignores spaces and the case of letters.
fn has_slot_word(text: &str, slot: WorkOffsetSlot) -> bool {
    text.lines().any(|line| {
        let code = code_without_comments(line);
        let words = code.split('G').skip(1).map(|rest| {
            let end = rest.find(|c: char| !c.is_ascii_digit() && c != '.').unwrap_or(rest.len());
            rest[..end].parse::<f64>()
        });
        let number = slot.name().trim_start_matches('G').parse::<f64>();
        words.flatten().any(|word| number.as_ref().is_ok_and(|number| *number == word))
    })
}

/// A semicolon begins a comment only outside parentheses.
fn code_without_comments(line: &str) -> String {
    let mut is_comment = false;
    let mut code = String::new();
    for c in line.chars() {
        match (is_comment, c) {
            (false, ';') => break,
            (false, '(') => is_comment = true,
            (true, ')') => is_comment = false,
            (false, c) if !c.is_whitespace() => code.push(c.to_ascii_uppercase()),
            _ => {}
        }
    }
    code
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn word_of_the_slot_is_found_outside_comments() {
        let slot = "G55".parse().unwrap();
        for text in ["G55", "n10 g0 x1 g 5 5", "G21G55G90", "(a) G055.0 (b)", "G1 X1\nG55 ; zero"] {
            assert!(has_slot_word(text, slot), "{text}");
        }
        for text in ["", "G551", "G54 G56", "(G55)", "; G55", "G0 X55", "G5.5", "G59.1"] {
            assert!(!has_slot_word(text, slot), "{text}");
        }
        assert!(has_slot_word("G59.1", "G59.1".parse().unwrap()));
        assert!(!has_slot_word("G59.1", "G59".parse().unwrap()));
    }

    #[test]
    fn programs_of_the_ini_files_folder_are_searched() {
        let folder = tempfile::tempdir().unwrap();
        let ini = folder.path().join("mine.ini");
        std::fs::write(&ini, "[DISPLAY]\nPROGRAM_PREFIX = nc\n").unwrap();
        let slot = "G55".parse().unwrap();
        assert_eq!(programs_with_slot(&ini, slot), None);
        let programs = folder.path().join("nc");
        std::fs::create_dir(&programs).unwrap();
        for (name, text) in [("b.ngc", "G55\n"), ("a.NGC", "g55\n"), ("c.ngc", "G54\n"), ("d.txt", "G55\n")] {
            std::fs::write(programs.join(name), text).unwrap();
        }
        let long = format!("{}G55\n", "(long)\n".repeat(600_000));
        std::fs::write(programs.join("long.ngc"), long).unwrap();
        let search = programs_with_slot(&ini, slot).unwrap();
        assert_eq!((search.found, search.unsearched_count), (vec!["a.NGC".to_owned(), "b.ngc".to_owned()], 1));
    }
}
