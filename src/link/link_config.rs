//! Link settings in a file: `serial`, `serial_id` or `tcp`.

use std::fmt;
use std::path::{Path, PathBuf};
use std::time::Duration;

use serde::Deserialize;

use super::link_mode::LinkMode;
use super::{LinkAddress, LinkError, SERIAL_PORTS_BY_ID_DIR, find_serial_port_by_id};

/// Default of the key `timeout_s` of a link, s.
const DEFAULT_LINK_TIMEOUT_S: f64 = 0.5;

/// Converts the key `timeout_s` of a link; absent: `DEFAULT_LINK_TIMEOUT_S`.
///
/// # Errors
/// A message, if the time is not within 0.01 to 30 s.
pub fn parse_timeout_s(timeout_s: Option<f64>) -> Result<Duration, String> {
    let seconds = timeout_s.unwrap_or(DEFAULT_LINK_TIMEOUT_S);
    let in_range = (0.01..=30.0).contains(&seconds);
    let message = || format!("`timeout_s` is {seconds}; permitted: 0.01 to 30 s");
    in_range.then(|| Duration::from_secs_f64(seconds)).ok_or_else(message)
}

/// A host name or address, a colon and a port. Whether a server listens there is known only after opening.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
#[serde(try_from = "String")]
pub struct HostPort {
    host: String,
    port: u16,
}

impl HostPort {
    /// A port of this computer.
    pub fn local(port: u16) -> Self {
        Self { host: "127.0.0.1".to_owned(), port }
    }
}

impl TryFrom<String> for HostPort {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        let split = text.rsplit_once(':').filter(|(host, _)| !host.is_empty());
        let port = split.and_then(|(host, port)| Some((host, port.parse().ok()?)));
        match port {
            Some((host, port)) if port > 0 => Ok(Self { host: host.to_owned(), port }),
            _ => Err(format!("`{text}` is not a host and a port; write `host:port`, e.g. `127.0.0.1:5007`")),
        }
    }
}

impl From<&HostPort> for LinkAddress {
    fn from(HostPort { host, port }: &HostPort) -> Self {
        LinkAddress::Tcp { host: host.clone(), port: *port }
    }
}

/// Keys of a link in the table of a device.
pub struct LinkKeys {
    pub serial: Option<PathBuf>,
    pub serial_id: Option<String>,
    pub tcp: Option<HostPort>,
    pub baud: Option<u32>,
}

/// Address of a link, as stated by the one key that the file contains: `serial`, `serial_id` or `tcp`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum LinkConfig {
    Serial {
        path: PathBuf,
        baud: u32,
    },
    /// A port by its name below [`SERIAL_PORTS_BY_ID_DIR`], or by a part of that name.
    SerialId {
        id: String,
        baud: u32,
    },
    Tcp(HostPort),
}

impl fmt::Display for LinkConfig {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Serial { path, .. } => write!(f, "{}", path.display()),
            Self::SerialId { id, .. } => write!(f, "{id}"),
            Self::Tcp(tcp) => write!(f, "{}", LinkAddress::from(tcp)),
        }
    }
}

impl LinkConfig {
    /// Description with the baud rate.
    pub fn describe(&self) -> String {
        match self {
            Self::Serial { baud, .. } | Self::SerialId { baud, .. } => format!("{self} at {baud} baud"),
            Self::Tcp(_) => self.to_string(),
        }
    }

    /// Baud rate of a serial port; `None` for TCP.
    pub fn baud(&self) -> Option<u32> {
        match self {
            Self::Serial { baud, .. } | Self::SerialId { baud, .. } => Some(*baud),
            Self::Tcp(_) => None,
        }
    }

    /// The keys of a machine file's table that name this address.
    pub fn to_toml(&self) -> String {
        match self {
            Self::Serial { baud, .. } => format!("serial = \"{self}\"\nbaud = {baud}\n"),
            Self::SerialId { baud, .. } => format!("serial_id = \"{self}\"\nbaud = {baud}\n"),
            Self::Tcp(_) => format!("tcp = \"{self}\"\n"),
        }
    }

    /// Builds the settings from the keys of a table; a serial port without `baud` gets `default_baud`.
    ///
    /// # Errors
    /// A message, if none or several of the three addresses are given, or a baud rate together with `tcp`.
    pub fn from_keys(keys: LinkKeys, default_baud: u32) -> Result<Self, String> {
        let LinkKeys { serial, serial_id, tcp, baud } = keys;
        let rate = baud.unwrap_or(default_baud);
        match (serial, serial_id, tcp) {
            (Some(path), None, None) => Ok(Self::Serial { path, baud: rate }),
            (None, Some(id), None) => Ok(Self::SerialId { id, baud: rate }),
            (None, None, Some(_)) if baud.is_some() => {
                Err("`baud` is only for `serial` and `serial_id`; remove it from a TCP link".to_owned())
            }
            (None, None, Some(tcp)) => Ok(Self::Tcp(tcp)),
            _ => Err("needs exactly one link: `serial = \"/dev/...\"`, `serial_id = \"usb-...\"` \
                      or `tcp = \"host:port\"`"
                .to_owned()),
        }
    }

    /// Current address of the link: the name of [`Self::SerialId`] is resolved to the path of its port. In a replay,
    /// the name itself is the path, because no port is opened.
    ///
    /// # Errors
    /// No port, or more than one port, matches the name.
    pub fn resolve_address(&self) -> Result<LinkAddress, LinkError> {
        let serial = |path: &Path, baud: u32| LinkAddress::Serial { path: path.display().to_string(), baud };
        Ok(match self {
            Self::Serial { path, baud } => serial(path, *baud),
            // A replayed capture answers, so the port need not exist.
            Self::SerialId { id, baud } if LinkMode::current().is_replayed() => serial(Path::new(id), *baud),
            Self::SerialId { id, baud } => {
                serial(&find_serial_port_by_id(Path::new(SERIAL_PORTS_BY_ID_DIR), id)?, *baud)
            }
            Self::Tcp(tcp) => tcp.into(),
        })
    }
}
