//! Where a device is, and how its byte stream is opened.

use std::fmt;
use std::io;
use std::time::Duration;

use tokio::net::TcpStream;
use tokio::time::timeout;
use tokio_serial::{ErrorKind, SerialPortBuilderExt, SerialStream};

use super::{Link, LinkError};

/// How long a host may take to accept a connection.
const CONNECT: Duration = Duration::from_secs(5);

/// Where a byte stream leads.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Address {
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

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Address::Serial { path, .. } => write!(f, "{path}"),
            Address::Tcp { host, port } => write!(f, "{host}:{port}"),
        }
    }
}

/// Open `address` for this process alone (serial: `TIOCEXCL` and an advisory lock), on the thread
/// that will own it.
pub async fn open(address: &Address) -> Result<Link, LinkError> {
    let name = address.to_string();
    match address.clone() {
        Address::Serial { path, baud } => {
            Link::opened(name, async move { serial(path, baud) }).await
        }
        Address::Tcp { host, port } => Link::opened(name.clone(), tcp(name, host, port)).await,
    }
}

fn serial(path: String, baud: u32) -> Result<SerialStream, LinkError> {
    let opened = tokio_serial::new(&path, baud).open_native_async();
    opened.map_err(|error| serial_error(path, error))
}

async fn tcp(name: String, host: String, port: u16) -> Result<TcpStream, LinkError> {
    // A connection that is not there yet can be given up without harm.
    timeout(CONNECT, TcpStream::connect((host.as_str(), port)))
        .await
        .unwrap_or_else(|_| Err(io::ErrorKind::TimedOut.into()))
        .and_then(|stream| stream.set_nodelay(true).map(|()| stream))
        .map_err(|source| tcp_error(name, source))
}

fn serial_error(address: String, error: tokio_serial::Error) -> LinkError {
    match error.kind() {
        // The serial crate says `NoDevice` for "somebody holds it" and NotFound for "is not there".
        ErrorKind::NoDevice => LinkError::Busy { address },
        ErrorKind::Io(io::ErrorKind::NotFound) => LinkError::Missing { address },
        ErrorKind::Io(io::ErrorKind::PermissionDenied) => LinkError::Denied { address },
        _ => LinkError::Open { address, source: io::Error::other(error) },
    }
}

fn tcp_error(address: String, source: io::Error) -> LinkError {
    match source.kind() {
        io::ErrorKind::ConnectionRefused => LinkError::Missing { address },
        io::ErrorKind::PermissionDenied => LinkError::Denied { address },
        _ => LinkError::Open { address, source },
    }
}

/// A pty for a simulated device: a stream for the device, and the path that a client opens.
pub struct Pty {
    pub device: SerialStream,
    pub path: String,
    /// Held open, so that the device outlives its clients as a real one does.
    pub client_side: SerialStream,
}

/// Make a pty in raw mode.
pub fn pty() -> Result<Pty, LinkError> {
    let fault = |source: io::Error| LinkError::Open { address: "a new pty".to_owned(), source };
    let (device, client_side) =
        SerialStream::pair().map_err(|error| fault(io::Error::other(error)))?;
    let path = tokio_serial::SerialPort::name(&client_side)
        .ok_or_else(|| fault(io::Error::other("it has no name")))?;
    Ok(Pty { device, path, client_side })
}
