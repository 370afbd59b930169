//! LinuxCNC's compensation files for linear axes. LinuxCNC reads them when it starts, interpolates between the
//! positions, and adds the correction to the position of the motor; the position that it reports does not contain it
//! (User Manual, "INI Configuration", `COMP_FILE`; seen on LinuxCNC 2.9).

mod table_file;

use std::path::{Path, PathBuf};

use machine::Axis;

use self::table_file::TableFile;
pub use self::table_file::{MotionDirection, TableFileError, TableValue};
use super::hal_pins::{ComponentPins, HalError, HalcmdClient};
use super::{ValueToWrite, are_values_equal, check_unit_is_mm};
use crate::controllers::ControllerError;
use crate::controllers::linuxcnc::IniFile;

#[derive(Debug, thiserror::Error)]
pub enum JointTableError {
    #[error(transparent)]
    Hal(#[from] HalError),
    #[error(transparent)]
    Ini(#[from] ControllerError),
    #[error(transparent)]
    File(#[from] TableFileError),
    #[error("{path} names no compensation file (COMP_FILE) for a joint of X, Y or Z", path = path.display())]
    NoTable { path: PathBuf },
    #[error("COMP_FILE_TYPE of [JOINT_{joint}] in {path} is not 0 or 1", path = path.display())]
    UnknownType { path: PathBuf, joint: usize },
    #[error("two joints have the compensation file {path}", path = path.display())]
    SharedFile { path: PathBuf },
    /// `expected_mm`: correction of the file for forward motion.
    #[error("LinuxCNC corrects {axis} at {position_mm} mm by {active_mm} mm; the file has {expected_mm} mm")]
    NotInEffect { axis: Axis, position_mm: f64, active_mm: f64, expected_mm: f64 },
    #[error("at {position_mm} mm of {axis} LinuxCNC's correction does not show whether it uses the new file")]
    NotDistinguishable { axis: Axis, position_mm: f64 },
    #[error("after the write, `{name}` reads `{read}` instead of `{written}`")]
    ReadBackMismatch { name: String, written: String, read: String },
    /// An axis with a compensation file belongs to several joints.
    #[error("{path} assigns {axis} to several joints", path = path.display())]
    Gantry { path: PathBuf, axis: Axis },
}

impl JointTableError {
    /// What to do next.
    pub fn remedy(&self) -> String {
        let text = match self {
            Self::Hal(error) => return error.remedy(),
            Self::Ini(error) => return error.remedy(),
            Self::File(error) => error.remedy(),
            Self::NoTable { .. } => {
                "add to the section of the joint, e.g. [JOINT_0]: COMP_FILE = x.comp and COMP_FILE_TYPE = 1; write the file \
                 with the first and the last position of the travel, each with zeros (`-300 0 0`, `300 0 0`); restart \
                 LinuxCNC and home the axes"
            }
            Self::UnknownType { .. } => {
                "set COMP_FILE_TYPE to the type of the file: 0 if its values are actual positions, 1 if they are corrections"
            }
            Self::Gantry { .. } => "correct the compensation files of the joints of this axis by hand",
            Self::SharedFile { .. } => "give each joint a file of its own",
            Self::NotInEffect { .. } => "restart LinuxCNC and home all axes, then try again",
            Self::NotDistinguishable { .. } => {
                "move the axis near an end of its travel, where the old and the new correction differ most, then try again"
            }
            Self::ReadBackMismatch { .. } => "check which other program writes the file, then try again",
        };
        text.to_owned()
    }
}

/// Meaning of the values in a compensation file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TableKind {
    /// `COMP_FILE_TYPE = 0` or missing: the actual position; the correction is the nominal position minus the value.
    ActualPosition,
    /// `COMP_FILE_TYPE = 1`: the correction.
    Correction,
}

/// Compensation table of one axis, as read from its file.
#[derive(Debug, Clone, PartialEq)]
pub struct JointTable {
    pub axis: Axis,
    pub kind: TableKind,
    /// Name of the file; part of the names of its values.
    pub file_name: String,
    /// Two values for each position: forward, then reverse.
    pub values: Vec<TableValue>,
}

impl JointTable {
    /// Name of a value at the control, e.g. `X x.comp -300 forward`.
    pub fn value_name(&self, value: &TableValue) -> String {
        format!("{} {} {}", self.axis, self.file_name, value.name())
    }

    /// Correction at `position_mm`, interpolated in the table; beyond the table, that of its nearest end.
    fn correction_mm(&self, direction: MotionDirection, position_mm: f64) -> f64 {
        let correction = |value: &TableValue| match self.kind {
            TableKind::Correction => value.value_mm,
            TableKind::ActualPosition => value.position_mm - value.value_mm,
        };
        let of_direction: Vec<&TableValue> = self.values.iter().filter(|value| value.direction == direction).collect();
        let after = of_direction.iter().position(|value| value.position_mm > position_mm);
        match (after, of_direction.first(), of_direction.last()) {
            (Some(0), Some(first), _) => correction(first),
            (Some(after), ..) => {
                let [low, high] = [of_direction[after - 1], of_direction[after]];
                let fraction = (position_mm - low.position_mm) / (high.position_mm - low.position_mm);
                correction(low) + fraction * (correction(high) - correction(low))
            }
            (None, _, Some(last)) => correction(last),
            (None, ..) => 0.0,
        }
    }
}

/// The compensation file of one joint.
#[derive(Debug)]
struct JointFile {
    /// Number N of `[JOINT_N]` in the INI file and of the pins `joint.N`, from 0.
    joint: usize,
    axis: Axis,
    kind: TableKind,
    path: PathBuf,
}

/// A control with compensation files.
#[derive(Debug)]
pub struct JointTableTarget {
    pins: HalcmdClient,
    ini: PathBuf,
    /// In the order of the joints; only joints of X, Y and Z that have a `COMP_FILE`.
    files: Vec<JointFile>,
}

impl JointTableTarget {
    /// `ini`: the INI file that LinuxCNC was started with. `halcmd`: as for [`HalcmdClient::new`].
    ///
    /// # Errors
    /// The INI file is not readable, is not in mm, or names no compensation file.
    pub fn new(ini: &Path, halcmd: &[String]) -> Result<Self, JointTableError> {
        let file = IniFile::read(ini)?;
        check_unit_is_mm(&file, ini)?;
        let files = joint_files(&file, ini)?;
        for (index, own) in files.iter().enumerate() {
            if files[..index].iter().any(|other| other.path == own.path) {
                return Err(JointTableError::SharedFile { path: own.path.clone() });
            }
        }
        match files.is_empty() {
            true => Err(JointTableError::NoTable { path: ini.to_owned() }),
            false => Ok(Self { pins: HalcmdClient::new(halcmd), ini: ini.to_owned(), files }),
        }
    }

    /// INI file and `halcmd` command, in words.
    pub fn describe(&self) -> String {
        format!("compensation files of {}, by `{}`", self.ini.display(), self.pins.describe())
    }

    /// Reads the tables of all files.
    ///
    /// # Errors
    /// A file cannot be read, or is not valid.
    pub fn read(&self) -> Result<Vec<JointTable>, JointTableError> {
        self.files.iter().map(JointFile::read).collect()
    }

    /// Writes `values`, each file as a whole, and reads them back. LinuxCNC uses them after its next start. A value
    /// whose name belongs to none of the files is ignored.
    ///
    /// # Errors
    /// A file has no value of a name; a file cannot be written, or reads back with other values.
    pub fn write(&self, values: &[ValueToWrite<'_>]) -> Result<(), JointTableError> {
        for file in &self.files {
            let prefix = file.name_prefix();
            let own = values.iter().filter_map(|value| {
                value.name.strip_prefix(&prefix).map(|name| ValueToWrite { name, text: value.text })
            });
            let own: Vec<ValueToWrite<'_>> = own.collect();
            if !own.is_empty() {
                TableFile::read(&file.path)?.write_values(&own)?;
                file.check_read_back(&own)?;
            }
        }
        Ok(())
    }

    /// Checks at the present position of each axis that LinuxCNC applies the correction of the axis' file, and not that
    /// of `others`. `others`: tables that LinuxCNC must not use, in the order of [`Self::read`]. A table of `others`
    /// that is missing or equal to that of the file is not checked.
    ///
    /// # Errors
    /// LinuxCNC uses other tables, or its correction does not show which ones.
    pub fn check_in_effect(&self, others: &[JointTable]) -> Result<(), JointTableError> {
        let tables = self.read()?;
        for (index, (file, table)) in self.files.iter().zip(&tables).enumerate() {
            let pins = self.pins.read_component(&format!("joint.{}", file.joint))?;
            check_table_in_effect(&pins, table, others.get(index).filter(|other| *other != table))?;
        }
        Ok(())
    }
}

/// The direction of the last motion is unknown: the correction of either direction counts as active.
fn check_table_in_effect(
    pins: &ComponentPins,
    table: &JointTable,
    other: Option<&JointTable>,
) -> Result<(), JointTableError> {
    let position_mm = pins.value("pos-cmd")?;
    let active_mm = pins.value("backlash-corr")?;
    let axis = table.axis;
    let is_active = |own: &JointTable| {
        [MotionDirection::Forward, MotionDirection::Reverse]
            .iter()
            .any(|direction| are_values_equal(own.correction_mm(*direction, position_mm), active_mm))
    };
    match (is_active(table), other.is_some_and(is_active)) {
        (true, false) => Ok(()),
        (true, true) => Err(JointTableError::NotDistinguishable { axis, position_mm }),
        (false, _) => {
            let expected_mm = table.correction_mm(MotionDirection::Forward, position_mm);
            Err(JointTableError::NotInEffect { axis, position_mm, active_mm, expected_mm })
        }
    }
}

impl JointFile {
    fn file_name(&self) -> String {
        self.path.file_name().unwrap_or_default().to_string_lossy().into_owned()
    }

    /// Text with which the names of the file's values begin.
    fn name_prefix(&self) -> String {
        format!("{} {} ", self.axis, self.file_name())
    }

    /// Checks that each value in the file has the text that was written.
    fn check_read_back(&self, written: &[ValueToWrite<'_>]) -> Result<(), JointTableError> {
        let table = self.read()?;
        for ValueToWrite { name, text } in written {
            let read = table.values.iter().find(|value| value.name() == *name).map_or("", |value| &value.value_text);
            if read != *text {
                let (name, written) = (format!("{}{name}", self.name_prefix()), (*text).to_owned());
                return Err(JointTableError::ReadBackMismatch { name, written, read: read.to_owned() });
            }
        }
        Ok(())
    }

    fn read(&self) -> Result<JointTable, JointTableError> {
        let values = TableFile::read(&self.path)?.values()?;
        Ok(JointTable { axis: self.axis, kind: self.kind, file_name: self.file_name(), values })
    }
}

/// The files of the joints of X, Y and Z. The joints are numbered in the order of the axes in `coordinates=` of the
/// kinematics or, if that is missing, in `COORDINATES`.
fn joint_files(file: &IniFile, ini: &Path) -> Result<Vec<JointFile>, JointTableError> {
    let of_kinematics = file.kinematics().unwrap_or_default().split_whitespace();
    let of_kinematics = of_kinematics.filter_map(|word| word.strip_prefix("coordinates=")).next();
    let coordinates = of_kinematics.or_else(|| file.value("TRAJ", "COORDINATES")).unwrap_or_default();
    let letters = coordinates.to_ascii_uppercase();
    let letters = letters.chars().filter(|letter| !letter.is_whitespace());
    let mut files: Vec<JointFile> = Vec::new();
    for (joint, letter) in letters.enumerate() {
        let section = format!("JOINT_{joint}");
        let axis = [Axis::X, Axis::Y, Axis::Z].into_iter().find(|axis| axis.to_string() == letter.to_string());
        let (Some(axis), Some(name)) = (axis, file.value(&section, "COMP_FILE")) else { continue };
        if coordinates.to_ascii_uppercase().matches(letter).count() > 1 {
            return Err(JointTableError::Gantry { path: ini.to_owned(), axis });
        }
        let kind = match file.value(&section, "COMP_FILE_TYPE") {
            None | Some("0") => TableKind::ActualPosition,
            Some("1") => TableKind::Correction,
            _ => return Err(JointTableError::UnknownType { path: ini.to_owned(), joint }),
        };
        let path = ini.parent().unwrap_or(Path::new("")).join(name);
        let path = path.canonicalize().map_err(|source| TableFileError::Io { path, source })?;
        files.push(JointFile { joint, axis, kind, path });
    }
    Ok(files)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// If COMP_FILE_TYPE is missing, LinuxCNC reads the values as actual positions.
    #[test]
    fn files_of_the_joints_are_found_in_the_ini_file() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["x.comp", "y.comp"] {
            std::fs::write(folder.path().join(name), "-9 -9 -9\n9 9 9\n").unwrap();
        }
        let tables = |kinematics: &str, joint_1: &str| {
            let path = folder.path().join("mine.ini");
            let text = format!(
                "[KINS]\nKINEMATICS = {kinematics}\n[TRAJ]\nLINEAR_UNITS = mm\nCOORDINATES = X Y Z\n[JOINT_0]\nCOMP_FILE = \
                 x.comp\n[JOINT_1]\n{joint_1}\n"
            );
            std::fs::write(&path, text).unwrap();
            JointTableTarget::new(&path, &[])
        };
        let read = tables("trivkins", "COMP_FILE = y.comp\nCOMP_FILE_TYPE = 1").unwrap().read().unwrap();
        let found: Vec<(Axis, TableKind)> = read.iter().map(|table| (table.axis, table.kind)).collect();
        assert_eq!(found, [(Axis::X, TableKind::ActualPosition), (Axis::Y, TableKind::Correction)]);
        assert_eq!(read[1].value_name(&read[1].values[2]), "Y y.comp 9 forward");
        assert_eq!(read[0].correction_mm(MotionDirection::Forward, 3.0), 0.0);
        // The joints of the kinematics count, not those of COORDINATES.
        let gantry = tables("trivkins coordinates=XXYZ", "").unwrap_err();
        assert!(matches!(gantry, JointTableError::Gantry { axis: Axis::X, .. }), "{gantry}");
        let shared = tables("trivkins", "COMP_FILE = ./x.comp").unwrap_err();
        assert!(matches!(shared, JointTableError::SharedFile { .. }), "{shared}");
        let unknown = tables("trivkins", "COMP_FILE = y.comp\nCOMP_FILE_TYPE = 2").unwrap_err();
        assert!(matches!(unknown, JointTableError::UnknownType { joint: 1, .. }), "{unknown}");
    }
}
