//! `config/trued.toml`: the machines that one daemon serves, and the address of its page. Each machine has its
//! own file, whose path is relative to this one.

use std::path::{Path, PathBuf};

use serde::Deserialize;

use super::config::{HttpConfig, ServeConfig};
use super::retention::RetentionConfig;
use crate::setup::MachineFile;
use crate::setup::machine_file::{MachineFileError, TomlDocument};

/// Permitted top-level sections of the daemon's file.
const SECTION_NAMES: [&str; 3] = ["http", "machine", "retention"];

/// One `[[machine]]` of the daemon's file.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct MachineEntry {
    /// Path of the machine file, relative to the folder of the daemon's file.
    file: PathBuf,
}

/// Machines and settings of a daemon: of `trued serve --config` (`trued.toml`) with the machine files that it names, of
/// one machine file, or built in.
pub struct DaemonFile {
    /// Machine files and their `[serve]`, in the order of the daemon's file.
    pub machines: Vec<(MachineFile, ServeConfig)>,
    /// `None`: no web page and no HTTP API.
    pub http_config: Option<HttpConfig>,
    /// `None`: samples and captures of old runs are never removed.
    pub retention_config: Option<RetentionConfig>,
}

impl DaemonFile {
    /// # Errors
    /// This file or a machine file is invalid, or a machine file has its own `[serve.http]`; the error gives file,
    /// line, key and remedy.
    pub fn read(path: &Path) -> Result<Self, MachineFileError> {
        let document = TomlDocument::read(path)?;
        document.check_keys_are_known(&[], &SECTION_NAMES)?;
        let http = document.read_section(&["http"], HttpConfig::deserialize)?;
        let retention = document.read_section(&["retention"], RetentionConfig::deserialize)?;
        let entries: Vec<MachineEntry> = document.deserialize_required_section(&["machine"])?;
        let folder = path.parent().unwrap_or(Path::new(""));
        let machines = entries.iter().enumerate().map(|(index, entry)| {
            let (machine, config) = read_serve_section(MachineFile::read(&folder.join(&entry.file))?)?;
            let Some(http) = &config.http_config else { return Ok((machine, config)) };
            let why = format!(
                "refers to a machine file that configures its own page at {}: one daemon serves one page; \
                 move [serve.http] of that file to this file as [http]",
                http.listen
            );
            Err(document.entry_value_error(&["machine"], index, "file", why))
        });
        Ok(Self { machines: machines.collect::<Result<_, _>>()?, http_config: http, retention_config: retention })
    }

    /// Serves the machine of one file, with its own page if the file configures one.
    ///
    /// # Errors
    /// The errors of [`Self::read`].
    pub fn for_machine_file(path: &Path) -> Result<Self, MachineFileError> {
        let (machine, config) = read_serve_section(MachineFile::read(path)?)?;
        let http = config.http_config.clone();
        Ok(Self { machines: vec![(machine, config)], http_config: http, retention_config: None })
    }

    /// Serves the built-in simulated machine, with a page.
    ///
    /// # Errors
    /// The errors of [`Self::read`].
    pub fn built_in() -> Result<Self, MachineFileError> {
        let machine = read_serve_section(MachineFile::built_in_for_method("self-calibration")?)?;
        let http =
            HttpConfig { listen: ([127, 0, 0, 1], 8137).into(), proxy_names: Vec::new(), requires_tokens: false };
        Ok(Self { machines: vec![machine], http_config: Some(http), retention_config: None })
    }
}

/// Checks the method names in the machine file, and reads its `[serve]`.
fn read_serve_section(machine: MachineFile) -> Result<(MachineFile, ServeConfig), MachineFileError> {
    machine.check_method_names(&methods::method_names())?;
    let config = machine.read_serve_section()?;
    Ok((machine, config))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn daemon_file_in_config_serves_the_built_in_machine() {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("config/trued.toml");
        let DaemonFile { machines, http_config: http, .. } = DaemonFile::read(&file).unwrap();
        assert_eq!(machines.len(), 1);
        assert_eq!(machines[0].1.cycles[0].method, "self-calibration");
        // The built-in machine is what `trued serve` serves without a file.
        let DaemonFile { machines: built_in, http_config: page, .. } = DaemonFile::built_in().unwrap();
        assert_eq!(machines[0].0.text(), built_in[0].0.text());
        assert_eq!(http.map(|http| http.listen), page.map(|page| page.listen));
    }
}
