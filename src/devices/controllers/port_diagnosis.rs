//! Finds out why a port cannot be opened, from the error of the operating system.

use std::fs;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use super::{ControllerError, PossibleCause};
use link::modbus::ModbusError;
use link::{LinkConfig, LinkError, SERIAL_PORTS_BY_ID_DIR};

/// Serial ports that the operator may have meant, by their names in Linux. A computer has dozens of ttyS
/// ports without a device.
const SERIAL_PORT_PREFIXES: [&str; 3] = ["ttyUSB", "ttyACM", "ttyAMA"];

/// Possible causes why the link `at` could not be opened, from the system's error; none for other errors.
pub(in crate::controllers) fn diagnose_open_failure(at: &LinkConfig, failure: &ControllerError) -> Vec<PossibleCause> {
    let (ControllerError::Link(error) | ControllerError::Modbus(ModbusError::OpenFailed(error))) = failure else {
        return Vec::new();
    };
    let diagnosis = match (error, at) {
        (LinkError::NotListening { address }, _) => connection_refused_diagnosis(address),
        (LinkError::NoSuchPort { address }, _) => port_missing_diagnosis(address, Path::new("/dev")),
        (LinkError::NoUniquePort { id, available }, _) => no_port_with_id_diagnosis(id, available),
        (LinkError::PermissionDenied { address }, _) => permission_denied_diagnosis(address),
        (LinkError::Busy { address }, _) => port_in_use_diagnosis(address),
        (LinkError::OpenFailed { address, source }, LinkConfig::Tcp(_)) => tcp_open_failure_diagnosis(address, source),
        _ => return Vec::new(),
    };
    vec![diagnosis]
}

fn connection_refused_diagnosis(address: &str) -> PossibleCause {
    PossibleCause::observed(
        format!("wrong port, or the control's server is not running: no server answers at {address}"),
        "the computer refuses the connection",
        "start the server on that computer, or set [controller] tcp = \"host:port\" in the machine file to \
         the port in the control's manual",
    )
}

/// The host does not answer; or, if `source` is no network error, its name is unknown.
fn tcp_open_failure_diagnosis(address: &str, source: &std::io::Error) -> PossibleCause {
    use std::io::ErrorKind as Kind;
    match source.kind() {
        Kind::TimedOut | Kind::HostUnreachable | Kind::NetworkUnreachable => PossibleCause::observed(
            format!(
                "{address} is not reachable: wrong address, the computer is off, or a firewall blocks the connection"
            ),
            source.to_string(),
            "switch the computer on, run `ping`, check the cable and the addresses of both computers; then \
             correct [controller] tcp in the machine file",
        ),
        _ => PossibleCause::observed(
            format!("the host name in {address} is unknown"),
            source.to_string(),
            "use the IP address: [controller] tcp = \"192.0.2.10:23\"",
        ),
    }
}

/// `devices`: folder that is searched for other ports.
fn port_missing_diagnosis(address: &str, devices: &Path) -> PossibleCause {
    let there = list_serial_ports(devices);
    let others = match there.as_slice() {
        [] => "no serial port was found".to_owned(),
        there => format!("serial ports present: {}", there.join(", ")),
    };
    let remedy = match there.as_slice() {
        [] => "plug the device in and switch it on; `dmesg` shows whether the system detects it".to_owned(),
        [only] => format!("if that port is the control, set [controller] serial = \"{only}\""),
        _ => format!(
            "set [controller] serial, or better serial_id with a name from {SERIAL_PORTS_BY_ID_DIR}: these names do not change"
        ),
    };
    PossibleCause::observed(format!("wrong port: this computer has no {address}"), others, remedy)
}

/// Paths of the serial ports with [`SERIAL_PORT_PREFIXES`] in the folder `devices`, sorted.
fn list_serial_ports(devices: &Path) -> Vec<String> {
    let entries = fs::read_dir(devices).into_iter().flatten().flatten();
    let names = entries.map(|entry| entry.file_name().to_string_lossy().into_owned());
    let is_port = |name: &String| SERIAL_PORT_PREFIXES.iter().any(|kind| name.starts_with(kind));
    let mut all: Vec<String> = names.filter(is_port).map(|name| devices.join(name).display().to_string()).collect();
    all.sort();
    all
}

fn no_port_with_id_diagnosis(id: &str, available_ids: &[String]) -> PossibleCause {
    let names = if available_ids.is_empty() { "none".to_owned() } else { available_ids.join(", ") };
    PossibleCause::observed(
        format!("wrong name, or the device is not plugged in: `{id}` does not match exactly one serial port"),
        format!("{SERIAL_PORTS_BY_ID_DIR} contains {names}"),
        "set [controller] serial_id to a name from that directory, or to a part that occurs in one name only",
    )
}

fn permission_denied_diagnosis(address: &str) -> PossibleCause {
    let group = fs::metadata(address).ok().and_then(|found| read_group_name(found.gid()));
    let group = group.unwrap_or_else(|| "dialout".to_owned());
    PossibleCause::observed(
        format!("no permission: this user cannot open {address}"),
        format!("{address} belongs to the group `{group}`"),
        format!("run `sudo usermod -aG {group} $USER`, then log out and in again"),
    )
}

fn read_group_name(id: u32) -> Option<String> {
    let groups = fs::read_to_string("/etc/group").ok()?;
    let of = |line: &str| {
        let mut fields = line.split(':');
        let (name, number) = (fields.next()?, fields.nth(1)?);
        (number.parse() == Ok(id)).then(|| name.to_owned())
    };
    groups.lines().find_map(of)
}

fn port_in_use_diagnosis(address: &str) -> PossibleCause {
    let (evidence, remedy) = match find_process_using_port(Path::new(address)) {
        Some((process, name)) => {
            (format!("`{name}` (process {process}) has the port open"), "close that program".to_owned())
        }
        None => (
            "a program of another user has the port open; this user cannot see its name".to_owned(),
            format!(
                "run `sudo fuser -v {address}` to find the program (often a G-code sender, a terminal or ModemManager), and close it"
            ),
        ),
    };
    PossibleCause::observed(format!("another program uses {address}"), evidence, remedy)
}

/// Number and name of another process that has `path` open, as far as this user may see it.
fn find_process_using_port(path: &Path) -> Option<(u32, String)> {
    let target = fs::canonicalize(path).ok()?;
    let own = std::process::id();
    let processes = fs::read_dir("/proc").ok()?.flatten();
    let numbers = processes.filter_map(|entry| entry.file_name().to_str()?.parse::<u32>().ok());
    numbers.filter(|process| *process != own).find_map(|process| {
        let folder = PathBuf::from(format!("/proc/{process}"));
        let mut open = fs::read_dir(folder.join("fd")).ok()?.flatten();
        open.find(|file| fs::read_link(file.path()).is_ok_and(|to| to == target))?;
        let name = fs::read_to_string(folder.join("comm")).unwrap_or_default();
        Some((process, name.trim().to_owned()))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use link::HostPort;

    #[test]
    fn missing_port_is_reported_with_the_existing_ones() {
        let devices = tempfile::tempdir().unwrap();
        let told = |names: &[&str]| {
            names.iter().for_each(|name| drop(fs::write(devices.path().join(name), "")));
            port_missing_diagnosis("/dev/ttyUSB7", devices.path())
        };
        assert!(told(&["ttyS0", "null"]).evidence.contains("no serial port was found"));
        let one = told(&["ttyACM0"]);
        assert!(one.remedy.contains("serial = \"") && one.remedy.contains("ttyACM0\""), "{one:?}");
        assert!(told(&["ttyUSB0"]).evidence.contains("ttyUSB0"));
    }

    #[test]
    fn group_name_and_process_using_a_file_are_found() {
        assert_eq!(read_group_name(0).as_deref(), Some("root"));
        let mut sleeper = std::process::Command::new("sleep");
        let file = tempfile::NamedTempFile::new().unwrap();
        let held = fs::File::open(file.path()).unwrap();
        let mut sleeper = sleeper.arg("20").stdin(held).spawn().unwrap();
        let found = find_process_using_port(file.path());
        sleeper.kill().unwrap();
        sleeper.wait().unwrap();
        assert_eq!(found.map(|(process, _)| process), Some(sleeper.id()));
    }

    #[test]
    fn network_errors_are_distinguished() {
        let at = LinkConfig::Tcp(HostPort::local(1));
        let told = |kind: std::io::ErrorKind| {
            let address = "192.0.2.1:23".to_owned();
            let failure = LinkError::OpenFailed { address, source: kind.into() }.into();
            diagnose_open_failure(&at, &failure)[0].cause.clone()
        };
        assert!(told(std::io::ErrorKind::TimedOut).contains("is not reachable"));
        assert!(told(std::io::ErrorKind::Other).contains("host name in"));
        let refused = LinkError::NotListening { address: "192.0.2.1:23".to_owned() }.into();
        assert!(diagnose_open_failure(&at, &refused)[0].cause.contains("no server answers"));
        assert!(diagnose_open_failure(&at, &ControllerError::ControlFrozen).is_empty());
    }
}
