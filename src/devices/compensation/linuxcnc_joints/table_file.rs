//! A compensation file of LinuxCNC: lines of a nominal position and one value for each direction of motion.

use std::fs::{self, File};
use std::io::Write as _;
use std::path::{Path, PathBuf};

/// Most lines that LinuxCNC reads (User Manual, "INI Configuration", `COMP_FILE`).
const MAX_LINES: usize = 256;

#[derive(Debug, thiserror::Error)]
pub enum TableFileError {
    #[error("the compensation file {path} cannot be read or written: {source}", path = path.display())]
    Io { path: PathBuf, source: std::io::Error },
    #[error("line {line} of {path} is not a position and two values, or its position does not increase", path = path.display())]
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
                "correct the file: each line has the position and the values for both directions, in increasing order; \
                 without a correction the first and the last position of the travel, each with zeros"
            }
            Self::NoSuchValue { .. } => "do not edit the file between a proposal and its end; restore it from a backup",
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
    pub text: String,
    pub mm: f64,
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

    /// The values line by line, each line forward and reverse.
    ///
    /// # Errors
    /// A line is not valid; there are too few or too many.
    pub fn values(&self) -> Result<Vec<TableValue>, TableFileError> {
        let mut values: Vec<TableValue> = Vec::new();
        let mut count = 0;
        for (index, line) in self.text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty()) {
            let invalid = || TableFileError::InvalidLine { path: self.path.clone(), line: index + 1 };
            let pair = parse_line(line).ok_or_else(invalid)?;
            let is_increasing = values.last().is_none_or(|last| pair[0].position_mm > last.position_mm);
            values.extend(is_increasing.then_some(pair).ok_or_else(invalid)?);
            count += 1;
        }
        match (2..=MAX_LINES).contains(&count) {
            true => Ok(values),
            false => Err(TableFileError::LineCount { path: self.path.clone(), count }),
        }
    }

    /// Replaces the file by one in which the value `name` reads `text`. All other bytes are as before.
    ///
    /// # Errors
    /// There is no such value; the file cannot be written.
    pub fn write_value(&self, name: &str, text: &str) -> Result<(), TableFileError> {
        let no_such_value = || TableFileError::NoSuchValue { path: self.path.clone(), name: name.to_owned() };
        let replace = |line: &str| {
            let [_, forward, reverse] = words_with_offsets(line)?;
            let [of_forward, of_reverse] = parse_line(line)?;
            let found = [(of_forward, forward), (of_reverse, reverse)].into_iter().find(|(own, _)| own.name() == name);
            found.map(|(own, offset)| format!("{}{text}{}", &line[..offset], &line[offset + own.text.len()..]))
        };
        let lines: Vec<&str> = self.text.split_inclusive('\n').collect();
        let changed = lines.iter().enumerate().find_map(|(index, line)| Some((index, replace(line)?)));
        let (changed_index, changed_line) = changed.ok_or_else(no_such_value)?;
        let is_changed = |index: usize| index == changed_index;
        let new = lines.iter().enumerate();
        let new = new.map(|(index, line)| if is_changed(index) { changed_line.as_str() } else { line });
        self.replace_file(&new.collect::<String>())
    }

    /// The new file is on the disk before it takes the place of the old one.
    fn replace_file(&self, text: &str) -> Result<(), TableFileError> {
        let error = |source| TableFileError::Io { path: self.path.clone(), source };
        let mut new_name = self.path.clone().into_os_string();
        new_name.push(".new");
        let new_path = PathBuf::from(new_name);
        let mut file = File::create(&new_path).map_err(error)?;
        let permissions = fs::metadata(&self.path).map_err(error)?.permissions();
        file.set_permissions(permissions).map_err(error)?;
        file.write_all(text.as_bytes()).and_then(|()| file.sync_all()).map_err(error)?;
        fs::rename(&new_path, &self.path).map_err(error)
    }
}

/// `None`: not three numbers.
fn parse_line(line: &str) -> Option<[TableValue; 2]> {
    let words: Vec<&str> = line.split_whitespace().collect();
    let [position, values @ ..] = &words[..] else { return None };
    let [forward, reverse] = values else { return None };
    let number = |word: &str| word.parse().ok().filter(|number: &f64| number.is_finite());
    let position_mm = number(position)?;
    let value = |direction, word: &str| {
        let (position_text, text) = ((*position).to_owned(), word.to_owned());
        Some(TableValue { position_text, position_mm, direction, mm: number(word)?, text })
    };
    let [of_forward, of_reverse] = MotionDirection::ALL;
    Some([value(of_forward, forward)?, value(of_reverse, reverse)?])
}

/// Offsets of the three words of a line, bytes.
fn words_with_offsets(line: &str) -> Option<[usize; 3]> {
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
    fn one_value_is_replaced_and_restored_byte_for_byte() {
        let folder = tempfile::tempdir().unwrap();
        let text = "-300.00   0.0300\t0.020 \r\n\n 0 0.0 -0.0\n300 -3e-2 -0.04";
        let file = file_of(folder.path(), text);
        let names: Vec<String> = file.values().unwrap().iter().map(TableValue::name).collect();
        assert_eq!(names[..3], ["-300.00 forward", "-300.00 reverse", "0 forward"]);
        file.write_value("300 forward", "-0.0312").unwrap();
        let changed = TableFile::read(&folder.path().join("x.comp")).unwrap();
        assert_eq!(changed.text, text.replace("-3e-2", "-0.0312"));
        assert_eq!(changed.values().unwrap()[4].mm, -0.0312);
        changed.write_value("300 forward", "-3e-2").unwrap();
        assert_eq!(std::fs::read_to_string(folder.path().join("x.comp")).unwrap(), text);
        assert!(matches!(file.write_value("1 forward", "0"), Err(TableFileError::NoSuchValue { .. })));
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
            (&(0..257).map(|at| format!("{at} 0 0\n")).collect::<String>(), "has 257 lines"),
        ] {
            assert!(error(text).contains(expected), "{text}: {}", error(text));
        }
        assert!(TableFile::read(&folder.path().join("none")).is_err());
    }
}
