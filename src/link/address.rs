//! Addresses of devices (serial port, TCP), and how to open the byte stream at an address.

use std::fmt;
use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

use tokio::net::TcpStream;
use tokio::time::{Instant, sleep, timeout};
use tokio_serial::{ErrorKind, Parity, SerialPortBuilderExt, SerialStream};

use super::boxed_stream::BoxedStream;
use super::{ByteStreamHandle, LineLink, LinkError};

/// Maximum time until a host accepts a TCP connection.
const TCP_CONNECT_TIMEOUT: Duration = Duration::from_secs(5);

/// Maximum wait for a serial port that another client has not closed yet: the last request of that client may still
/// run until its timeout.
const MAX_BUSY_PORT_WAIT: Duration = Duration::from_secs(5);
const BUSY_PORT_RETRY_INTERVAL: Duration = Duration::from_millis(50);

/// Address of a byte stream.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum LinkAddress {
    /// A serial device or a pty.
    Serial {
        path: String,
        baud: u32,
    },
    Tcp {
        host: String,
        port: u16,
    },
}

impl fmt::Display for LinkAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            LinkAddress::Serial { path, .. } => write!(f, "{path}"),
            LinkAddress::Tcp { host, port } => write!(f, "{host}:{port}"),
        }
    }
}

/// Opens `address` for this process alone (serial: `TIOCEXCL` and an advisory lock), on the thread that will own
/// the stream. Waits some seconds for another holder to close the port.
pub async fn open_line_link(address: &LinkAddress) -> Result<LineLink, LinkError> {
    LineLink::open(address.to_string(), open_stream(address.clone(), Parity::None)).await
}

/// Like [`open_line_link`], for a device that sends data without a request.
pub async fn open_byte_stream(address: &LinkAddress) -> Result<ByteStreamHandle, LinkError> {
    ByteStreamHandle::open(address.to_string(), open_stream(address.clone(), Parity::None)).await
}

/// Opens the stream at `address`, on the caller's runtime.
pub(super) async fn open_stream(address: LinkAddress, parity: Parity) -> Result<BoxedStream, LinkError> {
    Ok(match address {
        LinkAddress::Serial { path, baud } => Box::pin(open_serial(path, baud, parity).await?),
        LinkAddress::Tcp { host, port } => Box::pin(connect_tcp(host, port).await?),
    })
}

/// Folder where udev lists serial ports by persistent names, which do not depend on the port number.
pub const SERIAL_PORTS_BY_ID_DIR: &str = "/dev/serial/by-id";

/// Path of the port in `directory` whose name is `id`, or of the only port whose name contains `id`. The path leads
/// to the same device even after the port number has changed.
///
/// # Errors
/// No name matches, or more than one name matches.
pub fn find_serial_port_by_id(directory: &Path, id: &str) -> Result<PathBuf, LinkError> {
    // A missing folder counts as a folder without ports.
    let entries = std::fs::read_dir(directory).into_iter().flatten().flatten();
    let mut names: Vec<String> = entries.map(|entry| entry.file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    if names.iter().any(|name| name == id) {
        return Ok(directory.join(id));
    }
    let (matching, others): (Vec<_>, Vec<_>) = names.into_iter().partition(|name| !id.is_empty() && name.contains(id));
    match matching.as_slice() {
        [name] => Ok(directory.join(name)),
        [] => Err(LinkError::NoUniquePort { id: id.to_owned(), available: others }),
        _ => Err(LinkError::NoUniquePort { id: id.to_owned(), available: matching }),
    }
}

/// Opens a serial port; while another client holds the port, tries again for up to `MAX_BUSY_PORT_WAIT`.
async fn open_serial(path: String, baud: u32, parity: Parity) -> Result<SerialStream, LinkError> {
    let port = tokio_serial::new(&path, baud).parity(parity);
    let deadline = Instant::now() + MAX_BUSY_PORT_WAIT;
    loop {
        match port.clone().open_native_async().map_err(|error| map_serial_error(&path, error)) {
            Err(LinkError::Busy { .. }) if Instant::now() < deadline => sleep(BUSY_PORT_RETRY_INTERVAL).await,
            opened => return opened,
        }
    }
}

async fn connect_tcp(host: String, port: u16) -> Result<TcpStream, LinkError> {
    // Dropping a connection attempt is harmless: nothing was sent yet.
    timeout(TCP_CONNECT_TIMEOUT, TcpStream::connect((host.as_str(), port)))
        .await
        .unwrap_or_else(|_| Err(io::ErrorKind::TimedOut.into()))
        .and_then(|stream| stream.set_nodelay(true).map(|()| stream))
        .map_err(|source| map_tcp_error(format!("{host}:{port}"), source))
}

fn map_serial_error(path: &str, error: tokio_serial::Error) -> LinkError {
    let address = path.to_owned();
    match error.kind() {
        // The serial crate reports `NoDevice` for a port that another process holds, and `NotFound` for a missing
        // port.
        ErrorKind::NoDevice => LinkError::Busy { address },
        ErrorKind::Io(io::ErrorKind::NotFound) => LinkError::NoSuchPort { address },
        ErrorKind::Io(io::ErrorKind::PermissionDenied) => LinkError::PermissionDenied { address },
        _ => LinkError::OpenFailed { address, source: io::Error::other(error) },
    }
}

fn map_tcp_error(address: String, source: io::Error) -> LinkError {
    match source.kind() {
        io::ErrorKind::ConnectionRefused => LinkError::NotListening { address },
        io::ErrorKind::PermissionDenied => LinkError::PermissionDenied { address },
        _ => LinkError::OpenFailed { address, source },
    }
}

/// A pty for a simulated device: the device's stream, and the path that a client opens.
pub struct Pty {
    pub device: SerialStream,
    /// Path that a client opens.
    pub path: String,
    /// Client side, held open so that the device outlives its clients, as a real device does; `None`: a task holds it.
    pub client_side: Option<SerialStream>,
}

/// Makes a pty in raw mode.
pub fn create_pty() -> Result<Pty, LinkError> {
    let fault = |source: io::Error| LinkError::OpenFailed { address: "a new pty".to_owned(), source };
    let (device, client_side) = SerialStream::pair().map_err(|error| fault(io::Error::other(error)))?;
    let path =
        tokio_serial::SerialPort::name(&client_side).ok_or_else(|| fault(io::Error::other("the pty has no name")))?;
    Ok(Pty { device, path, client_side: Some(client_side) })
}
