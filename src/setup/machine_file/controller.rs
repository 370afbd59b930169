//! `[controller]`: which control, how to reach it, and what it already compensates.

use std::path::PathBuf;

use serde::Deserialize;

use super::document::{Document, value_problem};
use super::error::{MachineFileError, Problem};

const KINDS: [&str; 3] = ["simulated", "grbl", "linuxcnc"];

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ControllerConfig {
    pub control: Control,
    /// Compensations that the control has switched on, in its maker's words. They are part of the
    /// record: a result is what is left over beside them.
    pub compensations_active: Vec<String>,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Control {
    /// The simulated firmware moves a simulated machine, which `[simulated]` describes.
    Simulated { wire: Wire },
    /// grblHAL.
    Grbl { link: Link, dialect: String },
    LinuxCnc {
        /// Address of linuxcncrsh, `host:port`.
        tcp: String,
        /// Where programs and their result logs are put; the control must see the same folder.
        program_dir: PathBuf,
        dialect: String,
    },
}

impl Control {
    /// The language that it is spoken to; the simulated control orients its spindle.
    pub fn dialect(&self) -> &str {
        match self {
            Self::Simulated { .. } => "grbl-m19",
            Self::Grbl { dialect, .. } | Self::LinuxCnc { dialect, .. } => dialect,
        }
    }
}

/// What stands between the daemon and the simulated firmware.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Wire {
    #[default]
    Memory,
    Pty,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Link {
    Serial {
        path: PathBuf,
        baud: u32,
    },
    /// A port by its name below `/dev/serial/by-id`, or a part of that name.
    SerialId {
        id: String,
        baud: u32,
    },
    /// `host:port`.
    Tcp(String),
}

#[derive(Deserialize)]
struct Kind {
    kind: String,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Simulated {
    #[serde(rename = "kind")]
    _kind: String,
    #[serde(default)]
    wire: Wire,
    #[serde(default)]
    compensations_active: Vec<String>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Grbl {
    #[serde(rename = "kind")]
    _kind: String,
    serial: Option<PathBuf>,
    serial_id: Option<String>,
    baud: Option<u32>,
    tcp: Option<String>,
    #[serde(default = "grbl_dialect")]
    dialect: String,
    #[serde(default)]
    compensations_active: Vec<String>,
}

fn grbl_dialect() -> String {
    "grbl".to_owned()
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct LinuxCnc {
    #[serde(rename = "kind")]
    _kind: String,
    #[serde(default = "linuxcncrsh_address")]
    tcp: String,
    program_dir: PathBuf,
    #[serde(default = "linuxcnc_dialect")]
    dialect: String,
    #[serde(default)]
    compensations_active: Vec<String>,
}

/// Port 5007 is linuxcncrsh's own default.
fn linuxcncrsh_address() -> String {
    "127.0.0.1:5007".to_owned()
}

fn linuxcnc_dialect() -> String {
    "linuxcnc".to_owned()
}

const SECTION: [&str; 1] = ["controller"];

pub fn read(document: &Document) -> Result<ControllerConfig, MachineFileError> {
    let Kind { kind } = document.required(&SECTION)?;
    match kind.as_str() {
        "simulated" => {
            let raw: Simulated = document.required(&SECTION)?;
            Ok(ControllerConfig {
                control: Control::Simulated { wire: raw.wire },
                compensations_active: raw.compensations_active,
            })
        }
        "grbl" => grbl(document, document.required(&SECTION)?),
        "linuxcnc" => linuxcnc(document, document.required(&SECTION)?),
        other => {
            let why = format!("is `{other}`; known: {}", KINDS.join(", "));
            Err(document
                .error_at(&["controller", "kind"], value_problem(&["controller", "kind"], why)))
        }
    }
}

fn grbl(document: &Document, raw: Grbl) -> Result<ControllerConfig, MachineFileError> {
    let baud = raw.baud.unwrap_or(115_200);
    let link = match (raw.serial, raw.serial_id, raw.tcp) {
        (Some(path), None, None) => Link::Serial { path, baud },
        (None, Some(id), None) => Link::SerialId { id, baud },
        (None, None, Some(_)) if raw.baud.is_some() => {
            let key = ["controller", "baud"];
            let why = "belongs to `serial`; a TCP link has no baud rate: remove it".to_owned();
            return Err(document.error_at(&key, value_problem(&key, why)));
        }
        (None, None, Some(address)) => Link::Tcp(host_port(document, address)?),
        _ => {
            let why = "needs exactly one link: `serial = \"/dev/...\"`, `serial_id = \"usb-...\"` \
                       or `tcp = \"host:port\"`";
            let problem = Problem::Section { section: "controller".into(), why: why.into() };
            return Err(document.error_at(&SECTION, problem));
        }
    };
    Ok(ControllerConfig {
        control: Control::Grbl { link, dialect: raw.dialect },
        compensations_active: raw.compensations_active,
    })
}

fn linuxcnc(document: &Document, raw: LinuxCnc) -> Result<ControllerConfig, MachineFileError> {
    Ok(ControllerConfig {
        control: Control::LinuxCnc {
            tcp: host_port(document, raw.tcp)?,
            program_dir: raw.program_dir,
            dialect: raw.dialect,
        },
        compensations_active: raw.compensations_active,
    })
}

/// A name or an address, a colon and a port; whether somebody listens there is the link's matter.
fn host_port(document: &Document, address: String) -> Result<String, MachineFileError> {
    let sound = address
        .rsplit_once(':')
        .is_some_and(|(host, port)| !host.is_empty() && port.parse::<u16>().is_ok_and(|p| p > 0));
    if sound {
        return Ok(address);
    }
    let key = ["controller", "tcp"];
    let why = format!("is `{address}`; write `host:port`, e.g. `127.0.0.1:5007`");
    Err(document.error_at(&key, value_problem(&key, why)))
}
