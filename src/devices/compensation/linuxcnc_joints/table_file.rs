//! A compensation file of LinuxCNC: lines of a nominal position and one value for each direction of motion.

use std::fs::{self, File};
use std::io::{self, Write as _};
use std::os::unix::fs::{MetadataExt as _, fchown};
use std::path::{Path, PathBuf};

use crate::compensation::ValueToWrite;
use crate::finite_numbers::parse_finite_number;

/// Maximum number of lines that LinuxCNC reads (User Manual, "INI Configuration", `COMP_FILE`).
const MAX_LINES: usize = 256;
/// Maximum length of a line for LinuxCNC, bytes.
const MAX_LINE_BYTES: usize = 250;

#[derive(Debug, thiserror::Error)]
pub enum TableFileError {
    #[error("the compensation file {path} cannot be read or written: {source}", path = path.display())]
    Io { path: PathBuf, source: std::io::Error },
    #[error("line {line} of {path} is not a position and two values, or its position does not increase; LinuxCNC ignores all lines from there on", path = path.display())]
    InvalidLine { path: PathBuf, line: usize },
    #[error("{path} has {count} lines; LinuxCNC reads 2 to {MAX_LINES}", path = path.display())]
    LineCount { path: PathBuf, count: usize },
    #[error("{path} has no value for `{name}`", path = path.display())]
    NoSuchValue { path: PathBuf, name: String },
}

impl TableFileError {
    /// What to do next.
    pub fn remedy(&self) -> &'static str {
        match self {
            Self::Io { .. } => "run trued on the computer of the control, as a user who may write this file",
            Self::InvalidLine { .. } | Self::LineCount { .. } => {
                "correct the file: each line has the position and the values for both directions, in increasing order, without \
                 empty lines; a file without corrections has both ends of the travel, each with zeros"
            }
            Self::NoSuchValue { .. } => "restore the file from a backup; do not edit it during a compensation",
        }
    }
}

/// Direction of motion for which a value is valid.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MotionDirection {
    Forward,
    Reverse,
}

impl MotionDirection {
    const ALL: [Self; 2] = [Self::Forward, Self::Reverse];

    fn as_str(self) -> &'static str {
        match self {
            Self::Forward => "forward",
            Self::Reverse => "reverse",
        }
    }
}

/// One value of the file.
#[derive(Debug, Clone, PartialEq)]
pub struct TableValue {
    /// Position of the joint, as the file states it.
    pub position_text: String,
    pub position_mm: f64,
    pub direction: MotionDirection,
    /// The value as the file states it.
    pub value_text: String,
    /// Correction or actual position at `position_mm`, by the type of the table.
    pub value_mm: f64,
}

impl TableValue {
    /// Name within the file, e.g. `-300 forward`.
    pub fn name(&self) -> String {
        format!("{} {}", self.position_text, self.direction.as_str())
    }
}

/// The file as it was read.
#[derive(Debug, Clone)]
pub struct TableFile {
    path: PathBuf,
    text: String,
}

impl TableFile {
    /// # Errors
    /// The file cannot be read.
    pub fn read(path: &Path) -> Result<Self, TableFileError> {
        let text = fs::read_to_string(path).map_err(|source| TableFileError::Io { path: path.to_owned(), source })?;
        Ok(Self { path: path.to_owned(), text })
    }

    /// Values of all lines, in order; for each line forward, then reverse.
    ///
    /// # Errors
    /// A line is not valid, or the file has too few or too many lines.
    pub fn values(&self) -> Result<Vec<TableValue>, TableFileError> {
        let mut values: Vec<TableValue> = Vec::new();
        let mut count = 0;
        for (index, line) in self.text.trim_end().lines().enumerate() {
            let invalid = || TableFileError::InvalidLine { path: self.path.clone(), line: index + 1 };
            let pair = parse_line(line).filter(|_| line.len() <= MAX_LINE_BYTES).ok_or_else(invalid)?;
            let is_increasing = values.last().is_none_or(|last| pair[0].position_mm > last.position_mm);
            values.extend(is_increasing.then_some(pair).ok_or_else(invalid)?);
            count += 1;
        }
        match (2..=MAX_LINES).contains(&count) {
            true => Ok(values),
            false => Err(TableFileError::LineCount { path: self.path.clone(), count }),
        }
    }

    /// Atomically replaces the file by a copy with `values`. All other bytes are unchanged.
    ///
    /// # Errors
    /// The file has no value of a name, or cannot be written.
    pub fn write_values(&self, values: &[ValueToWrite<'_>]) -> Result<(), TableFileError> {
        let mut text = self.text.clone();
        for value in values {
            text = with_value(&text, value)
                .ok_or_else(|| TableFileError::NoSuchValue { path: self.path.clone(), name: value.name.to_owned() })?;
        }
        self.replace_file(&text).map_err(|source| TableFileError::Io { path: self.path.clone(), source })
    }

    /// Writes a new file to the disk, with owner and permissions of the old one, and renames it over the old one.
    fn replace_file(&self, text: &str) -> io::Result<()> {
        let folder = self.path.parent().unwrap_or(Path::new("."));
        let name = self.path.file_name().unwrap_or_default().to_string_lossy();
        let new_path = folder.join(format!(".{name}.trued"));
        match fs::remove_file(&new_path) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
            // Removes the new file that an interrupted write has left.
            _ => {}
        }
        if let Err(error) = self.write_new_file(&new_path, text).and_then(|()| fs::rename(&new_path, &self.path)) {
            let _ = fs::remove_file(&new_path);
            return Err(error);
        }
        File::open(folder)?.sync_all()
    }

    fn write_new_file(&self, new_path: &Path, text: &str) -> io::Result<()> {
        let metadata = fs::metadata(&self.path)?;
        let mut file = File::create_new(new_path)?;
        file.set_permissions(metadata.permissions())?;
        fchown(&file, Some(metadata.uid()), Some(metadata.gid()))?;
        file.write_all(text.as_bytes())?;
        file.sync_all()
    }
}

/// The text of a file with one value replaced; `None` if the file has no value of that name.
fn with_value(text: &str, value: &ValueToWrite<'_>) -> Option<String> {
    let replace = |line: &str| {
        let [_, forward, reverse] = word_offsets(line)?;
        let [of_forward, of_reverse] = parse_line(line)?;
        let mut found = [(of_forward, forward), (of_reverse, reverse)].into_iter();
        let (own, offset) = found.find(|(own, _)| own.name() == value.name)?;
        Some(format!("{}{}{}", &line[..offset], value.text, &line[offset + own.value_text.len()..]))
    };
    let mut lines: Vec<String> = text.split_inclusive('\n').map(str::to_owned).collect();
    let (index, changed) = lines.iter().enumerate().find_map(|(index, line)| Some((index, replace(line)?)))?;
    lines[index] = changed;
    Some(lines.concat())
}

/// Parses a line: its position with the forward and the reverse value. `None` if it is not three numbers.
fn parse_line(line: &str) -> Option<[TableValue; 2]> {
    let words: Vec<&str> = line.split_whitespace().collect();
    let [position, values @ ..] = &words[..] else { return None };
    let [forward, reverse] = values else { return None };
    let position_mm = parse_finite_number(position)?;
    let value = |direction, word: &str| {
        let (position_text, value_text) = ((*position).to_owned(), word.to_owned());
        Some(TableValue { position_text, position_mm, direction, value_mm: parse_finite_number(word)?, value_text })
    };
    let [of_forward, of_reverse] = MotionDirection::ALL;
    Some([value(of_forward, forward)?, value(of_reverse, reverse)?])
}

/// Offsets of the three words of a line, bytes; `None` if it has another number of words.
fn word_offsets(line: &str) -> Option<[usize; 3]> {
    let starts = line.char_indices().filter(|(offset, character)| {
        let before = line[..*offset].chars().next_back();
        !character.is_whitespace() && before.is_none_or(char::is_whitespace)
    });
    let offsets: Vec<usize> = starts.map(|(offset, _)| offset).collect();
    offsets.try_into().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file_of(folder: &Path, text: &str) -> TableFile {
        let path = folder.join("x.comp");
        std::fs::write(&path, text).unwrap();
        TableFile::read(&path).unwrap()
    }

    #[test]
    fn values_are_replaced_and_restored_byte_for_byte() {
        let folder = tempfile::tempdir().unwrap();
        let text = "-300.00   0.0300\t0.020 \r\n 0 0.0 -0.0\n300 -3e-2 -0.04\n\n";
        let file = file_of(folder.path(), text);
        let names: Vec<String> = file.values().unwrap().iter().map(TableValue::name).collect();
        assert_eq!(names[..3], ["-300.00 forward", "-300.00 reverse", "0 forward"]);
        let named = |name, text| ValueToWrite { name, text };
        file.write_values(&[named("300 forward", "-0.0312"), named("-300.00 reverse", "0.0212")]).unwrap();
        let changed = TableFile::read(&folder.path().join("x.comp")).unwrap();
        assert_eq!(changed.text, text.replace("-3e-2", "-0.0312").replace("0.020", "0.0212"));
        assert_eq!(changed.values().unwrap()[4].value_mm, -0.0312);
        changed.write_values(&[named("-300.00 reverse", "0.020"), named("300 forward", "-3e-2")]).unwrap();
        assert_eq!(std::fs::read_to_string(folder.path().join("x.comp")).unwrap(), text);
        assert!(matches!(file.write_values(&[named("1 forward", "0")]), Err(TableFileError::NoSuchValue { .. })));
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn invalid_files_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let error = |text: &str| file_of(folder.path(), text).values().unwrap_err().to_string();
        for (text, expected) in [
            ("0 0 0\n", "has 1 lines"),
            ("0 0 0\n1 0\n", "line 2"),
            ("0 0 0\n1 0 0 0\n", "line 2"),
            ("0 0 0\n1 0 nan\n", "line 2"),
            ("0 0 0\n0 0 0\n", "line 2"),
            ("; X\n0 0 0\n1 0 0\n", "line 1"),
            // LinuxCNC stops reading at an empty line.
            ("0 0 0\n\n1 0 0\n", "line 2"),
            (&format!("0 0 0\n1 0 {}0\n", " ".repeat(250)), "line 2"),
            (&(0..257).map(|at| format!("{at} 0 0\n")).collect::<String>(), "has 257 lines"),
        ] {
            assert!(error(text).contains(expected), "{text}: {}", error(text));
        }
        assert!(TableFile::read(&folder.path().join("none")).is_err());
    }
}
