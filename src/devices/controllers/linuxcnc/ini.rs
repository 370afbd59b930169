//! LinuxCNC's INI file. `#INCLUDE` is not followed.

use std::collections::BTreeMap;
use std::path::Path;

use crate::controllers::ControllerError;

/// INI file of LinuxCNC: values by section and key; if a key occurs twice, the first value counts.
pub(super) struct Ini(BTreeMap<(String, String), String>);

impl Ini {
    pub fn read(path: &Path) -> Result<Self, ControllerError> {
        let text = std::fs::read_to_string(path).map_err(|error| ControllerError::NotReady {
            state: format!("its INI file {}: {error}", path.display()),
            remedy: "[controller] ini in the machine file is the file that LinuxCNC was started with, and this \
                     user can read it"
                .to_owned(),
        })?;
        Ok(Self::of(&text))
    }

    pub fn of(text: &str) -> Self {
        let mut all = BTreeMap::new();
        let mut section = String::new();
        for line in text.lines().map(str::trim) {
            if let Some(name) = line.strip_prefix('[').and_then(|rest| rest.strip_suffix(']')) {
                section = name.to_owned();
            } else if let Some((key, value)) =
                line.split_once('=').filter(|_| !line.starts_with(['#', ';']))
            {
                let place = (section.clone(), key.trim().to_owned());
                all.entry(place).or_insert_with(|| value.trim().to_owned());
            }
        }
        Self(all)
    }

    pub fn text(&self, section: &str, key: &str) -> Option<&str> {
        self.0.get(&(section.to_owned(), key.to_owned())).map(String::as_str)
    }

    pub fn number(&self, section: &str, key: &str) -> Option<f64> {
        self.text(section, key)?.parse().ok().filter(|number: &f64| number.is_finite())
    }

    /// Module of the kinematics and its arguments.
    pub fn kinematics(&self) -> Option<&str> {
        self.text("KINS", "KINEMATICS")
    }

    pub fn kinematics_module(&self) -> Option<&str> {
        self.kinematics()?.split_whitespace().next()
    }

    /// Number of joints.
    pub fn joints(&self) -> Option<usize> {
        self.text("KINS", "JOINTS")?.parse().ok()
    }
}
