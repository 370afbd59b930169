//! `trued init`: writes a commented machine file from the data that the control reports.

use std::fs::OpenOptions;
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};

use super::Exit;
use super::args::InitArgs;
use super::failure::Failure;
use super::run::runtime;
use crate::setup::{Draft, SetupError};
use devices::controllers::{DeviceInfo, Leave, Named};

pub fn init(args: &InitArgs) -> Result<Exit, Failure> {
    if let Some(file) = args.to.as_deref().filter(|file| file.exists()) {
        return Err(there_already(file));
    }
    let draft = Draft {
        controller: controller(args, ini_file(args.ini.as_deref())?),
        name: args.name.clone(),
        topology: args.topology.clone(),
    };
    let control = draft.control()?;
    let said = runtime()?.block_on(introduced(&draft, control.as_ref(), args.search))?;
    let text = draft.write(&said)?;
    match &args.to {
        None => say!("{}", text.trim_end()),
        Some(file) => write_new(file, &text)?,
    }
    for remark in &said.remarks {
        tell!("{}\n  → {}", remark.what, remark.remedy);
    }
    Ok(Exit::Pass)
}

/// Absolute path of LinuxCNC's INI file, as the machine file may be read from another folder.
fn ini_file(path: Option<&Path>) -> Result<Option<String>, Failure> {
    let Some(path) = path else { return Ok(None) };
    match path.canonicalize() {
        Ok(path) if path.is_file() => Ok(Some(path.display().to_string())),
        Err(error) if error.kind() != ErrorKind::NotFound => Err(Failure::file(path, &error)),
        _ => Err(Failure::new(
            format!("--ini: there is no such file: {}", path.display()),
            "give the path of the INI file that LinuxCNC was started with",
        )),
    }
}

/// `[controller]` from the arguments, with the path of the INI file.
fn controller(args: &InitArgs, ini: Option<String>) -> toml::Table {
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

async fn introduced(
    draft: &Draft,
    control: &dyn Named,
    search: bool,
) -> Result<DeviceInfo, Failure> {
    let error = match draft.introduce(control).await {
        Err(SetupError::Controller(error)) => error,
        said => return Ok(said?),
    };
    let leave = if search { Leave::Ask } else { Leave::Listen };
    for suspicion in draft.diagnose(control, &error, leave).await {
        tell!("{suspicion}\n  → {}", suspicion.remedy);
    }
    if !search {
        tell!("`trued init --search` asks at other speeds and in other languages as well");
    }
    Err(SetupError::Controller(error).into())
}

fn write_new(file: &Path, text: &str) -> Result<(), Failure> {
    let created = OpenOptions::new().write(true).create_new(true).open(file);
    let written = created.and_then(|mut created| created.write_all(text.as_bytes()));
    written.map_err(|error| match error.kind() {
        ErrorKind::AlreadyExists => there_already(file),
        _ => Failure::file(file, &error),
    })?;
    tell!("{} is written; put right what is marked YOURS, then:", file.display());
    tell!("  trued check --machine {}", file.display());
    Ok(())
}

fn there_already(file: &Path) -> Failure {
    Failure::new(
        format!("{} is there already", file.display()),
        "a machine file is never overwritten: give another name, or move it away",
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_path_of_the_ini_file_is_absolute_and_must_be_there() {
        let here = ini_file(Some(Path::new("tests/peers/linuxcnc/rig.ini"))).unwrap().unwrap();
        assert!(Path::new(&here).is_absolute() && here.ends_with("/rig.ini"), "{here}");
        let failure = ini_file(Some(Path::new("tests/peers"))).unwrap_err();
        assert!(failure.what.starts_with("--ini: there is no such file"), "{}", failure.what);
        assert_eq!(ini_file(None).unwrap(), None);
    }
}
