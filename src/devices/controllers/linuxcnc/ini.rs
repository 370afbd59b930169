//! LinuxCNC's INI file. `#INCLUDE` is not followed.

use std::collections::BTreeMap;
use std::path::Path;

use crate::controllers::ControllerError;
use crate::finite_numbers::parse_finite_number;

/// INI file of LinuxCNC: values by section and key; if a key occurs twice, the first value counts.
pub(crate) struct IniFile(BTreeMap<(String, String), String>);

impl IniFile {
    pub fn read(path: &Path) -> Result<Self, ControllerError> {
        let text = std::fs::read_to_string(path).map_err(|error| {
            ControllerError::not_ready(
                format!("the INI file {} is not readable: {error}", path.display()),
                "set [controller] ini in the machine file to the file that LinuxCNC was started with, and give this \
                 user read permission",
            )
        })?;
        Ok(Self::parse(&text))
    }

    pub fn parse(text: &str) -> Self {
        let mut values = BTreeMap::new();
        let mut section = String::new();
        for line in text.lines().map(str::trim) {
            if let Some(name) = line.strip_prefix('[').and_then(|rest| rest.strip_suffix(']')) {
                section = name.to_owned();
            } else if let Some((key, value)) = line.split_once('=').filter(|_| !line.starts_with(['#', ';'])) {
                let path = (section.clone(), key.trim().to_owned());
                values.entry(path).or_insert_with(|| value.trim().to_owned());
            }
        }
        Self(values)
    }

    pub fn value(&self, section: &str, key: &str) -> Option<&str> {
        self.0.get(&(section.to_owned(), key.to_owned())).map(String::as_str)
    }

    pub fn number(&self, section: &str, key: &str) -> Option<f64> {
        parse_finite_number(self.value(section, key)?)
    }

    /// Value of `[KINS]KINEMATICS`: the module of the kinematics and its arguments.
    pub fn kinematics(&self) -> Option<&str> {
        self.value("KINS", "KINEMATICS")
    }

    pub fn kinematics_module(&self) -> Option<&str> {
        self.kinematics()?.split_whitespace().next()
    }

    /// Number of joints, `[KINS]JOINTS`.
    pub fn joint_count(&self) -> Option<usize> {
        self.value("KINS", "JOINTS")?.parse().ok()
    }
}
