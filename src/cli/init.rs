//! `trued init`: writes a commented machine file from the data that the control reports.

use std::fs::File;
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};

use super::args::InitArgs;
use super::failure::CommandFailure;
use super::run::build_runtime;
use crate::setup::{MachineFileDraft, SetupError};
use devices::controllers::{ControllerConfig, DeviceInfo, DiagnosisMode};

pub fn init_command(args: &InitArgs) -> Result<(), CommandFailure> {
    if let Some(file) = args.to.as_deref().filter(|file| file.exists()) {
        return Err(new_machine_file_error(file, &ErrorKind::AlreadyExists.into()));
    }
    let draft = MachineFileDraft {
        controller_keys: controller_table(args, absolute_ini_path(args.ini.as_deref())?),
        machine_name: args.name.clone(),
        topology: args.topology.clone(),
    };
    let control = draft.control_config()?;
    let info = build_runtime()?.block_on(query_device_info(&draft, control.as_ref(), args.search))?;
    let text = draft.render(&info)?;
    match &args.to {
        None => outln!("{}", text.trim_end()),
        Some(file) => write_new_machine_file(file, &text)?,
    }
    for remark in &info.findings {
        errln!("{}\n  → {}", remark.description, remark.remedy);
    }
    Ok(())
}

/// Absolute path of LinuxCNC's INI file, as the machine file may be read from another folder.
fn absolute_ini_path(path: Option<&Path>) -> Result<Option<String>, CommandFailure> {
    let Some(path) = path else { return Ok(None) };
    match path.canonicalize() {
        Ok(path) if path.is_file() => Ok(Some(path.display().to_string())),
        Err(error) if error.kind() != ErrorKind::NotFound => Err(CommandFailure::from_file_error(path, &error)),
        _ => Err(CommandFailure::new(
            format!("--ini: the file {} does not exist", path.display()),
            "use the path of the INI file of the running LinuxCNC",
        )),
    }
}

/// Table `[controller]` from the arguments, with the path of the INI file.
fn controller_table(args: &InitArgs, ini: Option<String>) -> toml::Table {
    let text = |value: &Option<String>| value.clone().map(toml::Value::String);
    let number = |value: Option<u32>| value.map(|value| toml::Value::Integer(value.into()));
    let path = |path: &Option<PathBuf>| path.as_ref().map(|path| path.display().to_string());
    let keys = [
        ("kind", Some(toml::Value::String(args.kind.clone()))),
        ("serial", text(&args.serial)),
        ("serial_id", text(&args.serial_id)),
        ("baud", number(args.baud)),
        ("parity", text(&args.parity)),
        ("tcp", text(&args.tcp)),
        ("unit", number(args.unit.map(u32::from))),
        ("program_dir", text(&path(&args.program_dir))),
        ("ini", text(&ini)),
        ("dialect", text(&args.dialect)),
    ];
    keys.into_iter().filter_map(|(key, value)| Some((key.to_owned(), value?))).collect()
}

/// Device information of the control. If the control cannot be identified, possible causes are printed.
async fn query_device_info(
    draft: &MachineFileDraft,
    control: &dyn ControllerConfig,
    searches_actively: bool,
) -> Result<DeviceInfo, CommandFailure> {
    let error = match draft.query_device_info(control).await {
        Err(SetupError::Controller(error)) => error,
        info => return Ok(info?),
    };
    let mode = if searches_actively { DiagnosisMode::OtherSettings } else { DiagnosisMode::ConfiguredSettings };
    for suspicion in draft.diagnose_connection_failure(control, &error, mode).await {
        errln!("{suspicion}\n  → {}", suspicion.remedy);
    }
    if !searches_actively {
        errln!("`trued init --search` also tries other baud rates and protocols");
    }
    Err(SetupError::Controller(error).into())
}

fn write_new_machine_file(file: &Path, text: &str) -> Result<(), CommandFailure> {
    let created = File::create_new(file);
    let written = created.and_then(|mut created| created.write_all(text.as_bytes()));
    written.map_err(|error| new_machine_file_error(file, &error))?;
    errln!("written: {}. Correct the values that are marked YOURS, then run:", file.display());
    errln!("  trued check --machine {}", file.display());
    Ok(())
}

fn new_machine_file_error(file: &Path, error: &std::io::Error) -> CommandFailure {
    CommandFailure::from_new_file_error(file, error, "machine file")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ini_path_is_absolute_and_must_exist() {
        let here = absolute_ini_path(Some(Path::new("tests/peers/linuxcnc/rig.ini"))).unwrap().unwrap();
        assert!(Path::new(&here).is_absolute() && here.ends_with("/rig.ini"), "{here}");
        let failure = absolute_ini_path(Some(Path::new("tests/peers"))).unwrap_err();
        assert!(failure.message.starts_with("--ini: the file tests/peers does not exist"), "{}", failure.message);
        assert_eq!(absolute_ini_path(None).unwrap(), None);
    }
}
