//! Why a port cannot be opened, from the error of the operating system.

use std::fs;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use super::{ControllerError, Diagnosis};
use link::modbus::ModbusError;
use link::{BY_ID, LinkError, Named};

/// Serial ports that the operator may have meant, by their names in Linux. A computer has dozens of ttyS
/// ports without a device.
const SERIAL: [&str; 3] = ["ttyUSB", "ttyACM", "ttyAMA"];

/// Suspected causes if the link `at` could not be opened, from the system's error; none if it could.
pub(in crate::controllers) fn suspects(at: &Named, failed: &ControllerError) -> Vec<Diagnosis> {
    let (ControllerError::Link(error) | ControllerError::Modbus(ModbusError::Link(error))) = failed
    else {
        return Vec::new();
    };
    let suspicion = match (error, at) {
        (LinkError::NotListening { address }, _) => nobody_listens(address),
        (LinkError::Missing { address }, _) => no_port(address, Path::new("/dev")),
        (LinkError::NoneNamed { id, there }, _) => none_named(id, there),
        (LinkError::Denied { address }, _) => denied(address),
        (LinkError::Busy { address }, _) => busy(address),
        (LinkError::Open { address, source }, Named::Tcp(_)) => no_way(address, source),
        _ => return Vec::new(),
    };
    vec![suspicion]
}

fn seen(what: String, because: String, remedy: &str) -> Diagnosis {
    Diagnosis { seen: true, vague: false, what, because, remedy: remedy.to_owned() }
}

fn nobody_listens(address: &str) -> Diagnosis {
    seen(
        format!("wrong port, or the control's server is not running: nobody listens at {address}"),
        "the computer of that name is there and refuses the connection".to_owned(),
        "start the server there; in the machine file, [controller] tcp = \"host:port\" with the port that \
         its manual names",
    )
}

fn no_way(address: &str, source: &std::io::Error) -> Diagnosis {
    use std::io::ErrorKind as Kind;
    match source.kind() {
        Kind::TimedOut | Kind::HostUnreachable | Kind::NetworkUnreachable => seen(
            format!("no way to {address}: wrong address, or it is off or behind a firewall"),
            source.to_string(),
            "switch it on, `ping` it, look at the cable and at both addresses; then [controller] tcp in the \
             machine file",
        ),
        _ => seen(
            format!("there is no computer of the name in {address}"),
            source.to_string(),
            "write its address in figures: [controller] tcp = \"192.0.2.10:23\"",
        ),
    }
}

fn no_port(address: &str, devices: &Path) -> Diagnosis {
    let there = ports(devices);
    let others = match there.as_slice() {
        [] => "there is no serial port at all".to_owned(),
        there => format!("there are {}", there.join(", ")),
    };
    let remedy = match there.as_slice() {
        [] => "plug the device in and switch it on; `dmesg` says whether it is seen".to_owned(),
        [only] => format!("if that is the control: [controller] serial = \"{only}\""),
        _ => format!(
            "[controller] serial, or better serial_id with a name from {BY_ID}, which does not change"
        ),
    };
    seen(format!("wrong port: {address} is not there"), others, &remedy)
}

fn ports(devices: &Path) -> Vec<String> {
    let entries = fs::read_dir(devices).into_iter().flatten().flatten();
    let names = entries.map(|entry| entry.file_name().to_string_lossy().into_owned());
    let is_port = |name: &String| SERIAL.iter().any(|kind| name.starts_with(kind));
    let mut all: Vec<String> =
        names.filter(is_port).map(|name| devices.join(name).display().to_string()).collect();
    all.sort();
    all
}

fn none_named(id: &str, there: &[String]) -> Diagnosis {
    let names = if there.is_empty() { "none".to_owned() } else { there.join(", ") };
    seen(
        format!("wrong name, or it is not plugged in: no one port is called `{id}`"),
        format!("{BY_ID} has {names}"),
        "[controller] serial_id takes a name from there, or a part that no other name has",
    )
}

fn denied(address: &str) -> Diagnosis {
    let group = fs::metadata(address).ok().and_then(|found| group_name(found.gid()));
    let group = group.unwrap_or_else(|| "dialout".to_owned());
    seen(
        format!("this user may not open {address}: no permission"),
        format!("it belongs to the group `{group}`"),
        &format!("`sudo usermod -aG {group} $USER`, then log out and in again"),
    )
}

fn group_name(id: u32) -> Option<String> {
    let groups = fs::read_to_string("/etc/group").ok()?;
    let of = |line: &str| {
        let mut fields = line.split(':');
        let (name, number) = (fields.next()?, fields.nth(1)?);
        (number.parse() == Ok(id)).then(|| name.to_owned())
    };
    groups.lines().find_map(of)
}

fn busy(address: &str) -> Diagnosis {
    let (because, remedy) = match holder(Path::new(address)) {
        Some((process, name)) => {
            (format!("`{name}` (process {process}) has it open"), "end that program".to_owned())
        }
        None => (
            "a program of another user has it, which cannot be seen from here".to_owned(),
            format!(
                "`sudo fuser -v {address}` names it (often a sender, a terminal, ModemManager)"
            ),
        ),
    };
    seen(format!("another program holds {address}"), because, &remedy)
}

/// Number and name of a process that has `path` open, as far as this user may see it.
fn holder(path: &Path) -> Option<(u32, String)> {
    let wanted = fs::canonicalize(path).ok()?;
    let own = std::process::id();
    let processes = fs::read_dir("/proc").ok()?.flatten();
    let numbers = processes.filter_map(|entry| entry.file_name().to_str()?.parse::<u32>().ok());
    numbers.filter(|process| *process != own).find_map(|process| {
        let folder = PathBuf::from(format!("/proc/{process}"));
        let mut open = fs::read_dir(folder.join("fd")).ok()?.flatten();
        open.find(|file| fs::read_link(file.path()).is_ok_and(|to| to == wanted))?;
        let name = fs::read_to_string(folder.join("comm")).unwrap_or_default();
        Some((process, name.trim().to_owned()))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use link::HostPort;

    #[test]
    fn a_port_that_is_not_there_is_told_with_those_that_are() {
        let devices = tempfile::tempdir().unwrap();
        let told = |names: &[&str]| {
            names.iter().for_each(|name| drop(fs::write(devices.path().join(name), "")));
            no_port("/dev/ttyUSB7", devices.path())
        };
        assert!(told(&["ttyS0", "null"]).because.contains("no serial port at all"));
        let one = told(&["ttyACM0"]);
        assert!(one.remedy.contains("serial = \"") && one.remedy.contains("ttyACM0\""), "{one:?}");
        assert!(told(&["ttyUSB0"]).because.contains("ttyUSB0"));
    }

    #[test]
    fn the_system_is_asked_for_groups_and_holders() {
        assert_eq!(group_name(0).as_deref(), Some("root"));
        let mut sleeper = std::process::Command::new("sleep");
        let file = tempfile::NamedTempFile::new().unwrap();
        let held = fs::File::open(file.path()).unwrap();
        let mut sleeper = sleeper.arg("20").stdin(held).spawn().unwrap();
        let found = holder(file.path());
        sleeper.kill().unwrap();
        sleeper.wait().unwrap();
        assert_eq!(found.map(|(process, _)| process), Some(sleeper.id()));
    }

    #[test]
    fn what_a_network_says_is_told_apart() {
        let at = Named::Tcp(HostPort::local(1));
        let told = |kind: std::io::ErrorKind| {
            let address = "192.0.2.1:23".to_owned();
            let failed = LinkError::Open { address, source: kind.into() }.into();
            suspects(&at, &failed)[0].what.clone()
        };
        assert!(told(std::io::ErrorKind::TimedOut).contains("no way to"));
        assert!(told(std::io::ErrorKind::Other).contains("no computer of the name"));
        let refused = LinkError::NotListening { address: "192.0.2.1:23".to_owned() }.into();
        assert!(suspects(&at, &refused)[0].what.contains("nobody listens"));
        assert!(suspects(&at, &ControllerError::Frozen).is_empty());
    }
}
